"""The design of a study: a published one with changes, or every number of a kind of design."""

import dataclasses
from typing import Any

from rvjax import catalogue, models
from rvjax.catalogue import part_class
from rvjax.designs import InvoluteStage
from rvjax.study.following import followed
from rvjax.study.values import choice, known, naming_field, quantity

BASES = {
    "corr": catalogue.CORR,
    "rv-20e": catalogue.RV_20E,
    "rv-40e": catalogue.RV_40E,
    "rv-80e": catalogue.RV_80E,
    "rv-320e": catalogue.RV_320E,
}


def parse_design(table: dict[str, Any]) -> Any:
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
        changed = _changed(BASES[choice(table.get("base"), BASES, "design.base")], numbers, "design")
        return followed(changed, numbers)
    if "base" in table:
        raise ValueError("design.base and design.kind: give one of them")
    kinds = models.kinds()
    return followed(_made(kinds[choice(table["kind"], kinds, "design.kind")], numbers, "design"), numbers)


def _changed(record: Any, changes: Any, where: str) -> Any:
    """A record with some fields changed; a part that it lacks is made from nothing."""
    return record.replace(**_values(type(record), changes, where, record))


def _made(cls: Any, numbers: Any, where: str) -> Any:
    values = _values(cls, numbers, where, None)
    needed = [f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING]
    missing = [name for name in needed if name not in values]
    if cls is InvoluteStage and {"sun_teeth", "planet_teeth", "module"} <= set(values) <= {*needed[:4]}:
        return InvoluteStage.from_teeth(**values)  # standard gears: the rest follows
    if missing:
        units = {f.name: f.metadata["unit"] for f in dataclasses.fields(cls)}
        listed = ", ".join(name if units[name] == "-" else f"{name} in {units[name]}" for name in missing)
        raise ValueError(f"{where}: {listed} missing")
    with naming_field(where):
        return cls(**values)


def _values(cls: Any, table: Any, where: str, base: Any) -> dict[str, Any]:
    """Values of the fields of a class of records."""
    if not isinstance(table, dict):
        raise ValueError(f"{where} = {table!r}: must be a table")
    fields = {f.name: f for f in dataclasses.fields(cls)}
    known(table, set(fields) | ({"base", "kind"} if where == "design" else set()), where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        metadata, name = fields[key].metadata, f"{where}.{key}"
        own = getattr(base, key, None)
        if metadata["kind"] == "record":
            values[key] = _made(part_class(cls, key), value, name) if own is None else _changed(own, value, name)
        elif metadata["kind"] == "count":
            if isinstance(value, bool) or not isinstance(value, int):
                raise ValueError(f"{name} = {value!r}: must be an integer")
            if value > metadata["maximum"]:
                raise ValueError(f"{name} = {value}: must be at most {metadata['maximum']}")
            values[key] = value  # the record checks the rest
        elif isinstance(value, list) and metadata.get("shape"):
            values[key] = [_number(item, metadata["unit"], name) for item in value]
        else:
            values[key] = _number(value, metadata["unit"], name)
    return values


def _number(value: object, unit: str, where: str) -> Any:
    return [_number(item, unit, where) for item in value] if isinstance(value, list) else quantity(value, unit, where)
