"""Bodies and contacts of one equilibrium, and the forces, energy and stiffness of all contacts at displacements q.

Unknowns q are lengths, deviations from the ideal motion; rotations are multiplied by a length of their body:

    disc k      three unknowns                  rows 3 k ..
    border      all other bodies: `links` bodies of three unknowns each (cranks), rows 3 discs ..; after them the
                common bodies, of which the first begins with the rotation of the carrier, which the load turns

A disc touches the border only, never another disc. A link touches discs and common bodies, never another link. The
energy is that of docs/models/loaded.md, Eq. 21. Arrays have the batch axis (independent cases) last; a leaf of the
system that all cases share has length 1 there.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import folded
from rvjax.loaded import laws


class Group(NamedTuple):
    """Contacts of the same two kinds of bodies. They are numbered disc by disc, link by link, and at each place."""

    discs: bool  # there are contacts on every disc
    links: bool  # there are contacts on every link, or of every disc with every link
    common: bool  # the common bodies are touched
    each: int = 1  # at a place; of bearings 1
    law: str = "linear"  # of joints


class Layout(NamedTuple):
    """Counts and methods: what is compiled in."""

    discs: int
    pins: int  # round each disc
    law: str  # of the pins
    links: int
    common: tuple[int, ...]  # unknowns of each common body
    joints: tuple[Group, ...]  # one or more
    bearings: tuple[Group, ...]  # one or more
    interior: bool = True  # cases that Newton leaves go to the interior point method; not in tests that need none

    @property
    def carrier_floats(self) -> bool:
        """The first common body is a carrier with x and y besides its rotation."""
        return self.common[0] == 3

    @property
    def input_moves(self) -> bool:
        """The second common body, if there is one, is the input: a floating sun, or a shaft in its supports."""
        return len(self.common) == 2

    @property
    def inner(self) -> int:
        """Unknowns of the discs."""
        return 3 * self.discs

    @property
    def carried(self) -> int:
        """Row of the carrier rotation, the first of the common bodies."""
        return self.inner + 3 * self.links

    @property
    def unknowns(self) -> int:
        """Their number."""
        return self.carried + sum(self.common)

    @property
    def near(self) -> int:
        """Unknowns of the border that discs touch, its first ones."""
        touched = any(group.discs and group.common for group in (*self.joints, *self.bearings))
        return 3 * self.links + touched * sum(self.common)

    def link(self, i: int) -> int:
        """First row of a link."""
        return self.inner + 3 * i

    def places(self, group: Group) -> tuple[int, int]:
        """Discs and links on which a group has contacts; 1 where it has none of that kind."""
        return self.discs if group.discs else 1, self.links if group.links else 1

    def parts(self, groups: tuple[Group, ...]) -> list[tuple[Group, slice]]:
        """Each group with its part of the contacts of all."""
        named_groups, end = list[tuple[Group, slice]](), 0
        for group in groups:
            discs, links = self.places(group)
            begin, end = end, end + discs * links * group.each
            named_groups.append((group, slice(begin, end)))
        return named_groups

    def contacts(self, groups: tuple[Group, ...]) -> int:
        """Number of contacts of all groups."""
        return sum(part.stop - part.start for _, part in self.parts(groups))


class Pins(NamedTuple):
    """Unilateral contacts of a disc with the ring. d discs, p pins."""

    rows: Any  # (3, d, p) depth per displacement of the disc; Eq. 9
    gap: Any  # (d, p) m, depth at q = 0
    compliance: Any  # (1,) of the contact law; (p,) where the supports of linear pins differ
    level: Any  # (d, p) A of the hertz contact law, else None


class Joints(NamedTuple):
    """Unilateral contacts of any two bodies, j of all groups, n unknowns."""

    rows: Any  # (j, n) depth per unknown
    gap: Any  # (j,) m, depth at q = 0
    compliance: Any  # (j,) of the contact law of their group
    level: Any  # (j,) A of the hertz contact law; None without such a group
    lever: Any  # (j,) < 0 where a positive load presses; its size weights the shares in the load


class Bearings(NamedTuple):
    """Springs k (|w| - clearance)+ along w = gap + rows q, b of all groups."""

    rows: Any  # (b, 2, n)
    gap: Any  # (b, 2) m, bore against journal at q = 0
    stiffness: Any  # (b,) N/m
    clearance: Any  # (b,) m, >= 0


class System(NamedTuple):
    """Numbers of one case, lengths in m, forces in N."""

    pins: Pins
    joints: Joints
    bearings: Bearings
    centring: Any  # () k0, N/m, of every unknown
    support: Any  # (n,) N/m, springs of the common bodies against the housing, besides k0
    load: Any  # () N, torque over the length of the carrier rotation


class Pressed(NamedTuple):
    """Unilateral contacts: pins (d, p, l) or joints (j, l)."""

    depth: jax.Array  # m
    force: jax.Array  # N
    slope: jax.Array  # N/m, rise of the force with the depth


class Held(NamedTuple):
    """Forces and stiffness of bearings."""

    force: jax.Array  # (b, 2, l), sign of grad E
    stiffness: jax.Array  # xx, xy, yy, (3, b, l)
    energy: jax.Array  # (b, l)


class Limits(NamedTuple):
    """Largest depths of the hertz contact law, m; None without it."""

    pins: Any  # (d, p, l)
    joints: Any  # (j, l), read for groups of this contact law


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
    pins, (joints, w) = depths(layout, s, q), displaced(s, q)
    return Contacts(pressed_pins(layout, s, pins), pressed_joints(layout, s, joints), held(w, s.bearings))


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


def pressed_pins(layout: Layout, s: System, depth: jax.Array) -> Pressed:
    """Pins at their depths (d, p, l), by the contact law."""
    force = laws.force(layout.law, depth, s.pins.compliance[None], s.pins.level)
    return Pressed(depth, force, laws.slope(layout.law, depth, force, s.pins.compliance[None]))


def pressed_joints(layout: Layout, s: System, depth: jax.Array) -> Pressed:
    """Joints at their depths (j, l), each by the contact law of its group."""
    forces, slopes = [], []
    for law, part, compliance, level in groups(layout, s):
        forces.append(laws.force(law, depth[part], compliance, level))
        slopes.append(laws.slope(law, depth[part], forces[-1], compliance))
    return Pressed(depth, _joined(forces), _joined(slopes))


def typical_joint_slopes(layout: Layout, s: System) -> jax.Array:
    """Slopes (j, l) where half of the joints carries the load, with the mean of their levers."""
    force = (jnp.abs(s.load) / (jnp.sum(jnp.abs(s.joints.lever), axis=0) / 2))[None]
    return _joined([laws.typical_slope(law, force, k, level) for law, _, k, level in groups(layout, s)])


def largest_depths(layout: Layout, s: System) -> Limits:
    """Largest depths of the contact laws.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
    """
    pins = laws.largest_depth(s.pins.compliance[None], s.pins.level) if layout.law == "hertz" else None
    hertz = [law == "hertz" for law, *_ in groups(layout, s)]
    joints = laws.largest_depth(s.joints.compliance, s.joints.level) if any(hertz) else None
    return Limits(pins, joints)


def groups(layout: Layout, s: System) -> Iterator[tuple[str, slice, jax.Array, Any]]:
    """Contact law, place among all joints, compliance and level of each group."""
    for group, part in layout.parts(layout.joints):
        yield group.law, part, s.joints.compliance[part], None if s.joints.level is None else s.joints.level[part]


def _joined(parts: list[jax.Array]) -> jax.Array:
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)


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
    total = (s.support + s.centring[None]) * q + load + jnp.pad(pins, ((0, layout.unknowns - layout.inner), (0, 0)))
    total = total + _product(s.joints.rows, at.joints.force)
    rows = s.bearings.rows
    return total + _product(rows.reshape(-1, *rows.shape[2:]), at.bearings.force.reshape(-1, q.shape[-1]))


def energy(layout: Layout, s: System, q: jax.Array, at: Contacts, most: Limits) -> jax.Array:
    """Energy (l,) J, Eq. 21."""
    pins = folded(laws.energy(layout.law, *at.pins[:2], s.pins.compliance[None], most.pins), 0, 1)
    depth, force, _ = at.joints
    joints = [
        laws.energy(law, depth[part], force[part], k, None if most.joints is None else most.joints[part])
        for law, part, k, _ in groups(layout, s)
    ]
    support = folded((s.support + s.centring[None]) * q * q, 0) / 2 + s.load * q[layout.carried]
    return pins + folded(at.bearings.energy, 0) + folded(_joined(joints), 0) + support


def _moved(rows: jax.Array, q: jax.Array) -> jax.Array:
    """rows (..., n, l) times q (n, l): (..., l)."""
    return folded(rows * q[(None,) * (rows.ndim - 2)], rows.ndim - 2)


def _product(rows: jax.Array, values: jax.Array) -> jax.Array:
    """Sum over m of rows (m, n, l) times values (m, l): (n, l)."""
    return folded(rows * values[:, None], 0)


def over_pins(rows: jax.Array, load: jax.Array) -> jax.Array:
    """Sums over the pins of a disc of rows (w, d, p, l) times load (d, p, l): (w, d, l)."""
    return folded(rows * load[None], 2)
