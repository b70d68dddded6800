"""Result of an allocation, with what the end of a search says: prices of limits and bounds, margins, flat places.

A flat place is how far a number can be from its best value at little more cost. The number is held off that value and
the others are chosen again. The cost that this adds is modelled by its slope (the price of an active bound) and a
curvature, which the last such search corrects.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy import special

from rvjax.base import frames
from rvjax.population import Estimate, Population
from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.decisions import AT, Decisions
from rvjax.tolerances.allocation.look import DECIDES, Look
from rvjax.tolerances.allocation.programme import AGAIN, MET, End, Programme
from rvjax.tolerances.batch.statistics import Statistics


@dataclasses.dataclass(frozen=True)
class Allocation:
    """Cheapest tolerances found, and their certificate.

    Attributes:
        feasible: False if the requirements fail even at the finest tolerances.
        status: "OPTIMAL" (certified), "SUBOPTIMAL" (certified, at more than 1.2 times the learned cost),
            "INFEASIBLE", "MAX_STEPS" (certified, maybe not the cheapest) or "NOT_CERTIFIED".
        tolerances: structure of the given ones.
        cost: of all half-widths that have one, of the mid-points that were moved and of the numbers of the design,
            with the objective.
        start_cost: the same of the given tolerances.
        learned: the same of the half-widths that the search accepted, before certification tightened them.
        costs: {field: cost}.
        half_widths: {field: half-width} of the fields that have a cost.
        multipliers: structure of the response: d cost / d limit when its limits move outwards, <= 0.
        shortfall: structure of the response: distance by which the limits must move outwards, 0 if met; with a
            joint target, the least that each needs separately. With variables half-widths are at their finest and
            numbers where the shortfalls, in parts of their limits, add up to the least.
        residual: of the accepted set in the conditions of an optimum (Karush, Kuhn and Tucker): the largest
            saving of a single field that no price of a requirement accounts for, as a part of all savings; nan where
            nothing was searched. Sampled slopes give it to a few percent; the cost is off by about its square.
        certificate: `Statistics` of independent units at `tolerances`; of up to 65536 with their responses.
        grades: {field: grade} of an allocation rounded to grades, else None.
        graded: the allocation rounded to grades, with `grades=True`; else None. Its certificate of costly units has
            shares and verdicts; other figures may be nan, because units far inside the limits are not solved.
        history: one dict per evaluated set: cost, margins {constraint: value}, half_widths {field: value}.
        evaluations: units of the response that were solved by the "search", with a gradient or without, and for
            "certificates"; units of the last "sample" of the search.
        values: {variable: number of the design}.
        bounds_active: {variable: "lower" or "upper" where it is at a bound, else None}.
        value_prices: {variable: d cost / d bound of the bound at which it is, else 0}.
        ranges: {variable: (least, largest) value with which, all else chosen anew, the cost stays within 0.5 %};
            of costly units a number for which no units were left is not in it.
        margins: {requirement: distance beyond the limit of what it judges at the end of the search, <= 0 within it}
            of a programme on all decisions, with the corrections of its certificate; of a costly limit that does
            not decide, of the certificate's units.
        margin_slopes: {requirement: {field or variable: derivative of this margin to a half-width or number}}.
        losses: {response: `Estimate` of its mean loss, of the certificate's units that do not fail}.
        objective: `Estimate` of the cost with these losses; what the search minimises.
        reason: of an infeasible problem with variables: what fails by how much, and the bound that would help most.
        helps: that bound, as (variable, "lower" or "upper").
        starts: one dict per start that was tried on a small sample, the given one first: `begun`, the numbers and
            mid-points from which the search began; `values` and `cost` at its end; whether requirements were `met`
            there, and the `units` of the sample. Empty where there was one start only.
        multiplier_intervals: {requirement: interval of its multiplier at the confidence of the certificate} where
            units are costly: the sampling error of the units that the search solved.
        curve: (least yield of a requirement, cost) of the `yields`, ascending.
    """

    feasible: bool
    status: str
    tolerances: Any
    cost: float
    start_cost: float
    learned: float
    costs: dict[str, float]
    half_widths: dict[str, float]
    multipliers: Any
    shortfall: Any
    residual: float
    certificate: Statistics
    grades: dict[str, str] | None
    graded: "Allocation | None"
    history: list[dict[str, Any]]
    evaluations: dict[str, int]
    values: dict[str, float] = dataclasses.field(default_factory=dict)
    bounds_active: dict[str, str | None] = dataclasses.field(default_factory=dict)
    value_prices: dict[str, float] = dataclasses.field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    margins: dict[str, float] = dataclasses.field(default_factory=dict)
    margin_slopes: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)
    losses: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    objective: Estimate | None = None
    reason: str | None = None
    helps: tuple[str, str] | None = None
    starts: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    multiplier_intervals: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    curve: list[tuple[float, float]] = dataclasses.field(default_factory=list)

    def to_pandas(self) -> "frames.DataFrame":
        """A `pandas.DataFrame`, SI: limits, half-width, cost and grade of each field that has a cost."""
        active = Population.of(self.tolerances, None).active
        rows = [
            {
                "field": name,
                "lower": float(active[name].lower),
                "upper": float(active[name].upper),
                "half_width": half_width,
                "cost": self.costs[name],
                "grade": (self.grades or {}).get(name),
            }
            for name, half_width in self.half_widths.items()
        ]
        return frames.tidy(rows, ["field"])


def bounds_active(decisions: Decisions, x: np.ndarray) -> dict[str, str | None]:
    """The bound at which each number of the design is, or None.

    Args:
        decisions: of the vector.
        x: (n,) the vector.
    """
    values, active = decisions.values(x), dict[str, str | None]()
    for name, item in decisions.variables.items():
        near = AT * (item.upper - item.lower)
        at_lower, at_upper = values[name] <= item.lower + near, values[name] >= item.upper - near
        free = name in decisions.free and not item.among
        active[name] = ("lower" if at_lower else "upper" if at_upper else None) if free else None
    return active


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
    if constraints.problem.joint_target is not None:  # the joint margin moves with that of the requirement that leads
        last = len(constraints.rows) - 1
        margins, outward = constraints.margins(last, constraints.values(end.look.x))
        seen = constraints.quantile(last, margins)
        for name, pull in outward.items():
            found[name] += float(prices[-1] * np.abs(pull[seen.units]) @ seen.weights)
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
    for used, jacobian in _without_groups(constraints, end.look):
        there = dataclasses.replace(end.look, used=used, jacobian=jacobian)
        prices = programme.prices(there, AGAIN)
        several.append([*prices_of(constraints, end, prices, constraints.ways).values()])
    error = np.std(np.asarray(several), axis=0) * math.sqrt(_GROUPS - 1)
    half = dict(zip(values, map(float, special.stdtrit(_GROUPS - 1, (1 + confidence) / 2) * error)))
    return {name: (-value - half[name], -value + half[name]) for name, value in values.items()}


def _without_groups(constraints: Constraints, look: Look) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Used ways (c,) and their derivatives (c, n) without one group of the units, for each group."""
    values, seen = constraints.values(look.x), []
    for k, row in enumerate(constraints.rows):
        if row.share and math.isfinite(look.used[k]):
            margins, outward = constraints.margins(k, values)
            units = constraints.quantile(k, margins).units
            pulled = {name: pull[units] for name, pull in outward.items()}
            rates = constraints.units.slopes(look.x, constraints.tails.z[:, units], pulled) / constraints.ways[k]
            place = np.full(len(margins), -1)
            place[units] = np.arange(len(units))
            seen.append((k, margins, place, rates))
    for group in range(_GROUPS):
        used, jacobian = look.used.copy(), look.jacobian.copy()
        for k, margins, place, rates in seen:
            kept = np.flatnonzero(np.random.default_rng(len(margins)).permutation(len(margins)) % _GROUPS != group)
            there = constraints.quantile(k, margins[kept], weights=constraints.tails.weights[kept])
            near, weights = place[kept[there.units]], there.weights
            if (near < 0).all():
                continue
            weights = np.where(near < 0, 0.0, weights) * weights.sum() / weights[near >= 0].sum()
            used[k], jacobian[k] = 1 + there.level / constraints.ways[k], rates[:, near] @ weights
        yield used, jacobian


def margins_of(
    constraints: Constraints, look: Look, seen: Statistics
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Margins of the requirements at the end of a search, of two sides the larger, and their derivatives.

    Args:
        constraints: of the search.
        look: at the end, with all derivatives.
        seen: the certificate, which has all costly units of limits that do not decide.
    """
    units = dict(seen.values or {}) if constraints.by_quantiles else {}
    decisions, x = constraints.decisions, look.x
    values, slopes = dict[str, float](), dict[str, dict[str, float]]()
    first, widths = len(decisions.fields) + len(decisions.moves), decisions.half_widths(x)
    for k, row in enumerate(constraints.rows):
        value, rates = (look.used[k] - 1) * constraints.ways[k], look.jacobian[k] * constraints.ways[k]
        if row.share and row.name in units and look.used[k] <= DECIDES:
            own = constraints.margins(k, units)[0]
            value = constraints.quantile(k, own, weights=np.ones(len(own))).level
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


WITHIN = 0.005
"""Part of the cost that a number off its best value may add."""

_OFF = 0.05  # part of its range by which a number is first held off
_CLOSE = 0.15  # of the added cost, by which the end of a range may miss it


def ranges(constraints: Constraints, programme: Programme, end: End) -> dict[str, tuple[float, float]]:
    """{number: (least, largest) value with which the least cost stays within `WITHIN`}.

    Costly units are few, and their optimum is not that of the search: a range has both.

    Args:
        constraints: of the search; costly units are few afterwards.
        programme: of the search.
        end: of the search.
    """
    decisions, effort = constraints.decisions, constraints.problem.effort
    if effort.of_ranges:
        constraints.sample(effort.of_ranges)
    low, high = programme.low, programme.high

    def solved(start: End, k: int | None = None, at: float = 0.0) -> End:
        x = start.look.x.copy()
        if k is not None:
            programme.low, programme.high = low.copy(), high.copy()
            programme.low[k] = programme.high[k] = x[k] = at
        found = programme.run(x, AGAIN, most=effort.looks, gain=effort.roughly)
        programme.low, programme.high = low, high
        return found

    best = solved(end)
    found = {name: (value, value) for name, value in decisions.values(best.look.x).items()}
    for k, name in enumerate(decisions.free, len(decisions.fields) + len(decisions.moves)):
        if low[k] == high[k]:
            continue
        item, at, ends = decisions.variables[name], float(best.look.x[k]), list[float]()
        for sign, limit, slope in ((-1.0, low[k], best.at_high[k]), (1.0, high[k], best.at_low[k])):
            held = functools.partial(solved, best, k)
            way = _way(held, best, at, sign, abs(float(limit) - at), float(slope), effort.trials)
            there = min(max(at + sign * way, 0.0), 1.0)
            ends.append(item.lower + there * (item.upper - item.lower))
        own = decisions.values(end.look.x)[name]
        found[name] = min(*ends, own), max(*ends, own)
    return found


def _way(
    solved: Callable[[float], End], best: End, at: float, sign: float, most: float, slope: float, trials: int
) -> float:
    """Distance at which the least cost has grown by `WITHIN`, or `most`."""
    if most <= 0:
        return 0.0
    allowed = WITHIN * abs(best.look.total)
    inner, outer, way = 0.0, math.inf, min(_OFF, most)
    for _ in range(trials):
        there = solved(at + sign * way)
        if there.look.excess > MET:
            outer, way = way, (inner + way) / 2
            continue
        added = there.look.total - best.look.total
        if abs(added - allowed) <= _CLOSE * allowed or (way == most and added <= allowed):
            return way
        inner, outer = (way, outer) if added < allowed else (inner, way)
        bend = max(2 * (added - slope * way) / way**2, 1e-3 * allowed)
        new = (math.sqrt(slope**2 + 2 * bend * allowed) - slope) / bend
        new = min(max(new, way / 4), 8 * way, most)
        way = new if inner < new < outer else (inner + min(outer, most)) / 2 if math.isfinite(outer) else most
    return min(way, most)
