"""A whole reducer: transmission error, forces, a crank turn.

Oracles: the 40-digit reference file (its own tolerances: float64 1e-10, float32 1e-5 relative); full-length
vector sums in 80-bit floats, which lose 4 digits of 19 to cancellation (1e-11 relative); power balance and
series of the pin loads; closed first-order harmonics.
"""

import itertools

import jax
import numpy as np
import pytest
from four_bar_reducers import (
    READ,
    changed,
    disc_couple,
    drawn,
    numbers,
    reducer,
    referenced,
    revolution,
    transmission_error,
)

from rvjax import RVErrors, Status, four_bar
from rvjax.four_bar.unit import pin_load_ratio
from rvjax.units import mm, um


def three_cranks(discs=2):
    """With the teeth of the reference, so that one program serves."""
    return reducer(3, discs, teeth=(15, 69, 39, 40))


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_reference_reducers(reference, dtype, thorough):
    for case in reference("four_bar")["reducer"]:
        if case["cranks"] == "geared" and not thorough:
            continue  # a program of its own: the linkage below has geared cranks
        design, errors = referenced(case, dtype)
        expected = case["expected"]
        closures = ["newton"] if case["cranks"] == "geared" else ["closed_form"]
        if case["name"] == "rv40_loaded_clearance" or (thorough and case["name"] == "rv320_three_cranks_loaded"):
            closures += ["newton"]
        given = dict(crank_angle=np.deg2rad(case["crank_angle_deg"]), output_torque=case["output_torque_Nm"])
        given |= dict(ratio=case.get("gear_stiffness_ratio"), cranks=case["cranks"], branch=case["branch"], dtype=dtype)
        for closure in closures:
            result = transmission_error(design, errors, closure=closure, **given)
            relative, absolute = (1e-10, 1e-18) if dtype == np.float64 else (1e-5, 1e-9)
            assert result.error.dtype == dtype
            np.testing.assert_allclose(result.error, expected["error_rad"], relative, absolute)
            np.testing.assert_allclose(result.per_disc, expected["per_disc_rad"], relative, absolute)
            if expected["misfit_mm"] is not None:
                misfit = np.multiply(expected["misfit_mm"], mm)
                np.testing.assert_allclose(result.misfit, misfit, relative, 1e-18 if dtype == np.float64 else 1e-12)
            assert int(result.info.status) == Status.CONVERGED


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_reference_curve(reference, dtype):
    for case in reference("four_bar")["curve"]:
        design, errors = referenced(case, dtype)
        assert case["output_torque_Nm"] == 0
        result = revolution(design, errors, angles=case["samples"], dtype=dtype)
        expected, relative = case["expected"], 1e-10 if dtype == np.float64 else 1e-5
        found = [result.maximum, result.minimum, result.peak_to_peak, result.mean]
        printed = [expected[name] for name in ("max_rad", "min_rad", "peak_to_peak_rad")]
        np.testing.assert_allclose(found, [*printed, expected["harmonics"][0]["re"]], relative)
        for harmonic in expected["harmonics"]:
            value, rounding = harmonic["re"] + 1j * harmonic["im"], 1e-17 if dtype == np.float64 else 1e-10
            np.testing.assert_allclose(result.harmonics[harmonic["order"]], value, relative, rounding)
        assert result.error.dtype == dtype
        assert len(result.harmonics) == case["samples"] // 2


