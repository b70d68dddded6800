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
from rvjax.tolerances import Estimate, Requirement, Tolerance, failure, failure_probability
from rvjax.tolerances.failure.subset import Levels, Sequential, Spreads, sequential

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


LAWS = {"normal": stats.norm(), "exponential": stats.expon(), "even": stats.uniform()}
DEALT = [pytest.param(16, name, marks=[pytest.mark.long] * (name != "exponential")) for name in LAWS]


@pytest.mark.parametrize(("streams", "name"), [*((1, name) for name in LAWS), *DEALT])
def test_mean_and_sd_of_any_law(streams, name):
    """Independent units, in one stream or dealt out to 16."""
    law = LAWS[name]
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


@pytest.mark.long  # honest errors, and parts that fail each in its own way: test_tolerances_failure.py
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


def norm(e):
    return jnp.sqrt(jnp.sum(e["v"] ** 2))


def within(numbers, radius):
    return stats.chi2.cdf(radius**2, numbers)


def beyond(numbers, radius):
    return stats.chi2.sf(radius**2, numbers)


def off(e):
    return jnp.sqrt(jnp.sum((e["v"] - jnp.array([2.0, 0.0, 0.0])) ** 2))


# Where few units fail, or few pass: response of standard normal numbers, how many, limits, share of the rare units.
PLACES = {
    "around the nominal unit": (norm, 5, Requirement(lower=0.2), within(5, 0.2)),
    "around it, of 1e-8": (norm, 2, Requirement(lower=1.414e-4), within(2, 1.414e-4)),
    "around it, of many numbers": (norm, 33, Requirement(lower=2.5), within(33, 2.5)),
    "a thin slab at an angle": (
        lambda e: jnp.abs(jnp.sum(e["v"])), 5, Requirement(lower=1e-5 * math.sqrt(5)), 2 * special.ndtr(1e-5) - 1
    ),
    "around it and far out": (norm, 2, Requirement(lower=0.02, upper=4.2), within(2, 0.02) + beyond(2, 4.2)),
    "a ring": (lambda e: jnp.abs(norm(e) - 4.0), 2, Requirement(lower=0.05), within(2, 4.05) - within(2, 3.95)),
    "a shell near the nominal unit": (
        lambda e: jnp.abs(norm(e) - 0.3), 5, Requirement(lower=0.05), within(5, 0.35) - within(5, 0.25)
    ),
    "a small ball elsewhere": (off, 3, Requirement(lower=0.1), stats.ncx2.cdf(0.01, 3, 4)),
    "a sliver and both tails": (
        lambda e: jnp.maximum(jnp.abs(e["v"][0]) - 3.5, 4e-4 - jnp.abs(e["v"][0] - 0.5)), 1, Requirement(upper=0.0),
        2 * stats.norm.sf(3.5) + stats.norm.cdf(0.5004) - stats.norm.cdf(0.4996),
    ),
    "both sides": (lambda e: jnp.abs(e["v"][0]), 5, Requirement(upper=4.5), 2 * stats.norm.sf(4.5)),
    "passing around the nominal unit": (norm, 5, Requirement(upper=0.2), within(5, 0.2)),
    "passing far out": (lambda e: e["v"][0], 5, Requirement(lower=4.5), stats.norm.sf(4.5)),
    "passing in a shell": (norm, 2, Requirement(lower=4.0, upper=4.1), within(2, 4.1) - within(2, 4.0)),
    "no value around the nominal unit": (
        lambda e: jnp.where(norm(e) < 0.2, jnp.nan, 1.0), 5, Requirement(lower=0.0), within(5, 0.2)
    ),
    "infinite but for few": (
        lambda e: jnp.where(e["v"][0] < -4.0, -1.0, jnp.inf), 5, Requirement(lower=0.0), stats.norm.sf(4.0)
    ),
    "a nominal unit unlike all others": (
        lambda e: jnp.where(norm(e) == 0, jnp.nan, norm(e)), 2, Requirement(upper=4.2), beyond(2, 4.2)
    ),
}  # fmt: skip
GOOD = {"OK", "SEVERAL_POINTS", "KINKED_POINT", "NO_POINT", "RARE_NOMINAL"}


def rare(share, flipped):
    """An estimate of the rare units, from one of the failing ones."""
    assert 0 <= share.lower <= share.value <= share.upper <= 1
    return 1 - share.value if flipped else share.value


LATER = ("a ring", "both sides", "infinite but for few", "a small ball elsewhere", "no value around the nominal unit")
"""Like a shell, both tails, units that are all alike, a sliver, and failed units of test_tolerances_failure.py."""


@pytest.mark.parametrize("place", [pytest.param(p, marks=[pytest.mark.long] * (p in LATER)) for p in PLACES])
def test_rare_units_anywhere(place):
    """Both estimates: the first to 4 of its standard errors and 10 %, the second to a factor of 2.5 (4 of its 20 %)."""
    response, numbers, need, exact = PLACES[place]
    flipped, tolerances = place.startswith("passing"), {"v": Tolerance.symmetric(3.0, shape=(numbers,))}
    found = failure_probability(response, tolerances, need, samples=10_000, seed=0)
    value, second = (rare(share, flipped) for share in (found.probability, found.second))
    assert set(found.status.split(", ")) <= GOOD
    assert abs(value - exact) < 4 * found.probability.error < 0.4 * exact
    assert exact / 2.5 < second < 2.5 * exact
    nominal_is_rare = ("nominal unit" in place and "shell" not in place) or place.startswith(("around", "a thin slab"))
    assert ("RARE_NOMINAL" in found.status) == nominal_is_rare


