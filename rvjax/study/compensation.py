"""Measured curves of a unit, and their corrections."""

import dataclasses
import math
from pathlib import Path

import numpy as np

from rvjax.compensation import Correction, Schedule, correction, schedule, significant
from rvjax.designs import RVReducer
from rvjax.identify import Orders, orders
from rvjax.study.columns import read_table
from rvjax.study.question import Study, StudyError

UNITS = {"angle": "deg", "error": "arcsec"}
"""Usual units of the columns that must be there; the header says which."""
SPARE = 4  # points for every number that is fitted


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """One measured curve.

    Attributes:
        torque: N m; 0 where the file does not tell.
        direction: as written; "" where the file does not tell.
        angle: of the output, rad (n,).
        error: of the output, rad (n,).
        found: its orders.
        correction: of it.
    """

    torque: float
    direction: str
    angle: np.ndarray
    error: np.ndarray
    found: Orders
    correction: Correction

    @property
    def label(self) -> str:
        """For a person and for file names."""
        words = [] if not self.torque and not self.direction else [f"{self.torque:g} N m"]
        return " ".join(words + ([self.direction] if self.direction else []))


@dataclasses.dataclass(frozen=True, eq=False)
class Corrections:
    """All curves of a file.

    Attributes:
        curves: in the order in which they first occur.
        schedule: over torque and direction.
    """

    curves: tuple[Curve, ...]
    schedule: Schedule


def corrections(
    study: Study, path: str | Path, *, angle_sd: float = 0.0, count: int | None = None, first_order: bool = False
) -> Corrections:
    """Corrections from a CSV file of measured curves.

    Orders up to three times the pins are fitted, fewer where the points are few, and counted where noise would not
    show them.

    Args:
        study: its design tells ratio and pins.
        path: of the file: "angle [deg]", "error [arcsec]" and, if wanted, "torque [N m]" and "direction", each in the
            unit that its header says; cells as `rvjax.columns.read_table` takes them.
        angle_sd: of the table's zero, rad of the output.
        count: orders to store at most.
        first_order: order 1 is the reducer's and not the mounting of the encoder.

    Raises:
        ValueError: names file, row, column and value.
    """
    if not isinstance(study.design, RVReducer):
        raise StudyError(f"{study.name}: an RV reducer is needed, whose ratio and pins are read")
    ratio, most = float(study.design.ratio), 3 * study.design.cycloid.pin_count
    curves = []
    for (torque, direction), points in _curves(Path(path)).items():
        angle, error = np.array(points).T
        fitted = np.arange(1, min(most, (len(angle) // SPARE - 1) // 2) + 1)
        where = f"{path}, {torque:g} N m {direction}".rstrip()
        try:
            found = orders(angle, error, fitted)
            seen = significant(found)
            seen = seen if first_order else seen[found.order[seen] > 1]
            made = correction(
                found.order[seen],
                found.value[seen],
                sd=found.sd[seen],
                ratio=ratio,
                angle_sd=angle_sd,
                count=count,
            )
        except ValueError as problem:
            raise StudyError(f"{where}: {problem}") from None
        curves.append(Curve(torque, direction, angle, error, found, made))
    return Corrections(tuple(curves), schedule({(c.torque, c.direction): c.correction for c in curves}))


def _curves(path: Path) -> dict[tuple[float, str], list[tuple[float, float]]]:
    """Points in SI by torque and direction; a row without an error is no point."""
    table = read_table(path)
    for name in ("angle", "error"):
        if name not in table.numbers:
            have = ", ".join([*table.numbers, *table.words]) or "no column that is known"
            raise StudyError(f'{path}: has no column "{name} [{UNITS[name]}]"; it has {have}')
    nothing = np.full(len(table.rows), math.nan)
    torque, direction = table.numbers.get("torque", nothing), table.words.get("direction", [""] * len(table.rows))
    found: dict[tuple[float, str], list[tuple[float, float]]] = {}
    for row, angle, error, load, way in zip(table.rows, *(table.numbers[n] for n in UNITS), torque, direction):
        if math.isnan(error):
            continue
        if math.isnan(angle):
            raise StudyError(f"{path}: row {row}, angle is empty")
        found.setdefault((0.0 if math.isnan(load) else float(load), way), []).append((float(angle), float(error)))
    if not found:
        raise StudyError(f"{path}: holds no point")
    return found