def plain(design, errors, angle, torque=0.0):
    """Disc angles and misfits from full-length vectors in 80-bit floats; forces as free-body sums."""
    real = np.longdouble
    cycloid, stage = design.cycloid, design.cranks
    c, nd, e, radius = stage.count, cycloid.disc_count, real(cycloid.eccentricity), real(stage.circle_radius)
    get = {name: np.asarray(getattr(errors, name), real) for name in READ}
    pi = real("3.14159265358979323846264338327950288")
    axis = np.exp(1j * (pi + 2 * pi * np.arange(c, dtype=real) / c))
    out = []
    for k in range(nd):
        b = real(angle) + 2 * pi * k / nd
        u = np.exp(1j * b)
        force = plain_forces(design, u, axis, real(torque))
        size = np.abs(force)
        shift = np.where(size > 0, force / np.where(size > 0, size, 1), 0) * get["bearing_clearance"]
        shift = shift + force / real(stage.bearing_stiffness)
        seat = (radius + get["carrier_bore"][:, 0] + 1j * get["carrier_bore"][:, 1]) * axis
        arm = e + get["eccentricity"] + get["crank_eccentricity"][k]
        pin = seat + arm * np.exp(1j * (b + get["crank_phase"])) + shift
        bore = (radius + get["disc_bore"][k, :, 0] + 1j * get["disc_bore"][k, :, 1]) * axis
        pin, bore = pin - pin.mean(), bore - bore.mean()
        turn = np.angle(np.sum(np.conj(bore) * pin))
        if c == 2:
            misfit = np.abs(pin[1] - pin[0]) - np.abs(bore[1] - bore[0])
        else:
            misfit = np.sqrt(2 * np.sum(np.abs(pin - np.exp(1j * turn) * bore) ** 2))
        out.append((float(-turn), float(misfit)))
    return np.array(out).T


def plain_forces(design, u, axis, torque):
    cycloid, ratio = design.cycloid, design.involute.sun_teeth / design.involute.planet_teeth
    e, k1 = cycloid.eccentricity, cycloid.shortening_coefficient
    n = np.arange(1, 200)
    kappa = 4 / np.pi * np.sum(k1 ** (2 * n - 1) / (4 * n**2 - 1))
    tangential = torque / (cycloid.disc_count * e * (cycloid.pin_count + ratio))
    couple = e * cycloid.disc_teeth * tangential
    force = (tangential * 1j + kappa * np.abs(tangential)) * u / len(axis)
    return force + couple / (len(axis) * design.cranks.circle_radius) * 1j * axis


@pytest.mark.parametrize(
    ("cranks", "discs"),
    [(2, 2), (3, 2), *(pytest.param(*counts, marks=pytest.mark.long) for counts in ((2, 1), (2, 3), (3, 1), (5, 2)))],
)
def test_locked_reducer_against_plain_vectors(cranks, discs):
    """Every number of cranks and of discs, one disc with even and odd cranks, loaded both ways and not."""
    design = reducer(cranks, discs) if cranks != 3 else three_cranks(discs)
    for seed, torque in itertools.product(range(3), (0.0, 412.0, -300.0)):
        errors, angle = drawn(design, seed), 0.7 + 2 * seed
        result = transmission_error(design, errors, crank_angle=angle, output_torque=torque, closure="closed_form")
        per_disc, misfit = plain(design, errors, angle, torque)
        np.testing.assert_allclose(result.per_disc, per_disc, rtol=1e-10, atol=1e-17)
        np.testing.assert_allclose(result.misfit, misfit, rtol=1e-9, atol=1e-16)
        np.testing.assert_allclose(result.error, per_disc.mean(), rtol=1e-10, atol=1e-17)


@pytest.mark.parametrize("turned", [2.0, -3.1])
def test_a_disc_turned_beyond_a_right_angle_keeps_its_misfit(turned):
    """Carrier bores turned about the axis beside ordinary errors: lengths of 36 mm are rounded in a misfit of 10 um."""
    design = three_cranks()
    radius, errors = design.cranks.circle_radius, drawn(design, 4)
    away = np.array([radius * (np.cos(turned) - 1), radius * np.sin(turned)])
    errors = changed(errors, carrier_bore=errors.carrier_bore + away[None])
    result = transmission_error(design, errors, crank_angle=0.7, output_torque=0.0, closure="closed_form")
    per_disc, misfit = plain(design, errors, 0.7)
    assert misfit.min() > 1e-6 and np.all(np.abs(per_disc) > 1.9)
    np.testing.assert_allclose(result.per_disc, per_disc, rtol=1e-13)
    np.testing.assert_allclose(result.misfit, misfit, rtol=1e-9)


