"""Quantities: numbers with an SI unit, and the text that a person reads of them."""

import math
import re
from dataclasses import dataclass

from rvjax.base.frames import Interval
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
    def of(cls, estimate: Interval, unit: str = "-", read_in: str | None = None, form: str | None = None) -> "Quantity":
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
