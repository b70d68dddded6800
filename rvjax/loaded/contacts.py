"""Forces, energy and stiffness of all contacts at displacements q: the energy of docs/models/loaded.md, Eq. 21.

Arrays have the batch axis (independent cases) last; a leaf of the system that all cases share has length 1 there.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.batching import folded
from rvjax.loaded import laws
from rvjax.loaded.system import Bearings, Layout, System


class Pressed(NamedTuple):
    """Unilateral contacts: pins (d, p, l) or joints (j, l)."""

    depth: jax.Array  # m
    force: jax.Array  # N
    slope: jax.Array | None = None  # N/m, rise of the force with the depth; None: that of the contact law


class Held(NamedTuple):
    """Forces and stiffness of bearings."""

    force: jax.Array  # (b, 2, l), sign of grad E
    stiffness: jax.Array  # xx, xy, yy, (3, b, l)
    energy: jax.Array  # (b, l)


class Contacts(NamedTuple):
    """Every contact at q."""

    pins: Pressed
    joints: Pressed
    bearings: Held


def contacts(layout: Layout, s: System, q: jax.Array) -> Contacts:
    """All contacts at the displacements q.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        q: (n, l).
    """
    depth = depths(layout, s, q)
    joint_depth, w = displaced(s, q)
    return Contacts(
        pins=Pressed(depth, laws.force(layout.law, depth, s.pins.compliance[None], s.pins.level)),
        joints=Pressed(joint_depth, joint_forces(layout, s, joint_depth)),
        bearings=held(w, s.bearings),
    )


def depths(layout: Layout, s: System, q: jax.Array, gaps: bool = True) -> jax.Array:
    """Depths of the pins in the discs, (d, p, l).

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        q: (n, l).
        gaps: False: changes of the depths by a step q.
    """
    discs = q[: layout.inner].reshape(layout.discs, 3, 1, -1)
    change = sum(s.pins.rows[a] * discs[:, a] for a in range(3))
    return jnp.asarray(s.pins.gap + change if gaps else change)


def displaced(s: System, q: jax.Array, gaps: bool = True) -> tuple[jax.Array, jax.Array]:
    """Depths of the joints (j, l), and displacements of the bearings (b, 2, l).

    Args:
        s: the system, batch axis last.
        q: (n, l).
        gaps: False: their changes by a step q.
    """
    joints, bearings = _moved(s.joints.rows, q), _moved(s.bearings.rows, q)
    return (s.joints.gap + joints, s.bearings.gap + bearings) if gaps else (joints, bearings)


def held(w: jax.Array, bearings: Bearings) -> Held:
    """k (|w| - clearance)+ along w, with its exact stiffness; without clearance k w.

    Args:
        w: (b, 2, l).
        bearings: their stiffness and clearance are read.
    """
    stiffness, clearance = bearings.stiffness, bearings.clearance
    x, y = w[:, 0], w[:, 1]
    square = x * x + y * y
    pressed = square >= clearance * clearance
    inverse = 1 / jnp.sqrt(jnp.where(pressed & (square > 0), square, 1))
    slack = jnp.where(square > 0, clearance, 0) * inverse  # share of w that is clearance
    cx, cy = x * inverse, y * inverse
    k = jnp.where(pressed, stiffness, 0)
    radial = k * (1 - slack)
    along = k * slack
    return Held(
        force=radial[:, None] * w,
        stiffness=jnp.stack([radial + along * cx * cx, along * cx * cy, radial + along * cy * cy]),
        energy=k * (1 - slack) * (1 - slack) * square / 2,
    )


def joint_forces(layout: Layout, s: System, depth: jax.Array) -> jax.Array:
    """Forces of the joints (j, l) at their depths (j, l)."""
    return _by_group(layout, s, laws.force, depth)


def joint_slopes(layout: Layout, s: System, depth: jax.Array, force: jax.Array) -> jax.Array:
    """Rise of the forces of the joints with their depths, (j, l)."""
    return _by_group(layout, s, lambda law, d, f, k, _: laws.slope(law, d, f, k), depth, force)


def typical_joint_slopes(layout: Layout, s: System) -> jax.Array:
    """Slopes (j, l) where half of the joints carries the load, with the mean of their levers."""
    force = jnp.abs(s.load) / (jnp.sum(jnp.abs(s.joints.lever), axis=0) / 2)
    return _by_group(layout, s, laws.typical_slope, force[None])


def _by_group(layout: Layout, s: System, of: Callable[..., jax.Array], *values: jax.Array) -> jax.Array:
    """of(contact law, *values, compliance, level) of each group of joints, (j, l)."""
    found = []
    for group, part in layout.parts(layout.joints):
        level = None if s.joints.level is None else s.joints.level[part]
        given = (value if len(value) == 1 else value[part] for value in values)
        found.append(of(group.law, *given, s.joints.compliance[part], level))
    return found[0] if len(found) == 1 else jnp.concatenate(found)


def gradient(layout: Layout, s: System, q: jax.Array, at: Contacts | None = None) -> jax.Array:
    """Gradient of the energy, (n, l) N; zero at the equilibrium (Eq. 22).

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        q: (n, l).
        at: its contacts, where they are known.
    """
    at = contacts(layout, s, q) if at is None else at
    pins = over_pins(s.pins.rows, at.pins.force).swapaxes(0, 1).reshape(layout.inner, -1)
    load = jnp.zeros_like(q).at[layout.carried].set(s.load)
    total = s.support * q + load + jnp.pad(pins, ((0, layout.unknowns - layout.inner), (0, 0)))
    total = total + _product(s.joints.rows, at.joints.force)
    rows = s.bearings.rows
    return total + _product(rows.reshape(-1, *rows.shape[2:]), at.bearings.force.reshape(-1, q.shape[-1]))


def energy(layout: Layout, s: System, q: jax.Array, at: Contacts) -> jax.Array:
    """Energy (l,) J, Eq. 21."""
    pins = folded(laws.energy(layout.law, *at.pins[:2], s.pins.compliance[None]), 0, 1)
    of_joints = _by_group(layout, s, lambda law, d, f, k, _: laws.energy(law, d, f, k), *at.joints[:2])
    support = folded(s.support * q * q, 0) / 2 + s.load * q[layout.carried]
    return pins + folded(at.bearings.energy, 0) + folded(of_joints, 0) + support


def _moved(rows: jax.Array, q: jax.Array) -> jax.Array:
    """rows (..., n, l) times q (n, l): (..., l)."""
    return folded(rows * q[(None,) * (rows.ndim - 2)], rows.ndim - 2)


def _product(rows: jax.Array, values: jax.Array) -> jax.Array:
    """Sum over m of rows (m, n, l) times values (m, l): (n, l)."""
    return folded(rows * values[:, None], 0)


def over_pins(rows: jax.Array, load: jax.Array) -> jax.Array:
    """Sums over the pins of a disc of rows (w, d, p, l) times load (d, p, l): (w, d, l)."""
    return folded(rows * load[None], 2)
