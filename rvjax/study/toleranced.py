"""Table [tolerances] of a study."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from rvjax.axes import axis_sizes
from rvjax.population import COMMON, DISTRIBUTIONS
from rvjax.records import Design, PyTree, Shape
from rvjax.study.placed import spelled
from rvjax.study.values import Metadata, Toml, choice, integer, known, naming_field, quantity, subtable
from rvjax.tolerances import Tolerance, for_design


def metadata(record: PyTree, field: str) -> Metadata:
    """Metadata of a field of a class of records."""
    return next(f.metadata for f in dataclasses.fields(record) if f.name == field)


def parse_tolerances(design: Design, table: Toml, folder: Path) -> PyTree:
    """Read the table [tolerances], limits in the words of drawings included.

    Args:
        design: the reducer.
        table: as written.
        folder: that files named in the study are relative to.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    table = spelled(design, table)
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    known(table, fields, "tolerances")
    made = {}
    for field in table:
        where = f"tolerances.{field}"
        with naming_field(where):
            about, own = metadata(design.error_record, field), dict(subtable(table, field))
            shape = _series(about["shape"], design.counts, own, where)
            made[field] = parse_tolerance(own, about["unit"], where, folder, shape)
    return for_design(design, **made)


def _series(axes: Shape, counts: Mapping[str, int], table: Toml, where: str) -> tuple[int, ...]:
    """Shape of a series, whose number of harmonics is taken out of its table; () where the design defines all sizes."""
    own = [axis for axis in axes if isinstance(axis, str) and axis not in counts]
    if not own:
        return ()
    if "harmonics" not in table:
        raise ValueError(f"{where}.harmonics is missing: an integer, the number of terms of the series")
    harmonics = integer(table.pop("harmonics"), f"{where}.harmonics", 1, 1000)
    return axis_sizes(axes, {**counts, **dict.fromkeys(own, harmonics)}, (0,) * len(axes))


def parse_tolerance(
    table: Toml, unit: str, where: str, folder: Path = Path(), shape: tuple[int, ...] = ()
) -> Tolerance:
    """Read the tolerance of one error.

    Args:
        table: as written.
        unit: SI unit of the error.
        where: name of the table, for messages.
        folder: that files named in it are relative to.
        shape: of the error; () where the design defines it.
    """
    law = DISTRIBUTIONS[choice(table.get("distribution", "normal"), DISTRIBUTIONS, f"{where}.distribution")]
    known(table, {"lower", "upper", "half_width", "grade", "size", "distribution", *COMMON, *law.parameters()}, where)
    if "cp" in table and not law.capable:
        raise ValueError(f"{where}.cp = {table['cp']!r}: {law.name} ends at the limits, it has no capability")
    options: dict[str, PyTree] = {"distribution": law, "shape": shape}
    options |= {key: quantity(table[key], "-", f"{where}.{key}") for key in COMMON if key in table}
    for key in law.parameters():
        if key in table:
            value = table[key]
            if isinstance(value, dict) and isinstance(value.get("file"), str):
                value = value | {"file": str(folder / value["file"])}
            options[key] = law.parsed(key, value, unit)
    size = quantity(table["size"], "m", f"{where}.size") if "size" in table else None
    ways = [{"lower", "upper"}, {"half_width"}, {"grade", "size"}]
    given = set(table) & {"lower", "upper", "half_width", "grade"}
    chosen = next((way for way in ways if given and given == way - {"size"}), None)
    if chosen is None or (chosen == ways[2] and size is None):
        raise ValueError(f"{where}: give lower and upper, or half_width, or grade and size")
    if chosen == ways[2] and size is not None:
        if unit != "m":
            raise ValueError(f"{where}.grade = {table['grade']!r}: grades are for lengths, this error is in {unit}")
        grade: PyTree = table["grade"]
        return Tolerance.grade(grade, size, **options)
    if size is not None and unit != "m":
        raise ValueError(f"{where}.size = {table['size']!r}: sizes are for lengths, this error is in {unit}")
    limits = {key: quantity(table[key], unit, f"{where}.{key}") for key in sorted(given)}
    if chosen == ways[1]:
        if limits["half_width"] < 0:
            raise ValueError(f"{where}.half_width = {table['half_width']!r}: must not be negative")
        return Tolerance.symmetric(limits["half_width"], size=size, **options)
    return Tolerance(limits["lower"], limits["upper"], size=size, **options)
