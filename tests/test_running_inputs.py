"""Friction that cannot be, in one line each; drag from speed ramps; inertias of a joint."""

import re

import jax
import numpy as np
import pytest
import running_cases as cases

import rvjax
from rvjax import Bearings, CycloidalErrors, Friction, RVErrors, loaded, running
from rvjax.running.inputs import kind_of

RV, ERRORS = cases.unit_of(cases.NAMED["rv40: no errors, forward"])
FRICTION = cases.friction_of(cases.NAMED["rv40: no errors, forward"])
DRIVE, DRIVE_ERRORS = cases.unit_of(cases.NAMED["cycloidal: no errors"])
ALONE = Friction(ring_pins=0.05)
LOADED = dict(output_torque=412.0, output_speed=1.0)


def losses(design=RV, errors=ERRORS, friction=FRICTION, **changes):
    return running.losses(design, errors, friction, **(LOADED | changes))


def of_drive(friction, design=DRIVE):
    return losses(design, DRIVE_ERRORS, friction)


SPEED, RISING = np.array([1.0, 2, 3, 4]), np.array([1.0, 1.25, 1.5, 2.5])
REFUSED = {
    "RVReducer.friction must be one": lambda: losses(friction=None),
    "RVReducer.bearings = None: Friction.arm_bearings": lambda: losses(RV.replace(bearings=None)),
    "Bearings.support = None": lambda: losses(RV.replace(bearings=Bearings(RV.bearings.arm))),
    "Bearings.disc_position: shape": lambda: losses(RV.replace(bearings=RV.bearings.replace(disc_position=np.ones(3)))),
    "Friction.output_pins: must be None for a RVReducer": lambda: losses(friction=Friction(output_pins=0.1)),
    "Friction.support_bearings: must be None for a Cyc": lambda: of_drive(Friction(support_bearings=0.1)),
    "Friction.gear_meshes = 0.1: must be 0": lambda: of_drive(Friction(gear_meshes=0.1)),
    "Bearings.support: must be None": lambda: of_drive(ALONE, DRIVE.replace(bearings=RV.bearings)),
    "Friction.ring_pins = -0.1: must be zero or positive": lambda: Friction(ring_pins=-0.1),
    "Friction.output_pins = -0.1: must be zero or pos": lambda: Friction(output_pins=-0.1),
    "Friction.static_factor = 0: must be positive": lambda: Friction(static_factor=0.0),
    "Friction.gear_meshes = 1: must be below 1": lambda: Friction(gear_meshes=1.0),
    "samples = 0: must be an integer of at least 1": lambda: losses(samples=0),
    "turns = 0.51: must be a whole number of crank turns": lambda: losses(turns=0.51),
    "carrier = 'loose'": lambda: losses(carrier="loose"),
    "takes RVErrors, got CycloidalErrors": lambda: losses(errors=CycloidalErrors()),
    "RVReducer.stiffness = None": lambda: losses(RV.replace(stiffness=None)),
    "direction = 'up'": lambda: running.back_driving(RV, ERRORS, FRICTION, direction="up"),
    "rated_torque = 0 N m: must be positive": lambda: running.joint(RV, ERRORS, FRICTION, rated_torque=0.0),
    "damping = -1 N m s/rad: must be zero or positive": lambda: running.joint(
        RV, ERRORS, FRICTION, rated_torque=412.0, damping=-1.0
    ),
    "torque: 3 points, must be 4 as of speed": lambda: running.fit_drag(np.array([1.0, 2, -1, -2]), np.ones(3)),
    "speed: 3 points, must be at least 4": lambda: running.fit_drag(np.array([1.0, 2, -1]), np.ones(3)),
    "speed: one direction only": lambda: running.fit_drag(np.array([1.0, 2, 3, 0]), np.ones(4)),
    "speed: 2 rad/s in every point": lambda: running.fit_drag(np.array([2.0, 2, -2, -2]), np.ones(4)),
    "speed[2] = 0 rad/s: a point at rest": lambda: running.fit_drag([1.0, 2, 0, -1, -2], [1.0, 2, 0.1, -1, -2]),
    "torque[3] = 2.1 N m at -2 rad/s (mean of this direction 1.8 N m): a torque that keeps": lambda: running.fit_drag(
        [1.0, 2, -1, -2], [1.5, 2.1, 1.5, 2.1]
    ),
    "torque[3] = -2 N m at 4 rad/s (mean": lambda: running.fit_drag(
        np.r_[SPEED, -SPEED], np.r_[1, 1.25, 1.5, -2, -1, -1.25, -1.5, -2]
    ),
    "at 4 rad/s (mean of this direction -1.5625 N m)": lambda: running.fit_drag(
        np.r_[SPEED, -SPEED], -np.r_[RISING, -RISING]
    ),
    "coulomb = -1.": lambda: running.fit_drag(np.r_[SPEED, -SPEED], np.r_[SPEED**2, -(SPEED**2)] / 4),
    "viscous = -0.475": lambda: running.fit_drag(np.r_[SPEED, -SPEED], np.r_[RISING[::-1], -RISING[::-1]]),
}


@pytest.mark.parametrize("told", REFUSED)
def test_what_cannot_be_is_one_line(told):
    with pytest.raises(ValueError, match=re.escape(told)) as error:
        REFUSED[told]()
    assert "\n" not in str(error.value)


