"""Mesh forces of the oscillatory roller stage: published-accuracy cases, statuses, extremes, precision.

Oracle: tests/reference/mesh_force.json, 40-digit arithmetic; tolerances stand there (1e-10 of the largest
force: forces come out at 1e-15, the margin is for other processors). Extremes are closed forms.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import CamRollerErrors, CamRollerReducer, Status, mesh_force
from tests.oracles import cam_roller
from tests.oracles.cam_roller import corr, solve

CORR = rvjax.catalogue.CORR
FORCES = ("cam", "cage", "gear")


def batch(cases):
    """Reference cases of equal teeth as a dictionary of arrays."""
    rollers = cases[0]["design"]["gear_teeth"] + 1
    flat = {name: np.array([c["design"][name] for c in cases]) for name in cam_roller.DESIGN}
    flat |= {"errors." + name: np.array([c["errors"][name] for c in cases]) for name in cam_roller.ERRORS[:2]}
    flat["errors.roller_radius"] = np.array([np.broadcast_to(c["errors"]["roller_radius"], rollers) for c in cases])
    flat["torque"] = np.array([c["input_torque"] for c in cases])
    flat["angle"] = np.array([c["output_angle"] for c in cases])
    return flat


@pytest.mark.parametrize(
    ("teeth", "contact"),
    [
        (25, "hertz"),
        pytest.param(25, "linear", marks=pytest.mark.long),  # below is its closed form
        pytest.param(25, "palmgren", marks=pytest.mark.long),  # test_mesh_force_properties.py has a census of it
        pytest.param(8, "hertz", marks=pytest.mark.long),  # test_mesh_force_properties.py has a census of 8 teeth
        pytest.param(24, "hertz", marks=pytest.mark.long),
    ],
)
def test_reference_cases(reference, teeth, contact):
    cases = [
        c for c in reference("mesh_force")["cases"] if (c["design"]["gear_teeth"], c["contact"]) == (teeth, contact)
    ]
    assert cases
    result = solve(teeth, batch(cases), contact)
    for k, case in enumerate(cases):
        expected = case["expected"]
        assert Status(int(result.info.status[k])).name == expected["status"], case["name"]
        if "windup" not in expected:
            assert np.isnan(result.windup[k]) and np.isnan(result.cam[k]).all()
            continue
        largest = max(np.abs(expected[name]).max() for name in FORCES)
        for name in FORCES:
            np.testing.assert_allclose(
                getattr(result, name)[k], expected[name], rtol=0, atol=case["rtol"] * largest, err_msg=case["name"]
            )
        assert abs(result.windup[k] - expected["windup"]) <= case["rtol"] * case["windup_scale"], case["name"]


@pytest.mark.long
@pytest.mark.parametrize("contact", ["hertz", pytest.param("palmgren", marks=pytest.mark.long)])
def test_reference_derivatives(reference, contact, thorough):
    """Reverse against central differences of 40-digit values; forward is the same, test_mesh_force_properties.py."""
    cases = [c for c in reference("mesh_force")["cases"] if "derivatives" in c and c["contact"] == contact]
    flat = batch(cases)
    flat["errors.roller_radius"] = flat["errors.roller_radius"][:, 0]
    most = np.array([c["derivatives"]["roller"] for c in cases])

    def outputs(case, roller):
        result = cam_roller.single(25, contact, case)
        return jnp.stack([result.windup, result.cam[roller], result.cage[roller]])

    names = {"T": "torque", "th": "angle"} | {n: n for n in cam_roller.DESIGN}
    names |= {"err_" + n: "errors." + n for n in cam_roller.ERRORS}
    for derivative in (jax.jacrev, jax.jacfwd) if thorough else (jax.jacrev,):
        found = jax.jit(jax.vmap(derivative(outputs)))(flat, most)
        for k, case in enumerate(cases):
            for j, output in enumerate(("windup", "cam", "cage")):
                expected = case["derivatives"][output]
                scale = {n: 1e-6 if n.startswith("err_") else abs(flat[names[n]][k]) for n in expected}
                scale["th"] = 0.01
                size = max(abs(expected[n]) * scale[n] for n in expected)
                for n in expected:
                    error = abs(float(found[names[n]][k, j]) - expected[n]) * scale[n]
                    assert error <= 1e-7 * size, (case["name"], output, n)


def test_reference_profiles(reference):
    for case in reference("mesh_force")["profiles"]:
        profile = mesh_force.tooth_profile(CamRollerReducer(**case["design"]), case["angle"])
        expected = case["expected"]
        assert bool(profile.undercut) == expected["undercut"]
        for name, size in (("centre", 0.15), ("flank", 0.15), ("normal_angle", 1), ("centre_curvature", 100)):
            if name in expected:
                np.testing.assert_allclose(getattr(profile, name), expected[name], rtol=0, atol=1e-12 * size)
        if "flank_curvature" in expected:
            np.testing.assert_allclose(profile.flank_curvature, expected["flank_curvature"], rtol=1e-12)
            np.testing.assert_allclose(profile.pressure_angle, expected["normal_angle"] - case["angle"], atol=1e-13)


def test_flank_is_an_envelope():
    """The tangent of the flank is perpendicular to the normal; the gear repeats every tooth."""
    flank = jax.jit(jax.vmap(jax.jacfwd(lambda angle: mesh_force.tooth_profile(CORR, angle).flank)))
    angles = np.linspace(-0.3, 0.4, 57)
    tangent = np.asarray(flank(angles))
    profile = jax.vmap(lambda angle: mesh_force.tooth_profile(CORR, angle))(angles)
    normal = np.stack([np.sin(profile.normal_angle), np.cos(profile.normal_angle)], 1)
    size = np.linalg.norm(tangent, axis=1)
    np.testing.assert_allclose(np.sum(tangent * normal, 1) / size, 0, atol=1e-12)
    # curvature is the turn of the normal along the arc
    turn = jax.vmap(jax.grad(lambda angle: mesh_force.tooth_profile(CORR, angle).normal_angle))(angles)
    np.testing.assert_allclose(turn / size, profile.flank_curvature, rtol=1e-10, atol=1e-9)
    again = jax.vmap(lambda angle: mesh_force.tooth_profile(CORR, angle))(angles + 2 * np.pi / 25)
    np.testing.assert_allclose(np.hypot(*again.flank.T), np.hypot(*profile.flank.T), rtol=1e-13)


def test_undercut_limits_of_table_1():
    assert float(mesh_force.largest_roller_radius(CORR)) == pytest.approx(10.05298e-3, rel=1e-6)
    assert np.isinf(mesh_force.largest_roller_radius(CORR.replace(eccentricity=1e-4)))
    margin = mesh_force.undercut_margin
    assert abs(float(margin(CORR.replace(roller_radius=float(mesh_force.largest_roller_radius(CORR)))))) < 1e-12
    assert margin(CORR.replace(eccentricity=4.198e-3)) > 0 > margin(CORR.replace(eccentricity=4.199e-3))
    assert margin(CORR.replace(cam_radius=122.1e-3)) > 0 > margin(CORR.replace(cam_radius=122.0e-3))


BAD = (
    ("roller_radius", 0.02, Status.UNDERCUT),
    ("eccentricity", 4.2e-3, Status.UNDERCUT),
    ("cam_radius", 0.118, Status.UNDERCUT),
    ("eccentricity", 0.0, Status.INVALID_GEOMETRY),
    ("eccentricity", 0.15, Status.INVALID_GEOMETRY),
    ("eccentricity", -1e-3, Status.INVALID_GEOMETRY),
    ("cam_radius", -0.1, Status.INVALID_GEOMETRY),
    ("roller_length", 0.0, Status.INVALID_GEOMETRY),
    ("young_modulus", 0.0, Status.INVALID_GEOMETRY),
    ("torque", np.nan, Status.NONFINITE),
    ("angle", np.inf, Status.NONFINITE),
    ("angle", 1e15, Status.NONFINITE),  # z times it is beyond 2^50, where a sine has few digits left
    ("errors.cam_radius", np.nan, Status.NONFINITE),
    ("eccentricity", np.nan, Status.NONFINITE),
    ("torque", 1e7, Status.CONTACT_OVERLOAD),
    ("torque", 1e300, Status.CONTACT_OVERLOAD),
    ("errors.cam_radius", 5e-3, Status.CONTACT_OVERLOAD),
    ("errors.roller_radius", np.where(np.arange(26) == 7, np.nan, 0.0), Status.NONFINITE),  # of one roller
    ("errors.roller_radius", np.where(np.arange(26) == 7, -1e200, 0.0), Status.NONFINITE),
)


@pytest.mark.parametrize(
    "contact", ["hertz", *(pytest.param(law, marks=pytest.mark.long) for law in ("linear", "palmgren"))]
)
def test_bad_lanes_have_a_status_and_leave_their_neighbours_alone(contact):
    """Every bad lane stands between good ones, whose values equal those of a clean batch; test_mesh_force_properties.py
    has their gradients."""
    rng = np.random.default_rng(3)
    clean = corr(2 * len(BAD), errors_roller_radius=rng.normal(size=(2 * len(BAD), 26)) * 3e-6)
    dirty = {name: v.copy() for name, v in clean.items()}
    for k, (name, value, _) in enumerate(BAD):
        dirty[name][2 * k] = value
    expected, found = solve(25, clean, contact), solve(25, dirty, contact)
    for k, (name, value, status) in enumerate(BAD):
        got = Status(int(found.info.status[2 * k]))
        if status == Status.CONTACT_OVERLOAD and contact != "hertz":
            assert got in (Status.CONVERGED, Status.NONFINITE)
            continue
        assert got == status, (name, value)
        assert np.isnan(found.windup[2 * k]) and np.isnan(found.gear[2 * k]).all()
    for name in (*FORCES, "windup"):
        np.testing.assert_array_equal(getattr(found, name)[1::2], getattr(expected, name)[1::2])


def test_eager_refusals():
    with pytest.raises(ValueError, match=r"eccentricity = 0.2 m: must be smaller than cam_radius"):
        CORR.replace(eccentricity=0.2)
    with pytest.raises(ValueError, match=r"roller_length = 0 m: must be positive"):
        CORR.replace(roller_length=0.0)
    with pytest.raises(ValueError, match="poisson_ratio"):
        CORR.replace(poisson_ratio=1.5)
    with pytest.raises(ValueError, match="contact = 'soft': must be one of hertz"):
        mesh_force.solve(CORR, CamRollerErrors(), input_torque=1.0, output_angle=0.0, contact="soft")
    with pytest.raises(ValueError, match=r"roller_radius: shape \(25,\), expected \(\) or \(26,\)"):
        mesh_force.solve(CORR, CamRollerErrors(roller_radius=np.zeros(25)), input_torque=1.0, output_angle=0.0)
    with pytest.raises(ValueError, match="roller_radius"):
        CamRollerErrors.for_design(CORR, roller_radius=np.zeros(25))
    with pytest.raises(ValueError, match="has no field 'inclination'"):
        mesh_force.sweep(CORR, CamRollerErrors(), "errors.inclination", np.zeros(2), input_torque=1.0)
    assert np.shape(CamRollerErrors.for_design(CORR, roller_radius=1e-6).roller_radius) == (26,)
    assert CORR.error_record is CamRollerErrors


def test_without_torque():
    units = corr(3, torque=0.0, errors_cam_radius=[0.0, -1e-5, 2e-6])
    result = solve(25, units)
    assert [Status(int(s)) for s in result.info.status] == [Status.UNLOADED, Status.UNLOADED, Status.CONVERGED]
    for name in FORCES:
        assert not np.any(getattr(result, name)[:2])
    place = cam_roller.geometry(25, units)
    forward = place["arm"][1] > 0
    assert result.windup[0] == 0
    assert result.windup[1] == pytest.approx(np.min(1e-5 / place["arm"][1][forward]), rel=1e-12)
    assert (result.cam[2] > 0).all()  # preload, the return flank included
    rvjax.check(result)


def test_dead_band_is_the_limit_of_no_torque():
    units = corr(4, torque=[0.0, 1e-9, 1e-6, -1e-9], errors_cam_radius=-1e-5)
    windup = solve(25, units).windup
    assert windup[0] <= windup[1] <= windup[2]
    assert windup[1] == pytest.approx(windup[0], rel=1e-9)
    assert windup[3] < 0


def test_extremes():
    units = corr(
        6,
        torque=[1e-9, 2e-9, 100.0, 1e-3, 1e-3, 1e-3],
        angle=[0.0013, 0.0013, 0.0, 0.0013, 0.0013, 0.0031],
        eccentricity=[3.5e-3, 3.5e-3, 3.5e-3, 1e-6, 2e-6, 3.5e-3],
        errors_cam_radius=[0, 0, 1e-6, 0, 0, -2e-3],
    )
    result = solve(25, units)
    assert (result.info.status == Status.CONVERGED).all()
    np.testing.assert_allclose(2 * result.cam[0], result.cam[1], rtol=1e-12)  # linear at small torque
    assert result.cam[2, 0] > 0 and result.cage[2, 0] == 0  # dead centre carries the interference only
    np.testing.assert_allclose(result.cam[3], 2 * result.cam[4], rtol=2e-4)  # F ~ 1/e
    assert result.windup[3] / result.windup[4] == pytest.approx(4, rel=2e-4)
    # A clearance many orders above the approach: one roller, in static equilibrium.
    loaded = np.flatnonzero(result.cam[5])
    assert len(loaded) == 1
    arm = cam_roller.geometry(25, units)["arm"][5, loaded[0]]
    assert result.cam[5, loaded[0]] == pytest.approx(0.55e-3 / arm, rel=1e-9)


def test_interference_loads_all_rollers():
    for name in ("cam_radius", "roller_radius"):
        result = solve(25, corr(1, **{"errors_" + name: 2e-5}))
        assert (result.cam > 0).all(), name


def test_closed_form_without_errors():
    """Linear contacts: tau = T / sum over the working half of K a^2."""
    units = corr(5, 8, angle=np.linspace(0.01, 1.7, 5), torque=[3.0, 30.0, 100.0, -20.0, 500.0])
    result, place = solve(8, units, "linear"), cam_roller.geometry(8, units)
    modulus = 2 * (1 - 0.3**2) / 2.06e11
    stiffness = np.pi * 0.012 / (2 * modulus * (1 + place["cage_ratio"] ** 2 + place["gear_ratio"] ** 2))
    torque = 0.55 * units["torque"][:, None]
    working = place["arm"] * torque > 0
    windup = torque / np.sum(working * stiffness * place["arm"] ** 2, axis=1, keepdims=True)
    np.testing.assert_allclose(result.windup, windup[:, 0], rtol=1e-12)
    np.testing.assert_allclose(result.cam, working * stiffness * place["arm"] * windup, rtol=1e-9, atol=1e-9)


def test_the_door_gives_one_case():
    """The program of all other tests takes batches, with one error for every roller."""
    design = CORR.replace(gear_teeth=8)
    errors = CamRollerErrors(cam_radius=1e-6, roller_radius=2e-6)
    one = mesh_force.solve(design, errors, input_torque=100.0, output_angle=0.2)
    many = solve(8, corr(1, 8, angle=0.2, errors_cam_radius=1e-6, errors_roller_radius=2e-6), "hertz")
    np.testing.assert_allclose(one.gear, many.gear[0], rtol=1e-13)
    assert isinstance(one, rvjax.MeshForces)
    with pytest.raises(rvjax.SolveError, match="CONTACT_OVERLOAD"):
        rvjax.check(mesh_force.solve(design, CamRollerErrors(), input_torque=1e9, output_angle=0.2))


@pytest.mark.long  # the references hold the same cases in double precision
@pytest.mark.parametrize("contact", ["hertz", "linear", "palmgren"])
def test_float32(contact):
    """Gaps up to 100 elastic approaches and |z theta| <= 150: 2e-4 of the largest force; 5e-6 is usual."""
    rng = np.random.default_rng(5)
    units = corr(
        32,
        8,
        torque=rng.uniform(20, 200, 32),
        angle=rng.uniform(-18, 18, 32),
        errors_roller_radius=rng.normal(size=(32, 9)) * 1e-5,
        errors_cam_radius=rng.normal(size=32) * 1e-5,
    )
    single = {name: v.astype(np.float32) for name, v in units.items()}
    exact = solve(8, {name: v.astype(np.float64) for name, v in single.items()}, contact)
    result = solve(8, single, contact)
    assert result.cam.dtype == result.windup.dtype == np.float32
    assert (result.info.status == Status.CONVERGED).all()
    largest = np.max(exact.gear, axis=1, keepdims=True)
    errors = np.max(np.abs(result.cam - exact.cam) / largest, axis=1)
    assert errors.max() < 2e-4 and np.median(errors) < 2e-5
