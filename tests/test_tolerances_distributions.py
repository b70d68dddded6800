"""Distributions and grades.

Oracles: SciPy's quantile functions and moments (independent code), closed-form moments, and the formula
behind the table of ISO 286-1. Quantile maps agree to 1e-9 of the half-width (the beta law is interpolated
from a table, 1e-8); moments are closed forms and agree to round-off, 1e-10.
"""

import itertools
import math
import operator
import warnings
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import rvjax
from rvjax.catalogue import RV_40E
from rvjax.population import Population
from rvjax.population.grades import GRADES
from rvjax.tolerances import Tolerance, for_design, it_width
from rvjax.units import mm, um

Z = np.linspace(-6, 6, 241)


def truncated(lower, upper, cp, shift):
    half, middle = (upper - lower) / 2, (upper + lower) / 2
    sigma, mean = half / (3 * cp), middle + shift * half
    return stats.truncnorm((lower - mean) / sigma, (upper - mean) / sigma, loc=mean, scale=sigma)


CASES = {
    "normal": (Tolerance(-2.0, 8.0), stats.norm(3.0, 5 / 3)),
    "shifted normal": (Tolerance(-2.0, 8.0, cp=1.5, shift=0.5), stats.norm(5.5, 5 / 4.5)),
    "truncated": (Tolerance(-2.0, 8.0, distribution="truncated_normal"), truncated(-2, 8, 1, 0)),
    "wide truncated": (
        Tolerance(-2.0, 8.0, distribution="truncated_normal", cp=0.3, shift=-0.7),
        truncated(-2, 8, 0.3, -0.7),
    ),
    "uniform": (Tolerance(-2.0, 8.0, distribution="uniform"), stats.uniform(-2, 10)),
    "triangular": (Tolerance(-2.0, 8.0, distribution="triangular"), stats.triang(0.5, -2, 10)),
    "skew triangular": (Tolerance(-2.0, 8.0, distribution="triangular", shift=0.6), stats.triang(0.8, -2, 10)),
    "beta": (Tolerance(-2.0, 8.0, distribution="beta", beta=(2.0, 5.0)), stats.beta(2, 5, -2, 10)),
    "u-shaped beta": (Tolerance(-2.0, 8.0, distribution="beta", beta=(0.5, 0.8)), stats.beta(0.5, 0.8, -2, 10)),
    "rayleigh": (Tolerance(0.0, 9.0, distribution="rayleigh"), stats.rayleigh(0, 3)),
}


@jax.jit
def deviated(tolerance, z):
    """Errors by one program, not by one for each operation."""
    return tolerance.deviate(z)


@jax.jit
def total(half_width, tolerance, z):
    return jnp.sum(tolerance.with_half_width(half_width).deviate(z))


