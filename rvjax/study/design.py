"""The design of a study, where each of its numbers is from, and checks of the input values.

A design is a published one with changes, or every number of a kind. Impossible values raise an error, unusual values
give a warning: a wrong unit in a file is not detected elsewhere.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from rvjax import catalogue, models
from rvjax.catalogue import BASES, doubt, doubtful, part_class, shown, steep, undercut, walk
from rvjax.designs import InvoluteStage
from rvjax.errors import described
from rvjax.outputs import Output
from rvjax.records import Design, PyTree, Record
from rvjax.study.kinds import kind_of, number_at
from rvjax.study.tolerances import Form, by_error, metadata, stated_by
from rvjax.study.values import Metadata, Toml, choice, field_value, is_replaced, known, naming_field
from rvjax.tolerances import Cost, Limits, Middle, Tolerance
from rvjax.units import with_unit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def parse_design(table: Toml) -> PyTree:
    """A design from the table [design].

    Args:
        table: `base` and changes to it, or `kind` and all numbers; parts of a design are tables.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    numbers = {key: value for key, value in table.items() if key not in ("base", "kind")}
    if "kind" not in table:
        if "base" not in table:
            raise ValueError(
                f"design.base or design.kind is missing: a known reducer ({', '.join(BASES)}), or its kind"
            )
        design = _changed(BASES[choice(table.get("base"), BASES, "design.base")], numbers, "design")
    elif "base" in table:
        raise ValueError("design.base and design.kind: give one of them")
    else:
        kinds = models.kinds()
        design = _made(kinds[choice(table["kind"], kinds, "design.kind")], numbers, "design")
    return kind_of(design).followed(design, numbers)


def given_numbers(table: Toml) -> dict[str, PyTree]:
    """Numbers of a table [design] by path, SI; with a base all of them, else those that the table gives.

    Args:
        table: `base` and changes to it, or `kind` and any numbers.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    if "kind" not in table or "base" in table:
        return {path: value for path, value, _ in walk(parse_design(table))}
    kinds = models.kinds()
    numbers = {key: value for key, value in table.items() if key != "kind"}
    return dict(_flat(kinds[choice(table["kind"], kinds, "design.kind")], numbers, "design"))


def _flat(cls: type, table: object, where: str) -> Iterator[tuple[str, PyTree]]:
    """(path, value) of the numbers of a part, complete or not."""
    numbers = table if isinstance(table, dict) else {}
    parts = {f.name for f in dataclasses.fields(cls) if f.metadata["kind"] == "record"} & set(numbers)
    yield from _values(
        cls, table if not parts else {k: v for k, v in numbers.items() if k not in parts}, where, None
    ).items()
    for key in sorted(parts):
        name, inside = f"{where}.{key}", numbers[key]
        inner = _flat(part_class(cls, key, inside if isinstance(inside, dict) else (), None, name), inside, name)
        yield from ((f"{key}.{path}", value) for path, value in inner)


def _changed(record: Record, changes: object, where: str) -> PyTree:
    """A record with some fields changed; a missing part is created."""
    return record.replace(**_values(type(record), changes, where, record))


def _made(cls: type, numbers: object, where: str, instead_of: Record | None = None) -> PyTree:
    values = _values(cls, numbers, where, None)
    needed = [f for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING]
    missing = [(f.name, f.metadata["unit"]) for f in needed if f.name not in values]
    if cls is InvoluteStage and {"sun_teeth", "planet_teeth", "module"} <= set(values) <= {f.name for f in needed[:4]}:
        return InvoluteStage.from_teeth(**values)  # standard gears: the rest follows
    if missing:
        listed = ", ".join(name if unit == "-" else f"{name} in {unit}" for name, unit in missing)
        whose = f"; a {cls.__name__} takes no number from the {type(instead_of).__name__} of the base"
        raise ValueError(f"{where}: {listed} missing{whose if instead_of else ''}")
    make: Callable[..., PyTree] = cls
    with naming_field(where):
        return make(**values)


def _values(cls: type, table: object, where: str, base: Record | None) -> dict[str, PyTree]:
    """Values of the fields of a class of records."""
    if not isinstance(table, dict):
        raise ValueError(f"{where} = {table!r}: must be a table")
    fields = {f.name: f.metadata for f in dataclasses.fields(cls)}
    known(table, set(fields) | ({"base", "kind"} if where == "design" else set()), where)
    values: dict[str, PyTree] = {}
    for key, value in table.items():
        about, name, own = fields[key], f"{where}.{key}", getattr(base, key, None)
        if about["kind"] == "record":
            part = part_class(cls, key, value if isinstance(value, dict) else (), own, name)
            values[key] = _changed(own, value, name) if isinstance(own, part) else _made(part, value, name, own)
        else:
            values[key] = field_value(value, about, name)
    return values


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of a design.

    Attributes:
        path: in the design, such as "cycloid.pin_count".
        value: SI, or a count.
        unit: SI unit, "-" for none.
        meaning: of the field.
        origin: where it comes from, in words.
        assumed: true if its source, or the study, marks it as not published.
    """

    path: str
    value: PyTree
    unit: str
    meaning: str
    origin: str
    assumed: bool


