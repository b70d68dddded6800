"""End of a programme: prices of the requirements, margins with their derivatives, and an audit."""

import functools
import math
from collections.abc import Callable

import numpy as np

from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.jackknife import half_interval
from rvjax.tolerances.optimum.margins import JOINT, Margins
from rvjax.tolerances.optimum.programme import End, Programme

STATIONARY = 0.1
"""Residual of an optimum by derivatives: it costs less than half of its square."""

_RADIUS = 0.2  # of the step behind a price
_PROBE = 0.1  # of the audit, logarithm of a half-width
_PROBES = 32  # at most
_ASTRAY = 0.4  # part of a probe by which a margin may deviate from its slopes
_NOISE = 0.02  # of the way to a limit


def pricing(margins: Margins, end: End, x: np.ndarray) -> Callable[[np.ndarray], dict[str, float]]:
    """Reduction of the cost per outward move of all limits of a requirement, by name: of prices (c,) of the margins.

    Corrections of a sampled margin are parts of the way to its limit: they grow with the limit.

    Args:
        margins: of the search.
        end: of the search.
        x: the solution.
    """
    kept = 1 - end.point.moved / margins.central_ways(x)
    kept[margins.exact] = 1.0
    leading = margins.leading(x) if JOINT in margins.names[len(margins.rows) :] else {}

    def priced(prices: np.ndarray) -> dict[str, float]:
        found = dict.fromkeys(margins.requirements, 0.0)
        for name, price, way, part in zip(margins.names, prices, margins.ways, kept):
            if name in found:
                found[name] += float(price / way * part)
        for name, part in leading.items():
            found[name] += float(prices[-1]) * part
        return found

    return priced


def intervals(
    margins: Margins,
    end: End,
    priced: Callable[[np.ndarray], dict[str, float]],
    low: np.ndarray,
    high: np.ndarray,
    confidence: float,
) -> dict[str, tuple[float, float]]:
    """Intervals of the prices of followed units, by their sampling error: no unit is solved for them.

    Args:
        margins: of the search, whose units are followed.
        end: of the search.
        priced: prices of the requirements, see `pricing`.
        low: (n,) bounds of its vector.
        high: (n,) bounds of its vector.
        confidence: of the intervals.
    """
    elastic, found = np.maximum(4 * end.prices, 2 * abs(end.point.total)), []
    for tails in margins.tails.parts():
        look = functools.partial(margins.of_tails, tails)
        there = Programme(look, low, high, margins.decisions.reach, 1, elastic=elastic)
        found.append([*priced(there.run(end.point.x, _RADIUS, end.curvature).prices).values()])
    values, by = priced(end.prices), dict(zip(margins.requirements, map(float, half_interval(found, confidence))))
    return {name: (value - by[name], value + by[name]) for name, value in values.items()}


def margins_of(
    margins: Margins, decisions: Decisions, end: End
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Margins of the requirements at the end of a search, of two sides the larger, and their derivatives."""
    values, slopes = dict[str, float](), dict[str, dict[str, float]]()
    point = end.point
    first = len(decisions.fields) + len(decisions.moves)
    widths = decisions.half_widths(point.x)
    for k, row in enumerate(margins.rows):
        value, rates = point.margins[k] * margins.ways[k], point.jacobian[k] * margins.ways[k]
        if not math.isfinite(value) or value <= values.get(row.name, -math.inf):
            continue
        values[row.name] = float(value)
        numbers = rates[first:] / decisions.rates()[len(decisions.moves) :]
        slopes[row.name] = dict(zip(decisions.fields, map(float, rates[: len(widths)] / widths)))
        slopes[row.name] |= dict(zip(decisions.free, map(float, numbers)))
    return values, slopes


def confirmed(margins: Margins, decisions: Decisions, end: End) -> bool:
    """Audit of an end: prices account for all savings, and the sample moves as its slopes predict.

    Every half-width grows alone, of many fields a few together. Units that fail, or a response in steps, show by
    margins that jump or stay.
    """
    if end.residual > STATIONARY:
        return False
    point, powers = end.point, np.array([row.item.power for row in margins.rows] + [2.0] * 2)[: len(margins.names)]
    distance = margins.central_ways(point.x)
    way = np.maximum(point.margins + distance, 0.0) / distance
    free = [j for j in range(len(decisions.fields)) if point.x[j] + _PROBE <= decisions.high[j]]
    for group in np.array_split(free, min(len(free), _PROBES) or 1):
        probe = point.x.copy()
        probe[group.astype(int)] += _PROBE
        seen = margins.look(probe, sloped=False).margins / distance + 1
        slopes = point.jacobian[:, group.astype(int)].sum(axis=1) / distance
        grown = way**powers + way ** (powers - 1) * slopes * np.expm1(powers * _PROBE)
        told = np.maximum(grown, 0.0) ** (1 / powers)
        if ((np.abs(seen - told) > _ASTRAY * _PROBE) & (np.maximum(seen, told) > 1 - _NOISE)).any():
            return False
    return True
