"""Allocation: the cheapest tolerances that still meet every requirement, with a certificate or a refusal."""

import dataclasses
from collections.abc import Mapping
from typing import Any, cast

import jax
import numpy as np

from rvjax._ground.choices import unknown
from rvjax._ground.progress import progress_bar
from rvjax._jax.arguments import checked
from rvjax.population import Correlation, Population, Tolerance
from rvjax.records import Record, is_concrete
from rvjax.response import BLOCK, DesignResponse, Response, by_response, response_names, unwrapped
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.monte_carlo import Run, Statistics
from rvjax.tolerances.loss import QuadraticLoss
from rvjax.tolerances.optimum.certificate import Certifier
from rvjax.tolerances.optimum.cost import COSTS, Cost
from rvjax.tolerances.optimum.designer import Designer
from rvjax.tolerances.optimum.figures import allocation_of, check_objective
from rvjax.tolerances.optimum.found import status_of
from rvjax.tolerances.optimum.half_widths import HalfWidths
from rvjax.tolerances.optimum.problem import Problem
from rvjax.tolerances.optimum.result import Allocation
from rvjax.tolerances.optimum.sample_average import Training
from rvjax.tolerances.optimum.variable import Middle, Variable, check_middles, with_values
from rvjax.tolerances.requirements.kinds import Limits

FEWEST = 100  # units a quantile can be learned from
_STILL = 1e-9  # of the half-width: less is rounding of equal values
KEPT = 65_536  # units of a certificate whose responses are kept, at most


class Solved:
    """Solved costly units of a search and its certificate."""

    def __init__(self, training: Training, certifier: Certifier, learned: np.ndarray | None) -> None:
        assert training.followed is not None
        self.training, self.certifier, self.parts = training, certifier, training.followed.parts
        self.learned = learned
        """Half-widths (j,) before certification, None without any."""

    def given(self, tolerances: Any, requirements: dict[str, Limits]) -> Statistics:
        """Statistics of the units of the search with the tolerances from which it began."""
        units, run = self.training.followed, self.certifier.run
        assert units is not None
        population = Population.of(tolerances)
        asked = dataclasses.replace(
            run, population=population, requirements=requirements, samples=units.samples, seed=units.seed
        )
        return asked.of_units(*units.exactly(population))


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
    memo: Memo | None = None,
    progress: bool = False,
) -> Allocation:
    """The cheapest half-widths with every requirement met: shares of units, means, capabilities.

    Changing a half-width scales the limits about their mid-point; shift and cp stay. A sequential quadratic programme
    finds all decisions together: quantiles of units in the tails and their gradients are its constraints. Costly units
    with limits on shares alone are followed from one set of half-widths to the next instead. Where an audit finds that
    derivatives mislead, differences along rays take their place. Independent units certify the result: a value counts
    by the worse end of its confidence interval, and what a certificate sees corrects the search (docs/optimum.md).

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        requirements: `Requirement`, or a dict of them by name of the response.
        costs: record or dict with `ReciprocalPower`, `Exponential`, `Table` or None by field; a field without
            a cost keeps its tolerance.
        samples: units to learn from.
        seed: of these units; certificates use the seeds after it.
        joint_target: share of units that must meet all requirements at once, if wanted.
        correlation: {(field or element, field or element): correlation of their z}.
        certificate_samples: independent units per certificate.
        confidence: of the certificate's intervals.
        grades: also round fields with a `size` to ISO 286 grades and fit the other fields to them.
        max_steps: sets of half-widths tried, at most, for one set of mid-points.
        middles: {field: Middle} of errors whose limits may also move as a whole; the others keep their mid-point.
        variables: {name: Variable} of numbers of the design that are chosen too. The response is then
            response(errors, values), values a dict of scalars by name.
        objective: {output: price per unit} of outputs without errors that add to the cost.
        losses: `QuadraticLoss`, or a dict of them by name of the response: their mean over the units adds to the
            cost. With losses `requirements` may be {}.
        memo: stores long computations, so that an interrupted allocation resumes from there.
        progress: show progress bars.

    Returns:
        `Allocation`. A unit that fails is a reject; with a requirement on a mean or Cpk fewer than 0.27 % may
        fail, with confidence.

    Raises:
        ValueError: no requirement, no cost, or names that do not fit.
    """
    return allocated(
        cast(Response, response), tolerances, requirements, costs=costs, samples=samples, seed=seed,
        joint_target=joint_target, correlation=correlation, certificate_samples=certificate_samples,
        confidence=confidence, grades=grades, max_steps=max_steps, middles=middles, variables=variables,
        objective=objective, losses=losses, memo=memo, progress=progress,
    )[0]  # fmt: skip