@pytest.mark.parametrize(
    ("response", "need", "share"),
    [(norm, Requirement(upper=-1.0), 1.0), (norm, Requirement(lower=-1.0), 0.0),
     (lambda e: norm(e) * jnp.nan, Requirement(lower=0.0), 1.0),
     (lambda e: jnp.inf + norm(e), Requirement(lower=0.0), 0.0),
     (lambda e: jnp.inf + norm(e), Requirement(upper=0.0), 1.0)],
    ids=["all fail", "none fails", "no value", "infinite passes", "infinite fails"],
)  # fmt: skip
def test_units_that_are_all_alike(response, need, share):
    """The bound of Clopper and Pearson: 1 - 0.025^(1/n) for n plain units, and a status that is not good."""
    tolerances = {"v": Tolerance.symmetric(3.0, shape=(5,))}
    found = failure_probability(response, tolerances, need, samples=10_000, seed=0)
    bound = 1 - 0.025 ** (1 / 14_096)
    limits = (1 - bound, 1.0) if share else (0.0, bound)
    seen = found.probability
    assert (seen.value, seen.lower, seen.upper) == pytest.approx((share, *limits), rel=1e-9)
    assert found.status == "FEW_EFFECTIVE_SAMPLES, NO_POINT"


def test_a_cone_of_which_no_step_leads_inwards():
    """Units of one direction, at every distance: neither estimate holds, and the interval and status say so."""
    direction, exact = lambda e: e["v"][0] / norm(e), stats.beta.sf(0.98**2, 0.5, 2.5) / 2
    for seed in range(2):
        found = failure_probability(
            direction, {"v": Tolerance.symmetric(3.0, shape=(6,))}, Requirement(upper=0.98), samples=10_000, seed=seed
        )
        assert "ESTIMATES_DISAGREE" in found.status or "FEW_EFFECTIVE_SAMPLES" in found.status
        assert 0 <= found.probability.lower <= exact <= found.probability.upper


def test_plain_units_contradict_two_estimates_that_agree(monkeypatch):
    """Both say 1 %; of 4096 plain units at 4 sd none fails, so their exact bound is the result."""
    wrong = Estimate(0.01, 0.001, 0.008, 0.012)
    monkeypatch.setattr(failure._Search, "draw", lambda self, random, samples: (wrong, 500.0, 1.0))
    monkeypatch.setattr(
        failure, "sequential", lambda path, numbers, random: Sequential(wrong, 4.0 + np.zeros((numbers, 9)))
    )
    found = failure_probability(
        lambda e: e["v"][0], {"v": Tolerance.symmetric(3.0, shape=(2,))}, Requirement(upper=4.0), samples=1000, seed=0
    )
    assert "ESTIMATES_DISAGREE, PLAIN_UNITS" in found.status
    assert (found.probability.value, found.probability.lower) == (0.0, 0.0)
    assert found.probability.upper == pytest.approx(1 - 0.025 ** (1 / 4096), rel=1e-9)


def shell(z):
    return 0.1 - abs((z**2).sum(axis=0) ** 0.5 - 5.1)


@pytest.mark.parametrize(
    ("path", "numbers", "exact"),
    [(Spreads(lambda z: (z**2).sum(axis=0) < 0.04, (0.5, 0.25, 2.0**-4)), 5, within(5, 0.2)),
     pytest.param(Spreads(lambda z: (z**2).sum(axis=0) < 6.25, (0.5,)), 33, within(33, 2.5), marks=pytest.mark.long),
     pytest.param(
         Spreads(lambda z: abs(z.sum(axis=0)) < 1e-4, (0.5, 2.0**-8, 2.0**-16)), 5, 2 * special.ndtr(1e-4 / 5**0.5) - 1,
         marks=pytest.mark.long,
     ),
     (Levels(shell, lambda z: shell(z) > 0), 5, within(5, 5.2) - within(5, 5.0)),
     (Levels(lambda z: z[0] - 4.5, lambda z: z[0] > 4.5), 5, stats.norm.sf(4.5))],
    ids=["ball", "ball of many numbers", "slab", "shell", "far"],
)  # fmt: skip
def test_subset_simulation_has_no_bias(path, numbers, exact):
    """Moves whose shape depends on the units that they move make the far limit 0.7 times as likely."""
    runs = 20 if numbers > 5 else 40
    found = [sequential(path, numbers, np.random.default_rng(seed)).probability for seed in range(runs)]
    ratios = np.array([each.value / exact for each in found])
    assert abs(ratios.mean() - 1) < 4 * ratios.std(ddof=1) / math.sqrt(runs) < 0.4
    assert sum(each.lower <= exact <= each.upper for each in found) >= 0.8 * runs  # fewer: 3 of 1000 cases with 20
