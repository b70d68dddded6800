"""The plan of assembly: which part goes into which unit, and what tolerances cost with and without matching.

Tighter tolerances or matching: which is cheaper? The cheapest tolerances for random assembly, and these opened.
"""

import dataclasses
import warnings

from rvjax import assembly
from rvjax.assembly import Plan, opening
from rvjax.base import progress
from rvjax.commands.assemble.inputs import Inputs
from rvjax.commands.assemble.parts import REST, Bench, bench, table_of
from rvjax.commands.speak import READING, WRITING
from rvjax.study import Study, StudyError
from rvjax.tolerances import allocate

YIELDS = (0.9, 0.95, 0.99)


@dataclasses.dataclass(frozen=True)
class Price:
    """One yield and its cost.

    Attributes:
        share: of good units.
        alone: cheapest cost of tolerances for random assembly.
        factor: by which matching opens them.
        matched: cost of the opened tolerances, none beyond the coarsest of its process.
        status: of the allocation.
    """

    share: float
    alone: float
    factor: float
    matched: float
    status: str


def prices(study: Study, found: Bench, *, sets: int = 8) -> list[Price]:
    """Allocate for several yields of the response that decides, and open the tolerances by matching.

    Args:
        study: tolerances and costs.
        found: parts.
        sets: of parts, sampled to find how far matching opens the tolerances.

    Raises:
        StudyError: no costs, or none for an error of the parts.
    """
    held = {name for slot, kind in found.kinds.items() if slot != REST for part in kind.parts for name in part.errors}
    if not held & set(study.costs):
        raise StudyError(f"{study.name}: none of the errors of the parts has a [cost]: {', '.join(sorted(held))}")
    response, rows = study.response_of(found.name), []
    for share in YIELDS:
        requirement = dataclasses.replace(found.requirement, target=share)
        cheapest = allocate(
            response,
            study.tolerances,
            {found.name: requirement},
            costs=study.costs,
            samples=study.samples,
            seed=study.seed,
            certificate_samples=study.certificate_samples,
        )
        by_field = {name: getattr(cheapest.tolerances, name) for name in study.fields}
        small, limits = dataclasses.replace(found, requirement=requirement).small
        wider = opening(small, found.kinds, by_field, requirement=limits, sets=sets, seed=study.seed).factor
        widths = {name: float(by_field[name].half_width) for name in study.costs}
        opened = {name: min(wider * t, max(study.costs[name].coarsest, t)) for name, t in widths.items()}
        matched = sum(float(cost(opened[name])) for name, cost in study.costs.items())
        rows.append(Price(share, float(cheapest.cost), wider, matched, cheapest.status))
    return rows


COSTLY = {"most_valued": 2**18, "most_fresh": 2**14}
"""Responses at most of a response whose units are expensive: to choose, and to value the plan."""
MATCHING, PRICING = "which part goes with which", "prices of tolerances"


@dataclasses.dataclass(frozen=True, eq=False)
class Assembled:
    """A plan of assembly.

    Attributes:
        parts: measured ones.
        plan: which of them make which unit.
        prices: cost of tolerances; empty without the option.
    """

    parts: Bench
    plan: Plan
    prices: tuple[Price, ...] = ()


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return (READING, MATCHING, *([PRICING] if inputs.prices else []), WRITING)


def _mirrored(plan: Plan, objective: str) -> Plan:
    """The plan of the opposite response in values of the response itself; its bound is an upper one."""
    own, sense = plan.random, 1 if objective == "yield" else -1
    random = dataclasses.replace(own, value=-own.value, lower=-own.upper, upper=-own.lower)
    bounds = dataclasses.replace(plan, objective=sense * plan.objective, lower_bound=sense * plan.lower_bound)
    return dataclasses.replace(bounds, values=-plan.values, random=random)


def compute(inputs: Inputs) -> Assembled:
    """Compute the plan, and prices if required."""
    study, how = inputs.study, table_of(inputs.study)
    parts = bench(study, inputs.source, encoding=inputs.encoding)
    progress.begin(MATCHING)
    response, requirement = parts.small
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", assembly.UnusualPart)  # the report names them with their rows
        plan = assembly.plan(
            response,
            parts.kinds,
            objective=how.objective,
            requirement=requirement,
            draws=how.draws,
            certificate_draws=how.certificate_draws,
            seed=study.seed,
            keep_best=True,
            **(COSTLY if parts.costly else {}),
        )
    if plan.status == "INFEASIBLE":
        study.check_nominal()  # the message is clearer if this unit fails too
    found = Assembled(parts, plan if parts.sense > 0 else _mirrored(plan, how.objective))
    if not inputs.prices:
        return found
    progress.begin(PRICING)
    return dataclasses.replace(found, prices=tuple(prices(study, parts)))
