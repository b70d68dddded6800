"""Matrices, modes, blocks and the mean state of the dynamic model.

Oracles: independent cases computed with 40 digits (tests/reference/dynamics.json, tolerances as stated there),
the NumPy model of dynamics_oracle.py, and the printed appendix of Yang et al. 2018.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import MeshVariation, Status, dynamics
from rvjax.catalogue import RV_20E, RV_320E
from rvjax.published import rv320e
from rvjax.units import arcsec, deg, rpm
from tests.oracles.appendix import printed_stiffness
from tests.oracles.dynamics import Oracle, layout

TORQUE = -3136.0
LAYOUTS = [(4, 3), (3, 2), (3, 1)]
FURTHER = ((5, 4), (2, 3), (3, 3), (4, 2), (2, 2), (2, 4), (6, 5))
LAYOUTS += [pytest.param(*counts, marks=pytest.mark.long) for counts in FURTHER]
NAMES = {
    "x_s": "sun.x",
    "theta_s": "sun.rotation",
    "theta_p1": "planet1.rotation",
    "x_H1": "crank1.x",
    "y_c1": "disc1.y",
    "theta_c1": "disc1.rotation",
    "x_o": "output.x",
    "y_o": "output.y",
    "theta_o": "output.rotation",
}


def stiffness(**changes):
    return RV_320E.replace(stiffness=RV_320E.stiffness.replace(**changes))


def cycloid(**changes):
    return RV_320E.replace(cycloid=RV_320E.cycloid.replace(**changes))


def spectrum(mass, matrix):
    mass = np.asarray(mass)
    values = np.linalg.eigvalsh(np.asarray(matrix) / np.sqrt(np.outer(mass, mass)))
    return np.sqrt(np.maximum(values, 0)) / (2 * np.pi)


@pytest.fixture(scope="module")
def cases(reference):
    return {case["id"]: case for case in reference("dynamics")["cases"]}


DESIGNS = {
    1: RV_320E,
    3: layout(RV_320E, 3, 2),
    6: layout(RV_320E, 3, 1),
    7: stiffness(sun_torsion=0.0),
    9: cycloid(force_angle=0.0),
    12: dynamics.lump(RV_320E).replace(eccentricity=1e-6),
}


# Modes of the other layouts are held against those of NumPy below.
@pytest.mark.parametrize("number", [pytest.param(n, marks=[pytest.mark.long] * (n in (3, 6))) for n in DESIGNS])
def test_natural_frequencies_are_those_of_the_reference(cases, number):
    expected = np.array(cases[number]["out"]["freq"])
    found = dynamics.modes(DESIGNS[number])
    np.testing.assert_allclose(found.frequency, expected, rtol=1e-9, atol=1e-2 if 0 in expected else 0)
    system = dynamics.assemble(DESIGNS[number])
    shape, square = np.asarray(found.shape), (2 * np.pi * np.asarray(found.frequency)) ** 2
    np.testing.assert_allclose(shape.T @ (np.asarray(system.mass)[:, None] * shape), np.eye(len(shape)), atol=1e-12)
    np.testing.assert_allclose(shape.T @ system.stiffness @ shape, np.diag(square), atol=1e-12 * square[-1])


def test_the_inertia_that_the_output_drives_is_of_the_modes():
    """Oracle: the eigenvalues of the assembled matrices, with the mass of the output's rotation increased."""
    load, system = 2.5, dynamics.assemble(RV_320E)
    mass = np.array(system.mass)
    mass[system.labels.index("output.rotation")] += load
    root = 1 / np.sqrt(mass)
    square = np.linalg.eigvalsh(root[:, None] * np.asarray(system.stiffness) * root)
    found = dynamics.modes(RV_320E, load_inertia=load)
    np.testing.assert_allclose(found.frequency, np.sqrt(np.maximum(square, 0)) / (2 * np.pi), rtol=1e-8, atol=1e-2)
    assert found.frequency[1] < 0.99 * dynamics.modes(RV_320E).frequency[1]
    assert int(dynamics.modes(RV_320E, load_inertia=np.nan).info.status) == Status.NONFINITE


