"""The minimum of the energy: Newton's method for many cases at once, lanes last.

It begins with the contacts that a torque of this sign closes, linear and without clearance. Then full steps; only after
four without a new lowest energy a lane returns to its best point and searches the line from there (its slope is
monotone, because the energy is convex). An immediate search fails where a journal slides round its clearance: it leaves
the circle by the second order, so that the energy of good steps rises for a while.

A block has a fixed number of lanes. Once a quarter of them is done, cases that wait take their places, so that slow
cases do not hold up the others.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded import laws
from rvjax.loaded.contacts import Bearing, Contacts, depths, energy, frame, gradient, hessian, joints
from rvjax.loaded.elimination import solve
from rvjax.loaded.interior import approach
from rvjax.loaded.lanes import BLOCK, folded, stored, take
from rvjax.loaded.system import Layout, System

MAX_STEPS = 300
_DIRECT = 80  # of them before the interior point method
_PATIENCE = 4  # full steps without a new lowest energy
_SEARCHES = 30  # points on a line at most


class Found(NamedTuple):
    """Where the iteration ended; in this module lanes last."""

    q: jax.Array  # (n, l)
    steps: jax.Array  # (l,)
    residual: jax.Array  # (l,) gradient over the largest force
    largest: jax.Array  # (l,) force of any pin, N
    converged: jax.Array  # (l,)
    overload: jax.Array  # (l,) a pin beyond its law, at the start or on the way
    finite: jax.Array  # (l,)


class _Tour(NamedTuple):
    """Of all cases: those that wait for the next round, and what is found."""

    number: jax.Array  # of the round
    queued: jax.Array  # (cases,)
    found: Found


class _State(NamedTuple):
    """Of a block. Numbers and marks of a lane are one array each: every array of a loop is copied by a kernel."""

    q: jax.Array  # (n, l); of a lane that is not open: where it ended
    best: jax.Array  # (n, l)
    step: jax.Array  # (n, l) Newton's step from the best point
    lanes: jax.Array  # (10, l) numbers of `_Lane`
    marks: jax.Array  # (10, l) and its counts and marks


class _Lane(NamedTuple):
    """Each (l,). The bracket: shares of the step from the best point, and slopes there, < 0 at its lower end."""

    lowest: Any  # energy at the best point
    descent: Any  # slope there along the step, < 0
    first: Any  # slope after the full step
    lower: Any
    lower_slope: Any
    upper: Any
    upper_slope: Any
    share: Any  # of the step, now
    residual: Any
    largest: Any
    stall: Any  # points since the best
    steps: Any
    searching: Any  # from here on marks
    cold: Any  # before the linear step
    given: Any  # at a start that was given
    open: Any
    better: Any  # the last point is the best
    converged: Any
    overload: Any
    finite: Any


_NUMBERS, _COUNTS = 10, 12  # of the fields of `_Lane`: where counts begin, and marks


def _packed(lane: _Lane, dtype: Any) -> tuple[jax.Array, jax.Array]:
    lanes = lane.open.shape
    numbers = [jnp.broadcast_to(x, lanes).astype(dtype) for x in lane[:_NUMBERS]]
    return jnp.stack(numbers), jnp.stack([jnp.broadcast_to(x, lanes).astype(jnp.int32) for x in lane[_NUMBERS:]])


def _lane(numbers: jax.Array, marks: jax.Array) -> _Lane:
    counts = _COUNTS - _NUMBERS
    return _Lane(*numbers, *marks[:counts], *(marks[counts:] != 0))


def _found(state: _State) -> Found:
    lane = _lane(state.lanes, state.marks)
    return Found(state.q, lane.steps, lane.residual, lane.largest, lane.converged, lane.overload, lane.finite)


def minimise(layout: Layout, system: System, start: jax.Array) -> Found:
    """The minimum of the energy of every case; leaves of the result have the cases first.

    Args:
        layout: counts and methods.
        system: leaves (cases or 1, ...).
        start: (cases or 1, n); NaN for the linear start.
    """
    cases = max(len(leaf) for leaf in jax.tree.leaves((system, start)))
    width = min(cases, BLOCK)
    if layout.law != "linear":
        system = _working_first(system)

    def one_round(tour: _Tour) -> _Tour:
        """Every case of the queue; in the second round each begins near its minimum."""
        (queue,) = jnp.nonzero(tour.queued, size=cases, fill_value=cases)
        many, again = jnp.sum(tour.queued, dtype=jnp.int32), tour.number > 0

        def seated(place: jax.Array, empty: jax.Array) -> tuple[jax.Array, System, _State]:
            index = queue.at[place].get(mode="fill", fill_value=cases)
            part, begin, steps = take((system, start, tour.found.steps), jnp.minimum(index, cases - 1))
            part = part._replace(gap=jnp.broadcast_to(part.gap, (*part.gap.shape[:-1], width)))
            taken = place < many
            begin = jnp.broadcast_to(begin, (layout.unknowns, width))
            begin, more = jax.lax.cond(
                again,
                lambda: approach(layout, part, taken & empty),
                lambda: (begin, jnp.zeros((width,), jnp.int32)),
            )
            return index, part, _begin(layout, part, begin, taken, jnp.where(again, steps, 0) + more)

        def unfinished(loop: Any) -> jax.Array:
            _, state, cursor, _ = loop
            return jnp.any(_open(state)) | (cursor < many)

        def refill(loop: Any) -> Any:
            place, state, cursor, results = loop
            free = ~_open(state)
            place = jnp.where(free, cursor + jnp.cumsum(free, dtype=place.dtype) - 1, place)
            cursor = cursor + jnp.sum(free, dtype=place.dtype)
            index, part, fresh = seated(place, free)
            state = jax.tree.map(lambda new, old: jnp.where(free[None], new, old), fresh, state)
            leave = jnp.where(cursor < many, 3 * width // 4, 0).astype(jnp.int32)
            state = _iterate(layout, part, state, leave, again)
            results = jax.tree.map(
                lambda all_, new: all_.at[index].set(jnp.moveaxis(new, -1, 0), mode="drop"), results, _found(state)
            )
            return place, state, cursor, results

        place = jnp.zeros((width,), jnp.int32)
        shapes = jax.eval_shape(lambda: seated(place, place == 0)[2])
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)  # every lane is free
        found = jax.lax.while_loop(unfinished, refill, (place, empty, jnp.int32(0), tour.found))[-1]
        lost = ~found.converged & found.finite & (found.steps >= _DIRECT)
        return _Tour(tour.number + 1, lost, found)

    def goes_on(tour: _Tour) -> jax.Array:
        return (tour.number == 0) | ((tour.number == 1) & jnp.any(tour.queued))

    dtype = start.dtype
    zero, no, none = jnp.zeros((cases,), dtype), jnp.zeros((cases,), bool), jnp.zeros((cases,), jnp.int32)
    nothing = Found(jnp.zeros((cases, layout.unknowns), dtype), none, zero, zero, no, no, no)
    return jax.lax.while_loop(goes_on, one_round, _Tour(jnp.int32(0), ~no, nothing)).found


def _working_first(s: System) -> System:
    """The pins of every disc in another order: those first that the torque presses."""
    order = jnp.argsort(s.rows[:, 2] * s.load[:, None, None], axis=-1)
    level = None if s.level is None else jnp.take_along_axis(s.level, order, axis=-1)
    return s._replace(
        rows=jnp.take_along_axis(s.rows, order[:, None], axis=-1),
        gap=jnp.take_along_axis(s.gap, order, axis=-1),
        level=level,
    )


def _open(state: _State) -> jax.Array:
    return _lane(state.lanes, state.marks).open


def _begin(layout: Layout, s: System, start: jax.Array, seated: jax.Array, steps: jax.Array) -> _State:
    """At the start that is given; where that is NaN at zero, before the linear step."""
    lanes = seated.shape[0]
    start = jnp.broadcast_to(start, (layout.unknowns, lanes))
    warm = jnp.all(jnp.isfinite(start), axis=0)
    q = jnp.where(warm[None], start, 0)
    lane = _Lane(*[jnp.zeros((lanes,), start.dtype)] * _NUMBERS, *[jnp.zeros((lanes,), bool)] * 10)
    lane = lane._replace(lowest=lane.lowest + jnp.inf, steps=steps, cold=~warm & (s.load != 0), given=warm, open=seated)
    return _State(q, q, jnp.zeros_like(q), *_packed(lane, start.dtype))


def _overloaded(s: System, depth: jax.Array) -> jax.Array:
    return folded(depth >= laws.largest_depth(s.compliance[None, None], s.level), 0, 1, by=jnp.logical_or)


def _iterate(layout: Layout, s: System, state: _State, leave: jax.Array, again: jax.Array) -> _State:
    """Steps of all open lanes until no more than `leave` are open; `again`: in the second round."""
    limit = jnp.where(again, MAX_STEPS, _DIRECT)
    # A part sums up to some ten contacts, each with its rounding: what does not get below that in 80 steps never will.
    slack = jnp.where(again, 8.0, 1.0).astype(state.q.dtype)
    lanes = state.q.shape[-1]
    eps = float(jnp.finfo(state.q.dtype).eps)
    tolerance = max(1e-13, 32 * eps)  # of the largest force
    stiffest = _most(s.bearing_stiffness, s.gear_stiffness)
    widest = _most(s.gap, s.gear_gap, s.bearing_gap)
    # The linear start: a slope for the mean force of the working pins, half of all, with the mean of their levers.
    lever = jnp.sum(jnp.abs(s.rows[2]), axis=(0, 1)) / 2
    typical = laws.typical_slope(layout.law, (jnp.abs(s.load) / lever)[None, None], s.compliance[None, None], s.level)
    working = jnp.where((s.rows[2] < 0) == (s.load > 0)[None, None], typical, 0)
    driving = jnp.broadcast_to(jnp.stack([s.load > 0, s.load <= 0])[None], (layout.cranks, 2, s.load.shape[-1]))

    at_rest = frame(layout, s)

    def law(depth: jax.Array, level: jax.Array | None) -> tuple[jax.Array, jax.Array]:
        force = laws.force(layout.law, depth, s.compliance[None, None], level)
        return force, laws.slope(layout.law, depth, force, s.compliance[None, None])

    def pressed(q: jax.Array, cold: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Depths, forces and slopes of the pins; those that the torque does not press are rarely pressed at all."""
        depth = depths(layout, s, q)
        if layout.law == "linear":
            force, slope = law(depth, None)
        else:
            half = layout.pins // 2 + 1
            level = depth if s.level is None else s.level  # read by the hertz law alone
            near = stored(law, depth[:, :half], level[:, :half])
            far = jax.lax.cond(
                jnp.any(depth[:, half:] > 0),
                law,
                lambda depth, _: (jnp.zeros_like(depth), jnp.zeros_like(depth)),
                *(depth[:, half:], level[:, half:]),
            )
            force, slope = (jnp.concatenate(both, axis=1) for both in zip(near, far))
        started = cold[None, None]
        return depth, jnp.where(started, working * depth, force), jnp.where(started, working, slope)

    def joined(q: jax.Array, cold: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, Bearing]:
        """Depths, forces and slopes of the flanks, and the bearings."""
        depth, held = joints(s._replace(clearance=jnp.where(cold, 0, s.clearance)), q)
        slope = jnp.where(jnp.where(cold[None, None], driving, depth > 0), s.gear_stiffness[:, None], 0)
        return depth, slope * depth, slope, held

    def judged(
        q: jax.Array, step: jax.Array, cold: jax.Array, at: Contacts, g: jax.Array, newton: jax.Array
    ) -> _Judged:
        value = energy(layout, s, q, at)
        size, miss = _most(at.pins, at.gear, at.bearing.force), _most(g)
        rounding = stiffest * jnp.maximum(widest, _most(q))
        over = _overloaded(s, at.depth) if layout.law == "hertz" else jnp.zeros((lanes,), bool)
        return _Judged(
            value=value,
            miss=miss,
            size=size,
            largest=folded(at.pins, 0, 1, by=jnp.maximum),
            along=folded(step * g, 0),
            descent=folded(newton * g, 0),
            small=miss <= slack * jnp.maximum(tolerance * size, 2 * eps * rounding),
            fine=jnp.isfinite(value) & folded(jnp.isfinite(newton), 0, by=jnp.logical_and),
            over=over & ~cold,
        )

    def body(state: _State) -> _State:
        q, cold = state.q, _lane(state.lanes, state.marks).cold
        depth, pins, slope = stored(pressed, q, cold)
        gear_depth, gear, gear_slope, held = stored(joined, q, cold)
        at = Contacts(depth, pins, gear_depth, gear, held)
        g = stored(lambda q, at: gradient(layout, s, q, at), q, at)
        square = stored(lambda *of: hessian(layout, s, *of), at, slope, gear_slope, at_rest)
        newton = stored(lambda square, g: -solve(layout, square, g), square, g)
        found = stored(judged, q, state.step, cold, at, g, newton)
        numbers, marks = stored(_decided, state.lanes, state.marks, found, limit)
        q, best, step = stored(_onward, state, newton, numbers, marks)
        return _State(q, best, step, numbers, marks)

    return jax.lax.while_loop(lambda state: jnp.sum(_open(state), dtype=leave.dtype) > leave, body, state)


