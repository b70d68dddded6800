"""The minimum of the energy: Newton's method for many cases at once, batch axis last.

It begins with the contacts that a torque of this sign closes, linear and without clearance; a drive begins where its
parts touch, and its steps are shortened (`touching`). Then full steps; only after eight, of a drive twenty, without a
new lowest energy a case returns to its best point and searches the line from there (its slope is monotone, because the
energy is convex). An immediate search fails where a journal slides round its clearance: it leaves the circle by the
second order, so that the energy of good steps rises for a while.

A block has a fixed number of places. Once half of its cases are done, waiting cases replace them, so that slow
cases do not delay the others. The last cases of a wide block, as a GPU has it, go on in a narrow one from their best
points: of a thousand equilibria at 3 % of the rated torque one takes 120 points, but half of all take 9.
"""

import functools
from collections.abc import Iterator
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax._jax.kernels import folded, stored
from rvjax._jax.sizes import EQUILIBRIA
from rvjax.loaded import laws
from rvjax.loaded.hessian import Frame, frame, hessian, solve
from rvjax.loaded.interior import approach
from rvjax.loaded.line_search import (
    OF_DRIVES,
    PATIENCE,
    Merit,
    Rows,
    State,
    begun,
    decided,
    onward,
    shortened,
    touching,
)
from rvjax.loaded.system import (
    Contacts,
    Held,
    Layout,
    Limits,
    Pressed,
    System,
    depths,
    displaced,
    energy,
    gradient,
    held,
    largest_depths,
    pressed_joints,
    pressed_pins,
    typical_joint_slopes,
)

Tree = TypeVar("Tree")

MAX_STEPS = 300
DIRECT = 80  # of them before the interior point method
_WIDE = 1024  # places; a wider block is left by its last cases
_LAST = 16  # one of so many places is open then


class Minimum(NamedTuple):
    """Result of the iteration; in this module with the batch axis last."""

    q: jax.Array  # (n, l)
    steps: jax.Array  # (l,)
    residual: jax.Array  # (l,) gradient over the largest force
    largest: jax.Array  # (l,) force of any pin or joint on a disc, N
    converged: jax.Array  # (l,)
    overload: jax.Array  # (l,) a pin or joint beyond its contact law at the last point
    finite: jax.Array  # (l,)

    @classmethod
    def shapes(cls, layout: Layout, dtype: DTypeLike) -> "Minimum":
        """Shapes and dtypes of one case."""
        vector = jax.ShapeDtypeStruct((layout.unknowns,), dtype)
        kinds = jnp.int32, dtype, dtype, bool, bool, bool
        return cls(vector, *(jax.ShapeDtypeStruct((), kind) for kind in kinds))  # type: ignore[arg-type]


class _Tour(NamedTuple):
    """State of all cases between two rounds. In the second round each begins near its minimum."""

    number: jax.Array  # of the round
    queued: jax.Array  # (cases,) to be solved in it
    start: jax.Array  # (cases or 1, n)
    found: Minimum  # cases first


class _Block(NamedTuple):
    """State within a round. The queue is the list of the queued cases; each has a place of the block for a while."""

    turn: jax.Array  # (width,) number in the queue of the case at each place
    state: State
    next: jax.Array  # number in the queue of the first case without a place so far
    found: Minimum  # cases first


