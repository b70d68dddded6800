"""Cells of tables: numbers with an SI unit, and columns, which turn a cell into one text and into numbers.

None is the cell of a number that does not exist.
"""

import dataclasses
import math
import re
from dataclasses import dataclass
from typing import Any

from rvjax.base.frames import Interval as Estimate
from rvjax.records import Scalar
from rvjax.units import readable


@dataclass(frozen=True)
class Quantity:
    """A number with its unit, and its interval if it has one.

    Attributes:
        value: SI; NaN where there is none.
        unit: SI unit, "-" for a plain number.
        lower: lower end of the interval, SI; None without one.
        upper: upper end, SI.
        read_in: unit in which a person reads it, "%" for a share; None: the usual one of `unit`.
        form: format of its numbers; None: that of the column.
    """

    value: float
    unit: str = "-"
    lower: float | None = None
    upper: float | None = None
    read_in: str | None = None
    form: str | None = None

    @classmethod
    def of(cls, estimate: Estimate, unit: str = "-", read_in: str | None = None, form: str | None = None) -> "Quantity":
        """The quantity of an estimate: anything with value, lower and upper.

        Args:
            estimate: numbers in SI.
            unit: SI unit.
            read_in: unit in which a person reads it; None: the usual one.
            form: format of its numbers; None: that of the column.
        """
        return cls(float(estimate.value), unit, float(estimate.lower), float(estimate.upper), read_in, form)

    @property
    def shown(self) -> tuple[str, float]:
        """Name and SI size of the unit in which a person reads the quantity; the name is "" for a plain number."""
        name, size = ("%", 0.01) if self.read_in == "%" else readable(self.unit, self.read_in)
        return ("" if name == "-" else name), size

    def numbers(self) -> list[float | None]:
        """Value, lower end and upper end in the shown unit; None if not finite."""
        size = 1.0 if self.read_in == "%" else self.shown[1]  # a share is a part of one in files
        return [number(x, size) for x in (self.value, self.lower, self.upper)]

    def text(self, form: str = ".4g", *, named: bool = True) -> str:
        """The number in the unit that is read, with the interval in brackets; "-" where there is no number.

        Args:
            form: format of each number.
            named: with the name of the unit.
        """
        if math.isnan(self.value):
            return "-"
        (name, size), form = self.shown, self.form or form
        said = f"{self.value / size:{form}}" + (f" {name}" if name and named else "")
        if self.lower is None or self.upper is None:
            return said
        return f"{said} [{self.lower / size:{form}}, {self.upper / size:{form}}]"


@dataclass(frozen=True)
class Zone(Quantity):
    """Limits of an error, and how a drawing states them.

    Attributes:
        value: mid-point of the limits, SI.
        unit: SI unit.
        lower: lower limit, SI.
        upper: upper limit, SI.
        read_in: unit in which a person reads it; None: the usual one.
        form: format of its numbers; not used.
        stated: words of a drawing before its number, such as "runout"; "" for limits.
        drawn: number of the drawing, SI; None for limits.
    """

    stated: str = ""
    drawn: float | None = None

    def text(self, form: str = ".2f", *, named: bool = True) -> str:
        """As a drawing states it: "runout 7.5 um", "+-3.00 um" or "8.00 +-4.00 um".

        Args:
            form: format of limits.
            named: with the name of the unit.
        """
        assert self.lower is not None and self.upper is not None
        name, size = self.shown
        unit = f" {name}" if named else ""
        if self.drawn is not None and self.stated:
            found = self.drawn / size
            return f"{self.stated} {found:{'.1f' if found >= 1 else '.2g'}}{unit}"
        middle, half = (self.upper + self.lower) / 2 / size, (self.upper - self.lower) / 2 / size
        about = "" if abs(middle) < 1e-9 * abs(half) else f"{middle:{form}} "
        return f"{about}+-{half:{form}}{unit}"


def micro(text: str) -> str:
    """Text with the sign of a micrometre and a microsecond, as pages and plots write it.

    Args:
        text: with "um" or "us".
    """
    return re.sub(r"(?<![A-Za-z])u(?=[ms]\b)", "µ", text)


def number(value: Scalar | None, size: float = 1.0) -> float | None:
    """Number with ten digits in a unit; None if it is not finite.

    Args:
        value: SI; None stays.
        size: of the unit, SI.
    """
    if value is None:
        return None
    found = float(value) / size
    return float(f"{found:.10g}") if math.isfinite(found) else None


