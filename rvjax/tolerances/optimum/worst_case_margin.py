"""Margin of a worst case and its derivatives; those to mid-points and numbers by differences."""

from collections.abc import Callable

import numpy as np

from rvjax.population import Population
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.requirements.limits import Limits
from rvjax.tolerances.worst_case import Extremes

_STEP = 1e-4  # of differences, part of a range


def worst_case(
    ends: Callable[[Population], Extremes], decisions: Decisions, x: np.ndarray, item: Limits, way: float
) -> tuple[float, np.ndarray]:
    """Margin, and its derivatives (n,) to the vector of decisions.

    Args:
        ends: extremes of a response in a population.
        decisions: of the vector.
        x: (n,) the vector.
        item: limit of the response.
        way: unit of the margin.
    """
    here, found, count = ends(decisions.population(x)), np.zeros(len(x)), len(decisions.fields)
    margin = float(item.learned(here.values, way))
    pull = item.pull(here.values, margin, way, len(here.values))
    active = list(decisions.base.active)
    by_width = pull.cotangents @ here.slopes[pull.units]
    found[:count] = by_width[[active.index(name) for name in decisions.fields]]
    for j in range(count, len(x)):
        there = x.copy()
        there[j] += _STEP if x[j] + _STEP <= decisions.high[j] else -_STEP
        found[j] = (item.learned(ends(decisions.population(there)).values, way) - margin) / (there[j] - x[j])
    return margin, found