def minimise(layout: Layout, system: System, start: jax.Array) -> Minimum:
    """The minimum of the energy of every case; leaves of the result have the cases first.

    Args:
        layout: counts and methods.
        system: leaves (cases or 1, ...).
        start: (cases or 1, n); NaN for none, inf for a case that is not solved.
    """
    cases = max(len(leaf) for leaf in jax.tree.leaves((system, start)))
    if layout.law != "linear":
        system = _working_first(system)
    width = min(cases, EQUILIBRIA.here)

    def goes_on(tour: _Tour) -> jax.Array:
        return (tour.number == 0) | ((tour.number == 1) & jnp.any(tour.queued))

    dtype = start.dtype
    zero, no, none = jnp.zeros((cases,), dtype), jnp.zeros((cases,), bool), jnp.zeros((cases,), jnp.int32)
    nothing = Minimum(jnp.zeros((cases, layout.unknowns), dtype), none, zero, zero, no, no, no)
    solved = jnp.broadcast_to(~jnp.any(jnp.isinf(start), axis=1), (cases,))
    tour = _Tour(jnp.int32(0), solved, start, nothing)
    if width > _WIDE:
        tour, width = _round(layout, system, tour, width, last=width // _LAST), width // _LAST
    if not layout.interior:
        return _round(layout, system, tour, width).found
    return jax.lax.while_loop(goes_on, lambda tour: _round(layout, system, tour, width), tour).found


def _working_first(s: System) -> System:
    """The pins of every disc from another one on: those first that the torque presses, half of the circle.

    They lie on one side of the line through the centres of ring and disc. Sorting by the lever took 4.6 of the 19 us of
    a case with a geometry of its own.
    """
    pins, count = s.pins, s.pins.rows.shape[-1]
    pressed = pins.rows[:, 2] * s.load[:, None, None] < 0
    first = jnp.argmax(pressed & ~jnp.roll(pressed, 1, axis=-1), axis=-1)
    order = (first[..., None] + np.arange(count)[None, None]) % count
    level = None if pins.level is None else jnp.take_along_axis(pins.level, order, axis=-1)
    rows = jnp.take_along_axis(pins.rows, order[:, None], axis=-1)
    return s._replace(pins=pins._replace(rows=rows, gap=jnp.take_along_axis(pins.gap, order, axis=-1), level=level))


def _round(layout: Layout, system: System, tour: _Tour, width: int, last: int = 0) -> _Tour:
    """Every case of the queue, as many at a time as a block has places; up to `last` are left to a narrower block."""
    cases = len(tour.queued)
    (queue,) = jnp.nonzero(tour.queued, size=cases, fill_value=cases)
    many, again = jnp.sum(tour.queued, dtype=jnp.int32), tour.number > 0

    def seated(turn: jax.Array, empty: jax.Array) -> tuple[jax.Array, System, State]:
        """Case at each place (`cases` for none), its system, and the state in which it begins."""
        index = queue.at[turn].get(mode="fill", fill_value=cases)
        part, begin, steps = take((system, tour.start, tour.found.steps), jnp.minimum(index, cases - 1))
        gap = jnp.broadcast_to(part.pins.gap, (*part.pins.gap.shape[:-1], width))
        part = part._replace(pins=part.pins._replace(gap=gap))
        taken = turn < many
        begin = jnp.broadcast_to(begin, (layout.unknowns, width))
        if layout.interior:
            begin, more = jax.lax.cond(
                again,
                lambda: approach(layout, part, taken & empty),
                lambda: (begin, jnp.zeros((width,), jnp.int32)),
            )
            steps = steps + more
        return index, part, _begin(layout, part, begin, taken, steps)

    def unfinished(block: _Block) -> jax.Array:
        return (jnp.sum(block.state.phase.open) > last) | (block.next < many)

    def refill(block: _Block) -> _Block:
        """Give the places of ended cases to the next of the queue, and go on until there are places to give again."""
        free = ~block.state.phase.open
        turn = jnp.where(free, block.next + jnp.cumsum(free, dtype=jnp.int32) - 1, block.turn)
        following = block.next + jnp.sum(free, dtype=jnp.int32)
        index, part, fresh = seated(turn, free)
        state = jax.tree.map(lambda new, old: jnp.where(free, new, old), fresh, block.state)
        # A refill waits for half of the places; without a queue all cases but the last run to their end.
        leave = jnp.where(following < many, width // 2, last).astype(jnp.int32)
        state = _iterate(layout, part, state, leave, again)
        # Cases that are still open are written, too: their last values come later. Places without a case write nothing.
        found = jax.tree.map(
            lambda all_, new: all_.at[index].set(jnp.moveaxis(new, -1, 0), mode="drop"), block.found, _found(state)
        )
        return _Block(turn, state, following, found)

    turn = jnp.zeros((width,), jnp.int32)
    shapes = jax.eval_shape(lambda: seated(turn, turn == 0)[2])
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)  # not open: every place is free
    block = jax.lax.while_loop(unfinished, refill, _Block(turn, empty, jnp.int32(0), tour.found))
    found, state = block.found, block.state
    if last:
        index = jnp.where(state.phase.open, queue[block.turn], cases)
        best = jnp.broadcast_to(tour.start, found.q.shape).at[index].set(state.best.T, mode="drop")
        return _Tour(tour.number, jnp.zeros_like(tour.queued).at[index].set(True, mode="drop"), best, found)
    lost = ~found.converged & found.finite & (found.steps >= DIRECT)
    return _Tour(tour.number + 1, lost, tour.start, found)


def _begin(layout: Layout, s: System, start: jax.Array, seated: jax.Array, steps: jax.Array) -> State:
    """At the start that is given. Where that is NaN, a drive where its parts touch, others at zero before the linear
    step."""
    warm = jnp.all(jnp.isfinite(start), axis=0)
    drive = not layout.links
    other = stored(functools.partial(touching, layout), s) if drive else jnp.zeros_like(start)
    cold = ~warm & (s.load != 0) & (not drive)
    return begun(jnp.where(warm[None], start, other), seated, cold, steps)


def _found(state: State) -> Minimum:
    element = state.rows.element
    return Minimum(state.q, element.counts.steps, *element.reached, *element.end)


class _Shared(NamedTuple):
    """Numbers that all steps of a block share."""

    layout: Layout
    s: System
    at_rest: Frame
    pins: jax.Array  # (d, p, l) slopes of the linear start: of contacts that a torque of this sign closes, else 0
    joints: jax.Array  # (j, l)
    stiffest: jax.Array  # (l,) of all springs, N/m
    widest: jax.Array  # (l,) of all gaps, m
    slack: jax.Array  # () factor on the largest gradient of a minimum
    most: Limits  # computed once: each is an exponential


def _shared(layout: Layout, s: System, again: jax.Array) -> _Shared:
    """Linear slopes are those at the mean force of the working contacts, half of all, with the mean of their levers."""
    pins, joints = s.pins, typical_joint_slopes(layout, s)
    force = jnp.abs(s.load) / (jnp.sum(jnp.abs(pins.rows[2]), axis=(0, 1)) / 2)
    typical = laws.typical_slope(layout.law, force[None, None], pins.compliance[None], pins.level)
    return _Shared(
        layout,
        s,
        at_rest=frame(layout, s),
        pins=jnp.where((pins.rows[2] < 0) == (s.load > 0)[None, None], typical, 0),
        joints=jnp.where((s.joints.lever < 0) == (s.load > 0)[None], joints, 0),
        stiffest=_most(s.bearings.stiffness, joints),
        widest=_most(pins.gap, s.joints.gap, s.bearings.gap),
        # A body sums up to some ten contacts, each with its rounding: a case above that after 80 steps stays there.
        slack=jnp.where(again, 8.0, 1.0).astype(pins.gap.dtype),
        most=stored(lambda s: largest_depths(layout, s), s),
    )


def _iterate(layout: Layout, s: System, state: State, leave: jax.Array, again: jax.Array) -> State:
    """Steps of all open cases until no more than `leave` are open; `again`: in the second round."""
    limit, of = jnp.where(again, MAX_STEPS, DIRECT), _shared(layout, s, again)
    patience = PATIENCE if layout.links else OF_DRIVES

    def body(state: State) -> State:
        q, cold = state.q, state.phase.cold
        pins = stored(functools.partial(_pressed, of), q, cold)
        joints, bearings = stored(functools.partial(_jointed, of), q, cold)
        at = Contacts(pins, joints, bearings)
        g = stored(lambda q, at: gradient(layout, s, q, at), q, at)
        square = stored(lambda at, at_rest: hessian(layout, s, at, at_rest), at, of.at_rest)
        newton = stored(lambda square, g: -solve(layout, square, g), square, g)
        size = stored(lambda at: _most(at.pins.force, at.joints.force, at.bearings.force), at)
        if not layout.links:
            newton = stored(functools.partial(shortened, layout, s), q, at, size, newton)
        merit = stored(functools.partial(_merit, of), q, state.step, cold, at, size, g, newton)
        rows = stored(
            lambda rows, at, limit: Rows.of(decided(rows.element, at, limit, patience)), state.rows, merit, limit
        )
        q, best, step = stored(lambda state, newton, rows: onward(state, newton, rows.element), state, newton, rows)
        return State(q, best, step, rows)

    return jax.lax.while_loop(lambda state: jnp.sum(state.phase.open, dtype=leave.dtype) > leave, body, state)


def _pressed(of: _Shared, q: jax.Array, cold: jax.Array) -> Pressed:
    """The pins; those that the torque does not press are rarely pressed at all."""
    layout, s, half = of.layout, of.s, of.layout.pins // 2 + 1
    depth = depths(layout, s, q)
    if layout.law == "linear":
        return _started(pressed_pins(layout, s, depth), of.pins, cold[None, None])

    def law(depth: jax.Array, level: jax.Array) -> tuple[jax.Array, jax.Array]:
        _, force, slope = pressed_pins(layout, s._replace(pins=s.pins._replace(level=level)), depth)
        return force, slope

    level = depth if s.pins.level is None else s.pins.level  # read by the hertz contact law only
    near = stored(law, depth[:, :half], level[:, :half])
    far = jax.lax.cond(
        jnp.any(depth[:, half:] > 0),
        law,
        lambda depth, _: (jnp.zeros_like(depth), jnp.zeros_like(depth)),
        *(depth[:, half:], level[:, half:]),
    )
    force, slope = (jnp.concatenate(both, axis=1) for both in zip(near, far))
    return _started(Pressed(depth, force, slope), of.pins, cold[None, None])


def _jointed(of: _Shared, q: jax.Array, cold: jax.Array) -> tuple[Pressed, Held]:
    """The joints, and the bearings, before the linear step without clearance."""
    depth, w = displaced(of.s, q)
    shut = of.s.bearings._replace(clearance=jnp.where(cold, 0, of.s.bearings.clearance))
    return _started(pressed_joints(of.layout, of.s, depth), of.joints, cold[None]), held(w, shut)


def _started(at: Pressed, slope: jax.Array, cold: jax.Array) -> Pressed:
    """Contacts, linear with the given slopes in a case before its linear step."""
    return Pressed(at.depth, jnp.where(cold, slope * at.depth, at.force), jnp.where(cold, slope, at.slope))


def _merit(
    of: _Shared,
    q: jax.Array,
    step: jax.Array,
    cold: jax.Array,
    at: Contacts,
    size: jax.Array,
    g: jax.Array,
    newton: jax.Array,
) -> Merit:
    value, eps = energy(of.layout, of.s, q, at, of.most), float(jnp.finfo(q.dtype).eps)
    miss = _most(g)
    rounding = 2 * eps * (of.stiffest * jnp.maximum(of.widest, _most(q)))
    on_discs = [at.joints.force[part] for group, part in of.layout.parts(of.layout.joints) if group.discs]
    over = [_any(depth >= limit) for depth, limit in _limited(of, at)]
    return Merit(
        energy=value,
        miss=miss,
        size=size,
        largest=_most(at.pins.force, *on_discs),
        along=folded(step * g, 0),
        slope=folded(newton * g, 0),
        small=miss <= of.slack * jnp.maximum(max(1e-13, 32 * eps) * size, rounding),
        fine=jnp.isfinite(value) & folded(jnp.isfinite(newton), 0, by=jnp.logical_and),
        over=functools.reduce(jnp.logical_or, over, jnp.zeros_like(cold)),
    )


def _limited(of: _Shared, at: Contacts) -> Iterator[tuple[jax.Array, jax.Array]]:
    """Depths of the contacts whose contact law has a largest depth, and that depth."""
    if of.most.pins is not None:
        yield at.pins.depth, of.most.pins
    for group, part in of.layout.parts(of.layout.joints):
        if group.law == "hertz":
            yield at.joints.depth[part], of.most.joints[part]


def _any(marks: jax.Array) -> jax.Array:
    return folded(marks, *range(marks.ndim - 1), by=jnp.logical_or)


def _most(*values: jax.Array) -> jax.Array:
    """Largest absolute value of each batch element."""
    largest = [folded(jnp.abs(value), *range(value.ndim - 1), by=jnp.maximum) for value in values]
    return functools.reduce(jnp.maximum, largest)


def take(tree: Tree, index: jax.Array) -> Tree:
    """The cases `index` of leaves (cases or 1, ...), batch axis last; a shared leaf keeps length 1."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf if len(leaf) == 1 else leaf[index], 0, -1), tree)
