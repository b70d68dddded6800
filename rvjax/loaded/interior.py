"""Near the minimum of the energy from anywhere: a primal-dual interior point method, for cases that Newton leaves.

Newton's method loses its way where a journal slides round its clearance and barely touches: a full step leaves the
circle by the second order, and contacts open and close in turns. Here no contact opens or closes. Each is a spring,
compressed by s, that keeps a gap z > 0 to its counterpart and has a separate force f > 0. All products f z = mu
fall together, and with them the forces become those of the contacts:

    pin, joint    z = s - depth(q) > 0,  f > 0
    bearing       Z = (clearance + s, w(q)) in the cone |Z_xy| < Z_0, its force F in the same cone

The step of the cones is that of Nesterov and Todd (Mathematics of Operations Research 22, 1997, 1-42): in Newton's
linear system each contact is a spring of finite stiffness. Arrays have the batch axis last.
"""

import functools
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded.hessian import frame, hessian, solve
from rvjax.loaded.system import (
    Contacts,
    Held,
    Layout,
    Pressed,
    System,
    depths,
    displaced,
    gradient,
    pressed_joints,
    pressed_pins,
    typical_joint_slopes,
)

STEPS = 60  # at most; hard cases take 15 to 35
_CLOSED = 5e4  # times the rounding: mu over its first value where the rest is left to Newton's method
_SHARE = 0.99  # of the way to the boundary of the cones

_Vector = tuple[jax.Array, jax.Array, jax.Array]  # of a cone: along its axis, x, y, (b, l)


class _Spring(NamedTuple):
    """Pins (d, p, l) or joints (j, l)."""

    s: jax.Array  # compression
    f: jax.Array  # force


class _Point(NamedTuple):
    q: jax.Array  # (n, l)
    pins: _Spring
    joints: _Spring
    reach: jax.Array  # (b, l) Z_0 of a bearing
    force: _Vector  # F of a bearing


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
    bearings = layout.contacts(layout.bearings)
    free = jnp.broadcast_to(s.bearings.clearance > 0, (bearings, lanes))  # without clearance it is a linear spring
    eps = float(jnp.finfo(s.pins.gap.dtype).eps)
    unilateral = layout.discs * layout.pins + layout.contacts(layout.joints)
    products = unilateral + jnp.sum(free, axis=0, dtype=s.pins.gap.dtype)
    at_rest = frame(layout, s)

    def body(loop: _Loop) -> _Loop:
        at = loop.at
        pins, (joints, w) = depths(layout, s, at.q), displaced(s, at.q)
        reach = (at.reach, w[:, 0], w[:, 1])
        inside = functools.reduce(operator.add, (a * b for a, b in zip(reach, at.force)))
        total = _sum(at.pins.f * (at.pins.s - pins)) + _sum(at.joints.f * (at.joints.s - joints))
        mu = (total + _sum(jnp.where(free, inside, 0))) / products
        first = jnp.where(loop.steps == 0, mu, loop.first)
        going = loop.open & (mu > _CLOSED * eps * first) & (loop.steps < STEPS)
        goal = mu * jnp.where(loop.share > 0.9, 0.1, jnp.where(loop.share > 0.5, 0.3, 0.5))

        of_pins, of_joints = pressed_pins(layout, s, at.pins.s), pressed_joints(layout, s, at.joints.s)
        cone = _cone(s, free, goal, reach, at.force, inside)
        closing = Contacts(
            _closing(at.pins, pins, of_pins, goal), _closing(at.joints, joints, of_joints, goal), cone.held
        )
        g = gradient(layout, s, at.q, closing)
        g, square = jax.lax.optimization_barrier((g, hessian(layout, s, closing, at_rest)))
        dq = jax.lax.optimization_barrier(-solve(layout, square, g))

        dpins, (djoints, dw) = depths(layout, s, dq, gaps=False), displaced(s, dq, gaps=False)
        step = _Point(
            dq,
            _change(at.pins, closing.pins, of_pins, dpins),
            _change(at.joints, closing.joints, of_joints, djoints),
            *_cone_change(s, at, cone, dw),
        )
        most = [*_room(at.pins, pins, step.pins, dpins), *_room(at.joints, joints, step.joints, djoints)]
        for vector, change in ((reach, (step.reach, dw[:, 0], dw[:, 1])), (at.force, step.force)):
            most.append(jnp.min(jnp.where(free, _leaves(vector, change), jnp.inf), axis=0))
        share = jnp.minimum(1, _SHARE * jnp.min(jnp.stack(most), axis=0))
        moved = jax.tree.map(
            lambda old, change: jnp.where(_like(going, old), old + _like(share, old) * change, old), at, step
        )
        return _Loop(moved, share, first, loop.steps + going.astype(jnp.int32), going)

    zero = jnp.zeros((lanes,), s.pins.gap.dtype)
    loop = _Loop(_begin(layout, s, lanes), zero, zero, jnp.zeros((lanes,), jnp.int32), wanted)
    end = jax.lax.while_loop(lambda loop: jnp.any(loop.open), body, loop)
    return end.at.q, end.steps


