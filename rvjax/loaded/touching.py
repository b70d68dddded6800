"""The start of a single-stage drive, and the length of its steps.

One to three pins of a drive carry. A linear start closes half of all, and Newton's method opens them again in turns;
where a disc then touches nothing, its step ends at the centring springs. Here every disc starts where the first of its
pins and holes touch, on the side of its bearing that these press, and a step ends where the first contact that it
closes carries the load alone. Arrays have the batch axis last.
"""

import functools

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import folded, stored
from rvjax.loaded import laws
from rvjax.loaded.system import Contacts, Layout, System, depths, displaced, groups


def touching(layout: Layout, s: System) -> jax.Array:
    """Displacements (n, l): every disc touches a pin, and one of them a hole, as deep as the share of the load presses.

    Args:
        layout: of a drive: its joints are the holes of the discs.
        s: the system.
    """
    discs, sign, share = layout.discs, jnp.sign(s.load)[None], (jnp.abs(s.load) / layout.discs)[None]  # (1, l)
    rows = s.joints.rows.reshape(discs, -1, *s.joints.rows.shape[1:])
    own = jnp.stack([rows[k, :, 3 * k : 3 * k + 3] for k in range(discs)])  # (d, h, 3, l)
    pins, holes = s.pins.rows.swapaxes(0, 1), own.swapaxes(1, 2)  # (d, 3, contacts, l)
    lever, carrier = pins[:, 2], rows[:, :, layout.carried]
    (law, _, compliance, level), *_ = groups(layout, s)
    pin_gap = s.pins.gap - laws.depth(layout.law, share[None], s.pins.compliance[None], s.pins.level)
    hole_gap = (s.joints.gap - laws.depth(law, share, compliance, level)).reshape(discs, carrier.shape[1], -1)

    def first(depth: jax.Array, arm: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Rotation of each disc (d, l) that takes its deepest contact of this load to zero, and a mark of that one."""
        rotations = jnp.where(arm * sign[None] < 0, depth / jnp.abs(arm), -jnp.inf)
        most = folded(rotations.swapaxes(0, 1), 0, by=jnp.maximum)
        return sign * most, (rotations == most[:, None]).astype(depth.dtype)

    def moved(contacts: jax.Array, *by: jax.Array) -> jax.Array:
        """Changes of the depths (d, contacts, l) by x, y and, if it is there, the rotation of the discs."""
        return sum(contacts[:, a] * change[:, None] for a, change in enumerate(by))  # type: ignore[return-value]

    def marked(mark: jax.Array, values: jax.Array) -> jax.Array:
        return folded((mark * values).swapaxes(0, 1), 0)

    def centres(pin: jax.Array, hole: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Displacements of the discs: moments give the forces of pin and hole, and the bearing balances both."""
        on_hole = share / marked(hole, jnp.abs(carrier))
        on_pin = on_hole * marked(hole, jnp.abs(holes[:, 2])) / marked(pin, jnp.abs(lever))
        x, y = (-on_hole * marked(hole, holes[:, a]) - on_pin * marked(pin, pins[:, a]) for a in range(2))
        size, bearings = jnp.sqrt(x * x + y * y), slice(0, discs)
        clearance, stiffness = s.bearings.clearance[bearings], s.bearings.stiffness[bearings]
        far = (clearance + size / stiffness) / jnp.where(size > 0, size, 1)
        return far * x - s.bearings.gap[bearings, 0], far * y - s.bearings.gap[bearings, 1]

    rotation, pin = stored(first, pin_gap, lever)
    _, hole = stored(first, hole_gap + holes[:, 2] * rotation[:, None], carrier)
    x, y = stored(centres, pin, hole)
    rotation, _ = stored(lambda x, y: first(pin_gap + moved(pins, x, y), lever), x, y)
    turns, _ = first(hole_gap + moved(holes, x, y, rotation), carrier)
    output = sign * folded(sign * turns, 0, by=jnp.maximum)[None]
    bodies = jnp.stack([x, y, rotation], axis=1).reshape(layout.inner, -1)
    at_rest = jnp.zeros((layout.unknowns - layout.inner - 1, bodies.shape[-1]), bodies.dtype)
    q = jnp.concatenate([bodies, output, at_rest])
    return jnp.where(jnp.isfinite(q) & (sign != 0), q, 0)


def shortened(layout: Layout, s: System, q: jax.Array, at: Contacts, size: jax.Array, step: jax.Array) -> jax.Array:
    """The step (n, l), ended where a contact that it closes would carry the load, or the largest force of now, alone.

    Args:
        layout: counts and methods.
        s: the system.
        q: the point (n, l).
        at: its contacts.
        size: their largest force (l,) N.
        step: from the point (n, l).
    """
    force = jnp.maximum(size, jnp.abs(s.load))
    moved, (turned, dw) = depths(layout, s, step, False), displaced(s, step, False)
    deep = laws.depth(layout.law, force[None, None], s.pins.compliance[None], s.pins.level)
    excess = [folded(_excess(at.pins.depth, moved, deep), 0, 1, by=jnp.maximum)]
    for law, part, compliance, level in groups(layout, s):
        deep = laws.depth(law, force[None], compliance, level)
        excess.append(folded(_excess(at.joints.depth[part], turned[part], deep), 0, by=jnp.maximum))
    # |w + share dw| = r: 1 / share is the root of (r^2 - w^2) x^2 - 2 w.dw x - dw^2 = 0
    _, w = displaced(s, q)
    reach = s.bearings.clearance + force[None] / s.bearings.stiffness
    square, along, change = (x[:, 0] * y[:, 0] + x[:, 1] * y[:, 1] for x, y in ((w, w), (w, dw), (dw, dw)))
    room = jnp.maximum(reach * reach, 4 * square) - square
    excess.append(folded((along + jnp.sqrt(along * along + room * change)) / room, 0, by=jnp.maximum))
    return jnp.where(force > 0, 1 / functools.reduce(jnp.maximum, excess, jnp.ones_like(force)), 1)[None] * step


def _excess(depth: jax.Array, change: jax.Array, deepest: jax.Array) -> jax.Array:
    """A change over that up to a depth, or to twice that of now."""
    return change / (jnp.maximum(deepest, 2 * depth) - depth)