@pytest.mark.parametrize(
    "methods",
    [
        dict(cranks="phase_locked", closure="newton"),
        dict(cranks="geared", closure="first_order"),
        pytest.param(dict(cranks="geared", closure="newton"), marks=pytest.mark.long),
    ],
)
def test_two_cranks_are_the_linkage(methods):
    """Procrustes fit and four-bar kernel agree; the linkage sees displacements of the second crank only."""
    design, angle, ratio = reducer(), 2.1, 40.0 if methods["cranks"] == "geared" else None
    errors = numbers(drawn(design, 5))
    fitted = transmission_error(design, errors, crank_angle=angle, ratio=ratio, **methods)
    radial, tangential = np.moveaxis(np.asarray(errors.carrier_bore), -1, 0)
    for k in range(2):
        bore = np.asarray(errors.disc_bore)[k].sum(axis=0)
        length = np.hypot(72 * mm + bore[0], bore[1]) - 72 * mm
        closed = four_bar.solve_closure(
            1.3 * mm + errors.eccentricity,
            72 * mm,
            four_bar.LinkDeviations(
                crank_1=errors.crank_eccentricity[k, 0],
                crank_3=errors.crank_eccentricity[k, 1],
                coupler=float(length),
                frame=float(radial.sum()),
                crank_phase=errors.crank_phase[1] - errors.crank_phase[0],
                joint=(0.0, float(tangential.sum())),
            ),
            crank_angle=angle + np.pi * k + errors.crank_phase[0],
            gear_stiffness_ratio=ratio,
            **methods,
        )
        beta = closed.coupler_angle - np.arctan2(bore[1], 72 * mm + bore[0])
        np.testing.assert_allclose(fitted.per_disc[k], -beta, rtol=1e-10)
        np.testing.assert_allclose(fitted.misfit[k], closed.misfit, rtol=1e-8)


def test_forces_balance():
    k1 = np.array([1e-3, 0.05, 0.2, 0.39999, 0.40001, 0.8125, 0.99])
    kappa, slope = jax.jit(jax.vmap(jax.value_and_grad(pin_load_ratio)))(k1)
    n, k1 = np.arange(1, 4000), k1[:, None]
    np.testing.assert_allclose(kappa, 4 / np.pi * np.sum(k1 ** (2 * n - 1) / (4.0 * n**2 - 1), axis=1), rtol=1e-12)
    np.testing.assert_allclose(kappa[5], 0.411777, rtol=1e-6)
    series = 4 / np.pi * np.sum((2 * n - 1) * k1 ** (2 * n - 2) / (4.0 * n**2 - 1), axis=1)
    np.testing.assert_allclose(slope, series, rtol=1e-10)


@pytest.mark.parametrize("torque", [412.0, -412.0])
def test_elastic_wind_up_is_constant(torque):
    design = reducer(stiffness=6.1e8)
    result = revolution(design, RVErrors.for_design(design), angles=8, output_torque=torque)
    couple = disc_couple(design, torque)
    np.testing.assert_allclose(result.error, -2 * couple / (6.1e8 * (72 * mm) ** 2), rtol=1e-4)
    np.testing.assert_allclose(result.error[2], -1.25820394e-4 * np.sign(torque), rtol=1e-6)


@pytest.mark.parametrize("design", [reducer(), pytest.param(reducer(3, 3), marks=pytest.mark.long)])
def test_first_harmonic_in_closed_form(design):
    """Phase-locked and unloaded the error is a pure first harmonic, to first order, in every design."""
    errors = drawn(design, 7, size=0.01 * um)
    errors = errors.replace(crank_phase=errors.crank_phase * 1e-3)
    c, nd, e = design.cranks.count, design.cycloid.disc_count, design.cycloid.eccentricity
    a, b = np.pi + 2 * np.pi * np.arange(c) / c, 2 * np.pi * np.arange(nd) / nd
    terms = e * np.asarray(errors.crank_phase) - 1j * np.asarray(errors.crank_eccentricity)
    z = np.sum(terms * np.exp(1j * (b[:, None] - a))) / (c * design.cranks.circle_radius * nd)
    result = revolution(design, errors, angles=64)
    np.testing.assert_allclose(result.harmonics[1], -z, rtol=1e-5)
    np.testing.assert_allclose(result.peak_to_peak, 2 * abs(z), rtol=3e-3)  # 64 angles miss the peak a little
    assert np.max(np.abs(result.harmonics[2:])) < 1e-4 * abs(z)
    waves = np.exp(1j * np.outer(np.arange(32), result.crank_angle))
    curve = np.real(np.sum(np.asarray(result.harmonics)[:, None] * waves, axis=0))
    np.testing.assert_allclose(result.error, curve, atol=1e-6 * abs(z))
    linear = revolution(design, errors, angles=64, closure="first_order")
    np.testing.assert_allclose(linear.error, result.error, atol=1e-4 * abs(z))


