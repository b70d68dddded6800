"""Monte Carlo at full scale: Sobol points, checkpoints, devices, processes.

Oracles: the uninterrupted run on one device in one process, to the last bit where the chunk is the same and to
round-off (1e-12 relative, counts equal) where it is not; closed forms and SciPy for the Sobol points. The share
of seeds whose interval holds the true value may miss 95 % by three standard errors of that share.
"""

import dataclasses
import json
import math
import multiprocessing
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special
from scipy.stats import qmc

from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance, monte_carlo, sample
from rvjax.tolerances.population.population import Population
from rvjax.tolerances.population.sobol import SCRAMBLES, SobolPoints
from rvjax.tolerances.propagation import checkpoint, tally
from rvjax.tolerances.propagation.checkpoint import describe, response_hash
from rvjax.tolerances.propagation.moments import CentralMoments, Pairwise
from rvjax.tolerances.propagation.order import Order

STACK = {name: Tolerance.symmetric(size) for name, size in dict(a=3.0, b=2.0, c=1.0).items()}
LIMITS = {"y": Requirement(upper=3.0), "z": Requirement(lower=-2.0, upper=2.0)}


def response(e):
    """Smooth, kinked, and without a value now and then for two reasons."""
    y = e["a"] + 0.3 * e["b"] ** 2
    status = jnp.where(e["c"] > 0.9, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
    return Outcome({"y": jnp.where(e["b"] < -1.9, jnp.nan, y), "z": jnp.abs(e["b"]) - e["c"]}, status)


def smooth(e):
    return e["a"] + 0.3 * e["b"] ** 2 - 0.1 * e["a"] * e["c"]


def first(e):
    return e["a"]


def run(samples=9000, *, respond=response, **options):
    defaults = dict(seed=3, chunk=1000, requirements=LIMITS if respond is response else None)
    return monte_carlo(respond, STACK, samples=samples, **(defaults | options))


def bits(statistics):
    """Every figure as text that changes with its last bit; what was asked is compared apart."""
    kept = statistics.values and {name: v.tobytes() for name, v in statistics.values.items()}
    return repr(dataclasses.replace(statistics, values=kept, study={}))


def same_to_roundoff(one, two):
    assert (one.samples, one.failures, one.examples) == (two.samples, two.failures, two.examples)
    assert one.joint_yield == two.joint_yield and one.yield_ == two.yield_
    for name in one.mean:
        for figure in ("mean", "sd"):
            for end in ("value", "error"):
                a, b = (getattr(getattr(s, figure)[name], end) for s in (one, two))
                assert a == pytest.approx(b, rel=1e-12, abs=1e-14)
        for p in one.quantiles:
            assert one.quantiles[p][name].value == pytest.approx(two.quantiles[p][name].value, rel=1e-9)


# Sobol points


def test_sobol_units_are_the_points_of_sixteen_scrambles():
    points = SobolPoints(3, 7)
    whole = points.z(0, 100)
    for scramble in (0, 5, 15):
        rng = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(scramble,)))
        expected = qmc.Sobol(3, scramble=True, bits=32, rng=rng).random(8)
        found = whole[:, scramble::SCRAMBLES][:, :6].T
        np.testing.assert_allclose(special.ndtr(found), expected[:6] + 2.0**-33, rtol=1e-12)
    for start, count in ((37, 50), (0, 1), (99, 1), (16, 16)):  # forwards, backwards, ragged
        np.testing.assert_array_equal(points.z(start, count), whole[:, start : start + count])
    assert np.isfinite(SobolPoints(40, 0).z(10**7, 64)).all()
    assert SobolPoints(0, 0).z(5, 3).shape == (0, 3)


