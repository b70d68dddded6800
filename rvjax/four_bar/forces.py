"""Load on the crank pins of a loaded reducer, and how far clearance and bearings let them move."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.designs import RVReducer
from rvjax.four_bar.closures import Crank
from rvjax.records import Array, Scalar

Vector = tuple[jax.Array, jax.Array]


class DiscLoad(NamedTuple):
    """Load of one disc on the carrier, per disc."""

    tangential: jax.Array  # Fv, along the direction of motion of the disc centre, N
    radial: jax.Array  # Fu, along the eccentric direction, N
    torque: jax.Array  # Tc, couple on the crank pins, N m


def pin_load_ratio(shortening: jax.Array) -> jax.Array:
    """kappa: radial over tangential pin load, half the pins in contact, loaded by lever arm; 0 < K1 < 1.

    The forces of the pins meet in the pitch point. A power series replaces the closed form where that
    would cancel.
    """
    small = shortening < 0.4
    k = jnp.where(small, shortening, 0.2)
    series = jnp.zeros_like(k)
    for n in range(20, 0, -1):
        series = series * k**2 + 1 / (4 * n**2 - 1)
    k1 = jnp.where(small, 0.5, shortening)
    closed = 1 / k1 - (1 - k1**2) / k1**2 * jnp.arctanh(k1)
    return jnp.where(small, 4 / jnp.pi * k * series, 2 / jnp.pi * closed)


def disc_load(design: RVReducer, eccentricity: Array, shortening: Array, torque: jax.Array) -> DiscLoad:
    """Share of one disc in the torque that all discs exert on the carrier; only counts are read from `design`."""
    cycloid, ratio = design.cycloid, design.involute.sun_teeth / design.involute.planet_teeth
    tangential = torque / (cycloid.disc_count * eccentricity * (cycloid.pin_count + ratio))  # ratio: the sun reacts
    return DiscLoad(
        tangential=tangential,
        radial=pin_load_ratio(shortening) * jnp.abs(tangential),
        torque=eccentricity * cycloid.disc_teeth * tangential,
    )


def pin_force(load: DiscLoad, crank: Crank, tangent: Vector, count: int, radius: Array) -> Vector:
    """Force of a disc on one of `count` crank pins; `crank` is the disc's eccentric direction."""
    couple = load.torque / (count * radius)
    return (
        (load.radial * crank.cosine - load.tangential * crank.sine) / count + couple * tangent[0],
        (load.radial * crank.sine + load.tangential * crank.cosine) / count + couple * tangent[1],
    )


def joint_shift(force: Vector, clearance: Scalar, stiffness: Scalar) -> Vector:
    """Bore against pin: the clearance taken up in the direction of the load, and the elastic approach.

    No load takes up no clearance: T = 0 is a jump of the clearance part, whose derivatives there are zero.
    """
    square = force[0] ** 2 + force[1] ** 2
    loaded = square > 0
    size = jnp.sqrt(jnp.where(loaded, square, 1))
    unit = tuple(jnp.where(loaded, part / size, 0) for part in force)
    return unit[0] * clearance + force[0] / stiffness, unit[1] * clearance + force[1] / stiffness
