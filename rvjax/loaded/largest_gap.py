"""Largest least gap of contacts whose parts may turn, without load: the highest point of a linear programme.

Gaps are linear in rotations. Every disc turns against the ring, and against the carrier where it has holes. At a gap s,
disc k may turn by [lo, hi] between its pins and by [lo', hi'] between its holes. The carrier may turn by

    max (lo - hi') .. min (hi - lo')

The lengths of these intervals are concave falling functions of s, straight between corners. The tangent of each is zero
at an upper bound of the largest gap. The least of these bounds is the next s. A contact without lever bounds s itself.

Two contacts decide the interval of a disc, four that of the carrier. The gap is their mean, weighted by 1/|lever|.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import BatchedKernel, along_lanes, folded, like, while_loop
from rvjax.loaded.balance import in_blocks

STEPS = 12  # at most; 5 were the most of 60,000 random cases
ROUNDING = 1e3  # of levers, in units of the last place
_DECIDE = 4  # contacts


class Lines(NamedTuple):
    """Gaps that change linearly with a rotation: gap - lever rotation; a row for each disc, (d, n)."""

    gap: jax.Array  # m
    lever: jax.Array  # m, > 0 and < 0 in every row


class _Ends(NamedTuple):
    """Ends of rotations at a gap s, batch axis last."""

    turn: jax.Array  # how far the end is away, rad
    weight: jax.Array  # how much nearer it comes with s, rad/m
    contacts: jax.Array  # numbers of the contacts that decide it, (m, ..)

    def plus(self, other: "_Ends") -> "_Ends":
        """Ends of the sum of two rotations."""
        contacts = jnp.concatenate([*jnp.broadcast_arrays(self.contacts, other.contacts)])
        return _Ends(self.turn + other.turn, self.weight + other.weight, contacts)

    def nearest(self) -> "_Ends":
        """The nearest end along the first axis; of several, the first of those that come nearer fastest."""
        turn = folded(self.turn, 0, by=jnp.minimum)
        weight = folded(jnp.where(self.turn == turn[None], self.weight, 0), 0, by=jnp.maximum)
        rows = jnp.arange(len(self.turn), dtype=jnp.int32).reshape(-1, *[1] * turn.ndim)
        here = (self.turn == turn[None]) & (self.weight == weight[None])
        first = rows == folded(jnp.where(here, rows, len(rows)), 0, by=jnp.minimum)[None]
        return _Ends(turn, weight, jnp.sum(jnp.where(first[None], self.contacts, 0), axis=1, dtype=jnp.int32))


def largest_gap(*sets: Lines) -> tuple[jax.Array, jax.Array]:
    """Largest least gap over the rotations of all discs and of the carrier, and its distance from a lower bound; () m.

    Args:
        *sets: gaps of pins over the rotation of each disc; of holes over its rotation against the carrier, if any.
    """
    leaves = like(jax.lax.stop_gradient(jax.tree.leaves(sets)))
    deciding, left = _decided(*(leaf[None] for leaf in leaves))
    gap, lever = (jnp.concatenate([x.ravel() for x in each])[deciding[0]] for each in zip(*sets))
    weight = 1 / jnp.where(deciding[0, 0] == deciding[0, 1], 1, jnp.abs(lever))  # one alone bounds no rotation
    return jnp.sum(weight * gap) / jnp.sum(weight), left[0]


def _shapes(*leaves: jax.Array) -> tuple[jax.ShapeDtypeStruct, jax.ShapeDtypeStruct]:
    cases = max(leaf.shape[0] for leaf in leaves)
    return jax.ShapeDtypeStruct((cases, _DECIDE), jnp.int32), jax.ShapeDtypeStruct((cases,), leaves[0].dtype)


def _block(_: object, *leaves: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Numbers (4, l) of the contacts that decide, row by row, pins first; distance from a lower bound, (l,) m."""
    sets = [Lines(*pair) for pair in zip(leaves[::2], leaves[1::2])]
    sides, alone = _sides(sets)
    size = jnp.max(jnp.stack([jnp.max(jnp.abs(gap), axis=(0, 1)) for gap, _ in sets]), axis=0)
    fine = 8 * jnp.finfo(size.dtype).eps * size

    def ends(s: jax.Array) -> list[_Ends]:
        """Of every disc, on both sides between its pins and between its holes, (d, l)."""
        return [side._replace(turn=side.turn - s[None, None] * side.weight).nearest() for side in sides]

    def bound(s: jax.Array) -> _Ends:
        """The least upper bound of the largest gap, (l,) m, by the tangents at s."""
        up, down, *holes = ends(s)
        of_discs = [up.plus(down)] + ([holes[0].plus(holes[1])] if holes else [])
        rooms = [_Ends(*(x[..., k, :] for x in each)) for each in of_discs for k in range(len(up.turn))]
        if holes:
            rooms.append(up.plus(holes[1]).nearest().plus(holes[0].plus(down).nearest()))
        bounds = jnp.stack([s + room.turn / room.weight for room in rooms] + [one.turn for one in alone])
        contacts = [jnp.concatenate([x] * (_DECIDE // len(x))) for _, _, x in (*rooms, *alone)]
        return _Ends(bounds, jnp.zeros_like(bounds), jnp.stack(contacts, axis=1)).nearest()

    def lower(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        s, steps, _ = state
        new = bound(s).turn
        return new, steps + 1, (steps == 0) | jnp.any(new < s - fine)

    start = jnp.zeros_like(size), jnp.int32(0), jnp.bool_(True)
    s, _, _ = while_loop(lambda state: state[2] & (state[1] < STEPS), lower, start)
    found = bound(s)
    return found.contacts, found.turn - _least(sets, ends(found.turn))


def _sides(sets: list[Lines]) -> tuple[list[_Ends], list[_Ends]]:
    """Ends at no gap by both sides of every set, contacts first (n, d, l); gaps of contacts without lever, (l,) m."""
    sides, alone, first = [], [], 0
    for gap, lever in sets:
        discs, count, _ = gap.shape
        contacts = jnp.arange(first, first + discs * count, dtype=jnp.int32).reshape(1, discs, count, 1)
        least = ROUNDING * jnp.finfo(gap.dtype).eps * jnp.max(jnp.abs(lever), axis=(0, 1), keepdims=True)
        for ahead in (lever, -lever):
            weight = jnp.where(ahead > least, 1 / jnp.where(ahead > least, ahead, 1), 0)
            turn = jnp.where(ahead > least, gap * weight, jnp.inf)
            sides.append(_Ends(*(x.swapaxes(-3, -2) for x in (turn, weight, contacts))))
        own = jnp.where(jnp.abs(lever) > least, jnp.inf, gap).reshape(discs * count, -1)
        alone.append(_Ends(own, jnp.zeros_like(own), contacts.reshape(1, -1, 1)).nearest())
        first += discs * count
    return sides, alone


def _least(sets: list[Lines], ends: list[_Ends]) -> jax.Array:
    """Least gap with discs and carrier in the middle of what is left to them, (l,) m."""
    hi, lo, *holes = (end.turn * sign for end, sign in zip(ends, (1, -1, 1, -1)))
    if holes:
        far, near = holes
        carrier = (folded(lo - far, 0, by=jnp.maximum) + folded(hi - near, 0, by=jnp.minimum))[None] / 2
        disc = (jnp.maximum(lo, carrier + near) + jnp.minimum(hi, carrier + far)) / 2
        turns = [disc, disc - carrier]
    else:
        turns = [(hi + lo) / 2]
    gaps = [of.gap - of.lever * turn[:, None] for of, turn in zip(sets, turns)]
    return jnp.min(jnp.stack([folded(gap, 0, 1, by=jnp.minimum) for gap in gaps]), axis=0)


_decided = along_lanes(BatchedKernel(lambda *leaves: in_blocks(_block, ((), *leaves)), _shapes))
"""The same of a batch, cases first."""
