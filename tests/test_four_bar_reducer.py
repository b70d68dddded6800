"""A whole reducer: transmission error, forces, a crank turn.

Oracles: the 40-digit reference file (its own tolerances: float64 1e-10, float32 1e-5 relative); full-length
vector sums in 80-bit floats, which lose 4 digits of 19 to cancellation (1e-11 relative); power balance and
series of the pin loads; closed first-order harmonics; finite differences.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import CrankStage, CycloidStage, InvoluteStage, RVErrors, RVReducer, Status, catalogue, four_bar
from rvjax.four_bar.forces import pin_load_ratio
from rvjax.units import mm, um

STATIC = ("angles", "cranks", "closure", "branch")
revolution = jax.jit(four_bar.revolution, static_argnames=STATIC)
transmission_error = jax.jit(four_bar.transmission_error, static_argnames=STATIC[1:])
READ = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance", "eccentricity")


def reducer(cranks=2, discs=2, e=1.3 * mm, radius=36 * mm, stiffness=6e8, teeth=(10, 26, 39, 40), pins=64 * mm):
    return RVReducer(
        InvoluteStage.from_teeth(teeth[0], teeth[1], module=2 * mm),
        CycloidStage(teeth[2], teeth[3], discs, e, pins, 3 * mm),
        CrankStage(cranks, radius, stiffness),
    )


def referenced(case, dtype=np.float64):
    """Design and errors of a case of the reference file."""
    d = case["design"]
    design = reducer(
        d["cranks"],
        d["discs"],
        d["eccentricity_mm"] * mm,
        d["crank_circle_radius_mm"] * mm,
        d["bearing_stiffness_N_per_mm"] / mm,
        (d["sun_teeth"], d["planet_teeth"], d["disc_teeth"], d["pin_count"]),
        d["pin_circle_radius_mm"] * mm,
    )
    errors = {n: np.asarray(v) * (1 if n == "crank_phase" else mm) for n, v in case["errors_mm_rad"].items()}
    return design, cast(RVErrors.for_design(design, **errors), dtype)


def cast(errors, dtype):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), errors)


def drawn(design, seed, size=10 * um, units=None):
    """Random errors of one unit, or of many along the last axis."""
    rng, counts = np.random.default_rng(seed), design.counts
    c, d, last = counts["cranks"], counts["discs"], () if units is None else (units,)
    values = dict(
        crank_eccentricity=rng.normal(0, size, (d, c, *last)),
        crank_phase=rng.normal(0, 1e-4, (c, *last)),
        disc_bore=rng.normal(0, size, (d, c, 2, *last)),
        carrier_bore=rng.normal(0, size, (c, 2, *last)),
        bearing_clearance=np.abs(rng.normal(0, size, last)),
        eccentricity=rng.normal(0, size, last),
    )
    blank = RVErrors.for_design(design)
    leaves, tree = jax.tree.flatten_with_path(blank)
    full = [np.zeros((*np.shape(leaf), *last)) + values.get(path[0].name, 0) for path, leaf in leaves]
    return tree.unflatten(map(jnp.asarray, full))


def changed(errors, **changes):
    """A batch with some fields changed; constructors take one case only."""
    leaves, tree = jax.tree.flatten_with_path(errors)
    return tree.unflatten([jnp.asarray(changes.get(path[0].name, leaf)) for path, leaf in leaves])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_reference_reducers(reference, dtype):
    for case in reference("four_bar")["reducer"]:
        design, errors = referenced(case, dtype)
        expected = case["expected"]
        closures = ["newton"] if case["cranks"] == "geared" else ["closed_form"]
        if case["name"] in ("rv40_loaded_clearance", "rv320_three_cranks_loaded"):
            closures += ["newton"]
        for closure in closures:
            result = four_bar.transmission_error(
                design,
                errors,
                crank_angle=jnp.asarray(np.deg2rad(case["crank_angle_deg"]), dtype),
                output_torque=case["output_torque_Nm"],
                cranks=case["cranks"],
                branch=case["branch"],
                gear_stiffness_ratio=case.get("gear_stiffness_ratio"),
                closure=closure,
            )
            relative, absolute = (1e-10, 1e-18) if dtype == np.float64 else (1e-5, 1e-9)
            assert result.error.dtype == dtype
            np.testing.assert_allclose(result.error, expected["error_rad"], relative, absolute)
            np.testing.assert_allclose(result.per_disc, expected["per_disc_rad"], relative, absolute)
            if expected["misfit_mm"] is not None and dtype == np.float64:
                np.testing.assert_allclose(result.misfit, np.multiply(expected["misfit_mm"], mm), 1e-10, 1e-18)
            assert int(result.info.status) == Status.CONVERGED


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_reference_curve(reference, dtype):
    for case in reference("four_bar")["curve"]:
        design, errors = referenced(case, dtype)
        result = revolution(design, errors, angles=case["samples"], output_torque=case["output_torque_Nm"])
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


@pytest.mark.parametrize("cranks", [2, 3, 5])
@pytest.mark.parametrize("discs", [1, 2, 3])
@pytest.mark.parametrize("torque", [0.0, 412.0, -300.0])
def test_locked_reducer_against_plain_vectors(cranks, discs, torque):
    design = reducer(cranks, discs)
    for seed in range(3):
        errors, angle = drawn(design, seed), 0.7 + 2 * seed
        result = transmission_error(design, errors, crank_angle=angle, output_torque=torque, closure="closed_form")
        per_disc, misfit = plain(design, errors, angle, torque)
        np.testing.assert_allclose(result.per_disc, per_disc, rtol=1e-10, atol=1e-17)
        np.testing.assert_allclose(result.misfit, misfit, rtol=1e-9, atol=1e-16)
        np.testing.assert_allclose(result.error, per_disc.mean(), rtol=1e-10, atol=1e-17)


def test_two_cranks_are_the_linkage():
    """Procrustes fit and four-bar kernel agree; the linkage sees displacements of the second crank only."""
    design, angle = catalogue.RV_40E, 2.1
    errors = drawn(design, 5)
    fitted = transmission_error(design, errors, crank_angle=angle)
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
        )
        beta = closed.coupler_angle - np.arctan2(bore[1], 72 * mm + bore[0])
        np.testing.assert_allclose(fitted.per_disc[k], -beta, rtol=1e-10)
        np.testing.assert_allclose(fitted.misfit[k], closed.misfit, rtol=1e-8)


def test_forces_balance():
    kappa = np.array([pin_load_ratio(k) for k in (1e-3, 0.05, 0.2, 0.39999, 0.40001, 0.8125, 0.99)])
    n = np.arange(1, 4000)
    k1 = np.array([1e-3, 0.05, 0.2, 0.39999, 0.40001, 0.8125, 0.99])[:, None]
    np.testing.assert_allclose(kappa, 4 / np.pi * np.sum(k1 ** (2 * n - 1) / (4.0 * n**2 - 1), axis=1), rtol=1e-12)
    np.testing.assert_allclose(kappa[5], 0.411777, rtol=1e-6)
    slope = jax.vmap(jax.grad(pin_load_ratio))(k1[:, 0])
    series = 4 / np.pi * np.sum((2 * n - 1) * k1 ** (2 * n - 2) / (4.0 * n**2 - 1), axis=1)
    np.testing.assert_allclose(slope, series, rtol=1e-10)


@pytest.mark.parametrize("torque", [412.0, -412.0])
def test_elastic_wind_up_is_constant(torque):
    design = catalogue.RV_40E.replace(cranks=catalogue.RV_40E.cranks.replace(bearing_stiffness=6.1e8))
    result = revolution(design, RVErrors(), output_torque=torque, angles=48)
    couple = 198.937142857143 * np.sign(torque)
    np.testing.assert_allclose(result.error, -2 * couple / (6.1e8 * (72 * mm) ** 2), rtol=1e-4)
    np.testing.assert_allclose(result.error[12], -1.25820394e-4 * np.sign(torque), rtol=1e-6)


def test_torque_through_zero():
    """Without load clearance has no direction: a jump whose one-sided limits are opposite."""
    design, errors = catalogue.RV_40E, RVErrors(bearing_clearance=5 * um)

    @jax.jit
    def error(torque, clearance):
        return transmission_error(
            design, errors.replace(bearing_clearance=clearance), crank_angle=np.pi / 2, output_torque=torque
        ).error

    value, slopes = jax.value_and_grad(error, argnums=(0, 1))(0.0, 5 * um)
    assert value == 0
    assert slopes[1] == 0
    np.testing.assert_allclose(slopes[0], -2 * 198.937142857143 / 412 / (6e8 * (72 * mm) ** 2), rtol=1e-9)
    np.testing.assert_allclose(error(1e-9, 5 * um), -error(-1e-9, 5 * um), rtol=1e-2)
    assert abs(error(1e-9, 5 * um)) > 1e-4
    clearance_slope = jax.grad(error, argnums=1)(412.0, 5 * um)
    difference = (error(412.0, 6 * um) - error(412.0, 4 * um)) / (2 * um)
    np.testing.assert_allclose(clearance_slope, difference, rtol=1e-5)


def test_first_harmonic_in_closed_form():
    """Phase-locked and unloaded the error is a pure first harmonic, to first order, in every design."""
    for design in (catalogue.RV_40E, reducer(3, 3)):
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
        linear = revolution(design, errors, closure="first_order")
        np.testing.assert_allclose(linear.error, result.error, atol=1e-4 * abs(z))


def test_opposite_discs_cancel_equal_crank_errors():
    delta = np.array([10.0, -4.0]) * um
    equal, opposite = (
        float(revolution(catalogue.RV_40E, RVErrors(crank_eccentricity=np.array([delta, s * delta]))).peak_to_peak)
        for s in (1, -1)
    )
    assert equal < 1e-7
    np.testing.assert_allclose(opposite, 2 * 14 * um / (72 * mm), rtol=3e-3)


def test_revolution_equals_its_curve():
    """The searched extremes are those of the curve, with and without load."""
    for design, arguments in (
        (catalogue.RV_40E, dict(angles=48)),
        (catalogue.RV_40E, dict(output_torque=412.0)),
        (catalogue.RV_40E, dict(closure="first_order", angles=8)),
        (reducer(3, 3), dict(output_torque=-100.0)),
    ):
        units = drawn(design, 8, units=20)
        turn = jax.jit(jax.vmap(lambda e, d=design, a=arguments: four_bar.revolution(d, e, **a), in_axes=-1))
        result = turn(units)
        error, misfit = np.asarray(result.error), np.asarray(result.misfit)
        np.testing.assert_allclose(result.maximum, error.max(axis=1), rtol=1e-12)
        np.testing.assert_allclose(result.minimum, error.min(axis=1), rtol=1e-12)
        np.testing.assert_allclose(result.mean, error.mean(axis=1), rtol=1e-12, atol=1e-20)
        np.testing.assert_allclose(result.largest_misfit, np.abs(misfit).max(axis=(1, 2)), rtol=1e-12)
        assert set(np.asarray(result.info.status)) == {0}
        if design is catalogue.RV_40E and arguments == dict(angles=48):
            unit = jax.tree.map(lambda leaf: leaf[..., 3], units)
            for j in (0, 7, 31):
                alone = transmission_error(catalogue.RV_40E, unit, crank_angle=result.crank_angle[0, j])
                np.testing.assert_allclose(alone.error, error[3, j], rtol=1e-12)


def test_derivatives_equal_differences():
    """Reverse and forward mode against differences, for a random sum of figures along a random direction."""
    design, rng = catalogue.RV_40E, np.random.default_rng(1)
    errors, weights = drawn(design, 9), rng.normal(size=5)

    def figure(errors):
        result = four_bar.revolution(design, errors, output_torque=412.0)
        parts = jnp.stack([result.maximum, result.minimum, result.largest_misfit, result.mean, result.error[5]])
        return jnp.dot(parts, weights)

    value, gradient = jax.jit(figure), jax.jit(jax.grad(figure))(errors)
    forward = jax.jit(lambda e, d: jax.jvp(figure, (e,), (d,))[1])
    blank = jax.tree.map(jnp.zeros_like, errors)
    for name in RVErrors.__dataclass_fields__:
        found = np.asarray(getattr(gradient, name))
        if name not in READ:
            assert np.all(found == 0)
            continue
        direction = changed(blank, **{name: rng.normal(size=found.shape)})
        above, below = (value(jax.tree.map(lambda x, d, s=s: x + s * 1e-9 * d, errors, direction)) for s in (1, -1))
        expected = (above - below) / 2e-9
        np.testing.assert_allclose(np.sum(found * getattr(direction, name)), expected, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(forward(errors, direction), expected, rtol=1e-5, atol=1e-5)


def test_zero_errors_are_exactly_zero_with_finite_derivatives():
    """At every crank angle; a random weight on each makes one lost derivative spoil the sum."""
    for cranks in (2, 3):
        design, angles = reducer(cranks), np.linspace(0, 2 * np.pi, 25)

        def figures(errors, design=design, angles=angles):
            def one(angle):
                result = four_bar.transmission_error(design, errors, crank_angle=angle, closure="closed_form")
                return jnp.concatenate([result.per_disc, result.misfit])

            return jax.vmap(one)(jnp.asarray(angles))

        @jax.jit
        def pulled(errors, weights, figures=figures):
            value, pull = jax.vjp(figures, errors)
            return value, pull(weights)[0]

        zero = cast(RVErrors.for_design(design), np.float64)
        value, gradient = pulled(zero, np.random.default_rng(0).normal(size=(25, 4)))
        assert np.all(np.asarray(value) == 0)
        for leaf in jax.tree.leaves(gradient):
            assert np.all(np.isfinite(leaf))


def test_second_derivatives_of_a_curve():
    design, errors = catalogue.RV_40E, drawn(catalogue.RV_40E, 10)

    def error(delta):
        return transmission_error(
            design, errors.replace(crank_eccentricity=delta), crank_angle=0.8, output_torque=412.0
        ).error

    delta = errors.crank_eccentricity
    second = np.asarray(jax.jit(jax.hessian(error))(delta)).reshape(4, 4)
    first = jax.jit(jax.grad(error))
    for j in range(4):
        step = 1e-7 * np.eye(4)[j].reshape(2, 2)
        difference = np.ravel((first(delta + step) - first(delta - step)) / 2e-7)
        np.testing.assert_allclose(second[j], difference, rtol=1e-5, atol=1e-2)


def test_lost_units_leave_their_neighbours_alone():
    design = catalogue.RV_40E
    units = drawn(design, 11, units=6)

    def total(design, units):
        def one(errors):
            result = four_bar.revolution(design, errors)
            return jnp.stack([result.peak_to_peak, result.largest_misfit]), result.info.status

        values, status = jax.vmap(one, in_axes=-1)(units)
        return jnp.sum(jnp.where((status == 0)[:, None], values, 0)[:3]), (values, status)

    gradient = jax.jit(jax.grad(total, argnums=(0, 1), has_aux=True))
    (shared, each), (values, status) = gradient(design, units)
    assert set(np.asarray(status)) == {0}
    carrier = np.array(units.carrier_bore)
    carrier[0, 0, 3] = -80 * mm  # the carrier bores change places
    phase = np.array(units.crank_phase)
    phase[1, 4] = np.nan
    clearance = np.array(units.bearing_clearance)
    clearance[5] = np.inf
    lost = changed(units, carrier_bore=carrier, crank_phase=phase, bearing_clearance=clearance)
    (lost_shared, lost_each), (lost_values, lost_status) = gradient(design, lost)
    assert [Status(int(s)).name for s in lost_status[3:]] == ["INVALID_GEOMETRY", "NONFINITE", "NONFINITE"]
    assert np.all(np.isnan(lost_values[3:]))
    assert np.array_equal(lost_values[:3], values[:3])
    for first, second in zip(jax.tree.leaves(shared), jax.tree.leaves(lost_shared)):
        np.testing.assert_allclose(second, first, rtol=1e-12)
    for first, second in zip(jax.tree.leaves(each), jax.tree.leaves(lost_each)):
        assert np.array_equal(second[..., :3], first[..., :3])
        assert np.all(np.asarray(second)[..., 3:] == 0)


def test_statuses():
    def status(design=catalogue.RV_40E, errors=None, **arguments):
        arguments = dict(crank_angle=1.0) | arguments
        result = four_bar.transmission_error(design, errors or RVErrors(), **arguments)
        assert np.isnan(result.error) == (int(result.info.status) not in (Status.CONVERGED, Status.CHANGE_POINT))
        return Status(int(result.info.status)).name

    assert status() == "CONVERGED"
    assert status(crank_angle=np.nan) == "NONFINITE"
    assert status(output_torque=np.inf) == "NONFINITE"
    assert status(errors=RVErrors(eccentricity=np.nan)) == "NONFINITE"
    assert status(errors=RVErrors(pin_radius=np.nan)) == "CONVERGED"  # not read by this model
    assert status(catalogue.RV_40E.replace(cranks=CrankStage(2, np.nan))) == "NONFINITE"
    assert status(crank_angle=0.0, cranks="free") == "CHANGE_POINT"
    assert status(errors=RVErrors(disc_bore=np.full((2, 2, 2), 1 * mm)), cranks="free") == "NOT_ASSEMBLABLE"
    steep = jax.tree.map(lambda leaf: leaf, catalogue.RV_40E)
    object.__setattr__(steep.cycloid, "shortening", 1.0)  # a batch is not checked
    assert status(steep) == "INVALID_GEOMETRY"


def test_impossible_arguments():
    for arguments, message in (
        (dict(closure="quadratic"), "closure"),
        (dict(branch="crossed"), "branch"),
        (dict(cranks="geared"), "gear_stiffness_ratio"),
    ):
        for function in (lambda **a: four_bar.transmission_error(**a, crank_angle=1.0), four_bar.revolution):
            with pytest.raises(ValueError, match=message):
                function(design=catalogue.RV_40E, errors=RVErrors(), **arguments)
    with pytest.raises(ValueError, match="3 cranks"):
        four_bar.transmission_error(reducer(3), RVErrors(), crank_angle=1.0, cranks="free")
    with pytest.raises(ValueError, match=r"RVErrors\.crank_phase"):
        four_bar.transmission_error(catalogue.RV_40E, RVErrors(crank_phase=np.zeros(3)), crank_angle=1.0)
    soft = reducer(stiffness=None)
    four_bar.transmission_error(soft, RVErrors(), crank_angle=1.0)
    for torque in (412.0, np.float64(1.0)):
        with pytest.raises(ValueError, match="bearing_stiffness"):
            four_bar.transmission_error(soft, RVErrors(), crank_angle=1.0, output_torque=torque)
    with pytest.raises(ValueError, match="bearing_stiffness"):
        jax.jit(lambda t: four_bar.revolution(soft, RVErrors(), output_torque=t))(0.0)
