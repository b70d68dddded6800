"""Intervals hold what they say: small versions of `python -m benchmarks.coverage`.

An interval of 95 % holds the truth in 950 of 1000 runs, give or take 7 (binomial). Bounds lie 4 of these below, which
the intervals without the correction for skewness miss by as much again; above, an interval that held everything would
say nothing.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from rvjax.population.estimates import of_groups, student
from rvjax.population.sample_statistics import CentralMoments, Sampled
from rvjax.tolerances import Requirement, Tolerance, failure_probability

RUNS = 1000
MOST = 0.99


def least(runs):
    return 0.95 - 4 * math.sqrt(0.95 * 0.05 / runs)


def share(intervals, exact):
    return np.mean([item.lower <= exact <= item.upper for item in intervals])


@pytest.mark.parametrize(
    "law",
    [stats.norm(), stats.chi2(1), stats.lognorm(0.7), stats.uniform()],
    ids=["normal", "chi2", "lognormal", "even"],
)
def test_the_mean_of_sixteen_groups_of_any_law(law):
    groups = law.rvs((RUNS, 16), random_state=np.random.default_rng(0))
    found = [of_groups(each, each.mean(), 0.95) for each in groups]
    assert least(RUNS) <= share(found, law.mean()) <= MOST
    if law.stats("s") > 2:  # what Student's law alone would say
        off = np.abs(groups.mean(axis=1) - law.mean()) / (groups.std(axis=1, ddof=1) / 4)
        assert np.mean(off <= student(0.95, 16)) < least(RUNS)


@pytest.mark.parametrize("law", [stats.norm(), stats.expon(), stats.uniform()], ids=["normal", "exponential", "even"])
@pytest.mark.parametrize("streams", [1, 16])
def test_mean_and_sd_of_any_law(law, streams):
    """Independent units, in one stream or dealt out to 16."""
    runs = RUNS if streams == 1 else 300
    values = law.rvs((runs, 512), random_state=np.random.default_rng(1))
    seen = [
        Sampled([CentralMoments.of(part) for part in np.split(each, streams)], None, np.full(streams, 512), 0.95)
        for each in values
    ]
    assert least(runs) <= share([item.mean() for item in seen], law.mean()) <= MOST
    assert least(runs) <= share([item.sd() for item in seen], law.std()) <= MOST


def test_an_interval_moves_towards_the_long_tail():
    values = np.random.default_rng(2).exponential(size=200)
    up, down = (CentralMoments.of(v).mean_estimate(0.95) for v in (values, -values))
    assert up.upper - up.value > 1.02 * (up.value - up.lower)
    assert (down.lower, down.upper) == pytest.approx((-up.upper, -up.lower), rel=1e-12)
    even = CentralMoments.of(np.concatenate([values, -values])).mean_estimate(0.95)
    assert even.upper == pytest.approx(special.ndtri(0.975) * even.error, rel=1e-4)


def test_failures_of_eight_parts():
    """Twelve seeds: of 12 intervals of 95 %, fewer than 9 hold the truth in 2 of 1000 cases."""
    response, eight = lambda e: jnp.max(e["v"]), {"v": Tolerance.symmetric(3.0, shape=(8,))}
    exact = -math.expm1(8 * stats.norm.logcdf(4.0))
    need = Requirement(upper=4.0)
    runs = [failure_probability(response, eight, need, samples=1000, seed=seed) for seed in range(12)]
    assert sum(run.probability.lower <= exact <= run.probability.upper for run in runs) >= 9
    assert sum(run.second.lower <= exact <= run.second.upper for run in runs) >= 9
    # The two estimates have errors of their own: 20 %, 8 %.
    off = np.array([(run.second.value - exact) / exact for run in runs])
    assert abs(off.mean()) < 4 * 0.25 / math.sqrt(12)
    assert np.median([run.probability.error / exact for run in runs]) < 0.1
