"""Problems without a solution: which limit is missed by how much, and the bound that would help most."""

import dataclasses
import math

import numpy as np

from rvjax.tolerances.allocation.decisions import AT, ROUNDING, Decisions
from rvjax.tolerances.allocation.programme import RADIUS, End
from rvjax.tolerances.allocation.result import Allocation
from rvjax.tolerances.allocation.search import Search


def least_shortage(search: Search, x: np.ndarray) -> End:
    """The least sum of shortfalls, in parts of their limits, with all half-widths at their finest.

    Args:
        search: of the problem.
        x: (n,) vector from which it is sought, as well as from the start.
    """
    programme, constraints, count = search.programme, search.constraints, len(search.decisions.fields)
    search.rays = None
    constraints.spare(None)
    search.constraints.rejects = np.array([constraints.target(k) for k in range(len(constraints.rows))])
    high, free = programme.high.copy(), programme.high
    high[:count] = programme.low[:count]
    programme.high, programme.weights = high, constraints.ways / constraints.sizes()
    ends = [search.run(np.clip(start, programme.low, high), RADIUS) for start in (x, search.decisions.start)]
    end = min(ends, key=lambda end: float(programme.weights @ np.maximum(end.look.used - 1, 0.0)))
    programme.high, programme.weights = free, None
    constraints.place(end.look.x)
    return programme.end(constraints.look(end.look.x))


def refused(search: Search, end: End) -> Allocation:
    """Result where no vector meets all requirements; a certificate that holds there decides.

    Args:
        search: of the problem.
        end: of the least shortage.
    """
    constraints, look = search.constraints, end.look
    run = search.certifier.run
    search.certifier.run = dataclasses.replace(run, keep=True)
    seen = search.certifier.draw(search.decisions.population(look.x))
    search.certifier.run = run
    held = search.certifier.holds(seen) and constraints.missed(look) <= ROUNDING
    total = look.cost + look.priced
    found = search.allocation(look, seen, "SUBOPTIMAL" if held else "INFEASIBLE", total)
    if held:
        return dataclasses.replace(found, evaluations=search.evaluations(constraints.count))
    joint, missing = search.problem.joint_target or 0.0, dict[str, float]()
    for k, row in enumerate(constraints.rows):
        if row.item is None:
            continue
        own = (look.used[k] - constraints.moved[k] - 1) * constraints.ways[k]
        if not row.exact and (
            not search.problem.effort.tails or joint or not row.share or not math.isfinite(own)
        ):  # more units, or all limits
            own = search.problem.requirements[row.name].shortfall(seen.values[row.name], joint)
        missing[row.name] = max(missing.get(row.name, 0.0), float(own), 0.0)
    if constraints.most_failed is not None and seen.failed > constraints.most_failed * seen.samples:
        few = {n for n, item in search.problem.requirements.items() if item.most_failed < 1}
        missing |= dict.fromkeys(few, math.inf)  # no limit helps a statistic of the valid units
    if not any(value > 0 for value in missing.values()) and search.problem.joint_target is None:
        found = dataclasses.replace(found, status="NOT_CERTIFIED", feasible=True)
    helps = _helping(search, end)
    return dataclasses.replace(
        found, shortfall=found.shortfall | missing, evaluations=search.evaluations(constraints.count), helps=helps,
        reason=_reason(search.decisions, missing, helps) if search.problem.variables else None,
    )  # fmt: skip


def _helping(search: Search, end: End) -> tuple[str, str] | None:
    """Bound of a number of the design whose move outwards reduces the shortage most."""
    first = len(search.decisions.fields) + len(search.decisions.moves)
    weights = search.constraints.ways / search.constraints.sizes()
    pull = (weights * (end.look.used > 1)) @ np.where(np.isfinite(end.look.jacobian), end.look.jacobian, 0.0)
    x, found = end.look.x, []
    for k, name in enumerate(search.decisions.free, first):
        found += [(float(pull[k]), name, "lower")] if x[k] <= search.programme.low[k] + AT else []
        found += [(float(-pull[k]), name, "upper")] if x[k] >= search.programme.high[k] - AT else []
    best = max(found, default=(0.0, "", ""))
    return (best[1], best[2]) if best[0] > 0 else None


def _reason(decisions: Decisions, missing: dict[str, float], helps: tuple[str, str] | None) -> str:
    """The limits that are missed, and the bound of a number that would help most."""
    text = "; ".join(
        f"{name or 'the response'} misses its limit by {value:.4g} (SI)" for name, value in missing.items() if value > 0
    )
    if helps is not None:
        name, side = helps
        item = decisions.variables[name]
        wider = f"a {'lower' if side == 'lower' else 'higher'} {side} bound of {name}"
        text += f"; {wider} than {item.lower if side == 'lower' else item.upper:.6g} (SI) would help most"
    return text
