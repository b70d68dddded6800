"""Reading of an encoder: derivatives, programs, types of numbers and bad input."""

from functools import cache

import jax
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, plain, solve
from loaded_turns import (
    ALL,
    TURN,
    loaded_turn,
    read_over_a_turn,
)

from rvjax import loaded
from rvjax.published.rv160 import MACHINE, NONE
from rvjax.units import mm

CASE = NAMED["rv40: all errors, rated, hertz"]
SHORT = loaded.Reading(
    radius=60 * mm, heads=(0.3, 2.0), ring_gain=3e-9, tilt_gain=2e-7, height=40 * mm, disc_position=(-7 * mm, 9 * mm),
    dent=6e-9, scale_eccentricity=(2e-6, 1e-6),
)  # fmt: skip
DESIGN = design_of(CASE)
FAILED = errors_of(CASE, DESIGN).replace(pin_radius=np.nan)


@cache
def start(errors=None):
    """An equilibrium, and all numbers that its reading reads: error and forces, design, encoder, conditions."""
    torque, angle = 412.0, 576.525
    found = solve(DESIGN, errors_of(CASE, DESIGN) if errors is None else errors, angle, torque)
    return jax.device_get(found), plain((found.error, found.pins, DESIGN, SHORT, torque, angle))


@jax.jit
def added(numbers, found):
    """What the reading adds to the error."""
    error, pins, design, reading, torque, angle = numbers
    found = found.replace(error=error, pins=pins)
    return loaded.reading(found, design, reading, input_angle=angle, output_torque=torque) - error


with_slopes = jax.jit(jax.value_and_grad(added))


def test_derivatives_to_every_number_agree_with_differences():
    """Central differences of fourth order; the bound as in test_loaded_derivatives.py, which has those of forces."""
    found, given = start()
    slopes, random = jax.tree.leaves(with_slopes(given, found)[1]), np.random.default_rng(0)
    leaves, tree = jax.tree.flatten(given)
    named = jax.tree_util.tree_leaves_with_path(given)
    value, moved = abs(float(added(given, found))), set()
    for number, (path, leaf) in enumerate(named):
        direction = random.standard_normal(np.shape(leaf))
        slope = float(np.vdot(slopes[number], direction))
        step = max(1e-5 * float(np.max(np.abs(leaf))), 1e-9)

        def along(size):
            changed = [*leaves[:number], leaf + size * direction, *leaves[number + 1 :]]  # noqa: B023
            return float(added(plain(jax.tree.unflatten(tree, changed)), found))

        due = (8 * (along(step) - along(-step)) - (along(2 * step) - along(-2 * step))) / (12 * step)
        assert abs(due - slope) <= 1e-5 * abs(slope) + 1e-11 * value / step, (path, slope, due)
        moved |= {path[-1].name} if slope != 0 and hasattr(path[-1], "name") else set()
    assert {f for f in vars(SHORT)} - {"scale_eccentricity"} <= moved
    assert np.all(slopes[0] == 0) and np.all(slopes[1] != 0)  # of the error nothing, of every pressed pin its force


def test_a_batch_is_its_cases():
    found = loaded_turn()
    read = read_over_a_turn(found, plain(ALL), 1000.0)
    for k in (0, 7):
        one = jax.tree.map(lambda leaf: leaf[k], found)  # noqa: B023
        angle = TURN[k] * MACHINE.ratio
        alone = loaded.reading(one, MACHINE, ALL, input_angle=angle, output_torque=1000.0)
        assert np.shape(alone) == () and abs(alone / read[k] - 1) < 1e-14


def test_a_second_reading_compiles_nothing(compiled):
    def call(x):
        reading = ALL.replace(heads=(x,), radius=x)
        return loaded.reading(
            jax.tree.map(lambda leaf: leaf[1], found), MACHINE, reading, input_angle=x, output_torque=x
        )

    found = jax.device_get(loaded_turn())
    call(0.3)
    compiled.clear()
    call(0.7)
    assert not compiled


def test_float32_stays_float32():
    found = jax.tree.map(lambda leaf: leaf[1], jax.device_get(loaded_turn()))
    small = jax.tree.map(lambda leaf: np.float32(leaf) if leaf.dtype == float else leaf, found)
    one, other = (loaded.reading(case, MACHINE, ALL, input_angle=1.0, output_torque=1000.0) for case in (small, found))
    assert one.dtype == np.float32 and abs(float(one) / float(other) - 1) < 1e-6


