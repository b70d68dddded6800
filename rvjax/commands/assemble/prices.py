"""Tighter tolerances or matching, which is cheaper: the cheapest tolerances for random assembly, and these opened."""

import dataclasses
from collections.abc import Sequence

from rvjax.assembly import opening
from rvjax.commands.assemble.parts import REST, Bench as Bench
from rvjax.render import TEXT, Number, Share, Table, Text
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


def price_table(prices: Sequence[Price]) -> Table:
    """Tighter tolerances or matching."""
    columns = [
        Share("yield", form="g"),
        Number("cost, random", form=".3f"),
        Number("opened by", form=".2f"),
        Number("cost, matched", form=".3f"),
        Text("allocation"),
    ]
    rows = [[price.share, price.alone, price.factor, price.matched, price.status] for price in prices]
    return Table("prices", columns, rows, on=frozenset({TEXT}))
