"""Forced response: first order, harmonic balance, exact periodic solution.

Oracles: independent cases (tests/reference/dynamics.json, tolerances as stated there); dense NumPy solves of
dynamics_oracle.py, full harmonic balance included, to 1e-9 of the largest amplitude of each coordinate; the
exact periodic solution, to which harmonic balance must tend.
"""

from functools import cache

import jax
import numpy as np
import pytest

import rvjax
from rvjax import Damping, Status, dynamics
from rvjax.catalogue import RV_320E
from rvjax.dynamics.assembly import spring_table
from rvjax.dynamics.response import METHODS
from rvjax.dynamics.static import Torques, balancing_torque
from rvjax.units import rpm
from tests.oracles.dynamics import Oracle, layout

TORQUE = -3136.0
RATED = 1000 * rpm
DAMPING = Damping(loss_factor=0.02, rayleigh_mass=30.0, rayleigh_stiffness=2e-7, modal_ratio=0.01)
NAMES = {
    "x_s": "sun.x",
    "theta_s": "sun.rotation",
    "theta_p1": "planet1.rotation",
    "x_H1": "crank1.x",
    "y_c1": "disc1.y",
    "x_o": "output.x",
    "y_o": "output.y",
    "theta_o": "output.rotation",
}
STAGE = {"sp": "planetary", "cp": "cycloid"}
SHOWN = spring_table(4, 3).labels  # every coordinate of the RV-320E
READ = [SHOWN.index(name) for name in NAMES.values()]


def varied(design, **changes):
    return design.replace(mesh_variation=design.mesh_variation.replace(**changes))


def solve(design, **options):
    """With all outputs of the RV-320E unless told."""
    defaults = dict(sun_speed=RATED, output_torque=TORQUE, outputs=SHOWN)
    return dynamics.response(design, **(defaults | options))


@cache
def program(stage, method):
    """The response with the design traced, so that one program serves most tests, impossible designs too."""

    def one(design, speed, torque):
        return solve(design, sun_speed=speed, output_torque=torque, stage=stage, method=method)

    return jax.jit(one)


def solve_each(designs, speeds, torques=TORQUE, stage="planetary", method="first_order"):
    """Responses of stacked designs like the RV-320E, one after the other."""
    speeds = np.asarray(speeds)
    arguments = (designs, speeds, np.broadcast_to(torques, speeds.shape).astype(speeds.dtype))
    rows = [program(stage, method)(*jax.tree.map(lambda x, k=k: x[k], arguments)) for k in range(len(speeds))]
    return jax.tree.map(lambda *x: np.stack(x), *rows)


def stacked(*designs):
    damped = [design.replace(damping=design.damping or Damping()) for design in designs]
    return jax.tree.map(lambda *x: np.array(x, float), *damped)


def all_labels(design):
    return dynamics.assemble(design).labels


def assert_close(found, expected, rtol):
    """Within rtol of the largest amplitude of each coordinate, and a hundredth of the largest of its type."""
    scale = np.abs(expected).max(axis=0)
    kinds = np.arange(expected.shape[1]) % 3 == 2
    for kind in (kinds, ~kinds):
        scale[kind] = np.maximum(scale[kind], 1e-2 * scale[kind].max())
    assert (np.abs(found - expected) / scale).max() < rtol


@pytest.fixture(scope="module")
def cases(reference):
    return {case["id"]: case for case in reference("dynamics")["cases"]}


@pytest.mark.parametrize(
    ("stage", "numbers"),
    # dense solves of both methods have the cycloid stage by default
    [("planetary", (25, 28, 33)), pytest.param("cycloid", (30,), marks=pytest.mark.long)],
)
def test_first_order_is_that_of_the_reference(cases, stage, numbers):
    rated = {"planetary": 248.64864864864865, "cycloid": 140.54054054054052}[stage]
    given = [cases[number] for number in numbers]
    assert {STAGE[case["stage"]] for case in given} == {stage}
    speeds = np.array([case["f_mesh_Hz"] for case in given]) / rated * RATED
    found = solve_each(stacked(*[RV_320E] * len(given)), speeds, stage=stage)
    assert np.all(found.info.status == Status.CONVERGED)
    for k, (number, case) in enumerate(zip(numbers, given)):
        assert set(case["out"]) == set(NAMES)
        np.testing.assert_allclose(found.frequency[k], case["f_mesh_Hz"] * np.arange(1, 10), rtol=1e-10)
        expected = np.array([complex(*case["out"][name]) for name in NAMES])
        ours, atol = found.amplitude[k, case["harmonic"] - 1, READ], 1e-13 * np.abs(expected).max()
        np.testing.assert_allclose(ours, expected, rtol=1e-5 if number == 33 else 1e-8, atol=atol)
        assert np.all(ours[expected == 0] == 0)  # suppressed


