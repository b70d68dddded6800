"""Wide tables of curves, as in ISO 230-2: a row for each target, a column for each run in a direction."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rvjax.base import columns as cells
from rvjax.base.cells import listed
from rvjax.base.columns import Table, Units, name_and_unit

SIDES = {
    "forward": ("fwd", "forward", "forwards", "fw", "up", "positive", "↑"),
    "backward": ("bwd", "backward", "backwards", "bw", "back", "reverse", "rev", "down", "negative", "↓"),
}
"""Words for a run in a direction."""
TARGETS = {"target", "tgt", "nominal", "command", "commanded", "setpoint"}
_POSITION = {"angle", "angular", "position", "pos", "output"}
_OTHERS = {
    "error",
    "dev",
    "deviation",
    "actual",
    "measured",
    "run",
    "cycle",
    "te",
    "x",
    "value",
    "reading",
    "direction",
}
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
    path: str | Path,
    table: Table,
    columns: Mapping[str, object] | None,
    *,
    units: Units,
    words: Sequence[str],
    encoding: str | None = None,
) -> Table | None:
    """The long table of a wide one: angle, error, direction; None if the file is no wide table.

    A column holds positions, which are compared with the target, or deviations from it.

    Args:
        path: of the file.
        table: what was read of the file otherwise; its header names the columns.
        columns: foreign names; that of the angle is the target.
        units: of all quantities that a bench measures.
        words: columns of text.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: no single column of targets, a column without a unit, neither positions nor deviations.
    """
    header, given = table.header, dict(columns or {})
    runs = {k: side for k, text in enumerate(header) if (side := side_of(text)) is not None}
    targets = [k for k, text in enumerate(header) if is_target(text)]
    if not runs or not ("angle" in table.numbers or targets):
        return None
    if "angle" not in table.numbers and len(targets) > 1:
        both = listed([header[k] for k in targets])
        line = cells.mapping("angle", [header[targets[0]]], units["angle"])[1]
        raise ValueError(f"{path}: the target may be in {both}; write one in [columns]: {line}")
    at = {f"run {k}": k for k in runs}
    if "angle" not in table.numbers:
        at |= {"angle": targets[0]}
    for name, k in at.items():
        if name_and_unit(header[k])[1] is None:
            example = "deg" if name == "angle" else "arcsec"
            raise ValueError(f'{path}: column {header[k]!r}: has no unit; write "{header[k]} [{example}]"')
    others = {name: family for name, family in units.items() if name != "error"}
    kept = tuple(word for word in words if word != "direction")
    read = cells.read_table(
        path,
        given,
        units=others | {name: units["angle"] for name in at},
        words=kept,
        at=at,
        named=is_column,
        encoding=encoding,
    )
    target = read.numbers["angle"]
    values = np.stack([read.numbers[f"run {k}"] for k in runs], axis=1)
    errors, what = _errors(str(path), target, values)
    repeat = len(runs)
    numbers = {"angle": np.repeat(target, repeat), "error": errors.ravel()}
    numbers |= {n: np.repeat(v, repeat) for n, v in read.numbers.items() if n in units and n != "angle"}
    texts = {name: [cell for cell in own for _ in runs] for name, own in read.words.items()}
    texts |= {"direction": list(runs.values()) * len(target)}
    sides = "; ".join(
        f"{side}: {listed([header[k] for k in runs if runs[k] == side])}" for side in dict.fromkeys(runs.values())
    )
    first = next(iter(runs))
    shown = {n: u for n, u in read.shown.items() if n in units} | {"error": read.shown[f"run {first}"]}
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
