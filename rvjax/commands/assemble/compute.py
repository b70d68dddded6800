"""The plan of assembly: which part goes into which unit, and what tolerances cost with and without matching."""

import dataclasses

from rvjax import assembly, progress
from rvjax.assembly import Plan
from rvjax.commands.assemble.inputs import Inputs
from rvjax.commands.assemble.parts import Bench, bench, table_of
from rvjax.commands.assemble.prices import Price, prices
from rvjax.commands.speak import READING, WRITING

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


def phases(asked: Inputs) -> dict[str, float]:
    """Phases of the command; their times are not known before.

    Args:
        asked: what is computed.
    """
    return dict.fromkeys((READING, MATCHING, *([PRICING] if asked.prices else []), WRITING), 0.0)


def compute(asked: Inputs) -> Assembled:
    """Compute the plan, and prices if required."""
    study, how = asked.study, table_of(asked.study)
    parts = bench(study, asked.source)
    progress.begin(MATCHING)
    plan = assembly.plan(
        parts.response,
        parts.kinds,
        objective=how.objective,
        requirement=parts.requirement,
        draws=how.draws,
        certificate_draws=how.certificate_draws,
        seed=study.seed,
        keep_best=True,
        **(COSTLY if parts.costly else {}),
    )
    if plan.status == "INFEASIBLE":
        study.check_nominal()  # the message is clearer if this unit fails too
    found = Assembled(parts, plan)
    if not asked.prices:
        return found
    progress.begin(PRICING)
    return dataclasses.replace(found, prices=tuple(prices(study, parts)))
