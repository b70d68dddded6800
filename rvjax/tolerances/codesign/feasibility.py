"""Least shortage of an infeasible problem: how far which limit is missed, and which bound would help most."""

import dataclasses

import numpy as np

from rvjax.tolerances.codesign.decisions import Decisions
from rvjax.tolerances.codesign.margins import Local, Margins
from rvjax.tolerances.codesign.programme import End, Programme


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


def least_shortage(
    margins: Margins, decisions: Decisions, starts: list[np.ndarray], low: np.ndarray, high: np.ndarray, most: int
) -> Shortage:
    """Numbers and mid-points of the least shortage, from several starts."""
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
        x = np.clip(start, low, high)
        for _ in range(2):
            margins.replace_sample(x)
            search = Programme(look, low, high, decisions.reach, most, elastic=weights)
            end = search.run(x)
            x = end.point.x
        ends.append(end)
    best = min(ends, key=short)
    by_name = dict.fromkeys(margins.names, 0.0)
    for name, margin, way in zip(margins.names, best.point.margins, margins.ways):
        by_name[name] = max(by_name[name], float(margin) * way, 0.0)
    by_name = {name: value for name, value in by_name.items() if name in margins.requirements}
    return Shortage(best.point.x, short(best), by_name, _helping(best, decisions))


def _helping(end: End, decisions: Decisions) -> tuple[str, str] | None:
    first = len(decisions.fields) + len(decisions.moves)
    rates = [(rate, name, "lower") for name, rate in zip(decisions.free, end.at_low[first:])]
    rates += [(rate, name, "upper") for name, rate in zip(decisions.free, end.at_high[first:])]
    best = max(rates, default=(0.0, "", ""))
    return (best[1], best[2]) if best[0] > 0 else None
