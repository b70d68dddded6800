"""Parts with measured errors, kinds of parts, and parts unlike the others: mostly a wrong unit or sign."""

import dataclasses
import operator
from collections.abc import Hashable, Iterable, Sequence
from typing import SupportsIndex

import jax
import numpy as np

from rvjax.base.fields import element
from rvjax.records import PyTree, Record
from rvjax.tolerances import Tolerance

Path = tuple[PyTree, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One measured part.

    Attributes:
        id: what is written on it.
        errors: measured, SI: a record, a dict or a number.
        sd: standard deviation of the measurement, SI: one number, or of the structure of `errors`; inf: not measured.
            One number leaves out the fields of a record that are plain zeros in all parts.
    """

    id: Hashable
    errors: PyTree
    sd: PyTree = 0.0

    def __post_init__(self) -> None:
        leaves = jax.tree_util.tree_flatten_with_path(self.errors)[0]
        if not leaves:
            raise ValueError(f"part {self.id!r}: errors = {self.errors!r}: holds no number")
        for path, leaf in leaves:
            name = jax.tree_util.keystr(path, simple=True, separator=".") or "errors"
            try:
                numbers, spread = np.asarray(leaf), np.asarray(at_path(self.sd, path, 0.0), float)
                finite = np.isfinite(numbers).all()
            except (TypeError, ValueError):
                raise ValueError(f"part {self.id!r}: {name} = {leaf!r}: must be a number with a spread") from None
            if not finite:
                raise ValueError(f"part {self.id!r}: {name} = {leaf!r}: must be finite")
            if not (spread >= 0).all():
                raise ValueError(f"part {self.id!r}: sd of {name} = {spread.min():.6g}: must be zero or positive")
            if np.iscomplexobj(numbers) and spread.any():
                raise ValueError(f"part {self.id!r}: {name} = {leaf!r}: a complex error has no standard deviation")


@dataclasses.dataclass(frozen=True, eq=False)
class Kind:
    """All parts that may be mounted in a slot.

    Attributes:
        parts: in the order in which they lie there.
        indices: angular positions in which a part may be mounted.
        stock: pieces of each part (classes of pins or shims); None: one of each.
        population: tolerances that the parts come from, of the structure of their errors; None: unknown.
    """

    parts: Sequence[Part]
    _: dataclasses.KW_ONLY
    indices: int = 1
    stock: Sequence[int] | None = None
    population: PyTree = None

    def __post_init__(self) -> None:
        parts = tuple(self.parts) if isinstance(self.parts, Iterable) else (self.parts,)
        for part in parts:
            if not isinstance(part, Part):
                raise ValueError(f"parts: {part!r} must be a Part")
        object.__setattr__(self, "parts", parts)
        if not self.parts:
            raise ValueError("parts: must hold at least one part")
        seen = set()
        for part in self.parts:
            if part.id in seen:
                raise ValueError(f"part {part.id!r}: duplicate id")
            seen.add(part.id)
        if _whole(self.indices) < 1:
            raise ValueError(f"indices = {self.indices!r}: must be a whole number of at least 1")
        if self.stock is not None:
            if not isinstance(self.stock, Sequence | np.ndarray):
                raise ValueError(f"stock = {self.stock!r}: must be a sequence of whole numbers, one for each part")
            if len(self.stock) != len(self.parts):
                raise ValueError(f"stock: {len(self.stock)} numbers for {len(self.parts)} parts")
            for part, pieces in zip(self.parts, self.stock):
                if _whole(pieces) < 0:
                    raise ValueError(f"stock = {pieces!r} of part {part.id!r}: must be a whole number, 0 or more")
            if not sum(self.stock):
                raise ValueError("stock: must hold at least one piece")

    @property
    def pieces(self) -> np.ndarray:
        """Pieces of each part (parts,)."""
        return np.ones(len(self.parts), int) if self.stock is None else np.array(self.stock, int)


def _whole(number: SupportsIndex) -> int:
    try:
        return operator.index(number)
    except TypeError:
        return -1


def at_path(structure: object, path: Path, absent: object) -> PyTree:
    """Entry of a structure for a leaf of another structure: the leaf at its path, or the leaf above.

    Args:
        structure: dict, record, list, tuple, or a leaf for all.
        path: of the leaf, as `jax.tree_util` gives it.
        absent: where it has none.
    """
    for key in path:
        if not isinstance(structure, (dict, Record, list, tuple)) or isinstance(structure, Tolerance):
            return structure
        name = getattr(key, "key", getattr(key, "name", getattr(key, "idx", None)))
        if isinstance(structure, dict):
            structure = structure.get(name, absent)
        elif isinstance(structure, Record):
            structure = getattr(structure, str(name), absent)
        else:
            structure = structure[name] if isinstance(name, int) and name < len(structure) else absent
    return structure


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
    unusual: dict[Hashable, Outlier] = {}
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(kind.parts[0].errors)[0]]
    for path in paths:
        tolerance = at_path(population, path, None)
        for one in _of_error(kind, path, tolerance if isinstance(tolerance, Tolerance) else None):
            if one.id not in unusual or one.away > unusual[one.id].away:
                unusual[one.id] = one
    return tuple(sorted(unusual.values(), key=lambda one: -one.away))


def _of_error(kind: Kind, path: Path, tolerance: Tolerance | None) -> list[Outlier]:
    """Of all elements of one error."""
    read = [(part, np.asarray(at_path(part.errors, path, np.nan))) for part in kind.parts]
    shape = read[0][1].shape
    if any(values.shape != shape or np.iscomplexobj(values) for _, values in read):
        return []
    values = np.array([array for _, array in read], float)
    gauge = np.array([np.broadcast_to(np.asarray(at_path(part.sd, path, 0.0), float), shape) for part, _ in read])
    name, unusual = jax.tree_util.keystr(path, simple=True, separator=".") or "errors", []
    for place in np.ndindex(shape):
        column, noise = values[:, *place], gauge[:, *place]
        for k, away, measure in _of_column(column, noise, tolerance):
            unusual.append(Outlier(kind.parts[k].id, element(name, place), float(column[k]), away, measure))
    return unusual


def _of_column(values: np.ndarray, gauge: np.ndarray, tolerance: Tolerance | None) -> list[tuple[int, float, str]]:
    """Place, distance and its measure of the unusual ones of measured values (parts,)."""
    known = np.isfinite(gauge)
    noise = np.where(known, _GAUGE * gauge, 0.0)
    unusual: dict[int, tuple[int, float, str]] = {}
    outside = np.full(len(values), True)
    if tolerance is not None and tolerance.half_width > 0:
        vector = tolerance.is_vector  # a component lies on both sides of zero
        middle, half = (0.0, tolerance.upper) if vector else (tolerance.middle, tolerance.half_width)
        off = np.abs(values - float(middle)) - noise
        outside = off > float(half)
        for k in np.flatnonzero(known & (off > _HALF_WIDTHS * float(half))):
            away = float(abs(values[k] - float(middle)) / float(half))
            unusual[int(k)] = int(k), away, "half-widths from the middle of its limits"
    lot = values[known]
    if len(lot) < _LOT:
        return list(unusual.values())
    median = float(np.median(lot))
    spread = 1.4826 * float(np.median(np.abs(lot - median)))
    mirrored = (np.abs(values + median) < _SPREADS * spread) & (abs(median) > _SPREADS * spread)
    far = known & (np.abs(values - median) - noise > _SPREADS * spread) & (outside | mirrored)
    if 0 < far.sum() <= _FEW * len(lot) and spread > 0:
        for k in np.flatnonzero(far):
            away = float(abs(values[k] - median) / spread)
            unusual.setdefault(int(k), (int(k), away, "standard deviations of the lot from its median"))
    return list(unusual.values())
