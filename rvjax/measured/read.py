"""Read bench files, long or wide: which kind of data a file holds, and its rows of equal conditions.

Rows of equal unit, torque, direction and temperature are a run. A wide file has a column of readings for each run.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rvjax.base import columns as cells
from rvjax.base.cells import is_number, listed
from rvjax.base.columns import Table, name_and_unit
from rvjax.base.text import guessed
from rvjax.measured.kinds import KINDS, Item
from rvjax.measured.run import DIRECTIONS, Conditions, Run
from rvjax.units import KNOWN, recognised

SIDES = {
    "forward": ("fwd", "forward", "forwards", "fw", "up", "positive", "↑"),
    "backward": ("bwd", "backward", "backwards", "bw", "back", "reverse", "rev", "down", "negative", "↓"),
}
"""Words for a run in a direction."""
TARGETS = {"target", "tgt", "nominal", "command", "commanded", "setpoint"}
_POSITION = {"angle", "angular", "position", "pos", "output"}
_OTHERS = {"error", "dev", "deviation", "actual", "measured", "run", "cycle", "te", "x", "value", "reading"}
_OTHERS |= {"direction"}
NEARER = 10.0  # readings are positions if they are so much nearer to the target than to zero, else deviations


def _words(header: str) -> list[str]:
    """Words of the name of a column; numbers are left out."""
    return re.findall(r"[^\W\d_]+|[↑↓]", name_and_unit(header)[0].casefold())


def side_of(header: str) -> str | None:
    """Return the direction that a header such as "fwd1 [deg]" names, None if it names none."""
    words = _words(header)
    sides = [side for side, own in SIDES.items() for word in words if word in own]
    rest = {word for word in words if not any(word in own for own in SIDES.values())}
    return sides[0] if len(sides) == 1 and rest <= _OTHERS | _POSITION else None


def is_target(header: str) -> bool:
    """Return True for the header of the target angles."""
    words = set(_words(header))
    return bool(words & TARGETS) and words <= TARGETS | _POSITION


def is_column(header: str) -> bool:
    """Return True for a header of a wide table."""
    return is_target(header) or side_of(header) is not None


def read_wide(
    path: str | Path, table: Table, columns: Mapping[str, object] | None, encoding: str | None
) -> Table | None:
    """The long table of a wide one: angle, error, direction; None if the file is no wide table.

    A column holds positions, which are compared with the target, or deviations from it.

    Args:
        path: of the file.
        table: what was read of the file otherwise; its header names the columns.
        columns: foreign names; that of the angle is the target.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: no single column of targets, a column without a unit, neither positions nor deviations.
    """
    header = table.header
    runs = {k: side for k, text in enumerate(header) if (side := side_of(text)) is not None}
    targets = [k for k, text in enumerate(header) if is_target(text)]
    if not runs or not ("angle" in table.numbers or targets):
        return None
    if "angle" not in table.numbers and len(targets) > 1:
        both = listed([header[k] for k in targets])
        line = cells.mapping("angle", [header[targets[0]]], UNITS["angle"])[1]
        raise ValueError(f"{path}: the target may be in {both}; write one in [columns]: {line}")
    at = {f"run {k}": k for k in runs}
    if "angle" not in table.numbers:
        at |= {"angle": targets[0]}
    for name, k in at.items():
        if name_and_unit(header[k])[1] is None:
            example = "deg" if name == "angle" else "arcsec"
            raise ValueError(f'{path}: column {header[k]!r}: has no unit; write "{header[k]} [{example}]"')
    others = {name: family for name, family in UNITS.items() if name != "error"} | dict.fromkeys(at, UNITS["angle"])
    read = cells.read_table(path, columns, units=others, words=("unit",), at=at, named=is_column, encoding=encoding)
    target = read.numbers["angle"]
    values = np.stack([read.numbers[f"run {k}"] for k in runs], axis=1)
    errors, what = _errors(str(path), target, values)
    repeat = len(runs)
    numbers = {"angle": np.repeat(target, repeat), "error": errors.ravel()}
    numbers |= {n: np.repeat(v, repeat) for n, v in read.numbers.items() if n in UNITS and n != "angle"}
    texts = {name: [cell for cell in own for _ in runs] for name, own in read.words.items()}
    texts |= {"direction": list(runs.values()) * len(target)}
    sides = "; ".join(
        f"{side}: {listed([header[k] for k in runs if runs[k] == side])}" for side in dict.fromkeys(runs.values())
    )
    first = next(iter(runs))
    shown = {n: u for n, u in read.shown.items() if n in UNITS} | {"error": read.shown[f"run {first}"]}
    notes = [note for note in read.notes if not note.startswith("columns are read")]
    notes += [f"a wide table is read: {sides}; {what}"]
    return Table(str(path), np.repeat(read.rows, repeat), numbers, texts, shown, read.header, tuple(notes))


def _errors(source: str, target: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, str]:
    """Errors of readings (targets, runs), rad, and whether these are positions or deviations."""
    less = np.angle(np.exp(1j * (values - target[:, None])))
    as_positions, as_deviations = (np.nanmax(np.abs(x), initial=0.0) for x in (less, values))
    if NEARER * as_positions < as_deviations:
        return less, "readings are positions, the error is reading less target"
    if NEARER * as_deviations < as_positions:
        return values, "readings are deviations from the target"
    raise ValueError(
        f"{source}: the readings of the wide table are neither near the targets nor near zero; "
        'write a long table with angle, error and direction, such as "angle [deg],error [arcsec],direction"'
    )


USUAL = {"angle": "deg", "error": "arcsec", "torque": "N m", "speed": "rpm", "frequency": "Hz", "sd": "Hz"}
_SI = {"angle": "rad", "error": "rad", "torque": "N m", "speed": "rad/s", "frequency": "Hz", "sd": "Hz"}
UNITS: dict[str, dict[str, float]] = {name: {usual: 0.0} | KNOWN[_SI[name]] for name, usual in USUAL.items()}
UNITS["temperature"] = {"degC": 1.0}
"""Measurement units of each quantity, the usual one first, with their size in SI (temperatures stay in degC)."""
SWEPT = 4  # different torques that a loop has at least
WORDS = ("direction", "unit")
_WAYS = {"": "forward", "forward": "forward", "fwd": "forward", "backward": "backward", "bwd": "backward"}


def read_table(
    path: str | Path,
    columns: Mapping[str, object] | None = None,
    *,
    kind: str | None = None,
    encoding: str | None = None,
) -> cells.Table:
    """A table that a bench has written, long or wide; see `rvjax.base.columns.read_table`.

    Args:
        path: of the file.
        columns: foreign names by quantity.
        kind: the kind that is wanted; None: any.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: one line that names the file, the column or the row, its value and the unit.
    """
    enough = [own.needs for name, own in KINDS.items() if kind in (None, name)]
    table = cells.read_table(path, columns, units=UNITS, words=WORDS, enough=enough, named=is_column, encoding=encoding)
    found = {name for name in KINDS if kind in (None, name) and set(KINDS[name].needs) <= table.numbers.keys()}
    both = {side_of(text) for text in table.header} >= set(DIRECTIONS)
    few = found == {"loop"} and both and len(np.unique(table.numbers["torque"])) < SWEPT
    if (found and not few) or kind not in (None, "curve"):
        return table
    try:  # a wide table may be at a few nominal torques
        return read_wide(path, table, columns, encoding) or table
    except ValueError:
        if few:
            return table
        raise


@dataclass(frozen=True)
class Measured:
    """Everything measured, of one kind.

    Attributes:
        kind: "curve", "loop" or "frequencies".
        items: in the order of the files and rows.
        notes: what was read from a form that is not the plain one, a sentence each, with the name of the file.
    """

    kind: str
    items: tuple[Item, ...]
    notes: tuple[str, ...] = ()

    @property
    def units(self) -> list[str]:
        """Names of the units, in the order in which they appear."""
        return list(dict.fromkeys(item.at.unit for item in self.items))

    @property
    def runs(self) -> tuple[Run, ...]:
        """Items of kind "curve"."""
        return tuple(item for item in self.items if isinstance(item, Run))


def read(
    paths: Sequence[str | Path],
    columns: Mapping[str, object] | None = None,
    *,
    kind: str | None = None,
    encoding: str | None = None,
) -> Measured:
    """Read the content of CSV files.

    Args:
        paths: files with a header "name [unit]": angle, error, torque, temperature, frequency, sd, direction, unit.
        columns: foreign names by quantity: the header of the column, or {column, unit} where it says no unit.
        kind: the one kind that is read, a key of `KINDS`; None: whichever the files hold.
        encoding: of the files, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: one line that names the file, the column or the row, its value and the unit.
        FileNotFoundError: there is no such file.
    """
    if not paths:
        raise ValueError("no data: name at least one CSV file")
    kinds: dict[str, str] = {}
    items: list[Item] = []
    notes: list[str] = []
    for path in paths:
        table = read_table(path, columns, kind=kind, encoding=encoding)
        held = _kind(table, kind)
        kinds.setdefault(held, str(path))
        if len(kinds) > 1:
            (first, one), (second, other) = kinds.items()
            raise ValueError(f"{other}: holds {second}, {one} holds {first}; identify them one after the other")
        for at, every in _groups(table):
            items += [KINDS[held].read(table, own, rows) for own, rows in KINDS[held].passes(table, at, every)]
        notes += [f"{Path(path).name}: {note}" for note in table.notes]
    return Measured(next(iter(kinds)), tuple(items), tuple(notes))


def _kind(table: Table, wanted: str | None) -> str:
    """Kind of measurement of a table."""
    has = table.numbers.keys()
    have = ", ".join([*has, *table.words])
    if wanted:
        needs = KINDS[wanted].needs
        for name in needs:
            if name not in has:
                said = f'has no column "{name} [{USUAL[name]}]"; it has {have or "no column that is known"}'
                raise ValueError(f"{table.source}: {said}; {_named(table, needs)}")
        return wanted
    for name, kind in sorted(KINDS.items(), key=lambda item: len(item[1].needs)):  # a frequency decides alone
        if set(kind.needs) <= has:
            return name
    lists = "; ".join(f"{name}: {', '.join(kind.needs)}" for name, kind in KINDS.items())
    near = max(KINDS.values(), key=lambda kind: _fitting(table, kind.needs))
    found = f"columns {have or 'none of them'}: what is needed is one of {lists}"
    raise ValueError(f"{table.source}: {found}; {_named(table, near.needs)}")


def _fitting(table: Table, needs: Sequence[str]) -> float:
    """Share of some quantities that a file may have, from the units of its columns."""
    free, count = [cells.name_and_unit(text)[1] or "?" for text in table.header], 0
    for name in needs:
        fits = next((unit for unit in free if recognised(unit, UNITS[name])), None)
        count += name in table.numbers or fits is not None
        free = [unit for unit in free if unit is not fits]
    return count / len(needs)


def _named(table: Table, needs: Sequence[str]) -> str:
    """List the columns of a file as written, and what to write in [columns] for the quantities that are missing."""
    guesses = {text: cells.loosely(text, UNITS) for text in table.header}
    taken = [text for text, guess in guesses.items() if guess is not None and guess[0] in table.numbers]
    used, lines = list(taken), list[str]()
    for name in needs:
        if name not in table.numbers:
            column, line = cells.mapping(name, table.header, UNITS[name], used)
            used.append(column)
            lines += [line] if column else []
    has = f"the file has the columns {listed(table.header)}"
    if all(map(is_number, table.header)):
        has = f"the first line, {listed(table.header)}, has numbers; write the names of the columns above it"
    near = {text: cells.nearest(text, needs) for text in table.header if text not in taken}
    meant = [f"did you mean {name} for {text!r}?" for text, name in near.items() if name and name not in table.numbers]
    such = [f"name foreign ones in [columns], such as {'; '.join(lines)}"] if lines else []
    angles = [
        text for text in table.header if recognised(cells.name_and_unit(text)[1] or "?", [*UNITS["angle"], "count"])
    ]
    both = (
        "of two encoders, the error is the angle of the output less that of the input over the ratio, in a new column"
    )
    formed = [both] if "error" in needs and "error" not in table.numbers and len(angles) > 1 else []
    return "; ".join([has, *meant, *such, *formed, *guessed(table.notes)])


def _groups(table: Table) -> list[tuple[Conditions, np.ndarray]]:
    """Rows of equal conditions, in the order in which these appear."""
    n = len(table.rows)
    unit = table.words.get("unit", [""] * n)
    words = table.words.get("direction", [""] * n)
    direction, stated = [_WAYS.get(word.casefold(), word) for word in words], any(words)
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
