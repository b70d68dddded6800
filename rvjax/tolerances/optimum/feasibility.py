"""Least shortage of an infeasible problem: how far which limit is missed, and which bound would help most."""

import dataclasses

import numpy as np

from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.local import Local
from rvjax.tolerances.optimum.margins import FAILED, Margins
from rvjax.tolerances.optimum.programme import End, Programme


@dataclasses.dataclass(frozen=True)
class Shortage:
    """The least sum of shortfalls, in parts of their limits, with all half-widths at their finest.

    Attributes:
        x: (n,) vector of decisions there.
        total: the sum.
        by_name: {requirement: distance by which its limits must move outwards}.
        helps: bound of a number of the design whose move outwards reduces the sum most, as (name, "lower" or "upper"),
            or None.
    """

    x: np.ndarray
    total: float
    by_name: dict[str, float]
    helps: tuple[str, str] | None


_SAMPLES, _ANCHORS = 2, 6  # searches from a start: units placed again for each, or followed from its end
_LOOKS = 30  # vectors of a programme on followed units


def least_shortage(
    margins: Margins,
    decisions: Decisions,
    starts: list[np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
    most: int,
    *,
    follows: bool = False,
) -> Shortage:
    """Numbers and mid-points of the least shortage, from several starts; `follows`: units are costly and followed."""
    high, count = high.copy(), len(decisions.fields)
    high[:count] = low[:count]
    weights = margins.ways / margins.limits()

    def look(x: np.ndarray) -> Local:
        point, nothing = margins.look(x), np.zeros(decisions.size)
        return dataclasses.replace(
            point, cost=1.0, slopes=nothing, bends=nothing, objective=0.0, objective_slopes=nothing
        )

    def short(end: End) -> float:
        return float(weights @ np.maximum(end.point.margins, 0.0))

    ends = []
    for start in starts:
        x, size, kept, solved = np.clip(start, low, high), 1.0, margins.anchor, np.inf
        for turn in range(_ANCHORS if follows else _SAMPLES):
            inside, looks = (low, high), most
            if not follows or not turn:
                margins.replace_sample(x)
            if follows:
                margins.follow(x)
                here = float(weights @ np.maximum(look(x).margins, 0.0))
                if here > solved and kept is not None:  # the step was too long
                    margins.anchor, size = kept, size / 3
                kept, solved = margins.anchor, min(here, solved)
                assert kept is not None
                room = size * decisions.reach
                inside, looks = (np.maximum(low, kept.x - room), np.minimum(high, kept.x + room)), _LOOKS
                x = kept.x
            end = Programme(look, *inside, decisions.reach, looks, elastic=weights).run(x)
            x = end.point.x
        ends.append(end)
    best = min(ends, key=short)
    by_name = dict.fromkeys(margins.names, 0.0)
    for name, margin, way in zip(margins.names, best.point.margins, margins.ways):
        by_name[name] = max(by_name[name], float(margin) * way, 0.0)
    if by_name.get(FAILED, 0.0) > 0:  # no limit helps a statistic of the valid units
        by_name |= {name: np.inf for name, item in margins.requirements.items() if item.most_failed < 1}
    by_name = {name: value for name, value in by_name.items() if name in margins.requirements}
    return Shortage(best.point.x, short(best), by_name, _helping(best, decisions))


def _helping(end: End, decisions: Decisions) -> tuple[str, str] | None:
    first = len(decisions.fields) + len(decisions.moves)
    rates = [(rate, name, "lower") for name, rate in zip(decisions.free, end.at_low[first:])]
    rates += [(rate, name, "upper") for name, rate in zip(decisions.free, end.at_high[first:])]
    best = max(rates, default=(0.0, "", ""))
    return (best[1], best[2]) if best[0] > 0 else None
