"""State of one batch element of Newton's method, and the choice of its next point.

Full steps, until four of them have brought no new lowest energy; then the element returns to its best point and
searches the line from there between two slopes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

PATIENCE = 4  # full steps without a new lowest energy
SEARCHES = 30  # points on a line at most


class State(NamedTuple):
    """State of a block. Numbers and marks are one array each, because a kernel copies every array of a loop."""

    q: jax.Array  # (n, l); the last point once an element is not open
    best: jax.Array  # (n, l)
    step: jax.Array  # (n, l) Newton's step from the best point
    lanes: jax.Array  # (10, l) numbers of `Lane`
    marks: jax.Array  # (10, l) and its counts and marks


class Lane(NamedTuple):
    """Each (l,). The bracket: shares of the step from the best point, and slopes there, < 0 at its lower end."""

    lowest: jax.Array  # energy at the best point
    descent: jax.Array  # slope there along the step, < 0
    first: jax.Array  # slope after the full step
    lower: jax.Array
    lower_slope: jax.Array
    upper: jax.Array
    upper_slope: jax.Array
    share: jax.Array  # of the step, now
    residual: jax.Array
    largest: jax.Array
    stall: jax.Array  # points since the best
    steps: jax.Array
    searching: jax.Array  # from here on marks
    cold: jax.Array  # before the linear step
    given: jax.Array  # at a start that was given
    open: jax.Array
    better: jax.Array  # the last point is the best
    converged: jax.Array
    overload: jax.Array
    finite: jax.Array


class Judged(NamedTuple):
    """Merit of a point, each (l,)."""

    value: jax.Array  # energy
    miss: jax.Array  # largest component of the gradient
    size: jax.Array  # largest force
    largest: jax.Array  # force of a pin
    along: jax.Array  # slope along the step from the best point
    descent: jax.Array  # and along Newton's step from here
    small: jax.Array  # the gradient is
    fine: jax.Array  # all is finite
    over: jax.Array  # a pin is beyond its contact law


_NUMBERS, _COUNTS = 10, 12  # of the fields of `Lane`: where counts begin, and marks


def fresh(lanes: int, dtype: DTypeLike) -> Lane:
    """State before the first step: all zero, no energy yet."""
    lane = Lane(*[jnp.zeros((lanes,), dtype)] * _NUMBERS, *[jnp.zeros((lanes,), bool)] * (len(Lane._fields) - _NUMBERS))
    return lane._replace(lowest=lane.lowest + jnp.inf)


def packed(lane: Lane, dtype: DTypeLike) -> tuple[jax.Array, jax.Array]:
    """Numbers, and counts with marks, of `lane`."""
    lanes = lane.open.shape
    numbers = [jnp.broadcast_to(x, lanes).astype(dtype) for x in lane[:_NUMBERS]]
    return jnp.stack(numbers), jnp.stack([jnp.broadcast_to(x, lanes).astype(jnp.int32) for x in lane[_NUMBERS:]])


def unpacked(numbers: jax.Array, marks: jax.Array) -> Lane:
    """Inverse of `packed`."""
    counts = _COUNTS - _NUMBERS
    return Lane(*numbers, *marks[:counts], *(marks[counts:] != 0))


def is_open(state: State) -> jax.Array:
    """Mark of each element (l,) that has not ended."""
    return unpacked(state.lanes, state.marks).open


def decided(numbers: jax.Array, marks: jax.Array, at: Judged, limit: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Numbers and marks of every element after a point, from those before it."""
    last = unpacked(numbers, marks)
    live, cold = last.open, last.cold
    usable = at.fine & ~at.over
    again = last.given & ~usable  # a given start beyond the contact law of a pin: the linear one instead
    done = usable & at.small & ~cold
    lower = usable & (at.value < last.lowest)
    slope = jnp.where(usable, at.along, jnp.inf)
    flat = jnp.abs(slope) <= 0.1 * jnp.abs(last.descent)
    exhausted = last.stall >= PATIENCE + SEARCHES
    better = ~cold & jnp.where(last.searching, (flat & (lower | (slope <= 0))) | exhausted, lower)
    first = jnp.where(last.stall == 0, slope, last.first)
    stall = jnp.where(better | cold | again, 0, last.stall + 1)
    enters = ~better & ~again & ~last.searching & ((stall >= PATIENCE) | (~usable & ~cold))

    down = slope < 0
    begin = jnp.where(enters, 0, jnp.where(down, last.share, last.lower))
    begin_slope = jnp.where(enters, last.descent, jnp.where(down, slope, last.lower_slope))
    end = jnp.where(enters, 1, jnp.where(down, last.upper, last.share))
    end_slope = jnp.where(enters, first, jnp.where(down, last.upper_slope, slope))
    bracketed = jnp.isfinite(end_slope) & (end_slope > 0)
    rise = jnp.where(bracketed, end_slope - begin_slope, 1)
    secant = jnp.where(bracketed, jnp.clip(-begin_slope / rise, 0.05, 0.95), 0.25)

    failed = jnp.isinf(last.lowest) & ~usable & ~cold & ~again
    steps = last.steps + (~(done | cold | last.searching)).astype(jnp.int32)
    lane = Lane(
        lowest=jnp.where(better, at.value, last.lowest),
        descent=jnp.where(better, at.descent, last.descent),
        first=first,
        lower=begin,
        lower_slope=begin_slope,
        upper=end,
        upper_slope=end_slope,
        share=begin + (end - begin) * secant,
        residual=jnp.where(live, at.miss / jnp.where(at.size > 0, at.size, 1), last.residual),
        largest=jnp.where(live, at.largest, last.largest),
        stall=stall,
        steps=jnp.where(live, steps, last.steps),
        searching=~better & (last.searching | enters),
        cold=again,
        given=jnp.zeros_like(again),
        open=live & ~done & ~failed & (steps < limit),
        better=better,
        converged=jnp.where(live, done, last.converged),
        overload=jnp.where(live, (last.overload | at.over) & ~done & ~again, last.overload),
        finite=jnp.where(live, at.fine | at.over | ~failed, last.finite),
    )
    return packed(lane, numbers.dtype)


def onward(
    last: State, newton: jax.Array, numbers: jax.Array, marks: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Next point of every open element, its best point and the step from there; the final point once it has ended."""
    lane = unpacked(numbers, marks)
    best, step = (jnp.where(lane.better[None], new, old) for new, old in ((last.q, last.best), (newton, last.step)))
    whole = last.q + newton
    # Without a best point there is no finite energy: such an element has failed.
    ended = jnp.where(lane.converged[None], whole, jnp.where(jnp.isinf(lane.lowest)[None], 0, best))
    point = jnp.where(lane.searching[None], best + lane.share[None] * step, whole)
    point = jnp.where(lane.cold[None], 0, point)
    return jnp.where(is_open(last)[None], jnp.where(lane.open[None], point, ended), last.q), best, step