def test_opposite_discs_cancel_equal_crank_errors():
    delta = np.array([10.0, -4.0]) * um
    design = reducer()
    pair = (RVErrors.for_design(design, crank_eccentricity=np.array([delta, s * delta])) for s in (1, -1))
    equal, opposite = (float(revolution(design, errors, angles=64).peak_to_peak) for errors in pair)
    assert equal < 1e-7
    np.testing.assert_allclose(opposite, 2 * 14 * um / (72 * mm), rtol=3e-3)


def turns(design, units, **arguments):
    """Turns of the units of a batch, one after the other, in one program."""
    count = units.bearing_clearance.shape[-1]
    alone = (jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[..., k], units) for k in range(count))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(revolution(design, one, **arguments) for one in alone))


@pytest.mark.parametrize(
    ("design", "arguments"),
    [
        (reducer(), dict(angles=64)),
        (reducer(), dict(angles=8, output_torque=412.0)),
        pytest.param(reducer(3, 3), dict(output_torque=-100.0), marks=pytest.mark.long),
        pytest.param(reducer(), dict(output_torque=412.0), marks=pytest.mark.long),
        pytest.param(reducer(), dict(closure="first_order", angles=8), marks=pytest.mark.long),
    ],
)
def test_revolution_equals_its_curve(design, arguments):
    """The searched extremes are those of the curve, with and without load.

    With a load the squared distance of two pins, whose largest is the misfit, is no single harmonic.
    """
    units = drawn(design, 8, units=20)
    result = turns(design, units, **arguments)
    np.testing.assert_allclose(result.maximum, result.error.max(axis=1), rtol=1e-12)
    np.testing.assert_allclose(result.minimum, result.error.min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(result.mean, result.error.mean(axis=1), rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(result.largest_misfit, np.abs(result.misfit).max(axis=(1, 2)), rtol=1e-12)
    assert set(result.info.status) == {0}
    if arguments == dict(angles=64):
        unit = jax.tree.map(lambda leaf: leaf[..., 3], units)
        for j in (0, 7, 53):
            alone = transmission_error(design, unit, crank_angle=result.crank_angle[0, j])
            np.testing.assert_allclose(alone.error, result.error[3, j], rtol=1e-12)


@pytest.mark.parametrize("angles", [64, pytest.param(17, marks=pytest.mark.long)])
def test_extremes_where_the_first_harmonic_vanishes(angles):
    """Extremes beside the first harmonic's, or of all angles where it does not decide: those of the curve.

    Crank errors of both discs, equal but for one by 1 nm to 0.3 mm, leave a first harmonic below the second, or above.
    """
    units = drawn(reducer(), 5, units=100)
    delta = np.array(units.crank_eccentricity) * 30
    delta[1] = delta[0]
    delta[1, 1] += np.geomspace(1e-3, 300, 100) * um
    units = changed(units, crank_eccentricity=delta, crank_phase=np.zeros((2, 100)), disc_bore=0 * units.disc_bore)
    result = turns(reducer(), units, angles=angles)
    error = result.error
    # Rounding: two angles of a curve whose terms, of the size of delta over R, cancel.
    rounding = 16 * np.finfo(float).eps * np.abs(delta).max() / (36 * mm)
    np.testing.assert_allclose(result.maximum, error.max(axis=1), rtol=1e-12, atol=rounding)
    np.testing.assert_allclose(result.minimum, error.min(axis=1), rtol=1e-12, atol=rounding)
    second = np.abs(np.fft.rfft(error - error.mean(axis=1, keepdims=True), axis=1)[:, 1:3])
    assert (second[:, 1] > second[:, 0]).any() and (second[:, 1] < 0.01 * second[:, 0]).any()
