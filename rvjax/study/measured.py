"""Measured data of a bench: runs of transmission error, hysteresis curves, natural frequencies. Without statistics.

Rows of equal unit, torque, direction and temperature are a run.

Columns of bench files: the columns of measured curves, loops and frequencies.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rvjax._ground import columns as cells
from rvjax._ground.columns import Table
from rvjax.study.branches import branches
from rvjax.units import KNOWN, deg, rpm

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
WORDS = ("direction", "unit")


def read_table(path: str | Path, columns: Mapping[str, object] | None = None) -> cells.Table:
    """A table that a bench has written; see `rvjax._ground.columns.read_table`."""
    return cells.read_table(path, columns, units=UNITS, words=WORDS)


DIRECTIONS = {"forward": 1, "backward": -1}
TURN = 359 * deg  # what a run has to cover; every sample represents the step before it
USUAL = {
    "angle": "deg",
    "error": "arcsec",
    "torque": "N m",
    "frequency": "Hz",
}  # units of the columns that must be there


@dataclass(frozen=True)
class Conditions:
    """Conditions of a measurement.

    Attributes:
        unit: name of the unit, "" where the file has no column for it.
        torque: N m, None where the file does not say.
        direction: "forward" or "backward".
        temperature: degC, None where the file does not say.
        speed: of the input, rad/s, None where the file does not say.
        stated: whether the file has directions; without them every run is forward.
    """

    unit: str = ""
    torque: float | None = None
    direction: str = "forward"
    temperature: float | None = None
    speed: float | None = None
    stated: bool = dataclasses.field(default=True, compare=False)

    @property
    def sign(self) -> int:
        """1 forward, -1 backward: load opposes motion, so it is the sign of the torque of the discs on the carrier."""
        return DIRECTIONS[self.direction]

    def text(self) -> str:
        """Text such as "412 N m forward, 25 degC"."""
        torque = "" if self.torque is None else f"{self.torque:g} N m "
        speed = "" if self.speed is None else f", {self.speed / rpm:g} r/min"
        return f"{torque}{self.direction}{speed}" + ("" if self.temperature is None else f", {self.temperature:g} degC")


@dataclass(frozen=True)
class Run:
    """Transmission error along a turn of the output.

    Attributes:
        source: name of the file.
        at: under which conditions.
        angle: of the output, ascending or descending without jumps, rad (n,).
        error: > 0: output ahead, rad (n,).
    """

    source: str
    at: Conditions
    angle: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class Loop:
    """Twist of the output under a torque that rises and falls, input held.

    Attributes:
        source: name of the file.
        at: under which conditions; torque is None.
        torque: of the bench on the output, a grid, N m (n,).
        midline: mean of the rising and the falling branch, rad (n,).
        width: falling less rising branch, rad (n,): friction and backlash.
        sd: of the midline, from the scatter about the branches, rad (n,).
        clipped: the torque sensor has hit its end; what lies there is cut off.
    """

    source: str
    at: Conditions
    torque: np.ndarray
    midline: np.ndarray
    width: np.ndarray
    sd: np.ndarray
    clipped: bool


@dataclass(frozen=True)
class Tones:
    """Natural frequencies of one unit.

    Attributes:
        source: name of the file.
        at: under which conditions; torque is None.
        frequency: ascending, Hz (n,).
        sd: Hz (n,), NaN where the file does not say.
    """

    source: str
    at: Conditions
    frequency: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True)
class Measured:
    """Everything measured, of one kind.

    Attributes:
        kind: "curve", "loop" or "frequencies".
        items: in the order of the files and rows.
    """

    kind: str
    items: tuple[Run | Loop | Tones, ...]

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
    items: list[Run | Loop | Tones] = []
    for path in paths:
        table = read_table(path, columns)
        held = _kind(table, kind)
        kinds.setdefault(held, str(path))
        if len(kinds) > 1:
            (first, one), (second, other) = kinds.items()
            raise ValueError(f"{other}: holds {second}, {one} holds {first}; identify them one after the other")
        for at, rows in _groups(table):
            items.append(KINDS[held].read(table, at, rows))
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


def _where(source: str, at: Conditions) -> str:
    unit = f"unit {at.unit!r}, " if at.unit else ""
    return f"{source}: {unit}run {at.text()}"


def _run(table: Table, at: Conditions, rows: np.ndarray) -> Run:
    angle, error = table.numbers["angle"][rows], table.numbers["error"][rows]
    kept = ~np.isnan(error)  # a missing reading is no sample; the gap that it leaves is checked with the orders
    for row, value in zip(table.rows[rows][kept], angle[kept]):
        if np.isnan(value):
            raise ValueError(f"{table.source}: row {row}, angle is empty: every sample needs its angle in deg")
    return Run(table.source, at, np.unwrap(angle[kept]), error[kept])


def checked(run: Run, finest: int) -> Run:
    """Check that a run determines the orders up to `finest` of the output revolution.

    Raises:
        ValueError: it covers less than 359 deg, turns back, or has a gap above half the finest order.
    """
    where, angle = _where(run.source, run.at), run.angle
    step = np.median(np.abs(np.diff(angle))) if len(angle) > 1 else 0.0
    if (covered := (np.ptp(angle) + step if len(angle) else 0.0) / deg) < TURN / deg:
        hint = "; a run needs one nominal torque" if len(angle) < 2 else ""
        raise ValueError(f"{where}: covers {covered:.6g} deg in {len(angle)} samples, needs at least 359 deg{hint}")
    falls = run.at.direction == "backward" and angle[-1] < angle[0]  # recorded in time, or sorted: both are read
    onward = -angle if falls else angle
    period = 360 * deg / finest
    back = np.max(np.maximum.accumulate(onward) - onward)
    if back > 0.1 * period:  # less is jitter of an encoder
        back_by = f"the angle turns back by {back / deg:.4g} deg"
        raise ValueError(f"{where}: {back_by}; a run goes one way, {run.at.direction}")
    order = np.argsort(angle, kind="stable")
    gap = np.max(np.diff(angle[order]))
    if gap > 0.5 * period:
        need = f"order {finest} needs at most {0.5 * period / deg:.4g} deg"
        raise ValueError(f"{where}: a gap of {gap / deg:.4g} deg in the angle; {need}")
    return replace(run, angle=angle[order], error=run.error[order])


def _loop(table: Table, at: Conditions, rows: np.ndarray) -> Loop:
    torque, angle = table.numbers["torque"][rows], table.numbers["angle"][rows]
    for name, values in (("torque", torque), ("angle", angle)):
        if np.any(np.isnan(values)):
            row = table.rows[rows][np.argmax(np.isnan(values))]
            raise ValueError(f"{table.source}: row {row}, {name} is empty: every sample of a loop needs both")
    unit = f"unit {at.unit!r}, " if at.unit else ""
    return Loop(table.source, at, *branches(f"{table.source}: {unit}loop", torque, angle))


def _tones(table: Table, at: Conditions, rows: np.ndarray) -> Tones:
    frequency = table.numbers["frequency"][rows]
    sd = table.numbers.get("sd", np.full(len(table.rows), np.nan))[rows]
    for name, values, bad in (("frequency", frequency, ~(frequency > 0)), ("sd", sd, sd <= 0)):
        if np.any(bad):
            k = int(np.argmax(bad))
            where = f"{table.source}: row {table.rows[rows][k]}, {name} = {values[k]:g}"
            raise ValueError(f"{where}: must be positive, in {table.shown[name]}")
    order = np.argsort(frequency, kind="stable")
    return Tones(table.source, at, frequency[order], sd[order])


@dataclass(frozen=True)
class Kind:
    """A kind of data.

    Attributes:
        needs: columns.
        read: (table, conditions, rows) -> what was measured under these conditions.
        unit: SI unit of one reading.
        example: of its noise.
        nuisances: of the bench that it may have.
    """

    needs: tuple[str, ...]
    read: Callable[[Table, Conditions, np.ndarray], Run | Loop | Tones]
    unit: str
    example: str
    nuisances: tuple[str, ...]


KINDS = {
    "curve": Kind(
        ("angle", "error"),
        _run,
        "rad",
        "0.2 arcsec",
        ("offset", "mounting", "phase", "reading", "drag", "viscous_drag"),
    ),
    "loop": Kind(("torque", "angle"), _loop, "rad", "0.2 arcsec", ("offset", "drag")),
    "frequencies": Kind(("frequency",), _tones, "Hz", "1 Hz", ()),
}
"""Kinds of measurements, by the name that an `rvjax.outputs.Observation` gives it."""
