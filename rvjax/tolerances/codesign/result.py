"""Fields of an `Allocation` with mid-points or numbers of the design that were chosen."""

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from rvjax.tolerances.codesign.design import Designer, Found
from rvjax.tolerances.codesign.prices import bounds_active, margins, multipliers, reason, value_prices
from rvjax.tolerances.codesign.problem import Problem


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
    judged, slopes = margins(found)
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
        margins=judged,
        margin_slopes=slopes,
        reason=reason(found),
    )
