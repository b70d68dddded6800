"""Corrections as text and files."""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rvjax import plotting
from rvjax.compensation import FORMS, Correction, Table, export, exported, predicted, residual
from rvjax.compensation import table as table_of
from rvjax.report.folders import as_csv, write_files
from rvjax.report.folders import as_json as json_file
from rvjax.report.pictures import saved
from rvjax.report.text import plain, table, versions
from rvjax.study import Study
from rvjax.study.compensation import Corrections, Curve
from rvjax.tolerances import Estimate
from rvjax.units import arcsec

POINTS = 720
"""Rows of a table where nobody chose, as long as the orders are not too high for them."""


def check_export(path: str) -> None:
    """Refuse a file that could not be written, before any work is done.

    Raises:
        ValueError: another ending, or no such folder.
    """
    if Path(path).suffix not in FORMS:
        raise ValueError(f"--export {path}: must end with one of {', '.join(FORMS)}")
    if not Path(path).absolute().parent.is_dir():
        raise ValueError(f"--export {path}: there is no such folder")


def _text(found: Estimate) -> str:
    return f"{found.value / arcsec:.3g} [{found.lower / arcsec:.3g}, {found.upper / arcsec:.3g}]"


def rows(found: Corrections, seed: int) -> tuple[list[str], list[list[str]]]:
    """Headers and rows: what each curve is, what is stored, and what stays."""
    headers = ["curve", "orders stored", "rms before", "rms after [interval]", "p-p before", "p-p after [interval]"]
    cells = []
    for curve in found.curves:
        left = predicted(curve.correction, seed=seed)
        orders = " ".join(map(str, curve.correction.order.tolist())) or "none"
        before = f"{curve.correction.before_rms / arcsec:.3g}"
        swing = f"{left.before_peak_to_peak.value / arcsec:.3g}"
        cells.append([curve.label or "all", orders, before, _text(left.rms), swing, _text(left.peak_to_peak)])
    return headers, cells


def cross_rows(found: Corrections) -> tuple[list[str], list[list[str]]]:
    """Headers and rows: rms that the table of one curve leaves of each other one, arcsec."""
    headers = ["table made at", *(curve.label or "all" for curve in found.curves)]
    cells = []
    for made in found.curves:
        lefts = [
            residual(made.correction, other.correction.given_order, other.correction.given_value).rms / arcsec
            for other in found.curves
        ]
        cells.append([made.label or "all", *(f"{left:.3g}" for left in lefts)])
    return headers, cells


def summary(found: Corrections, study: Study, *, seed: int) -> str:
    """The corrections as text, arcsec of the output."""
    lines = [f"Compensation {study.name}: ratio {found.curves[0].correction.ratio:g}, arcsec at the output", ""]
    lines.append(table(*rows(found, seed)))
    if len(found.curves) > 1:
        lines += ["", "rms left by the table of one curve at another", table(*cross_rows(found))]
    noise = max(curve.found.residual_sd for curve in found.curves)
    lines += ["", f"Beside the orders the curves hold {noise / arcsec:.3g} arcsec (rms) that no table takes off."]
    return "\n".join(lines)


def tables(found: Corrections, points: int, side: str) -> list[Table]:
    """The table of each curve; more steps than asked for where its orders need them."""
    return [table_of(curve.correction, max(points, _least(curve.correction)), side=side) for curve in found.curves]


def _least(correction: Correction) -> int:
    """Eight rows to a wave of the highest order: an error of 8 % of it by linear interpolation."""
    return 8 * int(correction.order.max(initial=0))


def export_all(found: Corrections, tables: Sequence[Table], path: str, seed: int) -> list[Path]:
    """Write the table of every curve; with several of them, the name of each file tells which."""
    target, written = Path(path), []
    for curve, rows in zip(found.curves, tables):
        label = re.sub(r"[^A-Za-z0-9.+-]+", "_", curve.label)
        own = target if len(found.curves) == 1 else target.with_name(f"{target.stem}-{label}{target.suffix}")
        export(rows, own, seed=seed)
        written.append(own)
    return written


def _mounting(curve: Curve) -> tuple[np.ndarray, str]:
    """Order 1 where it is not stored, so that a picture shows what a table can take off, and what the picture is."""
    if 1 in curve.correction.order or 1 not in curve.found.order:
        return np.zeros_like(curve.error), "Error and its correction"
    first = curve.found.value[curve.found.order == 1][0]
    return np.real(first * np.exp(1j * curve.angle)), "Error without order 1, and its correction"


def as_json(found: Corrections, tables: Sequence[Table], study: Study) -> dict[str, Any]:
    """Everything about corrections as JSON values, SI, with seed and versions."""
    curves = [
        {
            "torque": curve.torque,
            "direction": curve.direction,
            "order": curve.correction.order,
            "value": [[v.real, v.imag] for v in curve.correction.value.tolist()],
            "before_rms": curve.correction.before_rms,
            "residual_rms": curve.correction.residual_rms,
            "noise_sd": curve.found.residual_sd,
            "error_bound": rows.error_bound,
            "predicted": predicted(curve.correction, seed=study.seed),
        }
        for curve, rows in zip(found.curves, tables)
    ]
    about = {"study": study.name, "seed": study.seed, "versions": versions()}
    return plain(about | {"ratio": found.curves[0].correction.ratio, "curves": curves})


def write(found: Corrections, tables: Sequence[Table], study: Study, source: str, folder: Path) -> Path:
    """Write summary, orders, tables, JSON, data and pictures into a new folder."""
    return write_files(_files(found, tables, study, source), folder)


def _files(found: Corrections, tables: Sequence[Table], study: Study, source: str) -> Iterator[tuple[str, bytes]]:
    yield "study.toml", study.text.encode()
    yield "data.csv", Path(source).read_bytes()
    yield "summary.txt", (summary(found, study, seed=study.seed) + "\n").encode()
    yield "orders.csv", as_csv(*_orders(found))
    yield "result.json", json_file(as_json(found, tables, study))
    for number, (curve, rows) in enumerate(zip(found.curves, tables), 1):
        end = f"-{number}" if len(found.curves) > 1 else ""
        yield f"table{end}.csv", exported(rows, ".csv")
        mounting, title = _mounting(curve)
        with plotting.style():
            axes = plotting.compensation.before_and_after(
                curve.angle, curve.error - mounting, curve.correction, title=f"{title} {curve.label}".rstrip()
            )
            yield f"curve{end}.png", saved(axes.figure)


def _orders(found: Corrections) -> tuple[list[str], list[list[str]]]:
    """Headers and rows: every order of every curve, and how much of it is stored."""
    headers = ["curve", "order", "amplitude [arcsec]", "phase [deg]", "sd [arcsec]", "gain stored"]
    cells = []
    for curve in found.curves:
        given = curve.correction
        gains = dict(zip(given.order.tolist(), given.gain))
        for order, value, sd in zip(given.given_order.tolist(), given.given_value, given.sd):
            numbers = [abs(value) / arcsec, math.degrees(np.angle(value)), sd / arcsec, gains.get(order, 0.0)]
            cells.append([curve.label, str(order), *(f"{number:.10g}" for number in numbers)])
    return headers, cells
