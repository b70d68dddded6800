"""Worst case and root sum of squares.

Oracles: closed forms (linear stacks, x^2, quadratic forms of non-normal errors by exact moments), a brute force
grid, and Monte Carlo. Closed forms agree to round-off, 1e-12; second-order moments of quadratics to 1e-10.
"""

import itertools
import math
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import rvjax
from rvjax.population.population import Population
from rvjax.study import load
from rvjax.tolerances import Requirement, Tolerance, for_design, monte_carlo, rss, sample, worst_case
from rvjax.tolerances.worst_case import extremes
from rvjax.units import um
from tests.oracles.responses import Linear

LIMITS = Requirement(lower=-30 * um, upper=30 * um)


def stack(**options):
    return {name: Tolerance.symmetric(t * um, **options) for name, t in (("a", 12), ("b", 9), ("c", 6))}


linear = Linear(dict(a=3.0, b=-2.0, c=1.0))


def peak_to_peak(e):
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    wave = e["a"] * np.sin(angle) + e["b"] * np.cos(angle)
    return jnp.max(wave) - jnp.min(wave)


def test_linear_stack():
    found = rss(linear, stack(), requirements=LIMITS)
    sd = math.sqrt(12**2 + 6**2 + 2**2) * um
    assert found.method == "first order"
    assert (found.mean, found.sd) == pytest.approx((0.0, sd), rel=1e-12)
    assert found.yield_ == pytest.approx(2 * stats.norm.cdf(30 * um / sd) - 1, rel=1e-12)
    assert found.yield_ == pytest.approx(0.97301, abs=5e-6)
    assert found.cpk == pytest.approx(30 * um / (3 * sd))
    assert found.contributions == pytest.approx({"a": 144 / 184, "b": 36 / 184, "c": 4 / 184})
    assert found.sensitivities == pytest.approx({"a": 3.0, "b": -2.0, "c": 1.0})

    uniform = stack(distribution="uniform")
    assert rss(linear, uniform).sd == pytest.approx(math.sqrt(36**2 + 18**2 + 6**2) / math.sqrt(3) * um, rel=1e-12)
    assert rss(linear, uniform).yield_ is None
    widest = worst_case(linear, uniform)
    assert (widest.lower, widest.upper) == pytest.approx((-60 * um, 60 * um), rel=1e-14)
    assert {n: float(v / um) for n, v in widest.at_upper.items()} == pytest.approx({"a": 12, "b": -9, "c": 6})
    assert worst_case(linear, uniform, refine=False).upper == pytest.approx(60 * um)


def test_shift_and_asymmetric_limits_move_the_mean():
    tolerances = {"a": Tolerance(-2 * um, 8 * um), "b": Tolerance(0.0, 2 * um, cp=1.5, shift=0.5)}
    found = rss(lambda e: {"a": e["a"], "b": e["b"]}, tolerances)
    assert found.mean == pytest.approx({"a": 3 * um, "b": 1.5 * um})
    assert found.sd == pytest.approx({"a": 5 / 3 * um, "b": 1 / 4.5 * um})
    assert found.contributions["a"] == {"a": 1.0, "b": 0.0}  # exactly: the response does not know b


def test_second_order_of_a_square():
    tolerances = {"x": Tolerance.symmetric(3 * 0.7)}
    square = lambda e: e["x"] ** 2  # noqa: E731
    second, first = rss(square, tolerances, order=2), rss(square, tolerances)
    assert (second.mean, second.sd) == pytest.approx((0.49, 0.49 * math.sqrt(2)))
    assert second.method == "second order"
    assert (first.mean, first.sd, first.contributions) == (0.0, 0.0, {"x": 0.0})


# The formula reads moments, which test_tolerances_distributions.py holds for every distribution.
OTHERS = [pytest.param(name, marks=pytest.mark.long) for name in ("uniform", "triangular", "truncated_normal")]


