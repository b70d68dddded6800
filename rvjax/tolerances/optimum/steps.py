"""Search with costly units: programmes on followed units, each within a box about the vector where all are solved.

A programme on followed units costs next to nothing. At its end all units are solved again. The step is taken where cost
and excess together fall; otherwise the box shrinks. The search ends with a step that is short, or that gains little.

Flat places of the least cost: how far a number can be from its best value at little more cost.

One number is held off its best value and the others are chosen again. The cost that this adds is modelled by its slope
(the price of an active bound) and a curvature, which the last such search corrects.
"""

import functools
import math
from collections.abc import Callable

import numpy as np

from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.local import Local
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.programme import MET, End, Programme

FIRST = 0.7
"""Size of the first box of a search, in reaches."""

CLOSE = 0.3
"""The same of a search that begins at the end of another one."""

_MOST = 6  # vectors where units are solved, in one search
_LOOKS = 30  # vectors of one programme on followed units
_LEAST, _LARGEST = 0.1, 1.4  # sizes of boxes
_SHORT = 0.08  # of a step, in reaches, within which followed units are as good as solved ones
_LITTLE = 5e-3  # gain, as a part of the cost
_GOOD, _POOR = 0.7, 0.25  # parts of a promised gain


def followed(
    margins: Margins,
    look: Callable[[np.ndarray], Local],
    low: np.ndarray,
    high: np.ndarray,
    start: np.ndarray,
    most: int,
    curvature: np.ndarray | None = None,
    anchors: int = _MOST,
    size: float = FIRST,
) -> End:
    """The cheapest vector from a start on.

    Args:
        margins: whose units are solved or followed.
        look: evaluates a vector by these.
        low: (n,) bounds.
        high: (n,) bounds.
        start: (n,) vector.
        most: vectors to evaluate, in one programme.
        curvature: (n, n) of an earlier search nearby.
        anchors: vectors at which units are solved, at most.
        size: of the first box, in reaches.
    """
    reach = margins.decisions.reach
    x = np.clip(start, low, high)
    if far(margins, x):
        margins.follow(x)
    solved, first, least = 1, size, _LEAST * (size / FIRST) ** 2
    assert margins.anchor is not None
    here = look(margins.anchor.x)
    while True:
        at = margins.anchor
        inside = _box(at.x, size * reach, low, high)
        end = Programme(look, *inside, reach, min(most, _LOOKS)).run(x, min(size, 1.0), curvature)
        curvature, x = end.curvature, end.point.x
        elastic = 2 * end.prices
        promised = _merit(here, elastic) - _merit(end.point, elastic)
        if _length(x - at.x, reach) <= _SHORT or promised <= _LITTLE * abs(here.total) or solved >= anchors:
            return end
        margins.follow(x)
        solved += 1
        there = look(x)
        gained = _merit(here, elastic) - _merit(there, elastic)
        if gained > _POOR * promised:
            here = there
            size = min(_LARGEST, 2 * size) if gained > _GOOD * promised else size
            continue
        tried = _length(x - at.x, reach)
        margins.anchor, x = at, at.x
        size = (size if first == FIRST else min(size, tried)) / 2
        if size < least:
            return Programme(look, *inside, reach, 1).run(x, size, curvature)


def far(margins: Margins, x: np.ndarray) -> bool:
    """True if units at a vector do not follow from where they are solved nearby."""
    return margins.anchor is None or _length(x - margins.anchor.x, margins.decisions.reach) > _SHORT