def _begin(layout: Layout, s: System, lanes: int) -> _Point:
    """At q = 0 with every gap as wide as the widest of the case."""
    q = jnp.zeros((layout.unknowns, lanes), s.pins.gap.dtype)
    pins, (joints, w) = depths(layout, s, q), displaced(s, q)
    stiffest = jnp.maximum(jnp.max(s.bearings.stiffness, axis=0), jnp.max(typical_joint_slopes(layout, s), axis=0))
    wide = jnp.abs(s.load) / stiffest
    for gap in (pins, joints, w, s.bearings.clearance):
        wide = jnp.maximum(wide, jnp.max(jnp.abs(gap), axis=tuple(range(gap.ndim - 1))))
    reach = jnp.maximum(jnp.sqrt(w[:, 0] * w[:, 0] + w[:, 1] * w[:, 1]), s.bearings.clearance) + wide[None]
    axial = s.bearings.stiffness * (reach - s.bearings.clearance)
    pins, joints = (jnp.maximum(depth, 0) + _like(wide, depth) for depth in (pins, joints))
    of_pins, of_joints = pressed_pins(layout, s, pins).force, pressed_joints(layout, s, joints).force
    force = (axial, jnp.zeros_like(axial), jnp.zeros_like(axial))
    return _Point(q, _Spring(pins, of_pins), _Spring(joints, of_joints), reach, force)


def _closing(spring: _Spring, depth: jax.Array, law: Pressed, goal: jax.Array) -> Pressed:
    """The force that closes f z = goal along the contact law, and its slope in the depth."""
    room = spring.s - depth + spring.f / law.slope
    return Pressed(depth, (_like(goal, depth) + spring.f * law.force / law.slope) / room, spring.f / room)


def _change(spring: _Spring, closing: Pressed, law: Pressed, depth: jax.Array) -> _Spring:
    """Step of pins or joints whose depths change by `depth`."""
    change = closing.force + closing.slope * depth - spring.f
    return _Spring((change + spring.f - law.force) / law.slope, change)


def _room(spring: _Spring, depth: jax.Array, step: _Spring, change: jax.Array) -> list[jax.Array]:
    """Shares of a step at which a force, a gap or a compression vanishes."""
    z = spring.s - depth
    return [_until(spring.f, step.f), _until(z, step.s - change), _until(spring.s, step.s)]


class _Cone(NamedTuple):
    """Bearings in Newton's linear system, and what their step along Z_0 follows from."""

    held: Held
    v: _Vector
    push: jax.Array
    across: jax.Array  # of the first row, times v_x and v_y
    axial: jax.Array


def _cone(s: System, free: jax.Array, goal: jax.Array, z: _Vector, f: _Vector, inside: jax.Array) -> _Cone:
    """The scaling of the two cones, eta (2 v v' - J), with v = (v0, -vx, -vy) and the goal over Z."""
    k = s.bearings.stiffness
    det, det_f = _det(*z), _det(*f)
    root, root_f = jnp.sqrt(det), jnp.sqrt(det_f)
    mean = jnp.sqrt(2 + 2 * inside / (root * root_f))
    v0, vx, vy = ((a / root + sign * b / root_f) / mean for a, b, sign in zip(z, f, (1, -1, -1)))
    eta = root_f / root
    axial = k + eta * (2 * v0 * v0 - 1)
    push = (goal[None] * z[0] / det - k * (z[0] - s.bearings.clearance)) / axial
    along = 2 * eta * (k - eta) / axial
    across = -2 * eta * v0
    force = [jnp.where(free, goal[None] / det * u + across * v * push, k * u) for u, v in ((z[1], vx), (z[2], vy))]
    stiffness = [
        jnp.where(free, one + along * product, alone)
        for one, product, alone in ((eta, vx * vx, k), (0.0, vx * vy, 0.0), (eta, vy * vy, k))
    ]
    held = Held(jnp.stack(force, axis=1), jnp.stack(stiffness), jnp.zeros_like(eta))
    return _Cone(held, (v0, vx, vy), push, across, axial)


def _cone_change(s: System, at: _Point, cone: _Cone, dw: jax.Array) -> tuple[jax.Array, _Vector]:
    """Steps of Z_0 and F for a step dw (b, 2, l) of the displacements."""
    (dx, dy), (_, vx, vy), (xx, xy, yy) = (dw[:, 0], dw[:, 1]), cone.v, cone.held.stiffness
    reach = cone.push - cone.across * (vx * dx + vy * dy) / cone.axial
    f0, fx, fy = at.force
    return reach, (
        s.bearings.stiffness * (at.reach + reach - s.bearings.clearance) - f0,
        -(cone.held.force[:, 0] + xx * dx + xy * dy) - fx,
        -(cone.held.force[:, 1] + xy * dx + yy * dy) - fy,
    )


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
    share = jnp.where(change < 0, value / jnp.where(change < 0, -change, 1), jnp.inf)
    return jnp.min(share, axis=tuple(range(share.ndim - 1)))


def _like(lanes: jax.Array, value: jax.Array) -> jax.Array:
    """A number of each batch element (l,), shaped to broadcast with a value (..., l)."""
    return lanes.reshape((1,) * (value.ndim - 1) + lanes.shape)


def _sum(value: jax.Array) -> jax.Array:
    return jnp.sum(value, axis=tuple(range(value.ndim - 1)))
