"""Kind of a bench file: its columns, how they are read, nuisances of the bench."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from rvjax.base.columns import Table
from rvjax.measured.conditions import Conditions


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
