"""Flat places of the least cost: how far a number can be from its best value at little more cost.

One number is held off its best value and the others are chosen again. The cost that this adds is modelled by its slope
(the price of an active bound) and a curvature, which the last such search corrects.
"""

import functools
import math
from collections.abc import Callable

from rvjax.tolerances.allocation.constraints import FEW, Constraints
from rvjax.tolerances.allocation.programme import AGAIN, COARSE, GAIN, LOOKS, MET, End, Programme

WITHIN = 0.005
"""Part of the cost that a number off its best value may add."""

_OFF = 0.05  # part of its range by which a number is first held off
_TRIALS = 4, 2  # searches for one end of a range of quick and of costly units, at most
_CLOSE = 0.15  # of the added cost, by which the end of a range may miss it
_LOOKS = 4  # vectors of one search on costly units, at most


def ranges(constraints: Constraints, programme: Programme, end: End) -> dict[str, tuple[float, float]]:
    """{number: (least, largest) value with which the least cost stays within `WITHIN`}.

    Args:
        constraints: of the search; costly units are few afterwards.
        programme: of the search.
        end: of the search.
    """
    decisions, costly = constraints.decisions, constraints.problem.costly
    if costly:
        constraints.sample(FEW)
    low, high, looks = programme.low, programme.high, _LOOKS if costly else LOOKS

    def solved(start: End, k: int | None = None, at: float = 0.0) -> End:
        x = start.look.x.copy()
        if k is not None:
            programme.low, programme.high = low.copy(), high.copy()
            programme.low[k] = programme.high[k] = x[k] = at
        found = programme.run(x, AGAIN, most=looks, gain=COARSE if costly else max(GAIN))
        programme.low, programme.high = low, high
        return found

    best = solved(end)
    found = {name: (value, value) for name, value in decisions.values(best.look.x).items()}
    for k, name in enumerate(decisions.free, len(decisions.fields) + len(decisions.moves)):
        if low[k] == high[k]:
            continue
        item, at, ends = decisions.variables[name], float(best.look.x[k]), list[float]()
        for sign, limit, slope in ((-1.0, low[k], best.at_high[k]), (1.0, high[k], best.at_low[k])):
            held = functools.partial(solved, best, k)
            way = _way(held, best, at, sign, abs(float(limit) - at), float(slope), _TRIALS[costly])
            there = min(max(at + sign * way, 0.0), 1.0)
            ends.append(item.lower + there * (item.upper - item.lower))
        found[name] = min(ends), max(ends)
    return found


def _way(
    solved: Callable[[float], End], best: End, at: float, sign: float, most: float, slope: float, trials: int
) -> float:
    """Distance at which the least cost has grown by `WITHIN`, or `most`."""
    if most <= 0:
        return 0.0
    allowed = WITHIN * abs(best.look.total)
    inner, outer, way = 0.0, math.inf, min(_OFF, most)
    for _ in range(trials):
        there = solved(at + sign * way)
        if there.look.excess > MET:
            outer, way = way, (inner + way) / 2
            continue
        added = there.look.total - best.look.total
        if abs(added - allowed) <= _CLOSE * allowed or (way == most and added <= allowed):
            return way
        inner, outer = (way, outer) if added < allowed else (inner, way)
        bend = max(2 * (added - slope * way) / way**2, 1e-3 * allowed)
        new = (math.sqrt(slope**2 + 2 * bend * allowed) - slope) / bend
        new = min(max(new, way / 4), 8 * way, most)
        way = new if inner < new < outer else (inner + min(outer, most)) / 2 if math.isfinite(outer) else most
    return min(way, most)