TEXT, CSV, PAGE = "text", "csv", "page"
EVERYWHERE = frozenset((TEXT, CSV, PAGE))
"""Media of a report: the terminal, a file of numbers, the HTML page."""

Value = str | float | None
Cell = Any  # what the column of the cell can show: words, numbers, quantities, pairs of these


@dataclass(frozen=True)
class Column:
    """A column of any values: words, numbers as they are, quantities.

    Attributes:
        title: header.
        missing: text of a cell without a value.
        on: where the column is shown.
        file_title: header in the CSV file; None: the title.
        wraps: cells are prose: page and terminal may break them into lines.
        narrow: characters to which other cells may be broken where a table is too wide; 0: they may not.
    """

    title: str
    missing: str = "-"
    on: frozenset[str] = EVERYWHERE
    file_title: str | None = None
    wraps: bool = False
    narrow: int = 0

    def text(self, cell: object) -> str:
        """Text of the cell; words are not changed, also in a column of numbers."""
        if isinstance(cell, str):
            return cell
        return self.missing if cell is None else self._said(cell)

    def headers(self) -> list[str]:
        """Headers in a CSV file."""
        return [self.title if self.file_title is None else self.file_title]

    def values(self, cell: object) -> list[Value]:
        """The cell in a CSV file, a value for each header."""
        return [None] * len(self.headers()) if cell is None or cell == "" else self._given(cell)

    def _said(self, cell: Cell) -> str:
        return cell.text() if isinstance(cell, Quantity) else str(cell)

    def _given(self, cell: Cell) -> list[Value]:
        return list(cell.numbers()[:1]) if isinstance(cell, Quantity) else [cell]


class Titled(str):
    """A word with a remark, which the page shows in small letters below it."""

    remark: str

    def __new__(cls, word: str, remark: str) -> "Titled":
        """A word and its remark."""
        made = super().__new__(cls, word)
        made.remark = remark
        return made


@dataclass(frozen=True)
class Text(Column):
    """A column of words."""


@dataclass(frozen=True)
class Number(Column):
    """A column of numbers in SI with one `unit`, read in `read_in` and written as `form`; or of quantities.

    The text of a plain number has no unit: the title names it. Quantities have theirs unless `named` is False.
    """

    form: str = ".4g"
    unit: str = "-"
    read_in: str | None = None
    named: bool = True

    def _quantity(self, cell: Cell) -> Quantity:
        return cell if isinstance(cell, Quantity) else Quantity(float(cell), self.unit, read_in=self.read_in)

    def _said(self, cell: Cell) -> str:
        return self._quantity(cell).text(self.form, named=self.named and isinstance(cell, Quantity))

    def _given(self, cell: Cell) -> list[Value]:
        if self.unit == "-" and not isinstance(cell, Quantity):  # nothing to convert: all digits
            return [float(cell) if math.isfinite(cell) else None]
        return list(self._quantity(cell).numbers()[:1])


@dataclass(frozen=True)
class Share(Number):
    """A column of shares: parts of one in SI and in a file, percent in the text."""

    form: str = ".1f"

    def _said(self, cell: Cell) -> str:
        return f"{100 * float(cell):{self.form}} %"


@dataclass(frozen=True)
class Interval(Number):
    """A column of quantities with intervals: value, lower end and upper end in a file.

    `ends` are the formats of the headers of both ends in the file.
    """

    ends: tuple[str, str] = ("{}, lower end", "{}, upper end")

    def headers(self) -> list[str]:
        """Headers in a CSV file."""
        (title,) = super().headers()
        return [title, *(end.format(title) for end in self.ends)]

    def _said(self, cell: object) -> str:
        return self._quantity(cell).text(self.form, named=self.named)

    def _given(self, cell: object) -> list[Value]:
        return list(self._quantity(cell).numbers())


@dataclass(frozen=True)
class Limits(Column):
    """A column of limits of errors (`Zone`); in a file both ends, and the number of the drawing where it has one."""

    narrow: int = 18  # the words of a drawing and its number may be on two lines

    def headers(self) -> list[str]:
        """Headers in a CSV file."""
        return [f"{part} {self.title}" for part in ("lower", "upper", "drawing")]

    def _given(self, cell: Zone) -> list[Value]:
        return [*cell.numbers()[1:], number(cell.drawn, cell.shown[1])]


def column(shown: Column, default: object = "") -> Any:
    """A field of a row record: a dataclass whose fields are the columns of a table.

    Args:
        shown: title, unit, digits.
        default: cell of a row without a value.
    """
    return dataclasses.field(default=default, metadata={"column": shown})
