"""Test configuration: float64, no silent promotion of dtype or rank, headless pictures, programs compiled once.

From the second run of a clone on, what one worker or process compiled, all others and later runs take from
`.pytest_cache`; delete it to compile afresh. Programs are compiled for one short run, in a fifth of the time, for
compilation was three quarters of it. Benchmarks and the census compile as users do, and compare results first;
`machines.py` runs the tests so too ("optimised"), and under what stands in for other machines.

The files of one model run in one worker, one after another, and share what it has traced. A worker above three
gigabytes forgets its programs after a module, else it grows by a gigabyte every few minutes; the last lines of a run
say how far each one came, and which files took most CPU time and how many programs each of them compiled.

Tried without gain (60 small programs, three alternating runs, 2.0 to 2.4 s each way): XLA's thunks off, its scheduler
for concurrency off. Nor on one program of a bearing life: fusion off (six times the compilation), no algebraic
simplification (twice), a larger thread cache of malloc, no tracebacks of operations. Nor on all tests (601 CPU s):
bounds of 1.8 and 8 GB for a worker (626 and 643), on three files memory that glibc keeps, huge pages, and on two
programs other sets of instructions. Of 62,000 samples of a run 32 % are XLA, 14 % tracing, 14 % lowering, 4 % keeping
programs (two workers rarely want the same one), 0.8 % the garbage collector.
"""

import gc
import importlib
import json
import os
import resource
import sys
import time
from collections import Counter
from pathlib import Path

import environment  # before JAX
import jax
import matplotlib
import pytest
from cli_study import SMALL, answered_once
from hypothesis import settings

import rvjax
from rvjax import cli, models
from rvjax._jax import programs
from rvjax.render import Figure
from rvjax.status import Status
from rvjax.study import Study

gc.set_threshold(200_000, 20, 100)  # tracing makes millions of objects; looking through them all cost a tenth
rvjax.enable_x64()
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
matplotlib.use("Agg")

# `HYPOTHESIS_PROFILE=long pytest ...` draws many times more examples in every property test and runs tests marked long:
# dearer cases, and what is a job of the workflow (types, pages, notebooks, wheel, terminal, newest JAX).
settings.register_profile("default", max_examples=60, deadline=None)
settings.register_profile("long", max_examples=2000, deadline=None)
PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "default")
settings.load_profile(PROFILE)

REFERENCE = Path(__file__).parent / "reference"


EVENTS: list[str] = []  # what JAX traced, lowered and compiled; one listener for all, that nobody takes away
jax.monitoring.register_event_duration_secs_listener(lambda event, *_, **__: EVENTS.append(event))
COMPILED = "/jax/core/compile/backend_compile_duration"
SPENT: dict[str, Counter[str]] = {"CPU s": Counter(), "programs": Counter()}  # by file of tests
RUNNING = [""]
jax.monitoring.register_event_duration_secs_listener(
    lambda event, *_, **__: SPENT["programs"].update([RUNNING[0]] if event == COMPILED else [])
)


@pytest.fixture
def compiled():
    """JAX's own news of tracing, lowering and compiling since the list was cleared."""
    EVENTS.clear()
    return EVENTS


@pytest.fixture
def traced_option(tmp_path):
    """An option of XLA that leaves a trace, and what counts the programs of a name that XLA compiled with it."""
    folder = tmp_path / "xla"

    def count(name):
        return len({path.name.split(".")[0] for path in folder.glob(f"*.jit_{name}.*")})

    return (("xla_dump_to", str(folder)),), count


@pytest.fixture(scope="session")
def reference():
    """Independent high-precision cases: reference("four_bar") is the parsed file of that model."""
    return lambda model: json.loads((REFERENCE / f"{model}.json").read_text())


@pytest.fixture
def fake_model(monkeypatch):
    """The outputs of `tests/fake_model`, which is listed among the models for the length of a test."""
    monkeypatch.setattr(models, "MODELS", (*models.MODELS, "tests.fake_model"))
    return importlib.import_module("tests.fake_model.outputs")


@pytest.fixture(scope="module")
def answers():
    """Answers by the text of their study; in this module each is computed once."""
    with answered_once() as found:
        yield found


@pytest.fixture(scope="session")
def answered(tmp_path_factory):
    """One allocation through the command line, shared by the tests that look at what it wrote."""
    folder = tmp_path_factory.mktemp("allocate")
    (folder / "small.toml").write_text(SMALL)
    with answered_once():
        code = cli.main(["allocate", str(folder / "small.toml"), "--results", str(folder / "out"), "--quiet"])
    return code, folder / "out"


@pytest.fixture
def undrawn(monkeypatch):
    """Pages and folders with empty plots, two seconds sooner each: for tests of their words."""
    monkeypatch.setattr(Figure, "content", lambda *_: b"")


