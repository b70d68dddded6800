"""Tables as files that controllers and simulators read: CSV, JSON, Modelica, MJCF, Structured Text.

Every number has 17 significant digits, a point and an exponent: it is read back with all its bits, and an
IEC 61131-3 compiler takes it for a real number.
"""

import csv
import dataclasses
import io
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rvjax.base.files import versions, write_atomically
from rvjax.compensation.table import Table

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


def _join(numbers: np.ndarray, between: str) -> str:
    return between.join(_digits(number) for number in numbers)


def _write_csv(table: Table, joint: Joint, seed: int | None) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    rows.writerows(map(_digits, row) for row in zip(table.angle, table.correction))
    return text.getvalue()


def _read_csv(text: str) -> Parsed:
    rows = [row for row in csv.reader(io.StringIO(text)) if row]
    if tuple(rows[0]) != COLUMNS:
        raise ValueError(f"its first line must be {','.join(COLUMNS)}")
    return [float(row[0]) for row in rows[1:]], [float(row[1]) for row in rows[1:]], {}


def _write_json(table: Table, joint: Joint, seed: int | None) -> str:
    numbers = "[{}]"
    about = {
        "unit": "rad",
        "name": table.name,
        "ratio": table.ratio if math.isfinite(table.ratio) else None,
        "orders": list(table.orders),
        "error_bound": table.error_bound if math.isfinite(table.error_bound) else None,
        "seed": seed,
        "versions": versions(),
    }
    lines = [f' "{key}": {json.dumps(value)},' for key, value in about.items()]
    lines += [f' "angle": {numbers.format(_join(table.angle, ", "))},']
    lines += [f' "correction": {numbers.format(_join(table.correction, ", "))}']
    return "\n".join(["{", *lines, "}", ""])


def _read_json(text: str) -> Parsed:
    given = json.loads(text)
    if given["unit"] != "rad":
        raise ValueError(f"unit = {given['unit']!r}: must be rad")
    about = {key: math.nan if given[key] is None else float(given[key]) for key in ("ratio", "error_bound")}
    return given["angle"], given["correction"], about | {"name": given["name"], "orders": tuple(given["orders"])}


def _write_modelica(table: Table, joint: Joint, seed: int | None) -> str:
    rows = [f"{_digits(angle)} {_digits(value)}" for angle, value in zip(table.angle, table.correction)]
    return "\n".join(["#1", f"double {table.name}({len(rows)},2)", *rows, ""])


def _read_modelica(text: str) -> Parsed:
    first, head, *rows = text.splitlines()
    found = re.fullmatch(r"double (\w+)\((\d+),2\)", head.strip())
    if first.strip() != "#1" or found is None:
        raise ValueError("its first lines must be #1 and double NAME(N,2)")
    pairs = [tuple(map(float, row.split())) for row in rows if row.strip()]
    if len(pairs) != int(found[2]) or any(len(pair) != 2 for pair in pairs):
        raise ValueError(f"there must be {found[2]} rows of two numbers")
    return [pair[0] for pair in pairs], [pair[1] for pair in pairs], {"name": found[1]}


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
    found = {item.get("name", ""): item for item in ElementTree.fromstring(text).iter("numeric")}
    names = [name for name in found if f"{name}_angle" in found]
    if len(names) != 1:
        raise ValueError("there must be two numerics NAME and NAME_angle")
    angle, correction = ([float(x) for x in found[n].get("data", "").split()] for n in (f"{names[0]}_angle", names[0]))
    return angle, correction, {"name": names[0]}


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
    names = [name for name in arrays if f"{name}_angle" in arrays]
    if len(names) != 1:
        raise ValueError("there must be two arrays NAME and NAME_angle")
    return arrays[f"{names[0]}_angle"], arrays[names[0]], {"name": names[0]}


FORMS: dict[str, Form] = {
    ".csv": (_write_csv, _read_csv),
    ".json": (_write_json, _read_json),
    ".txt": (_write_modelica, _read_modelica),
    ".xml": (_write_mjcf, _read_mjcf),
    ".st": (_write_structured_text, _read_structured_text),
}
"""Writer and reader of each file name ending."""
