"""The design of a study: a published one with changes, or every number of a kind; and where each number is from."""

import dataclasses
import re
from collections.abc import Callable, Iterator

from rvjax import catalogue, models
from rvjax.catalogue import BASES, part_class, walk
from rvjax.designs import InvoluteStage
from rvjax.records import PyTree, Record
from rvjax.study.kinds import kind_of, number_at
from rvjax.study.values import Toml, choice, field_value, known, naming_field


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
        inner = _flat(part_class(cls, key), numbers[key], f"{where}.{key}")
        yield from ((f"{key}.{path}", value) for path, value in inner)


def _changed(record: Record, changes: object, where: str) -> PyTree:
    """A record with some fields changed; a missing part is created."""
    return record.replace(**_values(type(record), changes, where, record))


def _made(cls: type, numbers: object, where: str) -> PyTree:
    values = _values(cls, numbers, where, None)
    needed = [f for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING]
    missing = [(f.name, f.metadata["unit"]) for f in needed if f.name not in values]
    if cls is InvoluteStage and {"sun_teeth", "planet_teeth", "module"} <= set(values) <= {f.name for f in needed[:4]}:
        return InvoluteStage.from_teeth(**values)  # standard gears: the rest follows
    if missing:
        listed = ", ".join(name if unit == "-" else f"{name} in {unit}" for name, unit in missing)
        raise ValueError(f"{where}: {listed} missing")
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
            values[key] = _made(part_class(cls, key), value, name) if own is None else _changed(own, value, name)
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
        found.append(Number(path, value, about["unit"], about["meaning"], origin, is_assumed(said)))
    return found


def comments(text: str, table: str = "design") -> dict[str, str]:
    """The comment at each key of a table in a study file, by its path; that of its header if it says "assumed".

    Args:
        text: of the study.
        table: such as "design" or "requirement".
    """
    found, section, heading = dict[str, str](), "", ""
    for line in text.splitlines():
        if header := re.match(r"\s*\[([^\]]*)\]\s*(?:#\s*(.*))?", line):
            section, heading = header[1].strip(), header[2] or ""
        elif section.split(".")[0] == table and (key := re.match(r"\s*([\w.-]+)\s*=[^#]*(?:#\s*(.*))?$", line)):
            path = ".".join([*section.split(".")[1:], key[1]])
            found[path] = "; ".join(filter(None, [key[2], heading if heading.startswith("assumed") else ""]))
    return found


def is_assumed(text: str) -> bool:
    """True if a comment marks a value as not published."""
    return bool(catalogue.ASSUMED.search(text))


def _same(value: PyTree, other: PyTree) -> bool:
    return other is not None and bool((value == other) if not hasattr(value, "shape") else (value == other).all())


def given_paths(table: Toml, prefix: str = "") -> set[str]:
    """Paths of the numbers that a table [design] gives."""
    found = set[str]()
    for key, value in table.items():
        found |= given_paths(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found
