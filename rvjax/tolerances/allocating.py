"""Allocation: the cheapest tolerances that still meet every requirement, with a certificate or a refusal."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._ground.choices import unknown
from rvjax._ground.progress import progress_bar
from rvjax._jax.arguments import checked
from rvjax.population import Correlation, Population, Tolerance
from rvjax.records import Record
from rvjax.response import BLOCK, DesignResponse, Response, by_response, response_names, unwrapped
from rvjax.tolerances.allocation.certificate import DRAWS, Certifier
from rvjax.tolerances.allocation.cost import COSTS, Cost
from rvjax.tolerances.allocation.result import Allocation
from rvjax.tolerances.allocation.rounding import Rounding
from rvjax.tolerances.allocation.sample_average import Point, Training
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.monte_carlo import Run, Statistics
from rvjax.tolerances.codesign.nominal import Nominal
from rvjax.tolerances.codesign.problem import Problem
from rvjax.tolerances.codesign.result import designed
from rvjax.tolerances.codesign.variable import Middle, Variable, check_middles, with_values
from rvjax.tolerances.requirements.kinds import Limits

FEWEST = 100  # units a quantile can be learned from
DEARER = 0.2  # than learned, as a part of that cost: what is certified at more is not called the cheapest
KEPT = 65_536  # units of a certificate whose responses are kept, at most


class Solved:
    """Solved costly units of a search and its certificate."""

    def __init__(self, training: Training, certifier: Certifier) -> None:
        assert training.followed is not None
        self.training, self.certifier, self.parts = training, certifier, training.followed.parts

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
    memo: Memo | None = None,
    progress: bool = False,
) -> Allocation:
    """The cheapest half-widths with every requirement met: shares of units, means, capabilities.

    Changing a half-width scales the limits about their mid-point; shift and cp stay. One sample of units serves all
    steps. Each step models every constraint as a root sum of squares with the sampled margins and slopes. The model
    is separable: prices of the constraints that maximise its dual function give its optimum in a trust region. The
    step is accepted if the sampled cost and violation fall. Where an audit finds that derivatives mislead,
    differences along rays take their place. A larger sample corrects the margins once, unless units are costly: of
    these only units that decide are solved. Independent units then certify the result: a value counts by the worse
    end of its confidence interval, and half-widths are tightened where that costs least until it holds.

    With `middles`, `variables`, `objective` or a `Nominal` requirement a sequential quadratic programme finds all
    decisions together (docs/codesign.md).

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
        objective=objective, memo=memo, progress=progress,
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
    memo: Memo | None = None,
    progress: bool = False,
) -> tuple[Allocation, Solved | None]:
    """Result of `allocate`, and its solved units where these are costly: later evaluations reuse them."""
    population = Population.of(tolerances, correlation)
    if variables or objective:
        population = with_values(response, population, variables or {})
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    _check(required, joint_target, samples=samples, certificate_samples=certificate_samples, max_steps=max_steps)
    priced = costs_by_field(costs, population.active, needed=not variables)
    check_middles(middles or {}, population.active)
    if middles or variables or objective or any(isinstance(item, Nominal) for item in required.values()):
        drawn = certificate_samples, seed, block(samples, certificate_samples)
        judged = {name: item for name, item in required.items() if not isinstance(item, Nominal)}
        with progress_bar(progress, None, "searching", "step") as advance:
            run = Run(
                response, population, names, judged, *drawn, confidence=confidence, progress=progress,
                keep=certificate_samples <= KEPT, label="certifying", memo=memo,
            )  # fmt: skip
            problem = Problem(
                response, population, required, priced, middles or {}, variables or {}, objective or {}, joint_target,
                samples, seed, max_steps, run, memo, advance,
            )  # fmt: skip
            results = designed(problem, names, grades=grades)
        result, *rounded = [Allocation(**fields) for fields in results]
        return unwrapped(dataclasses.replace(result, graded=rounded[0]) if rounded else result), None
    start = np.array([float(population.active[name].half_width) for name in priced])
    training = Training(response, population, tuple(priced), required, joint_target, samples, seed, memo)
    with progress_bar(progress, None, "searching", "step") as advance:
        drawn = certificate_samples, seed, block(samples, certificate_samples)
        run = Run(
            response, training.population, names, required, *drawn, confidence=confidence, progress=progress,
            keep=certificate_samples <= KEPT, label="certifying", memo=memo,
        )  # fmt: skip
        certifier = Certifier(run, joint_target, follows=training.followed is not None)
        search = Search(training, priced, max_steps, advance)
        advance(0)
        point, possible = search.opened(start)
        found = _cheapest(search, certifier, point, start) if possible else _finest(search, certifier)
    given = names, start, certifier
    result = _result(search, found, *given)
    solved = None if training.followed is None else Solved(training, certifier)
    if not grades or not result.feasible:
        return unwrapped(result), solved
    t, chosen, certificate = Rounding(search, certifier, priced).graded(found.half_widths, found.certificate)
    status = "OPTIMAL" if certifier.holds(certificate) else "NOT_CERTIFIED"
    snapped = dataclasses.replace(found, status=status, half_widths=t, certificate=certificate)
    if status == "OPTIMAL" and not certifier.holds(found.certificate):  # grades near it are certified: they are the set
        found = dataclasses.replace(snapped, status=_status(search, found.learned, t, found.settled))
        result = _result(search, found, *given)
    graded = dataclasses.replace(_result(search, snapped, *given), grades=chosen)
    return unwrapped(dataclasses.replace(result, graded=graded)), solved


