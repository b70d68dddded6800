"""The `Allocation` of a solution.

Prices of limits and of bounds, active bounds, and the reason of an infeasible problem.
"""

import math
from collections.abc import Mapping

import jax.numpy as jnp

from rvjax.tolerances.loss import expected_losses
from rvjax.tolerances.optimum.found import Found
from rvjax.tolerances.optimum.problem import Problem
from rvjax.tolerances.optimum.result import Allocation

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
    return math.nan if found.end is None and found.shortage is None and found.decisions.variables else 0.0


def reason(found: Found) -> str | None:
    """The limits that an infeasible problem misses, and the bound of a number that would help most."""
    if found.shortage is None:
        return None
    missing = [
        f"{name or 'the response'} misses its limit by {value:.4g} (SI)"
        for name, value in found.shortage.by_name.items()
        if value > 0
    ]
    text = "; ".join(missing)
    if found.shortage.helps is not None:
        name, side = found.shortage.helps
        item = found.decisions.variables[name]
        wider = f"a {'lower' if side == 'lower' else 'higher'} {side} bound of {name}"
        text += f"; {wider} than {item.lower if side == 'lower' else item.upper:.6g} (SI) would help most"
    return text


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


def allocation_of(problem: Problem, found: Found, names: tuple[str, ...], solved: int) -> Allocation:
    """Result of a solution.

    Args:
        problem: that was solved.
        found: its solution.
        names: of the response.
        solved: units of the certificates.
    """
    decisions = found.decisions
    t = decisions.half_widths(found.x)
    nothing = dict.fromkeys(names, 0.0)
    widths = zip(decisions.fields, problem.priced.values(), t)
    losses = expected_losses(problem.losses, found.certificate)
    return Allocation(
        feasible=found.status != "INFEASIBLE",
        status=found.status,
        tolerances=decisions.population(found.x).tolerances,
        cost=found.cost,
        start_cost=problem.start_cost(decisions),
        learned=found.learned,
        costs={name: float(cost(jnp.asarray(half_width))) for name, cost, half_width in widths},
        half_widths=dict(zip(decisions.fields, map(float, t))),
        multipliers=nothing | {name: -price for name, price in found.prices.items()},
        shortfall=nothing | found.shortfall,
        residual=found.residual,
        certificate=found.certificate,
        grades=None,
        graded=None,
        history=found.history,
        evaluations={"search": found.evaluated, "certificates": solved},
        values=decisions.values(found.x),
        bounds_active=bounds_active(found),
        value_prices=value_prices(found),
        ranges=found.ranges,
        margins=found.margins,
        margin_slopes=found.slopes,
        losses=losses,
        objective=problem.whole_of(found.cost, losses),
        reason=reason(found),
        helps=None if found.shortage is None else found.shortage.helps,
        starts=found.starts,
        multiplier_intervals={name: (-high, -low) for name, (low, high) in found.intervals.items()},
    )