def test_harmonic_balance_is_that_of_the_reference(cases):
    case = cases[48]
    design = RV_320E.replace(damping=Damping(loss_factor=0.04))
    found = jax.tree.map(np.asarray, solve(design, method="harmonic_balance", harmonics=20))
    assert found.form == "cyclic"
    names = ("x_o", "theta_o", "theta_s")
    columns = np.array([SHOWN.index(NAMES[name]) for name in names])
    for order, values in case["out"].items():
        expected = np.array([complex(*values[name]) for name in names])
        ours = found.mean if order == "0" else found.amplitude[int(order) - 1] / 2
        np.testing.assert_allclose(ours[columns], expected, rtol=1e-8, atol=1e-16)


LAYOUTS = [  # the whole model and the mesh form: test_dynamics_unequal.py
    pytest.param(4, 3, "planetary", marks=pytest.mark.long),
    pytest.param(3, 2, "planetary", marks=pytest.mark.long),
    (3, 2, "cycloid"),
    pytest.param(2, 3, "cycloid", marks=pytest.mark.long),
    pytest.param(2, 2, "planetary", marks=pytest.mark.long),
    pytest.param(3, 1, "planetary", marks=pytest.mark.long),
    pytest.param(5, 4, "cycloid", marks=pytest.mark.long),
]


@pytest.mark.parametrize(("cranks", "discs", "stage"), LAYOUTS)
def test_both_methods_equal_dense_solves(cranks, discs, stage):
    """First order and harmonic balance, all coordinates, all dampings, forwards and backwards, all kinds of layout."""
    design = layout(RV_320E, cranks, discs, disc_phase=0.3).replace(damping=DAMPING)
    design = varied(design, planetary_swing=0.5, cycloid_swing=0.4, planetary_ramp=0.1)
    oracle, harmonics = Oracle(design), 4
    w = oracle.frequency(stage, RATED)
    options = dict(stage=stage, harmonics=harmonics, outputs=all_labels(design))

    @jax.jit
    @jax.vmap
    def run(speed):
        return [solve(design, sun_speed=speed, method=method, **options) for method in METHODS]

    first, full = run(np.array([RATED, -RATED]))
    for found in (first, full):
        assert np.all(found.info.status == Status.CONVERGED) and np.all(found.info.residual < 1e-13)
        np.testing.assert_allclose(found.frequency[1], w * np.arange(1, harmonics + 1) / (2 * np.pi), rtol=1e-12)
    assert first.form == ("first_order" if discs > 1 else "first_order_whole")
    assert full.form == ("cyclic" if cranks >= 3 and (discs >= 3 or stage == "cycloid") else "mesh")
    forwards = oracle.stage(stage, 2 * harmonics)
    for lane, sign in enumerate((1, -1)):  # backwards the mesh phases change sign
        rows, k, phase, a = forwards
        oracle.stage = lambda *_, turned=(rows, k, sign * phase, a): turned
        assert_close(np.asarray(first.amplitude[lane]), oracle.first_order(stage, w, harmonics, TORQUE), 1e-9)
        expected = oracle.harmonic_balance(stage, w, harmonics, TORQUE)[harmonics:]
        assert_close(np.asarray(full.amplitude[lane]) / 2, expected[1:], 1e-9)
        mean = np.asarray(full.mean[lane])
        np.testing.assert_allclose(mean, expected[0].real, rtol=1e-9, atol=1e-9 * np.abs(mean).max())


