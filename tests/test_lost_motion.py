"""Lost motion: the sum of terms and its readings.

Oracles: tests/reference/lost_motion.json (evaluated with 40 digits; 1e-12 relative, contact 1e-7 guaranteed there);
the published Table 5 and totals of Liu et al. 2022.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lost_motion_cases import TRUE_K1, cycloid, solve

import rvjax
from rvjax import RVErrors, Status
from rvjax.catalogue import RV_20E, RV_20E_ERRORS
from rvjax.lost_motion import geometric, shaft_tilt
from rvjax.lost_motion.outputs import PROFILES
from rvjax.units import arcmin, deg, mm, um


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


def test_a_line_of_normal_force_over_torque_returns_the_tilted_rows():
    """Table 10 of Liu et al. 2022: each total implies another force; a line over torque gives all six."""
    torque = jnp.array([50.0, 80, 110, 140, 170, 200])
    tilt = jnp.array([7.67e-6, 1.31e-5, 1.86e-5, 2.38e-5, 2.89e-5, 3.44e-5]) * deg
    printed = np.array([0.5976, 0.5982, 0.6018, 0.6029, 0.6032, 0.6063])

    def total(torque, tilt):
        force = 1.5081 + 0.2373 * torque / 200  # N, fitted
        return geometric(RV_20E, RV_20E_ERRORS, reading="as_printed", tilt=tilt, normal_force=force).total

    assert np.max(np.abs(jax.vmap(total)(torque, tilt) / arcmin - printed)) < 1.05e-3
    untilted = solve(RV_20E, RV_20E_ERRORS, reading="as_printed", normal_force=1.5081)
    assert abs(untilted.total / arcmin - 0.5462) == pytest.approx(0.048, abs=1e-3)


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