def test_a_case_without_a_value_has_no_reading_and_spoils_no_gradient():
    found, (error, pins, design, reading, torque, angle) = start()
    unchecked = jax.tree.map(lambda leaf: leaf, reading)  # as a sampler makes it
    object.__setattr__(unchecked, "radius", -0.06)
    changes = (dict(radius=np.nan), dict(ring_gain=np.inf), dict(heads=np.array([0.1, np.nan])))
    spoilt = [start(FAILED)]
    for wrong in (unchecked, *(reading.replace(**change) for change in changes)):
        spoilt.append((found, (error, pins, design, wrong, torque, angle)))
    for case, numbers in spoilt:
        value, slopes = with_slopes(plain(numbers), case)
        assert np.isnan(value) and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def test_a_tilt_without_places_is_no_reading():
    """Eager: an error. Traced, the gain is not known before it is too late: no value."""
    found, at = jax.tree.map(lambda leaf: leaf[1], loaded_turn()), dict(input_angle=1.0, output_torque=1000.0)

    def read(gain):
        return loaded.reading(found, MACHINE, loaded.Reading(radius=0.075, tilt_gain=gain), **at)

    assert np.isnan(jax.jit(read)(1e-7)) and np.isfinite(jax.jit(read)(0.0)) and np.isfinite(read(0.0))
    with pytest.raises(ValueError, match=r"Reading.tilt_gain = 1e-07 rad/\(N m\): needs disc_position"):
        read(1e-7)


WRONG = [
    (dict(radius=0.0), r"Reading.radius = 0 m: must be positive"),
    (dict(radius=-0.075), r"Reading.radius = -0.075 m: must be positive"),
    (dict(heads=()), r"Reading.heads = \[\]: must have one angle or more"),
    (dict(heads=np.zeros((2, 2))), r"Reading.heads: shape \(2, 2\)"),
    (dict(disc_position=(0.0, 1e-3, 2e-3)), r"Reading.disc_position: shape \(3,\): must be \(2,\)"),
    (dict(disc_position=0.01), r"Reading.disc_position: shape \(\): must be \(2,\)"),
    (dict(scale_eccentricity=np.zeros(3)), r"Reading.scale_eccentricity: shape \(3,\)"),
    (dict(scale_eccentricity=1e-6), r"Reading.scale_eccentricity: shape \(\)"),
]


@pytest.mark.parametrize(("change", "told"), WRONG)
def test_bad_encoders_are_one_line(change, told):
    found = jax.tree.map(lambda leaf: leaf[1], loaded_turn())
    with pytest.raises(ValueError, match=told) as refused:
        loaded.reading(found, MACHINE, ALL.replace(**change), input_angle=1.0, output_torque=1.0)
    assert "\n" not in str(refused.value)


def test_other_arguments_are_refused_by_name():
    found, at = jax.tree.map(lambda leaf: leaf[1], loaded_turn()), dict(input_angle=1.0, output_torque=1.0)
    with pytest.raises(ValueError, match="takes a design of kind RVReducer, got Reading"):
        loaded.reading(found, ALL, MACHINE, **at)
    with pytest.raises(ValueError, match=r"reading = RVReducer: must be of kind rvjax\.loaded\.Reading"):
        loaded.reading(found, MACHINE, MACHINE, **at)
    with pytest.raises(ValueError, match=r"found = Reading: must be of kind rvjax\.loaded\.Loaded"):
        loaded.reading(ALL, MACHINE, ALL, **at)
    with pytest.raises(ValueError, match=r"Loaded.pins: shape \(480, 2, 40\): must be \(2, 40\)"):
        loaded.reading(loaded_turn(), MACHINE, ALL, **at)
    support = MACHINE.contact.replace(pin_support=np.ones(39))
    with pytest.raises(ValueError, match=r"Contact.pin_support: shape \(39,\) .*\(pins,\) = \(40,\)"):
        loaded.equilibrium(MACHINE.replace(contact=support), NONE, **at)
    for name, value in (("harmonic", -1), ("harmonic", 1.5), ("most", True), ("most", -1)):
        with pytest.raises(ValueError, match=f"{name} = .*: must be an integer of at least 0"):
            loaded.housing_orders(MACHINE, **dict(harmonic=1) | {name: value})
    with pytest.raises(ValueError, match="takes a design of kind RVReducer"):
        loaded.housing_orders(ALL, 1)
