"""Columns of a measured table: a CSV file with headers "name [unit]", read to SI."""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from rvjax._ground.choices import unknown
from rvjax.units import spelling

Units = Mapping[str, Mapping[str, float]]
"""By quantity: what it may be written in, with its size in SI."""

DELIMITERS = ";\t,"
LARGEST, SMALLEST = 1e12, 1e-100  # in any unit: beyond every size of a part, below every rounding error of a zero


@dataclass(frozen=True)
class Table:
    """A measured table.

    Attributes:
        source: name of the file, for messages.
        rows: line of each row in the file, (n,).
        numbers: {quantity: values in SI (n,)}; NaN where a cell is empty.
        words: {name: texts (n,)}.
        shown: {quantity: unit that the file is written in}.
        digits: {quantity: one unit of the last digit that is written, SI}.
    """

    source: str
    rows: np.ndarray
    numbers: dict[str, np.ndarray]
    words: dict[str, list[str]]
    shown: dict[str, str]
    digits: dict[str, float]


def read_table(
    path: str | Path, columns: Mapping[str, object] | None = None, *, units: Units, words: Sequence[str] = ()
) -> Table:
    """A table from a CSV file; commas, semicolons or tabs between the cells, decimal commas where no comma separates.

    Args:
        path: the file; a byte order mark is skipped.
        columns: foreign names by quantity: the header of the column, or {column, unit} where it has no unit.
        units: quantities that are wanted, each with its units.
        words: columns of text that are wanted.

    Raises:
        ValueError: one line that names the file, the column or the row, its value and the unit.
        FileNotFoundError: there is no such file.
    """
    header, body, comma = read_cells(path)
    places = _places(str(path), header, columns or {}, units, words)
    numbers, texts, shown, digits = {}, {}, {}, {}
    for name, (column, unit) in places.items():
        taken = [(number, row[column].strip()) for number, row in body]
        if name in words:
            texts[name] = [cell for _, cell in taken]
        else:
            size = units[name][unit]
            numbers[name] = np.array([number_of(str(path), name, unit, *cell, comma) * size for cell in taken])
            shown[name], digits[name] = unit, _last_digit([cell for _, cell in taken], comma) * size
    return Table(str(path), np.array([number for number, _ in body]), numbers, texts, shown, digits)


def _last_digit(cells: Sequence[str], comma: bool) -> float:
    """One unit of the last digit, in the unit of the cells, which `number_of` has read; inf without a number."""
    parts = [cell.replace(",", ".").lower() if comma else cell.lower() for cell in cells]
    tens = [Decimal(cell).as_tuple().exponent for cell in parts if cell not in ("", "nan")]
    return min((10.0**place for place in tens if isinstance(place, int)), default=math.inf)


