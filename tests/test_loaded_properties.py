"""What the loaded equilibrium must obey whatever the numbers: balances, symmetries, closed forms, limits.

All cases of one law share one compiled program: errors always in full shapes, angle and torque as arguments.
Unless said otherwise, 1e-9 is the accuracy of the equilibrium (residual 1e-13 of the largest force, condition 1e3 under
load) with a margin of ten thousand.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of

import rvjax
from rvjax import Status, loaded

ALL_ERRORS = NAMED["rv40: all errors, rated, hertz"]
RATED = 412.0


def solve(errors, angle, torque, *, design=None, contact="hertz"):
    design = design_of(ALL_ERRORS) if design is None else design
    return loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque, contact=contact)


def errors_with(**given):
    return errors_of({"errors": given}, design_of(ALL_ERRORS))


def test_torques_and_forces_balance():
    """Sun torque times ratio is the output torque but for the centring springs, 1e-6; each disc is in balance."""
    case, design = ALL_ERRORS, design_of(ALL_ERRORS)
    found = solve(errors_of(case, design), 576.525, RATED)
    np.testing.assert_allclose(found.input_torque * 105, RATED, rtol=1e-6)
    np.testing.assert_allclose(jnp.sum(found.gear) * design.involute.sun_base_radius, found.input_torque, rtol=1e-12)
    share = 39 / (2 * (40 + 10 / 26))
    np.testing.assert_allclose(jnp.mean(found.disc_torque), RATED * share, rtol=1e-6)
    # Support bearings carry the output torque at their radius.
    axis = np.array([[-1.0, 0.0], [1.0, 0.0]]) * design.cranks.circle_radius
    force = np.asarray(found.support_bearing)
    moment = np.sum(axis[:, 0] * force[:, 1] - axis[:, 1] * force[:, 0])
    np.testing.assert_allclose(moment, RATED, rtol=1e-6)
    # Between arms and support stands the crank; the gear acts along its flank.
    arms = -np.asarray(found.disc_bearing).sum(axis=0)
    gear = (
        np.asarray(found.gear)[:, None] * np.cos(design.involute.pressure_angle) * np.array([[0.0, -1.0], [0.0, 1.0]])
    )
    off = arms - force + gear
    assert np.max(np.abs(off[:, 1])) < 1e-6 * np.max(np.abs(force))


def test_without_errors_the_curve_is_odd():
    """Equal springs, no errors, input angle 0: the mirror image of the reducer is itself."""
    forward, backward = (solve(errors_with(), 0.0, torque) for torque in (200.0, -200.0))
    np.testing.assert_allclose(forward.error, -backward.error, rtol=1e-9)
    np.testing.assert_allclose(forward.stiffness, backward.stiffness, rtol=1e-7)


def test_a_crank_turn_returns_with_the_next_pin():
    """Equal pins and teeth, sun and ring centred: after one crank turn every disc stands as before, one pin on."""
    design = design_of(ALL_ERRORS)
    case = {"errors": {k: v for k, v in ALL_ERRORS["errors"].items() if not k.startswith(("pin_o", "pin_radii"))}}
    errors = errors_of(case, design, sun_runout=0.0, ring_centre=0.0, disc_pitch=0.0, planet_runout=0.0)
    turn = 2 * np.pi * 105 / 40
    before, after = (solve(errors, 1.0 + angle, RATED) for angle in (0.0, turn))
    np.testing.assert_allclose(after.error, before.error, rtol=1e-9)
    moved = np.max(np.abs(np.asarray(before.pins) - np.asarray(after.pins)))
    np.testing.assert_allclose(np.roll(after.pins, -1, axis=1), before.pins, atol=1e-7 * np.max(before.pins))
    assert moved > 0.01 * np.max(before.pins)


def test_a_reducer_turned_by_half_is_the_same():
    """Both discs and both cranks swapped with their errors, pins moved by half the ring, vectors reversed."""
    design = design_of(ALL_ERRORS)
    errors = errors_of(ALL_ERRORS, design, disc_pitch=0.0, sun_runout=0.0)
    other = jax.tree.map(lambda leaf: leaf, errors)
    changes = {
        name: np.asarray(getattr(errors, name))[::-1] for name in ("carrier_bore", "crank_phase", "planet_runout")
    }
    changes |= {name: np.asarray(getattr(errors, name))[::-1, ::-1] for name in ("crank_eccentricity", "disc_bore")}
    changes |= {
        "disc_profile": np.asarray(errors.disc_profile)[::-1],
        "disc_centre": -np.asarray(errors.disc_centre)[::-1],
    }
    changes |= {name: np.roll(getattr(errors, name), 20, axis=0) for name in ("pin_offset", "pin_radii")}
    changes |= {"ring_centre": -np.asarray(errors.ring_centre)}
    for name, value in changes.items():
        object.__setattr__(other, name, value)
    one, two = solve(errors, 0.7, RATED), solve(other, 0.7, RATED)
    np.testing.assert_allclose(one.error, two.error, rtol=1e-9)
    np.testing.assert_allclose(one.pins, np.roll(np.asarray(two.pins)[::-1], 20, axis=1), atol=1e-8 * np.max(one.pins))


def test_hertz_stiffens_and_linear_is_proportional():
    secants = [100.0 / -solve(errors_with(), 0.3, 100.0).error, 400.0 / -solve(errors_with(), 0.3, 400.0).error]
    assert secants[1] > 1.005 * secants[0]
    half, full = (solve(errors_with(), 0.3, torque, contact="linear").error for torque in (200.0, 400.0))
    np.testing.assert_allclose(full, 2 * half, rtol=1e-9)


def test_tangential_carrier_bores_turn_the_output_alone():
    """All bores t tangential: the carrier stands behind by t / R, nothing else moves. Base tangent: Eq. of play."""
    t, nothing = 10e-6, solve(errors_with(), 0.4, RATED).error
    bores = np.tile([0.0, t], (2, 1))
    shifted = solve(errors_with(carrier_bore=bores), 0.4, RATED).error
    np.testing.assert_allclose(shifted - nothing, -t / 0.036, rtol=1e-4)  # the centring springs hold against it


def test_base_tangents_give_their_backlash():
    """-(upper + lower) / (2 r_s i), exactly but for what the centring springs and the probe torque add."""
    case, design = ALL_ERRORS, design_of(ALL_ERRORS)
    del case
    found = loaded.torsion(
        design, errors_with(base_tangent_upper=-20e-6, base_tangent_lower=-30e-6), input_angle=0.5, rated_torque=RATED
    )
    plain = loaded.torsion(design, errors_with(), input_angle=0.5, rated_torque=RATED)
    expected = 50e-6 / (2 * design.involute.sun_base_radius * 105)
    np.testing.assert_allclose(found.backlash - plain.backlash, expected, rtol=1e-3)
    assert np.all(np.diff(found.torque) > 0) and np.all(np.diff(found.angle) < 0)


def test_linear_springs_share_the_compliance():
    """Euler: the error of linear springs without clearance is homogeneous of degree -1 in all stiffnesses."""
    design = design_of(ALL_ERRORS)

    def error(scale):
        springs = jax.tree.map(lambda k: k * scale, design.stiffness)
        return solve(errors_with(), 0.3, RATED, design=design.replace(stiffness=springs), contact="linear").error

    value, slope = jax.jvp(jax.jit(error), (jnp.float64(1.0),), (jnp.float64(1.0),))
    np.testing.assert_allclose(slope, -value, rtol=1e-9)


@pytest.mark.parametrize("law", ["hertz", "linear"])
def test_nothing_gives_exactly_nothing(law):
    found = solve(errors_with(), 2.0, 0.0, contact=law)
    assert Status(int(found.info.status)) == Status.UNLOADED
    assert found.error == 0 and np.all(np.asarray(found.pins) == 0) and np.all(np.asarray(found.gear) == 0)


def test_revolution_and_torsion_are_their_equilibria():
    """The warm starts change nothing: every angle and torque as solved alone."""
    design = design_of(ALL_ERRORS)
    errors = errors_of(ALL_ERRORS, design)
    turn = loaded.revolution(design, errors, output_torque=RATED, samples=24)
    alone = [solve(errors, 2 * np.pi * 105 / 40 * j / 24, RATED).error for j in (0, 5, 23)]
    np.testing.assert_allclose(np.asarray(turn.error)[[0, 5, 23]], alone, rtol=1e-10)
    rvjax.check(turn)
