"""Unequal members, given torques, and tolerances of stiffness and mass.

Oracles: dense NumPy solves of dynamics_oracle.py with every member's own number (1e-9 of the largest amplitude);
equal numbers given one by one against one number for all (1e-9, two ways through the same matrices); independent
cases (tests/reference/dynamics.json); first-order propagation by sensitivities, which a Monte Carlo study of small
deviations must meet within its sampling error.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Damping, Status, dynamics
from rvjax.catalogue import RV_320E
from rvjax.dynamics import with_deviations
from rvjax.dynamics.response import METHODS
from rvjax.tolerances import Outcome, Tolerance, monte_carlo
from rvjax.units import rpm
from tests.oracles.dynamics import Oracle, layout

TORQUE, RATED = -3136.0, 1000 * rpm
DAMPED = RV_320E.replace(damping=Damping(0.02, 30.0, 2e-7, 0.01))
RATED_CASE = dict(sun_speed=RATED, output_torque=TORQUE)


def unequal(design, seed=3, size=0.2):
    """Every member with a stiffness and a mass of its own."""
    rng, c, d = np.random.default_rng(seed), design.cranks.count, design.cycloid.disc_count
    shapes = dict.fromkeys(("sun_planet_mesh", "planet_crank_bending", "planet_crank_torsion", "support_bearing"), (c,))
    shapes |= dict(turning_arm_bearing=(d, c), disc_pin_mesh=(d,))
    shapes = {f"stiffness.{name}": shape for name, shape in shapes.items()}
    for part, count in (("planet", c), ("crank", c), ("disc", d)):
        shapes |= {f"inertia.{part}_mass": (count,), f"inertia.{part}_inertia": (count,)}
    deviations = {name: size * rng.uniform(-1, 1, shape) for name, shape in shapes.items()}
    return jax.tree.map(lambda x: x if np.ndim(x) == 0 else np.asarray(x), with_deviations(design, deviations))


def assert_close(found, expected, rtol=1e-9):
    """Within rtol of the largest translation, or rotation, of all."""
    for kind in (np.arange(expected.shape[-1]) % 3 == 2, np.arange(expected.shape[-1]) % 3 != 2):
        assert np.abs(found - expected)[..., kind].max() < rtol * np.abs(expected[..., kind]).max()


@pytest.mark.parametrize("stage", ["planetary", pytest.param("cycloid", marks=pytest.mark.long)])
def test_unequal_members_are_solved_on_the_whole_model(stage):
    design, harmonics = unequal(layout(DAMPED, 4, 3, disc_phase=0.3)), 4
    oracle = Oracle(design)
    w, labels = oracle.frequency(stage, RATED), dynamics.assemble(design).labels

    @jax.jit
    def solve(design):
        options = RATED_CASE | dict(stage=stage, harmonics=harmonics, outputs=labels)
        return [dynamics.response(design, **options, method=m) for m in METHODS]

    first, full = solve(design)
    assert (first.form, full.form) == ("first_order_whole", "mesh")
    assert first.info.status == full.info.status == Status.CONVERGED
    assert_close(np.asarray(first.amplitude), oracle.first_order(stage, w, harmonics, TORQUE))
    expected = oracle.harmonic_balance(stage, w, harmonics, TORQUE)[harmonics:]
    assert_close(np.asarray(full.amplitude), 2 * expected[1:])
    assert_close(np.asarray(full.mean), expected[0].real)
    if stage == "cycloid":
        return
    np.testing.assert_allclose(dynamics.assemble(design).stiffness, oracle.K, atol=1e-14 * np.abs(oracle.K).max())
    modes, static = dynamics.modes(design), dynamics.static(design, output_torque=TORQUE)
    root = np.sqrt(oracle.m)
    squares = np.linalg.eigvalsh(oracle.K / np.outer(root, root))
    np.testing.assert_allclose(modes.frequency, np.sqrt(squares) / (2 * np.pi), rtol=1e-9)
    assert set(modes.kind) == {"coupled"}
    assert_close(np.asarray(static.deflection), oracle.mean(TORQUE))
    # Still statically determinate where the springs share one force each: discs in parallel are not.
    assert np.ptp(np.asarray(static.cycloid_force)) > 1
    assert np.sum(static.cycloid_force) == pytest.approx(-3 * 13639.03, rel=1e-6)


@pytest.mark.long  # log-sensitivities of discs one by one hold the derivatives, dense solves the values
def test_equal_members_given_one_by_one_are_equal():
    """The same reducer through its symmetry and, as arrays, through the whole model."""
    design = layout(DAMPED, 3, 3)
    arrays = design.replace(stiffness=design.stiffness.replace(disc_pin_mesh=np.full(3, 8.35e8)))
    options = RATED_CASE | dict(harmonics=3, outputs=("output.x", "output.rotation", "planet2.y"))

    def first_order(stiffness, eccentricity, design):
        cycloid = design.cycloid.replace(eccentricity=eccentricity)
        design = design.replace(cycloid=cycloid, stiffness=design.stiffness.replace(disc_pin_mesh=stiffness))
        found = dynamics.response(design, **options)
        return jnp.abs(found.amplitude[2, 1]), found

    run = jax.jit(jax.value_and_grad(first_order, argnums=(0, 1), has_aux=True))
    e = design.cycloid.eccentricity
    ((_, alike), slopes), ((_, each), own) = (run(d.stiffness.disc_pin_mesh, e, d) for d in (design, arrays))
    balanced = [dynamics.response(d, **options, method="harmonic_balance") for d in (design, arrays)]
    for first, second in ((alike, each), balanced):
        assert first.form != second.form
        one, other = np.asarray(first.amplitude), np.asarray(second.amplitude)
        assert np.all(np.abs(one - other).max(axis=0) < 1e-9 * np.abs(one).max(axis=0))
    np.testing.assert_allclose(dynamics.modes(arrays).frequency, dynamics.modes(design).frequency, rtol=1e-9)
    # One number for all has the sum of the members' derivatives.
    assert own[0].shape == (3,)
    np.testing.assert_allclose([np.sum(own[0]), own[1]], slopes, rtol=1e-8)


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"disc_pin_mesh: shape \(4,\) does not fit this design, expected \(discs,\)"):
        dynamics.assemble(RV_320E.replace(stiffness=RV_320E.stiffness.replace(disc_pin_mesh=np.full(4, 8.35e8))))
    with pytest.raises(ValueError, match=r"a scalar; sweep with jax\.vmap"):
        RV_320E.stiffness.replace(sun_support=np.full(4, 8.35e8))
    with pytest.raises(ValueError, match="one number in each field"):
        dynamics.blocks(unequal(RV_320E))
    for name in ("stiffness.magic", "magic", "stiffness", "stiffness.sun_support.x", "cycloid.disc_teeth"):
        with pytest.raises(ValueError, match=f"deviations: {name!r} is no number of this design"):
            with_deviations(RV_320E, {name: 0.1})


def test_a_given_sun_torque(reference, thorough):
    """The input held by its torsion spring alone, as a torsional stiffness is measured; none without any spring."""
    cases = {case["id"]: case for case in reference("dynamics")["cases"]}
    names = {"theta_s": "sun.rotation", "theta_p1": "planet1.rotation", "x_H1": "crank1.x", "y_c1": "disc1.y"}
    names |= {"theta_c1": "disc1.rotation", "theta_o": "output.rotation", "x_o": "output.x", "y_o": "output.y"}
    names |= {"x_s": "sun.x", "theta_s": "sun.rotation"}
    labels = dynamics.assemble(RV_320E).labels
    held = dynamics.static(RV_320E, output_torque=TORQUE, sun_torque=0.0)
    for name, value in cases[21]["out"].items():
        assert float(held.deflection[labels.index(names[name])]) == pytest.approx(value, rel=1e-9, abs=1e-15)
    # Output held, input free and without torque: no mesh carries load, nothing vibrates. Both methods are linear in
    # the mean deflection of the meshes, so that its rounding (11 unknowns) passes on as a share of the loaded response.
    design = RV_320E.replace(stiffness=RV_320E.stiffness.replace(sun_torsion=0.0, output_torsion=1e6))
    oracle, load = Oracle(design), np.zeros(39)
    load[-1] = TORQUE
    loaded = np.array(oracle.meshes["planetary"]) @ oracle.mean(TORQUE)
    share = 11 * np.finfo(float).eps / 2 * oracle.mesh_rounding("planetary", oracle.solve(oracle.K, load)) / loaded
    assert share.max() < 1e-10  # of the response: unloaded means unloaded
    options = RATED_CASE | dict(outputs=[names[name] for name in cases[36]["out"]], harmonics=3)

    @jax.jit
    @jax.vmap
    def run(torque):
        methods = METHODS if thorough else METHODS[:1]
        return [dynamics.response(design, **options, sun_torque=torque, method=m) for m in methods]

    for found in run(np.array([0.0, -TORQUE / oracle.ratio])):
        still, moving = np.abs(found.amplitude)
        assert np.all(found.info.status == Status.CONVERGED)
        assert moving.max() > 1e-8 and np.all(still <= share.max() * moving)
    free = RV_320E.replace(stiffness=RV_320E.stiffness.replace(sun_torsion=0.0))
    assert dynamics.static(free, output_torque=TORQUE, sun_torque=0.0).info.status == Status.SINGULAR


@pytest.mark.long  # batches of designs and of speeds, each alone: test_dynamics_response.py
def test_sweeps_over_speeds_and_designs_compile_once():
    """Stacked records are a batch: one program for every grid of one size, each lane the single case."""

    def one(design, speed):
        found = dynamics.response(design, sun_speed=speed, output_torque=TORQUE, harmonics=4)
        return found.amplitude, found.resonance_distance, found.info.status

    stiffness = jnp.array([0.9, 1.0, 1.1])
    designs = jax.vmap(lambda d: with_deviations(DAMPED, {"stiffness.disc_pin_mesh": d - 1}))(stiffness)
    run = jax.jit(jax.vmap(jax.vmap(one, in_axes=(None, 0)), in_axes=(0, None)))
    for speeds in (jnp.array([0.5, 1.0]) * RATED, jnp.array([0.7, -1.0]) * RATED):
        amplitude, distance, status = run(designs, speeds)
    assert run._cache_size() == 1
    assert amplitude.shape == (3, 2, 4, 3) and distance.shape == (3, 2, 4) and np.all(status == Status.CONVERGED)
    alone = dynamics.response(DAMPED, sun_speed=0.7 * RATED, output_torque=TORQUE, harmonics=4)
    np.testing.assert_allclose(amplitude[1, 0], alone.amplitude, rtol=1e-10, atol=1e-22)
    assert np.all(np.diff(np.abs(amplitude[:, 0, 0, 0])) != 0)


@pytest.mark.long  # derivatives of members one by one run in test_dynamics_derivatives.py
def test_monte_carlo_of_stiffness_and_mass_meets_first_order():
    """Relative bands of 3 sigma, all members alike: an amplitude, a frequency and the distance from resonance."""
    bands = {
        "stiffness.disc_pin_mesh": 0.03,
        "stiffness.turning_arm_bearing": 0.03,
        "stiffness.sun_torsion": 0.03,
        "inertia.disc_inertia": 0.015,
        "inertia.sun_inertia": 0.015,
    }
    design = RV_320E.replace(damping=Damping(loss_factor=0.02))

    def figures(deviations):
        unit = with_deviations(design, deviations)
        found = dynamics.response(unit, **RATED_CASE, harmonics=4, outputs=("output.rotation", "sun.rotation"))
        modes = dynamics.modes(unit)
        values = dict(
            rotation=jnp.abs(found.amplitude[3, 0]), torsion=modes.frequency[0], margin=found.resonance_distance[3]
        )
        return Outcome(value=values, status=jnp.stack([found.info.status, modes.info.status]))

    tolerances = {name: Tolerance.symmetric(band) for name, band in bands.items()}
    found = monte_carlo(figures, tolerances, samples=2000, seed=1, chunk=1000)
    assert found.failed == 0

    # Central differences over a tenth of a band: the response is smooth, derivatives have tests of their own.
    steps = 0.1 * np.diag(list(bands.values()))
    ends = np.concatenate([steps, -steps, np.zeros((1, len(bands)))])
    values = jax.jit(jax.vmap(lambda row: figures(dict(zip(bands, row))).value))(ends)
    for figure, value in values.items():
        nominal, spread = value[-1], (value[:5] - value[5:10]) / 0.2  # of each error over its whole band
        first_order = np.linalg.norm(spread) / 3
        assert first_order > 0
        # Sampling error of the spread of 2000 units: 1.6 %; curvature adds a fraction of a percent.
        assert found.sd[figure].value == pytest.approx(first_order, rel=0.05), figure
        assert found.mean[figure].value == pytest.approx(float(nominal), abs=0.1 * first_order)


@pytest.mark.long  # one number for all has the sum of the members' derivatives, above
def test_members_that_vary_one_by_one_average_out():
    """n independent members spread the first torsional frequency by 1/sqrt(n) of what they do all alike."""

    def torsion(deviations):
        return dynamics.modes(with_deviations(RV_320E, deviations)).frequency[0]

    name, band = "stiffness.disc_pin_mesh", 0.1
    slope = float(jax.grad(lambda share: torsion({name: share}))(0.0))
    own = monte_carlo(torsion, {name: Tolerance.symmetric(band, shape=(3,))}, samples=1000, seed=2, chunk=1000)
    # Sampling error of the spread: 2.2 %.
    assert own.sd.value == pytest.approx(slope * band / 3 / np.sqrt(3), rel=0.07)
    assert own.failed == 0
