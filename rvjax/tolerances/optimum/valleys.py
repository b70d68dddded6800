"""Starts of a search: valleys of a cost are looked into on a small sample.

Costly units of the small sample are followed, a few with gradients. Other starts than the given one, and the search on
the large sample from the cheapest of their ends, solve no more units than the given start and its certificate do.
"""

import math
from typing import Any

import numpy as np

from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.programme import End, Programme
from rvjax.tolerances.optimum.steps import followed

COARSE = 512
"""Units of the small sample, at most."""

FEW = 64
"""Costly units of the small sample with gradients, for each response."""

_LOOKS_COARSE = 14  # vectors of one search on the small sample, at most
_SETTLED = 1e-3  # of such a search
_LOOKS_FOLLOWED = 30  # vectors of a programme on followed units
_ROUNDS = (4, 0.7), (2, 0.3), (1, 0.15)  # vectors where these are solved, and size of the box of such a search
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


def searched(
    margins: Margins, starts: list[np.ndarray], low: np.ndarray, high: np.ndarray, most: float = math.inf
) -> list[End]:
    """Ends of searches on a small sample, in the order of their starts.

    Args:
        margins: on the small sample; with a finite `most` its units are followed.
        starts: vectors.
        low: (n,) bounds.
        high: (n,) bounds.
        most: units to solve; starts for which no units are left are not tried.
    """
    ends, reach, before = list[End](), margins.decisions.reach, margins.evaluated
    for x in starts:
        used = margins.evaluated - before
        if ends and used * (1 + 1 / len(ends)) > most:
            break
        margins.anchor = None
        for looks in (_LOOKS_COARSE, _LOOKS_COARSE // 2) if math.isinf(most) else ():
            margins.replace_sample(x)
            end = Programme(margins.look, low, high, reach, looks, settled=_SETTLED).run(x)
            x = end.point.x
        for anchors, size in _ROUNDS if math.isfinite(most) else ():
            margins.replace_sample(x)
            end = followed(margins, margins.look, low, high, x, _LOOKS_FOLLOWED, anchors=anchors, size=size)
            x = end.point.x
        ends.append(end)
    return ends


def rivals(ends: list[End], first: int = 0) -> list[End]:
    """Ends on a small sample to be repeated on a large one: distinct, the cheapest first.

    Args:
        ends: of the searches.
        first: entry of the vectors from which on they must differ.
    """
    met = [end for end in ends if end.excess <= _MET]
    ranked = sorted(met, key=lambda end: end.point.total) or sorted(ends, key=lambda end: end.excess)
    best, found = ranked[0], list[End]()
    limit = best.point.total + _DEARER * abs(best.point.total)
    for end in ranked:
        different = all(apart(end, other, first) for other in found)
        if different and (not found or (met and end.point.total <= limit)):
            found.append(end)
    return found[:3]


def apart(end: End, other: End, first: int) -> bool:
    """True if two ends differ in their entries from the `first` on."""
    return bool(np.abs(end.point.x - other.point.x)[first:].max() > _APART)


def told(decisions: Decisions, starts: list[np.ndarray], ends: list[End], units: int) -> list[dict[str, Any]]:
    """Starts that were tried, as `Allocation.starts` has them.

    Args:
        decisions: whose vectors these are.
        starts: vectors, in the order of the ends; those after the last end were not tried.
        ends: of the searches.
        units: of the sample that they share.
    """
    numbers = [decisions.values(x) | decisions.middles_at(x) for x in starts]
    return [
        dict(begun=begun, values=decisions.values(end.point.x) | decisions.middles_at(end.point.x),
             cost=end.point.total, met=end.excess <= _MET, units=units)
        for begun, end in zip(numbers, ends)
    ]  # fmt: skip
