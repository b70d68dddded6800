"""What is known of measured parts, and what plans promise of it: quadrature, closed forms, drawn truth behind them."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from assembly_cases import UNIT, cases, kind, measured, square
from scipy import integrate, stats

from rvjax.assembly import believed, opening, plan
from rvjax.tolerances import Requirement, Tolerance


def test_unmeasured_parts_gain_nothing():
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 20))
    unseen = {"a": measured(a, 0 * a, math.inf), "b": measured(b, 0 * b, math.inf)}
    found = plan(square, unseen, certificate_draws=64)
    assert [unit["b"] for unit in found.build] == list(range(20))
    assert found.gain.lower < 0 < found.gain.upper
    # 64 draws of a mean over 20 units (each 2 chi2): sd of the mean 2 sqrt(2)/sqrt(20 * 64) = 0.08; five of these
    assert abs(found.objective - 2.0) < 0.4 and abs(found.random.value - 2.0) < 0.4


def test_a_share_that_every_draw_shows_has_an_interval():
    """All 20 units good in each of 64 draws: the score interval of 64; parts that are known make no draws."""
    a, b = np.random.default_rng(3).standard_normal((2, 20))
    kinds = {"a": measured(a, 0 * a, 0.1), "b": measured(b, 0 * b, 0.1)}
    found = plan(square, kinds, requirement=Requirement(upper=1e3), certificate_draws=64, draws=8)
    for share in (found.yield_, found.random_yield):
        assert share.value == pytest.approx(1.0) and share.upper == 1.0
        assert share.lower == pytest.approx(64 / (64 + stats.norm.ppf(0.975) ** 2), rel=1e-6)
    exact = plan(square, {"a": kind(a), "b": kind(b)}, requirement=Requirement(upper=1e3))
    assert (exact.yield_.lower, exact.yield_.upper) == (1.0, 1.0)


def test_many_parts_leave_the_error_that_the_gauge_does_not_measure():
    """Spread left as a share of random: sqrt(s^2/(s0^2 + s^2)); a hundred parts miss their match by little.

    The promise is an expectation; what is left by chance is the unequal mean of both lots, (4/100)/2 of the square.
    """
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((2, 100))
    for sd in (0.5, 1.0):
        noise = sd * rng.standard_normal((2, 100))
        kinds = {"a": measured(a, noise[0], sd), "b": measured(b, noise[1], sd)}
        found = plan(square, kinds, draws=16, certificate_draws=48)
        share = math.sqrt(found.objective / found.random.value)
        assert share == pytest.approx(math.sqrt(sd**2 / (1 + sd**2)), rel=0.12)


def test_no_gain_is_promised_that_does_not_come_true():
    """30 measured sets, gauge as wide as the population: true - promised is 0 within its error; unshrunk it is not.

    Pairs of the true parts against the plan's own expectation; 4 standard errors.
    """
    rng = np.random.default_rng(6)
    off = {True: [], False: []}
    for _ in range(30):
        truth, noise = rng.standard_normal((2, 2, 24))
        for shrunk in (True, False):
            kinds = {
                slot: measured(x, e, 1.0 if shrunk else 0.0, UNIT if shrunk else None)
                for slot, x, e in zip("ab", truth, noise)
            }
            found = plan(square, kinds, draws=16, certificate_draws=32)
            true = [(truth[0][unit["a"]] + truth[1][unit["b"]]) ** 2 for unit in found.build]
            off[shrunk].append(np.mean(true) - found.objective)
    error = {shrunk: np.std(values, ddof=1) / math.sqrt(30) for shrunk, values in off.items()}
    assert abs(np.mean(off[True])) < 4 * error[True]
    assert np.mean(off[False]) > 5 * error[False]


DISTRIBUTIONS = [
    Tolerance(-1.0, 2.0, distribution="uniform"),
    Tolerance(-1.0, 2.0, distribution="triangular", shift=0.3),
    Tolerance(0.0, 2.0, distribution="rayleigh"),
    Tolerance(0.0, 2.0, distribution="lognormal", log_sd=0.4),
]


@pytest.mark.parametrize("tolerance", DISTRIBUTIONS, ids=lambda t: t.distribution)
@pytest.mark.parametrize(("value", "sd"), [(0.7, 0.3), (0.7, 0.003), (1.9, 0.5)])
def test_what_is_known_of_a_part_against_quadrature(tolerance, value, sd):
    """Oracle: 400 points of Gauss over z, where the posterior lives. A kink of a law (triangular) costs the 129 nodes
    of spacing h an error of order h^2, 1e-3 of the spread."""

    def weight(z, power):
        errors = np.asarray(tolerance.deviate(jnp.asarray(z)))
        return stats.norm.pdf(z) * np.exp(-(((value - errors) / sd) ** 2) / 2) * errors**power

    grid = np.linspace(-8, 8, 3001)
    errors = np.asarray(tolerance.deviate(jnp.asarray(grid)))
    most = np.argmax(stats.norm.logpdf(grid) - ((value - errors) / sd) ** 2 / 2)
    centre, slope = grid[most], np.gradient(errors, grid)[most]
    ends = centre + np.array([-1, 1]) * min(8.0, 10 * sd / max(slope, 1e-3))
    moments = [integrate.fixed_quad(weight, *ends, args=(power,), n=400)[0] for power in range(3)]
    mean = moments[1] / moments[0]
    spread = math.sqrt(max(moments[2] / moments[0] - mean**2, 0))
    found = believed(value, sd, tolerance)
    assert found[0] == pytest.approx(mean, abs=2e-3 * sd)
    assert found[1] == pytest.approx(spread, rel=2e-2)


@pytest.mark.parametrize("case", cases("shrink"), ids=lambda case: case["id"])
def test_shrinkage_of_the_reference(case):
    given, expected = case["given"], case["expected"]
    found = believed(given["value"], given["sd"], Tolerance(**given["tolerance"]))
    assert found == pytest.approx((expected["mean"], expected["sd"]), rel=1e-12, abs=1e-22)


def test_the_ends_of_knowledge():
    for tolerance in (UNIT, *DISTRIBUTIONS):
        assert believed(0.5, 0.0, tolerance) == (0.5, 0.0)
        mean, variance = tolerance.moments()[:2]
        assert believed(0.5, math.inf, tolerance) == pytest.approx((mean, math.sqrt(variance)), rel=2e-3)
    assert believed(0.5, 0.2, None) == (0.5, 0.2)
    mean, spread = believed(9.0, 0.1, DISTRIBUTIONS[0])  # far beyond the limits: at the end
    assert 1.99 < mean <= 2 and spread < 0.01
    vector = Tolerance(0.0, 3e-6, distribution="rayleigh", shape=(2,))
    mean, spread = believed([1e-6, -1e-6], 1e-6, vector)  # two normal components of sd 1e-6
    np.testing.assert_allclose((mean, spread), ([0.5e-6, -0.5e-6], [math.sqrt(0.5) * 1e-6] * 2), rtol=1e-12)


def test_opening():
    """One part has no choice: factor 1 but for the chance of 20 sets. More parts open the tolerances, none beyond."""
    requirement = Requirement(upper=1.0)
    alone = opening(square, {"a": kind([0.0]), "b": kind([0.0])}, {"x": UNIT}, requirement=requirement, sets=20)
    assert alone.factor < 1.3 and (alone.curve[:, 1] == alone.curve[:, 2]).all()
    kinds = {"a": kind([0.0] * 8), "b": kind([0.0] * 8)}
    found = opening(square, kinds, {"a": {"x": UNIT}, "b": {"x": UNIT}}, requirement=requirement, sets=8)
    factors, matched, random = found.curve.T
    assert found.factor > 1.5 and factors[0] == 1 and found.target == random[0]
    assert (matched >= random - 1e-12).all() and (np.diff(random) < 0.02).all()
    assert all((y >= found.target) == (k <= found.factor) for k, y in zip(factors, matched))
    # N(0, 2): P(|sum| <= 1) = erf(1/2); 8 sets of 8 x 8 dependent pairs
    assert found.target == pytest.approx(math.erf(0.5), abs=0.12)
    blind = opening(lambda parts, index: 0.0 * parts["a"]["x"], kinds, {"x": UNIT}, requirement=requirement, sets=2)
    assert blind.factor == 64
    assert found.opened({"x": UNIT})["x"].half_width == pytest.approx(3.0 * found.factor)


@pytest.mark.long
def test_opening_with_a_gauge_opens_less():
    requirement = Requirement(upper=1.0)
    kinds = {slot: measured([0.0] * 8, np.zeros(8), 2.0, None) for slot in "ab"}
    exact = {slot: measured([0.0] * 8, np.zeros(8), 0.0, None) for slot in "ab"}
    rough, fine = (opening(square, k, {"x": UNIT}, requirement=requirement, sets=5).factor for k in (kinds, exact))
    assert 1 <= rough < fine
