"""Quantiles of margins on a small sample, where the level may lie beyond what the sample holds."""

import numpy as np
from scipy import special

_BEYOND = 8  # units that must lie beyond a sampled quantile; further out the tail is extended as a normal one


def tail_quantile(margins: np.ndarray, target: float, distance: float) -> float:
    """Quantile of the units' margins (n,) at a target, failed ones (inf) above all others.

    A far tail is extended from the nominal response, at `distance` from the limit.
    """
    level = _reachable(target, len(margins))
    rank = (len(margins) - 1) * level
    low = int(rank)
    high = min(low + 1, len(margins) - 1)
    ordered = np.partition(margins, [low, high])
    a, b = ordered[low], ordered[high]
    quantile = a + (rank - low) * (b - a) if np.isfinite(b) else b
    further = special.ndtri((1 + target) / 2) / special.ndtri((1 + level) / 2)
    return float((quantile + distance) * further - distance)


def nearest(margins: np.ndarray, target: float, lanes: int) -> np.ndarray:
    """Units whose margins are nearest the quantile, by rank among those that did not fail."""
    order = np.argsort(margins)
    valid = int(np.isfinite(margins).sum())
    start = round(len(margins) * _reachable(target, len(margins))) - lanes // 2
    start = max(0, min(start, valid - lanes))
    return order[start : start + lanes]


def _reachable(target: float, samples: int) -> float:
    return min(target, 1 - _BEYOND / samples)
