"""Rare failures of a dear response, searched on a cheap one.

Oracles: closed forms. An estimate is unbiased whatever the cheap response says: the mean over seeds lies within four of
its own standard errors, and no interval of one seed misses by more than five. What a cheap response does not know must
be noticed. Coverage over 200 seeds: `benchmarks.coverage --only like`.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from oracles.programs import programs
from rvjax.response.response import respond
from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance, failure_probability, linearised
from rvjax.tolerances.failure import failure

SIX = {"v": Tolerance.symmetric(3.0, shape=(6,))}  # standard normal
NEED = Requirement(upper=4.2)
FLAT, BOTH = stats.norm.sf(4.2), 1 - stats.norm.cdf(4.2) ** 2


def flat(e):
    return (e["v"][0] + e["v"][1]) / math.sqrt(2)


def rough(e):
    """Four fifths of the value, and noise of its own."""
    return 0.8 * flat(e) + 0.1 * e["v"][5]


def corners(e):
    """Fails in a second way, of which `rough` knows nothing."""
    return jnp.maximum(flat(e), e["v"][3])


def asked(response, like, seed=0, samples=1000, need=NEED):
    return failure_probability(response, SIX, need, samples=samples, seed=seed, like=like)


def test_a_cheap_response_spares_most_units_and_biases_nothing():
    runs = [asked(flat, rough, seed) for seed in range(6)]
    ordinary = failure_probability(flat, SIX, NEED, samples=1000, seed=0)
    for run in runs:
        assert run.status == "OK" and run.points == 1 and run.effective_samples > 100
        assert abs(run.probability.value - FLAT) < 5 * run.probability.error < FLAT
        # The cheap slope is off by atan(1/8), and the last grid along the ray by 1/40.
        assert 4.2 <= run.reliability_index < 4.2 * 1.01 * 1.03
        assert run.evaluations < ordinary.evaluations / 2 < run.cheap_evaluations
    error = math.sqrt(sum(run.probability.error**2 for run in runs)) / len(runs)
    assert abs(np.mean([run.probability.value for run in runs]) - FLAT) < 4 * error
    assert ordinary.cheap_evaluations == 0


@pytest.mark.parametrize(
    ("like", "response", "exact"),
    [
        pytest.param(rough, corners, BOTH, id="a corner missed"),
        pytest.param(lambda e: e["v"][4], flat, FLAT, id="another way to fail"),
        pytest.param(lambda e: 0.0 * e["v"][0], flat, FLAT, id="never fails"),
        pytest.param(lambda e: 9.0 + e["v"][0], flat, FLAT, id="always fails"),
        pytest.param(lambda e: jnp.nan * e["v"][0], flat, FLAT, id="no value"),
    ],
)
def test_failures_missing_in_the_low_fidelity_response_are_noticed(like, response, exact):
    run = asked(response, like)
    assert "UNLIKE" in run.status
    assert abs(run.probability.value - exact) < 5 * run.probability.error < exact
    assert "NO_POINT" not in run.status and run.effective_samples > 100


def test_draws_about_wrong_points_are_unbiased_before_anybody_notices():
    """The share about the middle reaches every failure: weights are at most 20, and the mean is right. A limit of 2, so
    that those few draws hit it often enough to tell."""
    need, exact = Requirement(upper=2.0), 1 - stats.norm.cdf(2.0) ** 2
    shares, errors = [], []
    for seed in range(8):
        random = np.random.default_rng(seed)
        search, guide = (_search(of, need) for of in (corners, flat))
        guide.explore(random, np.zeros((6, 0)))
        assert search.follow(guide.mixture) == 1
        first, _, _ = search.draw(random, 2000)
        shares.append(first.value)
        errors.append(first.error)
        far = 9 * np.eye(6)[:, 3:4]
        assert search.mixture.weights(far)[0] <= 20 + 1e-9
    assert abs(np.mean(shares) - exact) < 4 * math.sqrt(np.mean(np.square(errors)) / len(errors))
    assert abs(np.mean(shares) - stats.norm.sf(2.0)) > 0.3 * stats.norm.sf(2.0)  # of the one corner alone


def _search(response, need):
    from rvjax.population.population import Population
    from rvjax.tolerances.failure.form import Units

    return failure._Search(Units(response, Population.of(SIX), ""), need)


def test_good_units_are_the_rare_ones():
    run = asked(flat, rough, need=Requirement(upper=-4.2))
    assert "UNLIKE" not in run.status and abs(1 - run.probability.value - FLAT) < 5 * run.probability.error


def test_names_and_units_without_a_value():
    """A value of the same name is used, or the only one; a unit without a value fails."""

    def two(e):
        return Outcome({"a": flat(e), "b": e["v"][2]}, jnp.where(e["v"][3] > 4.2, int(Status.SINGULAR), 0))

    found = asked(two, corners, need={"a": NEED})
    assert found.status["a"].startswith("SEVERAL") or found.status["a"] == "OK"
    assert abs(found.probability["a"].value - BOTH) < 5 * found.probability["a"].error
    with pytest.raises(ValueError, match=r"like: has no value 'a' as the response has; it has c, d"):
        asked(two, lambda e: {"c": flat(e), "d": flat(e)}, need={"a": NEED})


def test_another_seed_compiles_nothing():
    """One program of the dear response for its batch and one of the cheap one's; other numbers share it."""
    line = linearised(flat, SIX)
    first = asked(flat, line)
    before = programs(respond, flat), programs(respond, line)
    again, other = asked(flat, line), asked(flat, linearised(lambda e: 0.9 * flat(e), SIX), seed=5)
    assert again.probability == first.probability != other.probability
    assert (programs(respond, flat), programs(respond, line)) == before
