"""Limits that no single unit decides: outputs without errors, and statistics and losses of all units of a sample.

Statistics are means, spreads, capabilities, failed units and worst cases.
"""

import dataclasses
import functools
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Estimate, Population, Sampled
from rvjax.records import Array
from rvjax.response import Response, evaluate, per_response
from rvjax.tolerances.allocation.decisions import STEP, Decisions
from rvjax.tolerances.allocation.look import Row
from rvjax.tolerances.allocation.problem import Problem
from rvjax.tolerances.allocation.sample import Units
from rvjax.tolerances.limits import Limits
from rvjax.tolerances.worst_case import Extremes, extremes


@dataclasses.dataclass(frozen=True)
class Nominal(Limits):
    """Limits of an output without errors, which numbers of the design must keep; no unit counts.

    Attributes:
        lower: lower limit, unit of the output; None for none.
        upper: upper limit, unit of the output; None for none.
    """

    of_units: ClassVar[bool] = False
    of_sample: ClassVar[bool] = False
    exact: ClassVar[bool] = True
    most_failed: ClassVar[float] = math.inf
    judges: ClassVar[str] = "response"
    prefix: ClassVar[str] = "nominal_"

    lower: float | None = None  # type: ignore[assignment]
    upper: float | None = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name, none in (("lower", -math.inf), ("upper", math.inf)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, none)
        super().__post_init__()

    def figure(self, sampled: Sampled) -> Estimate:
        """Raise ValueError: units do not decide it.

        Raises:
            ValueError: always.
        """
        raise ValueError("Nominal: limits an output without errors; give it to an allocation with variables")

    def text(self) -> str:
        """Name of the limited value."""
        return "without errors"


def nominal_outputs(
    response: Response, population: Population, names: tuple[str, ...]
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Outputs of a response without errors by name, and {output: {number of the design: derivative}}."""
    if not names:
        return {}, {}
    values, slopes = _linearised(getattr(response, "central", response), population, names=names)
    by_number = {number: dict(zip(names, map(float, np.asarray(slope)))) for number, slope in slopes.items()}
    found = dict(zip(names, map(float, np.asarray(values))))
    return found, {output: {number: by_number[number][output] for number in by_number} for output in names}


@per_response(static=("names",))
def _linearised(
    response: Response, population: Population, *, names: tuple[str, ...]
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Outputs (k,) without errors, and their derivatives (k,) by number of the design."""
    nothing = {name: jnp.zeros(tolerance.shape) for name, tolerance in population.active.items()}

    def outputs(values: dict[str, Array]) -> jax.Array:
        found, _ = evaluate(response, population.replace(values=values or population.values).fill(nothing))
        return jnp.stack([found[name] for name in names])

    free = {name: jnp.asarray(value, jnp.result_type(float)) for name, value in (population.values or {}).items()}
    return outputs(free), jax.jacrev(outputs)(free) if free else {}


class WholeSample:
    """Used ways and losses of a problem that all units of a sample decide together, or the unit without errors."""

    problem: Problem
    decisions: Decisions
    rows: list[Row]
    ways: np.ndarray  # (c,), by which excesses are divided
    moved: np.ndarray  # (c,), corrections of the used ways
    plain: np.ndarray  # standard normal numbers of the units (numbers, units)
    units: Units
    names: tuple[str, ...]  # of the responses
    outputs: tuple[str, ...]  # without errors
    most_failed: float | None  # share of units that may fail

    def nominal(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """Used ways (c,) of limits without errors, their derivatives (c, n), priced outputs and their derivatives."""
        decisions, outward = self.decisions, np.zeros((len(self.rows), self.decisions.size))
        outputs, rates = nominal_outputs(self.problem.response, decisions.population(x), self.outputs)
        used = np.zeros(len(self.rows))
        for k, row in enumerate(self.rows):
            if row.nominal and row.item is not None:
                value = outputs[row.name]
                used[k] = 1 + float(row.item.margin(value)) / self.ways[k] if math.isfinite(value) else math.inf
                used[k] += self.moved[k]
                outward[k] = float(row.item.outward(np.array(value))) * decisions.by_number(rates[row.name])
                outward[k] /= self.ways[k]
        priced = sum(price * outputs[name] for name, price in self.problem.objective.items())
        towards = sum(
            (p * decisions.by_number(rates[name]) for name, p in self.problem.objective.items()),
            np.zeros(decisions.size),
        )
        return used, outward, float(priced), towards

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
        margin = item.learned(valid) + cushion
        if not math.isfinite(margin):
            return math.inf, nothing
        if not sloped:
            return 1 + margin / self.ways[k], nothing
        few = own[: self.problem.effort.sloped]
        units, slopes = item.pull(few)
        if not len(units):
            return 1 + margin / self.ways[k], nothing
        seen = few[units]
        square = float(((seen - seen.mean()) ** 2).sum())  # the cushion grows as the spread of the units does
        more = cushion * (seen - seen.mean()) / square if square > 0 else 0.0
        pulled = {row.name: slopes + more}
        return 1 + margin / self.ways[k], self.units.slope(x, self.plain[:, units], pulled) / self.ways[k]

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
        margin, (worse, outward) = float(item.learned(ends.values)), item.pull(ends.values)
        by_width, active = outward @ ends.slopes[worse], list(decisions.base.active)
        found[:count] = by_width[[active.index(name) for name in decisions.fields]]
        for j in range(count, len(x)):
            there = x.copy()
            there[j] += STEP if x[j] + STEP <= decisions.high[j] else -STEP
            found[j] = (item.learned(both(decisions.population(there)).values) - margin) / (there[j] - x[j])
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
            units = units[: self.problem.effort.sloped]
            if sloped:
                pull = {name: np.asarray(loss.slope(values[name][units])) / len(units)}
                towards += self.units.slope(x, self.plain[:, units], pull)
        return total, towards
