"""Batches of the loaded model: every lane as alone, slow ones too, failed ones contained; precision and compilation."""

import jax
import jax.numpy as jnp
import life_cases
import numpy as np
import pytest
from loaded_cases import NAMED, assert_same, at, design_of, errors_of, newton_alone, solve, supported

from rvjax import Status, loaded
from rvjax.loaded.case import solve as solve_from
from rvjax.loaded.equilibrium import admit, check_input, outcome, prepare

CASE = NAMED["rv40: all errors, rated, hertz"]
DESIGN = design_of(CASE)
ANGLES, RATED, UNITS = (576.525, 140.0), 412.0, 100
SIGNS = np.array([1.0, -1.0])
FIXED = ("eccentricity", "pin_position", "disc_runout", "disc_cumulative_pitch")


def sampled(count, seed=0):
    """Units with errors of the size of the reference case, the eccentricity nominal; clearances positive."""
    random = np.random.default_rng(seed)
    nominal = errors_of(CASE, DESIGN)
    drawn = jax.tree.map(lambda leaf: leaf, nominal)
    for name, value in vars(nominal).items():
        size = 0.0 if name in FIXED else np.sqrt(np.mean(np.square(value)))
        values = size * random.standard_normal((count, *np.shape(value)))
        object.__setattr__(drawn, name, jnp.asarray(np.abs(values) if "clearance" in name else values))
    return drawn


def unit(errors, n):
    return jax.tree.map(lambda leaf: leaf[n], errors)


def units_solved(errors, torques, starts):
    """Units at two angles with a torque each: groups of one geometry, in more lanes than a block has.

    As `loaded.equilibrium`, from a start of its own for each unit."""
    errors = errors.replace(**dict.fromkeys(FIXED, 0.0))

    def one(errors, torque, angle, start):
        layout = check_input(DESIGN, errors, "hertz", "fixed", "fixed")
        read = admit(layout, DESIGN, errors, torque, angle)
        case = prepare(layout, read, read.angle).loaded(read.torque)
        return outcome(layout, read, case, *solve_from(layout, read, case, jnp.full(layout.unknowns, start)))

    of_unit = jax.tree.map(lambda leaf: 0 if np.ndim(leaf) else None, errors)
    of_angle = jax.vmap(one, in_axes=(of_unit, None, None, 0))
    return jax.vmap(of_angle, in_axes=(None, 0, 0, None))(errors, torques, jnp.asarray(ANGLES), starts)


solve_units = jax.jit(units_solved)
COLD = np.full(UNITS, np.nan)  # from the linear step


def solve_case(design, errors, torque, angle):
    return loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque)


def alone(errors, place, torques):
    angle, n = place
    return solve(DESIGN, unit(errors, n), ANGLES[angle], torques[angle])


def test_many_units_at_little_torque_all_converge_and_agree_with_each_alone():
    """100 units at 3 % of rated torque with clearance, where a median case takes 7 steps and the worst near 100: more
    lanes than a block has, so that cases take the places of others. 1e-8: condition 1e7 of rounding, 1e-15."""
    errors, torques = sampled(UNITS), 0.03 * RATED * np.array([1.0, -1.0])
    found = jax.tree.map(np.asarray, solve_units(errors, torques, COLD))
    assert np.all(found.info.status == Status.CONVERGED)
    steps = found.info.steps
    assert steps.max() > 3 * np.median(steps)  # there were slow ones
    order = np.argsort(steps, axis=None)[[-1, -2, 0, UNITS]]
    for place in zip(*np.unravel_index(order, steps.shape)):
        due = alone(errors, place, torques)
        np.testing.assert_allclose(found.error[place], due.error, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.pins[place], due.pins, rtol=0, atol=1e-7 * np.max(due.pins))


@pytest.fixture(scope="module")
def good():
    """Forwards and backwards at rated torque."""
    return jax.tree.map(np.asarray, solve_units(sampled(UNITS), RATED * SIGNS, COLD))


def test_batches_of_batches_are_their_cases(good):
    """Two angles, each with a torque, of many units: no two axes can be exchanged unseen."""
    for place in ((0, 0), (0, 71), (1, 5), (1, 99)):
        assert_same(at(good, place), alone(sampled(UNITS), place, RATED * SIGNS), place)


