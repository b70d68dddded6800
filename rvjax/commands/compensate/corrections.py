"""Corrections of measured curves, one for each unit, torque, direction and temperature."""

import dataclasses
from pathlib import Path

import numpy as np

from rvjax.compensation import Correction, Table, correction
from rvjax.identify import Orders, orders
from rvjax.measured import MOTOR, Fitted, Judged, fitted, judge
from rvjax.records import PyTree
from rvjax.study import KINDS, Run, Study, StudyError, orders_of, read_measured

WHOLE_TURNS = 1.99
HARMONICS = 3  # of the pins, at least: the highest order that a table holds


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """One measured curve.

    Attributes:
        judged: the curve and its contents.
        fit: its orders, and those that a table may hold.
        correction: of it.
        before: rms without drift, mean and an order 1 that is not stored, rad.
        after: the same with the table, rad.
        held_out: the last of several revolutions without and with a table of the others, rad; None of one revolution.
    """

    judged: Judged
    fit: Fitted
    correction: Correction
    before: float
    after: float
    held_out: tuple[float, float] | None = None

    @property
    def run(self) -> Run:
        """As measured."""
        return self.judged.run

    @property
    def found(self) -> Orders:
        """Fitted orders."""
        return self.fit.found

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


def corrections(
    study: Study,
    path: str | Path,
    *,
    angle_sd: float = 0.0,
    count: int | None = None,
    first_order: bool = False,
    encoding: str | None = None,
) -> Corrections:
    """Corrections from a CSV file of measured curves.

    Orders up to three times the pins, of a single-stage drive up to three times its holes, are fitted, fewer where the
    points are few. Those of the reducer are always among them. Orders that exceed noise and are no alias are stored.

    Args:
        study: its design gives ratio and pins, its [columns] the foreign names of columns.
        path: of the file, as `rvjax.measured` reads it: "angle [deg]", "error [arcsec]" and, if wanted, unit,
            torque, direction and temperature. Rows of equal conditions are a curve.
        angle_sd: of the table's zero, rad of the output.
        count: orders to store at most.
        first_order: order 1 belongs to the reducer, not to the mounting of the encoder.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: names file, row, column and value.
    """
    if not orders_of(study.design):
        able = " or ".join(kind.name for kind in KINDS.values() if kind.orders)
        raise StudyError(f"{study.name}: {able} is needed, whose ratio and pins are read")
    read = read_measured([path], study.columns, kind="curve", encoding=encoding)
    runs = [run for run in read.runs if len(run.angle)]
    if not runs:
        raise StudyError(f"{path}: holds no point")
    curves = tuple(_curve(study.design, run, angle_sd, count, first_order) for run in runs)
    return Corrections(curves, notes=read.notes)


def _most(design: PyTree) -> int:
    """Highest order of a table: the third multiple of the pins, and every order that parts but the driven one make."""
    made = (order for name, order in orders_of(design).items() if name not in MOTOR)
    return int(max(HARMONICS * design.cycloid.pin_count, *made))


def _curve(design: PyTree, run: Run, angle_sd: float, count: int | None, first_order: bool) -> Curve:
    try:
        judged = judge(run, orders_of(design))
        fit = fitted(judged, _most(design))
        found = fit.found
        seen = fit.seen if first_order else fit.seen[found.order[fit.seen] > 1]
        made = correction(
            found.order[seen],
            found.value[seen],
            sd=found.sd[seen],
            ratio=float(design.ratio),
            angle_sd=angle_sd,
            count=count,
        )
        rest = periodic(judged, made)
        after = rest + made.output(judged.angle)
        return Curve(judged, fit, made, float(np.std(rest)), float(np.std(after)), _held_out(judged, made, rest))
    except ValueError as problem:
        text = str(problem)
        text = text if text.startswith(run.source) else f"{run.source}, {run.at.text()}: {text}"
        raise StudyError(text) from None


def periodic(judged: Judged, made: Correction) -> np.ndarray:
    """The measured curve, with lines, without drift, and without order 1 where that is not stored; rad.

    Args:
        judged: the curve.
        made: correction of it.
    """
    kept = np.isin(judged.model.angle, judged.angle)
    lines = judged.model.curve(judged.found("line"))[kept]
    curve = judged.error + lines
    if 1 in made.order or 2 * len(judged.angle) < 8:
        return curve
    value = orders(judged.angle, judged.error, sorted({1, *made.order.tolist()})).value[0]
    return np.asarray(curve - np.real(value * np.exp(1j * judged.angle)))


def _held_out(judged: Judged, made: Correction, curve: np.ndarray) -> tuple[float, float] | None:
    """Rms of the last revolution without and with the stored orders of the revolutions before it, rad."""
    if judged.sampling.turns < WHOLE_TURNS or not len(made.order):
        return None
    last = judged.angle > judged.angle[-1] - 2 * np.pi
    own = orders(judged.angle[~last], judged.error[~last], sorted({1, *made.order.tolist()}))
    gain = dict(zip(made.order.tolist(), made.gain))
    value = own.value * np.array([gain.get(order, 0.0) for order in own.order.tolist()])
    table_of = np.real(np.exp(1j * np.outer(judged.angle[last], own.order)) @ value)
    return float(np.std(curve[last])), float(np.std(curve[last] - table_of))