def _box(x: np.ndarray, room: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.maximum(low, x - room), np.minimum(high, x + room)


def _length(step: np.ndarray, reach: np.ndarray) -> float:
    return float(np.abs(step / reach).max(initial=0.0))


def _merit(point: Local, elastic: np.ndarray) -> float:
    excess = np.maximum(np.where(np.isfinite(point.margins), point.margins, 1e6), 0.0)
    return point.total + float(elastic @ excess)


WITHIN = 0.005
"""Part of the cost that a number off its best value may add."""

_OFF = 0.05  # part of its range by which a number is first held off
_TRIALS = 4  # searches for one end of a range, at most
_CLOSE = 0.15  # of the added cost, by which the end of a range may miss it
_NEAR = 3.0  # times more or less than allowed, from where the model of costly units gives the end of a range
_LOOKS_RANGE = 12  # vectors of one search, at most
_HELD = ((1, 0.15),)  # vectors where costly units are solved, and size of the box, for a number that is held
_BEST = (2, 0.15), (2, 0.05)  # the same for its best value
_RADIUS, _SETTLED_RANGE = 0.2, 1e-4  # of its first step and of its end


def ranges(
    margins: Margins, decisions: Decisions, end: End, low: np.ndarray, high: np.ndarray, most: float = math.inf
) -> dict[str, tuple[float, float]]:
    """{number: (least, largest) value with which the least cost stays within `WITHIN`}.

    Args:
        margins: on a sample that these searches share.
        decisions: whose vectors these are.
        end: of the search for the best.
        low: (n,) bounds of its vector.
        high: (n,) bounds of its vector.
        most: costly units to solve, which are followed in `margins`; numbers for which no units are left are not in
            the result.
    """
    before, costly = margins.evaluated, margins.anchor is not None

    def solved(x: np.ndarray, k: int | None = None, part: float = 0.0) -> End:
        least, greatest, start, at = low.copy(), high.copy(), x.copy(), margins.anchor
        if k is not None:
            least[k] = greatest[k] = start[k] = part
        if at is None:
            search = Programme(margins.look, least, greatest, decisions.reach, _LOOKS_RANGE, settled=_SETTLED_RANGE)
            return search.run(start, _RADIUS, end.curvature)
        margins.anchor = None
        for anchors, size in _HELD if k is not None else _BEST:
            there = followed(margins, margins.look, least, greatest, start, _LOOKS, end.curvature, anchors, size)
            start = there.point.x
        margins.anchor = at if k is not None else margins.anchor
        return there

    best = solved(end.point.x)
    allowed = WITHIN * abs(best.point.total)
    found = {name: (value, value) for name, value in decisions.values(best.point.x).items()}
    done = 0
    for k, name in enumerate(decisions.free, len(decisions.fields) + len(decisions.moves)):
        if low[k] == high[k]:
            continue
        if done and (margins.evaluated - before) * (1 + 1 / done) > most:
            del found[name]
            continue
        item, ends, way, done = decisions.variables[name], [], _OFF, done + 1
        for sign, limit, slope in ((-1.0, low[k], best.at_high[k]), (1.0, high[k], best.at_low[k])):
            at = float(best.point.x[k])
            held = functools.partial(solved, best.point.x, k)
            first = way if costly and way > 0 else _OFF
            way = _way(held, best, at, sign, abs(float(limit) - at), float(slope), allowed, first, costly)
            there = min(max(float(end.point.x[k]) + sign * way, 0.0), 1.0) if costly else at + sign * way
            ends.append(item.lower + there * (item.upper - item.lower))  # few costly units have another best value
        found[name] = min(ends), max(ends)
    return found


def _way(
    solved: Callable[[float], End],
    best: End,
    at: float,
    sign: float,
    most: float,
    slope: float,
    allowed: float,
    first: float = _OFF,
    costly: bool = False,
) -> float:
    """Distance at which the least cost has grown by `allowed`, or `most`; `costly`: the model gives it soon."""
    if most <= 0:
        return 0.0
    inner, outer, way = 0.0, math.inf, min(first, most)
    for _ in range(_TRIALS):
        there = solved(at + sign * way)
        if there.excess > 10 * MET:
            outer, way = way, (inner + way) / 2
            continue
        added = there.point.total - best.point.total
        if abs(added - allowed) <= _CLOSE * allowed or (way == most and added <= allowed):
            return way if way < most else most
        inner, outer = (way, outer) if added < allowed else (inner, way)
        bend = max(2 * (added - slope * way) / way**2, 1e-3 * allowed)
        new = (math.sqrt(slope**2 + 2 * bend * allowed) - slope) / bend
        new = min(max(new, way / 4), 8 * way, most)
        way = new if inner < new < outer else (inner + min(outer, most)) / 2 if math.isfinite(outer) else most
        if costly and allowed / _NEAR <= added <= _NEAR * allowed:
            break
    return min(way, most)
