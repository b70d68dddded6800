"""Near the minimum of the energy from anywhere: a primal-dual interior point method, for cases that Newton leaves.

Newton's method loses its way where a journal slides round its clearance and barely touches: a full step leaves the
circle by the second order, and contacts open and close in turns. Here no contact opens or closes. Each is a spring,
compressed by s, that keeps a gap z > 0 to its counterpart and has a separate force f > 0. All products f z = mu
fall together, and with them the forces become those of the contacts:

    pin, flank    z = s - depth(q) > 0,  f > 0
    journal       Z = (clearance + s, w(q)) in the cone |Z_xy| < Z_0, its force F in the same cone

The step of the cones is that of Nesterov and Todd (Mathematics of Operations Research 22, 1997, 1-42): in Newton's
linear system each contact is a spring of finite stiffness. Arrays have the batch axis last.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded import laws
from rvjax.loaded.contacts import Bearing, Contacts, gradient, hessian, moved
from rvjax.loaded.elimination import solve
from rvjax.loaded.system import Layout, System

STEPS = 60  # at most; hard cases take 15 to 35
_CLOSED = 5e4  # times the rounding: mu over its first value where the rest is left to Newton's method
_SHARE = 0.99  # of the way to the boundary of the cones


class _Point(NamedTuple):
    q: jax.Array  # (n, l)
    s: jax.Array  # (d, p, l) compression of a pin's spring
    f: jax.Array  # (d, p, l) its force
    gear: jax.Array  # (c, 2, l) the same of a flank
    gear_f: jax.Array
    reach: jax.Array  # (b, l) Z_0 of a journal
    cone: tuple[jax.Array, jax.Array, jax.Array]  # F_0, F_x, F_y, (b, l)


class _Loop(NamedTuple):
    at: _Point
    share: jax.Array  # (l,) of the last step
    first: jax.Array  # (l,) mu at the start
    steps: jax.Array  # (l,)
    open: jax.Array  # (l,)


@functools.partial(jax.jit, static_argnums=0)  # traced once, for shapes and values
def approach(layout: Layout, s: System, wanted: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Displacements (n, l) near the minimum, not finite where there are none, and the steps it took (l,).

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        wanted: (l,) elements to solve; others stay at zero.
    """
    lanes = wanted.shape[0]
    free = jnp.broadcast_to(s.clearance > 0, (layout.bearings, lanes))  # without clearance a journal is a linear spring
    k, eps = s.bearing_stiffness, float(jnp.finfo(s.gap.dtype).eps)
    contacts_free = s.gap.shape[0] * s.gap.shape[1] + 2 * layout.cranks + jnp.sum(free, axis=0, dtype=s.gap.dtype)

    def body(loop: _Loop) -> _Loop:
        at = loop.at
        depth, gear_depth, w = _moved(layout, s, at.q)
        x, y = w[:, 0], w[:, 1]
        z, gear_z = at.s - depth, at.gear - gear_depth
        law = laws.force(layout.law, at.s, s.compliance[None], s.level)
        slope = laws.slope(layout.law, at.s, law, s.compliance[None])
        f0, fx, fy = at.cone
        inside = at.reach * f0 + x * fx + y * fy
        total = _sum(at.f * z) + _sum(at.gear_f * gear_z) + _sum(jnp.where(free, inside, 0))
        mu = total / contacts_free
        first = jnp.where(loop.steps == 0, mu, loop.first)
        going = loop.open & (mu > _CLOSED * eps * first) & (loop.steps < STEPS)
        goal = mu * jnp.where(loop.share > 0.9, 0.1, jnp.where(loop.share > 0.5, 0.3, 0.5))

        # Pins and flanks: the force that closes f z = goal along the contact law, and its slope in the depth.
        room = z + at.f / slope
        pins, pin_slope = (goal[None, None] + at.f * law / slope) / room, at.f / room
        room = gear_z + at.gear_f / s.gear_stiffness[:, None]
        gear, gear_slope = (goal[None, None] + at.gear_f * at.gear) / room, at.gear_f / room
        # Journals: the scaling of the two cones, eta (2 v v' - J), with v = (v0, -vx, -vy) and the goal over Z.
        det, det_f = _det(at.reach, x, y), _det(f0, fx, fy)
        root, root_f = jnp.sqrt(det), jnp.sqrt(det_f)
        mean = jnp.sqrt(2 + 2 * inside / (root * root_f))
        v0, vx, vy = ((a / root + b / root_f) / mean for a, b in ((at.reach, f0), (x, -fx), (y, -fy)))
        eta = root_f / root
        axial = k + eta * (2 * v0 * v0 - 1)
        push = (goal[None] * at.reach / det - k * (at.reach - s.clearance)) / axial
        along = 2 * eta * (k - eta) / axial
        across = -2 * eta * v0  # of the first row, times vx and vy
        own = [jnp.where(free, goal[None] / det * u + across * v * push, k * u) for u, v in ((x, vx), (y, vy))]
        stiff = [
            jnp.where(free, one + along * product, alone)
            for one, product, alone in ((eta, vx * vx, k), (0.0, vx * vy, 0.0), (eta, vy * vy, k))
        ]
        bearing = Bearing(jnp.stack(own, axis=1), jnp.stack(stiff), jnp.zeros_like(x))
        forces = Contacts(depth, pins, gear_depth, gear, bearing)
        g, square = jax.lax.optimization_barrier(
            (gradient(layout, s, at.q, forces), hessian(layout, s, forces, pin_slope, gear_slope))
        )
        dq = jax.lax.optimization_barrier(-solve(layout, square, g))

        ddepth, dgear_depth, dw = _moved(layout, s, dq, gaps=False)
        dx, dy = dw[:, 0], dw[:, 1]
        df = pins + pin_slope * ddepth - at.f
        ds = (df + at.f - law) / slope
        dgear_f = gear + gear_slope * dgear_depth - at.gear_f
        dgear = (dgear_f + at.gear_f) / s.gear_stiffness[:, None] - at.gear
        dreach = push - across * (vx * dx + vy * dy) / axial
        dcone = (
            k * (at.reach + dreach - s.clearance) - f0,
            -(own[0] + stiff[0] * dx + stiff[1] * dy) - fx,
            -(own[1] + stiff[1] * dx + stiff[2] * dy) - fy,
        )
        most = [_until(at.f, df), _until(z, ds - ddepth), _until(at.s, ds)]
        most += [_until(at.gear_f, dgear_f), _until(gear_z, dgear - dgear_depth)]
        most += [
            jnp.min(jnp.where(free, _leaves(a, b), jnp.inf), axis=0)
            for a, b in (((at.reach, x, y), (dreach, dx, dy)), (at.cone, dcone))
        ]
        if layout.law == "hertz":
            most.append(_until(laws.largest_depth(s.compliance[None], s.level) - at.s, -ds))
        share = jnp.minimum(1, _SHARE * jnp.min(jnp.stack(most), axis=0))
        step = _Point(dq, ds, df, dgear, dgear_f, dreach, dcone)
        moved_to = jax.tree.map(
            lambda old, change: jnp.where(_like(going, old), old + _like(share, old) * change, old), at, step
        )
        return _Loop(moved_to, share, first, loop.steps + going.astype(jnp.int32), going)

    zero = jnp.zeros((lanes,), s.gap.dtype)
    loop = _Loop(_begin(layout, s, lanes), zero, zero, jnp.zeros((lanes,), jnp.int32), wanted)
    found = jax.lax.while_loop(lambda loop: jnp.any(loop.open), body, loop)
    return found.at.q, found.steps


