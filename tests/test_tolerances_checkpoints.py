"""What is kept of a study's chunks: moments and order statistics that merge, checkpoints and damage.

Oracle: the uninterrupted run, to the last bit.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scale_study import LIMITS, STACK, bits, response, run, smooth

from rvjax.population.population import Population
from rvjax.population.sample_statistics import CentralMoments, Pairwise
from rvjax.tolerances import Outcome, Tolerance, monte_carlo
from rvjax.tolerances.batch import checkpoint, statistics
from rvjax.tolerances.batch.checkpoint import describe, response_hash
from rvjax.tolerances.batch.quantiles import Order


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
    for k in (3, 0, 2, 5, 1, 4):  # bins come from the first values in the order of the chunks
        parts[k % 2].add(values[k], streams, number=k)
        if k == 2:
            assert parts[0].waiting == 4000 and not parts[0].settled  # chunk 1 is missing
    for block in values:
        whole.add(block, streams)
    both = Order(2)
    for part in parts[::-1]:
        both.merge(part.state())
    assert both.settled
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


def interrupted(after, *arguments, **options):
    """A study that ends without warning when `after` chunks are counted."""
    left, add = [after], statistics.Accumulator.add

    def limited(*chunk, **own):
        left[0] -= 1
        if left[0] < 0:
            raise Stop
        add(*chunk, **own)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statistics.Accumulator, "add", limited)
        run(*arguments, **options)


@pytest.mark.parametrize(
    "options", [{}, {"method": "sobol"}, {"keep": True}, {"samples": 3500}], ids=["random", "sobol", "kept", "few"]
)
def test_a_resumed_study_ends_with_identical_bits(tmp_path, options):
    expected = run(**options)
    for _ in range(3):
        with pytest.raises(Stop):
            interrupted(1, checkpoint=tmp_path / "c", checkpoint_every=0, **options)
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


def called_back(function):
    """A response that leaves its arithmetic to a function of NumPy."""

    def response(e):
        return jax.pure_callback(function, jax.ShapeDtypeStruct((), e["a"].dtype), e["a"], vmap_method="expand_dims")

    return response


def test_a_response_that_calls_python_takes_no_checkpoint(tmp_path):
    """The text of a program says nothing of such a function; one that only prints changes no value."""
    path, options = tmp_path / "c", dict(samples=100, seed=3)  # a function that prints is compiled for each unit
    double = called_back(lambda x: 2 * np.asarray(x))
    inside = lambda e: jax.lax.cond(e["a"] > 0, double, lambda e: e["a"], e)  # noqa: E731
    for each in (double, inside, lambda e: jax.jit(inside)(e)):
        with pytest.raises(
            ValueError, match=r"/c': the response calls a Python function .*; run without a checkpoint$"
        ):
            monte_carlo(each, STACK, checkpoint=path, **options)
        assert not path.exists()
    assert monte_carlo(double, STACK, **options).samples == 100

    def noted(e):
        jax.debug.callback(lambda x: None, e["a"])
        return e["a"]

    assert monte_carlo(noted, STACK, checkpoint=path, **options).samples == 100 and path.exists()


@pytest.mark.parametrize("damage", ["cut", "empty", "text", "bit"])
def test_a_damaged_checkpoint_is_named(tmp_path, damage):
    path = tmp_path / "c"
    run(3000, checkpoint=path)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 3] ^= 1  # of a count
    path.write_bytes({"cut": bytes(raw[:-300]), "empty": b"", "text": b"hello", "bit": bytes(raw)}[damage])
    with pytest.raises(ValueError, match=r"checkpoint = .*/c': damaged, or no checkpoint .* delete it to start again"):
        run(3000, checkpoint=path)


def test_a_full_disk_is_a_warning_and_loses_nothing(tmp_path, monkeypatch):
    expected, write = bits(run()), checkpoint.write_atomically
    calls = []

    def full(path, content):
        calls.append(path)
        if 3 <= len(calls) <= 5:
            raise OSError(28, "No space left on device")
        write(path, content)

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    with pytest.warns(RuntimeWarning, match=r"cannot be written \(.*No space left.*\); the study continues"):
        found = run(checkpoint=tmp_path / "c", checkpoint_every=0)
    assert bits(found) == expected
    assert bits(run(checkpoint=tmp_path / "c")) == expected  # the disk had room again: the file is complete
    for path in (tmp_path / "absent" / "c", tmp_path):
        with pytest.raises(OSError, match=path.name):  # before anything is computed
            run(checkpoint=path)