def test_a_sobol_unit_is_the_same_alone_and_in_any_chunk():
    whole = run(5000, method="sobol", keep=True, chunk=65536)
    parts = run(5000, method="sobol", keep=True, chunk=999)
    for name in ("y", "z"):
        np.testing.assert_allclose(parts.values[name], whole.values[name], rtol=1e-12, atol=1e-15)
    compared = 0
    for index in (0, 17, 998, 999, 4999):
        alone = response(sample(STACK, index, seed=3, method="sobol"))
        if alone.status == Status.CONVERGED and jnp.isfinite(alone.value["y"]):
            np.testing.assert_allclose(whole.values["z"][index], alone.value["z"], rtol=1e-12)
            compared += 1
    assert compared > 2
    with pytest.raises(ValueError, match="index: must be a number for method 'sobol'"):
        jax.vmap(lambda i: sample(STACK, i, seed=3, method="sobol")["a"])(jnp.arange(3))
    same_to_roundoff(run(9000, method="sobol"), run(9000, method="sobol", chunk=1234))


@pytest.fixture(scope="module")
def over_seeds():
    """Figures of 60 studies of 4096 units by each method, and the true mean."""
    seeds = range(60)
    runs = {m: [run(4096, respond=smooth, seed=s, method=m, chunk=4096) for s in seeds] for m in ("random", "sobol")}
    return runs, 0.3 * (2 / 3) ** 2


def test_sobol_points_bring_the_mean_nearer(over_seeds):
    runs, mean = over_seeds
    rms = {m: math.sqrt(np.mean([(s.mean.value - mean) ** 2 for s in found])) for m, found in runs.items()}
    assert rms["random"] > 5 * rms["sobol"]
    assert {s.standard_errors for s in runs["sobol"]} == {"16 independent scrambles"}
    assert runs["random"][0].standard_errors == "independent units"


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_stated_errors_are_honest(over_seeds, method):
    runs, mean = over_seeds
    found = runs[method]
    truth = {"mean": mean, "sd": None, "q": None}
    truth["sd"] = math.sqrt(1 + 2 * 0.09 * (2 / 3) ** 4 + 0.01 / 9)  # of a + 0.3 b^2 - 0.1 a c, sd 1, 2/3, 1/3
    truth["q"] = np.mean([s.quantiles[0.5].value for m in runs.values() for s in m])
    figures = {"mean": [s.mean for s in found], "sd": [s.sd for s in found], "q": [s.quantiles[0.5] for s in found]}
    for name, estimates in figures.items():
        hits = np.mean([e.lower <= truth[name] <= e.upper for e in estimates])
        assert hits >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / 60), name
        stated = math.sqrt(np.mean([e.error**2 for e in estimates]))
        seen = math.sqrt(np.mean([(e.value - truth[name]) ** 2 for e in estimates]))
        assert 0.7 < stated / seen < 1.5, name


def test_shares_of_sobol_units_have_honest_intervals():
    true = 0.5 * special.erfc(1.0 / math.sqrt(2))  # of the share of a > 1
    found = [
        run(4096, respond=first, seed=s, chunk=4096, method="sobol", requirements=Requirement(upper=1.0))
        for s in range(30)
    ]
    hits = np.mean([f.yield_.lower <= 1 - true <= f.yield_.upper for f in found])
    assert hits >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / 30)
    assert np.mean([f.yield_.error for f in found]) < 0.5 * math.sqrt(true * (1 - true) / 4096)
    none = run(2000, method="sobol", requirements={"y": Requirement(upper=1e3), "z": Requirement(upper=1e3)})
    assert none.failed > 0 and none.yield_["y"].lower < 1 - none.failed / 2000 < none.yield_["y"].upper


@pytest.mark.parametrize("samples", [1, 5, 16, 17])
def test_fewer_sobol_units_than_scrambles(samples):
    found = run(samples, respond=smooth, method="sobol", requirements=Requirement(upper=0.0))
    assert found.samples == samples and found.yield_.lower <= found.yield_.value <= found.yield_.upper
    assert math.isnan(found.mean.error) == (samples == 1)


# What is kept of the chunks