def test_a_failed_lane_disturbs_no_neighbour(good, thorough):
    spoilt = sampled(UNITS)
    for name, values in {
        "pin_radius": {3: jnp.nan},
        "pin_circle_radius": {7: -0.02 if thorough else -5e-3},  # after 300 steps, or a few
        "crank_phase": {9: jnp.inf},
    }.items():
        leaf = getattr(spoilt, name)
        for lane, value in values.items():
            leaf = leaf.at[lane].set(value)
        object.__setattr__(spoilt, name, leaf)
    bad = jax.tree.map(np.asarray, solve_units(spoilt, RATED * SIGNS, COLD))
    expected = {3: Status.NONFINITE, 7: Status.CONTACT_OVERLOAD, 9: Status.NONFINITE}
    for lane, status in expected.items():
        assert np.all(bad.info.status[:, lane] == status) and np.all(np.isnan(bad.error[:, lane]))
    rest = np.setdiff1d(np.arange(UNITS), list(expected))
    np.testing.assert_allclose(bad.error[:, rest], good.error[:, rest], rtol=1e-12)


def stacked(*alike):
    """Records as one, its numbers stacked where they differ."""
    return jax.tree.map(lambda *x: x[0] if all(np.array_equal(x[0], y) for y in x) else jnp.stack(x), *alike)


def agree_with_each_alone(axes, *lists):
    """All cases of design, errors, torque and angle under one vmap for each axis, the outermost first, and one by one.

    `axes` tells which of the arguments run along each axis, `lists` what they are there."""
    lists = [[jax.tree.map(lambda x: jnp.asarray(x, float), one) for one in ones] for ones in lists]
    batch = [stacked(*ones) for ones in lists]
    many = [jax.tree.map(lambda x, one: np.ndim(x) > np.ndim(one), x, ones[0]) for x, ones in zip(batch, lists)]
    found, sizes = solve_case, [len(lists[axis[0]]) for axis in axes]
    for axis in reversed(axes):
        mapped = [
            jax.tree.map(lambda varies, on=n in axis: 0 if varies and on else None, x) for n, x in enumerate(many)
        ]
        found = jax.vmap(found, mapped)
    found = jax.tree.map(np.asarray, jax.jit(found)(*batch))
    for place in np.ndindex(*sizes):
        index = {n: i for axis, i in zip(axes, place) for n in axis}
        due = solve_case(*(ones[index.get(n, 0)] for n, ones in enumerate(lists)))
        assert_same(at(found, place), due, place)


D, E, T, A = range(4)  # design, errors, torque, angle


AXES = {"angle torque": (A, T), "angle torque unit": (A, T, E), "reversed": (E, T, A)}


@pytest.mark.long  # each combination of axes is a program of its own; two axes run above
@pytest.mark.parametrize("axes", AXES.values(), ids=AXES)
def test_nested_batches_are_their_cases(axes):
    """Two angles, eight torques, three units of one geometry: no two axes can be exchanged unseen."""
    units = [unit(sampled(3), n) for n in range(3)]
    torques = RATED * np.linspace(-1, 1, 8)  # lanes enough that every angle is a group of its own
    agree_with_each_alone([(n,) for n in axes], [DESIGN], units if E in axes else units[:1], torques, [0.3, 140.0])


@pytest.mark.long  # the next test has designs as a batch axis too
def test_designs_of_other_springs_in_a_batch_are_their_cases():
    """One geometry, other contacts and bearings: the pin radius tells the flank only how it yields."""

    def made(share):
        return DESIGN.replace(
            cycloid=DESIGN.cycloid.replace(pin_radius=3e-3 * share),
            stiffness=DESIGN.stiffness.replace(support_bearing=9e8 / share, planet_crank_torsion=5e4 * share),
            contact=DESIGN.contact.replace(young_modulus=2e11 * share),
        )

    agree_with_each_alone(
        [(D,)], [made(share) for share in (0.8, 1.0, 1.3)], [errors_of(CASE, DESIGN)], [RATED], ANGLES[:1]
    )


