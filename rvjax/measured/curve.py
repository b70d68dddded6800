"""Curves of the transmission error along turns of the output."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from rvjax.base.columns import Table
from rvjax.measured.conditions import Conditions, where as named
from rvjax.measured.findings import findings
from rvjax.measured.judge import judge
from rvjax.measured.kind import Finding, Item, Kind
from rvjax.measured.run import Run
from rvjax.measured.sampling import legs, places, unwrapped
from rvjax.units import deg

TURN = 359 * deg  # what a run has to cover; every sample represents the step before it


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
    where, angle = named(run.source, run.at), run.angle
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