def allocated(
    response: Response,
    tolerances: Any,
    requirements: Any,
    *,
    costs: Any,
    samples: int,
    seed: int,
    joint_target: float | None,
    certificate_samples: int,
    grades: bool,
    correlation: Correlation = None,
    confidence: float = 0.95,
    max_steps: int = 300,
    middles: Mapping[str, Middle] | None = None,
    variables: Mapping[str, Variable] | None = None,
    objective: Mapping[str, float] | None = None,
    losses: Any = None,
    memo: Memo | None = None,
    progress: bool = False,
) -> tuple[Allocation, Solved | None]:
    """Result of `allocate`, and its solved units where these are costly: later evaluations reuse them."""
    population = Population.of(tolerances, correlation)
    if variables or objective:
        population = with_values(response, population, variables or {})
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    lost = by_response(losses, names, QuadraticLoss, "losses")
    _check(required, lost, joint_target, samples=samples, certificate_samples=certificate_samples, max_steps=max_steps)
    priced = costs_by_field(costs, population.active, needed=not variables)
    check_middles(middles or {}, population.active)
    judged = {name: item for name, item in required.items() if item.of_sample}
    with progress_bar(progress, None, "searching", "step") as advance:
        run = Run(
            response, population, names, judged, certificate_samples, seed, block(samples, certificate_samples),
            confidence=confidence, progress=progress, keep=certificate_samples <= KEPT, label="certifying", memo=memo,
        )  # fmt: skip
        problem = Problem(
            response, population, required, priced, middles or {}, variables or {}, objective or {}, lost,
            joint_target, samples, seed, max_steps, run, memo, advance,
        )  # fmt: skip
        check_objective(problem.objective, names)
        decisions = problem.decisions()
        alone = problem.of_widths(decisions)
        solver = HalfWidths(problem, decisions, problem.start(decisions)) if alone else Designer(problem, decisions)
        found = solver.solution()
        rounded = None
        if grades and found.status != "INFEASIBLE" and priced:
            rounded, chosen = solver.graded(found)
            if rounded.status == "OPTIMAL" and found.status == "NOT_CERTIFIED":  # grades near it are the set
                found = dataclasses.replace(
                    rounded, status=status_of(
                        certified=True, exact=True, cost=rounded.cost, learned=found.learned, settled=found.settled,
                        stationary=found.stationary,
                    ),
                )  # fmt: skip
        solved = solver.certifier.solved
        result = allocation_of(problem, found, names, solved)
        if rounded is not None:
            graded = dataclasses.replace(allocation_of(problem, rounded, names, solved), grades=chosen, ranges={})
            result = dataclasses.replace(result, graded=graded)
    if not isinstance(solver, HalfWidths):
        return unwrapped(result), None
    return unwrapped(result), Solved(solver.ended, solver.certifier, solver.learned)


def block(samples: int, certificate_samples: int) -> int:
    """Units of a certificate evaluated at once: as many as the search does where that needs no second program."""
    return min(samples, BLOCK) if certificate_samples < BLOCK else BLOCK


def _check(
    required: dict[str, Limits], losses: dict[str, QuadraticLoss], joint_target: float | None, **counts: int
) -> None:
    if not required and not losses:
        raise ValueError("requirements: needs at least one, or a loss")
    if joint_target is not None and not 0 < joint_target < 1:
        raise ValueError(f"joint_target = {joint_target!r}: must lie between 0 and 1")
    if joint_target is not None and not any(item.of_units for item in required.values()):
        raise ValueError(f"joint_target = {joint_target!r}: no requirement is for single units")
    check_counts(**counts)


def check_counts(**counts: int) -> None:
    """Raise ValueError for fewer than 100 `samples`, or less than 1 of something else.

    Args:
        **counts: by the name of the argument.
    """
    for name, value in counts.items():
        least = FEWEST if name == "samples" else 1
        if value < least:
            raise ValueError(f"{name} = {value!r}: must be at least {least}")


def costs_by_field(costs: Any, active: Mapping[str, Tolerance], *, needed: bool = True) -> dict[str, Cost]:
    """Costs of the active fields, in their order.

    Args:
        costs: as in `allocate`.
        active: fields that have a tolerance.
        needed: whether a field must have one.

    Raises:
        ValueError: another structure, something that is no cost, or a name without a tolerance.
    """
    if not isinstance(costs, (Mapping, Record)) or isinstance(costs, Cost):
        raise ValueError(f"costs: must be a record or a dict of costs by field, got {type(costs).__name__}")
    leaves, _ = jax.tree_util.tree_flatten_with_path(costs, is_leaf=lambda item: item is None or isinstance(item, Cost))
    given = {jax.tree_util.keystr(path, simple=True, separator="."): cost for path, cost in leaves}
    for name, cost in given.items():
        if cost is None or (isinstance(cost, float) and cost == 0):
            continue
        if not isinstance(cost, Cost):
            laws = ", ".join(law.__name__ for law in COSTS.values())
            raise ValueError(f"costs: {name} = {cost!r}: must be one of {laws}")
        if name not in active:
            raise unknown(f"costs: {name!r}", name, active, " has no tolerance; these have:")
    priced = {name: given[name] for name in active if isinstance(given.get(name), Cost)}
    for name in priced:  # no half-width would matter, and the coarsest costs least
        one = active[name]
        if (
            is_concrete(one.half_width)
            and one.half_width > 0
            and np.all(one.moments()[1] <= (_STILL * one.half_width) ** 2)
        ):
            raise ValueError(
                f"tolerances: {name} does not vary: {one.distribution} values that are all equal; measure with a "
                "finer step, or give another distribution"
            )
    if needed and not priced:
        raise ValueError("costs: no field has a cost, so there is nothing to allocate")
    return priced
