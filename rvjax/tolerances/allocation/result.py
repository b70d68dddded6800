"""Result of an allocation."""

import dataclasses
from typing import Any

import numpy as np

from rvjax.base import frames
from rvjax.population import Estimate, Population
from rvjax.tolerances.allocation.decisions import AT, Decisions
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
        graded: the allocation rounded to grades, with `grades=True`; else None.
        history: one dict per evaluated set: cost, margins {constraint: value}, half_widths {field: value}.
        evaluations: units of the response that were solved by the "search", with a gradient or without, and for
            "certificates"; units of the last "sample" of the search.
        values: {variable: number of the design}.
        bounds_active: {variable: "lower" or "upper" where it is at a bound, else None}.
        value_prices: {variable: d cost / d bound of the bound at which it is, else 0}.
        ranges: {variable: (least, largest) value with which, all else chosen anew, the cost stays within 0.5 %};
            of costly units a number for which no units were left is not in it.
        margins: {requirement: distance beyond the limit of what it judges at the end of the search, <= 0 within it}
            of a programme on all decisions, with the corrections of its certificate.
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

    def to_pandas(self) -> Any:
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
