"""Loops: twist of the output under a torque that rises and falls."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rvjax.base.columns import Table
from rvjax.measured.branches import branches
from rvjax.measured.conditions import Conditions
from rvjax.measured.hysteresis import about, used
from rvjax.measured.kind import Finding, Item, Kind


@dataclass(frozen=True)
class Recorded:
    """Samples of a loop in the order of time.

    Attributes:
        torque: N m (n,).
        angle: rad (n,).
        branch: 1 on a rising branch that is used, -1 on a falling one, 0 elsewhere (n,).
    """

    torque: np.ndarray
    angle: np.ndarray
    branch: np.ndarray


@dataclass(frozen=True)
class Loop:
    """Twist of the output under a torque that rises and falls, input held.

    Attributes:
        source: name of the file.
        at: under which conditions; torque is None.
        torque: of the bench on the output, a grid, N m (n,).
        midline: mean of the rising and the falling branch, rad (n,).
        width: falling less rising branch, rad (n,): friction and backlash.
        sd: of the midline: noise, curvature between the samples, half of the gap of an open loop, rad (n,).
        clipped: the torque sensor has hit its end; what lies there is cut off.
        findings: cycles, gap, width at zero torque, lost motion, stiffness, energy.
        recorded: the samples; None where there are none.
    """

    source: str
    at: Conditions
    torque: np.ndarray
    midline: np.ndarray
    width: np.ndarray
    sd: np.ndarray
    clipped: bool
    findings: tuple[Finding, ...] = ()
    recorded: Recorded | None = None


class Hysteresis(Kind):
    """Twist of the output over the torque, input held."""

    needs = ("torque", "angle")
    unit = "rad"
    example = "0.2 arcsec"
    nuisances = ("offset", "drag")

    def read(self, table: Table, at: Conditions, rows: np.ndarray) -> Loop:
        """Read the last whole cycle of one hysteresis curve."""
        torque, angle = table.numbers["torque"][rows], table.numbers["angle"][rows]
        for name, values in (("torque", torque), ("angle", angle)):
            if np.any(np.isnan(values)):
                row = table.rows[rows][np.argmax(np.isnan(values))]
                raise ValueError(f"{table.source}: row {row}, {name} is empty: every sample of a loop needs both")
        unit = f"unit {at.unit!r}, " if at.unit else ""
        found = branches(f"{table.source}: {unit}loop", torque, angle)
        return Loop(
            *(table.source, at, found.torque, found.midline, found.width, found.sd, found.clipped),
            findings=about(found, torque, angle, table.rows[rows]),
            recorded=Recorded(torque, angle, used(found, len(torque))),
        )

    def findings(self, item: Item, parts: Mapping[str, float]) -> tuple[Finding, ...]:
        """Properties of a loop: cycles, gap, width at zero torque, lost motion, stiffness, energy."""
        return item.findings if isinstance(item, Loop) else ()
