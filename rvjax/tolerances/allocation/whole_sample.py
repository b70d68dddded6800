"""Limits and losses of all units of a sample: means, spreads, capabilities, failed units, worst cases, mean losses."""

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from rvjax.tolerances.allocation.decisions import STEP
from rvjax.tolerances.worst_case import Extremes, extremes

if TYPE_CHECKING:
    from rvjax.tolerances.allocation.constraints import Constraints

_SLOPED = 1024  # costly units behind the slope of a statistic


def statistic(constraints: "Constraints", k: int, x: np.ndarray, *, sloped: bool) -> tuple[float, np.ndarray]:
    """Used way and its derivatives (n,) of a statistic of all units; units that fail have no slope.

    Args:
        constraints: of the problem.
        k: number of the row.
        x: vector of decisions.
        sloped: False without derivatives.
    """
    row, nothing = constraints.rows[k], np.zeros(constraints.decisions.size)
    values = constraints.units.values(constraints.decisions.population(x), constraints.plain)
    if row.item is None:
        assert constraints.most_failed is not None
        failed = np.any([np.isnan(values[name]) for name in constraints.problem.requirements if name in values], axis=0)
        return float(failed.mean()) / constraints.most_failed, nothing
    item, own = row.item, values[row.name]
    valid = own if item.most_failed >= 1 else own[~np.isnan(own)]
    cushion = constraints.problem.cushioned(item, valid)
    margin = item.learned(valid, constraints.ways[k]) + cushion
    if not math.isfinite(margin):
        return math.inf, nothing
    if not sloped:
        return 1 + margin / constraints.ways[k], nothing
    few = own[:_SLOPED] if constraints.problem.costly else own
    pull = item.pull(few, margin, constraints.ways[k], len(few))
    if not len(pull.units):
        return 1 + margin / constraints.ways[k], nothing
    seen = few[pull.units]
    square = float(((seen - seen.mean()) ** 2).sum())  # the cushion grows as the spread of the units does
    more = cushion * (seen - seen.mean()) / square if square > 0 else 0.0
    pulled = {row.name: pull.cotangents / pull.norms.sum() + more}
    return 1 + margin / constraints.ways[k], constraints.units.slope(
        x, constraints.plain[:, pull.units], pulled
    ) / constraints.ways[k]


def worst_case(constraints: "Constraints", k: int, x: np.ndarray) -> tuple[float, np.ndarray]:
    """Used way and its derivatives (n,) of a worst case; those to mid-points and numbers by differences.

    Args:
        constraints: of the problem.
        k: number of the row.
        x: vector of decisions.
    """
    row, way, decisions = constraints.rows[k], float(constraints.ways[k]), constraints.decisions
    item = row.item
    assert item is not None
    both = functools.partial(extremes, constraints.problem.response, names=constraints.names, name=row.name)
    ends: Extremes = both(decisions.population(x))
    found, count = np.zeros(len(x)), len(decisions.fields)
    margin = float(item.learned(ends.values, way))
    pull, active = item.pull(ends.values, margin, way, len(ends.values)), list(decisions.base.active)
    by_width = pull.cotangents @ ends.slopes[pull.units]
    found[:count] = by_width[[active.index(name) for name in decisions.fields]]
    for j in range(count, len(x)):
        there = x.copy()
        there[j] += STEP if x[j] + STEP <= decisions.high[j] else -STEP
        found[j] = (item.learned(both(decisions.population(there)).values, way) - margin) / (there[j] - x[j])
    return 1 + margin / way, found / way


def mean_loss(constraints: "Constraints", x: np.ndarray, *, sloped: bool) -> tuple[float, np.ndarray]:
    """Mean loss of the units that do not fail, inf where all do, and its derivatives (n,).

    Args:
        constraints: of the problem.
        x: vector of decisions.
        sloped: False without derivatives.
    """
    total, towards = 0.0, np.zeros(constraints.decisions.size)
    values = (
        constraints.units.values(constraints.decisions.population(x), constraints.plain)
        if constraints.problem.losses
        else {}
    )
    for name, loss in constraints.problem.losses.items():
        units = np.flatnonzero(np.isfinite(values[name]))
        if not len(units):
            return math.inf, towards
        total += float(np.mean(loss(values[name][units])))
        units = units[:_SLOPED] if constraints.problem.costly else units
        if sloped:
            pull = {name: np.asarray(loss.slope(values[name][units])) / len(units)}
            towards += constraints.units.slope(x, constraints.plain[:, units], pull)
    return total, towards
