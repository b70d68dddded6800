"""Fields of an `Allocation` with mid-points or numbers of the design that were chosen.

Prices of limits and of bounds, active bounds, and the reason of an infeasible problem.
"""

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from rvjax.tolerances.optimum.design import Designer, Found
from rvjax.tolerances.optimum.margins import JOINT
from rvjax.tolerances.optimum.problem import Problem

_AT = 1e-6  # part of its range, nearer than which a number is at its bound


def bounds_active(found: Found) -> dict[str, str | None]:
    """The bound at which each number of the design is, or None."""
    decisions, values = found.decisions, found.decisions.values(found.x)
    active: dict[str, str | None] = {}
    for name, item in decisions.variables.items():
        near = _AT * (item.upper - item.lower)
        at_lower, at_upper = values[name] <= item.lower + near, values[name] >= item.upper - near
        free = name in decisions.free and not item.among
        active[name] = ("lower" if at_lower else "upper" if at_upper else None) if free else None
    return active


def value_prices(found: Found) -> dict[str, float]:
    """d cost / d bound of each number, of the bound at which it is; 0 elsewhere, nan without a search."""
    decisions, prices = found.decisions, dict.fromkeys(found.decisions.variables, _unsearched(found))
    if found.end is None:
        return prices
    first = len(decisions.fields) + len(decisions.moves)
    for k, name in enumerate(decisions.free, first):
        rate = float(decisions.rates()[k - len(decisions.fields)])
        bound = bounds_active(found)[name]
        if bound is not None:
            prices[name] = float(found.end.at_low[k] if bound == "lower" else -found.end.at_high[k]) / rate
    return prices


def _unsearched(found: Found) -> float:
    """Price to begin with: nan where a certificate holds that no search led to."""
    return math.nan if found.end is None and found.shortage is None else 0.0


def multipliers(found: Found) -> dict[str, float]:
    """d cost / d limit by requirement, all its limits moving outwards; <= 0, nan without a search."""
    prices = dict.fromkeys(found.margins.requirements, _unsearched(found))
    if found.end is None:
        return prices
    for name, price, way in zip(found.margins.names, found.end.prices, found.margins.ways):
        if name in prices:
            prices[name] -= float(price / way)
    if JOINT in found.margins.names[len(found.margins.rows) :]:
        for name, part in found.margins.leading(found.x).items():
            prices[name] -= float(found.end.prices[-1]) * part
    return prices


def margins(found: Found) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Margins of the requirements at the end of the search, of two sides the larger, and their derivatives."""
    values, slopes = dict[str, float](), dict[str, dict[str, float]]()
    if found.end is None:
        return values, slopes
    decisions, point = found.decisions, found.end.point
    first = len(decisions.fields) + len(decisions.moves)
    widths = decisions.half_widths(point.x)
    for k, row in enumerate(found.margins.rows):
        value, rates = point.margins[k] * found.margins.ways[k], point.jacobian[k] * found.margins.ways[k]
        if not math.isfinite(value) or value <= values.get(row.name, -math.inf):
            continue
        values[row.name] = float(value)
        numbers = rates[first:] / decisions.rates()[len(decisions.moves) :]
        slopes[row.name] = dict(zip(decisions.fields, map(float, rates[: len(widths)] / widths)))
        slopes[row.name] |= dict(zip(decisions.free, map(float, numbers)))
    return values, slopes


def reason(found: Found) -> str | None:
    """The limits that an infeasible problem misses, and the bound of a number that would help most."""
    if found.shortage is None:
        return None
    missing = [
        f"{name or 'the response'} misses its limit by {value:.4g}"
        for name, value in found.shortage.by_name.items()
        if value > 0
    ]
    text = "; ".join(missing)
    if found.shortage.helps is not None:
        name, side = found.shortage.helps
        item = found.decisions.variables[name]
        bound = item.lower if side == "lower" else item.upper
        wider = "lower" if side == "lower" else "higher"
        text += f"; a {wider} {side} bound of {name} than {bound:.6g} would help most"
    return text


def designed(problem: Problem, names: tuple[str, ...], *, grades: bool) -> list[dict[str, Any]]:
    """Fields of the result, and of the result rounded to grades where these are wanted.

    Args:
        problem: to solve.
        names: of the response.
        grades: whether half-widths are also rounded.
    """
    check_objective(problem.objective, names)
    designer = Designer(problem)
    found = designer.solution()
    results = [figures(designer, found, names, designer.ranges(found))]
    if grades and results[0]["feasible"] and problem.priced:
        rounded, chosen = designer.graded(found)
        results.append(figures(designer, rounded, names, {}) | {"grades": chosen})
    return results


def check_objective(objective: Mapping[str, float], names: tuple[str, ...]) -> None:
    """Raise ValueError for a price of no output, or one that is not finite.

    Raises:
        ValueError: names it.
    """
    for name, price in objective.items():
        if name not in names:
            raise ValueError(f"objective: {name!r} is no output of the response; it has {', '.join(names)}")
        if not math.isfinite(price):
            raise ValueError(f"objective: the price of {name} = {price!r}: must be finite")


def figures(
    designer: Designer, found: Found, names: tuple[str, ...], ranges: dict[str, tuple[float, float]]
) -> dict[str, Any]:
    """Fields of the `Allocation` of a solution."""
    problem, decisions = designer.problem, found.decisions
    t = decisions.half_widths(found.x)
    nothing = dict.fromkeys(names, 0.0)
    start = found.margins.total(designer.problem.start(decisions)) if math.isfinite(found.learned) else math.nan
    reached, slopes = margins(found)
    widths = zip(decisions.fields, problem.priced.values(), t)
    return dict(
        feasible=found.status != "INFEASIBLE",
        status=found.status,
        tolerances=decisions.population(found.x).tolerances,
        cost=found.margins.total(found.x),
        start_cost=start,
        learned=found.learned,
        costs={name: float(cost(jnp.asarray(half_width))) for name, cost, half_width in widths},
        half_widths=dict(zip(decisions.fields, map(float, t))),
        multipliers=nothing | multipliers(found),
        shortfall=nothing | ({} if found.shortage is None else found.shortage.by_name),
        residual=math.nan if found.end is None else found.end.residual,
        certificate=found.certificate,
        grades=None,
        graded=None,
        history=found.history,
        evaluations={"search": found.margins.evaluated, "certificates": designer.certifier.solved},
        values=decisions.values(found.x),
        bounds_active=bounds_active(found),
        value_prices=value_prices(found),
        ranges=ranges,
        margins=reached,
        margin_slopes=slopes,
        reason=reason(found),
    )