@pytest.mark.long  # dense solves hold both
def test_the_cyclic_and_the_mesh_form_agree():
    """The mesh form holds everywhere; where the cyclic form is chosen both must give the same."""
    lumped = dynamics.lump(RV_320E.replace(damping=DAMPING))
    numbers, (speed, torque), _ = dynamics.assembly.admitted(lumped, RATED, TORQUE)
    w = dynamics.excitation.mesh_frequency(numbers, speed, "cycloid")
    torques = Torques(balancing_torque(numbers, torque), torque)
    arguments = (numbers, w, torques, "cycloid", 6, np.array([0, 2, 27, 36, 38]))
    cyclic, mesh = (
        jax.jit(lambda n, w, t, solve=solve: solve(n, w, t, *arguments[3:]))(*arguments[:3])
        for solve in (dynamics.harmonic_balance.solve_cyclic, dynamics.harmonic_balance.solve_mesh)
    )
    scale = np.abs(np.asarray(cyclic.amplitude)).max(axis=0)
    np.testing.assert_allclose(np.asarray(mesh.amplitude) / scale, np.asarray(cyclic.amplitude) / scale, atol=1e-10)
    np.testing.assert_allclose(mesh.mean, cyclic.mean, rtol=1e-9, atol=1e-16)


def samples(found, count):
    time = np.arange(count) / count
    orders = np.arange(1, len(found.amplitude) + 1)
    waves = np.exp(2j * np.pi * np.outer(time, orders)) @ np.asarray(found.amplitude)
    return np.asarray(found.mean) + waves.real


def test_the_exact_solution_and_how_harmonics_approach_it(cases, thorough):
    case, outputs = cases[42]["out"], ("output.x", "output.rotation", "sun.rotation")
    design = RV_320E.replace(damping=Damping(modal_ratio=0.02))
    exact = rvjax.check(dynamics.periodic(design, sun_speed=RATED, output_torque=TORQUE, samples=128, outputs=outputs))
    expected = [case["q_o_x_at_t0"], case["theta_o_at_t0"], case["theta_s_at_t0"]]
    np.testing.assert_allclose(exact.deflection[0], expected, rtol=1e-7)
    assert float(exact.multiplier) == pytest.approx(case["rho"], rel=1e-7)
    columns = [SHOWN.index(name) for name in outputs]
    article = jax.tree.map(lambda x: x[0], solve_each(stacked(design), [RATED]))
    assert float(samples(article, 1)[0, columns[1]]) == pytest.approx(case["article9_theta_o_at_t0"], rel=1e-9)

    moving = np.asarray(exact.deflection) - np.asarray(article.mean)[columns]
    error = {}
    found = {9: article, 20: jax.tree.map(np.asarray, solve(design, method="harmonic_balance", harmonics=20))}
    if thorough:
        found[60] = solve(design, method="harmonic_balance", harmonics=60)
    for harmonics, one in found.items():
        miss = samples(one, 128)[:, columns] - np.asarray(exact.deflection)
        error[harmonics] = np.sqrt(np.mean(miss**2, axis=0) / np.mean(moving**2, axis=0))
    np.testing.assert_allclose(error[9], [0.27, 0.56, 0.38], atol=0.01)
    np.testing.assert_allclose(error[20], [0.067, 0.071, 0.33], atol=0.01)
    if thorough:
        assert np.all(error[60] < [1e-3, 1.2e-3, 4e-3])


@pytest.mark.long  # a further design; the reference and many harmonics hold the exact solution of the RV-320E
def test_the_exact_solution_of_a_free_reducer_running_backwards():
    """Neither end held, two cranks, backwards: harmonic balance with many harmonics is the comparison."""
    design = layout(RV_320E, 2, 2, disc_phase=0.3).replace(damping=Damping(modal_ratio=0.05))
    design = design.replace(stiffness=design.stiffness.replace(sun_torsion=0.0))
    options = dict(sun_speed=-3 * RATED, output_torque=TORQUE, stage="cycloid", outputs=("output.rotation", "disc1.x"))
    exact = dynamics.periodic(design, samples=64, **options)
    assert exact.info.status == Status.CONVERGED
    found = dynamics.response(design, method="harmonic_balance", harmonics=40, **options)
    moving = np.asarray(exact.deflection) - np.asarray(exact.deflection).mean(axis=0)
    miss = samples(found, 64) - np.asarray(exact.deflection)
    assert np.all(np.abs(miss - miss.mean(axis=0)).max(axis=0) < 5e-3 * np.abs(moving).max(axis=0))


