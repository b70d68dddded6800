"""Arguments of an allocation, checked, and what follows from them."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from rvjax.base.words import unknown
from rvjax.population import Correlation, Estimate, Population, Tolerance, deviate_of
from rvjax.records import Record, is_concrete
from rvjax.response import BLOCK, Response, by_response, is_costly, response_names
from rvjax.tolerances.allocation.cost import COSTS, Cost, QuadraticLoss
from rvjax.tolerances.allocation.decisions import ROUNDING, Decisions
from rvjax.tolerances.allocation.variable import Middle, Variable, check_middles, with_values
from rvjax.tolerances.batch.checkpoint import Memo
from rvjax.tolerances.batch.run import Run
from rvjax.tolerances.limits import Limits

FEWEST = 100
"""Units a quantile can be learned from."""

KEPT = 65_536
"""Units of a certificate whose responses are kept, at most."""

QUICK = 8192
"""Quick units of a sample: those in the tails leave an error of the cost below that of a certificate."""

STAGES = 2048, 4096
"""Costly units of samples between the first and the last one."""

SPARE = 0.3
"""Standard errors of a share beyond what a certificate needs: the next sample shows a little less than the last."""

FEW = 512
"""Costly units of the first look, and of a part of the response that does not decide."""


@dataclasses.dataclass(frozen=True)
class Effort:
    """Looks and units of a search, and the accuracy at which it ends, for units of some time.

    Attributes:
        tails: True if all looks are at one sample in the tails, False if samples grow.
        middles: whether mid-points have several starts without numbers of the design too.
        rays: units of looks along rays, where derivatives mislead; 0: there are none.
        intervals: whether prices have intervals, by the sampling error of the units.
        gain: promised gain, as a part of the cost, below which a search ends.
        box: in logarithms of half-widths, below which a search ends.
        worth: gain, as a part of the cost, for which another certificate is computed.
        rivals: ends of starts that are searched on.
        expected: rejects in a certificate, below which a probability of failure is more accurate.
        sloped: units behind the slope of a statistic.
        of_yields: units of a look for the cost curve, and of its certificates.
        of_ranges: units of a look for a range; None: those of the search.
        trials: searches for one end of a range, at most.
        looks: of each of these, at most.
        roughly: as `gain`, of these.
    """

    tails: bool
    middles: bool
    rays: int
    intervals: bool
    gain: float
    box: float
    worth: float
    rivals: int
    expected: int
    sloped: int | None
    of_yields: tuple[int | None, int]
    of_ranges: int | None
    trials: int
    looks: int
    roughly: float


OF_QUICK = Effort(
    tails=True, middles=True, rays=2 * QUICK, intervals=False, gain=1e-5, box=1e-3, worth=1e-3, rivals=3, expected=200,
    sloped=None, of_yields=(None, KEPT), of_ranges=None, trials=4, looks=12, roughly=2e-4,
)  # fmt: skip
"""Of units that take microseconds. Along rays twice the units of a sample, because these are not in the tails."""

OF_COSTLY = Effort(
    tails=False, middles=False, rays=0, intervals=True, gain=2e-4, box=1e-2, worth=3e-3, rivals=2, expected=0,
    sloped=1024, of_yields=STAGES, of_ranges=FEW, trials=2, looks=4, roughly=5e-3,
)  # fmt: skip
"""Of units that take a millisecond."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """Arguments of `allocate`, checked.

    Attributes:
        response: of the errors of one unit, and of the values of `variables` if there are any.
        population: of the units, at the start.
        requirements: by name of the response.
        priced: costs by field.
        middles: by field.
        variables: by name.
        objective: {output: price per unit}.
        losses: {output: its loss, of which the mean counts}.
        joint_target: share of units that meet all limits, or None.
        samples: units to begin with.
        seed: of these.
        max_steps: vectors of decisions tried by a search, at most.
        run: of the certificates.
        memo: of long computations.
        advance: of a progress bar.
    """

    response: Response
    population: Population
    requirements: dict[str, Limits]
    priced: dict[str, Cost]
    middles: Mapping[str, Middle]
    variables: Mapping[str, Variable]
    objective: Mapping[str, float]
    losses: Mapping[str, QuadraticLoss]
    joint_target: float | None
    samples: int
    seed: int
    max_steps: int
    run: Run
    memo: Memo | None
    advance: Callable[[int], object]

    @functools.cached_property
    def decisions(self) -> Decisions:
        """Vector of decisions."""
        return Decisions(self.population, self.priced, self.middles, self.variables)

    @functools.cached_property
    def effort(self) -> Effort:
        """Looks, units and accuracy of a search, for the time of one unit."""
        return OF_COSTLY if is_costly(self.response) else OF_QUICK

    def cushioned(self, item: Limits, values: np.ndarray) -> float:
        """Distance inside its limit that a certificate needs of a statistic of units (n,)."""
        error = item.error(values) / math.sqrt(self.run.samples)
        return (deviate_of(self.run.confidence) + SPARE) * error

    def shown(self, target: float, samples: int) -> float:
        """Share of rejects that so many units may show where a target must be certain.

        The score interval of a share ends at the target where the share lies `deviate` errors of the target above it.
        """
        error = math.sqrt(target * (1 - target) / samples)
        return max(1 - target - (deviate_of(self.run.confidence) + SPARE) * error, 0.5 / samples)

    def whole_of(self, cost: float, losses: Mapping[str, Estimate]) -> Estimate:
        """Cost with mean losses; their intervals add up."""
        sums = (sum(getattr(item, key) for item in losses.values()) for key in ("value", "error", "lower", "upper"))
        value, error, lower, upper = sums
        return Estimate(cost + value, error, cost + lower, cost + upper)


def problem_of(
    response: Response, tolerances: Any, requirements: Any, *, costs: Any, correlation: Correlation, confidence: float,
    certificate_samples: int, middles: Any, variables: Any, objective: Any, losses: Any, progress: bool,
    memo: Memo | None, samples: int, seed: int, joint_target: float | None, max_steps: int,
) -> Problem:  # fmt: skip
    """Check the arguments of `allocate`, where they are described.

    Raises:
        ValueError: names that do not fit, or values that no allocation can use.
    """
    population = Population.of(tolerances, correlation)
    if variables or objective:
        population = with_values(response, population, variables or {})
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    lost = by_response(losses, names, QuadraticLoss, "losses")
    if not required and not lost:
        raise ValueError("requirements: needs at least one, or a loss")
    if joint_target is not None and not 0 < joint_target < 1:
        raise ValueError(f"joint_target = {joint_target!r}: must lie between 0 and 1")
    if joint_target is not None and not any(item.of_units for item in required.values()):
        raise ValueError(f"joint_target = {joint_target!r}: no requirement is for single units")
    check_counts(samples=samples, certificate_samples=certificate_samples, max_steps=max_steps)
    priced = costs_by_field(costs, population.active, needed=not variables)
    check_middles(middles or {}, population.active)
    _check_objective(objective or {}, names)
    run = Run(
        response, population, names, {name: item for name, item in required.items() if item.of_sample},
        certificate_samples, seed + 1, min(samples, BLOCK) if certificate_samples < BLOCK else BLOCK,
        confidence=confidence, progress=progress, keep=certificate_samples <= KEPT, label="certifying", memo=memo,
    )  # fmt: skip
    return Problem(
        response, population, required, priced, middles or {}, variables or {}, objective or {}, lost, joint_target,
        samples, seed, max_steps, run, memo, _silent,
    )  # fmt: skip


def _silent(count: int) -> None:
    """Show no progress."""


def check_counts(**counts: int) -> None:
    """Raise ValueError for fewer than 100 `samples`, or less than 1 of something else.

    Args:
        **counts: by the name of the argument.
    """
    for name, value in counts.items():
        least = FEWEST if name == "samples" else 1
        if value < least:
            raise ValueError(f"{name} = {value!r}: must be at least {least}")


def _check_objective(objective: Mapping[str, float], names: tuple[str, ...]) -> None:
    for name, price in objective.items():
        if name not in names:
            raise ValueError(f"objective: {name!r} is no output of the response; it has {', '.join(names)}")
        if not math.isfinite(price):
            raise ValueError(f"objective: the price of {name} = {price!r}: must be finite")


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
            and np.all(one.moments()[1] <= (ROUNDING * one.half_width) ** 2)
        ):
            raise ValueError(
                f"tolerances: {name} does not vary: {one.distribution} values that are all equal; measure with a "
                "finer step, or give another distribution"
            )
    if needed and not priced:
        raise ValueError("costs: no field has a cost, so there is nothing to allocate")
    return priced
