"""State of one batch element of Newton's method, and the choice of its next point.

Full steps, until some of them have brought no new lowest energy; then the element returns to its best point and
searches the line from there between two slopes.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp

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