def test_symmetry_of_the_response():
    """Members repeat one another one phase later; zero where the harmonic excites nothing that is shown."""
    design = RV_320E.replace(damping=DAMPING)
    labels = SHOWN
    found = dict(zip(labels, solve_each(stacked(design), [RATED]).amplitude[0].T))
    orders = np.arange(1, 10)
    for i in range(4):
        shift = np.exp(2j * np.pi * orders * 15 * i / 4)
        np.testing.assert_allclose(found[f"planet{i + 1}.y"], shift * found["planet1.y"], rtol=1e-9, atol=1e-20)
    for n in orders:
        rotational, translational = found["output.rotation"][n - 1], found["output.x"][n - 1]
        assert (rotational != 0) == (n % 4 == 0) and (translational != 0) == (n % 2 == 1)
    k = np.where(orders * 15 % 4 == 1, 1, -1)[::2]
    np.testing.assert_allclose(found["output.y"][::2], 1j * k * found["output.x"][::2], rtol=1e-9)
    few = solve(design, outputs=["output.rotation"], harmonics=4)
    np.testing.assert_allclose(few.amplitude[:, 0], found["output.rotation"][:4], rtol=1e-12)
    assert np.isinf(few.resonance_distance).tolist() == [True, True, True, False]


def test_scaling_and_limits():
    base = RV_320E.replace(damping=Damping(loss_factor=0.05))
    # k c^2 at equal masses moves every frequency by c.
    stiff = base.replace(stiffness=jax.tree.map(lambda k: 9 * k, base.stiffness))
    doubled, small = varied(base, planetary_swing=0.6), [varied(base, planetary_swing=swing) for swing in (1e-3, 1e-4)]
    designs, speeds = (base, base, doubled, base, stiff, *small), np.array([1, 1, 1, 1, 3, 1, 1.0]) * RATED
    torques = np.array([1, 2, 1, 0, 1, 1, 1.0]) * TORQUE
    one, *others = solve_each(stacked(*designs), speeds, torques).amplitude
    np.testing.assert_allclose(others[0], 2 * one, rtol=1e-12)
    np.testing.assert_allclose(others[1], 2 * one, rtol=1e-12)
    assert np.all(others[2] == 0)
    np.testing.assert_allclose(dynamics.modes(stiff).frequency, 3 * dynamics.modes(base).frequency, rtol=1e-9)
    np.testing.assert_allclose(others[3], one / 9, rtol=1e-9, atol=1e-30)
    # Harmonic balance tends to first order as the swing goes to zero, quadratically apart.
    full = [solve(design, method="harmonic_balance", harmonics=20).amplitude for design in small]
    gaps = [np.abs(np.asarray(balanced)[:9] - first).max() for balanced, first in zip(full, others[4:])]
    assert gaps[0] / gaps[1] == pytest.approx(100, rel=0.05)


@pytest.mark.parametrize("method", ["first_order", pytest.param("harmonic_balance", marks=pytest.mark.long)])
def test_extremes(method):
    """Inputs at the edge of the domain give numbers or a status, never silent NaN."""

    @jax.jit
    @jax.vmap
    def changed(changes):
        sun_torsion, sun_support, torsion, bending, angle, e, swing, mesh, _ = changes
        return RV_320E.replace(
            stiffness=RV_320E.stiffness.replace(
                sun_torsion=sun_torsion,
                sun_support=sun_support,
                planet_crank_torsion=torsion,
                planet_crank_bending=bending,
                disc_pin_mesh=mesh,
            ),
            cycloid=RV_320E.cycloid.replace(force_angle=angle, eccentricity=e),
            mesh_variation=RV_320E.mesh_variation.replace(planetary_swing=swing),
            damping=Damping(),
        )

    nominal = dict(
        kst=1.16e4, ks=4.19e7, kH=6.99e4, ka=2.33e8, beta=np.pi / 6, e=2.2e-3, swing=0.3, kcr=8.35e8, n=RATED
    )
    cases = [
        *(dict(), dict(kst=0.0), dict(ks=0.0), dict(kH=100.0), dict(ka=1e12, kH=1e9), dict(beta=0.0)),
        *(dict(beta=np.radians(80)), dict(e=1e-6), dict(swing=0.9), dict(swing=0.0), dict(n=0.0)),
        *(dict(beta=np.pi / 2), dict(e=-1e-3), dict(kcr=0.0), dict(kH=0.0), dict(ks=np.nan), dict(n=np.inf)),
    ]
    rows = np.array([list((nominal | change).values()) for change in cases])
    found = solve_each(jax.tree.map(np.asarray, changed(rows)), rows[:, -1], method=method)
    good = [Status.CONVERGED] * 11
    bad = [Status.INVALID_GEOMETRY] * 2 + [Status.SINGULAR] * 2 + [Status.NONFINITE] * 2
    assert found.info.status.tolist() == good + bad
    finite = np.isfinite(found.amplitude).all(axis=(1, 2))
    assert finite[:11].all() and not finite[[11, 12, 15, 16]].any()
    assert np.all(found.amplitude[9] == 0)


