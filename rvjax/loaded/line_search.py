"""Points of Newton's method: start of a single-stage drive, length of its steps, and the choice of the next point.

Full steps, until some of them have brought no new lowest energy; then the element returns to its best point and
searches the line from there between two slopes.

One to three pins of a drive carry. A linear start closes half of all, and Newton's method opens them again in turns;
where a disc then touches nothing, its step ends at the centring springs. Here every disc starts where the first of its
pins and holes touch, on the side of its bearing that these press, and a step ends where the first contact that it
closes carries the load alone. Arrays have the batch axis last.
"""

import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import folded, stored
from rvjax.loaded import laws
from rvjax.loaded.system import Contacts, Layout, System, depths, displaced, groups

PATIENCE, OF_DRIVES = 8, 20
"""Full steps without a new lowest energy. With 8 a drive at 3 % of its torque takes a third more points; with 20 one of
8,192 units of `rv-40e-whole` does not converge."""
SEARCHES = 30  # points on a line at most


class Best(NamedTuple):
    """Merit of the best point, each (l,)."""

    energy: jax.Array  # inf: there is none yet
    slope: jax.Array  # of the energy along Newton's step from there, < 0


class Line(NamedTuple):
    """Bracket on Newton's step from the best point: shares of the step and slopes there, < 0 at the lower end."""

    full_slope: jax.Array  # after the full step
    lower: jax.Array
    lower_slope: jax.Array
    upper: jax.Array
    upper_slope: jax.Array
    share: jax.Array  # of the next point


class Reached(NamedTuple):
    """Values of the last point for the result."""

    residual: jax.Array  # gradient over the largest force
    largest: jax.Array  # force on a disc


class Counts(NamedTuple):
    """Integers."""

    stall: jax.Array  # points since the best
    steps: jax.Array


class Phase(NamedTuple):
    """Marks: what the next point is."""

    searching: jax.Array  # a point of the line
    cold: jax.Array  # zero, before the linear step
    open: jax.Array  # there is one
    better: jax.Array  # the last point is the best


class End(NamedTuple):
    """Marks of the result."""

    converged: jax.Array
    overload: jax.Array  # a pin or joint beyond its contact law
    finite: jax.Array


class Element(NamedTuple):
    """All of a batch element but its displacements, each (l,)."""

    best: Best
    line: Line
    reached: Reached
    counts: Counts
    phase: Phase
    end: End


_NUMBERS, _INTEGERS = (Best, Line, Reached), (Counts, Phase, End)  # of an element, in this order


class Rows(NamedTuple):
    """Elements as two arrays, because XLA copies every array of a loop: a step has 18 copies, with one array for each
    field 68, next to about 90 kernels (counted in the compiled program, not timed)."""

    numbers: jax.Array  # (10, l)
    integers: jax.Array  # (9, l)

    @classmethod
    def of(cls, element: Element) -> "Rows":
        """Rows of elements."""
        size, dtype = element.phase.open.shape, element.line.share.dtype
        numbers = [jnp.broadcast_to(x, size).astype(dtype) for x in itertools.chain(*element[:3])]
        integers = [jnp.broadcast_to(x, size).astype(jnp.int32) for x in itertools.chain(*element[3:])]
        return cls(jnp.stack(numbers), jnp.stack(integers))

    @property
    def element(self) -> Element:
        """The elements again."""
        counts = len(Counts._fields)
        rows = itertools.chain(self.numbers, self.integers[:counts], self.integers[counts:] != 0)
        groups = (cls(*itertools.islice(rows, len(cls._fields))) for cls in (*_NUMBERS, *_INTEGERS))
        return Element(*groups)  # type: ignore[arg-type]


class State(NamedTuple):
    """State of a block."""

    q: jax.Array  # (n, l); the last point once an element is not open
    best: jax.Array  # (n, l)
    step: jax.Array  # (n, l) Newton's step from the best point
    rows: Rows

    @property
    def phase(self) -> Phase:
        """Marks of the elements."""
        return self.rows.element.phase


class Merit(NamedTuple):
    """Values at a point, each (l,)."""

    energy: jax.Array
    miss: jax.Array  # largest component of the gradient
    size: jax.Array  # largest force
    largest: jax.Array  # force on a disc
    along: jax.Array  # slope along the step from the best point
    slope: jax.Array  # and along Newton's step from here
    small: jax.Array  # the gradient is
    fine: jax.Array  # all is finite
    over: jax.Array  # a pin or joint is beyond its contact law