def read_cells(
    path: str | Path, example: str = "angle [deg],error [arcsec]", *, short: bool = False
) -> tuple[list[str], list[tuple[int, list[str]]], bool]:
    """Header, rows (line of the file, cells), and whether a cell may have a decimal comma.

    Args:
        path: of the file.
        example: of a header, for the message.
        short: rows may lack their last cells, which are empty.

    Raises:
        ValueError: no table.
        FileNotFoundError: there is no such file.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such data file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text ({error}); save it as UTF-8") from None
    lines = text.splitlines()
    first = next((k for k, line in enumerate(lines) if line.strip()), None)
    if first is None or "\0" in text:
        raise ValueError(f'{path}: no table; the first line must name the columns, such as "{example}"')
    delimiter = max(DELIMITERS, key=lines[first].count)
    try:
        reader = csv.reader(io.StringIO(text), delimiter=delimiter, strict=True)
        cells = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise ValueError(f"{path}: not a table of cells between {delimiter!r} ({error})") from None
    header, body = [name.strip() for name in cells[0][1]], cells[1:]
    for number, row in body:
        row += [""] * (len(header) - len(row) if short else 0)
        if len(row) != len(header):
            hint = " (decimal commas? then separate cells by semicolons)" if delimiter == "," else ""
            raise ValueError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}{hint}")
    if not body:
        raise ValueError(f"{path}: no rows under the header {delimiter.join(header)!r}")
    return header, body, delimiter != ","


def _places(
    source: str, header: Sequence[str], columns: Mapping[str, object], units: Units, words: Sequence[str]
) -> dict[str, tuple[int, str]]:
    """{quantity: (column, unit)}."""
    found: dict[str, tuple[int, str]] = {}
    foreign: dict[int, tuple[str, str | None]] = {}
    for name, about in columns.items():
        if name not in units and name not in words:
            raise unknown(f"unknown key columns.{name}", name, sorted([*units, *words]), "; known here:")
        given = about if isinstance(about, dict) else {"column": about}
        if not isinstance(given.get("column"), str) or not set(given) <= {"column", "unit"}:
            raise ValueError(
                f'columns.{name} = {about!r}: must be the header of a column, or {{column = "", unit = ""}}'
            )
        matches = [k for k, text in enumerate(header) if given["column"] in (text, split(text)[0])]
        if len(matches) != 1:
            why = "no column of the file" if not matches else f"the header of {len(matches)} columns"
            raise ValueError(f"{source}: columns.{name} = {given['column']!r}: {why}; it has {', '.join(header)}")
        unit = given.get("unit")
        foreign[matches[0]] = (name, None if unit is None else str(unit))
    for k, text in enumerate(header):
        name, unit = split(text)
        name, unit = (foreign[k][0], foreign[k][1] or unit) if k in foreign else (name.lower(), unit)
        if name not in units and name not in words:
            continue  # a column that is not required
        if k not in foreign and name in [taken for taken, _ in foreign.values()]:
            continue  # [columns] names another column for this quantity
        if name in found:
            raise ValueError(f"{source}: column {text!r}: {name} is in two columns")
        unit = spelling(unit) if unit else unit
        if name in units and unit not in units[name]:
            said = "has no unit" if not unit else f"unit {unit!r} is not known"
            example = next(iter(units[name]))
            raise ValueError(
                f'{source}: column {text!r}: {said}; write "{name} [{example}]" ({", ".join(units[name])})'
            )
        found[name] = (k, unit or "")
    return found


def element(field: str, place: Sequence[int]) -> str:
    """Return the name of an element of an error, such as "disc_bore[0,1]"; the field itself without a place.

    Args:
        field: name.
        place: index along each axis.
    """
    return f"{field}[{','.join(map(str, place))}]" if len(place) else field


def elements(field: str, shape: tuple[int, ...]) -> list[str]:
    """Names of all elements of an error in C order.

    Args:
        field: name.
        shape: of the error.
    """
    return [element(field, place) for place in np.ndindex(shape)]


def place_of(name: str) -> tuple[str, tuple[int, ...]]:
    """Field and place of the name of an element; "disc_bore[0][1]" is read as "disc_bore[0,1]".

    Raises:
        ValueError: the name is no such name.
    """
    match = re.fullmatch(r"([\w.]+)((?:\[\d+(?:, ?\d+)*\])*)", name)
    if match is None:
        raise ValueError(f"{name!r}: must be the name of an error or of an element, such as disc_bore[0,1]")
    return match[1], tuple(map(int, re.findall(r"\d+", match[2])))


def split(header: str) -> tuple[str, str | None]:
    """Name and unit of "name [unit]"; the name may contain brackets."""
    match = re.fullmatch(r"(.*?)\s*\[\s*([^\[\]]*?)\s*\]", header)
    return (match[1], match[2]) if match else (header, None)


def number_of(source: str, name: str, unit: str, row: int, cell: str, comma: bool, *, missing: bool = True) -> float:
    """Return the number in a cell, in the unit of the cell; NaN for an empty one.

    Args:
        source: name of the file, for the message.
        name: of the quantity.
        unit: of the cell.
        row: line of the file.
        cell: text.
        comma: whether decimals may have a comma.
        missing: "nan" is a missing reading too, as an empty cell is.

    Raises:
        ValueError: no number, not finite, or larger or smaller than any number of a part.
    """
    text = (cell.replace(",", ".") if comma else cell).lower()
    if text == "" or (missing and text == "nan"):
        return math.nan
    where = f"{source}: row {row}, {name} = {cell[:40]!r}"
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{where}: must be a number in {unit}") from None
    digits = re.search("[1-9]", text.partition("e")[0])
    if math.isnan(value) or (math.isinf(value) and not digits):
        raise ValueError(f"{where}: must be finite, in {unit}; leave the cell empty if nothing was measured")
    if abs(value) > LARGEST:
        raise ValueError(f"{where}: too large, must be at most {LARGEST:g} {unit}; correct the number")
    if digits and abs(value) < SMALLEST:  # also one that is 0 in double precision
        raise ValueError(f"{where}: too small, must be 0 or at least {SMALLEST:g} {unit}; correct the number")
    return value
