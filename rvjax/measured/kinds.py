"""Kinds of bench files: curves of the transmission error, hysteresis, natural frequencies.

A kind has columns, how they are read, and nuisances of the bench.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rvjax.base.columns import Table
from rvjax.measured.branches import branches
from rvjax.measured.curve_analysis import findings, judge
from rvjax.measured.hysteresis import about, used
from rvjax.measured.run import Conditions, Finding, Run, legs, places
from rvjax.units import deg

TURN = 359 * deg  # what a run has to cover; every sample represents the step before it


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


Item = Run | Loop | Tones


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


class Curve(Kind):
    """Transmission error over the output angle."""

    needs = ("angle", "error")
    unit = "rad"
    example = "0.2 arcsec"
    nuisances = ("offset", "mounting", "phase", "reading", "drag", "viscous_drag")

    def read(self, table: Table, at: Conditions, rows: np.ndarray) -> Run:
        """Read the samples of one run; a missing reading is no sample."""
        angle, error = table.numbers["angle"][rows], table.numbers["error"][rows]
        kept = ~np.isnan(error)  # a missing reading is no sample; the gap that it leaves is checked with the orders
        for row, value in zip(table.rows[rows][kept], angle[kept]):
            if np.isnan(value):
                raise ValueError(f"{table.source}: row {row}, angle is empty: every sample needs its angle in deg")
        return Run(table.source, at, unwrapped(angle[kept]), error[kept], table.rows[rows][kept])

    def passes(self, table: Table, at: Conditions, rows: np.ndarray) -> Iterator[tuple[Conditions, np.ndarray]]:
        """Forth and back of a file without directions; rows without a reading belong to the pass about them."""
        angle = table.numbers["angle"][rows]
        known = ~np.isnan(angle) & ~np.isnan(table.numbers["error"][rows])
        path = unwrapped(angle[known])
        every = legs(path) if not at.stated else []
        if len(every) < 2:
            yield at, rows
            return
        for leg in every:
            rises = path[leg][-1] > path[leg][0]
            yield replace(at, direction="forward" if rises else "backward", stated=True), rows[known][leg]

    def findings(self, item: Item, parts: Mapping[str, float]) -> tuple[Finding, ...]:
        """Points, stroke, closure, drift, noise, and orders that are not distinguishable."""
        return findings(judge(item, parts)) if isinstance(item, Run) else ()


def checked(run: Run, finest: int) -> Run:
    """Check that a run determines the orders up to `finest` of the output revolution.

    Raises:
        ValueError: it covers less than 359 deg, turns back, or has a gap above half the finest order.
    """
    where, angle = run.name, run.angle
    rank = np.sort(angle)
    distinct = places(rank, rank)[0]  # repeated readings of a place are no steps
    step = np.median(np.diff(distinct)) if len(distinct) > 1 else 0.0
    if (covered := (np.ptp(angle) + step if len(angle) else 0.0) / deg) < TURN / deg:
        hint = "; a run needs one nominal torque" if len(angle) < 2 else ""
        raise ValueError(f"{where}: covers {covered:.6g} deg in {len(angle)} samples, needs at least 359 deg{hint}")
    falls = run.at.direction == "backward" and angle[-1] < angle[0]  # recorded in time, or sorted: both are read
    onward = -angle if falls else angle
    period = 360 * deg / finest
    back = np.max(np.maximum.accumulate(onward) - onward)
    if back > 0.1 * period:  # less is jitter of an encoder
        back_by = f"the angle turns back by {back / deg:.4g} deg"
        raise ValueError(f"{where}: {back_by}; a run goes one way, {run.at.direction}")
    order = np.argsort(angle, kind="stable")
    gap = np.max(np.diff(angle[order]))
    if gap > 0.5 * period:
        need = f"order {finest} needs at most {0.5 * period / deg:.4g} deg"
        raise ValueError(f"{where}: a gap of {gap / deg:.4g} deg in the angle; {need}")
    return replace(run, angle=angle[order], error=run.error[order])


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
        loop = branches(f"{table.source}: {unit}loop", torque, angle)
        return Loop(
            *(table.source, at, loop.torque, loop.midline, loop.width, loop.sd, bool(loop.clipped_at)),
            findings=tuple(about(loop, torque, angle, table.rows[rows])),
            recorded=Recorded(torque, angle, used(loop, len(torque))),
        )

    def findings(self, item: Item, parts: Mapping[str, float]) -> tuple[Finding, ...]:
        """Properties of a loop: cycles, gap, width at zero torque, lost motion, stiffness, energy."""
        return item.findings if isinstance(item, Loop) else ()


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


KINDS: dict[str, Kind] = {"curve": Curve(), "loop": Hysteresis(), "frequencies": Frequencies()}
"""Kinds of measurements, by the name that an `rvjax.outputs.Observation` gives it."""


def unwrapped(angle: np.ndarray) -> np.ndarray:
    """Angle without jumps by a revolution; a single wrong angle adds none.

    Args:
        angle: in the order of time, rad (n,).
    """
    path = np.unwrap(angle)
    steps = np.diff(path)
    if len(steps) < 2 or np.median(np.abs(steps)) > math.pi / 4:
        return path
    across = np.diff(np.unwrap(np.stack([angle[:-2], angle[2:]]), axis=0), axis=0)[0]
    added = np.round((steps[:-1] + steps[1:] - across) / (2 * math.pi))
    steps[1:] -= np.where(np.abs(steps[1:]) > math.pi / 2, added, 0.0) * 2 * math.pi
    return np.concatenate([path[:1], path[0] + np.cumsum(steps)]) if np.any(added) else path