def _begin(layout: Layout, s: System, lanes: int) -> _Point:
    """At q = 0 with every gap as wide as the widest of the case."""
    q = jnp.zeros((layout.unknowns, lanes), s.gap.dtype)
    depth, gear_depth, w = _moved(layout, s, q)
    stiffest = jnp.maximum(jnp.max(s.bearing_stiffness, axis=0), jnp.max(s.gear_stiffness, axis=0))
    wide = jnp.max(jnp.abs(depth), axis=(0, 1))
    for other in (jnp.max(jnp.abs(gear_depth), axis=(0, 1)), jnp.max(jnp.abs(w), axis=(0, 1))):
        wide = jnp.maximum(wide, other)
    wide = jnp.maximum(jnp.maximum(wide, jnp.max(s.clearance, axis=0)), jnp.abs(s.load) / stiffest)
    if layout.law == "hertz":
        wide = jnp.minimum(wide, jnp.min(laws.largest_depth(s.compliance[None], s.level), axis=(0, 1)) / 4)
    pin = jnp.maximum(depth, 0) + wide[None, None]
    gear = jnp.maximum(gear_depth, 0) + wide[None, None]
    reach = jnp.maximum(jnp.sqrt(w[:, 0] * w[:, 0] + w[:, 1] * w[:, 1]), s.clearance) + wide[None]
    force = s.bearing_stiffness * (reach - s.clearance)
    return _Point(
        q=q,
        s=pin,
        f=laws.force(layout.law, pin, s.compliance[None], s.level),
        gear=gear,
        gear_f=s.gear_stiffness[:, None] * gear,
        reach=reach,
        cone=(force, jnp.zeros_like(force), jnp.zeros_like(force)),
    )


def _moved(layout: Layout, s: System, q: jax.Array, gaps: bool = True) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Depths of pins and flanks and displacements of journals at q, or their changes."""
    discs = q[: 3 * layout.discs].reshape(layout.discs, 3, 1, -1)
    depth = sum(s.rows[a] * discs[:, a] for a in range(3))
    parts = (depth, moved(s.gear_rows, q), moved(s.bearing_rows, q))
    return tuple(a + b for a, b in zip(parts, (s.gap, s.gear_gap, s.bearing_gap))) if gaps else parts


def _det(z0: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """Determinant of a vector in the cone, > 0."""
    size = jnp.sqrt(x * x + y * y)
    return (z0 - size) * (z0 + size)


def _leaves(z: tuple[jax.Array, ...], dz: tuple[jax.Array, ...]) -> jax.Array:
    """Share of a step dz at which z leaves its cone: the least positive root of a t^2 + 2 b t + c."""
    a = dz[0] * dz[0] - dz[1] * dz[1] - dz[2] * dz[2]
    b = z[0] * dz[0] - z[1] * dz[1] - z[2] * dz[2]
    c = _det(*z)
    square = b * b - a * c
    root = c / (jnp.sqrt(jnp.maximum(square, 0)) - b)
    return jnp.where((square >= 0) & (root > 0), root, jnp.inf)


def _until(value: jax.Array, change: jax.Array) -> jax.Array:
    """Share of a change at which the first of some positive values vanishes, (l,)."""
    return jnp.min(jnp.where(change < 0, value / jnp.where(change < 0, -change, 1), jnp.inf), axis=(0, 1))


def _like(lanes: jax.Array, value: jax.Array) -> jax.Array:
    """A number of each batch element (l,), shaped to broadcast with a value (..., l)."""
    return lanes.reshape((1,) * (value.ndim - 1) + lanes.shape)


def _sum(value: jax.Array) -> jax.Array:
    return jnp.sum(value, axis=tuple(range(value.ndim - 1)))