def test_moments_of_chunks_have_the_same_bits_in_any_order():
    blocks = [CentralMoments.of(v) for v in np.split(np.random.default_rng(0).normal(size=2300), range(100, 2300, 100))]
    expected = None
    for order in (range(23), reversed(range(23)), np.random.default_rng(1).permutation(23)):
        trees = [Pairwise() for _ in range(3)]
        for place in order:
            trees[place % 3].add(int(place), blocks[place])
        for other in trees[1:]:
            trees[0].merge(other.state())
        expected = expected or trees[0].total()
        assert trees[0].total() == expected
    assert len(trees[0].state()) == (23).bit_count()


def test_order_statistics_merge_like_one_run():
    values = np.random.default_rng(0).normal(size=(6, 2000))
    streams = np.arange(2000) % 2
    whole, parts = Order(2), [Order(2), Order(2)]
    for k, block in enumerate(values):
        whole.add(block, streams)
        for p in (0, 1):
            parts[p].add(block, streams, own=k % 2 == p)
    both = Order(2)
    for part in parts:
        both.merge(part.state())
    for rank in (1, 17.5, 6000, 12000):
        assert both.at(rank) == whole.at(rank)
    for limit in (-9.0, -3.2, 0.4, 9.0):
        hits, totals = both.below(limit)
        np.testing.assert_array_equal(totals, [6000, 6000])
        exact = [(values[:, s::2] <= limit).sum() for s in (0, 1)]
        np.testing.assert_allclose(hits, exact, atol=3)  # within a bin


# Checkpoints


class Stop(BaseException):
    """Stands for whatever ends a process."""