@pytest.mark.parametrize("distribution", ["beta", "rayleigh", *OTHERS])
def test_second_order_is_exact_for_quadratics_of_any_law(distribution):
    """E and var of x + 0.4 x^2 + 0.3 x y - y^2 from exact raw moments by quadrature in the quantile."""
    options = {"beta": dict(beta=(2.0, 5.0)), "triangular": dict(shift=0.4)}.get(distribution, {})
    x = Tolerance(0.0, 3.0, distribution=distribution, **options)
    y = Tolerance(-0.5, 1.5)
    laws = {
        "uniform": stats.uniform(0, 3),
        "triangular": stats.triang(0.7, 0, 3),
        "beta": stats.beta(2, 5, 0, 3),
        "truncated_normal": stats.truncnorm(-3, 3, 1.5, 0.5),
        "rayleigh": stats.rayleigh(0, 1),
    }
    mx, my = ([law.moment(k) for k in range(5)] for law in (laws[distribution], stats.norm(0.5, 1 / 3)))
    terms = {(1, 0): 1.0, (2, 0): 0.4, (1, 1): 0.3, (0, 2): -1.0}
    mean = sum(c * mx[i] * my[j] for (i, j), c in terms.items())
    square = sum(
        c * d * mx[i + k] * my[j + m] for ((i, j), c), ((k, m), d) in itertools.product(terms.items(), repeat=2)
    )
    quadratic = lambda e: e["x"] + 0.4 * e["x"] ** 2 + 0.3 * e["x"] * e["y"] - e["y"] ** 2  # noqa: E731
    found = rss(quadratic, {"x": x, "y": y}, order=2)
    assert found.mean == pytest.approx(mean, rel=1e-9)
    assert found.sd == pytest.approx(math.sqrt(square - mean**2), rel=1e-9)
    assert sum(found.contributions.values()) == pytest.approx(1.0)


def test_batch_factor():
    tolerances = {"x": Tolerance.symmetric(3.0, shape=(4,), batch=0.5)}
    average = lambda e: jnp.mean(e["x"])  # noqa: E731
    assert rss(average, tolerances).sd == pytest.approx(math.sqrt((1 + 3 * 0.5) / 4), rel=1e-12)
    uniform = {"x": tolerances["x"].replace(distribution="uniform")}
    rho = 6 / math.pi * math.asin(0.25)  # correlation of uniform numbers whose z have correlation 1/2
    assert rss(average, uniform).sd == pytest.approx(math.sqrt(3) * math.sqrt((1 + 3 * rho) / 4), rel=1e-4)
    square = lambda e: jnp.sum(e["x"]) ** 2  # noqa: E731
    assert rss(square, tolerances, order=2).sd == pytest.approx(10 * math.sqrt(2))  # var(sum) = 4 + 12/2
    with pytest.raises(ValueError, match="order = 2: correlated errors must be normal"):
        rss(square, uniform, order=2)


def test_components_of_vectors_in_a_batch_have_factors_of_their_own():
    """var(sum_j x_j + 2 y_j) = (1 + 4) s^2 (3 + 6 b) of three vectors: x and y share nothing."""
    tolerances = {"v": Tolerance(0.0, 3.0, distribution="rayleigh", shape=(3, 2), batch=0.3)}  # s = 1
    found = rss(lambda e: jnp.sum(e["v"][:, 0] + 2 * e["v"][:, 1]), tolerances)
    assert found.sd == pytest.approx(math.sqrt(5 * (3 + 6 * 0.3)), rel=1e-12)


def test_correlated_errors():
    """sd of linear sums from the correlation matrix; the share of a field is its part of the variance."""
    tolerances = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(6.0, shape=(2,), batch=0.2)}
    correlation = {("a", "b[1]"): 0.5}
    response = lambda e: e["a"] + e["b"][0] - e["b"][1]  # noqa: E731
    sizes = dict(samples=50_000, seed=0)
    matrix = np.array([[1, 0, 1.0], [0, 4, 0.8], [1.0, 0.8, 4]])  # 0.5 * 1 * 2 and 0.2 * 2 * 2
    g = np.array([1.0, 1.0, -1.0])
    found = rss(response, tolerances, correlation=correlation)
    assert found.sd == pytest.approx(math.sqrt(g @ matrix @ g), rel=1e-12)
    assert found.contributions["a"] == pytest.approx((matrix @ g)[0] / (g @ matrix @ g), abs=1e-12)
    drawn = monte_carlo(response, tolerances, correlation=correlation, **sizes)
    assert abs(drawn.sd.value - found.sd) < 4 * drawn.sd.error
    mixed = {
        "a": Tolerance(0.0, 3.0, distribution="rayleigh"),
        "b": Tolerance.symmetric(1.0, distribution="uniform", shape=(2,)),
    }
    crossed = {("a", "b"): -0.6}
    found = rss(response, mixed, correlation=crossed)
    drawn = monte_carlo(response, mixed, correlation=crossed, keep=True, **sizes)
    assert abs(drawn.sd.value - found.sd) < 4 * drawn.sd.error
    unit = jax.jit(lambda: sample(mixed, 17, seed=0, correlation=crossed))()
    assert float(response(unit)) == pytest.approx(drawn.values[17], rel=1e-12)


