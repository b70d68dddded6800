"""Allocation: the cheapest tolerances that still meet every requirement, with a certificate or a refusal."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import Record
from rvjax.tolerances.allocation.certificate import Certifier
from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.allocation.snapping import Snapping
from rvjax.tolerances.allocation.training import Training
from rvjax.tolerances.population.correlation import Correlation, correlated
from rvjax.tolerances.population.layout import Layout, layout
from rvjax.tolerances.propagation.monte_carlo import Statistics, progress_bar
from rvjax.tolerances.propagation.requirements import Requirement
from rvjax.tolerances.propagation.responses import Response, by_response, like_response, response_names

_FEWEST = 100  # units a quantile can be learned from


@dataclasses.dataclass(frozen=True)
class Allocation:
    """The cheapest tolerances found and how sure they are.

    Attributes:
        feasible: False if the requirements fail even at the finest tolerances.
        status: "OPTIMAL" (certified), "INFEASIBLE", "MAX_STEPS" (certified, maybe not the cheapest) or
            "NOT_CERTIFIED".
        tolerances: structure of the given ones.
        cost: of all fields that have one.
        start_cost: the same of the given tolerances.
        costs: {field: cost}.
        half_widths: {field: half-width} of the fields that have a cost.
        multipliers: structure of the response: d cost / d limit when its limits move outwards, <= 0.
        shortfall: structure of the response: how far the limits would have to move outwards, 0 if met; with a
            joint target, the least each needs by itself.
        certificate: `Statistics` of fresh units at `tolerances`.
        grades: {field: grade} of a snapped allocation, else None.
        graded: the allocation snapped to grades, if asked for.
        history: one dict per evaluated set: cost, margins {constraint: value}, half_widths {field: value}.
    """

    feasible: bool
    status: str
    tolerances: Any
    cost: float
    start_cost: float
    costs: dict[str, float]
    half_widths: dict[str, float]
    multipliers: Any
    shortfall: Any
    certificate: Statistics
    grades: dict[str, str] | None
    graded: "Allocation | None"
    history: list[dict[str, Any]]


def allocate(
    response: Response,
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
    progress: bool = False,
) -> Allocation:
    """The cheapest half-widths with P(response within its limits) >= target for every requirement.

    Changing a half-width scales the limits about their middle; shift and cp stay. One sample of units
    serves all steps. Each step models every constraint as a root sum of squares with the sampled
    margins and slopes, solves that model by an augmented Lagrangian, and is accepted if the sampled
    cost and violation fall. A larger sample corrects the quantiles once. Fresh units then certify the
    result: a yield counts by its lower confidence bound, and all half-widths shrink together until it holds.

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
        certificate_samples: fresh units per certificate.
        confidence: of the certificate's intervals.
        grades: also snap fields with a `size` to ISO 286 grades and fit the other fields to them.
        max_steps: sets of half-widths tried, at most.
        progress: show progress bars.

    Returns:
        `Allocation`. A unit that fails is a reject.

    Raises:
        ValueError: no requirement, no cost, or names that do not fit.
    """
    parts = layout(correlated(tolerances, correlation))
    names = response_names(response, parts.replace({}))
    required = by_response(requirements, names, Requirement, "requirements")
    if not required:
        raise ValueError("requirements: needs at least one")
    if joint_target is not None and not 0 < joint_target < 1:
        raise ValueError(f"joint_target = {joint_target!r}: must lie between 0 and 1")
    for name, value, least in (
        ("samples", samples, _FEWEST),
        ("certificate_samples", certificate_samples, 1),
        ("max_steps", max_steps, 1),
    ):
        if value < least:
            raise ValueError(f"{name} = {value!r}: must be at least {least}")
    priced = _costs_by_field(costs, parts)
    training = Training(response, parts, tuple(priced), required, joint_target, samples, seed)
    certifier = Certifier(response, required, joint_target, certificate_samples, confidence, seed, progress)
    search = Search(training, priced, max_steps)
    start, low = np.array([float(parts.active[name].half_width) for name in priced]), search.low
    shortfall, prices = dict.fromkeys(required, 0.0), np.zeros(len(required))
    if (training.margins(low) <= 0).all():
        with progress_bar(progress, None, "allocation", "step") as search.advance:
            point, settled = search.run(search.begin(start))
            if certificate_samples > samples:  # a larger sample knows the quantiles better: tell the smaller one
                seen = certifier.draw(training.tolerances(point.half_widths))
                point, settled = search.run(training.correct(point, certifier.factors(seen)))
        prices = search.multipliers(point) @ point.weights
        half_widths, certificate = certifier.settle(training, point.half_widths, low)
        status = "OPTIMAL" if settled else "MAX_STEPS"
        if not certifier.holds(certificate):
            status = "NOT_CERTIFIED"
    else:
        half_widths = low
        certificate, shortfall = certifier.shortfall(training.tolerances(low))
        refused = joint_target is not None or any(missing > 0 for missing in shortfall.values())
        status = "INFEASIBLE" if refused else "NOT_CERTIFIED"  # the larger sample may see the limits just met
        if certifier.holds(certificate):
            status = "OPTIMAL"

    def result(status: str, t: np.ndarray, certificate: Statistics, **more: Any) -> Allocation:
        return Allocation(
            feasible=status != "INFEASIBLE",
            status=status,
            tolerances=parts.bare(training.tolerances(t)),
            cost=search.cost(t),
            start_cost=search.cost(start),
            costs={name: float(cost(jnp.asarray(t[j]))) for j, (name, cost) in enumerate(priced.items())},
            half_widths=dict(zip(priced, map(float, t))),
            multipliers=like_response({**dict.fromkeys(names, 0.0), **dict(zip(required, map(float, -prices)))}),
            shortfall=like_response({**dict.fromkeys(names, 0.0), **shortfall}),
            certificate=certificate,
            history=search.history,
            **more,
        )

    graded = None
    if grades and status != "INFEASIBLE":
        t, found, snapped = Snapping(training, certifier, priced, max_steps).snap(half_widths, certificate)
        graded = result(
            "OPTIMAL" if certifier.holds(snapped) else "NOT_CERTIFIED", t, snapped, grades=found, graded=None
        )
    return result(status, half_widths, certificate, grades=None, graded=graded)


def _costs_by_field(costs: Any, parts: Layout) -> dict[str, Cost]:
    """Costs of the active fields, in their order."""
    if not isinstance(costs, (Mapping, Record)) or isinstance(costs, Cost):
        raise ValueError(f"costs: must be a record or a dict of costs by field, got {type(costs).__name__}")
    leaves, _ = jax.tree_util.tree_flatten_with_path(costs, is_leaf=lambda item: item is None or isinstance(item, Cost))
    given = {jax.tree_util.keystr(path, simple=True, separator="."): cost for path, cost in leaves}
    for name, cost in given.items():
        if cost is None or (isinstance(cost, float) and cost == 0):
            continue
        if not isinstance(cost, Cost):
            raise ValueError(f"costs: {name} = {cost!r} must be a ReciprocalPower, Exponential or Table")
        if name not in parts.active:
            raise ValueError(f"costs: {name!r} has no tolerance; these have: {', '.join(parts.active)}")
    priced = {name: given[name] for name in parts.active if isinstance(given.get(name), Cost)}
    if not priced:
        raise ValueError("costs: no field has a cost, so there is nothing to allocate")
    return priced
