"""Forces, energy and stiffness of all contacts at displacements q: the energy of docs/models/loaded.md, Eq. 21.

Arrays have their lanes (independent cases) last; a leaf of the system that all lanes share has one lane.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded import laws
from rvjax.loaded.elimination import Hessian
from rvjax.loaded.system import Layout, System


class Bearing(NamedTuple):
    """Radial springs with clearance, force and stiffness of their displacements."""

    force: jax.Array  # (b, 2, l), sign of grad E
    stiffness: tuple[jax.Array, jax.Array, jax.Array]  # xx, xy, yy, (b, l)
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
        s: the system, lanes last.
        q: (n, l).
    """
    discs = q[: 3 * layout.discs].reshape(layout.discs, 3, 1, -1)
    depth = s.gap + sum(s.rows[a] * discs[:, a] for a in range(3))
    gear_depth = s.gear_gap + moved(s.gear_rows, q)
    return Contacts(
        depth=depth,
        pins=laws.force(layout.law, depth, s.compliance[None, None], s.level),
        gear_depth=gear_depth,
        gear=s.gear_stiffness[:, None] * jnp.maximum(gear_depth, 0),
        bearing=bearing(s.bearing_gap + moved(s.bearing_rows, q), s.bearing_stiffness, s.clearance),
    )


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
    size = jnp.sqrt(jnp.where(held & (square > 0), square, 1))
    slack = jnp.where(square > 0, clearance, 0) / size  # share of w that is clearance
    cx, cy = x / size, y / size
    k = jnp.where(held, stiffness, 0)
    radial = k * (1 - slack)
    along = k * slack
    return Bearing(
        force=radial[:, None] * w,
        stiffness=(radial + along * cx * cx, along * cx * cy, radial + along * cy * cy),
        energy=k * (1 - slack) * (1 - slack) * square / 2,
    )


def gradient(layout: Layout, s: System, q: jax.Array, at: Contacts | None = None) -> jax.Array:
    """Gradient of the energy, (n, l) N; zero at the equilibrium (Eq. 22).

    Args:
        layout: counts and methods.
        s: the system, lanes last.
        q: (n, l).
        at: its contacts, where they are known.
    """
    at = contacts(layout, s, q) if at is None else at
    own = (s.support * q).at[layout.carried].add(s.load)
    own = own.at[: 3 * layout.discs].add(_summed(s.rows, at.pins).swapaxes(0, 1).reshape(3 * layout.discs, -1))
    for rows, force in ((s.gear_rows, at.gear), (s.bearing_rows, at.bearing.force)):
        own = own + _product(rows.reshape(-1, *rows.shape[2:]), force.reshape(-1, q.shape[-1]))
    return own


def energy(layout: Layout, s: System, q: jax.Array, at: Contacts) -> jax.Array:
    """Energy (l,) J, Eq. 21."""
    pins = jnp.sum(laws.energy(layout.law, at.depth, at.pins, s.compliance[None, None]), axis=(0, 1))
    gear = jnp.sum(at.gear * at.gear_depth, axis=(0, 1)) / 2
    own = jnp.sum(s.support * q * q, axis=0) / 2 + s.load * q[layout.carried]
    return pins + jnp.sum(at.bearing.energy, axis=0) + gear + own