def ramps(random, points=60):
    """Speeds of both directions, torques of 3.7 N m, 0.1 N m s/rad, 0.2 N m of the bench, noise of 0.15 N m."""
    speed = np.concatenate([np.linspace(0.5, 9, points), -np.linspace(0.5, 9, points)])
    return speed, 3.7 * np.sign(speed) + 0.1 * speed + 0.2 + 0.15 * random.standard_normal(len(speed))


def test_drag_of_ramps_comes_back_within_its_own_spread():
    speed, torque = ramps(np.random.default_rng(7))
    exact = running.fit_drag(speed, 3.7 * np.sign(speed) + 0.1 * speed + 0.2)
    np.testing.assert_allclose([exact.coulomb, exact.viscous, exact.offset], [3.7, 0.1, 0.2], rtol=1e-12)
    assert exact.residual_sd < 1e-13
    fits = [running.fit_drag(*ramps(np.random.default_rng(seed))) for seed in range(200)]
    for name, due in (("coulomb", 3.7), ("viscous", 0.1)):
        off = (np.array([float(getattr(fit, name)) for fit in fits]) - due) / float(getattr(fits[0], f"{name}_sd"))
        assert abs(off.mean()) < 0.25 and 0.85 < off.std() < 1.15  # 200 fits: 7 % of a standard deviation
    assert np.mean([float(fit.residual_sd) for fit in fits]) == pytest.approx(0.15, rel=0.02)
    half = running.fit_drag(speed[::2], torque[::2])
    told = half.coulomb * np.sign(speed) + half.viscous * speed + half.offset
    assert np.std((told - torque)[1::2]) < 0.2


def test_standard_deviations_are_those_of_least_squares():
    speed, torque = (x[::8] for x in ramps(np.random.default_rng(3)))
    columns = np.stack([np.sign(speed), speed, np.ones_like(speed)], axis=1)
    due, (rest,), *_ = np.linalg.lstsq(columns, torque)
    sd = np.sqrt(rest / (len(speed) - 3))
    sds = sd * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    fit = running.fit_drag(speed, torque)
    found = fit.coulomb, fit.viscous, fit.offset, fit.coulomb_sd, fit.viscous_sd, fit.residual_sd
    np.testing.assert_allclose(found, [*due, *sds[:2], sd], rtol=1e-11)


def test_drag_that_bends_with_the_speed_says_so():
    """Stribeck friction; a straight line with the same scatter has no warning."""
    speed, rng = np.linspace(0.05, 5, 40), np.random.default_rng(0)
    both = np.r_[speed, -speed]
    film = np.sign(both) * (0.8 + 0.4 * np.exp(-np.abs(both) / 0.2)) + 0.25 * both
    with pytest.warns(UserWarning, match=r"bends about the fit by 0\.0\d+ N m rms"):
        running.fit_drag(both, film + 0.01 * rng.standard_normal(80))
    running.fit_drag(both, 0.8 * np.sign(both) + 0.25 * both + 0.01 * rng.standard_normal(80))


def test_a_traced_point_at_rest_does_not_count():
    speed, torque = ramps(np.random.default_rng(5), 6)
    due = running.fit_drag(speed, torque)
    found = jax.jit(running.fit_drag)(np.append(speed, 0.0), np.append(torque, 7.0))
    np.testing.assert_allclose(jax.tree.leaves(found), jax.tree.leaves(due), rtol=1e-12)


def test_a_bad_point_gives_no_drag():
    assert np.isnan(running.fit_drag([1.0, np.nan, -1.0, -2.0], [1.0, 2.0, -1.0, -2.0]).coulomb)


def test_the_inertias_are_twice_the_kinetic_energy_of_the_ideal_motion():
    """Every part by its speed: the crank at -zc of the output in the housing, discs round the eccentric."""
    case = cases.NAMED["rv40: joint, all errors"]
    design, _ = cases.unit_of(case)
    parts, zc, crank = (
        design.inertia,
        design.cycloid.disc_teeth,
        design.cycloid.disc_teeth * design.cycloid.eccentricity,
    )
    rotor, output = kind_of(design).inertias(design)

    def every(values, count):
        return np.broadcast_to(values, count)

    cranks, discs = design.cranks.count, design.cycloid.disc_count
    spinning = every(parts.planet_inertia, cranks) + every(parts.crank_inertia, cranks)
    carried = every(parts.planet_mass, cranks) + every(parts.crank_mass, cranks)
    energy = parts.sun_inertia * design.ratio**2 + np.sum(spinning) * zc**2
    energy += np.sum(carried) * design.cranks.circle_radius**2 + parts.output_inertia
    energy += np.sum(every(parts.disc_mass, discs) * crank**2 + every(parts.disc_inertia, discs))
    assert float(rotor + output) == pytest.approx(float(energy), rel=1e-14)
    np.testing.assert_allclose(
        [rotor, output], [case["expect"]["rotor_inertia"], case["expect"]["output_inertia"]], rtol=1e-12
    )


def test_a_friction_is_no_part_of_the_loaded_model():
    """A NaN in it is not read there."""
    spoilt = RV.replace(friction=rvjax.Friction(ring_pins=np.nan))
    errors = RVErrors(drag_friction=np.nan)
    layout = loaded.check_input(spoilt, errors, "hertz", "fixed", "fixed")
    read = jax.jit(lambda *unit: loaded.admit(layout, *unit, 1.0, 0.0))(spoilt, errors)
    assert bool(read.gate.good) and read.design.friction is None and float(read.errors.drag_friction) == 0
