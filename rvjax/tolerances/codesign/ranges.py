"""Flat places of the least cost: how far a number can be from its best value at little more cost.

One number is held off its best value and the others are chosen again. The cost that this adds is modelled by its slope
(the price of an active bound) and a curvature, which the last such search corrects.
"""

import functools
import math
from collections.abc import Callable

import numpy as np

from rvjax.tolerances.codesign.decisions import Decisions
from rvjax.tolerances.codesign.margins import Margins
from rvjax.tolerances.codesign.programme import MET, End, Programme

WITHIN = 0.005
"""Part of the cost that a number off its best value may add."""

_FIRST = 0.05  # part of its range by which a number is first held off
_TRIALS = 4  # searches for one end of a range, at most
_CLOSE = 0.15  # of the added cost, by which the end of a range may miss it
_LOOKS = 12  # vectors of one search, at most
_RADIUS, _SETTLED = 0.2, 1e-4  # of its first step and of its end


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
        search = Programme(margins.look, least, most, decisions.reach, _LOOKS, settled=_SETTLED)
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
    inner, outer, way = 0.0, math.inf, min(_FIRST, most)
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