def block(samples: int, certificate_samples: int) -> int:
    """Units of a certificate evaluated at once: as many as the search does where that needs no second program."""
    return min(samples, BLOCK) if certificate_samples < BLOCK else BLOCK


def _check(required: dict[str, Limits], joint_target: float | None, **counts: int) -> None:
    if not required:
        raise ValueError("requirements: needs at least one")
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


@dataclasses.dataclass(frozen=True)
class _Found:
    """Result of a search.

    `prices` and `shortfall` by requirement; `learned`: cost before certification; `settled`: no limit of steps ended
    the search.
    """

    status: str
    learned: float
    half_widths: np.ndarray
    certificate: Statistics
    prices: np.ndarray
    shortfall: dict[str, float]
    residual: float = math.nan
    settled: bool = True


def _cheapest(search: Search, certifier: Certifier, point: Point, start: np.ndarray) -> _Found:
    training, run = search.training, certifier.run
    point, settled = search.find(point, start)
    if run.samples > training.samples and training.followed is None:  # a larger sample is more accurate
        seen = certifier.draw(training.with_half_widths(point.half_widths))
        point, settled = search.find(training.correct(point, certifier.factors(seen, training.distance)), start)
    prices = search.prices(point)
    if search.shrinks(point):
        half_widths, certificate = _certified(search, certifier, point, start)
    else:
        half_widths, certificate = _aimed(search, certifier, point, start)
    learned, nothing = search.cost(point.half_widths), dict.fromkeys(run.requirements, 0.0)
    status = _status(search, learned, half_widths, settled)
    if not certifier.holds(certificate):
        status = "NOT_CERTIFIED"
    return _Found(status, learned, half_widths, certificate, prices, nothing, search.residual(point), settled)


def _status(search: Search, learned: float, half_widths: np.ndarray, settled: bool) -> str:
    """Status of certified half-widths, by their cost over the learned one and the end of the search."""
    if search.cost(half_widths) > (1 + DEARER) * learned:
        return "SUBOPTIMAL"
    return "OPTIMAL" if settled else "MAX_STEPS"


def _certified(search: Search, certifier: Certifier, point: Point, start: np.ndarray) -> tuple[np.ndarray, Statistics]:
    """The cheapest certified set: what was found, tightened where need be, or the start, or the finest."""
    training, start = search.training, search.inside(start)
    best, certificate = certifier.settle(search, point)
    best, certificate = certifier.polished(search, point, best, certificate)
    others = [t for t in (start, search.low) if not certifier.holds(certificate) or search.cost(t) < search.cost(best)]
    for other in sorted(others, key=search.cost):
        if certifier.hopeless():
            break
        if search.promising(other):
            drawn = certifier.draw(training.with_half_widths(other))
            if certifier.holds(drawn):
                return other, drawn
    return best, certificate


def _aimed(search: Search, certifier: Certifier, point: Point, start: np.ndarray) -> tuple[np.ndarray, Statistics]:
    """Certified set where smaller half-widths do not help: correct the sample by a certificate, search again."""
    certificate = certifier.draw(search.training.with_half_widths(point.half_widths))
    for _ in range(DRAWS - 1):
        if certifier.holds(certificate) or certifier.hopeless():
            break
        told = search.training.correct(point, certifier.factors(certificate, search.training.distance))
        point, _ = search.find(told, start)
        certificate = certifier.draw(search.training.with_half_widths(point.half_widths))
    return point.half_widths, certificate


def _finest(search: Search, certifier: Certifier) -> _Found:
    """Result where even the finest half-widths fail on the learning sample; an independent one gives the shortfall."""
    certificate, shortfall = certifier.shortfall(search.training.with_half_widths(search.low))
    refused = certifier.joint_target is not None or any(missing > 0 for missing in shortfall.values())
    status = "INFEASIBLE" if refused else "NOT_CERTIFIED"  # the larger sample may see the limits just met
    if certifier.holds(certificate):
        status = "OPTIMAL"
    return _Found(status, search.cost(search.low), search.low, certificate, np.zeros(len(shortfall)), shortfall)


def _result(
    search: Search, found: _Found, names: tuple[str, ...], start: np.ndarray, certifier: Certifier
) -> Allocation:
    t, training, nothing = found.half_widths, search.training, dict.fromkeys(names, 0.0)
    costs = zip(training.fields, search.costs, t)
    return Allocation(
        feasible=found.status != "INFEASIBLE",
        status=found.status,
        tolerances=training.with_half_widths(t).tolerances,
        cost=search.cost(t),
        start_cost=search.cost(start),
        learned=found.learned,
        costs={name: float(cost(jnp.asarray(half_width))) for name, cost, half_width in costs},
        half_widths=dict(zip(training.fields, map(float, t))),
        multipliers=nothing | dict(zip(training.requirements, map(float, -found.prices))),
        shortfall=nothing | found.shortfall,
        residual=found.residual,
        certificate=found.certificate,
        grades=None,
        graded=None,
        history=search.history,
        evaluations={"search": training.evaluated[0], "certificates": certifier.solved},
    )


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
    if needed and not priced:
        raise ValueError("costs: no field has a cost, so there is nothing to allocate")
    return priced
