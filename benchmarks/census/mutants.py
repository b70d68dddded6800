"""Do the tests notice mistakes? Semantic mutants, one at a time, against the tests that must fail.

    python -m benchmarks.census.mutants [--group loaded] [--only "place of the smallest"] [--processes 2]
    python -m benchmarks.census.mutants --journal rows.jsonl --keep benchmarks/census/mutants.json

Each mutant of `mutants.toml` is one change that a person could make by mistake: a sign, a factor, a missing term, a
bound. It goes into a copy of the tree. The tests named in its row run, up to the first failure. Before, the same tests
must pass on the unchanged tree. General tools (mutmut, cosmic-ray) change every operator and run every test. That takes
days, because programs compile for seconds; these mutants take an hour. They are not part of continuous integration,
but a job compares the table with the code.

Every run forks from a process that has imported JAX, SciPy and pytest but nothing of rvjax: 3 s of the processor less
for each row. A run that was interrupted goes on with the rows that its journal lacks.
"""

import argparse
import ast
import contextlib
import functools
import hashlib
import json
import multiprocessing
import os
import queue
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
TABLE = Path(__file__).with_name("mutants.toml")
LIMIT = 300  # s of the processor for the tests of one mutant; one that hangs is noticed, too
FIRST = ["tests.environment", "jax", "jax.export", "scipy.optimize", "scipy.stats", "matplotlib.pyplot", "pandas"]
FIRST += ["mpmath", "pytest", "hypothesis.strategies", "jaxtyping", "execnet", "jinja2"]
FRESH = multiprocessing.get_context("forkserver")
NO_TEST = "no test ran"  # what a row selects is empty, or skipped
COPIED = ("rvjax", "tests", "benchmarks", "docs", "notebooks", "pyproject.toml")


Parsed = tuple[ast.Module, dict[str, list[ast.AST]]]


@functools.lru_cache(1024)
def parsed(text: str) -> Parsed:
    """Syntax tree of a module, and its functions and classes by name."""
    tree, named = ast.parse(text), dict[str, list[ast.AST]]()
    for name, node in functions(tree):
        named.setdefault(name, []).append(node)
    return tree, named


def functions(node: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Functions and classes below a node with their full names."""
    for child in ast.iter_child_nodes(node):
        named = isinstance(child, ast.FunctionDef | ast.ClassDef)
        if named:
            yield f"{prefix}{child.name}", child
        yield from functions(child, f"{prefix}{child.name}." if named else prefix)


@dataclass(frozen=True)
class Mutant:
    """One change: in `function`, `expression` becomes `becomes`, and of `tests` (arguments of pytest) one must fail."""

    group: str
    breaks: str
    function: str
    expression: str
    becomes: str
    tests: str
    survives: str = ""  # why no test can notice, for one that is known to live

    @property
    def key(self) -> str:
        """Name of the row in a journal; a row that has changed is another one."""
        return hashlib.sha256(repr(astuple(self)[:-1]).encode()).hexdigest()[:16]

    def places(
        self, root: Path = ROOT, parse: Callable[[str], Parsed] = parsed
    ) -> list[tuple[Path, ast.Module, ast.AST]]:
        """Every place of the expression in the function: file, its syntax tree, and the node."""
        where, name = self.function.split(":")
        path = root / "rvjax" / where.replace(".", "/")
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]
        (wanted,), found = ast.parse(self.expression).body, []
        for file in files:
            text = file.read_text("utf-8")
            if name.split(".")[-1] not in text:
                continue  # parsing every file of a package for every row took ten seconds
            tree, named = parse(text)
            for function in named.get(name, []) if name else [tree]:
                found += [(file, tree, node) for node in matches(function, wanted)]
        return found


def matches(node: ast.AST, wanted: ast.stmt) -> Iterator[ast.AST]:
    """The outermost expressions and statements below a node that read as wanted."""
    inner = wanted.value if isinstance(wanted, ast.Expr) else wanted
    for child in ast.iter_child_nodes(node):
        if alike(child, wanted) or alike(child, inner):
            yield child
        else:
            yield from matches(child, wanted)


def alike(one: object, other: object) -> bool:
    """Return True if two syntax trees have the same text. Most differ at the root, which is fast."""
    if isinstance(one, ast.AST):
        fields = (name for name in one._fields if name not in ("ctx", "kind", "type_comment"))
        return type(one) is type(other) and all(alike(getattr(one, f, None), getattr(other, f, None)) for f in fields)
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(alike, one, other))
    return type(one) is type(other) and one == other


class Ran:
    """Plugin of pytest that counts the tests that ran: a skipped test notices nothing."""

    count = 0

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Count the calls of tests."""
        self.count += report.when == "call" and not report.skipped


class Replacement(ast.NodeTransformer):
    """Puts one node in the place of another."""

    def __init__(self, old: ast.AST, text: str) -> None:
        """The node, and the text of what takes its place."""
        (statement,) = ast.parse(text).body
        self.old, self.new = old, statement.value if isinstance(old, ast.expr) else statement

    def visit(self, node: ast.AST) -> ast.AST:
        """As the base class has it."""
        return self.new if node is self.old else self.generic_visit(node)


def table() -> list[Mutant]:
    """All mutants, in the order of the file."""
    return [Mutant(**row) for row in tomllib.loads(TABLE.read_text("utf-8"))["mutant"]]


def copied(folder: Path) -> None:
    """The tree as the tests need it, without what they made."""
    left = shutil.ignore_patterns("__pycache__", ".pytest_cache", "_build")
    for name in (*COPIED, *(path.name for path in ROOT.glob("*.md"))):
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy)(
            source, folder / name, **({"ignore": left} if source.is_dir() else {})
        )


