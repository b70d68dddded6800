"""Forces, energy and stiffness of all contacts at displacements q: the energy of docs/models/loaded.md, Eq. 21.

Arrays have their lanes (independent cases) last; a leaf of the system that all lanes share has one lane.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded import laws
from rvjax.loaded.elimination import Hessian
from rvjax.loaded.system import Layout, System, directions


class Bearing(NamedTuple):
    """A radial spring with clearance, force and stiffness of its displacement w."""

    force: jax.Array  # (2, ..., l)
    stiffness: tuple[jax.Array, jax.Array, jax.Array]  # xx, xy, yy
    energy: jax.Array


class Contacts(NamedTuple):
    """Every contact at q."""

    depth: jax.Array  # (d, p, l)
    pins: jax.Array  # (d, p, l) N
    gear_depth: jax.Array  # (c, 2, l)
    gear: jax.Array  # (c, 2, l) N
    arm: Bearing  # (.., d, c, l), on the disc with the sign of grad E
    seat: Bearing  # (.., c, l)


def contacts(layout: Layout, s: System, q: jax.Array) -> Contacts:
    """All contacts at the displacements q.

    Args:
        layout: counts and methods.
        s: the system, lanes last.
        q: (n, l).
    """
    depth, gear_depth, arm, seat = displacements(layout, s, q)
    return Contacts(
        depth=depth,
        pins=laws.force(layout.law, depth, s.compliance[None, None], s.level),
        gear_depth=gear_depth,
        gear=s.mesh_stiffness[:, None] * jnp.maximum(gear_depth, 0),
        arm=bearing(arm, s.arm_stiffness, s.arm_clearance[None, None]),
        seat=bearing(seat, s.seat_stiffness, s.seat_clearance[None]),
    )


def parts(layout: Layout, q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, Any, Any]:
    """Displacements of discs (3, d, l), cranks (3, c, l), carrier rotation (l,), carrier and sun (or None)."""
    lanes = q.shape[-1]
    disc = q[: layout.inner].reshape(layout.discs, 3, lanes).transpose(1, 0, 2)
    crank = q[layout.inner : layout.carried].reshape(layout.cranks, 3, lanes).transpose(1, 0, 2)
    row = layout.carried + 1
    carrier = q[row : row + 2] if layout.carrier == "floating" else None
    sun = q[-3:] if layout.sun == "floating" else None
    return disc, crank, q[layout.carried], carrier, sun


def displacements(
    layout: Layout, s: System, q: jax.Array
) -> tuple[jax.Array, jax.Array, tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """Depths of pins (d, p, l) and flanks (c, 2, l), bearing displacements x, y of arms and seats; Eqs. 9-12."""
    disc, crank, turn, carrier, sun = parts(layout, q)
    tangent = jnp.asarray(directions(layout.cranks)[1].T, q.dtype)[:, :, None]  # (2, c, 1)
    depth = s.gap
    for a in range(3):
        depth = depth + s.rows[a] * disc[a][:, None]
    spin = jnp.asarray([1.0, -1.0], q.dtype)[None, :, None]
    gear = s.gear_gap + spin * crank[2][:, None]
    for a in range(2):
        gear = gear - s.flank[:, :, a] * crank[a][:, None]
        if sun is not None:
            gear = gear + s.flank[:, :, a] * sun[a][None, None]
    if sun is not None:
        gear = gear + spin * sun[2][None, None]
    arm, seat = [], []
    for a in range(2):
        turned = disc[a][:, None] + tangent[a][None] * disc[2][:, None]
        carried = crank[a][None] + s.swing[:, a][:, None] * crank[2][None]
        arm.append(s.arm[:, :, a] + turned - carried)
        held = tangent[a] * turn[None]
        seat.append(s.seat[:, a] + crank[a] - (held if carrier is None else held + carrier[a][None]))
    return depth, gear, (arm[0], arm[1]), (seat[0], seat[1])


def bearing(w: tuple[jax.Array, jax.Array], stiffness: jax.Array, clearance: jax.Array) -> Bearing:
    """k (|w| - clearance)+ along w, with its exact stiffness; without clearance k w.

    Args:
        w: x, y.
        stiffness: k.
        clearance: >= 0, of the rank of k.
    """
    x, y = w
    square = x * x + y * y
    held = square >= clearance * clearance
    size = jnp.sqrt(jnp.where(held & (square > 0), square, 1))
    slack = jnp.where(square > 0, clearance, 0) / size  # share of w that is clearance
    cx, cy = x / size, y / size
    k = jnp.where(held, stiffness, 0)
    radial = k * (1 - slack)
    along = k * slack
    return Bearing(
        force=jnp.stack([radial * x, radial * y]),
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
    tangent = jnp.asarray(directions(layout.cranks)[1].T, q.dtype)[:, :, None]
    arm, seat, lanes = at.arm.force, at.seat.force, q.shape[-1]
    pull = tangent[0][None] * arm[0] + tangent[1][None] * arm[1]
    disc = weighted(s.rows, at.pins) + jnp.stack([jnp.sum(x, axis=1) for x in (arm[0], arm[1], pull)])
    push = s.swing[:, 0][:, None] * arm[0] + s.swing[:, 1][:, None] * arm[1]
    crank = jnp.stack(
        [seat[a] - jnp.sum(arm[a], axis=0) - jnp.sum(s.flank[:, :, a] * at.gear, axis=1) for a in range(2)]
        + [at.gear[:, 0] - at.gear[:, 1] - jnp.sum(push, axis=0)]
    )
    tail = [s.load - jnp.sum(tangent[0] * seat[0] + tangent[1] * seat[1], axis=0)]
    row = layout.carried + 1
    if layout.carrier == "floating":
        tail += [s.carrier_support * q[row + a] - jnp.sum(seat[a], axis=0) for a in range(2)]
    if layout.sun == "floating":
        tail += [s.sun_support * q[a - 3] + jnp.sum(s.flank[:, :, a] * at.gear, axis=(0, 1)) for a in range(2)]
        tail += [s.sun_torsion * q[-1] + jnp.sum(at.gear[:, 0] - at.gear[:, 1], axis=0)]
    forces = [disc.transpose(1, 0, 2).reshape(layout.inner, lanes), crank.transpose(1, 0, 2).reshape(-1, lanes)]
    return jnp.concatenate([*forces, jnp.stack([jnp.broadcast_to(x, (lanes,)) for x in tail])]) + s.centring[None] * q


def energy(layout: Layout, s: System, q: jax.Array, at: Contacts) -> jax.Array:
    """Energy (l,) J, Eq. 21."""
    pins = jnp.sum(laws.energy(layout.law, at.depth, at.pins, s.compliance[None, None]), axis=(0, 1))
    springs = jnp.sum(at.arm.energy, axis=(0, 1)) + jnp.sum(at.seat.energy, axis=0)
    gear = jnp.sum(at.gear * at.gear_depth, axis=(0, 1)) / 2
    own = s.centring * jnp.sum(q * q, axis=0) / 2 + s.load * q[layout.carried]
    row = layout.carried + 1
    if layout.carrier == "floating":
        own = own + s.carrier_support * (q[row] ** 2 + q[row + 1] ** 2) / 2
    if layout.sun == "floating":
        own = own + s.sun_support * (q[-3] ** 2 + q[-2] ** 2) / 2 + s.sun_torsion * q[-1] ** 2 / 2
    return pins + springs + gear + own


def weighted(rows: jax.Array, load: jax.Array) -> jax.Array:
    """Sums over the pins of rows (w, d, p, l) times load (d, p, l): (w, d, l).

    Lanes that share their rows make it a product of matrices.
    """
    if rows.shape[-1] == 1 and load.shape[-1] > 1:
        return jnp.stack(
            [jnp.dot(rows[:, k, :, 0], load[k], precision="highest") for k in range(load.shape[0])], axis=1
        )
    return jnp.sum(rows * load[None], axis=2)


def hessian(
    layout: Layout, s: System, q: jax.Array, at: Contacts, pin_slope: Any = None, pressed: Any = None
) -> Hessian:
    """Second derivatives of the energy at q.

    Args:
        layout: counts and methods.
        s: the system, lanes last.
        q: (n, l).
        at: contacts at q.
        pin_slope: (d, p, l), by default that of the law.
        pressed: which flanks (c, 2, l) touch, by default those of positive depth.
    """
    cranks, lanes, tail = layout.cranks, q.shape[-1], layout.tail
    if pin_slope is None:
        pin_slope = laws.slope(layout.law, at.depth, at.pins, s.compliance[None, None])
    pair = [(a, b) for a in range(3) for b in range(a + 1)]
    sums = weighted(jnp.stack([s.rows[a] * s.rows[b] for a, b in pair]), pin_slope)
    tangent = jnp.asarray(directions(cranks)[1].T, q.dtype)[:, :, None]  # (2, c, 1)
    xx, xy, yy = at.arm.stiffness  # (d, c, l)
    tx, ty = tangent[0][None], tangent[1][None]
    sx, sy = s.swing[:, 0][:, None], s.swing[:, 1][:, None]
    vx, vy = xx * tx + xy * ty, xy * tx + yy * ty  # K t
    zx, zy = xx * sx + xy * sy, xy * sx + yy * sy  # K s
    on_disc = [[xx, xy, vx], [xy, yy, vy], [vx, vy, tx * vx + ty * vy]]
    between = [[xx, xy, zx], [xy, yy, zy], [vx, vy, tx * zx + ty * zy]]
    on_crank = [[xx, xy, zx], [xy, yy, zy], [zx, zy, sx * zx + sy * zy]]
    centring = jnp.broadcast_to(s.centring, (lanes,))
    disc = jnp.stack(
        [
            jnp.stack(
                [
                    sums[pair.index((max(a, b), min(a, b)))]
                    + jnp.sum(on_disc[a][b], axis=1)
                    + (centring[None] if a == b else 0)
                    for b in range(3)
                ]
            )
            for a in range(3)
        ]
    )
    disc_crank = -jnp.stack([jnp.stack(row, axis=2) for row in between])  # (3, d, c, 3, l)

    # Gears: rows (-flank_x, -flank_y, +-1) on the crank, (flank_x, flank_y, +-1) on the sun.
    pressed = at.gear_depth > 0 if pressed is None else pressed
    stiff = jnp.where(pressed, s.mesh_stiffness[:, None], 0)  # (c, 2, l)
    spin = jnp.broadcast_to(jnp.asarray([1.0, -1.0], q.dtype)[None, :, None], stiff.shape)
    normal = [jnp.broadcast_to(s.flank[:, :, a], stiff.shape) for a in range(2)]
    crank_row, sun_row = [-normal[0], -normal[1], spin], [normal[0], normal[1], spin]

    def gears(left: list[jax.Array], right: list[jax.Array], a: int, b: int) -> jax.Array:
        return jnp.sum(stiff * left[a] * right[b], axis=1)  # (c, l)

    kxx, kxy, kyy = at.seat.stiffness
    zero = jnp.zeros_like(kxx)
    held = [[kxx, kxy, zero], [kxy, kyy, zero], [zero, zero, zero]]
    crank = jnp.stack(
        [
            jnp.stack(
                [
                    jnp.sum(on_crank[a][b], axis=0)
                    + held[a][b]
                    + gears(crank_row, crank_row, a, b)
                    + (centring[None] if a == b else 0)
                    for b in range(3)
                ]
            )
            for a in range(3)
        ]
    )
    ux, uy = kxx * tangent[0] + kxy * tangent[1], kxy * tangent[0] + kyy * tangent[1]  # (c, l)
    columns = [[-ux, -uy, zero]]
    square = {(0, 0): jnp.sum(tangent[0] * ux + tangent[1] * uy, axis=0) + centring}
    if layout.carrier == "floating":
        columns += [[-kxx, -kxy, zero], [-kxy, -kyy, zero]]
        square |= {(1, 0): jnp.sum(ux, axis=0), (2, 0): jnp.sum(uy, axis=0), (2, 1): jnp.sum(kxy, axis=0)}
        square |= {(a + 1, a + 1): jnp.sum(k, axis=0) + s.carrier_support + centring for a, k in enumerate((kxx, kyy))}
    if layout.sun == "floating":
        first = tail - 3
        columns += [[gears(crank_row, sun_row, a, b) for a in range(3)] for b in range(3)]
        own = (s.sun_support, s.sun_support, s.sun_torsion)
        for a in range(3):
            for b in range(a + 1):
                value = jnp.sum(gears(sun_row, sun_row, a, b), axis=0)
                square[first + a, first + b] = value + own[a] + centring if a == b else value
    nothing = jnp.zeros((lanes,), q.dtype)
    crank_tail = jnp.stack([jnp.stack(column, axis=1) for column in columns], axis=2)  # (c, 3, t, l)
    corner = jnp.stack(
        [jnp.stack([square.get((max(a, b), min(a, b)), nothing) for b in range(tail)]) for a in range(tail)]
    )
    return Hessian(disc, disc_crank, crank, crank_tail, corner)
