"""The minimum of the energy: Newton's method for many cases at once, batch axis last.

It begins with the contacts that a torque of this sign closes, linear and without clearance. Then full steps; only after
four without a new lowest energy a case returns to its best point and searches the line from there (its slope is
monotone, because the energy is convex). An immediate search fails where a journal slides round its clearance: it leaves
the circle by the second order, so that the energy of good steps rises for a while.

A block has a fixed number of places. Once a quarter of its cases is done, waiting cases replace them, so that slow
cases do not delay the others.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from rvjax._jax.batching import folded, stored
from rvjax.loaded import laws
from rvjax.loaded.batching import BLOCK, take
from rvjax.loaded.contacts import Bearing, Contacts, depths, energy, frame, gradient, hessian, joints
from rvjax.loaded.elimination import solve
from rvjax.loaded.interior import approach
from rvjax.loaded.system import Layout, System
from rvjax.loaded.watchdog import Judged, State, decided, fresh, is_open, onward, packed, unpacked
from rvjax.records import PyTree

MAX_STEPS = 300
_DIRECT = 80  # of them before the interior point method


class Found(NamedTuple):
    """Result of the iteration; in this module with the batch axis last."""

    q: jax.Array  # (n, l)
    steps: jax.Array  # (l,)
    residual: jax.Array  # (l,) gradient over the largest force
    largest: jax.Array  # (l,) force of any pin, N
    converged: jax.Array  # (l,)
    overload: jax.Array  # (l,) a pin beyond its contact law, at the start or on the way
    finite: jax.Array  # (l,)

    @classmethod
    def shapes(cls, layout: Layout, dtype: DTypeLike) -> PyTree:
        """Shapes and dtypes of one case."""
        vector = jax.ShapeDtypeStruct((layout.unknowns,), dtype)
        kinds = jnp.int32, dtype, dtype, bool, bool, bool
        return cls(vector, *(jax.ShapeDtypeStruct((), kind) for kind in kinds))  # type: ignore[arg-type]


class _Tour(NamedTuple):
    """State of all cases: those that wait for the next round, and the results."""

    number: jax.Array  # of the round
    queued: jax.Array  # (cases,)
    found: Found


_Loop = tuple[jax.Array, State, jax.Array, Found]  # case in each place, their states, next in the queue, results


def _found(state: State) -> Found:
    lane = unpacked(state.lanes, state.marks)
    return Found(state.q, lane.steps, lane.residual, lane.largest, lane.converged, lane.overload, lane.finite)


def minimise(layout: Layout, system: System, start: jax.Array) -> Found:
    """The minimum of the energy of every case; leaves of the result have the cases first.

    Args:
        layout: counts and methods.
        system: leaves (cases or 1, ...).
        start: (cases or 1, n); NaN for the linear start, inf for a case that is not solved.
    """
    cases = max(len(leaf) for leaf in jax.tree.leaves((system, start)))
    width = min(cases, BLOCK)
    if layout.law != "linear":
        system = _working_first(system)

    def one_round(tour: _Tour) -> _Tour:
        """Every case of the queue; in the second round each begins near its minimum."""
        (queue,) = jnp.nonzero(tour.queued, size=cases, fill_value=cases)
        many, again = jnp.sum(tour.queued, dtype=jnp.int32), tour.number > 0

        def seated(place: jax.Array, empty: jax.Array) -> tuple[jax.Array, System, State]:
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

        def unfinished(loop: _Loop) -> jax.Array:
            _, state, cursor, _ = loop
            return jnp.any(is_open(state)) | (cursor < many)

        def refill(loop: _Loop) -> _Loop:
            place, state, cursor, results = loop
            free = ~is_open(state)
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
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)  # every place is free
        found = jax.lax.while_loop(unfinished, refill, (place, empty, jnp.int32(0), tour.found))[-1]
        lost = ~found.converged & found.finite & (found.steps >= _DIRECT)
        return _Tour(tour.number + 1, lost, found)

    def goes_on(tour: _Tour) -> jax.Array:
        return (tour.number == 0) | ((tour.number == 1) & jnp.any(tour.queued))

    dtype = start.dtype
    zero, no, none = jnp.zeros((cases,), dtype), jnp.zeros((cases,), bool), jnp.zeros((cases,), jnp.int32)
    nothing = Found(jnp.zeros((cases, layout.unknowns), dtype), none, zero, zero, no, no, no)
    wanted = jnp.broadcast_to(~jnp.any(jnp.isinf(start), axis=1), (cases,))
    return jax.lax.while_loop(goes_on, one_round, _Tour(jnp.int32(0), wanted, nothing)).found


def _working_first(s: System) -> System:
    """The pins of every disc in another order: those first that the torque presses."""
    order = jnp.argsort(s.rows[:, 2] * s.load[:, None, None], axis=-1)
    level = None if s.level is None else jnp.take_along_axis(s.level, order, axis=-1)
    return s._replace(
        rows=jnp.take_along_axis(s.rows, order[:, None], axis=-1),
        gap=jnp.take_along_axis(s.gap, order, axis=-1),
        level=level,
    )


def _begin(layout: Layout, s: System, start: jax.Array, seated: jax.Array, steps: jax.Array) -> State:
    """At the start that is given; where that is NaN at zero, before the linear step."""
    lanes = seated.shape[0]
    start = jnp.broadcast_to(start, (layout.unknowns, lanes))
    warm = jnp.all(jnp.isfinite(start), axis=0)
    q = jnp.where(warm[None], start, 0)
    lane = fresh(lanes, start.dtype)
    lane = lane._replace(steps=steps, cold=~warm & (s.load != 0), given=warm, open=seated)
    return State(q, q, jnp.zeros_like(q), *packed(lane, start.dtype))


def _overloaded(s: System, depth: jax.Array) -> jax.Array:
    return folded(depth >= laws.largest_depth(s.compliance[None], s.level), 0, 1, by=jnp.logical_or)


def _iterate(layout: Layout, s: System, state: State, leave: jax.Array, again: jax.Array) -> State:
    """Steps of all open cases until no more than `leave` are open; `again`: in the second round."""
    limit = jnp.where(again, MAX_STEPS, _DIRECT)
    # A part sums up to some ten contacts, each with its rounding: a case above that after 80 steps never gets below.
    slack = jnp.where(again, 8.0, 1.0).astype(state.q.dtype)
    lanes = state.q.shape[-1]
    eps = float(jnp.finfo(state.q.dtype).eps)
    tolerance = max(1e-13, 32 * eps)  # of the largest force
    stiffest = _most(s.bearing_stiffness, s.gear_stiffness)
    widest = _most(s.gap, s.gear_gap, s.bearing_gap)
    # The linear start: a slope for the mean force of the working pins, half of all, with the mean of their levers.
    lever = jnp.sum(jnp.abs(s.rows[2]), axis=(0, 1)) / 2
    typical = laws.typical_slope(layout.law, (jnp.abs(s.load) / lever)[None, None], s.compliance[None], s.level)
    working = jnp.where((s.rows[2] < 0) == (s.load > 0)[None, None], typical, 0)
    driving = jnp.broadcast_to(jnp.stack([s.load > 0, s.load <= 0])[None], (layout.cranks, 2, s.load.shape[-1]))

    at_rest = frame(layout, s)

    def law(depth: jax.Array, level: jax.Array | None) -> tuple[jax.Array, jax.Array]:
        force = laws.force(layout.law, depth, s.compliance[None], level)
        return force, laws.slope(layout.law, depth, force, s.compliance[None])

    def pressed(q: jax.Array, cold: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Depths, forces and slopes of the pins; those that the torque does not press are rarely pressed at all."""
        depth = depths(layout, s, q)
        if layout.law == "linear":
            force, slope = law(depth, None)
        else:
            half = layout.pins // 2 + 1
            level = depth if s.level is None else s.level  # read by the hertz contact law only
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

    def judged(q: jax.Array, step: jax.Array, cold: jax.Array, at: Contacts, g: jax.Array, newton: jax.Array) -> Judged:
        value = energy(layout, s, q, at)
        size, miss = _most(at.pins, at.gear, at.bearing.force), _most(g)
        rounding = stiffest * jnp.maximum(widest, _most(q))
        over = _overloaded(s, at.depth) if layout.law == "hertz" else jnp.zeros((lanes,), bool)
        return Judged(
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

    def body(state: State) -> State:
        q, cold = state.q, unpacked(state.lanes, state.marks).cold
        depth, pins, slope = stored(pressed, q, cold)
        gear_depth, gear, gear_slope, held = stored(joined, q, cold)
        at = Contacts(depth, pins, gear_depth, gear, held)
        g = stored(lambda q, at: gradient(layout, s, q, at), q, at)
        square = stored(lambda *of: hessian(layout, s, *of), at, slope, gear_slope, at_rest)
        newton = stored(lambda square, g: -solve(layout, square, g), square, g)
        found = stored(judged, q, state.step, cold, at, g, newton)
        numbers, marks = stored(decided, state.lanes, state.marks, found, limit)
        q, best, step = stored(onward, state, newton, numbers, marks)
        return State(q, best, step, numbers, marks)

    return jax.lax.while_loop(lambda state: jnp.sum(is_open(state), dtype=leave.dtype) > leave, body, state)


def _most(*values: jax.Array) -> jax.Array:
    """Largest absolute value of each batch element."""
    largest = [folded(jnp.abs(value), *range(value.ndim - 1), by=jnp.maximum) for value in values]
    return functools.reduce(jnp.maximum, largest)
