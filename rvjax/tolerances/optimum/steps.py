"""Search with costly units: programmes on followed units, each within a box about the vector where all are solved.

A programme on followed units costs next to nothing. At its end all units are solved again. The step is taken where cost
and excess together fall; otherwise the box shrinks. The search ends with a step that is short, or that gains little.

Starts of a search: valleys of a cost are looked into on a small sample.

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

_MOST = 6  # vectors where units are solved, in one search
_LOOKS = 30  # vectors of one programme on followed units
_FIRST, _LEAST = 0.7, 0.1  # size of the box, in reaches
_LARGEST = 1.4
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
    """
    reach = margins.decisions.reach
    x = np.clip(start, low, high)
    if margins.anchor is None or _length(x - margins.anchor.x, reach) > _SHORT:
        margins.follow(x)
    size, solved = _FIRST, 1
    assert margins.anchor is not None
    here = look(margins.anchor.x)
    while True:
        at = margins.anchor
        inside = np.maximum(low, at.x - size * reach), np.minimum(high, at.x + size * reach)
        end = Programme(look, *inside, reach, min(most, _LOOKS)).run(x, min(size, 1.0), curvature)
        curvature, x = end.curvature, end.point.x
        elastic = 2 * end.prices
        promised = _merit(here, elastic) - _merit(end.point, elastic)
        if _length(x - at.x, reach) <= _SHORT or promised <= _LITTLE * abs(here.total) or solved >= _MOST:
            return end
        margins.follow(x)
        solved += 1
        there = look(x)
        gained = _merit(here, elastic) - _merit(there, elastic)
        if gained > _POOR * promised:
            here = there
            size = min(_LARGEST, 2 * size) if gained > _GOOD * promised else size
            continue
        margins.anchor, x = at, at.x
        size /= 2
        if size < _LEAST:
            return Programme(look, *inside, reach, 1).run(x, size, curvature)


def _length(step: np.ndarray, reach: np.ndarray) -> float:
    return float(np.abs(step / reach).max(initial=0.0))


def _merit(point: Local, elastic: np.ndarray) -> float:
    excess = np.maximum(np.where(np.isfinite(point.margins), point.margins, 1e6), 0.0)
    return point.total + float(elastic @ excess)


COARSE = 512
"""Units of the small sample, at most."""

_LOOKS_COARSE = 14  # vectors of one search on the small sample, at most
_SETTLED = 1e-3  # of such a search
_STARTS = 6  # for one number; one more for each further one
_MET = 0.02  # of the way to a limit, by which a small sample may err
_APART = 0.05  # of the vector: nearer ends are one
_DEARER = 0.03  # than the cheapest end, beyond which another one is no rival


def starts(decisions: Decisions, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """The given vector, and others spread evenly over mid-points and numbers."""
    count, first = decisions.size - len(decisions.fields), len(decisions.fields)
    if not count:
        return [x]
    # Points of an additive recurrence: low discrepancy in any number of dimensions (Roberts 2018).
    root = _root(count)
    shifts = root ** -np.arange(1.0, count + 1)
    found = [x]
    for i in range(_STARTS + count - 1):
        there = x.copy()
        part = (0.5 + (i + 1) * shifts) % 1.0
        there[first:] = low[first:] + part * (high[first:] - low[first:])
        found.append(there)
    return found


def _root(count: int) -> float:
    """The positive root of r^(count + 1) = r + 1."""
    found = 1.5
    for _ in range(50):
        found = (1 + found) ** (1 / (count + 1))
    return found


def valleys(
    margins: Margins, starts: list[np.ndarray], low: np.ndarray, high: np.ndarray, reach: np.ndarray
) -> list[End]:
    """Ends of searches on a small sample to be repeated on a large one: distinct, the cheapest first."""
    ends: list[End] = []
    for start in starts:
        x = start
        for most in (_LOOKS_COARSE, _LOOKS_COARSE // 2):
            margins.replace_sample(x)
            end = Programme(margins.look, low, high, reach, most, settled=_SETTLED).run(x)
            x = end.point.x
        ends.append(end)
    met = [end for end in ends if end.excess <= _MET]
    ranked = sorted(met, key=lambda end: end.point.total) or sorted(ends, key=lambda end: end.excess)
    best, found = ranked[0], list[End]()
    limit = best.point.total + _DEARER * abs(best.point.total)
    for end in ranked:
        apart = all(np.abs(end.point.x - other.point.x).max() > _APART for other in found)
        if apart and (not found or (met and end.point.total <= limit)):
            found.append(end)
    return found[:3]


WITHIN = 0.005
"""Part of the cost that a number off its best value may add."""

_OFF = 0.05  # part of its range by which a number is first held off
_TRIALS = 4  # searches for one end of a range, at most
_CLOSE = 0.15  # of the added cost, by which the end of a range may miss it
_LOOKS_RANGE = 12  # vectors of one search, at most
_RADIUS, _SETTLED_RANGE = 0.2, 1e-4  # of its first step and of its end


def ranges(
    margins: Margins, decisions: Decisions, end: End, low: np.ndarray, high: np.ndarray
) -> dict[str, tuple[float, float]]:
    """{number: (least, largest) value with which the least cost stays within `WITHIN`}.

    Args:
        margins: on a sample that these searches share.
        decisions: whose vectors these are.
        end: of the search for the best.
        low: (n,) bounds of its vector.
        high: (n,) bounds of its vector.
    """

    def solved(x: np.ndarray, k: int | None = None, part: float = 0.0) -> End:
        least, most, start = low.copy(), high.copy(), x.copy()
        if k is not None:
            least[k] = most[k] = start[k] = part
        search = Programme(margins.look, least, most, decisions.reach, _LOOKS_RANGE, settled=_SETTLED_RANGE)
        return search.run(start, _RADIUS, end.curvature)

    best = solved(end.point.x)
    allowed = WITHIN * abs(best.point.total)
    found = {name: (value, value) for name, value in decisions.values(best.point.x).items()}
    for k, name in enumerate(decisions.free, len(decisions.fields) + len(decisions.moves)):
        if low[k] == high[k]:
            continue
        item, ends = decisions.variables[name], []
        for sign, limit, slope in ((-1.0, low[k], best.at_high[k]), (1.0, high[k], best.at_low[k])):
            at = float(best.point.x[k])
            held = functools.partial(solved, best.point.x, k)
            way = _way(held, best, at, sign, abs(float(limit) - at), float(slope), allowed)
            ends.append(item.lower + (at + sign * way) * (item.upper - item.lower))
        found[name] = min(ends), max(ends)
    return found


def _way(
    solved: Callable[[float], End], best: End, at: float, sign: float, most: float, slope: float, allowed: float
) -> float:
    """Distance at which the least cost has grown by `allowed`, or `most`."""
    if most <= 0:
        return 0.0
    inner, outer, way = 0.0, math.inf, min(_OFF, most)
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
    return min(way, most)
