"""Cycle statistics, sweeps, contact pressure, load sharing, stiffness; what statics says about published values.

Oracle: studies of tests/reference/mesh_force.json (40 digits, 1e-9 relative), NumPy in the paper's terms, and
theorems of statics that hold whatever the contact law.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import CamRollerErrors, Status, mesh_force
from rvjax._jax.sizes import lowering
from rvjax.mesh_force import equilibrium
from rvjax.mesh_force.block import Solution
from rvjax.mesh_force.geometry import Case
from rvjax.published.corr import CALIBRATED_TORQUE as TORQUE, PUBLISHED_STUDIES
from tests.oracles import cam_roller
from tests.oracles.cam_roller import corr, geometry, half_widths

CORR = rvjax.catalogue.CORR


def assert_study(found, study):
    """Statistics of one value of a study, with what is left of them on the way."""
    expected = study["statistics"]
    if "status" in expected:
        assert Status(int(found.info.status)).name == expected["status"]
        assert np.isnan(found.cam_mean)
        return
    for name, value in expected.items():
        assert float(getattr(found, name)) == pytest.approx(value, rel=1e-9), (study["value"], name)


def test_statistics_are_those_of_the_reference(reference):
    """Over the eccentricity; sweeps of all parameters in the long profile."""
    for study in reference("mesh_force")["studies"]:
        if (study["figure"], study["contact"]) == ("11", "hertz"):
            design = CORR.replace(eccentricity=study["value"])
            assert_study(mesh_force.cycle_statistics(design, CamRollerErrors(), input_torque=TORQUE), study)


@pytest.mark.long
@pytest.mark.parametrize(("figure", "contact"), [("11", "hertz"), ("12", "hertz"), ("14", "hertz"), ("14", "palmgren")])
def test_reference_studies(reference, figure, contact):
    studies = [s for s in reference("mesh_force")["studies"] if (s["figure"], s["contact"]) == (figure, contact)]
    parameter = PUBLISHED_STUDIES[figure][0]
    values = np.array([s["value"] for s in studies])
    found = mesh_force.sweep(CORR, CamRollerErrors(), parameter, values, input_torque=TORQUE, contact=contact)
    for k, study in enumerate(studies):
        assert_study(jax.tree.map(lambda leaf, k=k: leaf[k], found), study)


@pytest.mark.long
def test_statistics_with_one_error_per_roller():
    """Equal radii give the statistics of one radius; a whole tooth is sampled."""
    design = CORR.replace(gear_teeth=5)
    many = CamRollerErrors.for_design(design, roller_radius=1e-6)
    run = partial(mesh_force.cycle_statistics, design, contact="linear")
    one = run(CamRollerErrors(roller_radius=1e-6), input_torque=50.0)
    all_equal = run(many, input_torque=50.0)
    for name in ("cam_mean", "cam_peak", "gear_mean", "gear_peak", "cage_peak_to_peak", "pressure_peak"):
        assert float(getattr(one, name)) == pytest.approx(float(getattr(all_equal, name)), rel=1e-9), name
    angles = mesh_force.cycle_angles(5, roller_by_roller=True)
    assert angles.shape == (48,) and angles[-1] < 2 * np.pi / 5


def test_a_reversed_torque_works_in_the_other_half():
    errors = CamRollerErrors(roller_radius=1e-6)
    there, back = (mesh_force.cycle_statistics(CORR, errors, input_torque=torque) for torque in (50.0, -50.0))
    for name in ("cam_mean", "cam_peak", "gear_mean", "gear_peak", "cage_peak_to_peak", "pressure_peak"):
        assert float(getattr(back, name)) == pytest.approx(float(getattr(there, name)), rel=1e-9), name
    assert float(back.cage_mean) == pytest.approx(-float(there.cage_mean), rel=1e-9)


def test_pressure_of_the_contacts():
    design, errors = CORR.replace(gear_teeth=8), CamRollerErrors(cam_radius=1e-6)
    cases = corr(1, 8, angle=0.01, errors_cam_radius=1e-6)
    forces = mesh_force.solve(design, errors, input_torque=100.0, output_angle=0.01)
    widths = half_widths(8, cases, jax.tree.map(lambda leaf: np.asarray(leaf)[None], forces))
    pressure = mesh_force.contact_pressure(design, forces, output_angle=0.01)
    # p = 2 F / (pi b l); on the flat cage b is the half-width over the roller radius
    loaded = np.asarray(forces.cage) != 0
    width = widths[0, :, 1] * CORR.roller_radius
    expected = 2 * np.abs(forces.cage)[loaded] / (np.pi * width[loaded] * CORR.roller_length)
    np.testing.assert_allclose(pressure.cage[loaded], expected, rtol=1e-10)
    width = widths[0, :, 0] * CORR.roller_radius  # smaller than the cam
    loaded = np.asarray(forces.cam) != 0
    expected = 2 * np.asarray(forces.cam)[loaded] / (np.pi * width[loaded] * CORR.roller_length)
    np.testing.assert_allclose(pressure.cam[loaded], expected, rtol=1e-10)

    def raised(share):
        more = jax.tree.map(lambda leaf: leaf * share if leaf.dtype == float else leaf, forces)
        return mesh_force.contact_pressure(design, more, output_angle=0.01)

    same, slope = jax.jvp(raised, (1.0,), (1.0,))
    for name in ("cam", "cage", "gear"):  # as the root of the force
        carried = np.asarray(getattr(forces, name)) != 0
        np.testing.assert_allclose(getattr(slope, name)[carried], getattr(same, name)[carried] / 2, rtol=1e-12)
    idle = mesh_force.solve(design, CamRollerErrors(), input_torque=0.0, output_angle=0.01)
    assert not mesh_force.contact_pressure(design, idle, output_angle=0.01).gear.any()


def test_statics_forbid_the_published_cage_forces(thorough):
    """sum s Fs = (z + 1) T however the load is shared, so errors cannot lower the mean cage force by 15 or 25 %.

    s lies between L - e and L + e: at one torque the sum of the cage forces of the working half moves by 5 % at
    most if only that half is loaded, and preload on the return flank can only raise it. Wei et al. 2021 print a
    fall from 239 to 181 N (installation error, Fig. 15) and from 246 to 210 N (roller error, Fig. 16).
    """
    rng = np.random.default_rng(0)
    place = geometry(25, corr(1, angle=0.01))
    arm, s, ratio = (place[name][0] for name in ("arm", "s", "cage_ratio"))
    torque, working = 0.55 * TORQUE, arm > 0
    sums = []
    for _ in range(500):
        cam = rng.exponential(size=26) * (rng.uniform(size=26) < rng.uniform(0.1, 1))
        cam[20] += 1e-3
        preload = rng.integers(2)
        cam = np.where(working, cam, preload * cam * 0.2)
        drive, brake = np.sum((arm * cam)[working]), -np.sum((arm * cam)[~working])
        cam = np.where(working, cam * (torque + brake) / drive, cam)  # any load sharing with the right torque
        assert np.sum(s * ratio * cam) == pytest.approx(26 * torque, rel=1e-9)
        sums.append((preload, np.sum((ratio * cam)[working])))
    low, high = 26 * torque / (0.143 + 0.0035), 26 * torque / (0.143 - 0.0035)
    assert all(low <= total and (preload or total <= high) for preload, total in sums)
    largest_fall = 1 - low / high
    assert largest_fall < 0.05
    assert largest_fall < min(1 - 181 / 239, 1 - 210 / 246)
    if not thorough:  # the census has the sum of the cage forces by default
        return
    found = mesh_force.sweep(
        CORR,
        CamRollerErrors(),
        "errors.roller_radius",
        np.linspace(-2e-5, 2e-5, 5),
        input_torque=TORQUE,
        contact="linear",
    )
    assert (np.diff(found.cage_mean) > -0.05 * found.cage_mean[:-1]).all()


def test_random_errors_are_one_batch():
    """26 independent radii: the peak force of a batch is what every unit gives alone."""
    radii = np.random.default_rng(1).normal(size=(3, 26)) * 1e-6
    batch = cam_roller.solve(25, corr(3, errors_roller_radius=radii)).cam.max(axis=1)
    alone = [cam_roller.solve(25, corr(1, errors_roller_radius=row)).cam.max() for row in radii]
    np.testing.assert_allclose(batch, alone, rtol=1e-12)


@pytest.mark.parametrize("platform", ["cpu", "cuda"])
def test_a_batch_of_several_blocks_is_that_of_one(monkeypatch, platform):
    """A processor solves 600 cases in blocks, a GPU all at once, each at its place; a number that all share stays one.

    What solves a block is replaced by sums of what it gets.
    """
    sizes = []

    def instead(law, teeth, case, size):
        sizes.append(size)
        assert case.palmgren.shape == (1,) and case.radius_error.shape == (size, teeth + 1)
        load = case.torque[:, None] + case.radius_error * case.palmgren[:, None]
        return Solution(case.torque, load, *(case.sine + k for k in range(5)))

    monkeypatch.setattr(equilibrium, "solve_block", instead)
    draw = np.random.default_rng(2).normal
    numbers = {name: draw(size=600) for name in Case._fields} | {"radius_error": draw(size=(600, 6))}
    case = Case(**numbers | {"palmgren": np.array([3.0])})
    with lowering(platform):
        found = equilibrium._in_blocks("linear", 5, jax.tree.map(jnp.asarray, case))
    assert sizes == ([192] if platform == "cpu" else [600])
    np.testing.assert_array_equal(found.windup, case.torque)
    np.testing.assert_allclose(found.load, case.torque[:, None] + 3 * case.radius_error, rtol=1e-15)
    np.testing.assert_array_equal(found.finite, case.sine + 4)