@pytest.fixture
def drawing(tmp_path, request):
    """Write the file of a drawing, that of the module without a text; its path."""

    def write(text=None):
        (tmp_path / "drawing.toml").write_text(request.module.DRAWING if text is None else text)
        return str(tmp_path / "drawing.toml")

    return write


@pytest.fixture
def write(tmp_path):
    """Write the file of a bench, text or bytes; its path."""

    def made(content, name="bench.csv", encoding="utf-8"):
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
        return tmp_path / name

    return made


@pytest.fixture
def unsolved(monkeypatch):
    """`rvjax check` without the unit at the mid-points, ten seconds of compilation: for tests of its other lines."""
    none = lambda self, _: (dict.fromkeys(self.requirements, float("nan")), Status.CONVERGED)  # noqa: E731
    monkeypatch.setattr(Study, "at_mid_points", none)
    monkeypatch.setattr("rvjax.commands.check._turning", lambda _: [])


@pytest.fixture
def kept_programs(tmp_path, monkeypatch):
    """A folder in which programs are kept, as if the command line ran."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setattr(programs, "_folder", [folder])
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def thorough():
    """Whether the long profile runs: for the dear half of a test whose other half runs by default."""
    return PROFILE == "long"


def pytest_collection_modifyitems(config, items):
    """Tests marked long are for the long profile; the others in the order of their families."""
    left = [item for item in items if PROFILE != "long" and item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if item not in left]
    items.sort(key=lambda item: FAMILIES.index(scope(item.nodeid)) if scope(item.nodeid) in FAMILIES else len(FAMILIES))


def pytest_collection_finish(session):
    gc.freeze()  # modules and tests stay to the end: no collection looks through them again


PEAKS: dict[str, float] = {}
BOUND, GROWN = 3.0, 0.7  # GB that a worker holds, beyond which it forgets; by which it grows until it forgets again
LEFT = [0.0]  # GB after that: what is free stays with the process, which uses it again


def peak_memory():
    """Largest resident size of this process so far, GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e9 if sys.platform == "darwin" else 1e6)


def held_memory():
    """Resident size of this process now, GB; where the system does not say, its largest so far."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * resource.getpagesize() / 1e9 if statm.exists() else peak_memory()


@pytest.fixture(scope="module", autouse=True)
def forgotten():
    """Beyond the bound, traces and programs of a module are dropped after it."""
    yield
    if held_memory() > max(BOUND, LEFT[0] + GROWN):
        jax.clear_caches()
        LEFT[0] = held_memory()


# Dearest first, so that the end is many small files and no worker waits for the other.
FAMILIES = (
    *("loaded", "tolerances", "running", "dynamics", "code", "four_bar", "identify", "life", "cli", "mesh_force"),
    *("cycloidal", "shard_map", "extremes", "lost_motion", "design", "assembly", "compiled_once", "derivatives"),
    *("report", "models", "published", "docs", "plotting"),
)


def scope(nodeid):
    """Family of a test, or its file."""
    file = nodeid.split("::")[0]
    return next((family for family in FAMILIES if f"test_{family}" in file), file)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """As `--dist loadfile`, but all files of a model go to one worker: shared traces are a sixth of the time."""
    from xdist.scheduler import LoadScopeScheduling

    class Families(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return scope(nodeid)

    config.option.loadscopereorder = False  # by cost, above, and not by the number of tests
    return Families(config, log)


def used_cpu():
    """CPU time of this process and its finished children so far, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Counts CPU time and programs of a test, with the fixtures that it is the first to use, for its file."""
    RUNNING[0], before = item.nodeid.split("::")[0], used_cpu()
    try:
        return (yield)
    finally:
        SPENT["CPU s"][RUNNING[0]] += used_cpu() - before


def pytest_sessionfinish(session):
    gc.freeze()  # what is left goes with the process; pytest's last look through it all takes each worker five seconds
    environment.KEPT.mkdir(parents=True, exist_ok=True)  # for the next run
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput |= {"peak_memory": peak_memory(), "spent": {k: dict(v) for k, v in SPENT.items()}}


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error):
    output = getattr(node, "workeroutput", {})
    PEAKS[node.gateway.id] = output.get("peak_memory", float("nan"))
    for quantity, files in output.get("spent", {}).items():
        SPENT[quantity].update(files)


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter):
    peaks = PEAKS or {"main": peak_memory()}
    shown = ", ".join(f"{name} {peak:.1f} GB" for name, peak in sorted(peaks.items()))
    terminalreporter.write_line(f"peak memory: {shown}")
    seconds, programs = SPENT["CPU s"], SPENT["programs"]
    terminalreporter.write_line(f"{sum(seconds.values()):.0f} CPU s, {sum(programs.values())} programs; most of them:")
    for file, spent in seconds.most_common(15):
        terminalreporter.write_line(f"{spent:7.1f} CPU s {programs[file]:5} programs  {file}")
