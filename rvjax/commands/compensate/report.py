"""Report of `rvjax compensate`: orders stored and errors left, tables for the controller, plots before and after."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import rvjax
from rvjax._ground.files import versions
from rvjax.commands.compensate.compute import Corrections, Curve
from rvjax.commands.compensate.inputs import Inputs
from rvjax.compensation import Left, exported, predicted, residual
from rvjax.records import PyTree
from rvjax.render import CSV, TEXT, Figure, Interval, Note, Number, Quantity, Report, Table, Text
from rvjax.units import arcsec

ARCSEC: dict[str, PyTree] = {"unit": "rad", "read_in": "arcsec"}
BRIEF: dict[str, PyTree] = {"form": ".3g", **ARCSEC}


def report(inputs: Inputs, found: Corrections) -> Report:
    """The report on corrections.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    study, curves = inputs.study, found.curves
    left = [predicted(curve.correction, seed=study.seed) for curve in curves]
    noise = max(curve.found.residual_sd for curve in curves)
    head = f"Compensation {study.name}: ratio {curves[0].correction.ratio:g}, arcsec at the output"
    rest = f"Besides the orders the curves contain {noise / arcsec:.3g} arcsec (rms) that no table corrects."
    paths = [] if inputs.export is None else _paths(inputs.export, curves)
    return Report(
        title=f"{study.name}: compensation",
        content=(
            Note(head),
            _curves(curves, left),
            *_crossed(curves),
            Note(rest),
            Note("warning: this correction holds for the encoder head that measured the curve only."),
            *([Note("\n".join(found.notes))] if found.notes else []),
            _orders(curves),
            *(_figure(curve, end) for curve, end in zip(curves, _ends(curves))),
        ),
        data=_data(inputs, found, left),
        files={"study.toml": study.text.encode(), "data.csv": Path(inputs.data).read_bytes()}
        | {f"table{end}.csv": exported(rows, ".csv") for rows, end in zip(found.tables, _ends(curves))},
        exports={path: exported(rows, path.suffix, seed=study.seed) for path, rows in zip(paths, found.tables)},
        told={"tables": list(map(str, paths))},
        closing=tuple(f"Table: {path}" for path in paths),
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


def _curves(curves: Sequence[Curve], left: Sequence[Left]) -> Table:
    """Notes on each curve: stored orders and remaining error."""
    rows = []
    for curve, stays in zip(curves, left):
        made = curve.correction
        stored = " ".join(map(str, made.order.tolist())) or "none"
        after, swing = Quantity.of(stays.rms, **ARCSEC), Quantity.of(stays.peak_to_peak, **ARCSEC)
        before = made.before_rms, after, stays.before_peak_to_peak.value
        rows.append([curve.label or "all", stored, *before, swing])
    columns = [
        Text("curve"),
        Text("orders stored"),
        Number("rms before", **BRIEF),
        Interval("rms after [interval]", named=False, **BRIEF),
        Number("p-p before", **BRIEF),
        Interval("p-p after [interval]", named=False, **BRIEF),
    ]
    return Table("curves", columns, rows, on=frozenset({TEXT}))


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
        tables += [Table("crossed", columns, rows, caption, on=frozenset({TEXT}))] if len(own) > 1 else []
    return tables


def _orders(curves: Sequence[Curve]) -> Table:
    """Orders of all curves, and the stored part of each."""
    rows = []
    for curve in curves:
        made = curve.correction
        gains = dict(zip(made.order.tolist(), made.gain))
        for order, value, sd in zip(made.given_order.tolist(), made.given_value, made.sd):
            rows.append([curve.label, order, abs(value), np.angle(value), sd, gains.get(order, 0.0)])
    columns = [
        Text("curve"),
        Text("order"),
        Number("amplitude [arcsec]", **ARCSEC),
        Number("phase [deg]", unit="rad", read_in="deg"),
        Number("sd [arcsec]", **ARCSEC),
        Number("gain stored"),
    ]
    return Table("orders", columns, rows, on=frozenset({CSV}))


def _data(inputs: Inputs, found: Corrections, left: Sequence[Left]) -> dict[str, object]:
    curves = [
        {
            "unit": curve.run.at.unit,
            "torque": curve.torque,
            "direction": curve.direction,
            "temperature": curve.run.at.temperature,
            "order": curve.correction.order,
            "value": [[v.real, v.imag] for v in curve.correction.value.tolist()],
            "before_rms": curve.correction.before_rms,
            "residual_rms": curve.correction.residual_rms,
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
    first = np.zeros_like(curve.run.error)
    title = "Error and its correction"
    if 1 not in curve.correction.order and 1 in curve.found.order:
        value = curve.found.value[curve.found.order == 1][0]
        first, title = np.real(value * np.exp(1j * curve.run.angle)), "Error without order 1, and its correction"
    title = f"{title} {curve.label}".rstrip()

    before, made = curve.run.error - first, curve.correction
    draw = lambda: rvjax.plotting.compensation.before_and_after(curve.run.angle, before, made, title=title)  # noqa: E731
    return Figure(f"curve{end}", title, draw)