@pytest.mark.parametrize("name", CASES)
def test_quantile_map_and_moments_equal_scipy(name):
    tolerance, law = CASES[name]
    expected = np.where(Z < 0, law.ppf(stats.norm.cdf(Z)), law.isf(stats.norm.sf(Z)))
    accuracy = 1e-8 if "beta" in name else 1e-9
    np.testing.assert_allclose(deviated(tolerance, Z), expected, atol=accuracy * tolerance.half_width)

    mean, variance, third, fourth = tolerance.moments()
    m, v, skew, kurtosis = law.stats("mvsk")
    np.testing.assert_allclose([mean, variance], [m, v], rtol=1e-10)
    np.testing.assert_allclose(third, skew * v**1.5, rtol=1e-8, atol=1e-10 * v**1.5)
    np.testing.assert_allclose(fourth, (kurtosis + 3) * v**2, rtol=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_errors_are_differentiable_in_the_half_width(name):
    tolerance, _ = CASES[name]
    given, step = (tolerance, np.linspace(-8.5, 8.5, 35)), 1e-5
    slope = jax.grad(total)(5.0, *given)
    moved = float(total(5 + step, *given) - total(5 - step, *given))
    np.testing.assert_allclose(slope, moved / (2 * step), rtol=1e-6, atol=1e-6)


def test_shift_and_capability_place_mean_and_spread():
    shifted = Tolerance(0.0, 2.0, cp=1.5, shift=0.5)
    mean, variance, *_ = shifted.moments()
    assert mean == pytest.approx(1.5)  # m + h/2
    assert (2.0 - mean) / (3 * math.sqrt(variance)) == pytest.approx(0.75)  # Cpk = cp (1 - |shift|)
    rayleigh = Tolerance(0.0, 9 * um, distribution="rayleigh")
    assert rayleigh.moments()[0] == pytest.approx(3 * um * math.sqrt(math.pi / 2))


@pytest.mark.parametrize("beta", [(0.5, 0.75), (2.0, 5.0), (1000.0, 1.0), (1.0, 1e4), (1e6, 1e6 + 1)])
def test_moments_of_narrow_beta_laws_keep_their_digits(beta):
    """Oracle: the raw moments in rational numbers."""
    p, q = map(Fraction, beta)
    m1, m2, m3, m4 = itertools.accumulate(((p + k) / (p + q + k) for k in range(4)), operator.mul)
    exact = m1, m2 - m1**2, m3 - 3 * m1 * m2 + 2 * m1**3, m4 - 4 * m1 * m3 + 6 * m1**2 * m2 - 3 * m1**4
    found = Tolerance(0.0, 1.0, distribution="beta", beta=beta).moments()
    np.testing.assert_allclose(found, [float(moment) for moment in exact], rtol=1e-13)


def test_constant_error():
    for distribution in ("normal", "truncated_normal", "uniform", "triangular"):
        np.testing.assert_array_equal(deviated(Tolerance(2.0, 2.0, distribution=distribution), Z), 2.0)


def test_scaling_keeps_middle_shift_and_capability():
    scaled = Tolerance(-2 * um, 8 * um, cp=1.3, shift=0.2, size=25 * mm, shape=(2, 2)).with_half_width(1 * um)
    assert (scaled.lower, scaled.upper) == pytest.approx((2 * um, 4 * um))
    assert (scaled.cp, scaled.shift, scaled.size, scaled.shape) == (1.3, 0.2, 25 * mm, (2, 2))
    rayleigh = Tolerance(0.0, 8 * um, distribution="rayleigh").with_half_width(1 * um)
    assert (rayleigh.lower, rayleigh.upper) == (0.0, 2 * um)


def test_a_clearance_does_not_go_below_zero_in_silence():
    """Limits 0 to 3 um about 1.5 um: wider ones begin below zero. Other errors may; a search passes without a word."""
    given = dict(bearing_clearance=Tolerance(0.0, 3 * um), pin_radius=Tolerance(0.0, 3 * um))
    made = for_design(RV_40E, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made.bearing_clearance.with_half_width(1.5 * um), made.pin_radius.with_half_width(4 * um)
        lognormal = made.bearing_clearance.replace(distribution="lognormal", log_sd=0.2)
        assert float(lognormal.with_half_width(4 * um).upper) == pytest.approx(8 * um)  # begins at 0
        jax.jit(lambda t: made.bearing_clearance.with_half_width(t).upper)(4 * um)
    with pytest.warns(UserWarning, match=r"half_width = 2e-06: .* from -5e-07 on, but a clearance cannot be negative"):
        assert made.bearing_clearance.with_half_width(2 * um).lower == pytest.approx(-0.5 * um)
    with pytest.warns(UserWarning, match="a clearance cannot be negative"):
        Population.of(made).with_half_widths({"bearing_clearance": 2 * um})


def test_a_tolerance_is_a_tree_of_its_numbers():
    tolerance = Tolerance(-1.0, 1.0, distribution="uniform", shape=(3,))
    again = jax.tree.map(lambda x: x, tolerance)
    assert (again.distribution, again.shape, again.upper) == ("uniform", (3,), 1.0)
    assert isinstance(tolerance.upper, float)
    np.testing.assert_allclose(jax.jit(lambda t: t.deviate(jnp.zeros(3)))(tolerance), 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(lower=2.0, upper=1.0), r"Tolerance.lower = 2: lies above upper = 1"),
        (dict(lower=0.0, upper=math.inf), r"Tolerance.upper = inf: must be one finite number"),
        (dict(lower=0.0, upper=1.0, cp=-1.0), r"Tolerance.cp = -1: must be positive"),
        (dict(lower=0.0, upper=1.0, shift=1.0), r"Tolerance.shift = 1: must lie between -1 and 1"),
        (
            dict(lower=0.0, upper=1.0, shift=0.5, distribution="uniform"),
            r"Tolerance.shift = 0.5: must be 0 for uniform",
        ),
        (dict(lower=0.0, upper=1.0, distribution="gauss"), r"Tolerance.distribution = 'gauss': unknown"),
        (dict(lower=0.0, upper=1.0, distribution="beta"), r"Tolerance.beta = None: give \(p, q\)"),
        (dict(lower=0.0, upper=1.0, beta=(1.0, 2.0)), r"Tolerance.beta = \(1.0, 2.0\): give \(p, q\) with"),
        (dict(lower=0.0, upper=1.0, distribution="beta", beta=(1.0, -2.0)), r"two positive numbers"),
        (dict(lower=1.0, upper=2.0, distribution="rayleigh"), r"Tolerance.lower = 1: must be 0 for rayleigh"),
        (dict(lower=0.0, upper=1.0, batch=1.0), r"Tolerance.batch = 1: must be a number from 0 to below 1"),
        (dict(lower=0.0, upper=1.0, size=0.6), r"size = 0.6 m: the table of grades covers"),
        (dict(lower=0.0, upper=1.0, shape=(1.5,)), r"Tolerance.shape = \(1.5,\): must be a tuple of sizes"),
    ],
)
def test_bad_tolerances_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Tolerance(**arguments)


