"""Loads of the two support bearings of a crank: statics of a beam, and thrust of tapered bearings."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.bearings import Bearings
from rvjax.life.histories import magnitude


def shared(bearings: Bearings, arm: jax.Array, support: jax.Array) -> jax.Array:
    """Radial force of each support, (..., c, 2, 2) N [support 0, 1; x, y].

    Args:
        bearings: without positions each support carries half (Eq. 17).
        arm: crank on disc, (..., d, c, 2) N.
        support: both supports together, crank on carrier, (..., c, 2) N.
    """
    if not bearings.placed:
        return jnp.stack([support / 2, support / 2], axis=-2)
    gear = support + jnp.sum(arm, axis=-3)  # Eq. 16
    discs = arm.shape[-3]
    place = jnp.broadcast_to(bearings.disc_position, (discs,)).reshape((1,) * (arm.ndim - 3) + (discs, 1, 1))
    one = (bearings.planet_position * gear - jnp.sum(place * arm, axis=-3)) / bearings.support_span  # Eq. 18
    return jnp.stack([support - one, one], axis=-2)


class Equivalent(NamedTuple):
    """Equivalent loads of every instant, (...,) N."""

    dynamic: jax.Array
    static: jax.Array


def tapered(bearings: Bearings, force: jax.Array) -> Equivalent:
    """Equivalent loads of two tapered bearings set against each other. Eqs. 19, 20.

    Args:
        bearings: with preload.
        force: radial, (..., c, 2, 2) N [support 0, 1; x, y].
    """
    assert bearings.support is not None
    cotangent = 1 / jnp.tan(bearings.support.contact_angle)
    axial_factor = 0.4 * cotangent  # Y
    radial = magnitude(force)
    thrust = jnp.max(radial, axis=-1, keepdims=True) / (2 * axial_factor)
    axial = jnp.maximum(bearings.preload, thrust)
    return Equivalent(
        dynamic=jnp.maximum(radial, 0.4 * radial + axial_factor * axial),
        static=jnp.maximum(radial, 0.5 * radial + 0.22 * cotangent * axial),
    )