def begun(q: jax.Array, seated: jax.Array, cold: jax.Array, steps: jax.Array) -> State:
    """State before the first step.

    Args:
        q: first point (n, l).
        seated: (l,) there is a case.
        cold: (l,) it begins with the linear step.
        steps: (l,) of rounds before.
    """
    zero, no = jnp.zeros(seated.shape, q.dtype), jnp.zeros(seated.shape, bool)
    element = Element(
        best=Best(zero + jnp.inf, zero),
        line=Line(*[zero] * len(Line._fields)),
        reached=Reached(zero, zero),
        counts=Counts(jnp.zeros(seated.shape, jnp.int32), steps),
        phase=Phase(searching=no, cold=cold, open=seated, better=no),
        end=End(no, no, no),
    )
    return State(q, q, jnp.zeros_like(q), Rows.of(element))


def decided(last: Element, at: Merit, limit: jax.Array, patience: int) -> Element:
    """Every element after a point.

    Args:
        last: before it.
        at: the point.
        limit: steps at most.
        patience: full steps without a new lowest energy.
    """
    best, phase, stall = last.best, last.phase, last.counts.stall
    live, cold, searching = phase.open, phase.cold, phase.searching
    usable = at.fine & (~at.over | (at.energy < best.energy))  # beyond the contact law if it is better there
    done = at.fine & at.small & ~cold
    failed = jnp.isinf(best.energy) & ~usable & ~cold

    # A full step is better where the energy is the lowest. A point of the line is where its slope is small, too.
    lower = usable & (at.energy < best.energy)
    slope = jnp.where(usable, at.along, jnp.inf)
    flat = jnp.abs(slope) <= 0.1 * jnp.abs(best.slope)
    exhausted = stall >= patience + SEARCHES
    better = ~cold & jnp.where(searching, (flat & (lower | (slope <= 0))) | exhausted, lower)
    full_slope = jnp.where(stall == 0, slope, last.line.full_slope)
    stall = jnp.where(better | cold, 0, stall + 1)
    enters = ~better & ~searching & ((stall >= patience) | (~usable & ~cold))
    steps = last.counts.steps + (~(done | cold | searching)).astype(jnp.int32)  # points of a line are none
    return Element(
        best=Best(jnp.where(better, at.energy, best.energy), jnp.where(better, at.slope, best.slope)),
        line=_narrowed(last, slope, full_slope, enters),
        reached=Reached(
            residual=jnp.where(live, at.miss / jnp.where(at.size > 0, at.size, 1), last.reached.residual),
            largest=jnp.where(live, at.largest, last.reached.largest),
        ),
        counts=Counts(stall, jnp.where(live, steps, last.counts.steps)),
        phase=Phase(
            searching=~better & (searching | enters),
            cold=jnp.zeros_like(cold),
            open=live & ~done & ~failed & (steps < limit),
            better=better,
        ),
        end=End(
            converged=jnp.where(live, done & ~at.over, last.end.converged),
            overload=jnp.where(live, at.over & ~cold, last.end.overload),
            finite=jnp.where(live, ~failed, last.end.finite),
        ),
    )


def _narrowed(last: Element, slope: jax.Array, full_slope: jax.Array, enters: jax.Array) -> Line:
    """The bracket after a point of the given slope: the whole step where the search begins there."""
    line = last.line
    down = slope < 0
    lower = jnp.where(enters, 0, jnp.where(down, line.share, line.lower))
    # The end that stays counts with half of its slope (Illinois), else a steep end holds the points on its own side.
    lower_slope = jnp.where(enters, last.best.slope, jnp.where(down, slope, line.lower_slope / 2))
    upper = jnp.where(enters, 1, jnp.where(down, line.upper, line.share))
    upper_slope = jnp.where(enters, full_slope, jnp.where(down, line.upper_slope / 2, slope))
    bracketed = jnp.isfinite(upper_slope) & (upper_slope > 0)
    rise = jnp.where(bracketed, upper_slope - lower_slope, 1)
    secant = jnp.where(bracketed, jnp.clip(-lower_slope / rise, 0.25, 0.75), 0.25)
    return Line(full_slope, lower, lower_slope, upper, upper_slope, lower + (upper - lower) * secant)


def onward(last: State, newton: jax.Array, element: Element) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Next point of every open element, its best point and the step from there; the final point once it has ended.

    Args:
        last: the state before.
        newton: Newton's step from its point (n, l).
        element: after that point.
    """
    phase = element.phase
    best, step = (jnp.where(phase.better[None], new, old) for new, old in ((last.q, last.best), (newton, last.step)))
    whole = last.q + newton
    # Without a best point there is no finite energy: such an element has failed.
    # In float32 what the last step would balance is rounding: divided by a centring spring it crosses the clearance.
    exact = whole if jnp.finfo(whole.dtype).eps < 1e-8 else last.q
    ended = jnp.where(element.end.converged[None], exact, jnp.where(jnp.isinf(element.best.energy)[None], 0, best))
    point = jnp.where(phase.searching[None], best + element.line.share[None] * step, whole)
    point = jnp.where(phase.cold[None], 0, point)
    return jnp.where(last.phase.open[None], jnp.where(phase.open[None], point, ended), last.q), best, step


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
