"""Corrections for a controller: equal steps over one output turn, or over torque and direction too, and files of them.

A part of the error grows with the load, and the directions differ. Controllers and simulators read CSV, JSON, Modelica,
MJCF and Structured Text. Every number has 17 significant digits, a point and an exponent: it is read back with all its
bits, and an IEC 61131-3 compiler takes it for a real number.
"""

import csv
import dataclasses
import io
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.files import versions, write_atomically
from rvjax.base.words import choose
from rvjax.compensation.correction import Correction, rated, saved_by

SIDES = ("input", "output")


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """Rows of angle and correction; the last row is the first row, one turn later.

    Attributes:
        angle: of the output, rad, 0 to 2 pi (points + 1,).
        correction: added at the side chosen, rad (points + 1,).
        error_bound: largest error of linear interpolation, rad at that side; nan where a file does not hold it.
        name: in files.
        ratio: input turns per output turn; nan where a file does not hold it.
        orders: stored, per output turn; empty where a file does not hold them.
    """

    angle: np.ndarray
    correction: np.ndarray
    error_bound: float
    name: str = "te_correction"
    ratio: float = math.nan
    orders: tuple[int, ...] = ()


@checked
def table(correction: Correction, points: int = 720, *, side: str = "input") -> Table:
    """Sample a correction.

    Between rows, order k of a line is wrong by at most |v_k| (1 - cos(pi k/points)).

    Args:
        correction: of one unit.
        points: equal steps of the output angle; the row at 2 pi comes on top.
        side: "input" (times the ratio) or "output".

    Raises:
        ValueError: fewer than 2 max(order) + 1 points, or an unknown side.
    """
    least = 2 * int(correction.order.max(initial=0)) + 1
    if points < least:
        raise ValueError(f"points = {points!r}: must be at least {least}, twice the highest order and one")
    choose("side", side, SIDES)
    factor = correction.ratio if side == "input" else 1.0
    # An order turns by 2 pi k i/points; k i is reduced to one turn in integers, so that no digit is lost.
    steps = np.arange(points)
    phase = 2 * math.pi / points * ((correction.order[:, None] * steps) % points)
    value = correction.value[:, None]
    rows = factor * np.sum(value.imag * np.sin(phase) - value.real * np.cos(phase), axis=0)
    bound = np.sum(np.abs(correction.value) * 2 * np.sin(math.pi * correction.order / (2 * points)) ** 2)
    return Table(
        angle=np.append(2 * math.pi / points * steps, 2 * math.pi),
        correction=np.append(rows, rows[0]),
        error_bound=abs(factor) * float(bound),
        ratio=correction.ratio,
        orders=tuple(correction.order.tolist()),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Schedule:
    """Corrections measured at some torques in some directions.

    Attributes:
        corrections: {direction: ((torque in N m, correction), ...)}, torques ascending.
    """

    corrections: dict[Hashable, tuple[tuple[float, Correction], ...]]

    def at(self, torque: float, direction: Hashable) -> Correction:
        """The correction at a load: linear in the torque for each complex order, held beyond the measured torques.

        Args:
            torque: N m.
            direction: as given; nothing is taken from another one.

        Raises:
            ValueError: a direction that was not measured, or a torque that is not finite.
        """
        if direction not in self.corrections:
            known = ", ".join(map(repr, self.corrections))
            raise ValueError(f"direction = {direction!r}: must be measured; measured are {known}")
        if not math.isfinite(torque):
            raise ValueError(f"torque = {torque!r} N m: must be finite")
        measured = self.corrections[direction]
        torques = [at for at, _ in measured]
        if torque <= torques[0]:
            return measured[0][1]
        if torque >= torques[-1]:
            return measured[-1][1]
        above = int(np.searchsorted(torques, torque))
        (low, first), (high, second) = measured[above - 1], measured[above]
        return _between(first, second, (torque - low) / (high - low))


def _between(first: Correction, second: Correction, share: float) -> Correction:
    """Weighted mean of two measurements with independent errors. An order that one of them lacks is 0 there."""
    order = np.union1d(first.given_order, second.given_order)
    value, stored, variance = np.zeros(len(order), complex), np.zeros(len(order), complex), np.zeros(len(order))
    for weight, side in ((1 - share, first), (share, second)):
        place = np.searchsorted(order, side.given_order)
        value[place] += weight * side.given_value
        stored[place] += weight * side.stored
        variance[place] += (weight * side.sd) ** 2
    angle_sd = max(first.angle_sd, second.angle_sd)
    chosen = np.flatnonzero(np.isin(order, np.union1d(first.order, second.order)))
    saved = saved_by(value, stored, order, angle_sd)
    return rated(order, value, stored, np.sqrt(variance), angle_sd, first.ratio, chosen, saved)


@checked
def schedule(corrections: Mapping[tuple[float, Hashable], Correction]) -> Schedule:
    """Corrections by torque and direction.

    Args:
        corrections: {(torque in N m, direction): correction}; a direction is any name or sign.

    Raises:
        ValueError: none at all, a torque that is not finite, or different ratios.
    """
    if not corrections:
        raise ValueError("corrections: must hold at least one")
    for key, correction in corrections.items():
        if not isinstance(correction, Correction):
            raise ValueError(f"corrections: {key!r} = {correction!r}: must be a Correction")
    ratios = {correction.ratio for correction in corrections.values()}
    if len(ratios) > 1:
        raise ValueError(f"ratio: corrections must have one ratio, not {', '.join(f'{r:g}' for r in sorted(ratios))}")
    by_direction: dict[Hashable, list[tuple[float, Correction]]] = {}
    for (torque, direction), correction in corrections.items():
        if not math.isfinite(torque):
            raise ValueError(f"torque = {torque!r} N m: must be finite")
        by_direction.setdefault(direction, []).append((float(torque), correction))
    return Schedule({direction: tuple(sorted(all_, key=lambda x: x[0])) for direction, all_ in by_direction.items()})


COLUMNS = ("angle [rad]", "correction [rad]")
JOINT = ("stiffness", "damping", "frictionloss")
NUMBER = r"[-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?"

Joint = Mapping[str, float]
Parsed = tuple[list[float], list[float], dict[str, Any]]
Form = tuple[Callable[[Table, Joint, int | None], str], Callable[[str], Parsed]]


def export(table: Table, path: str | Path, *, joint: Joint | None = None, seed: int | None = None) -> None:
    """Write a table; the ending chooses the form.

    .csv: two columns. .json: the same with unit, ratio, orders, seed and versions. .txt: text of a Modelica CombiTable;
    extrapolate periodically. .xml: MJCF, which holds the numbers for a controller to use. .st: Structured Text.

    Args:
        table: to write.
        path: ends with .csv, .json, .txt, .xml or .st.
        joint: stiffness (N m/rad), damping (N m s/rad) and frictionloss (N m) of an identified unit; .xml alone holds
            them, as the class of joints named like the table.
        seed: of the numbers behind the table; .json alone holds it.

    Raises:
        ValueError: another ending, a table that is not finite, a name that is no identifier, or an unknown key of
            `joint`.
        OSError: it cannot be written.
    """
    _form(path)
    write_atomically(Path(path), exported(table, Path(path).suffix, joint=joint, seed=seed))


def exported(table: Table, ending: str, *, joint: Joint | None = None, seed: int | None = None) -> bytes:
    """Return the content of the file that `export` writes.

    Args:
        table: to write.
        ending: of the file, one of `FORMS`.
        joint: as in `export`.
        seed: as in `export`.
    """
    write, _ = FORMS[ending]
    if not (np.isfinite(table.angle).all() and np.isfinite(table.correction).all()):
        raise ValueError("table: holds a number that is not finite")
    if not re.fullmatch(r"[A-Za-z]\w*", table.name, re.ASCII):
        raise ValueError(f"name = {table.name!r}: must be letters, digits and underscores")
    for key, number in (joint or {}).items():
        if key not in JOINT or not math.isfinite(number):
            raise ValueError(f"joint[{key!r}] = {number!r}: must be a finite number of {', '.join(JOINT)}")
    return write(table, joint or {}, seed).encode()


def read(path: str | Path) -> Table:
    """Return the table in a file of `export`, bit for bit.

    Raises:
        ValueError: another ending, or a file that holds no such table.
        OSError: it cannot be read.
    """
    _, parse = _form(path)
    try:
        angle, correction, about = parse(Path(path).read_text("utf-8"))
        columns = np.array(angle, float), np.array(correction, float)
        if len(columns[0]) != len(columns[1]) or len(columns[0]) < 2:
            raise ValueError(f"{len(columns[0])} angles and {len(columns[1])} corrections")
        if not np.isfinite(columns).all():
            raise ValueError("holds a number that is not finite")
    except (ValueError, KeyError, TypeError, IndexError, ElementTree.ParseError, RecursionError) as error:
        raise ValueError(f"{path}: holds no table of a correction ({' '.join(str(error).split())})") from None
    return dataclasses.replace(Table(*columns, error_bound=math.nan), **about)


def _form(path: str | Path) -> Form:
    ending = Path(path).suffix
    if ending not in FORMS:
        raise ValueError(f"{path}: must end with one of {', '.join(FORMS)}")
    return FORMS[ending]


def _digits(number: float) -> str:
    return f"{float(number):.16e}"


def _join(numbers: Iterable[float], between: str) -> str:
    return between.join(_digits(number) for number in numbers)


def _rows(table: Table, between: str) -> list[str]:
    """A line for each angle with its correction."""
    return [_join(pair, between) for pair in zip(table.angle, table.correction)]


def _write_csv(table: Table, joint: Joint, seed: int | None) -> str:
    return "\n".join([",".join(COLUMNS), *_rows(table, ","), ""])


def _read_csv(text: str) -> Parsed:
    rows = [row for row in csv.reader(io.StringIO(text)) if row]
    if tuple(rows[0]) != COLUMNS:
        raise ValueError(f"its first line must be {','.join(COLUMNS)}")
    return [float(row[0]) for row in rows[1:]], [float(row[1]) for row in rows[1:]], {}


def _write_json(table: Table, joint: Joint, seed: int | None) -> str:
    ratio, bound = (number if math.isfinite(number) else None for number in (table.ratio, table.error_bound))
    about: dict[str, object] = {"unit": "rad", "name": table.name, "ratio": ratio, "orders": list(table.orders)}
    about |= {"error_bound": bound, "seed": seed, "versions": versions()}
    lines = [f' "{key}": {json.dumps(value)},' for key, value in about.items()]
    angle, correction = (_join(numbers, ", ") for numbers in (table.angle, table.correction))
    lines += [f' "angle": [{angle}],', f' "correction": [{correction}]']
    return "\n".join(["{", *lines, "}", ""])


def _read_json(text: str) -> Parsed:
    given = json.loads(text)
    if given["unit"] != "rad":
        raise ValueError(f"unit = {given['unit']!r}: must be rad")
    about = {key: math.nan if given[key] is None else float(given[key]) for key in ("ratio", "error_bound")}
    return given["angle"], given["correction"], about | {"name": given["name"], "orders": tuple(given["orders"])}


def _write_modelica(table: Table, joint: Joint, seed: int | None) -> str:
    rows = _rows(table, " ")
    return "\n".join(["#1", f"double {table.name}({len(rows)},2)", *rows, ""])


def _read_modelica(text: str) -> Parsed:
    first, head, *rows = text.splitlines()
    match = re.fullmatch(r"double (\w+)\((\d+),2\)", head.strip())
    if first.strip() != "#1" or match is None:
        raise ValueError("its first lines must be #1 and double NAME(N,2)")
    pairs = [tuple(map(float, row.split())) for row in rows if row.strip()]
    if len(pairs) != int(match[2]) or any(len(pair) != 2 for pair in pairs):
        raise ValueError(f"there must be {match[2]} rows of two numbers")
    return [pair[0] for pair in pairs], [pair[1] for pair in pairs], {"name": match[1]}


def _write_mjcf(table: Table, joint: Joint, seed: int | None) -> str:
    root = ElementTree.Element("mujoco", model=table.name)
    if joint:  # a separate class: other joints of the model stay unchanged
        outer = ElementTree.SubElement(root, "default")
        own = ElementTree.SubElement(outer, "default", {"class": table.name})
        ElementTree.SubElement(own, "joint", {key: _digits(joint[key]) for key in JOINT if key in joint})
    custom = ElementTree.SubElement(root, "custom")
    for name, numbers in ((f"{table.name}_angle", table.angle), (table.name, table.correction)):
        data = _join(numbers, " ")
        ElementTree.SubElement(custom, "numeric", name=name, size=str(len(numbers)), data=data)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _read_mjcf(text: str) -> Parsed:
    arrays = {}
    for item in ElementTree.fromstring(text).iter("numeric"):
        arrays[item.get("name", "")] = [float(x) for x in item.get("data", "").split()]
    return _named(arrays, "numerics")


def _named(arrays: Mapping[str, list[float]], what: str) -> Parsed:
    """The table of two arrays NAME and NAME_angle."""
    names = [name for name in arrays if f"{name}_angle" in arrays]
    if len(names) != 1:
        raise ValueError(f"there must be two {what} NAME and NAME_angle")
    return arrays[f"{names[0]}_angle"], arrays[names[0]], {"name": names[0]}


def _write_structured_text(table: Table, joint: Joint, seed: int | None) -> str:
    lines = ["VAR_GLOBAL CONSTANT"]
    for name, numbers in ((f"{table.name}_angle", table.angle), (table.name, table.correction)):
        values = _join(numbers, ",\n        ")
        lines.append(f"    {name} : ARRAY[0..{len(numbers) - 1}] OF LREAL := [\n        {values}];")
    return "\n".join([*lines, "END_VAR", ""])


def _read_structured_text(text: str) -> Parsed:
    arrays: dict[str, list[float]] = {}
    for name, last, numbers in re.findall(r"(\w+)\s*:\s*ARRAY\[0\.\.(\d+)\] OF LREAL := \[([^\]]*)\];", text):
        parts = [part.strip() for part in numbers.split(",")]
        if len(parts) != int(last) + 1 or not all(re.fullmatch(NUMBER, part) for part in parts):
            raise ValueError(f"{name}: must hold {int(last) + 1} numbers")
        arrays[name] = [float(part) for part in parts]
    return _named(arrays, "arrays")


FORMS: dict[str, Form] = {
    ".csv": (_write_csv, _read_csv),
    ".json": (_write_json, _read_json),
    ".txt": (_write_modelica, _read_modelica),
    ".xml": (_write_mjcf, _read_mjcf),
    ".st": (_write_structured_text, _read_structured_text),
}
"""Writer and reader of each file name ending."""
