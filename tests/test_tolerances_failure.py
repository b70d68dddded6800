"""Failure probabilities far out in the tail.

Oracles: closed forms (normal, chi-square, gamma and uniform-product tails), quadrature for a parabolic limit, the
plain count among many units for a reducer. A probability must lie within 4 of its own standard errors, and that error
below 5 %; the index of a flat limit is exact to round-off, that of a curved one to 1e-4 (its search stops at an angle
of 1e-3, which enters squared).
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special, stats

import rvjax
from rvjax.population import Population
from rvjax.records import Record, field, record
from rvjax.response.response import respond
from rvjax.status import Status
from rvjax.study.response import Response
from rvjax.tolerances import (
    Estimate,
    Outcome,
    Requirement,
    Tolerance,
    failure,
    failure_probability,
    for_design,
    monte_carlo,
)
from rvjax.tolerances.failure import subset
from rvjax.tolerances.failure.form import Found, Units, slopes
from rvjax.tolerances.failure.importance_sampling import Mixture
from rvjax.units import um
from tests.oracles.programs import programs
from tests.oracles.responses import Linear

UNIT = Tolerance.symmetric(3.0)  # standard normal
THREE = {"a": UNIT, "b": UNIT, "c": UNIT}
MANY = {"v": Tolerance.symmetric(3.0, shape=(33,))}  # more than one batch of searches
EVEN = Tolerance(0.0, 1.0, distribution="uniform")
ROOT = math.sqrt(14)


def flat(e):
    return (3 * e["a"] - 2 * e["b"] + e["c"]) / ROOT


@record
class Squares(Record):
    """A power of the weighted sum of squares of the elements of v."""

    weights: Any = field("-", "of the squares", shape=("n",))
    power: Any = field("-", "of the sum", default=1.0)

    def __call__(self, e):
        return jnp.sum(self.weights * e["v"] ** 2) ** self.power


@record
class Apart(Record):
    """The larger of two elements of v, the second of which lies further away."""

    further: Any = field("-", "distance")

    def __call__(self, e):
        return jnp.maximum(e["v"][0], e["v"][1] - self.further)


@record
class Bent(Record):
    """a - bend/2 b^2."""

    bend: Any = field("-", "curvature")

    def __call__(self, e):
        return e["a"] - self.bend / 2 * e["b"] ** 2


def agrees(found, exact, error=0.05):
    share = found.probability
    assert abs(share.value - exact) < 4 * share.error
    assert share.error < error * exact
    assert share.lower < share.value < share.upper
    assert found.effective_samples > 100


def test_flat_limit():
    found = failure_probability(flat, THREE, Requirement(upper=4.0), samples=20_000, seed=1)
    agrees(found, 3.1671e-5, 0.02)
    assert found.reliability_index == pytest.approx(4.0, abs=1e-9)
    assert {n: float(v) for n, v in found.point.items()} == pytest.approx(
        {"a": 12 / ROOT, "b": -8 / ROOT, "c": 4 / ROOT}
    )
    assert (found.points, found.status) == (1, "OK")
    assert 20_000 < found.evaluations < 70_000
    compiled = programs(respond, flat), programs(slopes, flat)
    again = failure_probability(flat, THREE, Requirement(upper=4.0), samples=20_000, seed=1)
    assert again.probability == found.probability
    other = failure_probability(flat, THREE, Requirement(upper=3.9), samples=5000, seed=2)
    assert other.probability.value != found.probability.value
    assert (programs(respond, flat), programs(slopes, flat)) == compiled == (1, 1)


def test_errors_are_honest():
    """Twenty seeds: the scatter of the estimates is what each says of itself, and there is no bias."""
    runs = [failure_probability(flat, THREE, Requirement(upper=4.0), samples=2000, seed=s) for s in range(20)]
    off = np.array([(r.probability.value - special.ndtr(-4.0)) / r.probability.error for r in runs])
    assert abs(off.mean()) < 4 / math.sqrt(20)
    assert 0.5 < off.std(ddof=1) < 1.6


def test_both_limits_have_their_points():
    found = failure_probability(flat, THREE, Requirement(lower=-4.3, upper=4.0), samples=20_000, seed=2)
    agrees(found, stats.norm.sf(4.0) + stats.norm.sf(4.3))
    assert (found.points, found.status) == (2, "SEVERAL_POINTS")
    assert found.reliability_index == pytest.approx(4.0)


@pytest.mark.parametrize("limit", [0.0, -1.3, 1.0])
def test_frequent_failures(limit):
    found = failure_probability(flat, THREE, Requirement(upper=limit), samples=20_000, seed=0)
    agrees(found, stats.norm.sf(limit))
    assert found.reliability_index == pytest.approx(limit, abs=1e-6)


@pytest.mark.parametrize(
    ("response", "tolerances", "requirement", "exact", "index"),
    [
        # Every phase is equally bad; the other numbers are idle.
        (Squares(np.isin(np.arange(33), (0, 7)) * 1.0, 0.5), MANY, Requirement(upper=5.0), math.exp(-12.5), 5.0),
        pytest.param(
            *(Squares((np.arange(33) < 3) * 1.0), MANY, Requirement(upper=25.0), stats.chi2.sf(25, 3), 5.0),
            marks=pytest.mark.long,
        ),
        # c (1 + L + L^2/2) with L = ln(1/c); the limit bends away from its nearest point along three arms.
        (
            lambda e: e["a"] * e["b"] * e["c"],
            {"a": EVEN, "b": EVEN, "c": EVEN},
            Requirement(lower=1e-6),
            1e-6 * (1 + math.log(1e6) + math.log(1e6) ** 2 / 2),
            -stats.norm.ppf(1e-2) * math.sqrt(3),
        ),
        # Squares of Rayleigh magnitudes are exponential, their sum follows a gamma law.
        pytest.param(
            lambda e: (e["a"] ** 2 + e["b"] ** 2) / 2,
            dict.fromkeys("ab", Tolerance(0.0, 3.0, distribution="rayleigh")),
            Requirement(upper=16.0),
            stats.gamma.sf(16, 2),
            None,
            marks=pytest.mark.long,
        ),
        # The corner of a square: y has a kink and its slope in z dies out towards the edges.
        (
            lambda e: e["a"] + e["b"],
            {"a": EVEN, "b": EVEN},
            Requirement(upper=2 - 1e-3),
            1e-6 / 2,
            None,
        ),
    ],
    ids=["ring", "sphere", "uniform product", "gamma", "corner"],
)
def test_curved_limits(response, tolerances, requirement, exact, index):
    found = failure_probability(response, tolerances, requirement, samples=20_000, seed=3)
    agrees(found, exact)
    assert found.evaluations < 120_000
    if index is not None:
        assert found.reliability_index == pytest.approx(index, abs=1e-4)


@pytest.mark.parametrize("bend", [pytest.param(-0.15, marks=pytest.mark.long), 0.15])
def test_parabola(bend):
    exact, _ = integrate.quad(lambda x: stats.norm.pdf(x) * stats.norm.sf(4 + bend / 2 * x * x), -10, 10)
    pair = {"a": UNIT, "b": UNIT}
    found = failure_probability(Bent(bend), pair, Requirement(upper=4.0), samples=20_000, seed=4)
    agrees(found, exact)
    assert (found.reliability_index, found.status) == (pytest.approx(4.0, abs=1e-5), "OK")


def test_a_failure_that_plain_units_do_not_foretell():
    """A second way to fail, as likely as the first but steep: no plain unit comes near it."""
    response = lambda e: jnp.maximum(e["a"], 20 * (e["b"] - 4.3) + 4.2)  # noqa: E731
    found = failure_probability(response, THREE, Requirement(upper=4.2), samples=20_000, seed=0)
    agrees(found, stats.norm.sf(4.2) + stats.norm.sf(4.3))
    assert (found.points, found.status) == (2, "SEVERAL_POINTS")


@pytest.mark.long  # rare units of many numbers: test_tolerances_coverage.py
def test_many_numbers():
    many = {"v": Tolerance.symmetric(3.0, shape=(100,))}
    found = failure_probability(lambda e: jnp.sum(e["v"]) / 10, many, Requirement(upper=6.0), samples=10_000, seed=0)
    agrees(found, stats.norm.sf(6.0))


def test_failed_units_are_failures():
    def response(e):
        lost = jnp.abs(e["v"][3]) > 4.5
        return Outcome(e["v"][1], jnp.where(lost, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED)))

    found = failure_probability(response, MANY, Requirement(upper=9.0), samples=20_000, seed=5)
    agrees(found, 2 * stats.norm.sf(4.5))
    assert found.reliability_index == pytest.approx(4.5, abs=1e-4)
    assert abs(float(found.point["v"][3])) == pytest.approx(4.5, abs=1e-4)
    hidden = lambda e: jnp.where(e["a"] > 4.2, jnp.nan, e["a"])  # noqa: E731
    agrees(failure_probability(hidden, THREE, Requirement(upper=4.0), samples=20_000, seed=5), stats.norm.sf(4.0))
    nothing = failure_probability(lambda e: e["a"] * jnp.nan, THREE, Requirement(upper=1.0), samples=1000, seed=0)
    assert nothing.probability.value == 1.0
    assert (nothing.reliability_index, nothing.point) == (-math.inf, None)


def test_correlated_and_batched_errors():
    """sd of a + b with correlation 0.6 is sqrt(3.2); of the mean of 4 with batch factor 0.5, sqrt(5/8)."""
    total = Linear({"a": 1.0, "b": 1.0})
    options = dict(samples=10_000, seed=6)
    found = failure_probability(
        total, {"a": UNIT, "b": UNIT}, Requirement(upper=4.5 * math.sqrt(3.2)), correlation={("a", "b"): 0.6}, **options
    )
    agrees(found, stats.norm.sf(4.5))
    assert (float(found.point["a"]), float(found.point["b"])) == pytest.approx([4.5 * math.sqrt(0.8)] * 2)
    batch = {"v": Tolerance.symmetric(3.0, shape=(4,), batch=0.5)}
    found = failure_probability(
        lambda e: jnp.mean(e["v"]), batch, Requirement(lower=-4.5 * math.sqrt(0.625)), **options
    )
    agrees(found, stats.norm.sf(4.5))
    assert found.reliability_index == pytest.approx(4.5)


def test_unreachable_limits_and_no_spread():
    found = failure_probability(flat, dict.fromkeys("abc", EVEN), Requirement(upper=9.0), samples=1000, seed=0)
    assert (found.probability.value, found.reliability_index, found.point) == (0.0, math.inf, None)
    assert 0 < found.probability.upper < 0.1
    assert found.status == "FEW_EFFECTIVE_SAMPLES, NO_POINT"
    fixed = dict.fromkeys("abc", Tolerance(1.0, 1.0))
    assert failure_probability(flat, fixed, Requirement(upper=1.0), samples=100, seed=0).probability.value == 0.0
    assert failure_probability(flat, fixed, Requirement(upper=0.5), samples=100, seed=0).probability.value == 1.0


@pytest.mark.parametrize("further", [0.0, 0.5])  # the second way is as likely as the first, or a twelfth of it
def test_what_the_first_estimate_misses_shows(further, monkeypatch):
    """With all searches blind to one of two ways to fail, the second estimate tells, and its interval is taken in."""
    take = failure._Search._take

    def blind(self, state, found):
        seen = found.points[0] > 2
        return take(self, state, Found(found.points[:, seen], found.converged[seen]))

    monkeypatch.setattr(failure._Search, "_take", blind)
    monkeypatch.setattr(failure, "orbit", lambda state, point, converged: Found(point[:, None], np.array([converged])))
    found = failure_probability(Apart(further), MANY, Requirement(upper=4.5), samples=10_000, seed=1)
    assert found.points == 1
    assert found.probability.value < 1.2 * stats.norm.sf(4.5)
    assert "ESTIMATES_DISAGREE" in found.status
    assert found.probability.lower <= stats.norm.sf(4.5) + stats.norm.sf(4.5 + further) <= found.probability.upper


def test_a_unit_without_random_numbers():
    for limit, share in ((-1.0, 1.0), (1.0, 0.0)):
        found = failure_probability(lambda e: 0.0 * e["a"], {"a": None}, Requirement(upper=limit), samples=100, seed=0)
        assert (found.probability.value, found.points) == (share, 0)


def test_responses_of_several_values():
    response = lambda e: {"y": flat(e), "a": e["a"]}  # noqa: E731
    required = {"y": Requirement(upper=4.0), "a": Requirement(lower=-3.5)}
    found = failure_probability(response, THREE, required, samples=10_000, seed=7)
    assert found.reliability_index == pytest.approx({"y": 4.0, "a": 3.5})
    for name, share in found.probability.items():
        assert abs(share.value - stats.norm.sf(found.reliability_index[name])) < 4 * share.error
    with pytest.raises(ValueError, match="the response has the names"):
        failure_probability(response, THREE, Requirement(upper=4.0), samples=100, seed=0)
    with pytest.raises(ValueError, match="samples = 1: must be at least 2"):
        failure_probability(flat, THREE, Requirement(upper=4.0), samples=1, seed=0)


@pytest.mark.long  # curved limits with a closed form run by default
def test_misfit_of_a_reducer():
    """The largest misfit over two discs and 16 angles: kinks everywhere, several ways to fail."""
    conditions = rvjax.models.kind(rvjax.catalogue.RV_40E).conditions(angles=16)
    response = Response.of(rvjax.catalogue.RV_40E, ("misfit",), conditions)
    fine = Tolerance.grade("IT6", 0.025)
    tolerances = for_design(rvjax.catalogue.RV_40E, crank_eccentricity=fine, disc_bore=fine, carrier_bore=fine)
    usual, rare = ({"misfit": Requirement(upper=limit)} for limit in (19 * um, 27 * um))
    counted = monte_carlo(response, tolerances, samples=200_000, seed=8, chunk=16384, requirements=usual)
    share, error = counted.ppm["misfit"].value / 1e6, counted.ppm["misfit"].error / 1e6
    found = failure_probability(response, tolerances, usual, samples=20_000, seed=9)
    own = found.probability["misfit"]
    assert abs(own.value - share) < 4 * math.hypot(own.error, error)
    first, second = (failure_probability(response, tolerances, rare, samples=40_000, seed=s) for s in (1, 2))
    one, two = (item.probability["misfit"] for item in (first, second))
    assert 1e-8 < one.value < 1e-5
    assert abs(one.value - two.value) < 4 * math.hypot(one.error, two.error)
    assert one.error < 0.05 / 2 * one.value
    assert first.evaluations["misfit"] <= 120_000
    at_point = response(first.point["misfit"]).value["misfit"]
    assert float(at_point) == pytest.approx(27 * um, rel=1e-3)


# Parts that fail each in its own direction, all alike: a maximum over pins or rollers. (Response, fields, limit,
# ways to fail beyond 4.5 sigma.)
ALIKE = {
    "maximum of 33": (lambda e: jnp.max(e["v"]), 33, 4.5, 33),
    "maximum of 64": (lambda e: jnp.max(e["v"]), 64, 4.5, 64),
    "largest of 33, either sign": (lambda e: jnp.max(jnp.abs(e["v"])), 33, 4.5, 66),
    # No slope anywhere, and no value that tells near from far.
    "plateau": (lambda e: jnp.where(jnp.max(e["v"]) > 4.5, 1.0, 0.0), 10, 0.5, 10),
}


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=[pytest.mark.long] * (c in ("maximum of 64", "largest of 33, either sign"))) for c in ALIKE],
)
def test_every_part_has_its_own_failure(case):
    response, fields, limit, ways = ALIKE[case]
    exact = -math.expm1(ways * stats.norm.logcdf(4.5))
    found = failure_probability(
        response, {"v": Tolerance.symmetric(3.0, shape=(fields,))}, Requirement(upper=limit), samples=10_000, seed=1
    )
    agrees(found, exact, 0.1)
    assert found.points >= ways if case == "plateau" else found.points == ways


def test_corners_whose_slopes_lead_away_from_all_failures():
    """The linearised limit of a corner points along one number, where no unit fails; sixteen corners."""
    found = failure_probability(
        lambda e: jnp.prod(jnp.sign(e["v"])) * jnp.min(jnp.abs(e["v"])),
        {"v": Tolerance.symmetric(3.0, shape=(5,))}, Requirement(upper=1.5631), samples=20_000, seed=0,
    )  # fmt: skip
    exact = 16 * stats.norm.sf(1.5631) ** 5
    assert found.points >= 16
    assert abs(found.probability.value - exact) < 0.3 * exact
    assert found.probability.lower < exact < found.probability.upper


@pytest.mark.parametrize(("fields", "corner", "samples"), [(5, 2.0, 1000), (3, 2.5, 300)])
def test_intervals_hold_where_few_heavy_units_decide(fields, corner, samples):
    """Unit normals about the corner of a cube: intervals of equal factors hold in 79 and 86 % of the draws."""
    search = object.__new__(failure._Search)
    search.mixture = Mixture(fields)
    search.mixture.add(Found(np.full((fields, 1), corner), np.array([True])))
    search.differ = lambda z: (z > corner).all(axis=0)
    random, exact = np.random.default_rng(0), stats.norm.sf(corner) ** fields
    intervals = [search.draw(random, samples)[0] for _ in range(400)]
    assert np.mean([one.lower <= exact <= one.upper for one in intervals]) > 0.92


@pytest.mark.parametrize("away", [27, 30, 37, 50, 1e6])
def test_limits_far_beyond_every_unit(away):
    """Squares of the weights, then the weights themselves, are below the smallest number: 0 / 0 before."""
    tolerances = {"a": Tolerance.symmetric(3 * um), "b": Tolerance.symmetric(4 * um)}
    limit = Requirement(upper=away * 5 / 3 * um)
    found = failure_probability(Linear({"a": 1.0, "b": 1.0}), tolerances, limit, samples=8000, seed=0)
    exact = stats.norm.sf(away)
    assert found.reliability_index == pytest.approx(away, rel=1e-9)
    assert found.probability.lower <= exact <= found.probability.upper
    assert exact == 0 or abs(found.probability.value / exact - 1) < 0.2
    assert exact > 0 or (found.probability.value == 0 and "FEW_EFFECTIVE_SAMPLES" in found.status)


NEVER = {  # no unit fails, or none passes; numbers that no double tells from 1; nothing varies
    "even": (lambda e: e["a"], {"a": EVEN}, Requirement(upper=1.5)),
    "always": (lambda e: e["a"], {"a": EVEN}, Requirement(upper=-0.5)),
    "without a value": (lambda e: e["a"] * jnp.nan, {"a": UNIT}, Requirement(upper=1.0)),
    "far": (lambda e: e["a"], {"a": UNIT}, Requirement(lower=-50.0)),
    "far, passing": (lambda e: e["a"], {"a": UNIT}, Requirement(lower=12.0)),
    "a constant": (lambda e: 2.0 + 0 * e["a"], {"a": UNIT}, Requirement(upper=1.0)),
}


@pytest.mark.parametrize("case", NEVER)
def test_no_probability_is_known_without_an_interval(case):
    """Both estimates; before, the second was 0 +- 0 from 0 to 0 where no unit had been found."""
    response, tolerances, requirement = NEVER[case]
    found = failure_probability(response, tolerances, requirement, samples=1000, seed=0)
    for one in (found.probability, found.second):
        assert 0 <= one.lower <= one.value <= one.upper <= 1
        assert one.lower < one.upper and one.error > 0
    assert found.probability.value in (0.0, 1.0)


def test_units_that_were_never_seen_bound_the_second_estimate():
    """A region of 1e-6 that no widening leads to: none of 1024 units, by Clopper and Pearson, and the truth within."""
    corner = stats.norm.ppf(1 - 1e-6)
    region = lambda z: (z[0] > corner) & (z[0] < corner + 1e-3)  # noqa: E731
    blind = subset.Spreads(region, (1.0001,))
    found = subset.sequential(blind, 1, np.random.default_rng(0)).probability
    assert (found.value, found.lower) == (0.0, 0.0)
    assert found.upper == pytest.approx(1 - 0.025 ** (1 / 1024), rel=1e-12)
    certain = subset.sequential(subset.Spreads(lambda z: z[0] < 50.0, (1.25,)), 1, np.random.default_rng(0)).probability
    assert certain.value == 1.0 and certain.lower < 1.0 and certain.error == pytest.approx(1 / 1024)


def test_two_hits_leave_a_probability_within_its_range(thorough):
    """A paraboloid and few draws: a symmetric interval of two weights ends below 0 (exact: 2.81017e-6)."""
    below = failure._of_failure(Estimate(2.3e-7, 1.3e-7, -2.5e-8, 4.8e-7), False)
    assert (below.lower, below.upper, below.error) == (0.0, 4.8e-7, 1.3e-7)
    assert failure._of_failure(Estimate(0.4, 0.4, -0.3, 1.1), True) == Estimate(0.6, 0.4, 0.0, 1.0)
    bowl = lambda e: e["a"] - jnp.sum(e["u"] ** 2)  # noqa: E731
    tolerances = {"a": UNIT, "u": Tolerance.symmetric(3.0, shape=(4,))}
    for seed in range(4 if thorough else 2):
        found = failure_probability(bowl, tolerances, Requirement(upper=3.5), samples=20, seed=seed)
        assert 0 <= found.probability.lower < found.probability.upper <= 1
        assert 0 <= found.second.lower < 2.81017e-6 < found.second.upper


def test_an_infinite_value_is_a_value_and_a_missing_one_is_none():
    """A life without load is infinite; the status of such a unit is that of a missing value."""

    def life(e):
        value = jnp.where(e["a"] > 0.05, jnp.inf, jnp.where(e["a"] < -0.15, jnp.nan, e["a"]))
        return Outcome({"y": value}, jnp.where(jnp.isfinite(value), int(Status.CONVERGED), int(Status.NONFINITE)))

    units = Units(life, Population.of({"a": Tolerance.symmetric(0.3)}), "y")
    np.testing.assert_allclose(units.values(np.array([[-2.0, -0.5, 1.0]])), [np.nan, -0.05, np.inf])