@pytest.fixture
def always(monkeypatch):
    """A file after every chunk, not only once a second."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)


def interrupted(after, *arguments, **options):
    """A study that ends without warning when `after` chunks are counted."""
    left, add = [after], tally.Tally.add

    def limited(*chunk, **own):
        left[0] -= 1
        if left[0] < 0:
            raise Stop
        add(*chunk, **own)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tally.Tally, "add", limited)
        run(*arguments, **options)


@pytest.mark.parametrize(
    "options", [{}, {"method": "sobol"}, {"keep": True}, {"samples": 3500}], ids=["random", "sobol", "kept", "few"]
)
def test_a_resumed_study_ends_with_identical_bits(tmp_path, always, options):
    expected = run(**options)
    for _ in range(3):
        with pytest.raises(Stop):
            interrupted(1, checkpoint=tmp_path / "c", **options)
    assert bits(run(checkpoint=tmp_path / "c", **options)) == bits(expected)
    assert bits(run(checkpoint=tmp_path / "c", **options)) == bits(expected)  # finished already
    assert [file.name for file in tmp_path.iterdir()] == ["c"]


def test_more_units_continue_a_finished_study(tmp_path):
    path = tmp_path / "c"
    run(4500, checkpoint=path)
    expected = run(9200)
    with pytest.raises(Stop):
        interrupted(5, 9200, checkpoint=path)  # chunks 4 (whole now) .. 8
    assert bits(run(9200, checkpoint=path)) == bits(expected)
    interrupted(1, 9200, checkpoint=path)  # the last one, which is short, is all there is to do
    with pytest.raises(ValueError, match=r"samples = 4000: checkpoint = .* holds 9000 already"):
        run(4000, checkpoint=path)


def test_another_study_is_refused_by_name(tmp_path, monkeypatch):
    path = tmp_path / "c"
    run(2000, checkpoint=path)
    other = dict(STACK, b=Tolerance.symmetric(2.5))
    for options, words in [
        (dict(seed=4), "seed is 3 in the file and 4 here"),
        (dict(method="sobol"), "method is random in the file and sobol here"),
        (dict(chunk=500), "chunk is 1000 in the file and 500 here"),
        (dict(requirements={"y": LIMITS["y"]}), "requirements.z is .* in the file and absent here"),
        (dict(correlation={("a", "b"): 0.5}), "correlation is absent in the file"),
    ]:
        with pytest.raises(ValueError, match=f"belongs to another study: .*{words}"):
            run(2000, checkpoint=path, **options)
    with pytest.raises(ValueError, match=r"tolerances.b is normal -2.0 .. 2.0, cp 1.0 in the file and normal -2.5"):
        monte_carlo(response, other, samples=2000, seed=3, chunk=1000, requirements=LIMITS, checkpoint=path)
    changed = lambda e: Outcome({**response(e).value, "z": e["b"]}, response(e).status)  # noqa: E731
    with pytest.raises(ValueError, match=r"response is \w+ in the file and \w+ here; name another file"):
        monte_carlo(changed, STACK, samples=2000, seed=3, chunk=1000, requirements=LIMITS, checkpoint=path)
    monkeypatch.setattr("rvjax.__version__", "9.9")
    with pytest.raises(ValueError, match=r"rvjax is \S+ in the file and 9.9 here"):
        run(2000, checkpoint=path)


def test_the_fingerprint_of_a_study_sees_everything_that_shapes_its_errors():
    """Every option of every law, the correlation, each alone and all apart from each other."""
    plain, magnitude = dict(lower=-1.0, upper=1.5), dict(lower=0.0, upper=1.5, distribution="rayleigh")
    beta, lognormal = dict(distribution="beta", beta=(2.0, 3.0)), dict(distribution="lognormal", log_sd=0.3)
    measured = dict(distribution="empirical", values=[-0.5, 0.1, 0.4])
    turned = dict(lower=0.0, distribution="von_mises", concentration=2.0, direction=0.1, shape=(2,))
    given = [
        *(plain | change for change in ({}, dict(lower=-1.1), dict(upper=1.6), dict(cp=1.1), dict(shift=0.1))),
        *(plain | change for change in (dict(distribution="uniform"), dict(shape=(4,)), dict(shape=(4,), batch=0.2))),
        *(magnitude | change for change in ({}, dict(shape=(2,), vector=False), dict(shape=(2,), vector=True))),
        *(plain | change for change in (beta, beta | dict(beta=(2.0, 3.1)), lognormal, lognormal | dict(log_sd=0.31))),
        *(plain | change for change in (measured, measured | dict(values=[-0.5, 0.1, np.nextafter(0.4, 1)]))),
        *(plain | turned | change for change in ({}, dict(concentration=2.1), dict(direction=0.2))),
    ]
    told = [describe(Population.of({"a": Tolerance(**options)}), {}) for options in given]
    told += [describe(Population.of({"a": 0.1}), {}), describe(Population.of({"a": 0.2}), {})]
    pair = {"a": Tolerance.symmetric(1.0), "b": Tolerance.symmetric(1.0)}
    told += [describe(Population.of(pair, {("a", "b"): rho} if rho else None), {}) for rho in (0.0, 0.5, 0.5 + 1e-15)]
    assert len({tuple(sorted(text.items())) for text in told}) == len(told)


def test_the_hash_of_a_response_sees_every_constant():
    table = np.linspace(0.0, 1.0, 20_000)
    changed = table.copy()
    changed[12_345] += 1e-12
    of = lambda constants: response_hash(lambda e: jnp.sum(e["a"] * constants), Population.of(STACK))  # noqa: E731
    assert of(table) == of(table.copy()) != of(changed)
    wider = {name: t.with_half_width(7.0) for name, t in STACK.items()}
    assert response_hash(smooth, Population.of(STACK)) == response_hash(smooth, Population.of(wider))


@pytest.mark.parametrize("damage", ["cut", "empty", "text", "bit"])
def test_a_damaged_checkpoint_is_named(tmp_path, damage):
    path = tmp_path / "c"
    run(3000, checkpoint=path)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes({"cut": bytes(raw[:-300]), "empty": b"", "text": b"hello", "bit": bytes(raw)}[damage])
    with pytest.raises(ValueError, match=r"checkpoint = .*/c': damaged, or no checkpoint .* delete it to begin anew"):
        run(3000, checkpoint=path)


def test_a_full_disk_is_a_warning_and_loses_nothing(tmp_path, always, monkeypatch):
    expected, write = bits(run()), checkpoint.write_atomically
    calls = []

    def full(path, content):
        calls.append(path)
        if 3 <= len(calls) <= 5:
            raise OSError(28, "No space left on device")
        write(path, content)

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    with pytest.warns(RuntimeWarning, match=r"cannot be written \(.*No space left.*\); the study goes on without"):
        found = run(checkpoint=tmp_path / "c")
    assert bits(found) == expected
    assert bits(run(checkpoint=tmp_path / "c")) == expected  # the disk had room again: the file is complete
    for path in (tmp_path / "absent" / "c", tmp_path):
        with pytest.raises(OSError, match=path.name):  # before anything is computed
            run(checkpoint=path)


def slow_study(path, samples):
    """A study in a process of its own that takes at least 4 ms a chunk."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", f"{path}.programs")  # compile once for all processes
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    checkpoint.EVERY = checkpoint._SHARE = 0
    add = tally.Tally.add

    def slow(*arguments, **options):
        Path(f"{path}.begun").touch()
        time.sleep(0.004)
        add(*arguments, **options)

    tally.Tally.add = slow
    run(samples, checkpoint=path)