def session(folder: Path, tests: str, said: Path) -> None:
    """Run pytest in this process, in a copy of the tree, and end the process with pytest's code."""
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 1))
    with said.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    for name in [n for n in sys.modules if n.split(".")[0] in ("rvjax", "tests", "benchmarks")]:
        del sys.modules[name]
    os.chdir(folder)
    sys.path[:] = [str(folder), *(place for place in sys.path if place and Path(place) not in (ROOT, folder))]
    os.environ["PYTHONPATH"] = str(folder)
    # A third of a short run; next to the sources, where `_write` finds it.
    sys.dont_write_bytecode, sys.pycache_prefix = False, None
    os.environ.pop("PYTHONPYCACHEPREFIX", None)
    import pytest

    ran, rewritten = Ran(), "ignore::pytest.PytestAssertRewriteWarning"  # of hypothesis, which is imported already
    code = pytest.main(["-n", "0", "-p", "no:cacheprovider", "-W", rewritten, "-x", *shlex.split(tests)], [ran])
    sys.stdout.flush()
    os._exit(code if code or ran.count else pytest.ExitCode.NO_TESTS_COLLECTED)


def run(folder: Path, tests: str) -> str:
    """ "passed", "failed", "hangs", `NO_TEST`, or what kept pytest from running them."""
    said = folder / "said.txt"
    process = FRESH.Process(target=session, args=(folder, tests, said))
    process.start()
    process.join(10 * LIMIT)  # one that sleeps
    if process.exitcode is None:
        process.kill()
        process.join()
    if process.exitcode in (-signal.SIGKILL, -signal.SIGXCPU):
        return "hangs"
    if process.exitcode in (0, 1):
        return ("passed", "failed")[process.exitcode]
    if process.exitcode == 5:
        return NO_TEST
    return f"pytest ended with {process.exitcode}: {said.read_text('utf-8', 'replace').strip()[-300:]}"


def verdict(folder: Path, mutant: Mutant) -> str:
    """ "killed", "survived", or what is wrong with the row of the table."""
    places = mutant.places(folder, parsed.__wrapped__)  # a tree of its own, which it changes
    if len(places) != 1:
        return f"{mutant.function} has the expression {len(places)} times"
    path, tree, node = places[0]
    whole = path.read_text("utf-8")
    changed = Replacement(node, mutant.becomes).visit(tree)
    try:
        _write(path, ast.unparse(ast.fix_missing_locations(changed)))
        found = run(folder, mutant.tests)
    finally:
        _write(path, whole)
    return {"failed": "killed", "hangs": "killed", "passed": "survived"}.get(found, found)


def together(mutants: Sequence[Mutant]) -> str:
    """Arguments of pytest for all tests of some rows, which name one file."""
    file, *_ = shlex.split(mutants[0].tests)
    chosen = {tuple(shlex.split(mutant.tests)[1:]) for mutant in mutants}
    if () in chosen:
        return file
    return shlex.join([file, "-k", " or ".join(f"({expression})" for _, expression in sorted(chosen))])


