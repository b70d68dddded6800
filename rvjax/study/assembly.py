"""Parts read from a CSV file, as kinds in the slots of a reducer."""

import csv
import dataclasses
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rvjax.assembly import OBJECTIVES, Kind, Machine, Part, Plan, draw, supply_of
from rvjax.assembly import known as known_parts
from rvjax.mounting import carried, disc_mountings, drawing, unit_errors
from rvjax.records import axis_sizes
from rvjax.study.matching import Assembly
from rvjax.study.question import Study, StudyError
from rvjax.study.values import choice, finite, integer, known, quantity, subtable
from rvjax.tolerances import Requirement, Tolerance
from rvjax.units import KNOWN

HEAD = re.compile(r"(?P<field>[a-z_]+)(?P<element>(?:\[\d+\])*) \[(?P<unit>[^\]]+)\]")
REST = "rest"
"""Slot of all errors that have a tolerance and no parts: each unit has its own, nobody measured them."""


def parse_assembly(table: dict[str, Any], design: Any, requirements: Mapping[str, Any]) -> Assembly:
    """The table [assembly] of a study.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    known(table, {"response", "objective", "turned", "draws", "certificate_draws", "sd"}, "assembly")
    found: dict[str, Any] = {}
    if "response" in table:
        found["response"] = choice(table["response"], requirements, "assembly.response")
    if "objective" in table:
        found["objective"] = choice(table["objective"], OBJECTIVES, "assembly.objective")
    if "turned" in table:
        if not isinstance(table["turned"], bool):
            raise ValueError(f"assembly.turned = {table['turned']!r}: must be true or false")
        found["turned"] = table["turned"]
    for key, most in (("draws", 4096), ("certificate_draws", 1_000_000)):
        if key in table:
            found[key] = integer(table[key], f"assembly.{key}", 1, most)
    units = {f.name: f.metadata["unit"] for f in dataclasses.fields(design.error_record)}
    sd = subtable(table, "sd")
    known(sd, units, "assembly.sd")
    found["sd"] = {name: quantity(value, units[name], f"assembly.sd.{name}") for name, value in sd.items()}
    for name, value in found["sd"].items():
        if value < 0:
            raise ValueError(f"assembly.sd.{name} = {sd[name]!r}: must be zero or positive")
    return Assembly(**found)


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """Parts of a study, ready to be matched.

    Attributes:
        response: (parts, index) -> Outcome of the response that decides.
        kinds: parts by slot.
        name: of the response.
        requirement: on it.
    """

    response: Any
    kinds: dict[str, Kind]
    name: str
    requirement: Requirement


def bench(study: Study, path: str | Path) -> Bench:
    """Parts of a study from a CSV file.

    The first line names the columns: `kind` ("disc", "crank", "carrier", or any name for parts that hold whole errors,
    such as pins or bearings), `id`, if wanted `stock`, and measured errors with their unit: "bearing_clearance [um]",
    "disc_bore[0][1] [um]" (crank 0, tangential). An empty cell is an error that this part does not have, or that was
    not measured where others of its kind have it.

    Args:
        study: design, tolerances (the populations), requirements and measurement uncertainties.
        path: of the file.

    Raises:
        StudyError: names file, line, column and value.
    """
    from rvjax.designs import RVReducer

    if not isinstance(study.design, RVReducer):
        raise StudyError(f"{study.name}: parts are matched for RV reducers only")
    name, requirement = _asked(study)
    rows = _rows(Path(path))
    groups: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        groups.setdefault(row["kind"].strip(), []).append(row)
    kinds: dict[str, Kind] = {}
    taken: set[str] = set()
    for kind, own in groups.items():
        slots, fields = _slots(study.design, kind, path)
        made = _kind(study, path, kind, own, fields, slots)
        for slot in slots:
            if slot in kinds:
                raise StudyError(f"{path}: {slot} has parts of two kinds")
            kinds[slot] = made
        taken |= {field for part in made.parts for field in part.errors}
    if len(kinds) < 2:
        raise StudyError(f"{path}: parts of {', '.join(kinds)} alone; at least two slots are matched")
    rest = {f: getattr(study.tolerances, f) for f in study.fields if f not in taken}
    if rest:
        zeros = {f: np.zeros(tolerance.shape) for f, tolerance in rest.items()}
        pieces = min(int(kind.pieces.sum()) for kind in kinds.values())
        kinds[REST] = Kind([Part("any", zeros, math.inf)], stock=[pieces], population=rest)
    outcome = study.response_of(name)
    design = study.design
    return Bench(lambda parts, index: outcome(unit_errors(design, parts, index)), kinds, name, requirement)


def unit_values(found: Bench, seed: int, plan: Plan | None = None, count: int = 1024) -> np.ndarray:
    """Responses of units with all that is not known of their parts drawn; nan where one fails (count,).

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
    name = study.assembly.response
    if name is None:
        if len(study.requirements) > 1:
            listed = ", ".join(study.requirements)
            raise StudyError(f"{study.name}: assembly.response is missing: which of {listed} decides?")
        name = next(iter(study.requirements))
    requirement = study.requirements[name]
    if not isinstance(requirement, Requirement):
        raise StudyError(f"{study.name}: requirement.{name}: parts are matched against limits of each unit")
    return name, requirement


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, restval="", skipinitialspace=True)
            rows = [row for row in reader if any((value or "").strip() for value in row.values() if value != [])]
            columns = [name.strip() for name in reader.fieldnames or []]
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such list of parts") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StudyError(f"{path}: cannot be read ({error})") from None
    for needed in ("kind", "id"):
        if needed not in columns:
            raise StudyError(f"{path}: has no column {needed!r}; it has {', '.join(columns) or 'none'}")
    if len(set(columns)) < len(columns):
        raise StudyError(f"{path}: two columns have one name")
    if not rows:
        raise StudyError(f"{path}: lists no part")
    for number, row in enumerate(rows, 2):
        if None in row:
            raise StudyError(f"{path}, line {number}: has more cells than columns")
    return [{(key or "").strip(): value or "" for key, value in row.items()} for row in rows]


