"""Search with costly units: programmes on followed units, each within a box about the vector where all are solved.

A programme on followed units costs next to nothing. At its end all units are solved again. The step is taken where cost
and excess together fall; otherwise the box shrinks. The search ends with a step that is short, or that gains little.
"""

from collections.abc import Callable

import numpy as np

from rvjax.tolerances.codesign.margins import Local, Margins
from rvjax.tolerances.codesign.programme import End, Programme

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
