"""A run: transmission error along the angle of the output."""

from dataclasses import dataclass

import numpy as np

from rvjax.measured.conditions import Conditions, where


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
