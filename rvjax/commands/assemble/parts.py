"""A list of measured parts, as kinds in the slots of a reducer."""

import dataclasses
import math
import re
from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.assembly import Kind, Machine, Part, Plan, UnitResponse, draw, known as known_parts, outliers, supply_of
from rvjax.base import columns
from rvjax.base.cells import MARKS, read_cells
from rvjax.base.fields import axis_sizes, element as element_name, place_of, value_text
from rvjax.base.text import guessed, number_of
from rvjax.commands.assemble.section import table_of
from rvjax.mounting import AXES, carried, disc_mountings, drawing
from rvjax.records import PyTree
from rvjax.study import KINDS, Study, StudyError, kind_of
from rvjax.tolerances import Requirement, Tolerance
from rvjax.units import KNOWN, recognised, unknown_unit

WORDS = ("kind", "id", "stock")
REST = "rest"
"""Slot of all errors with a tolerance and without parts: not measured, independent in each unit."""


@dataclasses.dataclass(frozen=True)
class Row:
    """A part as the list has it.

    Attributes:
        number: of the line.
        cells: by column.
        comma: whether decimals may have a comma.
    """

    number: int
    cells: dict[str, str]
    comma: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """Parts of a study, ready to be matched.

    Attributes:
        response: (parts, index) -> Outcome of the response that decides.
        kinds: parts by slot.
        name: of the response.
        requirement: on it.
        costly: a unit is so expensive that only those are solved that can enter the plan.
        unusual: a line for each part far beyond its limits or its lot, the furthest of each kind first.
        notes: how the file was read.
    """

    response: UnitResponse
    kinds: dict[str, Kind]
    name: str
    requirement: Requirement
    costly: bool = False
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

    def _mirrored(self, parts: PyTree, index: PyTree) -> PyTree:
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
    rows, notes = _rows(Path(path), encoding)
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.cells["kind"], []).append(row)
    kinds: dict[str, Kind] = {}
    unusual: list[str] = []
    taken: set[str] = set()
    for kind, own in groups.items():
        slots, fields = _slots(study.design, kind, path)
        made = _kind(study, path, kind, own, fields, slots)
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
        lambda parts, index: outcome(unit_errors(design, parts, index)), kinds, name, requirement, outcome.costly,
        tuple(unusual), tuple(notes),
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


def _rows(path: Path, encoding: str | None) -> tuple[list[Row], list[str]]:
    """Rows of the list; a note on a guessed encoding."""
    try:
        cells = read_cells(
            path,
            "kind,id,bearing_clearance [um]",
            short=True,
            named=lambda text: text.lower() in ("kind", "id"),
            encoding=encoding,
        )
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such list of parts") from None
    header = [text.lower() if text.lower() in WORDS else text for text in cells.header]
    for needed in ("kind", "id"):
        if needed not in header:
            raise StudyError(f"{path}: has no column {needed!r}; it has {', '.join(header)}")
    names = [name for name in header if name]  # a delimiter at the end of each line makes a column without a name
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise StudyError(f"{path}: two columns have the same name, {twice!r}")
    rows = [Row(number, dict(zip(header, map(str.strip, row))), cells.comma) for number, row in cells.body]
    rows = [row for row in rows if not row.cells["kind"].startswith(MARKS)]  # a comment that has commas
    return rows, guessed(cells.notes)


def _slots(design: PyTree, kind: str, path: str | Path) -> tuple[list[str], dict[str, tuple[int, ...]]]:
    """Slots that a kind of parts feeds, and the errors it may hold with their shapes."""
    shapes = {f.name: axis_sizes(f.metadata["shape"], design.counts) for f in dataclasses.fields(design.error_record)}
    several = {part: held for part in AXES if (held := carried(design, part))}  # a single shaft is no crank
    match = re.fullmatch(r"([a-z]+?)(?:_(\d+))?", kind)
    if match and match[1] in several:
        part, number, count = match[1], match[2], design.counts[AXES[match[1]]]
        if number is not None and int(number) >= count:
            raise StudyError(f"{path}: kind = {kind!r}: this design has {count} {AXES[part]}, counted from 0")
        every = [k for k in range(count) if part != "disc" or drawing(design, k) == 0]
        return [f"{part}_{k}" for k in every] if number is None else [kind], several[part]
    if not re.fullmatch(r"[a-z][a-z0-9_]*", kind) or kind == REST:
        raise StudyError(f"{path}: kind = {kind!r}: must be {', '.join(several)}, carrier, or a name in lower case")
    return [kind], {name: shape for name, shape in shapes.items() if not any(name in own for own in several.values())}


