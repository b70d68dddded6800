"""Requirement curves: cost of a tighter limit or a higher yield."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rvjax._ground.choices import choose
from rvjax._jax.arguments import checked
from rvjax.population import Population
from rvjax.response import Response
from rvjax.tolerances.allocating import Solved, allocate, block
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.monte_carlo import Run, Statistics
from rvjax.tolerances.optimum.cost import Cost
from rvjax.tolerances.optimum.result import Allocation
from rvjax.tolerances.optimum.sample_average import Training
from rvjax.tolerances.optimum.search import NOISE, Search
from rvjax.tolerances.requirements.limits import Limits

_DRAWN_TO = 0.01  # part of a cost, or of the way to a limit, to which a point of costly units is searched
_WRONG = 0.5  # costly units on the wrong side of a limit, in standard errors of the number beyond it
_STEPS = 30  # sets of half-widths that a search for one yield looks at, at most


@dataclasses.dataclass(frozen=True)
class CostCurve:
    """The cheapest cost along a requirement.

    Attributes:
        against: "limit" or "target".
        of: name of the requirement that moves; None for the only one, or for all (targets).
        values: limits (unit of the response; half the width of a two-sided requirement) or targets.
        costs: cheapest certified cost of each, nan where the requirements cannot be met.
        learned: the same before certification: smoother along the curve, a little lower.
        multipliers: d cost / d limit of the moving requirement (of a target curve: nan).
        evaluations: sets of half-widths that each search looked at.
        allocations: the `Allocation` of each value.
    """

    against: str
    of: str | None
    values: tuple[float, ...]
    costs: tuple[float, ...]
    learned: tuple[float, ...]
    multipliers: tuple[float, ...]
    evaluations: tuple[int, ...]
    allocations: tuple[Allocation, ...]


@checked
def cost_curve(
    response: Response,
    tolerances: Any,
    requirements: Any,
    *,
    costs: Any,
    values: Sequence[float],
    against: str = "limit",
    of: str | None = None,
    **options: Any,
) -> CostCurve:
    """The cheapest cost for each of several limits, or targets, of a requirement.

    Every search starts from the last solution and uses the same units and the same compiled programs.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field; where the first search starts.
        requirements: `Requirement`, or a dict of them by name of the response.
        costs: record or dict with a cost or None by field.
        values: of the limit (a one-sided limit itself; half-widths about the mid-point of two limits) or of the
            target, in the order to go through; neighbours should be near each other.
        against: "limit" or "target".
        of: name of the requirement that moves; None moves the only one, or all shares of units (targets).
        **options: of `allocate`, such as `samples`, `seed`, `certificate_samples`.

    Returns:
        `CostCurve`.

    Raises:
        ValueError: no values, an unknown `against` or `of`, or several limits and no `of`.
    """
    choose("against", against, ("limit", "target"))
    if not len(values):
        raise ValueError("values: needs at least one")
    _check_of(requirements, against, of)
    allocations: list[Allocation] = []
    start = tolerances
    for value in values:
        required = _moved(requirements, against, of, float(value))
        allocations.append(allocate(response, start, required, costs=costs, **options))
        if allocations[-1].feasible:
            start = allocations[-1].tolerances
    return CostCurve(
        against=against,
        of=of,
        values=tuple(map(float, values)),
        costs=tuple(a.cost if a.feasible else math.nan for a in allocations),
        learned=tuple(a.learned if a.feasible else math.nan for a in allocations),
        multipliers=tuple(_price(a, of) if against == "limit" and a.feasible else math.nan for a in allocations),
        evaluations=tuple(len(a.history) for a in allocations),
        allocations=tuple(allocations),
    )


def _check_of(requirements: Any, against: str, of: str | None) -> None:
    if isinstance(requirements, Mapping):
        names = ", ".join(requirements)
        if of is not None and of not in requirements:
            raise ValueError(f"of = {of!r}: no requirement has this name; these exist: {names}")
        if of is None and against == "limit" and len(requirements) > 1:
            raise ValueError(f"of: name the requirement whose limit moves, one of {names}")
    elif of is not None:
        raise ValueError(f"of = {of!r}: there is only one requirement, without a name")


def _moved(requirements: Any, against: str, of: str | None, value: float) -> Any:
    """The requirements with one limit, or the targets, at a value."""
    if isinstance(requirements, Mapping):
        moving = {n for n, item in requirements.items() if against == "limit" or item.goal == "target"}
        moving = moving if of is None else {of}
        return {
            name: _moved(item, against, None, value) if name in moving else item for name, item in requirements.items()
        }
    if not isinstance(requirements, Limits):
        raise ValueError(f"requirements = {requirements!r}: must be a requirement, or a dict of them")
    return requirements.aimed(value) if against == "target" else requirements.limited(value)


def _price(allocation: Allocation, of: str | None) -> float:
    if isinstance(allocation.multipliers, Mapping):
        name = next(iter(allocation.certificate.verdicts)) if of is None else of
        return float(allocation.multipliers[name])
    return float(allocation.multipliers)


def cost_of_yields(
    response: Response,
    tolerances: Any,
    requirements: dict[str, Limits],
    *,
    costs: dict[str, Cost],
    targets: Sequence[float],
    samples: int,
    seed: int,
    units: int,
    memo: Memo | None = None,
    solved: Solved | None = None,
) -> list[tuple[float, float]]:
    """Cost of other targets, one search each: (least yield of a requirement, cost) of its result.

    Nothing is certified: the yield is measured on independent units, for any target.

    Args:
        response: pure function of the errors of one unit; a dict of scalars, or an `Outcome` of these.
        tolerances: record or dict with a `Tolerance` or None in each field; where the first search starts.
        requirements: by name of the response.
        costs: by field.
        targets: of all shares of units, in any order. Searches go away from the targets of the requirements, each from
            the last result: units move least, and so fewest are solved again.
        samples: units to learn from.
        seed: of these units; the fresh ones have the one after it.
        units: fresh ones behind each yield.
        memo: keeps what took long to compute.
        solved: units of the allocation whose tolerances these are, if they are costly; they serve here too.
    """
    population, points = Population.of(tolerances), []
    priced = {name: costs[name] for name in population.active if name in costs}
    start = np.array([float(population.active[name].half_width) for name in priced])
    start = start if solved is None or solved.learned is None else solved.learned
    goal = min(float(getattr(item, item.goal)) for item in requirements.values() if item.goal == "target")
    for side in (sorted((x for x in targets if x < goal), reverse=True), sorted(x for x in targets if x >= goal)):
        t, before = start, None if solved is None else solved.training
        for target in side:
            required = _moved(requirements, "target", None, target)
            if before is not None:
                before = training = before.aimed(required, t, math.inf)
            else:
                training = Training(response, population, tuple(priced), required, None, samples, seed, memo)
            search = Search(training, priced, _STEPS)
            if solved is not None:
                search.settled, search.gain = _DRAWN_TO, _DRAWN_TO
            point = search.begin(t)
            training.wrong = _wrong(target, samples)
            point, _ = search.run(point)
            if not (point.margins <= NOISE * training.distance).all():
                continue
            t = point.half_widths
            made = training.with_half_widths(t)
            if solved is not None:
                fresh = solved.certifier.draw(made, wrong=_wrong(target, solved.certifier.run.samples), alone=True)
            else:
                drawn = units, seed + 1, block(samples, units)
                fresh = Run(response, made, training.names, required, *drawn, memo=memo).statistics()
            points.append((least_yield(fresh), search.cost(t)))
    return points


def _wrong(target: float, units: int) -> float:
    """Units on the wrong side of a limit that change a yield of some units little."""
    return _WRONG * math.sqrt(units * target * (1 - target))


def least_yield(statistics: Statistics) -> float:
    """The least share of units that keeps one requirement; a study without any has no curve."""
    return min(verdict.estimate.value for verdict in statistics.verdicts.values() if verdict.kind == "share")
