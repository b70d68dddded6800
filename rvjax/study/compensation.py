"""Measured curves of a unit, and their corrections."""

import csv
import dataclasses
from pathlib import Path

import numpy as np

from rvjax.compensation import Correction, Schedule, correction, schedule
from rvjax.compensation.significant import significant
from rvjax.designs import RVReducer
from rvjax.identify import Orders, orders
from rvjax.study.question import Study, StudyError
from rvjax.study.values import finite
from rvjax.units import arcsec, deg

COLUMNS = {"angle [deg]": deg, "error [arcsec]": arcsec}
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
        path: of the file: "angle [deg]", "error [arcsec]" and, if wanted, "torque [N m]" and "direction".
        angle_sd: of the table's zero, rad of the output.
        count: orders to store at most.
        first_order: order 1 is the reducer's and not the mounting of the encoder.

    Raises:
        StudyError: names file, line, column and value.
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
    """Points in SI by torque and direction."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file, restval="", skipinitialspace=True)
            names = [name.strip() for name in rows.fieldnames or []]
            rows.fieldnames = names
            missing = [name for name in COLUMNS if name not in names]
            if missing:
                raise StudyError(f"{path}: has no column {missing[0]!r}; it has {', '.join(names) or 'none'}")
            found: dict[tuple[float, str], list[tuple[float, float]]] = {}
            for row in rows:
                where = f"{path}, line {rows.line_num}"
                if None in row:
                    raise StudyError(f"{where}: has more cells than columns")
                torque = finite(row.get("torque [N m]") or "0", f"{where}: torque [N m]")
                point = tuple(finite(row[name], f"{where}: {name}") * size for name, size in COLUMNS.items())
                found.setdefault((torque, (row.get("direction") or "").strip()), []).append((point[0], point[1]))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such file of curves") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StudyError(f"{path}: cannot be read ({error})") from None
    if not found:
        raise StudyError(f"{path}: holds no point")
    return found
