"""Loops: twist of the output under a torque that rises and falls."""

from dataclasses import dataclass

import numpy as np

from rvjax._ground.columns import Table
from rvjax.measured.branches import branches
from rvjax.measured.conditions import Conditions
from rvjax.measured.kind import Kind


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


class Hysteresis(Kind):
    """Twist of the output over the torque, input held."""

    needs = ("torque", "angle")
    unit = "rad"
    example = "0.2 arcsec"
    nuisances = ("offset", "drag")

    def read(self, table: Table, at: Conditions, rows: np.ndarray) -> Loop:
        """Read one hysteresis curve and split it into branches."""
        torque, angle = table.numbers["torque"][rows], table.numbers["angle"][rows]
        for name, values in (("torque", torque), ("angle", angle)):
            if np.any(np.isnan(values)):
                row = table.rows[rows][np.argmax(np.isnan(values))]
                raise ValueError(f"{table.source}: row {row}, {name} is empty: every sample of a loop needs both")
        unit = f"unit {at.unit!r}, " if at.unit else ""
        return Loop(table.source, at, *branches(f"{table.source}: {unit}loop", torque, angle))
