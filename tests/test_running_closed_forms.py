"""Closed forms of the losses of a reducer."""

import functools

import numpy as np
import pytest
import running_cases as cases
from loaded_cases import plain
from scipy.special import ellipe

from rvjax import Bearings, Friction, Status, loaded, running
from rvjax.loaded import unchecked

PIN = 1e7  # N/m
LINEAR = dict(contact="linear", samples=24, output_speed=0.7)


@functools.cache
def simple():
    """RV-40E with stiff bearings, without positions of the supports, and its friction."""
    design, errors = cases.unit_of(cases.NAMED["rv40: no errors, forward"])
    springs = design.stiffness.replace(turning_arm_bearing=1e11, support_bearing=1e11)
    bearings = Bearings(design.bearings.arm, design.bearings.support)
    contact = design.contact.replace(pin_stiffness=PIN)
    return plain((design.replace(stiffness=springs, bearings=bearings, contact=contact), errors))


SIMPLE = plain(Friction(0.05, None, 0.002, 0.0015, 0.01, input_drag=0.05, output_drag=8.0, static_factor=1.2))


@pytest.mark.long  # the cases of an independent evaluation, test_running.py, have every place by default
def test_closed_forms_of_every_place():
    """The handbook's formula of the pins, elliptic integrals of the bearings, gears: Eqs. 19 to 24."""
    design, errors = simple()
    cycloid, cranks, bearings = design.cycloid, design.cranks.count, design.bearings
    zc, zp, discs, e = cycloid.disc_teeth, cycloid.pin_count, cycloid.disc_count, cycloid.eccentricity
    rp, rr, radius, torque = cycloid.pin_circle_radius, cycloid.pin_radius, design.cranks.circle_radius, 412.0
    found = running.losses(design, errors, SIMPLE, output_torque=torque, **LINEAR)
    moment = torque * zc / (discs * (zp + design.involute.sun_teeth / design.involute.planet_teeth))
    ring = 0.05 * discs * moment * 4 * (rp - rr) / (np.pi * e * zc)
    assert float(found.ring_pins) == pytest.approx(ring, rel=4e-4)
    k1 = e * zp / rp
    inner = (1 - (1 - k1**2) / (2 * k1) * np.log((1 + k1) / (1 - k1))) / k1
    a, b = moment / (cranks * radius), np.hypot(moment / (e * zc), 2 * moment * inner / (np.pi * e * zc)) / cranks
    arms = discs * cranks * 2 / np.pi * (a + b) * ellipe(4 * a * b / (a + b) ** 2)
    assert float(found.arm_bearings) == pytest.approx(zp * 0.002 * arms * bearings.arm.pitch_diameter / 2, rel=1e-4)
    supports = zp * 0.0015 * torque / radius * bearings.support.pitch_diameter / 2
    assert float(found.support_bearings) == pytest.approx(supports, rel=1e-5)
    gears = 0.01 * torque * (1 - 1 / design.ratio)
    assert float(found.gear_meshes) == pytest.approx(gears, rel=2e-4)  # centring springs carry 1e-8 of a stiff bearing
    drag = 8 + design.ratio * 0.05
    share = float(found.loss_torque - found.drag) / torque
    assert float(found.efficiency) == pytest.approx(1 / (1 + share + drag / torque), rel=1e-9)
    assert float(found.backward_efficiency) == pytest.approx(1 - share - drag / torque, rel=1e-7)
    delta = 2e-6
    tight = running.losses(design, unchecked(errors, pin_radius=delta), SIMPLE, output_torque=0.0, **LINEAR)
    assert int(tight.info.status) == Status.CONVERGED
    size = 2 / np.pi * (1 + k1) * ellipe(4 * k1 / (1 + k1) ** 2)
    assert float(tight.ring_pins) == pytest.approx(0.05 * discs * PIN * delta * zp * (rp * size - rr), rel=1e-3)


@pytest.mark.long
def test_the_two_numbers_of_the_makers():
    """Back-driving torque over ratio times starting torque is 1/(1 - f L), with one angle."""
    design, errors = simple()
    one = running.losses(design, errors, SIMPLE, output_torque=412.0, **(LINEAR | dict(samples=1)))
    share, drag = float(one.loss_torque - one.drag) / 412, 8 + design.ratio * 0.05
    for direction in ("forward", "backward"):
        back = running.back_driving(design, errors, SIMPLE, direction=direction, samples=1, contact="linear")
        assert float(back.torque) == pytest.approx(1.2 * drag / (1 - 1.2 * share), rel=1e-8)
        makers = float(back.torque / (design.ratio * one.starting_torque))
        assert makers == pytest.approx(1 / (1 - 1.2 * share), rel=1e-8)


@pytest.mark.long
def test_a_narrow_loop_is_twice_the_friction_over_the_stiffness():
    design, errors = simple()
    drag = plain(Friction(output_drag=1e-3, static_factor=1.2))
    found = running.hysteresis(design, errors, drag, contact="linear")
    at = loaded.equilibrium(design, errors, input_angle=0.0, output_torque=1e-3, contact="linear")
    assert float(found.width) == pytest.approx(2 * 1.2e-3 / float(at.stiffness), rel=1e-3)


@pytest.mark.long
def test_a_drive_with_either_output_has_the_same_losses_of_pins_and_arms():
    """And those of the closed forms, with stiff bearings; six output pins."""
    design, errors = cases.unit_of(cases.NAMED["cycloidal: no errors"])
    cycloid, output = design.cycloid, design.output
    zp, e = cycloid.pin_count, cycloid.eccentricity
    stiff = design.stiffness.replace(eccentric_bearing=1e11, shaft_support=None)
    cycloid = unchecked(cycloid, equidistant_modification=0.0, shift_modification=0.0)
    output = unchecked(output, hole_clearance=0.0, pin_stiffness=1e9)
    contact = design.contact.replace(pin_stiffness=PIN)
    design = plain(design.replace(stiffness=stiff, cycloid=cycloid, output=output, contact=contact))
    friction = plain(Friction(0.06, 0.08, 0.0015))
    one = running.losses(design, errors, friction, output_torque=11.7, output_speed=1.0, contact="linear")
    lever = 4 * (cycloid.pin_circle_radius - cycloid.pin_radius) / (np.pi * e * cycloid.disc_teeth)
    assert float(one.ring_pins) == pytest.approx(0.06 * 11.7 * lever, rel=1e-3)
    holes = 0.08 * 11.7 * 4 * e * zp / (np.pi * output.circle_radius)
    assert float(one.output_pins) == pytest.approx(holes, rel=0.01)
    assert float(one.gear_meshes) == float(one.support_bearings) == 0
    ring, torque = design.replace(member="ring"), -11.7 * zp / cycloid.disc_teeth
    other = running.losses(ring, errors, friction, output_torque=torque, output_speed=1.0, contact="linear")
    for name in ("ring_pins", "output_pins", "arm_bearings"):
        assert float(getattr(other, name)) == pytest.approx(float(getattr(one, name)), rel=1e-6)
