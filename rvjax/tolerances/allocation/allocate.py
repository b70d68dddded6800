"""Allocation: the cheapest tolerances that still meet every requirement, with a certificate or a refusal.

Curves of the cost along a limit or a yield are searches one after the other, each from the end of the last one.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.progress import progress_bar
from rvjax.base.words import choose
from rvjax.population import Correlation
from rvjax.response import DesignResponse, Response, unwrapped
from rvjax.tolerances.allocation.decisions import ROUNDING
from rvjax.tolerances.allocation.grades import Grades
from rvjax.tolerances.allocation.problem import problem_of
from rvjax.tolerances.allocation.programme import COARSE, LOOKS, MET, End
from rvjax.tolerances.allocation.result import Allocation, ranges
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.allocation.shortage import least_shortage, refused
from rvjax.tolerances.allocation.variable import Middle, Variable
from rvjax.tolerances.batch.checkpoint import Memo
from rvjax.tolerances.limits import Limits


@checked
def allocate(
    response: Response | DesignResponse,
    tolerances: Any,
    requirements: Any,
    *,
    costs: Any,
    samples: int = 16384,
    seed: int = 0,
    joint_target: float | None = None,
    correlation: Correlation = None,
    certificate_samples: int = 1_000_000,
    confidence: float = 0.95,
    grades: bool = False,
    max_steps: int = 300,
    middles: Mapping[str, Middle] | None = None,
    variables: Mapping[str, Variable] | None = None,
    objective: Mapping[str, float] | None = None,
    losses: Any = None,
    yields: Sequence[float] = (),
    memo: Memo | None = None,
    progress: bool = False,
) -> Allocation:
    """The cheapest half-widths with every requirement met: shares of units, means, capabilities.

    Changing a half-width scales the limits about their mid-point; shift and cp stay. All decisions are searched
    together on a sample that grows until enough of its units lie beyond each limit that decides. Independent units
    certify the result: a value counts by the worse end of its confidence interval, and what a certificate sees corrects
    what the sample must show (docs/optimum.md).

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        requirements: `Requirement`, or a dict of them by name of the response.
        costs: record or dict with `ReciprocalPower`, `Exponential`, `Table` or None by field; a field without
            a cost keeps its tolerance.
        samples: units to begin with.
        seed: of these units; certificates use the seeds after it.
        joint_target: share of units that must meet all requirements at once, if wanted.
        correlation: {(field or element, field or element): correlation of their z}.
        certificate_samples: independent units per certificate, at least; more are used where they save more than
            2 % of the cost.
        confidence: of the certificate's intervals.
        grades: also round fields with a `size` to ISO 286 grades and fit the other fields to them.
        max_steps: vectors of decisions that one run of the search looks at, at most.
        middles: {field: Middle} of errors whose limits may also move as a whole; the others keep their mid-point.
        variables: {name: Variable} of numbers of the design that are chosen too. The response is then
            response(errors, values), values a dict of scalars by name.
        objective: {output: price per unit} of outputs without errors that add to the cost.
        losses: `QuadraticLoss`, or a dict of them by name of the response: their mean over the units adds to the
            cost. With losses `requirements` may be {}.
        yields: other targets of all shares of units, for which `Allocation.curve` has the cost.
        memo: stores long computations, so that an interrupted allocation resumes from there.
        progress: show progress bars.

    Returns:
        `Allocation`. A unit that fails is a reject; with a requirement on a mean or Cpk fewer than 0.27 % may
        fail, with confidence.

    Raises:
        ValueError: no requirement, no cost, or names that do not fit.
    """
    problem = problem_of(
        cast(Response, response), tolerances, requirements, costs=costs, samples=samples, seed=seed,
        joint_target=joint_target, correlation=correlation, certificate_samples=certificate_samples,
        confidence=confidence, max_steps=max_steps, middles=middles, variables=variables, objective=objective,
        losses=losses, memo=memo, progress=progress,
    )  # fmt: skip
    with progress_bar(progress, None, "searching", "step") as advance:
        search = Search(dataclasses.replace(problem, advance=advance))
        return unwrapped(solution(search, grades=grades, yields=yields))


def solution(search: Search, *, grades: bool, yields: Sequence[float]) -> Allocation:
    """The cheapest certified vector, or the least shortage.

    Args:
        search: of the problem.
        grades: also the cheapest with half-widths of ISO 286 grades.
        yields: other targets of all shares, for the cost curve.
    """
    end = search.learned()
    if end.look.excess > MET or search.constraints.missed(end.look) > ROUNDING:
        shortage = least_shortage(search, end.look.x)
        if shortage.look.excess > MET:
            return refused(search, shortage)
        end = search.run(shortage.look.x)
    found, end = search.certified(end)
    kept = search.constraints.rejects.copy(), search.constraints.moved.copy()
    if grades and search.problem.priced and found.feasible:
        rounded, look = Grades(search).rounded(end, found)
        if rounded.status == "OPTIMAL" and found.status == "NOT_CERTIFIED":  # grades near it are the set
            seen = search.certifier.whole(rounded.certificate, search.constraints, look.x)
            status = search.status(seen, end, found.learned, look)
            found = dataclasses.replace(rounded, certificate=seen, status=status, grades=None)
        found = dataclasses.replace(found, graded=rounded)
    search.constraints.rejects, search.constraints.moved = kept
    count = search.constraints.count
    found = dataclasses.replace(found, curve=costs_of_yields(search, end, yields))
    if search.problem.variables and search.rays is None:
        search.constraints.rejects, search.constraints.moved = kept[0], kept[1].copy()
        found = dataclasses.replace(found, ranges=ranges(search.constraints, search.programme, end))
    return dataclasses.replace(found, evaluations=search.evaluations(count))


def costs_of_yields(search: Search, end: End, yields: Sequence[float]) -> list[tuple[float, float]]:
    """(least yield of a requirement, cost) of other targets, ascending; yields are those of independent units.

    Args:
        search: of the problem; its sample and wanted rejects are others afterwards.
        end: from which searches go away.
        yields: targets of all shares.
    """
    problem, constraints, certifier = search.problem, search.constraints, search.certifier
    if not yields or not any(row.share for row in constraints.rows):
        return []
    goal = min((item.target for item in problem.requirements.values() if item.of_shares), default=1.0)  # type: ignore[attr-defined]
    points = list[tuple[float, float]]()
    most, fresh_units = problem.effort.of_yields
    if most:
        constraints.sample(min(constraints.count, most))
    for side in (sorted((y for y in yields if y < goal), reverse=True), sorted(y for y in yields if y >= goal)):
        x = end.look.x
        for target in side:
            moved = [
                1 - target if row.share and row.item else old for row, old in zip(constraints.rows, constraints.rejects)
            ]
            constraints.rejects = np.array(moved)
            there = search.programme.run(x, most=LOOKS, gain=COARSE)
            if there.look.excess > 2 * MET:
                continue
            x = there.look.x
            points.append((certifier.yield_at(constraints, x, fresh_units), there.look.total))
    return sorted(points)


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