def design_numbers(design: PyTree, given: Toml, text: str) -> list[Number]:
    """Numbers of a design with their origin.

    Args:
        design: the reducer.
        given: the table [design] of its study.
        text: of the study, whose comments may say that a number is assumed.
    """
    base = str(given.get("base", ""))
    sources, own = catalogue.sources(base), comments(text)
    published = catalogue.BASES.get(base)
    kind, found, stated = kind_of(design), [], given_paths(given)
    for path, value, about in walk(design):
        # A number that is neither given nor the published one has followed from others.
        kept = published is not None and path in sources and _same(value, number_at(published, path))
        if path in stated:
            origin, said = "this study", own.get(path, "")
        elif (derived := kind.derivation(design, path, value)) and not (kept and stated.isdisjoint(kind.derived_from)):
            origin, said = derived, ""
        elif kept:
            said = sources[path]
            origin = f"{base}: {said}" if said else base
        else:
            origin, said = "default", ""
        assumed = is_assumed(said) and not is_replaced(value, about, said)
        found.append(Number(path, value, about["unit"], about["meaning"], origin, assumed))
    return found


def comments(text: str, table: str = "design") -> dict[str, str]:
    """The comment at each key of a table in a study file, by its path; that of its header if it says "assumed".

    Args:
        text: of the study.
        table: such as "design" or "requirement".
    """
    found = {}
    for path, note, heading in catalogue.noted(text, table):
        found[path] = "; ".join(filter(None, [note, heading if heading.startswith("assumed") else ""]))
    return found


def is_assumed(text: str) -> bool:
    """True if a comment marks a value as not published."""
    return bool(catalogue.ASSUMED.search(text))


def _same(value: PyTree, other: Design) -> bool:
    return other is not None and bool((value == other) if not hasattr(value, "shape") else (value == other).all())