def test_the_appendix_is_the_assembled_matrix_but_for_one_sign():
    """With the printed sign a rigid translation strains the bearings, and they leave 5 rigid motions, not 7."""
    ours = np.asarray(dynamics.assemble(RV_320E).stiffness)
    np.testing.assert_allclose(printed_stiffness(RV_320E, corrected=True), ours, rtol=1e-13, atol=1e-6)
    np.testing.assert_allclose(rv320e.printed_stiffness(), printed_stiffness(RV_320E), rtol=1e-13, atol=1e-6)
    oracle = Oracle(RV_320E)
    meshes = sum(8.35e8 * np.outer(v, v) for v in oracle.meshes["cycloid"])
    rigid = np.zeros(39)  # the whole reducer moves along x
    rigid[36] = 1
    for i in range(4):
        for first in (3 + 3 * i, 15 + 3 * i):
            rigid[first : first + 2] = np.cos(np.pi * i / 2), -np.sin(np.pi * i / 2)
    for j in range(3):
        rigid[27 + 3 * j : 29 + 3 * j] = np.cos(2 * np.pi * j / 3), -np.sin(2 * np.pi * j / 3)
    bearings = stiffness(sun_support=0.0, sun_torsion=0.0, sun_planet_mesh=0.0)
    for corrected, nullity in ((True, 7), (False, 5)):
        matrix = printed_stiffness(bearings, corrected=corrected) - meshes
        scale = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1))
        assert np.sum(np.abs(np.linalg.eigvalsh(matrix / np.outer(scale, scale))) < 1e-10) == nullity
        strain = np.abs(matrix @ rigid).max()
        assert strain < 1e-5 if corrected else strain > 3e9
    frequency = spectrum(oracle.m, printed_stiffness(RV_320E))
    pairs = frequency[:-1][np.diff(frequency) < 1e-6 * frequency[1:]]
    np.testing.assert_allclose(pairs[:2], [753.8, 1814.9], atol=0.05)


@pytest.mark.parametrize(("cranks", "discs"), LAYOUTS)
def test_assembly_and_modes_for_every_layout(cranks, discs):
    design = layout(RV_320E, cranks, discs, disc_phase=0.3)
    oracle = Oracle(design)
    system = dynamics.assemble(design)
    assert len(system.labels) == len(system.mass) == 6 * cranks + 3 * discs + 6
    np.testing.assert_array_equal(system.stiffness, system.stiffness.T)
    np.testing.assert_allclose(system.stiffness, oracle.K, rtol=0, atol=1e-15 * np.abs(oracle.K).max() * 10)
    np.testing.assert_array_equal(system.mass, oracle.m)
    found = dynamics.modes(design)
    np.testing.assert_allclose(found.frequency, spectrum(oracle.m, oracle.K), rtol=1e-9, atol=1e-3)
    counts = {kind: int(np.sum(found.kind == kind)) for kind in set(found.kind)}
    if discs == 1:
        assert counts == {"coupled": 6 * cranks + 9}
        return
    central = 4 + 6 * (2 if cranks > 2 else 1) + 3 * (2 if discs > 2 else 1)
    expected = {"rotational": 11, "translational": central, "planetary": 6 * (cranks - 3), "disc": 3 * (discs - 3)}
    assert counts == {kind: number for kind, number in expected.items() if number > 0}