def _slots(design: Any, kind: str, path: str | Path) -> tuple[list[str], dict[str, tuple[int, ...]]]:
    """Slots that a kind of parts feeds, and the errors it may hold with their shapes."""
    discs, cranks = design.cycloid.disc_count, design.cranks.count
    shapes = {f.name: axis_sizes(f.metadata["shape"], design.counts) for f in dataclasses.fields(design.error_record)}
    if match := re.fullmatch(r"disc(?:_(\d+))?", kind):
        slots = [f"disc_{k}" for k in range(discs) if drawing(design, k) == 0] if match[1] is None else [kind]
        if match[1] is not None and int(match[1]) >= discs:
            raise StudyError(f"{path}: kind = {kind!r}: this design has {discs} discs, counted from 0")
        return slots, carried(design, "disc")
    if match := re.fullmatch(r"crank(?:_(\d+))?", kind):
        if match[1] is not None and int(match[1]) >= cranks:
            raise StudyError(f"{path}: kind = {kind!r}: this design has {cranks} cranks, counted from 0")
        slots = [f"crank_{k}" for k in range(cranks)] if match[1] is None else [kind]
        return slots, carried(design, "crank")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", kind) or kind == REST:
        raise StudyError(f"{path}: kind = {kind!r}: must be disc, crank, carrier, or another name in small letters")
    apart = {*carried(design, "disc"), *carried(design, "crank")}
    return [kind], {name: shape for name, shape in shapes.items() if name not in apart}


def _kind(
    study: Study,
    path: str | Path,
    kind: str,
    rows: list[dict[str, str]],
    shapes: Mapping[str, tuple[int, ...]],
    slots: list[str],
) -> Kind:
    """Parts of one kind."""
    measured: dict[str, dict[tuple[int, ...], str]] = {}
    scales: dict[str, float] = {}
    for column in rows[0]:
        if column in ("kind", "id", "stock") or not any(row[column].strip() for row in rows):
            continue
        field, element, scale = _column(study, path, column, kind, shapes)
        measured.setdefault(field, {})[element] = column
        scales[column] = scale
    if not measured:
        raise StudyError(f"{path}: parts of kind {kind!r} have no error")
    parts, stock = [], []
    for row in rows:
        label = row["id"].strip()
        where = f"{path}, {kind} {label!r}"
        if not label:
            raise StudyError(f"{path}: a part of kind {kind!r} has no id")
        errors, sds = {}, {}
        for field, elements in measured.items():
            value, sd = np.zeros(shapes[field]), np.full(shapes[field], np.inf)
            for element, column in elements.items():
                if text := row[column].strip():
                    value[element] = finite(text, f"{where}: {column}") * scales[column]
                    sd[element] = study.assembly.sd.get(field, 0.0)
            if np.isinf(sd).any() and getattr(study.tolerances, field) is None:
                raise StudyError(f"{where}: {field} is not measured in full, and no tolerance says what it may be")
            errors[field], sds[field] = value, sd
        parts.append(Part(label, errors, sds))
        stock.append(_count(row.get("stock", "").strip() or "1", f"{where}: stock"))
    population = {field: tolerance for field in measured if (tolerance := getattr(study.tolerances, field)) is not None}
    checked = {field: one for field, one in population.items() if isinstance(one, Tolerance)}
    try:
        return Kind(parts, indices=_positions(study, slots[0]), stock=stock, population=checked)
    except ValueError as error:
        raise StudyError(f"{path}, {kind}: {error}") from None


def _positions(study: Study, slot: str) -> int:
    """Angular positions of a part in its slot."""
    if not study.assembly.turned:
        return 1
    kind, _, number = slot.rpartition("_")
    if kind == "disc":
        return len(disc_mountings(study.design, int(number), made_for=drawing(study.design, int(number))))
    return study.design.cranks.count if slot == "carrier" else 1


def _column(
    study: Study, path: str | Path, column: str, kind: str, shapes: Mapping[str, tuple[int, ...]]
) -> tuple[str, tuple[int, ...], float]:
    """Field, element and SI size of the unit of a column."""
    match = HEAD.fullmatch(column)
    if match is None:
        raise StudyError(f"{path}: column {column!r}: must be like 'bearing_clearance [um]' or 'disc_bore[0][1] [um]'")
    field = match["field"]
    if field not in shapes:
        raise StudyError(f"{path}: column {column!r}: parts of kind {kind!r} have {', '.join(shapes)}")
    units = KNOWN[study.unit(field)]
    if match["unit"] not in units:
        raise StudyError(f"{path}: column {column!r}: unit {match['unit']!r} is not one of {', '.join(units)}")
    element = tuple(map(int, re.findall(r"\d+", match["element"])))
    shape = shapes[field]
    if len(element) != len(shape) or any(k >= size for k, size in zip(element, shape)):
        raise StudyError(f"{path}: column {column!r}: {field} of this part has the shape {shape}")
    return field, element, units[match["unit"]]


def _count(text: str, where: str) -> int:
    if not text.isdecimal():
        raise StudyError(f"{where} = {text!r}: must be a whole number, 0 or more")
    return int(text)
