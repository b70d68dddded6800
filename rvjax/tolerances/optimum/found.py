"""Solution of a problem and its status. No other place calls an end or a set of grades OPTIMAL."""

import dataclasses
from typing import Any

import numpy as np

from rvjax.tolerances.batch.monte_carlo import Statistics
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.feasibility import Shortage
from rvjax.tolerances.optimum.programme import End

DEARER = 0.2  # than learned, as a part of that cost: what is certified at more is not called the cheapest


@dataclasses.dataclass(frozen=True)
class Found:
    """Solution of a problem.

    Attributes:
        status: as in `Allocation`.
        decisions: whose vector `x` is.
        x: (n,) the solution.
        certificate: of the solution.
        learned: cost before certification.
        cost: of the solution, with the priced outputs, without losses.
        prices: {requirement: reduction of the cost per outward move of its limits}, nan where nothing was searched.
        shortfall: {requirement: distance by which its limits must move outwards}.
        residual: of the conditions of an optimum.
        settled: no limit of steps ended the search.
        stationary: the residual is small, or a search by values was exhausted.
        exact: every limit without sampling error is met.
        evaluated: units that the search solved.
        history: one dict per vector.
        end: of a programme on all decisions, None without one.
        shortage: of an infeasible problem that a programme searched.
        margins: {requirement: margin at the end of the programme}, with its derivatives in `slopes`.
        slopes: {requirement: {field or number: derivative}}.
        intervals: {requirement: interval of its price} of costly units.
        ranges: {number: values with which the cost stays within 0.5 %}.
        starts: one dict per start that was tried on a small sample.
    """

    status: str
    decisions: Decisions
    x: np.ndarray
    certificate: Statistics
    learned: float
    cost: float
    prices: dict[str, float]
    shortfall: dict[str, float]
    residual: float
    settled: bool
    stationary: bool
    exact: bool
    evaluated: int
    history: list[dict[str, Any]]
    end: End | None = None
    shortage: Shortage | None = None
    margins: dict[str, float] = dataclasses.field(default_factory=dict)
    slopes: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)
    intervals: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    starts: list[dict[str, Any]] = dataclasses.field(default_factory=list)


def status_of(*, certified: bool, exact: bool, cost: float, learned: float, settled: bool, stationary: bool) -> str:
    """Status of an end.

    Args:
        certified: the certificate of this end holds.
        exact: every limit without sampling error is met there: outputs without errors, worst cases.
        cost: of this end.
        learned: cost before certification.
        settled: no limit of steps ended the search.
        stationary: the residual of the conditions of an optimum is small, or differences along rays were exhausted.
    """
    if not (certified and exact):
        return "NOT_CERTIFIED"
    if cost > learned + DEARER * abs(learned):
        return "SUBOPTIMAL"
    return "OPTIMAL" if settled and stationary else "MAX_STEPS"


def with_grades(found: Found, x: np.ndarray, certificate: Statistics, cost: float, *, certified: bool) -> Found:
    """A solution with other half-widths, rounded to grades: of these OPTIMAL means certified.

    Args:
        found: the solution before.
        x: (n,) its vector with the grades.
        certificate: of these.
        cost: of these.
        certified: the certificate holds.
    """
    status = "OPTIMAL" if certified and found.exact else "NOT_CERTIFIED"
    return dataclasses.replace(found, x=x, certificate=certificate, cost=cost, status=status)