def test_grades_of_the_table():
    assert it_width("IT6", 25 * mm) == pytest.approx(13 * um)
    assert it_width("IT7", 30 * mm) == pytest.approx(21 * um)  # a step includes its end ...
    assert it_width("IT7", 30.001 * mm) == pytest.approx(25 * um)  # ... and the next begins above it
    assert it_width("IT01", 2 * mm) == pytest.approx(0.3 * um)
    assert it_width("IT11", 500 * mm) == pytest.approx(400 * um)
    symmetric = Tolerance.grade("IT6", 25 * mm, distribution="uniform")
    assert (symmetric.lower, symmetric.upper, symmetric.size) == pytest.approx((-6.5 * um, 6.5 * um, 25 * mm))


def test_grades_follow_the_standard_s_formula():
    """i = 0.45 D^(1/3) + 0.001 D um with D the geometric mean of the step; within the standard's own rounding."""
    ends = [6, 10, 18, 30, 50, 80, 120, 180, 250, 315, 400, 500]
    multiples = dict(zip(GRADES[6:], (7, 10, 16, 25, 40, 64, 100)))
    for start, end in itertools.pairwise(ends):
        d = math.sqrt(start * end)
        unit = 0.45 * d ** (1 / 3) + 0.001 * d
        for grade, multiple in multiples.items():
            assert multiple * unit == pytest.approx(it_width(grade, end * mm) / um, rel=0.07)
        fine = {"IT01": 0.3 + 0.008 * d, "IT0": 0.5 + 0.012 * d, "IT1": 0.8 + 0.020 * d}
        ratio = (7 * unit / fine["IT1"]) ** 0.25  # IT2 .. IT4 in geometric progression between IT1 and IT5
        fine |= {f"IT{k}": fine["IT1"] * ratio ** (k - 1) for k in (2, 3, 4)}
        for grade, width in fine.items():
            assert width == pytest.approx(it_width(grade, end * mm) / um, rel=0.26)
    widths = np.array([[it_width(grade, end * mm) for grade in GRADES] for end in ends])
    assert (np.diff(widths, axis=1) > 0).all()
    assert (np.diff(widths, axis=0) >= 0).all()


@pytest.mark.parametrize(("grade", "size", "message"), [
    ("IT12", 0.025, "grade = 'IT12': unknown"),
    ("6", 0.025, "grade = '6': unknown"),
    ("IT6", 0.0, "size = 0 m"),
    ("IT6", 25.0, "size = 25 m: the table of grades covers sizes above 0 and up to 0.5 m"),
])  # fmt: skip
def test_bad_grades_are_named(grade, size, message):
    with pytest.raises(ValueError, match=message):
        it_width(grade, size)


def test_a_tolerance_may_stand_in_an_error_record():
    errors = rvjax.RVErrors(bearing_clearance=Tolerance(-1 * um, 1 * um))
    assert errors.bearing_clearance.upper == 1 * um
