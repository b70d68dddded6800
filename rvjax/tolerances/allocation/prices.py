"""Prices of the end of a search: of limits, with their sampling error, and of bounds of the numbers of a design."""

import dataclasses
import math

import numpy as np
from scipy import special

from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.decisions import Decisions
from rvjax.tolerances.allocation.programme import AGAIN, End, Programme
from rvjax.tolerances.allocation.result import bounds_active

_GROUPS = 20  # of units, each left out in turn (Tukey 1958)


def prices_of(constraints: Constraints, end: End, prices: np.ndarray, ways: np.ndarray) -> dict[str, float]:
    """Reduction of the cost per outward move of all limits of a requirement, by name.

    Args:
        constraints: of the search.
        end: of the search.
        prices: (c,) of used ways.
        ways: (c,) move of a limit for each used way.
    """
    found = dict.fromkeys(constraints.problem.requirements, 0.0)
    for row, price, way in zip(constraints.rows, prices, ways):
        if row.item is not None:
            found[row.name] += float(price / way)
    for name, part in constraints.leading(end.look.x).items():
        found[name] += float(prices[-1]) * part
    return found


def intervals(programme: Programme, end: End, confidence: float) -> dict[str, tuple[float, float]]:
    """Intervals of d cost / d limit by the sampling error of the units: no unit is solved for them.

    Args:
        programme: of the search.
        end: of the search.
        confidence: of the intervals.
    """
    constraints, several = programme.constraints, []
    values = prices_of(constraints, end, end.prices, constraints.ways)
    for used, jacobian in constraints.without_groups(end.look, _GROUPS):
        there = dataclasses.replace(end.look, used=used, jacobian=jacobian)
        prices = programme.prices(there, AGAIN)
        several.append([*prices_of(constraints, end, prices, constraints.ways).values()])
    error = np.std(np.asarray(several), axis=0) * math.sqrt(_GROUPS - 1)
    half = dict(zip(values, map(float, special.stdtrit(_GROUPS - 1, (1 + confidence) / 2) * error)))
    return {name: (-value - half[name], -value + half[name]) for name, value in values.items()}


def margins_of(constraints: Constraints, end: End) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Margins of the requirements at the end of a search, of two sides the larger, and their derivatives.

    Args:
        constraints: of the search.
        end: of the search.
    """
    decisions, x = constraints.decisions, end.look.x
    values, slopes = dict[str, float](), dict[str, dict[str, float]]()
    first, widths = len(decisions.fields) + len(decisions.moves), decisions.half_widths(x)
    for k, row in enumerate(constraints.rows):
        value, rates = (end.look.used[k] - 1) * constraints.ways[k], end.look.jacobian[k] * constraints.ways[k]
        if row.item is None or not math.isfinite(value) or value <= values.get(row.name, -math.inf):
            continue
        values[row.name] = float(value)
        numbers = rates[first:] / decisions.rates()[len(decisions.moves) :]
        slopes[row.name] = dict(zip(decisions.fields, map(float, rates[: len(widths)] / widths)))
        slopes[row.name] |= dict(zip(decisions.free, map(float, numbers)))
    return values, slopes


def value_prices(decisions: Decisions, end: End) -> dict[str, float]:
    """d cost / d bound of each number, of the bound at which it is; 0 elsewhere.

    Args:
        decisions: of the search.
        end: of the search.
    """
    prices, bounds = dict.fromkeys(decisions.variables, 0.0), bounds_active(decisions, end.look.x)
    for k, name in enumerate(decisions.free, len(decisions.fields) + len(decisions.moves)):
        rate = float(decisions.rates()[k - len(decisions.fields)])
        if bounds[name] is not None:
            prices[name] = float(end.at_low[k] if bounds[name] == "lower" else -end.at_high[k]) / rate
    return prices