def hessian(layout: Layout, s: System, at: Contacts, pin_slope: Any = None, gear_slope: Any = None) -> Hessian:
    """Second derivatives of the energy, in the blocks of the elimination.

    Args:
        layout: counts and methods.
        s: the system, lanes last.
        at: contacts at q.
        pin_slope: (d, p, l), by default that of the law.
        gear_slope: (c, 2, l), by default the stiffness of the flanks of positive depth.
    """
    discs, cranks, lanes = layout.discs, layout.cranks, at.depth.shape[-1]
    if pin_slope is None:
        pin_slope = laws.slope(layout.law, at.depth, at.pins, s.compliance[None, None])
    if gear_slope is None:
        gear_slope = jnp.where(at.gear_depth > 0, s.gear_stiffness[:, None], 0)
    split = discs * cranks
    # Rows of an arm on its disc and on its crank, (2, 3, d, c, .), and the same times its stiffness.
    arms = s.bearing_rows[:split].reshape(discs, cranks, 2, layout.unknowns, -1)
    on_disc = jnp.stack([arms[k, :, :, 3 * k : 3 * k + 3] for k in range(discs)])
    on_crank = jnp.stack([arms[:, i, :, layout.crank(i) : layout.crank(i) + 3] for i in range(cranks)], axis=1)
    on_disc, on_crank = (jnp.moveaxis(x, (2, 3), (0, 1)) for x in (on_disc, on_crank))
    stiff = [k[:split].reshape(1, discs, cranks, lanes) for k in at.bearing.stiffness]
    sprung_disc, sprung_crank = _sprung(stiff, on_disc), _sprung(stiff, on_crank)
    pair = [(a, b) for a in range(3) for b in range(a + 1)]
    sums = _summed(jnp.stack([s.rows[a] * s.rows[b] for a, b in pair]), pin_slope)
    centring = jnp.eye(3, dtype=sums.dtype)[:, :, None, None] * s.centring[None, None, None]
    full = jnp.stack([jnp.stack([sums[pair.index((max(a, b), min(a, b)))] for b in range(3)]) for a in range(3)])
    # Rows of seat and flanks on their crank, (2, 3, c, .), and on carrier and sun, (2, t, c, .).
    held = []
    seats, seat_stiffness = s.bearing_rows[split:], [k[None, split:] for k in at.bearing.stiffness]
    for rows in (seats, s.gear_rows):
        own = jnp.stack([rows[i, :, layout.crank(i) : layout.crank(i) + 3] for i in range(cranks)])
        held.append([jnp.moveaxis(x, 0, 2) for x in (own, rows[:, :, layout.carried :])])
    (seat, seat_tail), (flank, flank_tail) = held
    sprung_seat, sprung_flank = (
        [_sprung(seat_stiffness, x) for x in (seat, seat_tail)],
        [jnp.swapaxes(gear_slope, 0, 1)[:, None] * x for x in (flank, flank_tail)],
    )
    tail = jnp.sum(_outer(seat_tail, sprung_seat[1]) + _outer(flank_tail, sprung_flank[1]), axis=2)
    corner = jnp.arange(layout.tail)
    return Hessian(
        disc=full + jnp.sum(_outer(on_disc, sprung_disc), axis=3) + centring,
        disc_crank=jnp.moveaxis(_outer(sprung_disc, on_crank), 1, 3),
        crank=jnp.sum(_outer(on_crank, sprung_crank), axis=2)
        + _outer(seat, sprung_seat[0])
        + _outer(flank, sprung_flank[0])
        + centring,
        crank_tail=jnp.moveaxis(_outer(seat, sprung_seat[1]) + _outer(flank, sprung_flank[1]), 2, 0),
        tail=tail.at[corner, corner].add(s.support[layout.carried :]),
    )


def _sprung(stiffness: list[jax.Array], rows: jax.Array) -> jax.Array:
    """Stiffness xx, xy, yy (1, ..., l) times rows (2, w, ..., l)."""
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
    if _shared(rows, q):
        return jnp.tensordot(rows[..., 0], q, 1, precision="highest")
    return jnp.sum(rows * q[(None,) * (rows.ndim - 2)], axis=-2)


def _product(rows: jax.Array, values: jax.Array) -> jax.Array:
    """Sum over m of rows (m, n, l) times values (m, ..., l): (n, ..., l)."""
    if _shared(rows, values):
        return jnp.tensordot(rows[..., 0], values, (0, 0), precision="highest")
    middle = (1,) * (values.ndim - 2)
    return jnp.sum(rows.reshape(*rows.shape[:2], *middle, rows.shape[-1]) * values[:, None], axis=0)


def _summed(rows: jax.Array, load: jax.Array) -> jax.Array:
    """Sums over the pins of rows (w, d, p, l) times load (d, p, l): (w, d, l)."""
    if _shared(rows, load):
        parts = [jnp.dot(rows[:, k, :, 0], load[k], precision="highest") for k in range(load.shape[0])]
        return jnp.stack(parts, axis=1)
    return jnp.sum(rows * load[None], axis=2)


def _shared(rows: jax.Array, values: jax.Array) -> bool:
    """Whether many lanes share their rows: a sum is a product of matrices then."""
    return rows.shape[-1] == 1 and values.shape[-1] > 1
