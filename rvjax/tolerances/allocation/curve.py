"""Requirement curves: cost of a tighter limit or a higher yield."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

from rvjax._jax.checks import checked
from rvjax.base.words import choose
from rvjax.response import Response
from rvjax.tolerances.allocation.allocate import allocate
from rvjax.tolerances.allocation.result import Allocation
from rvjax.tolerances.requirements.limits import Limits


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
