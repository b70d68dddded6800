"""Starts of a search: a cost may have several valleys in the mid-points and numbers of a design."""

from typing import Any

import numpy as np

from rvjax.tolerances.allocation.decisions import Decisions
from rvjax.tolerances.allocation.programme import MET, End

_STARTS = 6  # for one number; one more for each further one
_APART = 0.05  # of the vector: nearer ends are one
_DEARER = 0.03  # than the cheapest end, beyond which another one is no rival


def starts(decisions: Decisions, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """The given vector, and others spread evenly over mid-points and numbers.

    Args:
        decisions: of the vector.
        x: (n,) the vector.
        low: (n,) bounds.
        high: (n,) bounds.
    """
    count, first = decisions.size - len(decisions.fields), len(decisions.fields)
    if not count:
        return [x]
    # Points of an additive recurrence: low discrepancy in any number of dimensions (Roberts 2018).
    root = 1.5  # of r^(count + 1) = r + 1
    for _ in range(50):
        root = (1 + root) ** (1 / (count + 1))
    shifts, found = root ** -np.arange(1.0, count + 1), [x]
    for i in range(_STARTS + count - 1):
        there = x.copy()
        there[first:] = low[first:] + (0.5 + (i + 1) * shifts) % 1.0 * (high[first:] - low[first:])
        found.append(there)
    return found


def rivals(ends: list[End], first: int, most: int) -> list[End]:
    """Ends on a small sample to go on from: distinct, the cheapest first.

    Args:
        ends: of the searches.
        first: entry of the vectors from which on they must differ.
        most: ends, at most.
    """
    met = [end for end in ends if end.look.excess <= 2 * MET]
    ranked = sorted(met, key=lambda end: end.look.total) or sorted(ends, key=lambda end: end.look.excess)
    found = list[End]()
    limit = ranked[0].look.total + _DEARER * abs(ranked[0].look.total)
    for end in ranked:
        different = all(np.abs(end.look.x - other.look.x)[first:].max(initial=0.0) > _APART for other in found)
        if not found or (different and met and end.look.total <= limit):
            found.append(end)
    return found[:most]


def tried(decisions: Decisions, several: list[np.ndarray], ends: list[End], units: int) -> list[dict[str, Any]]:
    """Starts that were tried, as `Allocation.starts` has them.

    Args:
        decisions: of the vectors.
        several: the starts, (n,) vectors.
        ends: of their searches.
        units: of the sample.
    """

    def of(x: np.ndarray) -> dict[str, float]:
        return decisions.values(x) | decisions.middles_at(x)

    return [
        dict(begun=of(x), values=of(end.look.x), cost=end.look.total, met=end.look.excess <= 2 * MET, units=units)
        for x, end in zip(several, ends)
    ]
