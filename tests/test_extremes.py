"""Corners that a census of random inputs found, and properties over the whole domain.

Oracles: the curve of a crank turn for its figures; statics of the returned forces; statuses as the models promise
them; longdouble vectors for a linkage. Tolerances: 1e-9 where angles are compared that two formulas round apart,
1e-10 for residuals. Statuses and finiteness are exact.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

import rvjax
from rvjax import CamRollerErrors, LinkDeviations, RVErrors, Status, catalogue, four_bar, lost_motion
from tests.oracles import cam_roller

KEPT = (Status.CONVERGED, Status.UNLOADED, Status.CHANGE_POINT, Status.SINGULAR)


def finite_as_promised(values, status):
    """Values are finite where the status keeps them and NaN elsewhere."""
    rows = np.concatenate([np.asarray(v).reshape(len(status), -1) for v in values], 1)
    kept = np.isin(np.asarray(status), KEPT)
    assert np.isfinite(rows[kept]).all()
    assert np.isnan(rows[~kept]).all()


@functools.cache
def turn(angles, dtype=np.float64, slopes=False):
    """Figures and curve of a turn for a batch of bore errors and torques, with the gradient of the largest error."""
    design = catalogue.RV_40E

    def figures(bore, torque):
        errors = RVErrors(carrier_bore=bore, bearing_clearance=jnp.asarray(2e-6, bore.dtype))
        found = four_bar.revolution(design, errors, angles=angles, output_torque=torque)
        return found.maximum, found

    return jax.jit(jax.vmap(jax.value_and_grad(figures, has_aux=True) if slopes else figures))


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_figures_of_a_turn_beyond_a_right_angle(dtype, thorough):
    """The tangent of the summed angles wraps there; lanes with small angles share the batch unchanged."""
    rng = np.random.default_rng(3)
    size = 10.0 ** rng.uniform(-7, -0.3, 300)
    bore = (size[:, None, None] * rng.uniform(-1, 1, (300, 2, 2))).astype(dtype)
    bore[..., 0] *= 0.1
    torque = (rng.choice([-400.0, 0.0, 400.0], 300)).astype(dtype)
    most, found = turn(7, dtype)(bore, torque)
    status = np.asarray(found.info.status)
    finite_as_promised([most, found.minimum, found.largest_misfit], status)
    good = status == Status.CONVERGED
    curve = np.asarray(found.error)[good]
    assert (np.abs(curve).max(1) > 1).sum() > 10 and (np.abs(curve).max(1) < 1e-3).sum() > 30
    tolerance = 1e-9 if dtype == np.float64 else 1e-5
    np.testing.assert_allclose(np.asarray(most)[good], curve.max(1), tolerance, 1e-3 * tolerance)
    np.testing.assert_allclose(np.asarray(found.minimum)[good], curve.min(1), tolerance, 1e-3 * tolerance)
    if thorough:  # twice the program; test_four_bar_reducer_derivatives.py has finite gradients of lost units
        assert np.isfinite(turn(7, dtype, slopes=True)(bore, torque)[1]).all()
    # beside other units a unit is what it was
    again, _ = turn(7, dtype)(np.roll(bore, 17, 0), np.roll(torque, 17))
    np.testing.assert_allclose(np.roll(again, -17), most, 1e-5 if dtype == np.float32 else 1e-12)


@pytest.mark.parametrize("angles", [1, *(pytest.param(n, marks=pytest.mark.long) for n in (2, 5))])
def test_any_number_of_angles_and_any_batch_axis(angles):
    rng = np.random.default_rng(angles)
    bore = rng.uniform(-1e-5, 1e-5, (2, 2, 4))
    bore[0, 1, 2] = np.nan

    def figures(bore):
        found = four_bar.revolution(catalogue.RV_40E, RVErrors(carrier_bore=bore), angles=angles)
        return found.maximum, found.peak_to_peak, found.info.status, found.error

    last = jax.jit(jax.vmap(figures, in_axes=-1))(bore)
    np.testing.assert_array_equal(last[2], [0, 0, Status.NONFINITE, 0])
    for lane in (0, 3):
        np.testing.assert_allclose(last[0][lane], last[3][lane].max(), 1e-12)
        np.testing.assert_allclose(last[1][lane], np.ptp(last[3][lane]), 1e-12, 1e-18)
    assert np.isnan(last[0][2]) and np.isfinite(np.delete(np.asarray(last[0]), 2)).all()


@pytest.mark.long  # statuses of lost linkages: test_four_bar_limits.py; their gradients: test_four_bar_derivatives.py
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    ("cranks", "closure"), [("free", "closed_form"), ("free", "newton"), ("phase_locked", "newton")]
)
def test_linkages_too_large_for_the_arithmetic(dtype, cranks, closure):
    """Finite inputs whose squares overflow: a status, NaN, and no NaN in the derivatives."""
    huge = 0.3 * float(np.finfo(dtype).max)
    lanes = np.zeros((8, 5))
    for number, (name, value) in enumerate([(0, huge), (1, huge), (2, huge), (3, huge), (4, huge), (4, -huge)]):
        lanes[number + 1, name] = value
    lanes[7] = 1e-5

    def angle(x):
        deviations = LinkDeviations(crank_1=x[0], coupler=x[1], crank_3=x[2], frame=x[3], joint=x[3:])
        e, spacing = jnp.asarray(1.3e-3, x.dtype), jnp.asarray(0.072, x.dtype)
        found = four_bar.solve_closure(e, spacing, deviations, crank_angle=1.1, cranks=cranks, closure=closure)
        return jnp.where(jnp.isfinite(found.coupler_angle), found.coupler_angle, 0), found

    (_, found), slope = jax.jit(jax.vmap(jax.value_and_grad(angle, has_aux=True)))(lanes.astype(dtype))
    finite_as_promised([found.coupler_angle, found.misfit], found.info.status)
    np.testing.assert_array_equal(found.info.status, [0, *[Status.NONFINITE] * 6, 0])
    assert np.isfinite(slope).all()


@pytest.mark.parametrize("profile", ["first_order", pytest.param("contact", marks=pytest.mark.long)])
def test_lost_motion_too_large_or_too_small(profile):
    """Terms that overflow and a search without end: a status, NaN, finite derivatives."""
    design = catalogue.RV_40E
    e, rp = design.cycloid.eccentricity, design.cycloid.pin_circle_radius
    lanes = jnp.array([[e, rp, 0, 0], [1e-300, rp, 0, 1e-6], [e, rp, 1e300, 0], [0.999999 * rp / 40, rp, 2e-7, 1e-7]])

    def total(x):
        cycloid = design.cycloid.replace(
            eccentricity=x[0], pin_circle_radius=x[1], shift_modification=x[2], shortening=None
        )
        errors = RVErrors(pin_radius=-x[3], eccentricity=x[3])
        found = lost_motion.geometric(design.replace(cycloid=cycloid), errors, profile=profile)
        return jnp.where(jnp.isfinite(found.total), found.total, 0), found

    (_, found), slope = jax.jit(jax.vmap(jax.value_and_grad(total, has_aux=True)))(lanes)
    finite_as_promised([found.total, found.play], found.info.status)
    np.testing.assert_array_equal(found.info.status[:3], [0, Status.NONFINITE, Status.NONFINITE])
    assert np.isfinite(slope).all()


@functools.cache
def stage(teeth, contact):
    def solve(case):
        design = catalogue.CORR.replace(gear_teeth=teeth, eccentricity=case["e"], roller_radius=case["r"])
        design = design.replace(young_modulus=case["E"], cam_radius=case["cam"], roller_length=case["length"])
        errors = CamRollerErrors(case["cam_error"], case["throw_error"], case["radius_error"])
        found = rvjax.mesh_force.solve(
            design, errors, input_torque=case["torque"], output_angle=case["angle"], contact=contact
        )
        return jnp.sum(jnp.where(jnp.isfinite(found.gear), found.gear, 0)), found

    return jax.jit(jax.vmap(jax.value_and_grad(solve, has_aux=True)))


def units(count, teeth=2, **changes):
    case = dict(e=2e-3, r=8e-3, E=2e11, cam=0.135, length=0.012, cam_error=0.0, throw_error=0.0, torque=50.0, angle=0.3)
    case = {name: np.full(count, value) for name, value in case.items()}
    return case | {"radius_error": np.zeros((count, teeth + 1))} | changes


@pytest.mark.parametrize(
    "contact", ["hertz", *(pytest.param(law, marks=pytest.mark.long) for law in ("linear", "palmgren"))]
)
def test_rollers_too_large_for_the_arithmetic(contact):
    case = units(LANES)  # the first six, in the program of all examples below
    case["torque"][:6] = [50.0, 1e300, -1e300, 50.0, 50.0, 50.0]
    case["e"][:6] = [2e-3, 2e-3, 2e-3, 1e-250, 2e-3, 2e-3]
    case["E"][:6] = [2e11, 2e11, 2e11, 2e11, 1e-300, 2e11]
    case["cam_error"][:6] = [0, 0, 0, 0, 0, -1e300]
    (_, found), slope = stage(2, contact)(case)
    finite_as_promised([found.cam, found.cage, found.gear, found.windup], found.info.status)
    crushed = Status.CONTACT_OVERLOAD if contact == "hertz" else Status.NONFINITE
    expected = [0, crushed, crushed, Status.NONFINITE, crushed, Status.NONFINITE, *[0] * (LANES - 6)]
    np.testing.assert_array_equal(found.info.status, expected)
    assert all(np.isfinite(leaf).all() for leaf in slope.values())


def test_a_cam_lost_in_the_rounding_of_the_link():
    """1e-30 m beside a roller of 9 mm: a contact of radius zero, and gradients that were NaN. Likewise loads that
    vanish when squared."""
    case = units(LANES)
    case["cam"][:4] = [0.135, 1e-30, 0.135, 0.135]
    case["length"][:4] = [0.012, 0.012, 1e-300, 0.012]
    case["torque"][:4] = [1e-9, 1e-9, 0, 1e-300]
    (_, found), slope = stage(2, "hertz")(case)
    np.testing.assert_array_equal(found.info.status[:5], [0, *[Status.NONFINITE] * 3, 0])
    assert all(np.isfinite(leaf).all() for leaf in slope.values())


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_one_preloaded_roller_near_dead_centre_against_a_small_torque(dtype):
    """Steps below the rounding of the depths never end by themselves: these lanes ran out of steps."""
    rng = np.random.default_rng(0)
    count, teeth = 512, 2
    radius_error = rng.uniform(-1, 0.3, (count, 3)) * 10 ** rng.uniform(-9, -6, (count, 1))
    torque = 10 ** rng.uniform(-9, -5, count)
    angle = (rng.integers(0, 6, count) * np.pi / 3 + 10 ** rng.uniform(-4, -2, count)) / teeth
    given = dict(eccentricity=2e-3, young_modulus=2e11, torque=torque, angle=angle, errors_roller_radius=radius_error)
    case = cam_roller.corr(count, teeth, **given)
    found = cam_roller.solve(teeth, {name: value.astype(dtype) for name, value in case.items()}, "linear")
    assert np.isin(found.info.status, (Status.CONVERGED, Status.UNLOADED)).all()


@pytest.mark.long  # test_dynamics_response.py has statuses of extremes, test_dynamics_derivatives.py a failed lane
def test_dynamics_beyond_the_arithmetic():
    """Masses and lengths whose products overflow; amplitudes of a NONFINITE lane are NaN like the mean."""
    base = catalogue.RV_320E

    def amplitude(x):
        inertia, cycloid = base.inertia.replace(planet_inertia=x[0]), base.cycloid.replace(eccentricity=x[1])
        design = base.replace(inertia=inertia, cycloid=cycloid)
        found = rvjax.dynamics.response(design, sun_speed=100.0, output_torque=x[2], harmonics=1)
        size = jnp.sum(jnp.abs(jnp.where(jnp.isfinite(found.mean), found.mean, 0)))
        return size, (found.amplitude.real, found.mean, found.info.status)

    lanes = jnp.array([[1e-3, 2e-3, -3e3], [1e-300, 2e-3, -3e3], [1e-3, 1e300, -3e3], [1e-3, 2e-3, 1e300]])
    (_, (amplitudes, mean, status)), slope = jax.jit(jax.vmap(jax.value_and_grad(amplitude, has_aux=True)))(lanes)
    np.testing.assert_array_equal(status, [0, *[Status.NONFINITE] * 3])
    finite_as_promised([amplitudes, mean], status)
    assert np.isfinite(slope).all()


# --- properties


LANES = 64


@st.composite
def signed_decades(draw, low, high):
    """A batch seed and spread: lanes are drawn by NumPy, for one program serves all examples."""
    return draw(st.integers(0, 2**32 - 1)), draw(st.floats(low, high))


@given(signed_decades(-9, -0.5))
def test_free_linkages_close(drawn):
    """Whatever converges closes; whatever cannot close says so; nothing else is finite."""
    seed, decade = drawn
    rng = np.random.default_rng(seed)
    e = rng.uniform(0.001, 0.03, LANES)
    x = e[:, None] * 10**decade * rng.uniform(-3, 3, (LANES, 6))
    angle = rng.uniform(-7, 7, LANES)
    found = closing()(e, x, angle)
    finite_as_promised([found.coupler_angle], found.info.status)
    pin = (e + x[:, 0]) * np.exp(1j * angle)
    frame = 0.1 + x[:, 3] + x[:, 4] + 1j * x[:, 5]
    reach, l2, l3 = np.abs(frame - pin), 0.1 + x[:, 1], e + x[:, 2]
    slack = np.minimum(l2 + l3 - reach, reach - np.abs(l2 - l3))
    status = np.asarray(found.info.status)
    valid = (e + x[:, 0] > 0) & (l3 > 0) & (l2 > 0) & (0.1 + x[:, 3] > 0)
    assert (status[~valid] == Status.INVALID_GEOMETRY).all()
    assert (status[valid & (slack < -1e-12)] == Status.NOT_ASSEMBLABLE).all()
    assert np.isin(status[valid & (slack > 1e-12)], KEPT).all()
    good = status == Status.CONVERGED
    miss = np.abs(np.abs(pin + l2 * np.exp(1j * np.asarray(found.coupler_angle)) - frame) - l3)[good]
    assert (miss < 1e-14).all()


@functools.cache
def closing():
    def close(e, x, angle):
        deviations = LinkDeviations(crank_1=x[0], coupler=x[1], crank_3=x[2], frame=x[3], joint=x[4:])
        spacing = jnp.full_like(e, 0.1)
        return four_bar.solve_closure(e, spacing, deviations, crank_angle=angle, cranks="free", closure="closed_form")

    return jax.jit(jax.vmap(close))


@given(signed_decades(-9, 0))
def test_rollers_are_in_equilibrium(drawn):
    """Virtual work of the cage, sum s Fs = n T, and no force that pulls, for every load and interference."""
    seed, decade = drawn
    rng = np.random.default_rng(seed)
    case = units(LANES, torque=rng.choice([-1, 0, 1], LANES) * 10 ** rng.uniform(-9, 6, LANES))
    case["radius_error"] = 8e-3 * 10**decade * rng.uniform(-1, 1, (LANES, 3))
    case["angle"] = rng.choice([0, np.pi / 12, 1], LANES) * rng.uniform(-7, 7, LANES)
    case["e"] = rng.uniform(1e-5, 0.05, LANES)
    (_, found), slope = stage(2, "hertz")(case)
    status = np.asarray(found.info.status)
    finite_as_promised([found.cam, found.cage, found.gear, found.windup], status)
    assert (status != Status.MAX_STEPS).all()
    assert all(np.isfinite(leaf).all() for leaf in slope.values())
    good = np.isin(status, (Status.CONVERGED, Status.UNLOADED))
    assert (np.asarray(found.info.residual)[good] <= 1e-10).all()
    assert (np.asarray(found.cam)[good] >= 0).all() and (np.asarray(found.gear)[good] >= 0).all()
    psi = 2 * case["angle"][:, None] - 2 * np.pi * np.arange(3) / 3
    ray = case["e"][:, None] * np.cos(psi) + np.sqrt(0.143**2 - (case["e"][:, None] * np.sin(psi)) ** 2)
    moments = ray * np.asarray(found.cage)
    size = np.maximum(np.abs(moments).sum(1), 3 * np.abs(case["torque"])) + 1e-300
    miss = np.abs(moments.sum(1) - 3 * 0.55 * case["torque"]) / size
    assert (miss[good] < 1e-9).all()
