"""Limits and losses of all units of a sample: means, spreads, capabilities, failed units, worst cases, mean losses."""

import functools
import math

import numpy as np

from rvjax.tolerances.allocation.decisions import STEP, Decisions
from rvjax.tolerances.allocation.look import Row
from rvjax.tolerances.allocation.problem import Problem
from rvjax.tolerances.allocation.sample import Units
from rvjax.tolerances.worst_case import Extremes, extremes

_SLOPED = 1024  # costly units behind the slope of a statistic


class WholeSample:
    """Used ways and losses of a problem that all units of a sample decide together."""

    problem: Problem
    decisions: Decisions
    rows: list[Row]
    ways: np.ndarray  # (c,), by which excesses are divided
    plain: np.ndarray  # standard normal numbers of the units (numbers, units)
    units: Units
    names: tuple[str, ...]  # of the responses
    most_failed: float | None  # share of units that may fail

    def statistic(self, k: int, x: np.ndarray, *, sloped: bool) -> tuple[float, np.ndarray]:
        """Used way and its derivatives (n,) of a statistic of all units; units that fail have no slope.

        Args:
            k: number of the row.
            x: vector of decisions.
            sloped: False without derivatives.
        """
        row, nothing = self.rows[k], np.zeros(self.decisions.size)
        values = self.units.values(self.decisions.population(x), self.plain)
        if row.item is None:
            assert self.most_failed is not None
            failed = np.any([np.isnan(values[name]) for name in self.problem.requirements if name in values], axis=0)
            return float(failed.mean()) / self.most_failed, nothing
        item, own = row.item, values[row.name]
        valid = own if item.most_failed >= 1 else own[~np.isnan(own)]
        cushion = self.problem.cushioned(item, valid)
        margin = item.learned(valid, self.ways[k]) + cushion
        if not math.isfinite(margin):
            return math.inf, nothing
        if not sloped:
            return 1 + margin / self.ways[k], nothing
        few = own[:_SLOPED] if self.problem.costly else own
        pull = item.pull(few, margin, self.ways[k], len(few))
        if not len(pull.units):
            return 1 + margin / self.ways[k], nothing
        seen = few[pull.units]
        square = float(((seen - seen.mean()) ** 2).sum())  # the cushion grows as the spread of the units does
        more = cushion * (seen - seen.mean()) / square if square > 0 else 0.0
        pulled = {row.name: pull.cotangents / pull.norms.sum() + more}
        return 1 + margin / self.ways[k], self.units.slope(x, self.plain[:, pull.units], pulled) / self.ways[k]

    def worst_case(self, k: int, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Used way and its derivatives (n,) of a worst case; those to mid-points and numbers by differences.

        Args:
            k: number of the row.
            x: vector of decisions.
        """
        row, way, decisions = self.rows[k], float(self.ways[k]), self.decisions
        item = row.item
        assert item is not None
        both = functools.partial(extremes, self.problem.response, names=self.names, name=row.name)
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

    def mean_loss(self, x: np.ndarray, *, sloped: bool) -> tuple[float, np.ndarray]:
        """Mean loss of the units that do not fail, inf where all do, and its derivatives (n,).

        Args:
            x: vector of decisions.
            sloped: False without derivatives.
        """
        total, towards = 0.0, np.zeros(self.decisions.size)
        values = self.units.values(self.decisions.population(x), self.plain) if self.problem.losses else {}
        for name, loss in self.problem.losses.items():
            units = np.flatnonzero(np.isfinite(values[name]))
            if not len(units):
                return math.inf, towards
            total += float(np.mean(loss(values[name][units])))
            units = units[:_SLOPED] if self.problem.costly else units
            if sloped:
                pull = {name: np.asarray(loss.slope(values[name][units])) / len(units)}
                towards += self.units.slope(x, self.plain[:, units], pull)
        return total, towards