def test_killed_at_ten_random_moments_and_resumed(tmp_path):
    path, samples = tmp_path / "c", 300_500
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["jax", "rvjax.tolerances"])
    rng, reached = np.random.default_rng(0), []
    for _ in range(10):
        process = context.Process(target=slow_study, args=(path, samples))
        process.start()
        begun = Path(f"{path}.begun")
        while not begun.exists():
            assert process.is_alive()
            time.sleep(0.002)
        time.sleep(rng.uniform(0.0, 0.1))  # ten of them: at most 1 s of at least 1.2 s
        process.kill()  # SIGKILL
        process.join()
        assert process.exitcode == -9
        begun.unlink()
        with np.load(path) as file:  # whole at any moment
            reached.append(json.loads(file["about"].tobytes())["next"])
    assert reached == sorted(reached) and 0 < reached[-1] < 300
    assert len(set(reached)) > 3
    assert bits(run(samples, checkpoint=path)) == bits(run(samples))


# Devices and processes

CHILD = """
import jax
jax.config.update("jax_enable_x64", True)
if {address!r}:
    jax.distributed.initialize({address!r}, num_processes=2, process_id={process})
import test_tolerances_scale as here
found = {{m: here.run(20_500, method=m, **{options}) for m in ("random", "sobol")}}
found["again"] = here.run(20_500, **{options})
found["few"] = here.run(700, **{options})
found["long"] = here.run(20_500, **({options} | dict(chunk=4096)))
from rvjax.tolerances import save
save({{"found": found, "devices": len(jax.local_devices()), "processes": jax.process_count()}}, {path!r})
"""


def child(path, *, devices=1, address="", process=0, options=None):
    code = CHILD.format(address=address, process=process, options=options or {}, path=str(path))
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count={devices}"  # the same arithmetic
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(Path(__file__).parent)}
    return subprocess.Popen([sys.executable, "-c", code], env=environment, cwd=Path(__file__).parent.parent)


@pytest.fixture(scope="module")
def alone():
    found = {m: run(20_500, method=m) for m in ("random", "sobol")}
    return found | {"few": run(700), "long": run(20_500, chunk=4096)}


def test_eight_devices_give_what_one_gives(tmp_path, alone):
    from rvjax.tolerances import load

    assert child(tmp_path / "eight.json", devices=8).wait(120) == 0
    result = load(tmp_path / "eight.json")
    assert result["devices"] == 8
    for name, expected in alone.items():
        same_to_roundoff(result["found"][name], expected)
    assert bits(result["found"]["again"]) == bits(result["found"]["random"])


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def test_two_processes_give_the_bits_of_one(tmp_path, alone):
    from rvjax.tolerances import load

    address = f"127.0.0.1:{free_port()}"
    both = [child(tmp_path / f"{p}.json", address=address, process=p) for p in (0, 1)]
    assert [process.wait(120) for process in both] == [0, 0]
    for p in (0, 1):
        result = load(tmp_path / f"{p}.json")
        assert result["processes"] == 2
        for name, expected in alone.items():
            assert bits(result["found"][name]) == bits(expected), name
