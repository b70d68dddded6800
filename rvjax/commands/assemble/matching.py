"""Matching of measured parts: parts of a study in the slots of a reducer, and what matching saves.

Tighter tolerances or matching, which is cheaper: the cheapest tolerances for random assembly, and these opened.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.assembly import (
    Kind,
    Machine,
    Part,
    Plan,
    UnitResponse,
    draw,
    known as known_parts,
    opening,
    outliers,
    supply_of,
)
from rvjax.base.fields import value_text
from rvjax.commands.assemble.parts import REST, Row, kind_of_rows, rows_of, slots_of, table_of
from rvjax.commands.forecast import effort_of
from rvjax.records import PyTree
from rvjax.render import TEXT, Number, Share, Table, Text
from rvjax.study import KINDS, Study, StudyError, kind_of
from rvjax.tolerances import Requirement, allocate

YIELDS = (0.9, 0.95, 0.99)


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """Parts of a study, ready to be matched.

    Attributes:
        response: (parts, index) -> Outcome of the response that decides.
        kinds: parts by slot.
        name: of the response.
        requirement: on it.
        most: responses at most to choose, and to value the plan, as `plan` names them.
        unusual: a line for each part far beyond its limits or its lot, the furthest of each kind first.
        notes: how the file was read.
    """

    response: UnitResponse
    kinds: dict[str, Kind]
    name: str
    requirement: Requirement
    most: Mapping[str, int] = dataclasses.field(default_factory=dict)
    unusual: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def sense(self) -> int:
        """-1 where large values are good, because the requirement has a lower limit only; else 1."""
        return -1 if self.requirement.upper == math.inf else 1

    @property
    def small(self) -> tuple[UnitResponse, Requirement]:
        """Response whose small values are good, and the requirement on it."""
        if self.sense > 0:
            return self.response, self.requirement
        limits = dict(lower=-math.inf, upper=-self.requirement.lower)
        return self._mirrored, dataclasses.replace(self.requirement, **limits)

    def _mirrored(self, parts: PyTree, index: PyTree) -> object:
        return jax.tree.map(
            lambda leaf: leaf if jnp.issubdtype(leaf, jnp.integer) else -leaf, self.response(parts, index)
        )


def bench(study: Study, path: str | Path, *, encoding: str | None = None) -> Bench:
    """Parts of a study from a CSV file.

    The first line names the columns: `kind` ("disc", "crank", "carrier", or any name for parts that hold whole errors,
    such as pins or bearings), `id`, if wanted `stock`, and measured errors with their unit: "bearing_clearance [um]",
    "disc_bore[0,1] [um]" (crank 0, tangential). An empty cell is an error that this part does not have, or that was
    not measured where others of its kind have it.

    Args:
        study: design, tolerances (the populations), requirements and measurement uncertainties.
        path: of the file.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        StudyError: names file, line, column and value.
    """
    if (unit_errors := kind_of(study.design).unit_errors) is None:
        able = " and ".join(kind.plural for kind in KINDS.values() if kind.unit_errors)
        raise StudyError(f"{study.name}: parts are matched for {able} only")
    name, requirement = _asked(study)
    rows, notes = rows_of(Path(path), encoding)
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.cells["kind"], []).append(row)
    kinds: dict[str, Kind] = {}
    unusual: list[str] = []
    taken: set[str] = set()
    for kind, own in groups.items():
        slots, fields = slots_of(study.design, kind, path)
        made = kind_of_rows(study, path, kind, own, fields, slots)
        unusual += _unusual(study, kind, made, own)
        for slot in slots:
            if slot in kinds:
                raise StudyError(f"{path}: {slot} has parts of two kinds")
            kinds[slot] = made
        taken |= {field for part in made.parts for field in part.errors}
    if len(kinds) < 2:
        raise StudyError(f"{path}: has parts of {', '.join(kinds)} only; list parts of at least two slots")
    rest = {f: getattr(study.tolerances, f) for f in study.fields if f not in taken}
    if rest:
        zeros = {f: np.zeros(tolerance.shape) for f, tolerance in rest.items()}
        pieces = min(int(kind.pieces.sum()) for kind in kinds.values())
        kinds[REST] = Kind([Part("any", zeros, math.inf)], stock=[pieces], population=rest)
    outcome = study.response_of(name)
    design = study.design
    return Bench(
        lambda parts, index: outcome(unit_errors(design, parts, index)), kinds, name, requirement,
        effort_of(outcome).plan, tuple(unusual), tuple(notes),
    )  # fmt: skip


def _unusual(study: Study, kind: str, made: Kind, rows: list[Row]) -> list[str]:
    """Lines on the parts of a kind that may have a wrong unit."""
    places = {row.cells["id"]: row.number for row in rows}
    lines = []
    for one in outliers(made):
        value = value_text(one.value, study.unit(one.name.partition("[")[0]))
        lines.append(one.text(f"row {places[str(one.id)]}, {kind} {one.id}", value))
    return lines


def unit_values(found: Bench, seed: int, plan: Plan | None = None, count: int = 1024) -> np.ndarray:
    """Responses of units with the unmeasured errors of their parts sampled; nan for a failed unit (count,).

    Args:
        found: parts.
        seed: of the random numbers.
        plan: whose units are valued in turn; None: pieces taken by chance, in any position.
        count: of values.
    """
    by_kind = {id(kind): known_parts(kind, slot) for slot, kind in found.kinds.items()}
    slots = {slot: by_kind[id(kind)] for slot, kind in found.kinds.items()}
    machine, weight = Machine(found.response, slots), supply_of(slots).weight()
    rng = np.random.default_rng([seed, 7])
    if plan is None:
        cells = np.argwhere(weight > 0)
        place = cells[rng.choice(len(cells), count, p=weight[weight > 0] / weight.sum())]
        turn = machine.indices[rng.integers(len(machine.indices), size=count)]
    else:
        places = [{one.id_of(k): k for k in range(len(one.order))} for one in slots.values()]
        built = [[own[unit[slot]] for own, slot in zip(places, slots)] for unit in plan.build]
        units = np.arange(count) % len(built)
        place, turn = np.array(built)[units], np.array([[at[slot] for slot in slots] for at in plan.index])[units]
    return machine.values(draw(slots, seed, 7, count, alike=False), place, turn, np.arange(count))


def _asked(study: Study) -> tuple[str, Requirement]:
    """The response that decides, and its requirement."""
    name = table_of(study).response
    if name is None:
        if len(study.requirements) > 1:
            listed = ", ".join(study.requirements)
            raise StudyError(f"{study.name}: assembly.response is missing; name one of {listed}")
        name = next(iter(study.requirements))
    requirement = study.requirements[name]
    if not isinstance(requirement, Requirement):
        raise StudyError(f"{study.name}: requirement.{name}: parts are matched for limits of single units only")
    return name, requirement


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