def test_kinds_mean_what_they_say():
    """Eqs. 10 to 12: which central coordinates move, and how members follow one another."""
    found = dynamics.modes(layout(RV_320E, 5, 4))
    labels, shape = dynamics.assemble(layout(RV_320E, 5, 4)).labels, np.asarray(found.shape)
    row = {label: shape[i] for i, label in enumerate(labels)}
    scale = np.abs(shape).max(axis=0)

    def still(names, kind):
        for name in names:
            assert np.abs(row[name] / scale)[found.kind == kind].max() < 1e-9, (name, kind)

    turning, moving = ["sun.rotation", "output.rotation"], ["sun.x", "sun.y", "output.x", "output.y"]
    still(moving, "rotational")
    still(turning, "translational")
    still(turning + moving + [n for n in labels if n.startswith("disc")], "planetary")
    still([n for n in labels if not n.startswith("disc")], "disc")
    alike = found.kind == "rotational"
    np.testing.assert_allclose(row["planet2.y"][alike], row["planet1.y"][alike], atol=1e-9)
    sums = sum(row[f"crank{i}.rotation"] for i in range(1, 6))
    assert np.abs(sums / scale)[~alike].max() < 1e-9


@pytest.mark.parametrize(("cranks", "discs"), [(4, 3), (5, 4), pytest.param(6, 5, marks=pytest.mark.long)])
def test_blocks_have_the_spectrum_of_the_whole(cases, cranks, discs):
    design = layout(RV_320E, cranks, discs, disc_phase=0.7)
    parts = dynamics.blocks(design)
    present = [b for b in (parts.rotational, parts.translational, parts.planetary, parts.disc) if b is not None]
    assert [b.copies for b in present] == [1, 2] + [c for c in (cranks - 3, discs - 3) if c]
    assert [len(b.mass) for b in present] == [11, 11, 6, 3][: len(present)]
    together = np.sort(np.concatenate([np.repeat(spectrum(b.mass, b.stiffness), b.copies) for b in present]))
    oracle = Oracle(design)
    np.testing.assert_allclose(together, spectrum(oracle.m, oracle.K), rtol=1e-11)
    if (cranks, discs) == (4, 3):
        own = spectrum(parts.translational.mass, parts.translational.stiffness)
        np.testing.assert_allclose(own, cases[46]["out"]["freq"], rtol=1e-9)
        assert parts.disc is None


def test_rigid_motions():
    free = np.asarray(dynamics.assemble(stiffness(sun_torsion=0.0)).stiffness)
    lumped, labels = dynamics.lump(RV_320E), dynamics.assemble(RV_320E).labels
    ratio = (39 * 0.04863 + np.cos(20 * deg) * 0.0635) / 0.01057
    turn = {"sun.rotation": ratio, "output.rotation": 1.0}
    for i in range(1, 5):
        turn |= {f"planet{i}.y": 0.0635, f"crank{i}.y": 0.0635}
        turn |= {f"planet{i}.rotation": -39.0, f"crank{i}.rotation": -39.0}
    for j in range(1, 4):
        turn |= {f"disc{j}.y": -lumped.force_arm, f"disc{j}.rotation": 1.0}
    rigid = np.array([turn.get(label, 0.0) for label in labels])
    np.testing.assert_allclose(free @ rigid, 0, atol=1e-12 * np.abs(free).max() * np.abs(rigid).max())

    def nullity(design):
        matrix = np.asarray(dynamics.assemble(design).stiffness)
        root = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1))
        return int(np.sum(np.linalg.eigvalsh(matrix / np.outer(root, root)) < 1e-11))

    sideways = cycloid(force_angle=90 * deg)
    zero = jax.tree.map(jnp.asarray, lumped)  # traced or lumped values may be zero, a design refuses them
    assert nullity(RV_320E) == 0
    assert nullity(stiffness(sun_torsion=0.0)) == nullity(sideways) == 1
    assert nullity(sideways.replace(stiffness=sideways.stiffness.replace(sun_torsion=0.0))) == 2
    for name in ("planet_crank_torsion", "disc_pin_mesh"):
        assert nullity(zero.replace(stiffness=zero.stiffness.replace(**{name: 0.0}))) == 1
    bearings = dict(sun_support=0.0, sun_torsion=0.0, sun_planet_mesh=0.0, disc_pin_mesh=0.0)
    assert nullity(zero.replace(stiffness=zero.stiffness.replace(**bearings))) == 7