def _kind(
    study: Study,
    path: str | Path,
    kind: str,
    rows: list[Row],
    shapes: Mapping[str, tuple[int, ...]],
    slots: list[str],
) -> Kind:
    """Parts of one kind."""
    measured: dict[str, dict[tuple[int, ...], str]] = {}
    units: dict[str, str] = {}
    for column in rows[0].cells:
        if column in WORDS or not any(row.cells[column] for row in rows):
            continue
        field, element, unit = _column(study, path, column, kind, shapes)
        if element in measured.setdefault(field, {}):
            raise StudyError(f"{path}: column {column!r}: {element_name(field, element)} is in two columns")
        measured[field][element] = column
        units[column] = unit
    if not measured:
        raise StudyError(f"{path}: parts of kind {kind!r} have no error")
    positive = {f.name for f in dataclasses.fields(study.design.error_record) if f.metadata["sign"] != "any"}
    parts, stock = [], []
    for row in rows:
        label = row.cells["id"]
        where = f"{path}, {kind} {label!r}"
        if not label:
            raise StudyError(f"{path}: a part of kind {kind!r} has no id")
        errors, sds = {}, {}
        for field, elements in measured.items():
            value, sd = np.zeros(shapes[field]), np.full(shapes[field], np.inf)
            for element, column in elements.items():
                if text := row.cells[column]:
                    name, size = element_name(field, element), KNOWN[study.unit(field)][units[column]]
                    unit, at = units[column], row.number
                    found = number_of(str(path), name, unit, at, text, row.comma, missing=False)
                    value[element] = found * size
                    sd[element] = table_of(study).sd.get(field, 0.0)
                    if field in positive and value[element] < -4 * sd[element]:
                        raise StudyError(f"{path}: row {at}, {name} = {text!r}: must be zero or positive, in {unit}")
            if np.isinf(sd).any() and getattr(study.tolerances, field) is None:
                raise StudyError(
                    f"{where}: not all elements of {field} are measured, and [tolerances.{field}] is missing"
                )
            errors[field], sds[field] = value, sd
        parts.append(Part(label, errors, sds))
        stock.append(_count(row.cells.get("stock", "") or "1", f"{where}: stock"))
    population = {field: tolerance for field in measured if (tolerance := getattr(study.tolerances, field)) is not None}
    checked = {field: one for field, one in population.items() if isinstance(one, Tolerance)}
    try:
        return Kind(parts, indices=_positions(study, slots[0]), stock=stock, population=checked)
    except ValueError as error:
        raise StudyError(f"{path}, {kind}: {error}") from None


def _positions(study: Study, slot: str) -> int:
    """Angular positions of a part in its slot."""
    if not table_of(study).turned:
        return 1
    kind, _, number = slot.rpartition("_")
    if kind == "disc":
        return len(disc_mountings(study.design, int(number), made_for=drawing(study.design, int(number))))
    return study.design.counts[study.design.places] if slot == "carrier" else 1


def _column(
    study: Study, path: str | Path, column: str, kind: str, shapes: Mapping[str, tuple[int, ...]]
) -> tuple[str, tuple[int, ...], str]:
    """Field, place and unit of a column."""
    head, unit = columns.name_and_unit(column)
    try:
        field, place = place_of(head)
    except ValueError:
        unit = None
    if unit is None:
        example = "must be like 'bearing_clearance [um]' or 'disc_bore[0,1] [um]'"
        raise StudyError(f"{path}: column {column!r}: {example}")
    if field not in shapes:
        raise StudyError(f"{path}: column {column!r}: parts of kind {kind!r} have {', '.join(shapes)}")
    units, known = KNOWN[study.unit(field)], recognised(unit, KNOWN[study.unit(field)])
    if known is None:
        raise StudyError(str(unknown_unit(f"{path}: column {column!r}: unit {unit!r}", unit, units)))
    shape = shapes[field]
    if len(place) != len(shape) or any(k >= size for k, size in zip(place, shape)):
        raise StudyError(f"{path}: column {column!r}: {field} of this part has the shape {shape}")
    return field, place, known


def _count(text: str, where: str) -> int:
    if not text.isdecimal():
        raise StudyError(f"{where} = {text!r}: must be a whole number, 0 or more")
    return int(text)
