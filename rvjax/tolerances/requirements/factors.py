"""Common factors on all half-widths that should just meet a requirement: start of the next certificate."""

import math

from scipy import special

from rvjax.population import Estimate

CUSHION = 0.7
"""Margin in standard errors of a value, so that the next draw passes too."""

MOST_FACTOR = 1e3
"""The largest step, and the reciprocal of the smallest."""

_LEAST_SEEN = 1e-3  # of the allowed rejects: fewer give no further information


def share_factor(share: Estimate, target: float, samples: int, deviate: float) -> float:
    """Factor on the half-widths of a two-sided normal response whose share of units should reach a target."""
    # The score interval has its lower end at the target where the share lies z errors of the target above it.
    wanted = min(target + (deviate + CUSHION) * math.sqrt(target * (1 - target) / samples), 1 - 0.5 / samples)
    seen = min(max(share.value, 0.5 / samples), 1 - 0.5 / samples)
    return float(special.ndtri((1 + seen) / 2) / special.ndtri((1 + wanted) / 2))


def rare_factor(share: Estimate, target: float, deviate: float) -> float:
    """`share_factor` where the share of rejects is known to a part of itself, however small it is."""
    failing, wanted = max(1 - share.value, _LEAST_SEEN * (1 - target)), 1 - target
    wanted /= 1 + (deviate + CUSHION) * share.error / failing
    return float(special.ndtri(min(failing, 1 - _LEAST_SEEN) / 2) / special.ndtri(wanted / 2))


def bounded(factor: float) -> float:
    """Limit to the largest change of a single step; nan becomes 0."""
    return 0.0 if math.isnan(factor) else min(max(factor, 1 / MOST_FACTOR), MOST_FACTOR)
