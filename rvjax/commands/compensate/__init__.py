"""`rvjax compensate`: from measured curves of the transmission error to the tables of a controller."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import rvjax
from rvjax import commands, study
from rvjax.base import progress
from rvjax.base.files import versions
from rvjax.commands.cells import findings_data, measurement_section, measurement_warnings
from rvjax.commands.compensate.corrections import Corrections, Curve, corrections, periodic
from rvjax.compensation import FORMS, Correction, Left, exported, predicted, residual, table
from rvjax.measured import Finding, findings, foreign
from rvjax.records import PyTree
from rvjax.render import (
    CSV,
    PAGE,
    TEXT,
    Figure,
    Interval,
    Note,
    Number,
    Quantity,
    Report,
    Table,
    Text,
    column,
    results_folder,
)
from rvjax.study import kind_of
from rvjax.units import arcsec

POINTS = 720
"""Rows of a table without --points, unless the orders need more."""


@dataclass(kw_only=True)
class CompensateInputs(commands.Inputs):
    """Find the orders of measured error curves, choose those to store, compute the residual, and write the table.

    examples:
      rvjax compensate my-study.toml curve.csv --export table.csv
      rvjax compensate my-study.toml curve.csv --export table.st --count 5 --angle-sd "20 arcsec"

    The data has the columns "angle [deg]" (of the output) and "error [arcsec]", and optionally unit, "torque [N m]",
    direction (forward or backward) and "temperature [degC]". Each combination of these gets a separate table. The
    ending of FILE chooses the format: .csv, .json, .txt (Modelica), .xml (MJCF), .st (Structured Text).
    """

    source: str = commands.study_argument("; the command uses its ratio")
    data: str = commands.argument("measured curves", "DATA.csv")
    export: Path | None = commands.option(
        "write the table; with several curves one file for each (default: only the results folder)", "FILE", type=Path
    )
    count: int | None = commands.option(
        "store at most N orders (default: all orders that reduce the error)", "N", type=commands.whole_number
    )
    angle_sd: float = commands.option(
        "standard deviation of the zero of the table at the output, such as '20 arcsec' (default: 0)",
        "ANGLE",
        default="0 rad",
        unit="rad",
    )
    points: int = commands.option(
        "equal steps over one output revolution (default: 720, or more for high orders)",
        "N",
        default=POINTS,
        type=commands.whole_number,
    )
    side: str = commands.option(
        "where the correction is added (default: input)", default="input", choices=["input", "output"]
    )
    first_order: bool = commands.switch("store order 1 too; it is usually the mounting of the encoder")
    encoding: str | None = commands.encoding_option()
    results: str | None = commands.results_option("STUDY-compensation")
    quiet: bool = commands.quiet_option()

    def __post_init__(self) -> None:
        """Read the study, and check the file of the table."""
        if self.export is not None and self.export.suffix not in FORMS:
            raise ValueError(f"--export {self.export}: must end with one of {', '.join(FORMS)}")
        if self.export is not None and not self.export.absolute().parent.is_dir():
            raise ValueError(f"--export {self.export}: there is no such folder")
        self.study = study.load(self.source, solve=False, needs=("design",))
        self.folder = results_folder(self.results, f"{self.study.name}-compensation")
        self.phases = (commands.READING, CORRECTING, commands.WRITING)


CORRECTING = "orders of the curves"


def compute(inputs: CompensateInputs) -> Corrections:
    """Corrections of all curves and their tables."""
    progress.begin(CORRECTING)
    found = corrections(
        inputs.study,
        inputs.data,
        angle_sd=inputs.angle_sd,
        count=inputs.count,
        first_order=inputs.first_order,
        encoding=inputs.encoding,
    )
    made = (table(c.correction, max(inputs.points, _least(c.correction)), side=inputs.side) for c in found.curves)
    return dataclasses.replace(found, tables=tuple(made))


def _least(found: Correction) -> int:
    """Eight rows for a period of the highest order: an error of 8 % of it by linear interpolation."""
    return 8 * int(found.order.max(initial=0))


ARCSEC: dict[str, PyTree] = {"unit": "rad", "read_in": "arcsec"}
BRIEF: dict[str, PyTree] = {"form": ".3g", **ARCSEC}


def report(inputs: CompensateInputs, found: Corrections) -> Report:
    """The report on corrections.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    study, curves = inputs.study, found.curves
    left = [predicted(curve.correction, seed=study.seed) for curve in curves]
    noise = max(curve.found.residual_sd for curve in curves)
    head = f"Compensation {study.name}: ratio {curves[0].correction.ratio:g}, arcsec at the output"
    multiples = kind_of(study.design).multiples(study.design)
    found_in = {
        curve.label: findings(curve.judged) + foreign(curve.judged, multiples) + _not_stored(curve) for curve in curves
    }
    rest = f"Besides the orders the curves contain {noise / arcsec:.3g} arcsec (rms) that no table corrects."
    paths = [] if inputs.export is None else _paths(inputs.export, curves)
    return Report(
        title=f"{study.name}: compensation",
        content=(
            Note(head),
            *([Note("\n".join(said))] if (said := measurement_warnings(found_in)) else []),
            _curves(curves, left),
            *_crossed(curves),
            Note(rest),
            Note("warning: this correction holds for the encoder head that measured the curve only."),
            *([Note("\n".join(found.notes))] if found.notes else []),
            _orders(curves),
            *(_figure(curve, end) for curve, end in zip(curves, _ends(curves))),
            *measurement_section(found_in, [_measured(curve, end) for curve, end in zip(curves, _ends(curves))]),
        ),
        page="",
        data=_data(inputs, found, left, found_in),
        files={"study.toml": study.text.encode(), "data.csv": Path(inputs.data).read_bytes()}
        | {f"table{end}.csv": exported(rows, ".csv") for rows, end in zip(found.tables, _ends(curves))},
        exports={path: exported(rows, path.suffix, seed=study.seed) for path, rows in zip(paths, found.tables)},
        told={"tables": list(map(str, paths))},
        closing=tuple(f"Table: {path}" for path in paths),
    )


