"""Sampling error of a result of many units: the spread of the results without one group of them (Tukey 1958)."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

GROUPS = 20
"""Groups of units."""


def groups(count: int) -> np.ndarray:
    """Group (n,) of each of so many units, at random."""
    return np.random.default_rng(count).permutation(count) % GROUPS


def half_interval(several: Sequence[np.ndarray | list[float]], confidence: float) -> np.ndarray:
    """Half of the intervals (k,) of values.

    Args:
        several: values (k,) without each group.
        confidence: of the intervals.
    """
    error = np.std(np.asarray(several), axis=0) * math.sqrt(GROUPS - 1)
    return np.asarray(special.stdtrit(GROUPS - 1, (1 + confidence) / 2) * error)
