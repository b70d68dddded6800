"""Read bench files: which kind of data a file holds, and its rows of equal conditions.

Rows of equal unit, torque, direction and temperature are a run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rvjax._ground import columns as cells
from rvjax._ground.columns import Table
from rvjax.measured.conditions import DIRECTIONS, Conditions
from rvjax.measured.curve import Curve
from rvjax.measured.kind import Item, Kind
from rvjax.measured.loop import Hysteresis
from rvjax.measured.run import Run
from rvjax.measured.tones import Frequencies
from rvjax.units import KNOWN

UNITS: dict[str, dict[str, float]] = {
    "angle": KNOWN["rad"],
    "error": KNOWN["rad"],
    "torque": KNOWN["N m"],
    "temperature": {"degC": 1.0},
    "speed": KNOWN["rad/s"],
    "frequency": KNOWN["Hz"],
    "sd": KNOWN["Hz"],
}
"""Measurement units of each quantity, with their size in SI (temperatures stay in degC)."""
USUAL = {
    "angle": "deg",
    "error": "arcsec",
    "torque": "N m",
    "frequency": "Hz",
}  # units of the columns that must be there
WORDS = ("direction", "unit")
KINDS: dict[str, Kind] = {"curve": Curve(), "loop": Hysteresis(), "frequencies": Frequencies()}
"""Kinds of measurements, by the name that an `rvjax.outputs.Observation` gives it."""


def read_table(path: str | Path, columns: Mapping[str, object] | None = None) -> cells.Table:
    """A table that a bench has written; see `rvjax._ground.columns.read_table`."""
    return cells.read_table(path, columns, units=UNITS, words=WORDS)


@dataclass(frozen=True)
class Measured:
    """Everything measured, of one kind.

    Attributes:
        kind: "curve", "loop" or "frequencies".
        items: in the order of the files and rows.
    """

    kind: str
    items: tuple[Item, ...]

    @property
    def units(self) -> list[str]:
        """Names of the units, in the order in which they appear."""
        return list(dict.fromkeys(item.at.unit for item in self.items))

    @property
    def runs(self) -> tuple[Run, ...]:
        """Items of kind "curve"."""
        return tuple(item for item in self.items if isinstance(item, Run))


def read(
    paths: Sequence[str | Path], columns: Mapping[str, object] | None = None, *, kind: str | None = None
) -> Measured:
    """Read the content of CSV files.

    Args:
        paths: files with a header "name [unit]": angle, error, torque, temperature, frequency, sd, direction, unit.
        columns: foreign names by quantity: the header of the column, or {column, unit} where it says no unit.
        kind: the one kind that is read, a key of `KINDS`; None: whichever the files hold.

    Raises:
        ValueError: one line that names the file, the column or the row, its value and the unit.
        FileNotFoundError: there is no such file.
    """
    if not paths:
        raise ValueError("no data: name at least one CSV file")
    kinds: dict[str, str] = {}
    items: list[Item] = []
    for path in paths:
        table = read_table(path, columns)
        held = _kind(table, kind)
        kinds.setdefault(held, str(path))
        if len(kinds) > 1:
            (first, one), (second, other) = kinds.items()
            raise ValueError(f"{other}: holds {second}, {one} holds {first}; identify them one after the other")
        for at, every in _groups(table):
            items += [KINDS[held].read(table, own, rows) for own, rows in KINDS[held].passes(table, at, every)]
    return Measured(next(iter(kinds)), tuple(items))


def _kind(table: Table, wanted: str | None) -> str:
    """Kind of measurement of a table."""
    has = table.numbers.keys()
    for name in KINDS[wanted].needs if wanted else ():
        if name not in has:
            have = ", ".join([*has, *table.words]) or "no column that is known"
            raise ValueError(f'{table.source}: has no column "{name} [{USUAL[name]}]"; it has {have}')
    if wanted:
        return wanted
    for name, kind in sorted(KINDS.items(), key=lambda item: len(item[1].needs)):  # a frequency decides alone
        if set(kind.needs) <= has:
            return name
    lists = "; ".join(f"{name}: {', '.join(kind.needs)}" for name, kind in KINDS.items())
    found = f"columns {', '.join([*has, *table.words]) or 'none of them'}: what is needed is one of {lists}"
    raise ValueError(f"{table.source}: {found} (name foreign ones in [columns])")


def _groups(table: Table) -> list[tuple[Conditions, np.ndarray]]:
    """Rows of equal conditions, in the order in which these appear."""
    n = len(table.rows)
    unit = table.words.get("unit", [""] * n)
    words = table.words.get("direction", [""] * n)
    direction, stated = [word or "forward" for word in words], any(words)
    for row, word in zip(table.rows, direction):
        if word not in DIRECTIONS:
            raise ValueError(f"{table.source}: row {row}, direction = {word[:40]!r}: must be forward or backward")
    empty = np.full(n, np.nan)
    torque = table.numbers.get("torque", empty) if "error" in table.numbers else empty
    found: dict[Conditions, list[int]] = {}
    numbers = (table.numbers.get(name, empty) for name in ("temperature", "speed"))
    for k, (own, load, way, warm, fast) in enumerate(zip(unit, torque, direction, *numbers)):
        at = Conditions(own, _or_none(load), way, _or_none(warm), _or_none(fast), stated)
        found.setdefault(at, []).append(k)
    return [(at, np.array(rows)) for at, rows in found.items()]


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
