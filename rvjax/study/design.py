"""The design of a study: a published one with changes, or every number of a kind of design.

Numbers of a design that follow from others.

Where a study changes what a number follows from, the number follows; where it gives both, they must agree. A published
design that contradicts itself keeps its numbers as long as nothing of that part is changed.
"""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from rvjax import catalogue, models
from rvjax._reducer.plausible import walk
from rvjax.catalogue import part_class
from rvjax.designs import InvoluteStage, RVReducer
from rvjax.records import Design, PyTree, Record, Scalar
from rvjax.study.values import Toml, choice, integer, known, naming_field, quantities, subtable

GEARS = ("sun_teeth", "planet_teeth", "module", "pressure_angle")
PROFILE = ("eccentricity", "pin_count", "pin_circle_radius")
# Share by which a given number may differ from what it follows from: rounding of drawings; profile shift of the gears
# (one module at ten and thirty teeth); cranks off the planets' axes by a rounded shift (0.8 % in the RV-320E).
AGREE = {"sun_radius": 2e-3, "sun_base_radius": 2e-3, "planet_base_radius": 2e-3, "centre_distance": 0.05}
AGREE_CIRCLE = 0.02


def followed(design: Design, given: Toml) -> Design:
    """The design, with what follows from the numbers that a study gives.

    Raises:
        ValueError: a given number contradicts those it follows from; names both.
    """
    if not isinstance(design, RVReducer):
        return design
    gears, profile, cranks = (set(subtable(given, part)) for part in ("involute", "cycloid", "cranks"))
    involute = design.involute
    standard = InvoluteStage.from_teeth(**{name: getattr(involute, name) for name in GEARS})
    if gears & set(GEARS):
        involute = involute.replace(**{name: getattr(standard, name) for name in AGREE if name not in gears})
    for name in sorted(gears & set(AGREE)):
        _agree(f"involute.{name}", getattr(involute, name), "teeth and module", getattr(standard, name), AGREE[name])
    circle = design.cranks
    if involute.centre_distance != design.involute.centre_distance or "centre_distance" in gears:
        circle = circle if "circle_radius" in cranks else circle.replace(circle_radius=involute.centre_distance)
    if "circle_radius" in cranks:
        _agree(
            "cranks.circle_radius", circle.circle_radius, "centre_distance", involute.centre_distance, AGREE_CIRCLE,
            "each planet sits on its crank",
        )  # fmt: skip
    cycloid = design.cycloid
    if profile & set(PROFILE) and "shortening" not in profile:
        cycloid = cycloid.replace(shortening=None)
    return design.replace(involute=involute, cranks=circle, cycloid=cycloid)


def _agree(name: str, value: Scalar, source: str, due: Scalar, share: float, why: str = "") -> None:
    if np.any(np.abs(value - due) > share * np.abs(due)):
        reason = f"; {why}" if why else ""
        raise ValueError(
            f"design.{name} = {1e3 * value:.6g} mm: {source} make it {1e3 * due:.6g} mm, more than {share:.3g} of it "
            f"apart{reason}"
        )


BASES = {
    "corr": catalogue.CORR,
    "rv-20e": catalogue.RV_20E,
    "rv-40e": catalogue.RV_40E,
    "rv-40e-whole": catalogue.RV_40E_WHOLE,
    "rv-80e": catalogue.RV_80E,
    "rv-320e": catalogue.RV_320E,
}


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
        changed = _changed(BASES[choice(table.get("base"), BASES, "design.base")], numbers, "design")
        return followed(changed, numbers)
    if "base" in table:
        raise ValueError("design.base and design.kind: give one of them")
    kinds = models.kinds()
    return followed(_made(kinds[choice(table["kind"], kinds, "design.kind")], numbers, "design"), numbers)


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
        elif about["kind"] == "count":
            values[key] = integer(value, name, about["minimum"], about["maximum"])
        else:
            values[key] = quantities(value, about["unit"], name)
    return values