class _Judged(NamedTuple):
    """What a point is worth, each (l,)."""

    value: jax.Array  # energy
    miss: jax.Array  # largest component of the gradient
    size: jax.Array  # largest force
    largest: jax.Array  # force of a pin
    along: jax.Array  # slope along the step from the best point
    descent: jax.Array  # and along Newton's step from here
    small: jax.Array  # the gradient is
    fine: jax.Array  # all is finite
    over: jax.Array  # a pin is beyond its law


def _decided(numbers: jax.Array, marks: jax.Array, at: _Judged, limit: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Numbers and marks of every lane after a point, from those before it."""
    last = _lane(numbers, marks)
    live, cold = last.open, last.cold
    usable = at.fine & ~at.over
    again = last.given & ~usable  # a given start beyond the law of a pin: the linear one instead
    done = usable & at.small & ~cold
    lower = usable & (at.value < last.lowest)
    slope = jnp.where(usable, at.along, jnp.inf)
    flat = jnp.abs(slope) <= 0.1 * jnp.abs(last.descent)
    exhausted = last.stall >= _PATIENCE + _SEARCHES
    better = ~cold & jnp.where(last.searching, (flat & (lower | (slope <= 0))) | exhausted, lower)
    first = jnp.where(last.stall == 0, slope, last.first)
    stall = jnp.where(better | cold | again, 0, last.stall + 1)
    enters = ~better & ~again & ~last.searching & ((stall >= _PATIENCE) | (~usable & ~cold))

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
    lane = _Lane(
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
        given=False,
        open=live & ~done & ~failed & (steps < limit),
        better=better,
        converged=jnp.where(live, done, last.converged),
        overload=jnp.where(live, (last.overload | at.over) & ~done & ~again, last.overload),
        finite=jnp.where(live, at.fine | at.over | ~failed, last.finite),
    )
    return _packed(lane, numbers.dtype)


def _onward(
    last: _State, newton: jax.Array, numbers: jax.Array, marks: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The next point of every open lane, its best one and the step from there; at its end the point that it ends at."""
    lane = _lane(numbers, marks)
    best, step = (jnp.where(lane.better[None], new, old) for new, old in ((last.q, last.best), (newton, last.step)))
    whole = last.q + newton
    # Without a best point there is no finite energy: such a lane has failed.
    ended = jnp.where(lane.converged[None], whole, jnp.where(jnp.isinf(lane.lowest)[None], 0, best))
    onward = jnp.where(lane.searching[None], best + lane.share[None] * step, whole)
    onward = jnp.where(lane.cold[None], 0, onward)
    return jnp.where(_open(last)[None], jnp.where(lane.open[None], onward, ended), last.q), best, step


def _most(*values: Any) -> jax.Array:
    """Largest absolute value of each lane."""
    largest = [folded(jnp.abs(value), *range(value.ndim - 1), by=jnp.maximum) for value in values]
    return functools.reduce(jnp.maximum, largest)