def test_a_harmonic_on_a_mode():
    """Undamped on resonance to rounding: a large number or SINGULAR, never NaN."""
    mode = float(dynamics.modes(RV_320E).frequency[1])
    speed = mode / 248.64864864864865 * RATED
    speeds = [np.nextafter(speed, 0.0), speed, np.nextafter(speed, np.inf), RATED]
    found = solve_each(stacked(*[RV_320E] * 4), speeds)
    assert np.isfinite(found.amplitude).all()
    size = np.abs(found.amplitude[:, 0, SHOWN.index("output.x")])
    assert np.all(size[:3] > 1e3 * size[3])
    assert set(found.info.status.tolist()) <= {Status.CONVERGED, Status.SINGULAR}
    assert np.all(found.resonance_distance[:3, 0] < 1e-12)


@pytest.mark.long  # the reference holds double precision by default
def test_single_precision(thorough):
    """Against double precision of the same rounded inputs.

    With u the unit roundoff and gamma = 11 u for the 11 unknowns of a sector, mesh forces keep gamma times the
    rounding of a mesh deflection, and the square of a mode keeps 2 gamma kappa, kappa = sum k |v.phi| |v|.|phi| / w^2.
    A share d away from an undamped mode the latter grows by 1 / (2 d), at a mode of loss factor eta by 1 / eta.
    Observed: up to 6e-6 and 3e-4 beside 9e-5 and 1.5e-3 (d = 0.1 and 1e-3), 2e-5 beside 6e-4 with damping.
    """

    def single(tree):
        return jax.tree.map(np.float32, tree)

    def pair(design, speeds, **options):
        """Amplitudes (speeds, harmonics, outputs) in double and in single precision."""
        given = single((stacked(*[design] * len(speeds)), np.asarray(speeds)))
        found = [solve_each(*jax.tree.map(kind, given), **options) for kind in (np.float64, np.float32)]
        assert all(np.all(one.info.status == Status.CONVERGED) for one in found)
        fine, coarse = (one.amplitude for one in found)
        assert (fine.dtype, coarse.dtype) == (np.complex128, np.complex64)
        return fine, coarse

    oracle, gamma = Oracle(jax.tree.map(lambda x: float(np.float32(x)), RV_320E)), 11 * np.finfo(np.float32).eps / 2
    squares, shapes = oracle.modes()
    stiffness, rows = (np.array(part) for part in zip(*oracle.springs))
    terms = stiffness[:, None] * np.abs(rows @ shapes) * (np.abs(rows) @ np.abs(shapes))
    kappa = terms.sum(axis=0) / squares
    mean = oracle.mean(TORQUE)
    forces = (oracle.mesh_rounding("planetary", mean) / np.abs(np.array(oracle.meshes["planetary"]) @ mean)).max()

    mode, distance = np.sqrt(squares[1]) / (2 * np.pi * 248.64864864864865) * RATED, np.array([1e-1, 1e-2, 1e-3, 1e-4])
    fine, coarse = (values[:, :, SHOWN.index("output.x")] for values in pair(RV_320E, mode * (1 + distance)))
    error = np.abs(coarse - fine).max(axis=1) / np.abs(fine).max(axis=1)
    assert np.all(error < gamma * (forces + kappa[1:3].max() / distance))
    if not thorough:  # a program of its own in either precision
        return
    damped = RV_320E.replace(damping=Damping(loss_factor=0.02))
    fine, coarse = (values[0] for values in pair(damped, [RATED], method="harmonic_balance"))
    # Every sector adds its most sensitive mode; 9 harmonics reach to 2240 Hz.
    reached = squares < (2 * np.pi * 2240) ** 2
    error = np.abs(coarse - fine).max(axis=0) / np.abs(fine).max(axis=0)
    assert error.max() < gamma * (forces + 2 * kappa[reached].max() / 0.02)


@pytest.mark.long  # by default the fourth harmonic reaches it
def test_an_output_that_no_harmonic_reaches_rests():
    """The first three harmonics of the mesh of four cranks turn the planets against each other, never the output."""
    found = dynamics.response(RV_320E, sun_speed=RATED, output_torque=TORQUE, harmonics=3, outputs=("output.rotation",))
    assert np.all(np.asarray(found.amplitude) == 0) and int(found.info.status) == 0
