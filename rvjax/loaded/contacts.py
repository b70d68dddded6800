"""Forces, energy and stiffness of all contacts at displacements q: the energy of docs/models/loaded.md, Eq. 21.

Arrays have the batch axis (independent cases) last; a leaf of the system that all cases share has length 1 there.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.batching import folded
from rvjax.loaded import laws
from rvjax.loaded.elimination import Hessian
from rvjax.loaded.system import Layout, System


class Bearing(NamedTuple):
    """Radial springs with clearance, force and stiffness of their displacements."""

    force: jax.Array  # (b, 2, l), sign of grad E
    stiffness: jax.Array  # xx, xy, yy, (3, b, l)
    energy: jax.Array  # (b, l)


class Contacts(NamedTuple):
    """Every contact at q."""

    depth: jax.Array  # (d, p, l)
    pins: jax.Array  # (d, p, l) N
    gear_depth: jax.Array  # (c, 2, l)
    gear: jax.Array  # (c, 2, l) N
    bearing: Bearing


def contacts(layout: Layout, s: System, q: jax.Array) -> Contacts:
    """All contacts at the displacements q.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        q: (n, l).
    """
    depth = depths(layout, s, q)
    gear_depth, held = joints(s, q)
    return Contacts(
        depth=depth,
        pins=laws.force(layout.law, depth, s.compliance[None], s.level),
        gear_depth=gear_depth,
        gear=s.gear_stiffness[:, None] * jnp.maximum(gear_depth, 0),
        bearing=held,
    )


def depths(layout: Layout, s: System, q: jax.Array) -> jax.Array:
    """Depths of the pins in the discs, (d, p, l).

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        q: (n, l).
    """
    discs = q[: layout.inner].reshape(layout.discs, 3, 1, -1)
    return s.gap + sum(s.rows[a] * discs[:, a] for a in range(3))


def joints(s: System, q: jax.Array) -> tuple[jax.Array, Bearing]:
    """Depths of the flanks (c, 2, l), and the bearings.

    Args:
        s: the system, batch axis last.
        q: (n, l).
    """
    held = bearing(s.bearing_gap + moved(s.bearing_rows, q), s.bearing_stiffness, s.clearance)
    return s.gear_gap + moved(s.gear_rows, q), held


def bearing(w: jax.Array, stiffness: jax.Array, clearance: jax.Array) -> Bearing:
    """k (|w| - clearance)+ along w, with its exact stiffness; without clearance k w.

    Args:
        w: (b, 2, l).
        stiffness: k, (b, l).
        clearance: (b, l) >= 0.
    """
    x, y = w[:, 0], w[:, 1]
    square = x * x + y * y
    held = square >= clearance * clearance
    inverse = 1 / jnp.sqrt(jnp.where(held & (square > 0), square, 1))
    slack = jnp.where(square > 0, clearance, 0) * inverse  # share of w that is clearance
    cx, cy = x * inverse, y * inverse
    k = jnp.where(held, stiffness, 0)
    radial = k * (1 - slack)
    along = k * slack
    return Bearing(
        force=radial[:, None] * w,
        stiffness=jnp.stack([radial + along * cx * cx, along * cx * cy, radial + along * cy * cy]),
        energy=k * (1 - slack) * (1 - slack) * square / 2,
    )


def gradient(layout: Layout, s: System, q: jax.Array, at: Contacts | None = None) -> jax.Array:
    """Gradient of the energy, (n, l) N; zero at the equilibrium (Eq. 22).

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        q: (n, l).
        at: its contacts, where they are known.
    """
    at = contacts(layout, s, q) if at is None else at
    pins = _summed(s.rows, at.pins).swapaxes(0, 1).reshape(layout.inner, -1)
    load = jnp.zeros_like(q).at[layout.carried].set(s.load)
    total = s.support * q + load + jnp.pad(pins, ((0, layout.unknowns - layout.inner), (0, 0)))
    for rows, force in ((s.gear_rows, at.gear), (s.bearing_rows, at.bearing.force)):
        total = total + _product(rows.reshape(-1, *rows.shape[2:]), force.reshape(-1, q.shape[-1]))
    return total


def energy(layout: Layout, s: System, q: jax.Array, at: Contacts) -> jax.Array:
    """Energy (l,) J, Eq. 21."""
    pins = folded(laws.energy(layout.law, at.depth, at.pins, s.compliance[None]), 0, 1)
    gear = folded(at.gear * at.gear_depth, 0, 1) / 2
    own = folded(s.support * q * q, 0) / 2 + s.load * q[layout.carried]
    return pins + folded(at.bearing.energy, 0) + gear + own


class Frame(NamedTuple):
    """Geometry in the second derivatives, batch axis last; rows of x and y, or of both flanks, first."""

    pins: jax.Array  # (6, d, p, l) products of two rows: 00, 10, 11, 20, 21, 22
    disc: jax.Array  # (2, 3, d, c, l) an arm on its disc
    pairs: tuple[jax.Array, jax.Array]  # (2, 6, d, c, l) the same, first and second of each such product
    crank: jax.Array  # (2, 3, d, c, l) an arm on its crank
    seat: jax.Array  # (2, 3, c, l) a seat on its crank
    seat_tail: jax.Array  # (2, t, c, l) and on carrier and sun
    flank: jax.Array  # (2, 3, c, l) the flanks of a planet on its crank
    flank_tail: jax.Array  # (2, t, c, l)


_PAIRS = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))


def frame(layout: Layout, s: System) -> Frame:
    """The geometry of the second derivatives.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
    """
    discs, cranks, split = layout.discs, layout.cranks, layout.discs * layout.cranks
    arms = s.bearing_rows[:split].reshape(discs, cranks, 2, layout.unknowns, -1)
    on_disc = jnp.stack([arms[k, :, :, 3 * k : 3 * k + 3] for k in range(discs)])
    on_crank = jnp.stack([arms[:, i, :, layout.crank(i) : layout.crank(i) + 3] for i in range(cranks)], axis=1)
    disc, crank = (jnp.moveaxis(x, (2, 3), (0, 1)) for x in (on_disc, on_crank))
    held = []
    for rows in (s.bearing_rows[split:], s.gear_rows):
        own = jnp.stack([rows[i, :, layout.crank(i) : layout.crank(i) + 3] for i in range(cranks)])
        held += [jnp.moveaxis(x, 0, 2) for x in (own, rows[:, :, layout.carried :])]
    first, second = (jnp.stack([disc[:, pair[i]] for pair in _PAIRS], axis=1) for i in range(2))
    pins = jnp.stack([s.rows[a] * s.rows[b] for a, b in _PAIRS])
    return Frame(pins, disc, (first, second), crank, *held)


@functools.partial(jax.jit, static_argnums=0)  # traced once for each batch size
def hessian(
    layout: Layout,
    s: System,
    at: Contacts,
    pin_slope: jax.Array | None = None,
    gear_slope: jax.Array | None = None,
    at_rest: Frame | None = None,
) -> Hessian:
    """Second derivatives of the energy, in the blocks of the elimination.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        at: contacts at q.
        pin_slope: (d, p, l), by default that of the contact law.
        gear_slope: (c, 2, l), by default the stiffness of the flanks of positive depth.
        at_rest: `frame(layout, s)`, where it is known.
    """
    discs, cranks, lanes = layout.discs, layout.cranks, at.depth.shape[-1]
    rows = frame(layout, s) if at_rest is None else at_rest
    if pin_slope is None:
        pin_slope = laws.slope(layout.law, at.depth, at.pins, s.compliance[None])
    if gear_slope is None:
        gear_slope = jnp.where(at.gear_depth > 0, s.gear_stiffness[:, None], 0)
    split = discs * cranks
    stiff = at.bearing.stiffness[:, :split].reshape(3, 1, discs, cranks, lanes)
    disc, crank = _sprung(stiff, rows.disc), _sprung(stiff, rows.crank)
    first, second = rows.pairs[0], _sprung(stiff, rows.pairs[1])
    arms = folded(first[0] * second[0] + first[1] * second[1], 2)
    stiff = at.bearing.stiffness[:, None, split:]
    seat, seat_tail = _sprung(stiff, rows.seat), _sprung(stiff, rows.seat_tail)
    flank, flank_tail = (jnp.swapaxes(gear_slope, 0, 1)[:, None] * x for x in (rows.flank, rows.flank_tail))
    centring = jnp.eye(3, dtype=flank.dtype)[:, :, None, None] * s.centring[None, None, None]
    tail = folded(_outer(rows.seat_tail, seat_tail) + _outer(rows.flank_tail, flank_tail), 2)
    support = jnp.eye(layout.tail, dtype=flank.dtype)[:, :, None] * s.support[layout.carried :, None]
    bridge = disc[:, :, :, :, None] * jnp.moveaxis(rows.crank, 1, 3)[:, None]  # (2, 3, d, c, 3, l)
    return Hessian(
        disc=_summed(rows.pins, pin_slope) + arms + jnp.stack([centring[pair] for pair in _PAIRS]),
        disc_crank=bridge[0] + bridge[1],
        crank=folded(_outer(rows.crank, crank), 2) + _outer(rows.seat, seat) + _outer(rows.flank, flank) + centring,
        crank_tail=jnp.moveaxis(_outer(rows.seat, seat_tail) + _outer(rows.flank, flank_tail), 2, 0),
        tail=tail + support,
    )


def _sprung(stiffness: jax.Array, rows: jax.Array) -> jax.Array:
    """Stiffness xx, xy, yy (3, 1, ..., l) times rows (2, w, ..., l)."""
    xx, xy, yy = stiffness
    return jnp.stack([xx * rows[0] + xy * rows[1], xy * rows[0] + yy * rows[1]])


def _outer(left: jax.Array, right: jax.Array) -> jax.Array:
    """Sum over the first axis of left (2, v, ..., l) times right (2, w, ..., l): (v, w, ..., l)."""
    return left[0][:, None] * right[0][None] + left[1][:, None] * right[1][None]


def moved(rows: jax.Array, q: jax.Array) -> jax.Array:
    """rows (..., n, l) times q (n, l): (..., l).

    Args:
        rows: of flanks or bearings.
        q: displacements.
    """
    return folded(rows * q[(None,) * (rows.ndim - 2)], rows.ndim - 2)


def _product(rows: jax.Array, values: jax.Array) -> jax.Array:
    """Sum over m of rows (m, n, l) times values (m, l): (n, l)."""
    return folded(rows * values[:, None], 0)


def _summed(rows: jax.Array, load: jax.Array) -> jax.Array:
    """Sums over the pins of rows (w, d, p, l) times load (d, p, l): (w, d, l)."""
    return folded(rows * load[None], 2)