@pytest.mark.parametrize(
    ("correlation", "message"),
    [
        ({("a", "d"): 0.5}, "correlation: 'd' has no tolerance; these have: a, b, c"),
        ({("a", "b[3]"): 0.5}, r"'b\[3\]' is no element of shape \(\)"),
        ({("a", "b"): 1.0}, "must lie between -1 and 1"),
        ({("a", "a"): 0.5}, "shares an element with itself"),
        (
            {("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9},
            "its smallest eigenvalue is -0.8",
        ),
        ({"ab": 0.5}, "must be a pair of names"),
    ],
)
def test_bad_correlations_are_named(correlation, message):
    with pytest.raises(ValueError, match=message):
        rss(linear, stack(), correlation=correlation)


def test_a_kink_at_the_mean_is_sampled():
    tolerances = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(6.0), "idle": Tolerance.symmetric(1.0)}
    found = rss(peak_to_peak, tolerances, order=2, requirements=Requirement(upper=12.0))
    drawn = monte_carlo(peak_to_peak, tolerances, samples=20_000, seed=5)
    assert found.method == "sampled" and "16384 units" in rss.__doc__
    assert found.mean == pytest.approx(drawn.mean.value, rel=0.03)
    assert found.sd == pytest.approx(drawn.sd.value, rel=0.05)
    assert sum(found.contributions.values()) == pytest.approx(1.0)
    assert found.contributions["idle"] == found.sensitivities["idle"] == 0.0
    assert 0.85 < found.contributions["b"] < 0.95  # 4 times the variance, and the angle leans to it
    widest = worst_case(peak_to_peak, tolerances)
    assert widest.lower == 0.0
    assert widest.upper == pytest.approx(2 * math.hypot(3, 6), rel=1e-3)


MANY = {"w": Tolerance.symmetric(30.0), "e": Tolerance.symmetric(3.0, shape=(40,))}
above = lambda x: jnp.maximum(x, 0.0)  # noqa: E731
TAIL = stats.norm.pdf(0.5) - 0.5 * stats.norm.sf(0.5)  # E max(e - 0.5, 0)
# Mean and variance beyond those of w (0, 100), in closed form: of abs(e), max(e, 0), max(abs(e) - 0.5, 0), a dead band.
KINKS = {
    "at the mean": (lambda e: 0.09 * jnp.sum(jnp.abs(e)), 3.6 * math.sqrt(2 / math.pi), 0.324 * (1 - 2 / math.pi)),
    "weaker": (lambda e: -0.03 * jnp.sum(jnp.abs(e)), -1.2 * math.sqrt(2 / math.pi), 0.036 * (1 - 2 / math.pi)),
    "one side": (lambda e: 0.15 * jnp.sum(above(e)), 6 / math.sqrt(2 * math.pi), 0.9 * (0.5 - 0.5 / math.pi)),
    "off the mean": (lambda e: 0.15 * jnp.sum(above(jnp.abs(e) - 0.5)), 12 * TAIL, 0.3),
    "rounded": (lambda e: 0.09 * jnp.sum(jnp.hypot(e, 0.01)), 3.6 * math.sqrt(2 / math.pi), 0.12),
}


@pytest.mark.parametrize(
    ("kinks", "order"),
    [
        *(pytest.param(k, 1, marks=[pytest.mark.long] * (k in ("weaker", "one side"))) for k in KINKS),
        *(pytest.param(k, 2, marks=[pytest.mark.long] * (k != "at the mean")) for k in KINKS),
    ],
)
def test_many_weak_kinks_are_sampled(kinks, order):
    """Each of 40 is a hundredth of the gradient; their means add up. Four errors of 16384 units, with Cpk of both."""
    bent, mean, variance = KINKS[kinks]
    found = rss(lambda e: e["w"] + bent(e["e"]), MANY, order=order, requirements=Requirement(lower=-30.0, upper=30.0))
    sd = math.sqrt(100 + variance)
    assert found.method == "sampled"
    assert abs(found.mean - mean) < 4 * sd / 128 and found.sd == pytest.approx(sd, rel=4 / math.sqrt(2 * 16384))
    assert found.cpk == pytest.approx((30 - abs(mean)) / (3 * sd), abs=0.025)  # of 1: 0.90 at the mean


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_kinks_whose_means_cancel_are_sampled(size):
    """Plays on opposite sides, max(b, 0) - max(-a, 0) = (a + b + |b| - |a|)/2, move no mean, and the jump of the
    gradient tells all that it misses. The variance of |b| is 1 - 2/pi of that of b, and it is not correlated with b.
    """
    parts = {name: Tolerance.symmetric(3.0) for name in "ab"}
    found = rss(lambda e: 0.5 * e["a"] + size * (jnp.maximum(e["b"], 0) - jnp.maximum(-e["a"], 0)), parts)
    variance = (0.5 + 0.5 * size) ** 2 + (0.5 * size) ** 2 * (1 + 2 * (1 - 2 / math.pi))
    assert found.method == "sampled"
    assert found.sd == pytest.approx(math.sqrt(variance), rel=4 / math.sqrt(2 * 16384))


def test_kinks_that_leave_the_mean_alone_are_sampled_and_smooth_responses_are_not():
    """A dead band in every error has no slope at the mean; curvature belongs to the second order, however large."""
    quiet = MANY | {"w": Tolerance.symmetric(3.0)}
    band = lambda e: 0.4 * jnp.sum(jnp.sign(e["e"]) * above(jnp.abs(e["e"]) - 1.0))  # noqa: E731
    square = 2 * (2 * stats.norm.sf(1.0) - stats.norm.pdf(1.0))  # E max(abs(e) - 1, 0)^2
    found = rss(lambda e: e["w"] + band(e), quiet)
    assert found.method == "sampled"
    assert found.sd == pytest.approx(math.sqrt(1 + 6.4 * square), rel=4 / math.sqrt(2 * 16384))
    for smooth in (lambda e: e["w"] + 0.05 * jnp.sum(e["e"] ** 2), lambda e: 1e5 + 1e-4 * e["w"]):
        assert rss(smooth, MANY).method == "first order"
        assert rss(smooth, MANY, order=2).method == "second order"
    faint = rss(lambda e: e["w"] + 1e-3 * jnp.sum(jnp.abs(e["e"])), MANY)  # 0.3 % of the sd: better than by chance
    assert faint.method == "first order" and faint.sd == pytest.approx(10.0)


def test_nothing_varies():
    fixed = {name: Tolerance(1 * um, 1 * um) for name in "abc"}
    found = rss(linear, fixed, requirements=LIMITS)
    assert (found.sd, found.yield_, found.cpk) == (0.0, 1.0, math.inf)
    assert found.mean == pytest.approx(2 * um)
    assert rss(linear, {"a": 0.0, "b": None, "c": 0.0}).mean == 0.0
    assert worst_case(linear, {"a": None, "b": None, "c": None}).upper == 0.0


def test_records_and_arrays():
    tolerances = for_design(rvjax.catalogue.RV_40E, crank_eccentricity=Tolerance.grade("IT6", 0.025))
    found = rss(lambda e: jnp.sum(e.crank_eccentricity) + e.disc_runout, tolerances)
    assert found.sd == pytest.approx(2 * 6.5 * um / 3)
    np.testing.assert_allclose(found.sensitivities["crank_eccentricity"], np.ones((2, 2)))
    assert list(found.contributions) == ["crank_eccentricity"]


def test_worst_case_of_a_monotone_response():
    """Rising in a, falling in b, flat at the middle in c (c^3): corners, whatever the curvature."""
    tolerances = {"a": Tolerance(-1.0, 2.0), "b": Tolerance(0.0, 1.0), "c": Tolerance(-2.0, 2.0)}
    response = lambda e: jnp.exp(e["a"]) / (1 + e["b"]) + e["c"] ** 3  # noqa: E731
    found = worst_case(response, tolerances)
    assert found.upper == pytest.approx(math.exp(2) + 8, rel=1e-14)
    assert found.lower == pytest.approx(math.exp(-1) / 2 - 8, rel=1e-14)
    assert found.failed == 0


def test_worst_case_of_many_errors():
    """Thirty errors of alternating effect: far more corners than can be looked at."""
    tolerances = {"x": Tolerance.symmetric(1.0, shape=(30,))}
    signs = np.where(np.arange(30) % 3 == 0, -1.0, 1.0)
    response = lambda e: jnp.sinh(jnp.sum(signs * e["x"]) / 10)  # noqa: E731
    found = worst_case(response, tolerances)
    assert (found.lower, found.upper) == pytest.approx((-math.sinh(3), math.sinh(3)), rel=1e-13)
    np.testing.assert_allclose(found.at_upper["x"], signs)


def test_worst_case_needs_refinement():
    """The gradient at the middle points to the wrong corner; a grid of the whole box is the oracle."""
    tolerances = {"x": Tolerance.symmetric(1.0, shape=(13,)), "y": Tolerance.symmetric(1.0)}
    response = lambda e: 0.1 * e["y"] + 3 * e["y"] * e["x"][0] - 0.2 * e["x"][1] + e["x"][0] * e["x"][2]  # noqa: E731
    corners = itertools.product((-1.0, 1.0), repeat=4)
    best = max(0.1 * y + 3 * y * x0 - 0.2 * x1 + x0 * x2 for y, x0, x1, x2 in corners)
    assert worst_case(response, tolerances).upper == pytest.approx(best)


def test_worst_case_beyond_a_place_that_every_gradient_calls_the_best():
    """Two peaks along each of 14 errors, 0.8 and 1.2 high at the limits, and in the middle a slope to the lower one.

    Only moves across, one error at a time, leave the lower peaks; less than half of any start lies on the others.
    """
    tolerances = {"x": Tolerance.symmetric(1.0, shape=(14,))}
    found = worst_case(lambda e: jnp.sum(0.5 * e["x"] ** 3 + e["x"] ** 2 - 0.3 * e["x"]), tolerances)
    assert found.upper == pytest.approx(14 * 1.2)
    np.testing.assert_array_equal(found.at_upper["x"], 1.0)


def test_worst_case_inside_the_box():
    tolerances = {"x": Tolerance(-1.0, 2.0), "y": Tolerance.symmetric(1.0)}
    response = lambda e: (e["x"] - 0.3) ** 2 + 0.5 * (e["x"] + e["y"]) ** 2  # noqa: E731
    found = worst_case(response, tolerances)
    assert found.lower == pytest.approx(0.0, abs=1e-4)
    assert float(found.at_lower["x"]) == pytest.approx(0.3, abs=0.02)


BOX = {"a": Tolerance.symmetric(1.0), "b": Tolerance.symmetric(1.0)}
WAVES = {"x": Tolerance.symmetric(1.0, shape=(5,))}


@pytest.mark.parametrize(
    ("response", "tolerances", "lower", "upper"),
    [
        (lambda e: e["a"] ** 2 - e["b"] ** 2, BOX, -1.0, 1.0),  # 0 in every corner, and level at the mid-point
        (lambda e: jnp.exp(-50 * (e["a"] - 0.4) ** 2) + 0.1 * e["b"], BOX, -0.1, 1.1),  # a peak 0.1 wide
        (lambda e: (e["a"] * e["b"] - 0.2) ** 2 - (e["a"] + 0.3) ** 2, BOX, -1.69, 1.44 - 0.49),
        (lambda e: (e["a"] - 0.31) ** 2 + 100 * (e["b"] - e["a"]) ** 2, BOX, 0.0, 1.31**2 + 400),  # a narrow valley
        # Every phase from i - 3 to i + 3: the first holds 0 but not pi.
        (lambda e: jnp.sum(jnp.cos(3 * e["x"] + np.arange(5.0))), WAVES, -4 - math.cos(3 - math.pi), 5.0),
        # Squares of a vector in its disc: the slope turns round.
        (
            lambda e: e["v"][0] ** 2 - 2 * e["v"][1] ** 2,
            {"v": Tolerance(0.0, 2.0, distribution="rayleigh", shape=(2,))},
            -8.0,
            4.0,
        ),
    ],
    ids=["saddle", "peak", "product", "valley", "waves", "disc"],
)
def test_worst_case_of_slopes_that_change_sign(response, tolerances, lower, upper):
    """Ends to 5e-7 of the range."""
    found = worst_case(response, tolerances)
    assert (found.lower, found.upper) == pytest.approx((lower, upper), rel=0, abs=5e-7 * (upper - lower))
    assert found.status == "SLOPES_CHANGE_SIGN"
    for value, place in ((found.lower, found.at_lower), (found.upper, found.at_upper)):
        assert float(response(place)) == pytest.approx(value, abs=1e-12)
    ends = extremes(response, Population.of(tolerances), ("",), "")  # what requirements read
    assert tuple(ends.values) == (found.lower, found.upper)


@pytest.mark.parametrize(("shape", "before"), [((10,), 7168), ((30,), 1152)], ids=["all corners", "no corners"])
def test_worst_case_of_a_monotone_response_costs_no_more_than_its_corners(shape, before, monkeypatch):
    """Points evaluated, whole blocks of 64: as many as without a look at the slopes within the limits, at most."""
    module = sys.modules["rvjax.tolerances.worst_case"]
    evaluate, points = module._values_and_gradients, []
    monkeypatch.setattr(
        module, "_values_and_gradients", lambda *args, **named: points.append(len(args[2])) or evaluate(*args, **named)
    )
    found = worst_case(lambda e: jnp.sinh(jnp.sum(e["x"]) / 10), {"x": Tolerance.symmetric(1.0, shape=shape)})
    assert found.upper == pytest.approx(math.sinh(shape[0] / 10))
    assert found.status == "OK"
    assert 0 < sum(points) <= before
    assert worst_case(linear, stack(), refine=False).status == "ONE_CORNER"


def test_worst_case_of_vectors_is_a_disc():
    tolerances = {
        "v": Tolerance(0.0, 2.0, distribution="rayleigh", shape=(3, 2)),
        "r": Tolerance(0.0, 1.0, distribution="rayleigh"),
    }
    response = lambda e: 3 * e["v"][0, 0] + 4 * e["v"][0, 1] - e["v"][2, 1] + e["r"]  # noqa: E731
    found = worst_case(response, tolerances)
    assert (found.lower, found.upper) == pytest.approx((-12.0, 13.0))  # 5 * 2 + 2, and r from 0 to 1


def test_worst_case_counts_failures():
    tolerances = {"x": Tolerance.symmetric(1.0), "y": Tolerance.symmetric(1.0)}
    found = worst_case(lambda e: jnp.where(e["x"] > 0.9, jnp.nan, e["x"]) + e["y"], tolerances)
    assert found.failed > 0
    assert found.lower == -2.0
    assert 0.0 <= found.upper <= 1.9
    nothing = worst_case(lambda e: e["x"] * jnp.nan, tolerances)
    assert math.isnan(nothing.upper)


def test_bad_order_is_named():
    with pytest.raises(ValueError, match="order = 3: must be 1 or 2"):
        rss(linear, stack(), order=3)


@pytest.mark.long  # second derivatives of the four-bar model compile for half a minute
def test_moments_of_the_embedded_study_to_second_order():
    study = load("rv-40e")
    found = rss(study.response(), study.tolerances, order=2)
    drawn = monte_carlo(study.response(), study.tolerances, samples=65_536, seed=5)
    assert found.method["lost_motion"] == "second order"
    for name, sd in found.sd.items():
        assert sd == pytest.approx(drawn.sd[name].value, rel=0.02)
        assert abs(found.mean[name] - drawn.mean[name].value) < 0.02 * sd