def test_the_mean_state_is_that_of_the_reference(cases):
    found = rvjax.check(dynamics.static(RV_320E, output_torque=TORQUE))
    labels = dynamics.assemble(RV_320E).labels
    for number, design in ((20, RV_320E), (23, cycloid(force_angle=1.3962634015954636))):
        found = rvjax.check(dynamics.static(design, output_torque=TORQUE))
        for name, value in cases[number]["out"].items():
            assert float(found.deflection[labels.index(NAMES[name])]) == pytest.approx(value, rel=1e-9, abs=1e-15)
    found = dynamics.static(RV_320E, output_torque=TORQUE)
    assert abs(float(found.deflection[-1])) / arcsec == pytest.approx(108.76, abs=5e-3)
    # Statically determinate, as one of the central parts is free to turn.
    sun_torque = -TORQUE / 185.0747853756
    np.testing.assert_allclose(found.planetary_force, sun_torque / (4 * 0.01057), rtol=1e-9)
    carried = TORQUE + sun_torque * (np.cos(20 * deg) * 0.0635 - 0.04863) / 0.01057
    np.testing.assert_allclose(found.cycloid_force, carried / (3 * np.cos(30 * deg) * (0.0858 + 0.0022)), rtol=1e-9)


@pytest.mark.parametrize(
    ("cranks", "discs"), [*(pytest.param(*n, marks=pytest.mark.long) for n in ((3, 2), (3, 1))), (2, 2)]
)
def test_the_mean_state_of_other_layouts(cranks, discs):
    design = layout(RV_320E, cranks, discs, disc_phase=0.3)
    oracle = Oracle(design)
    found = rvjax.check(dynamics.static(design, output_torque=TORQUE))
    mean = oracle.mean(TORQUE)
    np.testing.assert_allclose(found.deflection, mean, rtol=1e-9, atol=1e-9 * np.abs(mean).max())
    rows = np.array(oracle.meshes["planetary"])
    np.testing.assert_allclose(found.planetary_force, design.stiffness.sun_planet_mesh * rows @ mean, rtol=1e-8)


def test_a_free_input_carries_the_same_forces():
    free = rvjax.check(dynamics.static(stiffness(sun_torsion=0.0), output_torque=TORQUE))
    held = dynamics.static(RV_320E, output_torque=TORQUE)
    np.testing.assert_allclose(free.cycloid_force, held.cycloid_force, rtol=1e-12)
    np.testing.assert_allclose(free.deflection, held.deflection, rtol=1e-9, atol=1e-15)
    frequency = dynamics.modes(stiffness(sun_torsion=0.0)).frequency
    assert frequency[0] == 0 and frequency[1] > 700


def test_mesh_frequencies_and_wave(cases):
    """What `response` makes of them is tested there; here the numbers of the reference, backwards."""
    speed, lumped = cases[17]["out"], jax.tree.map(jnp.asarray, dynamics.lump(RV_320E))
    for stage, name in (("planetary", "f_sp_Hz"), ("cycloid", "f_cp_Hz")):
        w = dynamics.excitation.mesh_frequency(lumped, jnp.asarray(-1000 * rpm), stage)
        np.testing.assert_allclose(np.abs(w) / (2 * np.pi), speed[name], rtol=1e-10)
    wave = dynamics.excitation.wave_coefficients(lumped, "planetary", 9)
    np.testing.assert_allclose(wave, cases[18]["out"]["a"], rtol=1e-10)


def test_torques_that_nothing_balances_have_no_mean_state():
    """Neither sun nor output is held: only the sun torque that leaves the rigid motion without load has an answer."""
    free = stiffness(sun_torsion=0.0)
    balanced = dynamics.static(free, output_torque=TORQUE)
    assert int(balanced.info.status) == Status.CONVERGED
    for sun_torque in (0.0, 10.0):
        found = dynamics.static(free, output_torque=TORQUE, sun_torque=sun_torque)
        assert int(found.info.status) == Status.SINGULAR


