"""What the loaded equilibrium must obey whatever the numbers: balances, symmetries, closed forms, limits.

All cases of one law share one compiled program: errors always in full shapes, every number an argument.
Unless said otherwise, 1e-9 is the accuracy of the equilibrium (residual 1e-13 of the largest force, condition 1e3 under
load) with a margin of ten thousand.
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, plain, solve as solve_case, supported

import rvjax
from rvjax import Status, loaded

ALL_ERRORS = NAMED["rv40: all errors, rated, hertz"]
RATED = 412.0


def solve(errors, angle, torque, *, design=None, contact="hertz"):
    return solve_case(design_of(ALL_ERRORS) if design is None else design, errors, angle, torque, contact=contact)


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


@pytest.mark.long
def test_base_tangents_give_their_backlash():
    """-(upper + lower) / (2 r_s i), exactly but for what the centring springs and the probe torque add."""
    design, short = design_of(ALL_ERRORS), dict(base_tangent_upper=-20e-6, base_tangent_lower=-30e-6)
    found, without = (
        loaded.torsion(*plain((design, errors)), input_angle=0.5, rated_torque=RATED)
        for errors in (errors_with(**short), errors_with())
    )
    expected = 50e-6 / (2 * design.involute.sun_base_radius * 105)
    np.testing.assert_allclose(found.backlash - without.backlash, expected, rtol=1e-3)
    assert np.all(np.diff(found.torque) > 0) and np.all(np.diff(found.angle) < 0)


def test_linear_springs_share_the_compliance():
    """Euler: the error of linear springs without clearance is homogeneous of degree -1 in all stiffnesses."""
    design = design_of(ALL_ERRORS)
    stiffer = design.replace(stiffness=jax.tree.map(lambda k: 2 * k, design.stiffness))
    before, after = (solve(errors_with(), 0.3, RATED, design=d, contact="linear") for d in (design, stiffer))
    np.testing.assert_allclose(after.error, before.error / 2, rtol=1e-9)
    np.testing.assert_allclose(after.stiffness, 2 * before.stiffness, rtol=1e-7)


@pytest.mark.parametrize("law", ["hertz", "linear"])
def test_nothing_gives_exactly_nothing(law):
    found = solve(errors_with(), 2.0, 0.0, contact=law)
    assert Status(int(found.info.status)) == Status.UNLOADED
    assert found.error == 0 and np.all(np.asarray(found.pins) == 0) and np.all(np.asarray(found.gear) == 0)


def test_revolution_and_torsion_are_their_equilibria():
    """The warm starts change nothing: every angle and torque as solved alone."""
    design = design_of(ALL_ERRORS)
    errors = errors_of(ALL_ERRORS, design)
    given = plain((supported(design, 1e9), errors))
    turn = loaded.revolution(*given, output_torque=RATED, samples=24, contact="linear")
    alone = [solve(errors, 2 * np.pi * 105 / 40 * j / 24, RATED, contact="linear") for j in range(24)]
    error, pins = (np.array([getattr(found, name) for found in alone]) for name in ("error", "pins"))
    np.testing.assert_allclose(turn.error, error, rtol=1e-10)
    assert float(turn.mean) == pytest.approx(error.mean(), rel=1e-9)
    assert float(turn.peak_to_peak) == pytest.approx(np.ptp(error), rel=1e-9)
    waves = np.fft.fft(error)[:5] / 24 * np.array([1, 2, 2, 2, 2])
    np.testing.assert_allclose(turn.harmonics, waves, rtol=0, atol=1e-9 * np.abs(error).max())
    assert float(turn.largest_pin) == pytest.approx(pins.max(), rel=1e-8)
    rvjax.check(turn)


def in_other_units(record, length, force):
    """The record with its numbers as they read where metre and newton are smaller by these factors."""
    scale = {"m": length, "N": force, "N/m": force / length, "Pa": force / length**2}
    scale |= {"N m": force * length, "N m/rad": force * length, "rad": 1.0, "-": 1.0}
    changes = {}
    for f in dataclasses.fields(record):
        value, kind = getattr(record, f.name), f.metadata["kind"]
        if value is not None and kind == "record" and f.name != "info":
            changes[f.name] = in_other_units(value, length, force)
        elif value is not None and kind == "real":
            changes[f.name] = value * scale[f.metadata["unit"]]
    return record.replace(**changes)


def same_in_other_units(design, errors, torque, law, length, force):
    before = solve(errors, 0.7, torque, design=design, contact=law)
    design, errors = (in_other_units(part, length, force) for part in (design, errors))
    after = rvjax.check(solve(errors, 0.7, torque * force * length, design=design, contact=law))
    np.testing.assert_allclose(after.error, before.error, rtol=1e-9)
    due = in_other_units(before, length, force)
    # Without load a gear carries what the centring springs leave of sums of pin forces, which are right to 1e-13.
    left = 1e-12 * np.max(due.pins)
    radii = dict(input_torque=design.involute.sun_base_radius, disc_torque=design.cycloid.pin_circle_radius)
    for name in ("pins", "pressure", "disc_bearing", "support_bearing", "gear", "input_torque", "disc_torque"):
        allowed = 1e-8 * np.max(np.abs(getattr(due, name))) + left * radii.get(name, 1.0)
        np.testing.assert_allclose(getattr(after, name), getattr(due, name), rtol=0, atol=allowed, err_msg=name)
    np.testing.assert_allclose(after.stiffness, due.stiffness, rtol=1e-7)


@pytest.mark.parametrize(
    ("law", "more"),
    [
        ("hertz", {}),
        *(
            pytest.param(law, dict(pin_support=4e8, pin_stiffness=3e7), marks=pytest.mark.long)
            for law in ("hertz", "linear", "palmgren")
        ),
    ],
)
def test_forces_and_moduli_together_move_nothing(law, more):
    """All errors; forces three times as large. Then lengths as well, every number by its unit."""
    design = design_of(ALL_ERRORS)
    design = design.replace(contact=design.contact.replace(**more))
    errors = errors_of(ALL_ERRORS, design)
    for length, force in ((1.0, 3.0), (0.3, 5.0)):
        same_in_other_units(design, errors, RATED, law, length, force)


def test_lengths_together_turn_nothing():
    """Linear springs, the same in N/m: angles stay and forces grow as lengths, loaded and with parts forced together.

    The ring of thicker pins is preloaded, so that the error without load is definite."""
    design = design_of(ALL_ERRORS)
    errors = errors_of(ALL_ERRORS, design)
    tight = errors.replace(pin_radius=20e-6, bearing_clearance=0.0, support_clearance=0.0)
    assert np.max(solve(tight, 0.7, 0.0, contact="linear").pins) > 10.0
    for given, torque in ((errors, RATED), (tight, 0.0)):
        same_in_other_units(design, given, torque, "linear", 2.5, 2.5)


@pytest.mark.parametrize("law", ["hertz", "linear"])
def test_a_turned_ring_turns_the_output_with_the_sun_held(law):
    """All pins t tangential: every force as before, the error t / rp zp / (zp + z1/z2) larger. All teeth t behind on
    their circle do the same, so that both together do nothing.

    The centring springs, 6 N/m on seven rotations at radii up to 36 mm against 1e6 N m/rad: 1e-7 of the shift."""
    design = design_of(ALL_ERRORS)
    errors = errors_of(ALL_ERRORS, design)
    t = 20e-6 * np.array([0.0, 1.0])
    ring = errors.replace(pin_offset=errors.pin_offset + t)
    teeth = errors.replace(disc_pitch=errors.disc_pitch - t[1])
    both = ring.replace(disc_pitch=errors.disc_pitch + t[1])
    plain, turned, behind, together = (solve(e, 0.4, RATED, contact=law) for e in (errors, ring, teeth, both))
    expected = t[1] / 0.064 * 40 / (40 + 10 / 26)
    np.testing.assert_allclose([turned.error - plain.error, behind.error - plain.error], expected, rtol=1e-6)
    np.testing.assert_allclose(turned.pins, plain.pins, rtol=0, atol=1e-6 * np.max(plain.pins))
    np.testing.assert_allclose(together.error, plain.error, rtol=1e-9)


@pytest.mark.parametrize("pins", [(40,), pytest.param((12, 24, 48), marks=pytest.mark.long)])
def test_equidistant_play_gives_its_backlash_as_pins_become_many(pins):
    """2 D / (e zc) zc / (zp + z1/z2), where a pin stood at the longest lever, e zc, on both flanks.

    lever / (e zc) = sin(psi)/S falls from 1 with the curvature 1 whatever K1, and the nearest pin is off by half a
    pitch at most: the backlash is larger by up to (pi/zp)^2/2. The parts yield 2e-8 rad to 1e-3 N m at 5e4 N m/rad, of
    1e-3 rad of play: 4e-5 for both sides; the centring springs take less."""
    play, torque, base, worst = 30e-6, 1e-3, design_of(ALL_ERRORS), []
    rp = base.cycloid.pin_circle_radius
    for zp in pins:
        k1, e = 0.8125, 0.8125 * rp / zp
        cycloid = base.cycloid.replace(disc_teeth=zp - 1, pin_count=zp, eccentricity=e, pin_radius=0.1 / zp)
        design = base.replace(cycloid=cycloid)
        th = np.arange(5) / 5 * 2 * np.pi / (zp * (zp - 1))  # of the carrier, until the next pin stands so
        errors = errors_of({"errors": dict(equidistant_modification=play)}, design)
        back, ahead = (
            np.array([solve(errors, angle, t, design=design, contact="linear").error for angle in th * design.ratio])
            for t in (-torque, torque)
        )
        backlash = back - ahead
        psi = 2 * np.pi * np.arange(zp) / zp + (zp - 1) * th[:, None]  # the second disc has the same, zp being even
        share = np.sin(psi) / np.sqrt(1 + k1**2 - 2 * k1 * np.cos(psi))
        excess = backlash / (2 * play / e / (zp + 10 / 26)) - 1
        np.testing.assert_allclose(excess, (1 / share.max(1) - 1 / share.min(1)) / 2 - 1, rtol=0, atol=1e-4)
        worst.append(np.max(excess))
    assert all(after < before / 2 for before, after in itertools.pairwise(worst))
    assert worst[-1] < (np.pi / pins[-1]) ** 2 / 2
