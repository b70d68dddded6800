"""Laws with parameters of their own: lognormal, von Mises directions, measured values.

Oracles: SciPy's distributions; integrals of the maps over the standard normal law by 400-point Gauss-Legendre
quadrature; NumPy's figures of the data. Tolerances: tables are cubic Hermite pieces of width 0.0022 in z with exact
slopes, whose error is below 1e-11 of the range; single precision keeps 24 bits, times the derivative of the map.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from rvjax.study.tolerances import parse_tolerance
from rvjax.tolerances import Requirement, Tolerance, load, monte_carlo, rss, sample, save, worst_case
from rvjax.units import um

Z = np.linspace(-6.0, 6.0, 49)
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(400)
POINTS, WEIGHTS = 9 * POINTS, 9 * WEIGHTS * stats.norm.pdf(9 * POINTS)
MEASURED = np.random.default_rng(5).gamma(2.0, 1.0, 40)

SKEW = Tolerance(-1.0, 3.0, distribution="lognormal", log_sd=0.4, cp=0.9)
DATA = Tolerance(0.0, 8.0, distribution="empirical", values=MEASURED)


@jax.jit
def deviated(tolerance, z):
    """Errors by one program, not by one for each operation."""
    return tolerance.deviate(z)


def turned(concentration, direction=0.7, shape=(2,), **options):
    """Vectors of scale 1 with a preferred direction."""
    own = dict(concentration=concentration, direction=direction, distribution="von_mises")
    return Tolerance(0.0, 3.0, shape=shape, **own, **options)


def by_quadrature(values):
    """Mean and central moments 2 .. 4 of values at POINTS."""
    mean = WEIGHTS @ values
    return [mean, *(WEIGHTS @ (values - mean) ** k for k in (2, 3, 4))]


def test_lognormal_is_scipy_s():
    law = stats.lognorm(0.4, loc=-1.0, scale=4 * math.exp(-3 * 0.9 * 0.4))
    np.testing.assert_allclose(deviated(SKEW, Z), law.ppf(stats.norm.cdf(Z)), rtol=1e-7)  # ppf of 1 - 1e-9
    mean, variance, third, fourth = SKEW.moments()
    m, v, skew, kurtosis = law.stats("mvsk")
    np.testing.assert_allclose([mean, variance, third], [m, v, skew * v**1.5], rtol=1e-10)
    assert fourth == pytest.approx((kurtosis + 3) * v**2, rel=1e-10)
    assert law.sf(3.0) == pytest.approx(stats.norm.sf(2.7))  # rejects above the limit as for a normal law of cp 0.9
    nearly = Tolerance(-1.0, 3.0, distribution="lognormal", log_sd=1e-6)  # where raw moments would lose all digits
    assert nearly.moments()[1] == pytest.approx((4e-6) ** 2, rel=1e-5)
    scaled = SKEW.with_half_width(1.0)
    assert (scaled.lower, scaled.upper) == (-1.0, 1.0)


@pytest.mark.parametrize("concentration", [0.5, 2000.0, *(pytest.param(k, marks=pytest.mark.long) for k in (0.0, 8.0))])
def test_directions_are_scipy_s(concentration):
    z = np.stack([np.zeros_like(Z), Z])
    x, y = np.asarray(deviated(turned(concentration), z))
    angle = np.angle((x + 1j * y) * np.exp(-0.7j))
    if concentration < 50:  # beyond, SciPy's own figure is a normal approximation
        share = stats.vonmises.cdf(angle, concentration) if concentration else 0.5 + angle / (2 * math.pi)
        inner = np.abs(Z) < 5.5  # shares nearer to 1 than 1e-8 hold no digits in a difference
        np.testing.assert_allclose(share[inner], stats.norm.cdf(Z[inner]), atol=2e-12)
    else:  # narrow: normal with 1/k, to first order of 1/k
        inner = np.abs(Z) < 3
        np.testing.assert_allclose(angle[inner] * math.sqrt(concentration), Z[inner], atol=3e-3)
    np.testing.assert_allclose(np.hypot(x, y), math.sqrt(2 * math.log(2)), rtol=1e-12)  # the median magnitude


@pytest.mark.parametrize("concentration", [3.0, pytest.param(0.0, marks=pytest.mark.long)])
def test_moments_of_directed_vectors(concentration):
    tolerance = turned(concentration, shape=(3, 2))
    first, second = np.meshgrid(POINTS, POINTS, indexing="ij")
    z = np.broadcast_to(np.stack([first.ravel(), second.ravel()]), (3, 2, first.size))
    errors = np.asarray(deviated(tolerance, z))[1]
    weights = np.outer(WEIGHTS, WEIGHTS).ravel()
    mean = errors @ weights
    moved = errors - mean[:, None]
    found = tolerance.moments()
    for k, expected in enumerate([mean, *((moved**k) @ weights for k in (2, 3, 4))]):
        assert found[k].shape == (3, 2)
        np.testing.assert_allclose(found[k][1], expected, atol=1e-7)  # quadrature over a root at 0 magnitude
    covariance = (moved[0] * moved[1]) @ weights
    coupling = tolerance.law.correlation(tolerance)[0, 1]
    assert coupling * np.sqrt(found[1][0].prod()) == pytest.approx(covariance, abs=1e-7)


def test_no_concentration_is_the_law_of_plain_vectors():
    moments = [Tolerance(0.0, 3.0, distribution="rayleigh", shape=(2,)).moments(), turned(0.0).moments()]
    np.testing.assert_allclose(np.stack([np.broadcast_to(m, 2) for m in moments[0]]), np.stack(moments[1]), atol=1e-14)


def test_measured_values_are_their_order_statistics():
    ordered, n = np.sort(MEASURED), len(MEASURED)
    shares = (np.arange(n) + 0.5) / n
    found = deviated(DATA, special.ndtri(shares))
    np.testing.assert_allclose(found, ordered, rtol=1e-12)
    expected = np.interp(stats.norm.cdf(Z), shares, ordered)
    np.testing.assert_allclose(deviated(DATA, Z), expected, rtol=1e-12)
    mean, variance, third, fourth = DATA.moments()
    assert mean == pytest.approx(MEASURED.mean(), rel=1e-14)
    # Linear pieces: the data's own variance, less what a straight line between neighbours leaves out.
    gaps = np.diff(ordered)
    assert variance == pytest.approx(MEASURED.var() - (gaps**2).sum() / (6 * n), rel=1e-12)
    u = (np.arange(400_000) + 0.5) / 400_000
    moved = np.interp(u, shares, ordered) - mean
    np.testing.assert_allclose([third, fourth], [(moved**3).mean(), (moved**4).mean()], rtol=1e-8)
    half = DATA.with_half_width(2.0)
    np.testing.assert_allclose(half.law.values, 4 + (ordered - 4) / 2)
    assert (half.lower, half.upper) == (2.0, 6.0)
    one = Tolerance(0.0, 2.0, distribution="empirical", values=[1.5])
    np.testing.assert_array_equal(deviated(one, Z), 1.5)


@pytest.mark.parametrize("tolerance", [SKEW, DATA, turned(4.0)], ids=lambda t: t.distribution)
def test_derivatives_are_those_of_the_value_and_finite(tolerance):
    z = np.stack([Z[1:-1], Z[-2:0:-1]]) if tolerance.is_vector else Z[1:-1] + 0.0123
    total = jax.jit(lambda t, z: jnp.sum(tolerance.with_half_width(t).deviate(z)))
    by_t, by_z = map(np.asarray, jax.grad(total, argnums=(0, 1))(2.0, jnp.asarray(z)))
    value = lambda t, z: float(total(t, jnp.asarray(z)))  # noqa: E731
    step = 1e-5
    assert by_t == pytest.approx((value(2 + step, z) - value(2 - step, z)) / (2 * step), rel=1e-8)
    assert np.isfinite(by_z).all()
    moved = value(2.0, z + step) - value(2.0, z - step)
    assert by_z.sum() == pytest.approx(moved / (2 * step), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("tolerance", [SKEW, DATA, turned(4.0)], ids=lambda t: t.distribution)
def test_single_precision(tolerance):
    z = np.stack([Z, Z[::-1]]) if tolerance.is_vector else Z
    z = np.clip(z, -4.0, 4.0)
    exact = np.asarray(deviated(tolerance, z))
    found = deviated(tolerance, jnp.asarray(z, jnp.float32))
    assert found.dtype == jnp.float32
    # Phi(z) of 24 bits, and 40 order statistics or angles up to pi on it: 8 eps of the range leaves a margin of 4.
    np.testing.assert_allclose(found, exact, atol=32 * np.finfo(np.float32).eps * np.abs(exact).max())


MIXED = {"skew": SKEW, "data": DATA, "runout": turned(3.0, shape=(2, 2))}


def response(e):
    return e["skew"] + 2 * e["data"] + e["runout"][0, 0] - 3 * e["runout"][1, 1] + e["runout"][0, 1]


@pytest.mark.long  # each law alone is held above, each use with other laws in its own file
def test_every_use_of_a_law(tmp_path):
    linear = rss(response, MIXED)
    found = monte_carlo(response, MIXED, samples=50_000, seed=1, requirements=Requirement(upper=30.0))
    assert abs(found.mean.value - linear.mean) < 4 * found.mean.error
    assert abs(found.sd.value - linear.sd) < 4 * found.sd.error  # with the covariance of the first vector's components
    limits = worst_case(response, MIXED)
    # Discs of radius 3: |(1, 1)| and 3 times; boxes of half-widths 2 and 4 about 1 and 4.
    assert limits.upper == pytest.approx(1 + 8 + 2 + 8 + 3 * math.sqrt(2) + 9)
    path = tmp_path / "units.npz"
    save(MIXED, path)
    again = load(path)
    units = [jax.jit(lambda given: sample(given, 7, seed=3))(given) for given in (MIXED, again)]
    for name in MIXED:
        np.testing.assert_array_equal(units[0][name], units[1][name])
    assert found.study["tolerances.skew"] == "lognormal -1.0 .. 3.0, cp 0.9, log_sd 0.4"
    other = monte_carlo(response, MIXED | {"data": DATA.replace(values=MEASURED + 1e-15)}, samples=1, seed=1)
    assert other.study["tolerances.data"] != found.study["tolerances.data"]


def test_correlated_laws_are_known_to_rss_or_refused(thorough):
    if thorough:  # test_study_placed.py has rss of correlated errors by default
        pair = {"skew": SKEW, "data": DATA}
        correlation = {("skew", "data"): 0.6}
        linear = rss(lambda e: e["skew"] + e["data"], pair, correlation=correlation)
        first, second = (np.asarray(deviated(t, POINTS)) for t in pair.values())
        x, y = np.meshgrid(POINTS, POINTS, indexing="ij")
        other = np.asarray(deviated(DATA, 0.6 * x + 0.8 * y))
        covariance = WEIGHTS @ ((first - WEIGHTS @ first)[:, None] * other) @ WEIGHTS
        expected = by_quadrature(first)[1] + by_quadrature(second)[1] + 2 * covariance
        # Kinks of the measured law: quadrature and the 23 Hermite terms agree to parts in a thousand.
        assert linear.sd**2 == pytest.approx(expected, rel=2e-3)
    with pytest.raises(ValueError, match="runout: rss does not include correlated von_mises vectors"):
        rss(response, MIXED, correlation={("runout[0,0]", "skew"): 0.3})
    with pytest.raises(ValueError, match="order = 2: correlated errors must be normal"):
        rss(response, MIXED, order=2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(distribution="lognormal"), r"Tolerance.log_sd = None: give the standard deviation of the logarithm"),
        (dict(distribution="lognormal", log_sd=-1.0), r"Lognormal.log_sd = -1: must be positive"),
        (dict(distribution="lognormal", log_sd=20.0), r"Tolerance.log_sd = 20: must be at most 9"),
        (dict(distribution="lognormal", log_sd=1.0, shift=0.1), r"Tolerance.shift = 0.1: must be 0 for lognormal"),
        (dict(log_sd=1.0), r"Tolerance.log_sd = 1: give .* with distribution='lognormal', and only there"),
        (dict(distribution="empirical", values=[]), r"Tolerance.values = .*: must be one row of finite numbers"),
        (dict(distribution="empirical", values=[1.0, math.nan]), r"must be one row of finite numbers"),
        (dict(distribution="von_mises", concentration=-1.0), r"Tolerance.concentration = -1: must be a number from 0"),
    ],
)
def test_bad_parameters_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Tolerance(0.0, 1.0, **arguments)


def test_the_widest_lognormal_law_has_moments():
    assert np.isfinite(Tolerance(0.0, 1.0, distribution="lognormal", log_sd=9.0).moments()).all()


def test_a_direction_needs_a_vector_and_no_argument_is_forgotten():
    with pytest.raises(ValueError, match=r"a: von_mises is for vectors .* this field has \(\)"):
        sample({"a": turned(1.0, shape=())}, 0, seed=0)
    with pytest.raises(TypeError, match="unexpected argument 'bta'"):
        Tolerance(0.0, 1.0, bta=(1, 2))


def test_study_files_read_every_parameter(tmp_path):
    where = "tolerances.x"
    skew = parse_tolerance(dict(half_width="2 um", distribution="lognormal", log_sd=0.3, cp=1.2), "m", where)
    assert (skew.distribution, skew.law.log_sd, skew.cp, skew.upper) == ("lognormal", 0.3, 1.2, pytest.approx(2 * um))
    turn = dict(lower="0 um", upper="9 um", distribution="von_mises", concentration=2.0, direction="30 deg")
    assert parse_tolerance(turn, "m", where).law.direction == pytest.approx(math.pi / 6)
    limits = dict(lower="0 um", upper="9 um", distribution="empirical")
    np.testing.assert_allclose(
        parse_tolerance(limits | dict(values=["3 um", "1 um"]), "m", where).law.values, [1e-6, 3e-6]
    )
    file = tmp_path / "parts.csv"
    file.write_text("part,deviation\nA,2.5\nB,-1\n")
    column = dict(file=str(file), column="deviation", unit="um")
    np.testing.assert_allclose(parse_tolerance(limits | dict(values=column), "m", where).law.values, [-1e-6, 2.5e-6])
    file.write_text("deviation\n2.5\n-1\n", "utf-8-sig")  # as Excel begins a file
    np.testing.assert_allclose(parse_tolerance(limits | dict(values=column), "m", where).law.values, [-1e-6, 2.5e-6])
    file.write_text("Teil;Abmaß [µm]\nA;2,5\nB;\nC;-1,0\n", "utf-8-sig")  # a part that was not measured
    german = dict(file=str(file), column="Abmaß")
    np.testing.assert_allclose(parse_tolerance(limits | dict(values=german), "m", where).law.values, [-1e-6, 2.5e-6])
    file.write_text("deviation\n2.5\n-1\n")
    plain = dict(half_width=3, distribution="empirical", values=column | dict(unit="-"))
    np.testing.assert_allclose(parse_tolerance(plain, "-", where).law.values, [-1.0, 2.5])
    file.write_text("part,deviation\nA,2.5\nB,-1\n")
    for change, message in [
        (dict(column="x"), r"columns.values = 'x': no column of the file; it has part, deviation"),
        (dict(column="part"), "row 2, values = 'A': must be a number in um"),
        (dict(unit="furlong"), r"values.unit = 'furlong': is not one of"),
        (dict(file="absent.csv"), r"values.file = 'absent.csv': cannot be read"),
    ]:
        with pytest.raises(ValueError, match=message):
            parse_tolerance(limits | dict(values=column | change), "m", where)
    with pytest.raises(ValueError, match="log_sd = 'much': must be a plain finite number"):
        parse_tolerance(dict(half_width="2 um", distribution="lognormal", log_sd="much"), "m", where)
    with pytest.raises(ValueError, match="values = '3 um': must be a list"):
        parse_tolerance(limits | dict(values="3 um"), "m", where)
    with pytest.raises(ValueError, match=r"unknown key tolerances.x.log_sd"):
        parse_tolerance(limits | dict(values=["3 um"], log_sd=1.0), "m", where)
