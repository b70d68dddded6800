"""Corrections of measured curves, one for each unit, torque, direction and temperature."""

import dataclasses
from pathlib import Path

import numpy as np

from rvjax._ground import progress
from rvjax.commands.compensate.inputs import Inputs
from rvjax.commands.speak import READING, WRITING
from rvjax.compensation import Correction, Table, correction, significant, table
from rvjax.identify import Orders, orders
from rvjax.records import PyTree
from rvjax.study import KINDS, Run, Study, StudyError, kind_of, read_measured

CORRECTING = "orders of the curves"
SPARE = 4  # points for every number that is fitted


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """One measured curve.

    Attributes:
        run: as measured.
        found: its orders.
        correction: of it.
    """

    run: Run
    found: Orders
    correction: Correction

    @property
    def torque(self) -> float:
        """N m; 0 where the file has none."""
        return self.run.at.torque or 0.0

    @property
    def direction(self) -> str:
        """Direction in the file; "" if there is none."""
        return self.run.at.direction if self.run.at.stated else ""

    @property
    def label(self) -> str:
        """Unit and conditions as text, also for file names; "" if there are none."""
        at = self.run.at
        torque = [f"{self.torque:g} N m"] if at.torque is not None or self.direction else []
        warm = [] if at.temperature is None else [f"{at.temperature:g} degC"]
        return " ".join(filter(None, [at.unit, *torque, self.direction, *warm]))


@dataclasses.dataclass(frozen=True, eq=False)
class Corrections:
    """All curves of a file.

    Attributes:
        curves: in the order in which they first occur.
        tables: of the curves, in the same order.
        notes: how the file was read, where it has not the plain form.
    """

    curves: tuple[Curve, ...]
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()


def phases(inputs: Inputs) -> dict[str, float]:
    """Phases of the command; their times are not known before.

    Args:
        inputs: what is computed.
    """
    return dict.fromkeys((READING, CORRECTING, WRITING), 0.0)


def compute(inputs: Inputs) -> Corrections:
    """Corrections of all curves and their tables."""
    progress.begin(CORRECTING)
    found = corrections(
        inputs.study, inputs.data, angle_sd=inputs.angle_sd, count=inputs.count, first_order=inputs.first_order
    )
    made = (table(c.correction, max(inputs.points, _least(c.correction)), side=inputs.side) for c in found.curves)
    return dataclasses.replace(found, tables=tuple(made))


def _least(found: Correction) -> int:
    """Eight rows for a period of the highest order: an error of 8 % of it by linear interpolation."""
    return 8 * int(found.order.max(initial=0))


def corrections(
    study: Study, path: str | Path, *, angle_sd: float = 0.0, count: int | None = None, first_order: bool = False
) -> Corrections:
    """Corrections from a CSV file of measured curves.

    Orders up to three times the pins are fitted, fewer where the points are few. The significant ones are stored.

    Args:
        study: its design gives ratio and pins, its [columns] the foreign names of columns.
        path: of the file, as `rvjax.measured` reads it: "angle [deg]", "error [arcsec]" and, if wanted, unit,
            torque, direction and temperature. Rows of equal conditions are a curve.
        angle_sd: of the table's zero, rad of the output.
        count: orders to store at most.
        first_order: order 1 belongs to the reducer, not to the mounting of the encoder.

    Raises:
        ValueError: names file, row, column and value.
    """
    if kind_of(study.design).orders is None:
        able = " or ".join(kind.name for kind in KINDS.values() if kind.orders)
        raise StudyError(f"{study.name}: {able} is needed, whose ratio and pins are read")
    read = read_measured([path], study.columns, kind="curve")
    runs = [run for run in read.runs if len(run.angle)]
    if not runs:
        raise StudyError(f"{path}: holds no point")
    curves = tuple(_curve(study.design, run, angle_sd, count, first_order) for run in runs)
    return Corrections(curves, notes=read.notes)


def _curve(design: PyTree, run: Run, angle_sd: float, count: int | None, first_order: bool) -> Curve:
    most = 3 * design.cycloid.pin_count
    fitted = np.arange(1, min(most, (len(run.angle) // SPARE - 1) // 2) + 1)
    try:
        found = orders(run.angle, run.error, fitted)
        seen = significant(found)
        seen = seen if first_order else seen[found.order[seen] > 1]
        made = correction(
            found.order[seen],
            found.value[seen],
            sd=found.sd[seen],
            ratio=float(design.ratio),
            angle_sd=angle_sd,
            count=count,
        )
    except ValueError as problem:
        raise StudyError(f"{run.source}, {run.at.text()}: {problem}") from None
    return Curve(run, found, made)
