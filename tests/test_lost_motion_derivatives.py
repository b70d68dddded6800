"""Lost motion: derivatives.

Oracles: partial derivatives written out below (1e-12, both are closed forms) and central differences (1e-6, their
truncation and cancellation meet there in float64).
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lost_motion_cases import TRUE_K1, cycloid, numbers, solve

from rvjax import RVErrors
from rvjax.catalogue import RV_20E, RV_20E_ERRORS
from rvjax.errors import read_by
from rvjax.lost_motion import geometric
from rvjax.lost_motion.outputs import PROFILES
from rvjax.units import arcmin, mm, um

READ = read_by(RVErrors, "lost_motion")
# Exact contact compiles long; its gradient is held against differences in test_lost_motion_flank.py.
EACH = [pytest.param(p, marks=pytest.mark.long) if p == "contact" else p for p in PROFILES]


@cache
def _gradient(profile):
    return jax.jit(jax.grad(lambda design, errors: geometric(design, errors, profile=profile).total, argnums=(0, 1)))


def gradient(profile, design, errors):
    """Gradient of the total to design and errors, compiled once for designs with a given K1."""
    return _gradient(profile)(numbers(design), numbers(errors))


def with_its_k1(design, profile):
    """As tests of values have it, so that they share programs: exact contact derives K1, which it does not read."""
    return cycloid(design, shortening=None) if profile == "contact" else design


@pytest.mark.parametrize("profile", EACH)
def test_zero_errors_give_exactly_zero_and_finite_gradients(profile, thorough):
    # The K1 that follows from the lengths, given as a number.
    design = cycloid(RV_20E, equidistant_modification=0.0, shift_modification=0.0)
    design = cycloid(design, shortening=TRUE_K1.cycloid.shortening_coefficient)
    errors = RVErrors()
    result = solve(with_its_k1(design, profile), errors, profile=profile)
    assert result.valid
    assert all(leaf == 0 for leaf in jax.tree.leaves((result.total, result.play, result.terms)))
    found = gradient(profile, design, errors)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found))
    sum_of_terms = gradient("first_order", design, errors)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-13), found, sum_of_terms)

    def of_some(x):
        some = RVErrors(eccentricity=x[0], pin_radius=x[1], pin_circle_radius=x[2])
        return geometric(design, some, profile=profile).total

    if profile == "first_order" or thorough:  # three quarters of the time
        assert np.all(np.isfinite(jax.jit(jax.hessian(of_some))(jnp.zeros(3))))


def partial_derivatives(design, errors):
    """By hand, for the sum of terms (Liu et al. 2022, Eq. 12 to 20); e, r_p and K1 as three separate numbers."""
    stage, first = design.cycloid, design.involute
    e, zc, zp, rp, k1 = stage.eccentricity, stage.disc_teeth, stage.pin_count, stage.pin_circle_radius, 0.72
    x, y = stage.equidistant_modification, stage.shift_modification
    s, per = np.sqrt(1 - k1**2), 1 / (e * zc)
    backlash = -1 / (2 * first.sun_radius * 141 * np.cos(first.pressure_angle))
    span = errors.base_tangent_upper + errors.base_tangent_lower
    k_n = x * per / e - (zp**2 / (zc * rp**2 * s) + s * per / e) * y
    return {
        "base_tangent_upper": backlash,
        "base_tangent_lower": backlash,
        "pin_circle_radius": 2 * s * per,
        "pin_radius": -2 * per,
        "pin_hole_clearance": per,
        "disc_runout": per / 2,
        "pin_position": 2 * k1 * per,
        "disc_cumulative_pitch": -k1 * per,
        "equidistant_modification": 2 * per,
        "shift_modification": -2 * s * per,
        "eccentricity": -2 * k_n,
        "bearing_clearance": 2 / first.centre_distance,
    }, {
        ("involute", "sun_radius"): -backlash * span / first.sun_radius,
        ("involute", "pressure_angle"): backlash * span * np.tan(first.pressure_angle),
        ("involute", "centre_distance"): -2 * errors.bearing_clearance / first.centre_distance**2,
        ("cycloid", "equidistant_modification"): 2 * per - 2 * errors.eccentricity * per / e,
        ("cycloid", "shift_modification"): -2 * s * per
        + 2 * errors.eccentricity * (zp**2 / (zc * rp**2 * s) + s * per / e),
        ("cycloid", "pin_circle_radius"): -4 * errors.eccentricity * zp**2 * y / (zc * rp**3 * s),
    }


def test_gradient_equals_the_table_of_partial_derivatives():
    by_design_found, by_error_found = gradient("first_order", RV_20E, RV_20E_ERRORS)
    by_error, by_design = partial_derivatives(RV_20E, RV_20E_ERRORS)
    assert set(by_error) == set(READ)
    for name, value in by_error.items():
        np.testing.assert_allclose(getattr(by_error_found, name), value, rtol=1e-12, err_msg=name)
    for (part, name), value in by_design.items():
        np.testing.assert_allclose(getattr(getattr(by_design_found, part), name), value, rtol=1e-12, err_msg=name)
    # Published-style sensitivities, arcmin per mm
    for name, value in dict(
        pin_circle_radius=135.938, pin_radius=-195.883, bearing_clearance=250.018, eccentricity=-1.4398
    ).items():
        assert getattr(by_error_found, name) * mm / arcmin == pytest.approx(value, abs=5e-4 if abs(value) > 9 else 5e-5)


@pytest.mark.parametrize("profile", EACH)
def test_numbers_that_are_not_read_have_no_derivative(profile):
    errors = RVErrors(**{name: getattr(RV_20E_ERRORS, name) for name in READ})
    by_design, by_error = gradient(profile, RV_20E, errors)
    for name, value in vars(by_error).items():
        if name not in READ:
            assert np.all(value == 0), name
        elif name != "eccentricity":
            assert value != 0, name
    assert by_design.cranks.circle_radius == 0 and by_design.cycloid.pin_radius == 0 and by_design.involute.module == 0
    assert (by_design.cycloid.shortening == 0) == (profile == "contact")
    # and a NaN in them is nobody's business
    nan = errors.replace(crank_phase=np.nan, disc_bore=np.nan)
    assert solve(with_its_k1(RV_20E, profile), nan, profile=profile).valid


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"profile": "closed_form"},
        pytest.param({"profile": "contact"}, marks=pytest.mark.long),
        {"reading": "as_printed"},
    ],
)
def test_derivatives_equal_finite_differences(options, thorough):
    errors = RV_20E_ERRORS.replace(pin_radius=-0.008 * mm)
    names = ("pin_circle_radius", "pin_radius", "eccentricity", "equidistant_modification", "bearing_clearance")
    nominal = np.array([getattr(errors, name) for name in names] + [0.9 * mm, 52 * mm, 27.5 * mm, 0.01, 3e-6])

    def total(x):
        design = TRUE_K1.replace(involute=TRUE_K1.involute.replace(centre_distance=x[7]))
        design = cycloid(design, eccentricity=x[5], pin_circle_radius=x[6])
        return geometric(
            design, errors.replace(**dict(zip(names, x[:5]))), tilt=x[8], centre_shift=x[9], **options
        ).total

    step = np.array([1e-7] * 5 + [1e-7, 1e-6, 1e-6, 1e-4, 1e-6])
    n = len(step)
    points = np.concatenate([nominal[None] + np.diag(step), nominal[None] - np.diag(step), nominal[None]])
    both = jax.jit(jax.value_and_grad(total))
    values, slopes = (np.stack(part) for part in zip(*map(both, points)))
    gradient, difference = slopes[-1], (values[:n] - values[n:-1]) / (2 * step)
    np.testing.assert_allclose(gradient, difference, rtol=1e-6, atol=1e-9 * np.abs(gradient).max())
    if options.get("profile") == "contact" or (options and not thorough):
        return  # the flank's second derivatives are checked on their own
    # Second derivatives: scaled by the step so that one tolerance fits all
    second = (slopes[:n] - slopes[n:-1]) / (2 * step[:, None])
    hessian = jax.jit(jax.hessian(total))(nominal)
    scale = np.sqrt(np.abs(np.outer(step, step)))
    np.testing.assert_allclose(hessian * scale, second * scale, rtol=2e-5, atol=2e-6 * np.abs(hessian * scale).max())


def test_exact_second_derivatives_with_the_eccentricity_error():
    def total(modification):
        design = cycloid(RV_20E, equidistant_modification=modification[0], shift_modification=modification[1])
        return geometric(design, RV_20E_ERRORS.replace(eccentricity=modification[2])).total

    hessian = jax.jit(jax.hessian(total))(jnp.array([-0.01 * mm, -0.012 * mm, 0.005 * mm]))
    e, zc, zp, rp, s = 0.9 * mm, 39, 40, 52 * mm, np.sqrt(1 - 0.72**2)
    expected = np.zeros((3, 3))
    expected[0, 2] = expected[2, 0] = -2 / (e**2 * zc)
    expected[1, 2] = expected[2, 1] = 2 * (zp**2 / (zc * rp**2 * s) + s / (e**2 * zc))
    np.testing.assert_allclose(hessian, expected, rtol=1e-12, atol=1e-9)


def test_eccentricity_coefficient_is_the_derivative_of_the_nominal_terms():
    """K_n = -1/2 d(gamma_D + gamma_y)/de at fixed pin circle, K1 derived (Eq. 17, mended)."""

    def nominal(e):
        terms = geometric(cycloid(TRUE_K1, eccentricity=e), RVErrors()).terms
        return terms.nominal_equidistant + terms.nominal_shift

    slope = jax.grad(nominal)(0.9 * mm)
    error = RVErrors(eccentricity=1 * um)
    np.testing.assert_allclose(geometric(TRUE_K1, error).terms.eccentricity, slope * 1 * um, rtol=1e-12)