def given_paths(table: Toml, prefix: str = "") -> set[str]:
    """Paths of the numbers that a table [design] gives."""
    found = set[str]()
    for key, value in table.items():
        found |= given_paths(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found


FAR_LIMIT = 10.0  # below the smallest known value of an output; assumed
HALF_WIDTH = {"m": (0.5e-6, 40e-6), "rad": (1e-4, 9e-3), "-": (0.01, 0.3)}  # of the studies and sources in this package


def refuse_impossible(design: Design, tolerances: Record, costs: dict[str, Cost], middles: dict[str, Middle]) -> None:
    """Raise an error for parts that do not fit into each other, and for errors as large as the part.

    Raises:
        ValueError: names the key, its value and what it collides with.
    """
    kind_of(design).refuse(design)
    for field, tolerance, about in _toleranced(tolerances):
        nominal = number_at(design, about["of"]) if about["of"] and about["unit"] != "-" else None
        part = None if nominal is None else abs(float(np.max(np.asarray(nominal))))
        widest = {f"tolerances.{field}": tolerance}
        if field in costs:
            coarsest = max(costs[field].coarsest, float(tolerance.half_width))
            widest[f"cost.{field}.coarsest = {shown(coarsest, about['unit'])}"] = tolerance.scaled(coarsest)
        if field in middles:
            half, lowest = max(float(t.half_width) for t in widest.values()), middles[field].lower
            widest[f"middle.{field}.lower = {shown(lowest, about['unit'])}"] = Tolerance(lowest - half, lowest + half)
        for name, limits in widest.items():
            unit, lower, upper = about["unit"], float(limits.lower), float(limits.upper)
            span = f"limits of {shown(lower, unit)} and {shown(upper, unit)}"
            if about["sign"] == "nonnegative" and lower < -1e-12 * abs(upper):
                raise ValueError(f"{name}: {span}, but a clearance cannot be negative")
            if part is not None and max(-lower, upper) >= part:
                raise ValueError(f"{name}: {span}, as large as the part itself, {shown(part, unit)}")


def doubts(
    design: Design,
    conditions: "DataclassInstance",
    tolerances: Record,
    forms: Mapping[str, Form] = MappingProxyType({}),
) -> list[str]:
    """Numbers that are far from those of every known reducer, a line each; tolerances as the file states them."""
    kind, found = kind_of(design), [f"design.{line}" for line in (undercut(design) or steep(design)) + doubtful(design)]
    for f in dataclasses.fields(conditions):
        if f.metadata["torque"]:
            value = abs(getattr(conditions, f.name) or 0.0)
            found += doubt(f"conditions.{f.name}", value, "N m", 0.0, kind.largest_torque)  # small loads are tests
    for number, (torque, speed, _) in enumerate(getattr(conditions, "duty", None) or ()):
        found += doubt(f"duty[{number}].output_torque", abs(torque), "N m", 0.0, kind.largest_torque)
        found += doubt(f"duty[{number}].output_speed", abs(speed), "rad/s", 0.0, kind.speed)
        found += _of_another_size(design, f"duty[{number}].output_torque", abs(torque))
    found += _of_another_size(design, "conditions.rated_torque", abs(getattr(conditions, "rated_torque", None) or 0.0))
    for field, tolerance, about in _toleranced(tolerances):
        half, unit = float(tolerance.half_width), about["unit"]
        what, times = stated_by(forms, field)
        if half and unit in HALF_WIDTH:
            ends = [times * end for end in (half, *HALF_WIDTH[unit])]
            found += doubt(f"tolerances.{field}: {what}", ends[0], unit, *ends[1:])
    given = {name for name, _, _ in _toleranced(tolerances)}
    found += [
        f"tolerances.{name}: {bound.placed} is the same error with its place, and sampled separately; without {name} "
        "the one follows"
        for name, bound in described(tolerances, "bounds").items()
        if {name, bound.placed} <= given
    ]
    return found + kind.doubts(design)


def _of_another_size(design: Design, name: str, torque: float) -> list[str]:
    """A rated torque of catalogues that does not fit the design: it may be left from the study of another size."""
    line = kind_of(design).of_another_size(design, torque)
    return [f"{name} = {shown(torque, 'N m')}: {line}"] if line else []


def doubtful_limits(requirements: Mapping[str, Limits], outputs: Mapping[str, Output]) -> list[str]:
    """Upper limits far below what any known reducer has, a line each.

    Args:
        requirements: by name of the output.
        outputs: by name.
    """
    found = []
    for name, requirement in requirements.items():
        (unit, size), least = outputs[name].shown, outputs[name].least
        if 0 < requirement.upper < least / FAR_LIMIT:
            limit, known = (with_unit(number / size, unit) for number in (requirement.upper, least))
            found.append(f"requirement.{name}.upper = {limit}: no known reducer has less than {known}; check the unit")
    return found


def doubtful_costs(costs: Mapping[str, Cost], tolerances: Record) -> list[str]:
    """Process ranges that are far from those of known parts, or that exclude the initial tolerance, a line each.

    Args:
        costs: by field.
        tolerances: of the study.
    """
    found = []
    for field, tolerance, about in _toleranced(tolerances):
        if field not in costs:
            continue
        unit, half = about["unit"], float(tolerance.half_width)
        finest, coarsest = float(costs[field].finest), float(costs[field].coarsest)
        for name, value in (("finest", finest), ("coarsest", coarsest)):
            if unit in HALF_WIDTH:
                found += doubt(f"cost.{field}.{name}", value, unit, *HALF_WIDTH[unit])
        likely = unit not in HALF_WIDTH or not doubt("", half, unit, *HALF_WIDTH[unit])  # else it has its line already
        if half and likely and not finest * (1 - 1e-9) <= half <= coarsest * (1 + 1e-9):
            found.append(
                f"cost.{field}: the process holds half-widths of {shown(finest, unit)} to {shown(coarsest, unit)}; "
                f"the initial one is {shown(half, unit)}"
            )
    return found


def _toleranced(tolerances: Record) -> Iterator[tuple[str, Tolerance, Metadata]]:
    for field, tolerance in by_error(tolerances).items():
        yield field, tolerance, metadata(type(tolerances), field)