def _write(path: Path, text: str) -> None:
    """Write a module, and forget what Python compiled of it: Python compares seconds and sizes only."""
    path.write_text(text, "utf-8")
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()


def outcomes(mutants: Sequence[Mutant], processes: int, trust: bool) -> Iterator[tuple[Mutant, str, float]]:
    """Each mutant with its verdict and seconds, as they end; every process has a copy of the tree."""
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "jax"))
    sys.path.insert(0, str(ROOT))  # the first process finds `tests.environment` there
    FRESH.set_forkserver_preload(FIRST)
    folders, done = queue.SimpleQueue[Path](), queue.SimpleQueue[tuple[Mutant, str, float]]()
    by_file: dict[str, list[Mutant]] = {}
    for mutant in mutants:
        by_file.setdefault(shlex.split(mutant.tests)[0], []).append(mutant)

    def look(file: str) -> None:
        folder = folders.get()
        try:
            before = "passed" if trust else run(folder, together(by_file[file]))
            for mutant in by_file[file]:
                begun = time.perf_counter()
                found = verdict(folder, mutant) if before == "passed" else f"without the mutant: {before}"
                done.put((mutant, found, time.perf_counter() - begun))
        finally:
            folders.put(folder)

    with contextlib.ExitStack() as stack:
        for _ in range(processes):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rvjax-mutants-")))
            copied(folder)
            folders.put(folder)
        pool = stack.enter_context(ThreadPoolExecutor(processes))
        jobs = [pool.submit(look, file) for file in by_file]
        for _ in mutants:
            while done.empty():
                for job in jobs:
                    if job.done():
                        job.result()  # what it raised
                time.sleep(0.05)
            yield done.get()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.census.mutants", description=__doc__.split("\n")[0])
    parser.add_argument("--group", help="this group alone")
    parser.add_argument("--only", help="mutants whose `breaks` holds this text")
    parser.add_argument("--keep", help="JSON file for the score")
    parser.add_argument("--journal", help="file with one line for each row; rows in it are not run again")
    parser.add_argument("--processes", type=int, default=1, help="rows at once (default 1)")
    parser.add_argument("--trust", action="store_true", help="the tests are known to pass on the tree as it is")
    options = parser.parse_args(arguments)
    mutants = [m for m in table() if options.group in (None, m.group) and (options.only or "") in m.breaks]
    journal = Path(options.journal or os.devnull)
    lines = journal.read_text("utf-8").splitlines() if journal.exists() else []
    found = {row["key"]: row for row in map(json.loads, lines)}
    rest = [mutant for mutant in mutants if mutant.key not in found]
    for mutant, outcome, seconds in outcomes(rest, options.processes, options.trust):
        print(f"{mutant.group:12} {outcome:9.200} {seconds:4.0f} s  {mutant.breaks}", flush=True)
        if outcome in ("killed", "survived"):
            row = {"key": mutant.key, "breaks": mutant.breaks, "outcome": outcome, "seconds": round(seconds, 1)}
            found[mutant.key] = row
            with journal.open("a", encoding="utf-8") as file:
                print(json.dumps(row), file=file)
    score = dict[str, list[int]]()
    for mutant in mutants:
        if mutant.key in found:
            count = score.setdefault(mutant.group, [0, 0])
            count[0] += found[mutant.key]["outcome"] == "killed"
            count[1] += 1
    minutes = sum(found[mutant.key]["seconds"] for mutant in mutants if mutant.key in found) / 60
    for group, (killed, count) in score.items():
        print(f"{group:12} {killed:3} of {count:3}")
    killed, count = (sum(column) for column in zip(*score.values())) if score else (0, 0)
    print(f"all          {killed:3} of {count:3}, {minutes:.0f} min")
    survivors = [m for m in mutants if m.key in found and found[m.key]["outcome"] == "survived"]
    for mutant in survivors:
        print(f"survived: {mutant.group}: {mutant.breaks}: {mutant.survives or 'no reason known'}")
    if options.keep:
        kept = {"groups": score, "survivors": [m.breaks for m in survivors], "minutes": round(minutes)}
        Path(options.keep).write_text(json.dumps(kept, indent=1) + "\n", "utf-8")
    return int(count < len(mutants) or any(not m.survives for m in survivors))


if __name__ == "__main__":
    sys.exit(main())
