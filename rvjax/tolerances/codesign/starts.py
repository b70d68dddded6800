"""Starts of a search: valleys of a cost are looked into on a small sample."""

import numpy as np

from rvjax.tolerances.codesign.decisions import Decisions
from rvjax.tolerances.codesign.margins import Margins
from rvjax.tolerances.codesign.programme import End, Programme

COARSE = 512
"""Units of the small sample, at most."""

_LOOKS = 14  # vectors of one search on the small sample, at most
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
        for most in (_LOOKS, _LOOKS // 2):
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