def test_the_wave_of_a_mesh_is_a_trapezoid():
    """Its Fourier integral by the midpoint rule, whose kinks leave 1e-9 of the swing with 2^16 points."""
    variation = MeshVariation(0.3, 0.6, 0.1, 0.2, 0.45, 0.3)
    lumped = jax.tree.map(jnp.asarray, dynamics.lump(RV_320E.replace(mesh_variation=variation)))
    t = (np.arange(2**16) + 0.5) / 2**16 - 0.5
    for stage in ("planetary", "cycloid"):
        swing, duty, ramp = (getattr(variation, f"{stage}_{name}") for name in ("swing", "duty", "ramp"))
        wave = swing * np.clip((duty / 2 - np.abs(t)) / ramp + 0.5, 0, 1)  # half high a share `duty` of the period
        exact = 2 * np.mean(wave * np.cos(2 * np.pi * np.arange(1, 10)[:, None] * t), axis=1)
        found = dynamics.excitation.wave_coefficients(lumped, stage, 9)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-8 * swing)


def test_what_is_refused():
    with pytest.raises(ValueError, match="inertia = None"):
        dynamics.assemble(RV_20E)
    with pytest.raises(ValueError, match=r"disc_teeth \+ 1"):
        dynamics.modes(cycloid(pin_count=41))
    with pytest.raises(ValueError, match=r"Stiffness\.disc_pin_mesh = 0"):
        dynamics.static(stiffness(disc_pin_mesh=0.0), output_torque=TORQUE)
    with pytest.raises(ValueError, match="eccentricity"):
        cycloid(eccentricity=0.0)
    with pytest.raises(ValueError, match="three or more cranks and discs"):
        dynamics.blocks(layout(RV_320E, 4, 2))
    for call in (dict(stage="third"), dict(method="magic"), dict(outputs=["output.z"]), dict(harmonics=0)):
        with pytest.raises(ValueError, match=next(iter(call)).removesuffix("s")):
            dynamics.response(RV_320E, sun_speed=100.0, output_torque=TORQUE, **call)


def test_statuses_of_modes_and_mean_state():
    def lane(e, torsion):
        design = RV_320E.replace(
            cycloid=RV_320E.cycloid.replace(eccentricity=e),
            stiffness=RV_320E.stiffness.replace(planet_crank_torsion=torsion),
        )
        return dynamics.static(design, output_torque=TORQUE), dynamics.modes(design)

    e, torsion = [2.2e-3, -1.0, np.nan, 2.2e-3, 2.2e-3], [6.99e4, 6.99e4, 6.99e4, np.inf, 0.0]
    static, modes = jax.tree.map(lambda *x: np.stack(x), *map(jax.jit(lane), e, torsion))
    names = [Status.CONVERGED, Status.INVALID_GEOMETRY, Status.NONFINITE, Status.NONFINITE]
    assert static.info.status.tolist() == [*names, Status.SINGULAR]
    assert modes.info.status.tolist() == [*names, Status.CONVERGED]
    one = dynamics.static(RV_320E, output_torque=TORQUE)
    np.testing.assert_allclose(static.deflection[0], one.deflection, rtol=1e-12, atol=1e-20)
    assert np.isnan(static.deflection[1:4]).all() and np.isnan(modes.frequency[1:4]).all()
    assert np.isfinite(static.deflection[4]).all() and modes.frequency[4, 0] == 0
    pins = dynamics.static(cycloid(force_angle=90 * deg), output_torque=TORQUE)
    assert pins.info.status == Status.INVALID_GEOMETRY


def test_soft_sideways_mode_of_two_discs():
    """With two discs and no output support the output is held sideways by the sun alone."""
    found = dynamics.modes(layout(RV_320E, 3, 2))
    assert found.frequency[0] == pytest.approx(67.36, abs=0.01) and found.kind[0] == "translational"
