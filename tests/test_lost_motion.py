"""Lost motion: the sum of terms, its readings, statuses and derivatives.

Oracles: tests/reference/lost_motion.json (evaluated with 40 digits; 1e-12 relative, contact 1e-7 guaranteed there);
the published Table 5 and totals of Liu et al. 2022; partial derivatives written out below (1e-12, both are closed
forms) and central differences (1e-6, their truncation and cancellation meet there in float64).
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import RVErrors, Status
from rvjax.catalogue import RV_20E, RV_20E_ERRORS
from rvjax.lost_motion import empirical_normal_force, geometric, shaft_tilt
from rvjax.lost_motion.reducer import ERRORS_READ, PROFILES
from rvjax.units import arcmin, deg, mm, um

solve = jax.jit(geometric, static_argnames=("reading", "profile"))
TRUE_K1 = jax.tree.map(lambda x: x, RV_20E).replace(cycloid=RV_20E.cycloid.replace(shortening=None))


def cycloid(design, **changes):
    return design.replace(cycloid=design.cycloid.replace(**changes))


def inputs(case):
    """Design, errors and options of a reference case. Built as a pytree: the values may be invalid on purpose."""
    given = case["design"]
    counts = {name: given[name] for name in ("sun_teeth", "planet_teeth")}
    involute = RV_20E.involute.replace(
        **counts,
        centre_distance=given["centre_distance"] * mm,
        sun_radius=given["sun_radius"] * mm,
        pressure_angle=given["pressure_angle_deg"] * deg,
    )
    lengths = ("eccentricity", "pin_circle_radius", "equidistant_modification", "shift_modification")
    design = RV_20E.replace(involute=involute)
    design = cycloid(design, shortening=None, disc_teeth=given["disc_teeth"], pin_count=given["pin_count"])
    design = cycloid(design, **{name: given[name] * mm for name in lengths})
    if given["shortening"] is not None:
        leaves, tree = jax.tree.flatten(cycloid(design, shortening=0.123))
        design = jax.tree.unflatten(tree, [given["shortening"] if leaf == 0.123 else leaf for leaf in leaves])
    errors = RVErrors(**{name: value * mm for name, value in case["errors"].items()})
    options = dict(case["options"])
    options["tilt"] = options.pop("tilt_deg") * deg
    options["centre_shift"] *= mm
    return design, errors, options


def test_reference_cases(reference):
    cases = [case for case in reference("lost_motion")["cases"] if case["kind"].startswith("geometric")]
    assert len(cases) == 21
    for case in cases:
        design, errors, options = inputs(case)
        result, expected = solve(design, errors, **options), case["expect"]
        assert bool(result.valid) == expected["valid"], case["name"]
        assert Status(int(result.info.status)).name == expected.get("status", "CONVERGED"), case["name"]
        assert bool(result.valid) == (int(result.info.status) == Status.CONVERGED)
        if expected["total_arcmin"] is None:
            assert all(np.isnan(leaf) for leaf in jax.tree.leaves((result.total, result.play, result.terms)))
            continue
        tolerance = dict(rtol=case["tolerance"]["relative"], atol=case["tolerance"]["absolute_arcmin"])
        np.testing.assert_allclose(result.total / arcmin, expected["total_arcmin"], **tolerance, err_msg=case["name"])
        np.testing.assert_allclose(result.play / arcmin, expected["play_arcmin"], **tolerance)
        terms = {name: float(value) / arcmin for name, value in vars(result.terms).items()}
        assert terms.keys() == expected["terms_arcmin"].keys()
        for name, value in expected["terms_arcmin"].items():
            np.testing.assert_allclose(terms[name], value, **tolerance, err_msg=f"{case['name']}: {name}")
        assert sum(terms.values()) == pytest.approx(float(result.total) / arcmin, rel=1e-12, abs=1e-13)


# Rows of Table 5 of Liu et al. 2022: output torque N m, output tilt deg, deflection mm, input tilt deg, deflection mm.
TABLE_5 = """
200 0.00153 0.0042626 0.0000344 0.000072051
190 0.00145 0.0040486 0.0000324 0.000067906
180 0.00137 0.0038346 0.0000309 0.000064796
170 0.00130 0.0036207 0.0000289 0.000060649
160 0.00122 0.0034067 0.0000272 0.000057021
150 0.00114 0.0031927 0.0000255 0.000053393
140 0.00107 0.0029788 0.0000238 0.000049765
130 0.00099 0.0027648 0.0000220 0.000046136
120 0.00091 0.0025508 0.0000203 0.000042508
110 0.00083 0.0023369 0.0000186 0.000038879
100 0.00076 0.0021229 0.0000166 0.000034733
90 0.00068 0.0019089 0.0000149 0.000031105
80 0.00060 0.0016945 0.0000131 0.000027477
70 0.00053 0.00148105 0.0000114 0.000023848
60 0.00045 0.0012665 0.0000096 0.000020215
50 0.00037 0.0010531 0.0000076 0.000016074
40 0.00030 0.00083909 0.0000059 0.000012446
30 0.00022 0.00062512 0.0000042 0.0000088175
20 0.00014 0.00041115 0.0000024 0.0000051894
10 0.00007 0.00019718 0.0000007 0.0000015612
"""


def test_table_5_all_forty_angles():
    table = np.array([line.split() for line in TABLE_5.strip().splitlines()], float)
    assert table.shape == (20, 5)
    tilt = jax.vmap(shaft_tilt, in_axes=(0, None))
    output, entry = tilt(table[:, 2] * mm, 160 * mm) / deg, tilt(table[:, 4] * mm, 120 * mm) / deg
    # Some rows are rounded, some cut off in the last digit: within one unit of it.
    assert np.max(np.abs(output - table[:, 1])) < 1e-5
    assert np.max(np.abs(entry - table[:, 3])) < 1e-7


def test_shaft_tilt(reference):
    for case in reference("lost_motion")["cases"]:
        if case["kind"] == "shaft_tilt":
            tilt = shaft_tilt(case["deflection"] * mm, case["length"] * mm)
            np.testing.assert_allclose(tilt, case["expect_rad"], rtol=1e-13)
    assert shaft_tilt(2.0, 2.0) == np.pi / 2 and shaft_tilt(-2.0, 2.0) == -np.pi / 2
    assert shaft_tilt(-1e-3, 0.1) == -shaft_tilt(1e-3, 0.1)
    slope = jax.vmap(jax.grad(shaft_tilt), in_axes=(0, None))(jnp.array([-3.0, 0.0, 1.0, 2.0, 2.1]), 2.0)
    np.testing.assert_allclose(slope, [0, 0.5, 1 / np.sqrt(3), np.inf, 0])  # NaN lanes poison nothing
    np.testing.assert_array_equal(np.isnan(shaft_tilt(2.1, 2.0)), True)
    np.testing.assert_array_equal(np.isnan(jax.jit(shaft_tilt)(0.1, -2.0)), True)
    assert shaft_tilt(jnp.float32(1e-3), 0.1).dtype == jnp.float32


def test_published_totals_and_what_they_are_worth():
    def total(**options):
        return float(solve(RV_20E, RV_20E_ERRORS, **options).total / arcmin)

    assert total() == pytest.approx(1.756980, abs=5e-7)  # three times the printed 0.5467
    assert total(reading="as_printed") == pytest.approx(0.548750, abs=5e-7)
    fitted = solve(RV_20E, RV_20E_ERRORS, reading="as_printed", normal_force=0.5075)
    assert fitted.total / arcmin == pytest.approx(0.5467, abs=1e-12) and not fitted.valid
    with pytest.raises(rvjax.SolveError, match="PRESSURE_ANGLE"):
        rvjax.check(fitted)
    # At a fixed force neither tilt nor shift moves the printed total by what Table 10 shows (0.05 and more).
    force = dict(reading="as_printed", normal_force=1.6)
    still = total(**force)
    assert abs(total(**force, tilt=3.44e-5 * deg) - still) < 1e-9
    assert abs(total(**force, centre_shift=4.5 * um) - still) < 6e-5


def test_empirical_normal_force_returns_the_rows_it_was_fitted_to():
    torque = jnp.array([50.0, 80, 110, 140, 170, 200])
    tilt = jnp.array([7.67e-6, 1.31e-5, 1.86e-5, 2.38e-5, 2.89e-5, 3.44e-5]) * deg
    printed = np.array([0.5976, 0.5982, 0.6018, 0.6029, 0.6032, 0.6063])

    def total(torque, tilt):
        force = empirical_normal_force(torque)
        return geometric(RV_20E, RV_20E_ERRORS, reading="as_printed", tilt=tilt, normal_force=force).total

    assert np.max(np.abs(jax.vmap(total)(torque, tilt) / arcmin - printed)) < 1.05e-3
    assert np.isnan(empirical_normal_force(49.0)) and np.isnan(empirical_normal_force(200.1))
    untilted = solve(RV_20E, RV_20E_ERRORS, reading="as_printed", normal_force=1.5081)
    assert abs(untilted.total / arcmin - 0.5462) == pytest.approx(0.048, abs=1e-3)


@pytest.mark.parametrize("profile", PROFILES)
def test_zero_errors_give_exactly_zero_and_finite_gradients(profile):
    design = cycloid(TRUE_K1, equidistant_modification=0.0, shift_modification=0.0)
    result = solve(design, RVErrors(), profile=profile)
    assert result.valid
    assert all(leaf == 0 for leaf in jax.tree.leaves((result.total, result.play, result.terms)))

    def total(design, errors, profile=profile):
        return geometric(design, errors, profile=profile).total

    gradient = jax.jit(jax.grad(total, argnums=(0, 1)))(design, RVErrors())
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
    sum_of_terms = jax.jit(jax.grad(partial(total, profile="first_order"), argnums=(0, 1)))(design, RVErrors())
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-13), gradient, sum_of_terms)

    def of_some(x):
        return total(design, RVErrors(eccentricity=x[0], pin_radius=x[1], pin_circle_radius=x[2]))

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
    both = jax.jit(jax.grad(lambda d, e: geometric(d, e).total, argnums=(0, 1)))
    design_gradient, gradient = both(RV_20E, RV_20E_ERRORS)
    by_error, by_design = partial_derivatives(RV_20E, RV_20E_ERRORS)
    assert set(by_error) == set(ERRORS_READ)
    for name, value in by_error.items():
        np.testing.assert_allclose(getattr(gradient, name), value, rtol=1e-12, err_msg=name)
    for (part, name), value in by_design.items():
        np.testing.assert_allclose(getattr(getattr(design_gradient, part), name), value, rtol=1e-12, err_msg=name)
    # Published-style sensitivities, arcmin per mm
    for name, value in dict(
        pin_circle_radius=135.938, pin_radius=-195.883, bearing_clearance=250.018, eccentricity=-1.4398
    ).items():
        assert getattr(gradient, name) * mm / arcmin == pytest.approx(value, abs=5e-4 if abs(value) > 9 else 5e-5)


@pytest.mark.parametrize("profile", PROFILES)
def test_numbers_that_are_not_read_have_no_derivative(profile):
    errors = RVErrors.for_design(RV_20E, **{name: getattr(RV_20E_ERRORS, name) for name in ERRORS_READ})
    gradient = jax.jit(jax.grad(lambda d, e: geometric(d, e, profile=profile).total, argnums=(0, 1)))
    by_design, by_error = gradient(RV_20E, errors)
    for name, value in vars(by_error).items():
        if name not in ERRORS_READ:
            assert np.all(value == 0), name
        elif name != "eccentricity":
            assert value != 0, name
    assert by_design.cranks.circle_radius == 0 and by_design.cycloid.pin_radius == 0 and by_design.involute.module == 0
    assert (by_design.cycloid.shortening == 0) == (profile == "contact")
    # and a NaN in them is nobody's business
    nan = jax.tree.map(lambda x: x, errors)
    nan = nan.replace(crank_phase=jnp.full(2, jnp.nan), disc_bore=jnp.full((2, 2, 2), jnp.nan))
    assert solve(RV_20E, nan, profile=profile).valid


@pytest.mark.parametrize("options", [{}, {"profile": "closed_form"}, {"profile": "contact"}, {"reading": "as_printed"}])
def test_derivatives_equal_finite_differences(options):
    errors = RV_20E_ERRORS.replace(pin_radius=-0.008 * mm)
    names = ("pin_circle_radius", "pin_radius", "eccentricity", "equidistant_modification", "bearing_clearance")
    nominal = jnp.array([getattr(errors, name) for name in names] + [0.9 * mm, 52 * mm, 27.5 * mm, 0.01, 3e-6])

    def total(x):
        design = TRUE_K1.replace(involute=TRUE_K1.involute.replace(centre_distance=x[7]))
        design = cycloid(design, eccentricity=x[5], pin_circle_radius=x[6])
        return geometric(
            design, errors.replace(**dict(zip(names, x[:5]))), tilt=x[8], centre_shift=x[9], **options
        ).total

    step = jnp.array([1e-7] * 5 + [1e-7, 1e-6, 1e-6, 1e-4, 1e-6])
    n = len(step)
    points = jnp.concatenate([nominal[None] + jnp.diag(step), nominal[None] - jnp.diag(step), nominal[None]])
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(total)))(points)
    gradient, difference = slopes[-1], (values[:n] - values[n:-1]) / (2 * step)
    np.testing.assert_allclose(gradient, difference, rtol=1e-6, atol=1e-9 * np.abs(gradient).max())
    if options.get("profile") == "contact":
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


def test_homogeneous_scale_free_and_even_in_tilt():
    errors = RV_20E_ERRORS.replace(eccentricity=0.0)

    def scaled(design, factor):
        lengths = {name: getattr(design.cycloid, name) * factor for name in ("eccentricity", "pin_circle_radius")}
        design = cycloid(design, **lengths)
        first = design.involute
        first = first.replace(sun_radius=first.sun_radius * factor, centre_distance=first.centre_distance * factor)
        return design.replace(involute=first)

    def modified(design, factor):
        stage = design.cycloid
        return cycloid(
            design,
            equidistant_modification=stage.equidistant_modification * factor,
            shift_modification=stage.shift_modification * factor,
        )

    once, thrice = (solve(modified(RV_20E, x), jax.tree.map(lambda v, x=x: v * x, errors)).total for x in (1.0, 3.0))
    np.testing.assert_allclose(thrice, 3 * once, rtol=1e-13)
    for profile in PROFILES:
        one = solve(TRUE_K1, RV_20E_ERRORS, profile=profile).total
        larger = jax.tree.map(lambda v: v * 10, RV_20E_ERRORS)
        ten = solve(modified(scaled(TRUE_K1, 10.0), 10.0), larger, profile=profile).total
        np.testing.assert_allclose(ten, one, rtol=1e-12)
    left, right = (solve(RV_20E, RV_20E_ERRORS, tilt=tilt).total for tilt in (-0.02, 0.02))
    assert left == right
    loose, tight = solve(RV_20E, RV_20E_ERRORS), solve(RV_20E, RVErrors())
    assert loose.play == loose.total > 0 and tight.total < 0 and tight.play == 0


def test_statistics_of_the_table_9_bands():
    """The sum is linear in the errors: mean, spread and extremes follow from the gradient."""
    signed = dict(
        pin_circle_radius=10, pin_radius=4, eccentricity=5, equidistant_modification=1, shift_modification=3
    )  # um
    positive = dict(disc_runout=15, disc_cumulative_pitch=19, pin_hole_clearance=5, bearing_clearance=1)
    low = {name: -value * um for name, value in signed.items()} | dict.fromkeys(positive, 0.0)
    high = {name: value * um for name, value in (signed | positive).items()}

    def total(x):
        bands = {name: low[name] + (high[name] - low[name]) * value for name, value in zip(high, x)}
        span = (-30.9 + 34.4 * x[-1]) * um
        return geometric(RV_20E, RVErrors(**bands, base_tangent_upper=span, base_tangent_lower=span)).total / arcmin

    middle = jnp.full(len(high) + 1, 0.5)
    mean, slope = jax.jit(jax.value_and_grad(total))(middle)
    assert mean == pytest.approx(-0.2340, abs=5e-5)
    assert np.sqrt(np.sum(slope**2) / 12) == pytest.approx(1.0531, abs=5e-5)
    half = np.sum(np.abs(slope)) / 2
    assert mean - half == pytest.approx(-4.428, abs=5e-4) and mean + half == pytest.approx(3.960, abs=5e-4)


NAN, INVALID = Status.NONFINITE, Status.INVALID_GEOMETRY
BAD = [
    ("shortening", 0.0, INVALID),
    ("shortening", 1.0, INVALID),
    ("shortening", -0.5, INVALID),
    ("eccentricity", 0.0, INVALID),
    ("eccentricity", -1e-3, INVALID),
    ("pin_circle_radius", 0.0, INVALID),
    ("sun_radius", 0.0, INVALID),
    ("pressure_angle", 91 * deg, INVALID),
    ("tilt", 90 * deg, INVALID),
    ("tilt", -2.0, INVALID),
    ("centre_shift", -27.5 * mm, INVALID),
    ("tilt", jnp.inf, NAN),
    ("centre_shift", jnp.inf, NAN),
    ("pin_circle_radius", jnp.inf, NAN),
    ("pin_radius_error", jnp.nan, NAN),
    ("pin_radius_error", -jnp.inf, NAN),
    ("shortening", jnp.nan, NAN),
    ("tilt", 0.0, Status.CONVERGED),
]


def case_of(name, value):
    """A function of all the numbers that may go wrong."""
    numbers = dict(
        shortening=0.72, eccentricity=0.9 * mm, pin_circle_radius=52 * mm, sun_radius=13.5 * mm,
        pressure_angle=20 * deg, tilt=1e-3, centre_shift=0.0, pin_radius_error=-0.014 * mm,
    )  # fmt: skip
    return numbers | {name: value}


def run_case(numbers, profile):
    stage = {name: numbers[name] for name in ("shortening", "eccentricity", "pin_circle_radius")}
    first = {name: numbers[name] for name in ("sun_radius", "pressure_angle")}
    design = cycloid(RV_20E.replace(involute=RV_20E.involute.replace(**first)), **stage)
    errors = RV_20E_ERRORS.replace(pin_radius=numbers["pin_radius_error"])
    options = {name: numbers[name] for name in ("tilt", "centre_shift")}
    return geometric(design, errors, profile=profile, **options)


@pytest.mark.parametrize("profile", PROFILES)
def test_bad_lanes_have_a_status_and_leave_their_neighbours_alone(profile):
    cases = [case for case in BAD if profile != "contact" or case[0] != "shortening"]
    batch = {key: jnp.array([case_of(name, value)[key] for name, value, _ in cases]) for key in case_of("tilt", 0.0)}
    result = jax.jit(jax.vmap(partial(run_case, profile=profile)))(batch)
    for status, (name, value, expected) in zip(result.info.status, cases):
        assert Status(int(status)) == expected, (name, value)
    good = np.array([case[2] == Status.CONVERGED for case in cases])
    for leaf in jax.tree.leaves((result.total, result.play, result.terms)):
        np.testing.assert_array_equal(np.isfinite(leaf), good)

    def mean(shared, lanes):  # of the good lanes, as statistics would take it
        value = jax.vmap(lambda lane: run_case({key: lane[key] * shared[key] for key in lane}, profile).total)(lanes)
        return jnp.sum(jnp.where(jnp.isnan(value), 0, value))

    # The bad numbers multiply the shared ones, so only the stand-ins keep their gradient finite.
    gradient = jax.jit(jax.grad(mean, argnums=(0, 1)))
    shared = dict.fromkeys(batch, 1.0)
    by_shared, by_lane = gradient(shared, batch)
    repeated = {key: jnp.full_like(value, value[good.argmax()]) for key, value in batch.items()}
    expected, _ = gradient(shared, repeated)
    assert good.sum() == 1
    for key in batch:
        assert np.all(np.isfinite(by_lane[key])) and np.all(np.asarray(by_lane[key])[~good] == 0), key
        if np.all(np.isfinite(batch[key])):  # else the product with the shared number itself is to blame
            np.testing.assert_allclose(by_shared[key], expected[key] / len(good), rtol=1e-12, atol=1e-18)


def test_printed_reading_states():
    run = jax.jit(jax.vmap(lambda f: geometric(RV_20E, RV_20E_ERRORS, reading="as_printed", normal_force=f)))
    result = run(jnp.array([1.6, 0.5075, 0.0, -1.0, jnp.nan]))
    expected = [Status.CONVERGED, Status.PRESSURE_ANGLE, INVALID, INVALID, NAN]
    assert [Status(int(s)) for s in result.info.status] == expected
    np.testing.assert_array_equal(np.isfinite(result.total), [True, True, False, False, False])
    np.testing.assert_array_equal(result.valid, [True, False, False, False, False])


def test_extremes():
    flat = solve(cycloid(RV_20E, shortening=1 - 1e-12), RV_20E_ERRORS)
    assert flat.valid and -5e3 < flat.total / arcmin < -4e3
    large = cycloid(RV_20E, disc_teeth=10**6, pin_count=10**6 + 1, shortening=0.72)
    only = solve(large, RV_20E_ERRORS)
    assert only.valid and np.isfinite(only.total)
    assert solve(large, jax.tree.map(np.float32, RV_20E_ERRORS)).valid
    near = [
        solve(RV_20E, RV_20E_ERRORS, centre_shift=-27.5 * mm + gap).terms.bearing_clearance for gap in (1e-9, 1e-10)
    ]
    assert near[1] / near[0] == pytest.approx(10, rel=1e-4)
    apart = cycloid(RV_20E, pin_count=41)  # a tooth difference of two
    assert solve(apart, RV_20E_ERRORS).valid
    preload = jax.tree.map(lambda x: x, RV_20E_ERRORS)
    object.__setattr__(preload, "bearing_clearance", -1 * um)  # as sampling makes it
    shifted = solve(RV_20E, preload).terms.bearing_clearance
    assert shifted == -solve(RV_20E, RV_20E_ERRORS).terms.bearing_clearance
    for profile in ("closed_form", "contact"):
        tight = solve(TRUE_K1, RVErrors(shift_modification=5 * um), profile=profile)
        assert tight.info.status == Status.NOT_ASSEMBLABLE and np.isnan(tight.total) and not tight.valid


@pytest.mark.parametrize(
    ("design", "options", "message"),
    [
        (RV_20E, {"reading": "printed"}, "reading = 'printed'"),
        (RV_20E, {"profile": "exact"}, "profile = 'exact'"),
        (RV_20E, {"reading": "as_printed", "profile": "contact"}, "as_printed"),
        (RV_20E, {"reading": "as_printed", "profile": "closed_form"}, "as_printed"),
        (RV_20E, {"normal_force": 0.5}, "normal_force"),
        (cycloid(RV_20E, pin_count=41), {"profile": "contact"}, "one pin more"),
        (cycloid(RV_20E, pin_count=39), {}, "must exceed disc_teeth"),
    ],
)
def test_method_errors_also_under_jit(design, options, message):
    with pytest.raises(ValueError, match=message):
        geometric(design, RV_20E_ERRORS, **options)
    with pytest.raises(ValueError, match=message):
        solve(design, RV_20E_ERRORS, **options)


def test_constructors_judge_numbers_given_eagerly():
    with pytest.raises(ValueError, match=r"shortening = 1.*K1"):
        cycloid(RV_20E, shortening=1.0)
    with pytest.raises(ValueError, match="bearing_clearance"):
        RV_20E_ERRORS.replace(bearing_clearance=-1 * um)


@pytest.mark.parametrize(("profile", "absolute", "relative"), [("first_order", 6e-6, 3e-6), ("contact", 2e-5, 1e-5)])
def test_float32_within_its_bounds(profile, absolute, relative):
    bands = dict(
        pin_circle_radius=10,
        pin_radius=4,
        eccentricity=5,
        equidistant_modification=1,
        shift_modification=3,
        disc_runout=15,
        disc_cumulative_pitch=19,
        pin_hole_clearance=5,
        bearing_clearance=1,
        base_tangent_upper=30,
    )  # um; fmt: skip
    rng = np.random.default_rng(5)
    drawn = {name: np.float32(rng.uniform(-band, band, 4000) * um) for name, band in bands.items()}
    design = cycloid(TRUE_K1, equidistant_modification=0.006 * mm)  # enough room for nearly all

    def run(**errors):
        return geometric(design, RVErrors(**errors), profile=profile)

    single = jax.jit(jax.vmap(lambda e: run(**e)))(drawn)
    double = jax.jit(jax.vmap(lambda e: run(**e)))({name: np.float64(value) for name, value in drawn.items()})
    assert single.total.dtype == jnp.float32 and double.total.dtype == jnp.float64
    both = np.asarray(single.valid & double.valid)
    assert both.mean() > 0.8 and np.mean(single.valid != double.valid) < 1e-3
    size = sum(np.abs(term) for term in jax.tree.leaves(double.terms))
    bound = absolute * arcmin + relative * size
    assert np.all((np.abs(single.total - double.total.astype(np.float32)) <= bound)[both])
