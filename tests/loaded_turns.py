"""A loaded reducer over one output turn, and what an encoder reads of it.

The reducer is that of `published.rv160`: three cranks, 39 teeth, 40 pins. 480 angles of an output turn are a multiple
of 120, so that orders above 240 alias onto orders of the same harmonic of the housing.
"""

from functools import cache, partial

import jax
import numpy as np
from loaded_cases import by_newton, plain

from rvjax import loaded
from rvjax.published.rv160 import MACHINE, NONE
from rvjax.status import succeeded
from rvjax.units import mm

SAMPLES, ORDERS = 480, np.arange(241)
TURN = 2 * np.pi * np.arange(SAMPLES) / SAMPLES  # of the carrier
PINS = 2 * np.pi * np.arange(40) / 40
ENCODER = loaded.Reading(radius=75 * mm, disc_position=(-11 * mm, 11 * mm), height=50 * mm)
ALL = ENCODER.replace(ring_gain=2e-9, tilt_gain=1e-7, dent=5.4e-9, scale_eccentricity=(3e-6, -2e-6))


SUPPORT, NOTHING = np.full(40, 1e8), np.zeros(40)


def sprung(support=SUPPORT, stiffness=MACHINE.stiffness, **contact):
    """The reducer on a support of each pin, and with other springs: one program serves all."""
    arms, seats = (
        np.broadcast_to(x, s) for x, s in ((stiffness.turning_arm_bearing, (2, 3)), (stiffness.support_bearing, 3))
    )
    springs = stiffness.replace(turning_arm_bearing=arms, support_bearing=seats)
    held = MACHINE.contact.replace(pin_support=support, **contact)
    return plain(MACHINE.replace(stiffness=springs, contact=held))


def harmonics(y):
    """Complex amplitudes A_n of y = Re sum A_n e^(i n th), rad."""
    return np.fft.rfft(np.asarray(y)) * 2 / SAMPLES


@jax.jit
def solved_over_a_turn(design, errors, torque, shape, pull):
    """Equilibria, and their slopes to eps: supports yield times 1 + eps shape, and the torque grows by eps pull."""

    def solved(eps):
        held = design.contact.replace(pin_support=design.contact.pin_support / (1 + eps * shape))
        return every_angle(design.replace(contact=held), errors, torque + eps * pull)

    return jax.jvp(solved, (0.0,), (1.0,))


def every_angle(design, errors, torque):
    one = partial(by_newton, design, errors, torque=torque)
    return jax.vmap(lambda angle: one(angle=angle))(TURN * MACHINE.ratio)


values_over_a_turn = jax.jit(every_angle)  # two thirds of the time of compilation


def found_over_a_turn(design, torque, errors=NONE):
    found = values_over_a_turn(design, plain(errors), float(torque))
    assert succeeded(found.info.status).all()
    return found


def slopes_over_a_turn(design, torque, shape=NOTHING, pull=0.0, errors=NONE):
    """Equilibria and slopes, by one program."""
    found, slopes = solved_over_a_turn(design, plain(errors), float(torque), shape, pull)
    assert succeeded(found.info.status).all()
    return found, slopes


@jax.jit
def read_over_a_turn(found, reading, torque):
    one = partial(loaded.reading, design=MACHINE, output_torque=torque, reading=reading)
    return jax.vmap(lambda found, angle: one(found, input_angle=angle))(found, TURN * MACHINE.ratio)


def orders_read(found, reading, torque):
    return harmonics(read_over_a_turn(found, plain(reading), float(torque)))


@cache
def loaded_turn(torque=1000.0):
    return found_over_a_turn(sprung(), torque)
