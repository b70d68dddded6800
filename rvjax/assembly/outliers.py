"""Parts whose errors lie far beyond their limits, or beyond all others: mostly a wrong unit, or a wrong sign."""

import dataclasses
from collections.abc import Hashable

import jax
import numpy as np

from rvjax.assembly.parts import Kind, Path, at_path
from rvjax.base.columns import element
from rvjax.tolerances import Tolerance

_HALF_WIDTHS = 3.0  # from the middle of the limits: nine standard deviations of a process that just fills them
_SPREADS = 10.0  # from the median of the lot, by its median deviation: no lot of one process has such a part
_LOT = 6  # parts that show a spread
_FEW = 0.2  # of the parts; more are a lot of their own
_GAUGE = 4.0  # standard deviations of the measurement


class UnusualPart(UserWarning):
    """A part whose errors lie far beyond their limits, or beyond those of all others."""


@dataclasses.dataclass(frozen=True)
class Outlier:
    """One error of one part.

    Attributes:
        id: of the part.
        name: of the error or its element.
        value: measured, SI.
        away: its distance, in the half-widths or spreads of `measure`.
        measure: what the distance is counted in, as a text.
    """

    id: Hashable
    name: str
    value: float
    away: float
    measure: str

    def text(self, part: str, value: str) -> str:
        """One line.

        Args:
            part: its name for the reader.
            value: with its unit.
        """
        return f"{part}: {self.name} = {value} lies {self.away:.3g} {self.measure}; check its unit and sign"


def outliers(kind: Kind) -> tuple[Outlier, ...]:
    """Parts that do not belong to the others, the furthest first; at most one error of each.

    An error counts that lies more than 3 half-widths from the middle of its limits. So does one of few that lie more
    than 10 standard deviations of the lot from its median: without limits, beyond them, or at the median's mirror
    image. Four standard deviations of the measurement are allowed for.

    Args:
        kind: parts.
    """
    population = getattr(kind.population, "tolerances", kind.population)
    found: dict[Hashable, Outlier] = {}
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(kind.parts[0].errors)[0]]
    for path in paths:
        tolerance = at_path(population, path, None)
        for one in _of_error(kind, path, tolerance if isinstance(tolerance, Tolerance) else None):
            if one.id not in found or one.away > found[one.id].away:
                found[one.id] = one
    return tuple(sorted(found.values(), key=lambda one: -one.away))


def _of_error(kind: Kind, path: Path, tolerance: Tolerance | None) -> list[Outlier]:
    """Of all elements of one error."""
    read = [(part, np.asarray(at_path(part.errors, path, np.nan))) for part in kind.parts]
    shape = read[0][1].shape
    if any(values.shape != shape or np.iscomplexobj(values) for _, values in read):
        return []
    values = np.array([array for _, array in read], float)
    gauge = np.array([np.broadcast_to(np.asarray(at_path(part.sd, path, 0.0), float), shape) for part, _ in read])
    name, found = jax.tree_util.keystr(path, simple=True, separator=".") or "errors", []
    for place in np.ndindex(shape):
        column, noise = values[:, *place], gauge[:, *place]
        for k, away, measure in _of_column(column, noise, tolerance):
            found.append(Outlier(kind.parts[k].id, element(name, place), float(column[k]), away, measure))
    return found


def _of_column(values: np.ndarray, gauge: np.ndarray, tolerance: Tolerance | None) -> list[tuple[int, float, str]]:
    """Place, distance and its measure of the unusual ones of measured values (parts,)."""
    known = np.isfinite(gauge)
    noise = np.where(known, _GAUGE * gauge, 0.0)
    found: dict[int, tuple[int, float, str]] = {}
    outside = np.full(len(values), True)
    if tolerance is not None and tolerance.half_width > 0:
        vector = tolerance.is_vector  # a component lies on both sides of zero
        middle, half = (0.0, tolerance.upper) if vector else (tolerance.middle, tolerance.half_width)
        off = np.abs(values - float(middle)) - noise
        outside = off > float(half)
        for k in np.flatnonzero(known & (off > _HALF_WIDTHS * float(half))):
            away = float(abs(values[k] - float(middle)) / float(half))
            found[int(k)] = int(k), away, "half-widths from the middle of its limits"
    lot = values[known]
    if len(lot) < _LOT:
        return list(found.values())
    median = float(np.median(lot))
    spread = 1.4826 * float(np.median(np.abs(lot - median)))
    mirrored = (np.abs(values + median) < _SPREADS * spread) & (abs(median) > _SPREADS * spread)
    far = known & (np.abs(values - median) - noise > _SPREADS * spread) & (outside | mirrored)
    if 0 < far.sum() <= _FEW * len(lot) and spread > 0:
        for k in np.flatnonzero(far):
            away = float(abs(values[k] - median) / spread)
            found.setdefault(int(k), (int(k), away, "standard deviations of the lot from its median"))
    return list(found.values())