def _not_stored(curve: Curve) -> tuple[Finding, ...]:
    """Orders that exceed noise and are not stored."""
    size = dict(zip(curve.found.order.tolist(), np.abs(curve.found.value).tolist()))
    return tuple(
        Finding(f"order {order} is not stored", size[order], "rad", why, True)
        for order, why in curve.fit.unsure.items()
        if order > 1
    )


def _ends(curves: Sequence[Curve]) -> list[str]:
    """End of the name of the files of each curve."""
    return [f"-{number}" if len(curves) > 1 else "" for number in range(1, len(curves) + 1)]


def _paths(export: Path, curves: Sequence[Curve]) -> list[Path]:
    """The file of the table of each curve; with several of them, its name holds unit and conditions."""
    labels = [re.sub(r"[^A-Za-z0-9.+-]+", "_", curve.label) for curve in curves]
    if len(set(labels)) < len(labels):  # "a b" and "a_b"
        labels = [f"{number}-{label}" for number, label in enumerate(labels, 1)]
    return [export.with_name(f"{export.stem}-{label}{export.suffix}") for label in labels] if labels[1:] else [export]


@dataclass(frozen=True)
class CurveRow:
    """A curve: stored orders, before and after, and what is expected of another measurement."""

    curve: str = column(Text("curve"))
    stored: str = column(Text("orders stored"))
    before: float = column(Number("rms before", **BRIEF))
    after: float = column(Number("rms after", **BRIEF))
    held_out: float | None = column(Number("held-out turn", **BRIEF))
    rms: Quantity = column(Interval("stored orders leave [interval]", named=False, **BRIEF))
    peak_to_peak: Quantity = column(Interval("p-p [interval]", named=False, **BRIEF))


