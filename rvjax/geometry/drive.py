"""Figures of a single-stage drive: its ring, the holes of its discs, the force of an eccentric bearing."""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.cycloidal import CycloidalReducer
from rvjax.geometry.ring import Figures, harmless, material, of_ring, of_steel, root, squared_pressure
from rvjax.records import Array, PyTree, Scalar, promote
from rvjax.status import Status, admit


def of_drive(design: CycloidalReducer, output_torque: Scalar) -> Figures:
    """Figures of a single-stage drive, as `figures` returns them.

    Args:
        design: cycloid stage, output pins and contact are read.
        output_torque: () N m.
    """
    return _figures((design.cycloid, design.output, design.contact, design.carrier_factor * output_torque))


@functools.partial(jax.jit, inline=True)
def _figures(read: PyTree) -> Figures:
    """Of the cycloid stage, output pins, contact and torque of the carrier."""
    cycloid, output, contact, torque = read
    unread: dict[str, None] = dict(pin_stiffness=None, pin_support=None)
    cycloid, output = cycloid.replace(shortening=None, force_angle=0.0, disc_phase=0.0), output.replace(**unread)
    read = promote((cycloid, output, contact and contact.replace(**unread), torque))
    cycloid, output, contact, torque = read
    k1 = cycloid.shortening_coefficient
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    positive = [cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.pin_radius, *material(contact)]
    positive += [output.circle_radius, output.pin_radius, cycloid.eccentricity + output.hole_clearance / 2]
    possible = (k1 > 0) & (k1 < 1) & jnp.all(jnp.stack(positive) > 0)
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (cycloid, output, contact, torque), gate = admit(read, _harmless(read), *checks)

    each = jnp.abs(torque) / cycloid.disc_count  # of the carrier on one disc
    found, pressure, info = of_ring(cycloid, contact, each, gate)
    e, circle, pin = cycloid.eccentricity, output.circle_radius, output.pin_radius
    room = e + output.hole_clearance / 2  # hole radius less pin radius
    hole = pin + room
    across = each / (e * cycloid.disc_teeth)
    along = 2 / jnp.pi * across * _ring_share(cycloid.shortening_coefficient) - 4 * each / (jnp.pi * circle)  # Eq. 16
    own: dict[str, Any] = dict(
        hole_gap=2 * (circle * math.sin(math.pi / output.count) - hole),
        hole_wall=cycloid.pin_circle_radius - cycloid.pin_radius - e - circle - hole,
        eccentric_force=root(across**2 + along**2),
        hole_pressure=None,
    )
    if contact is not None:
        force = each / circle * largest_share(output.count)
        own["hole_pressure"] = root(force * squared_pressure(contact) * room / (pin * hole))  # 1/R* = 1/rw - 1/rh
    own, _ = gate.close(own)
    return Figures(**found, **own, pin_pressure=pressure, info=info, crank_room=None, contact_ratio=None, mass=None)


def _ring_share(k1: Array) -> Array:
    """I of Eq. 16: force of the ring along the eccentric, over 2 T/(pi e zc)."""
    return (1 - (1 - k1**2) / (2 * k1) * jnp.log((1 + k1) / (1 - k1))) / k1


@functools.cache
def largest_share(pins: int) -> float:
    """Largest force of an output pin over a turn, rigid discs, over T/Rw: 4/n for an even number. Eq. 17.

    Args:
        pins: output pins, n.
    """
    place, step = 0.0, 2 * math.pi / pins / 4096
    for grid in (step * np.arange(4096), step * np.linspace(-1, 1, 4097)):
        positive = np.maximum(np.sin(place + grid[:, None] + 2 * np.pi * np.arange(pins) / pins), 0)
        shares = positive.max(axis=1) / np.sum(positive**2, axis=1)
        place += grid[np.argmax(shares)]
    return float(shares.max())


def _harmless(read: PyTree) -> PyTree:
    """A drive that exists, in the place of one that does not."""
    cycloid, output, contact, torque = jax.tree.map(jnp.ones_like, read)
    contact = contact and of_steel(contact)
    return harmless(cycloid), output.replace(circle_radius=0.5, pin_radius=0.1, hole_clearance=0.01), contact, torque
