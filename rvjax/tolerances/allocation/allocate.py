"""Allocation: the cheapest tolerances that still meet every requirement, with a certificate or a refusal."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, cast

from rvjax._jax.checks import checked
from rvjax.base.progress import progress_bar
from rvjax.population import Correlation
from rvjax.response import DesignResponse, Response, unwrapped
from rvjax.tolerances.allocation.problem import problem_of
from rvjax.tolerances.allocation.result import Allocation
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.allocation.variable import Middle, Variable
from rvjax.tolerances.batch.memo import Memo


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
        return unwrapped(search.solution(grades=grades, yields=yields))