def _curves(curves: Sequence[Curve], left: Sequence[Left]) -> Table:
    rows = []
    for curve, stays in zip(curves, left):
        stored = " ".join(map(str, curve.correction.order.tolist())) or "none"
        later = curve.held_out and curve.held_out[1]
        expected = Quantity.of(stays.rms, **ARCSEC), Quantity.of(stays.peak_to_peak, **ARCSEC)
        rows.append(CurveRow(curve.label or "all", stored, curve.before, curve.after, later, *expected))
    without = () if any(curve.held_out for curve in curves) else ("held_out",)
    note = "rms of the measured curve without its mean, a drift, and an order 1 that is not stored"
    return Table.of(CurveRow, "curves", rows, without=without, note=note, on=frozenset({TEXT, PAGE}))


def _crossed(curves: Sequence[Curve]) -> list[Table]:
    """For each unit with several curves: rms that the table of one curve leaves of each other one."""
    tables = []
    for unit in dict.fromkeys(curve.run.at.unit for curve in curves):
        own = [curve for curve in curves if curve.run.at.unit == unit]
        rows = [
            [
                made.label or "all",
                *(residual(made.correction, c.correction.given_order, c.correction.given_value).rms for c in own),
            ]
            for made in own
        ]
        columns = [Text("table made at"), *(Number(curve.label or "all", **BRIEF) for curve in own)]
        caption = "rms of a curve with the table of another curve"
        tables += [Table("crossed", columns, rows, caption, on=frozenset({TEXT, PAGE}))] if len(own) > 1 else []
    return tables


@dataclass(frozen=True)
class OrderRow:
    """An order of a curve, and its stored part."""

    curve: str = column(Text("curve"))
    order: int = column(Text("order"))
    amplitude: float = column(Number("amplitude [arcsec]", **ARCSEC))
    phase: float = column(Number("phase [deg]", unit="rad", read_in="deg"))
    sd: float = column(Number("sd [arcsec]", **ARCSEC))
    gain: float = column(Number("gain stored"))


def _orders(curves: Sequence[Curve]) -> Table:
    rows = []
    for curve in curves:
        made = curve.correction
        gains = dict(zip(made.order.tolist(), made.gain))
        for order, value, sd in zip(made.given_order.tolist(), made.given_value, made.sd):
            rows.append(OrderRow(curve.label, order, abs(value), np.angle(value), sd, gains.get(order, 0.0)))
    return Table.of(OrderRow, "orders", rows, on=frozenset({CSV}))


def _data(
    inputs: CompensateInputs, found: Corrections, left: Sequence[Left], found_in: Mapping[str, Sequence[Finding]]
) -> dict[str, object]:
    curves = [
        {
            "unit": curve.run.at.unit,
            "torque": curve.torque,
            "direction": curve.direction,
            "temperature": curve.run.at.temperature,
            "order": curve.correction.order,
            "value": [[v.real, v.imag] for v in curve.correction.value.tolist()],
            "before_rms": curve.before,
            "residual_rms": curve.after,
            "held_out_rms": curve.held_out and list(curve.held_out),
            "not_stored": curve.fit.unsure,
            "measurement": findings_data(found_in[curve.label]),
            "noise_sd": curve.found.residual_sd,
            "error_bound": rows.error_bound,
            "predicted": stays,
        }
        for curve, rows, stays in zip(found.curves, found.tables, left)
    ]
    about = {"study": inputs.study.name, "seed": inputs.study.seed, "versions": versions()}
    about |= {"notes": list(found.notes)} if found.notes else {}
    return about | {"ratio": found.curves[0].correction.ratio, "curves": curves}


def _figure(curve: Curve, end: str) -> Figure:
    """The curve before and after, without order 1 where that is not stored."""
    made, angle = curve.correction, curve.judged.angle
    title = "Error and its correction" if 1 in made.order else "Error without order 1, and its correction"
    title = f"{title} {curve.label}".rstrip()
    before = periodic(curve.judged, made)
    return Figure(f"curve{end}", title, lambda: rvjax.plotting.corrected_curve(angle, before, made, title=title))


def _measured(curve: Curve, end: str) -> Figure:
    """The readings, what was found in them, and the rest."""
    title = f"Measured curve, its contents and the rest {curve.label}".rstrip()
    return Figure(f"measurement{end}", title, lambda: rvjax.plotting.measured_contents(curve.judged, title=title))
