"""The table [assembly] of a study, and the list of measured parts: rows, and the parts of a kind in its slots."""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rvjax.assembly import (
    OBJECTIVES,
    Kind,
    Part,
)
from rvjax.base import columns
from rvjax.base.cells import MARKS, read_cells
from rvjax.base.fields import axis_sizes, element as element_name, place_of
from rvjax.base.text import guessed, number_of
from rvjax.mounting import AXES, carried, disc_mountings, drawing
from rvjax.records import PyTree
from rvjax.study import Study, StudyError, choice, integer, known, quantity, subtable
from rvjax.tolerances import Tolerance
from rvjax.units import KNOWN, recognised, unknown_unit

WORDS = ("kind", "id", "stock")
REST = "rest"
"""Slot of all errors with a tolerance and without parts: not measured, independent in each unit."""


@dataclasses.dataclass(frozen=True)
class Assembly:
    """Options for matching measured parts: the table [assembly].

    Attributes:
        response: that decides; None: the only requirement.
        objective: "mean", "bottleneck" or "yield".
        turned: discs may be turned over and carriers turned.
        draws: samples of the unmeasured errors, for the choice.
        certificate_draws: independent samples, for the statistics of the result.
        sd: standard deviation of the measurement by error, SI.
    """

    response: str | None = None
    objective: str = "mean"
    turned: bool = True
    draws: int = 64
    certificate_draws: int = 1024
    sd: Mapping[str, float] = dataclasses.field(default_factory=dict)


def table_of(study: Study) -> Assembly:
    """The table [assembly] of a study, or what holds without it."""
    found = study.sections.get("assembly")
    return found if isinstance(found, Assembly) else Assembly()


def section(table: Mapping[str, object], loaded: Study) -> Assembly:
    """The table [assembly] of a study.

    Args:
        table: as written.
        loaded: the study.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    known(table, {f.name for f in dataclasses.fields(Assembly)}, "assembly")
    found: dict[str, PyTree] = {}
    if "response" in table:
        found["response"] = choice(table["response"], loaded.requirements, "assembly.response")
    if "objective" in table:
        found["objective"] = choice(table["objective"], OBJECTIVES, "assembly.objective")
    if "turned" in table:
        if not isinstance(table["turned"], bool):
            raise ValueError(f"assembly.turned = {table['turned']!r}: must be true or false")
        found["turned"] = table["turned"]
    for key, most in (("draws", 4096), ("certificate_draws", 1_000_000)):
        if key in table:
            found[key] = integer(table[key], f"assembly.{key}", 1, most)
    sd = subtable(table, "sd")
    units = {f.name: f.metadata["unit"] for f in dataclasses.fields(loaded.design.error_record)}
    known(sd, units, "assembly.sd")
    found["sd"] = {name: quantity(value, units[name], f"assembly.sd.{name}") for name, value in sd.items()}
    for name, value in found["sd"].items():
        if value < 0:
            raise ValueError(f"assembly.sd.{name} = {sd[name]!r}: must be zero or positive")
    return Assembly(**found)


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


def rows_of(path: Path, encoding: str | None) -> tuple[list[Row], list[str]]:
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


def slots_of(design: PyTree, kind: str, path: str | Path) -> tuple[list[str], dict[str, tuple[int, ...]]]:
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


def kind_of_rows(
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
