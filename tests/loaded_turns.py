"""A loaded reducer over one output turn, and what an encoder reads of it.

The reducer is that of `published.rv160`: three cranks, 39 teeth, 40 pins. 480 angles of an output turn are a multiple
of 120, so that orders above 240 alias onto orders of the same harmonic of the housing.
"""

from functools import cache, partial

import jax
import numpy as np
from loaded_cases import plain

from rvjax import loaded
from rvjax.published.rv160_reducer import MACHINE, NONE
from rvjax.status import succeeded
from rvjax.units import mm

SAMPLES, ORDERS = 480, np.arange(241)
TURN = 2 * np.pi * np.arange(SAMPLES) / SAMPLES  # of the carrier
PINS = 2 * np.pi * np.arange(40) / 40
ENCODER = loaded.Reading(radius=75 * mm, disc_position=(-11 * mm, 11 * mm), height=50 * mm)
RING, TILT = ENCODER.replace(ring_gain=2e-9), ENCODER.replace(tilt_gain=1e-7)
ALL = ENCODER.replace(ring_gain=2e-9, tilt_gain=1e-7, dent=5.4e-9, scale_eccentricity=(3e-6, -2e-6))


SUPPORT = np.full(40, 1e8)


def sprung(support=SUPPORT, stiffness=MACHINE.stiffness, **contact):
    """The reducer on other supports of its pins, by default an array: one program serves most tests."""
    springs = stiffness.replace(turning_arm_bearing=np.broadcast_to(stiffness.turning_arm_bearing, (2, 3)))
    held = MACHINE.contact.replace(pin_support=support, **contact)
    return plain(MACHINE.replace(stiffness=springs, contact=held))


def harmonics(y):
    """Complex amplitudes A_n of y = Re sum A_n e^(i n th), rad."""
    return np.fft.rfft(np.asarray(y)) * 2 / SAMPLES


@partial(jax.jit, static_argnums=3)
def solved_over_a_turn(design, errors, torque, law):
    one = partial(loaded.equilibrium, design, errors, output_torque=torque, contact=law)
    return jax.vmap(lambda angle: one(input_angle=angle))(TURN * MACHINE.ratio)


def found_over_a_turn(design, torque, law="hertz", errors=NONE):
    found = solved_over_a_turn(design, plain(errors), float(torque), law)
    assert succeeded(found.info.status).all()
    return found


@jax.jit
def read_over_a_turn(found, reading, torque):
    one = partial(loaded.reading, design=MACHINE, output_torque=torque, reading=reading)
    return jax.vmap(lambda found, angle: one(found, input_angle=angle))(found, TURN * MACHINE.ratio)


def orders_read(found, reading, torque):
    return harmonics(read_over_a_turn(found, plain(reading), float(torque)))


@cache
def loaded_turn(torque=1000.0):
    return found_over_a_turn(sprung(), torque)
