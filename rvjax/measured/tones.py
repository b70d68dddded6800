"""Natural frequencies of a unit."""

from dataclasses import dataclass

import numpy as np

from rvjax.base.columns import Table
from rvjax.measured.conditions import Conditions
from rvjax.measured.kind import Kind


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


class Frequencies(Kind):
    """Natural frequencies, with their standard deviations where the file has them."""

    needs = ("frequency",)
    unit = "Hz"
    example = "1 Hz"

    def read(self, table: Table, at: Conditions, rows: np.ndarray) -> Tones:
        """Read the frequencies of one unit, ascending."""
        frequency = table.numbers["frequency"][rows]
        sd = table.numbers.get("sd", np.full(len(table.rows), np.nan))[rows]
        for name, values, bad in (("frequency", frequency, ~(frequency > 0)), ("sd", sd, sd <= 0)):
            if np.any(bad):
                k = int(np.argmax(bad))
                where = f"{table.source}: row {table.rows[rows][k]}, {name} = {values[k]:g}"
                raise ValueError(f"{where}: must be positive, in {table.shown[name]}")
        order = np.argsort(frequency, kind="stable")
        return Tones(table.source, at, frequency[order], sd[order])
