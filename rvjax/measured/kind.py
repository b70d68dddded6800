"""Kind of a bench file: its columns, how they are read, nuisances of the bench; conditions, runs and findings."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from rvjax.base.columns import Table
from rvjax.units import rpm

DIRECTIONS = {"forward": 1, "backward": -1}


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


def where(source: str, at: Conditions) -> str:
    """Name a run in a message.

    Args:
        source: name of the file.
        at: its conditions.
    """
    unit = f"unit {at.unit!r}, " if at.unit else ""
    return f"{source}: {unit}run {at.text()}"


@dataclass(frozen=True, eq=False)
class Run:
    """Transmission error along a turn of the output.

    Attributes:
        source: name of the file.
        at: under which conditions.
        angle: of the output, ascending or descending without jumps, rad (n,).
        error: > 0: output ahead, rad (n,).
        rows: lines of the file (n,); None where the run has none.
    """

    source: str
    at: Conditions
    angle: np.ndarray
    error: np.ndarray
    rows: np.ndarray | None = None

    @property
    def name(self) -> str:
        """File, unit and conditions, for a message."""
        return where(self.source, self.at)


class Item(Protocol):
    """Content of a file for one set of conditions."""

    @property
    def source(self) -> str:
        """Name of the file."""

    @property
    def at(self) -> Conditions:
        """Under which conditions."""


@dataclass(frozen=True)
class Finding:
    """Property of a measurement that limits a result.

    Attributes:
        name: such as "stroke".
        value: in SI; NaN where the text alone says it.
        unit: SI unit of the value.
        text: a sentence; "" where the number is enough.
        warning: it makes a result wrong or less certain.
    """

    name: str
    value: float
    unit: str
    text: str = ""
    warning: bool = False


class Kind(ABC):
    """A kind of bench file: quantities whose columns it must have, SI unit and example of a reading, nuisances."""

    needs: ClassVar[tuple[str, ...]]
    unit: ClassVar[str]
    example: ClassVar[str]
    nuisances: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def read(self, table: Table, at: Conditions, rows: np.ndarray) -> Item:
        """Read what was measured under some conditions.

        Args:
            table: of the file.
            at: the conditions.
            rows: of the table that were measured under them.

        Raises:
            ValueError: names file, row, column, value and unit.
        """

    def passes(self, table: Table, at: Conditions, rows: np.ndarray) -> Iterator[tuple[Conditions, np.ndarray]]:
        """Conditions and rows of each item that rows of equal conditions hold.

        Args:
            table: of the file.
            at: the conditions in the file.
            rows: of the table that have them.
        """
        yield at, rows

    def findings(self, item: Item, parts: Mapping[str, float]) -> tuple[Finding, ...]:
        """Properties of a measurement that limit a result: sampling, noise, and what does not come from the reducer.

        Args:
            item: what was read.
            parts: {name: order per output turn, a whole number or not} of what the reducer can cause.
        """
        return ()