@pytest.mark.long  # test_loaded_slack.py has one axis of geometries
def test_units_of_their_own_geometry_in_a_batch_are_their_cases():
    """Eccentricities of parts and designs, and crank circles, which no two units share, at two torques and angles."""

    def made(share, radius):
        cycloid = DESIGN.cycloid.replace(eccentricity=1.3e-3 * share)
        return DESIGN.replace(cycloid=cycloid, cranks=DESIGN.cranks.replace(circle_radius=radius))

    designs = [made(0.97, 0.036), made(1.0, 0.035), made(1.04, 0.038)]
    errors = [errors_of(CASE, DESIGN, eccentricity=size) for size in (4e-6, -6e-6, 2e-6)]
    agree_with_each_alone([(D, E), (T,), (A,)], designs, errors, [RATED, -RATED], [0.3, 140.0])


@newton_alone()
def solve_single(*given):
    """The equilibrium in single precision, by one program."""
    design, errors, angle, torque = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), given)
    return loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque, contact="linear")


def test_single_precision():
    """The aim for loaded cases: error 1e-4 relative + 1e-8 rad, forces 1e-3 of the largest. A few ill-conditioned units
    of a hundred miss it, by up to the rounding of their gaps times a condition of 1e4: 5e-4. Linear pins; the contact
    laws have their own test. The first 50 units."""
    errors = jax.device_get(sampled(UNITS))
    singles = [solve_single(supported(DESIGN, 1e9), unit(errors, n), ANGLES[0], RATED) for n in range(UNITS // 2)]
    doubles = [solve(DESIGN, unit(errors, n), ANGLES[0], RATED, contact="linear") for n in range(UNITS // 2)]
    single, double = (jax.tree.map(lambda *leaves: np.stack(leaves), *ones) for ones in (singles, doubles))
    assert single.error.dtype == jnp.float32
    assert np.all(single.info.status == Status.CONVERGED)
    off = np.abs(np.asarray(single.error, float) - double.error)
    assert np.mean(off <= 1e-4 * np.abs(double.error) + 1e-8) > 0.97
    assert np.all(off <= 5e-4 * np.abs(double.error))
    largest = np.max(double.pins, axis=(1, 2), keepdims=True)
    assert np.max(np.abs(np.asarray(single.pins, float) - double.pins) / largest) < 1e-3


def test_single_precision_finds_the_equilibria_of_a_light_duty():
    """After the linear start no closed contact holds the carrier: its pivot is rounding, and was zero or negative."""
    design, errors = life_cases.unit_of(life_cases.NAMED[life_cases.BASIC])
    design = supported(design.replace(bearings=None), 1e9)
    for part, torque in ((6, 20.0), (7, 30.0), (13, 20.0), (18, 70.0)):
        given = design, errors, 2 * np.pi * design.ratio / 48 * part, torque
        single, double = solve_single(*given), solve(*given, contact="linear")
        assert single.error.dtype == jnp.float32 and single.info.status == Status.CONVERGED
        assert single.info.steps < 40
        np.testing.assert_allclose(single.error, double.error, rtol=1e-3)


def test_other_numbers_compile_nothing(compiled):
    errors = errors_of(CASE, DESIGN)
    solve(DESIGN, errors, ANGLES[0], RATED)
    compiled.clear()
    solve(DESIGN, jax.tree.map(lambda leaf: 0.5 * leaf, errors), ANGLES[0], 0.3 * RATED)
    assert not compiled


def test_a_start_beyond_the_law_of_a_pin_is_left():
    """Metres of approach find the equilibrium too, with and without load."""
    errors = jax.tree.map(lambda leaf: np.tile(leaf, (UNITS, *[1] * np.ndim(leaf))), errors_of(CASE, DESIGN))
    starts = np.r_[1e-3, -1.0, 1e30, COLD[3:]]
    found = jax.tree.map(np.asarray, solve_units(errors, np.array([412.0, 0.0]), starts))
    assert set(found.info.status[0]) == {Status.CONVERGED}
    for angle in range(2):
        cold = at(found, (angle, -1))
        assert set(found.info.status[angle]) == {cold.info.status}
        for n in range(3):
            np.testing.assert_allclose(found.error[angle, n], cold.error, rtol=1e-12)
            np.testing.assert_allclose(found.pins[angle, n], cold.pins, rtol=0, atol=1e-9 * np.max(cold.pins))
