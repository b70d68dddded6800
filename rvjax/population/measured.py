"""Tolerances from measured parts: distributions of their errors, with confidence intervals for the sample size."""

import dataclasses
import itertools
import math
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from rvjax.base import frames
from rvjax.base.cells import read_cells
from rvjax.base.columns import name_and_unit, read_table, split
from rvjax.base.fields import axis_sizes
from rvjax.base.words import unknown
from rvjax.population.distributions import in_steps, step_of
from rvjax.population.estimates import Estimate, deviate_of
from rvjax.population.tolerance import Tolerance
from rvjax.records import Design, Metadata, PyTree
from rvjax.units import KNOWN, recognised, spelling

Limit = Tolerance | tuple[float, float]
NATURAL = 3.0
"""Standard deviations to each side of the mean that are the limits of an error without given limits."""
_EVERY_UNIT = {unit: size for family in KNOWN.values() for unit, size in family.items()}


@dataclasses.dataclass(frozen=True)
class MeasuredColumn:
    """Statistics of one column: an error or one of its elements; SI. Intervals are those of normal errors.

    Attributes:
        unit: SI unit.
        n: parts measured.
        distinct: different readings among them.
        step: of the instrument: one unit of the last digit, or the least difference where readings mostly repeat.
        mean: with Student's interval.
        sd: of the lot, divisor n - 1, with the chi-square interval; at least step/sqrt(12), the sd of rounding, with
            the lower end of the readings themselves.
        minimum: smallest value.
        maximum: largest value.
        limits: lower and upper, None where none are given.
        cpk: min(U - mean, mean - L)/(3 sd) with the interval of Bissell (1990): its error is
            sqrt(1/(9 n) + Cpk^2/(2 (n - 1))); None without limits.
    """

    unit: str
    n: int
    distinct: int
    step: float
    mean: Estimate
    sd: Estimate
    minimum: float
    maximum: float
    limits: tuple[float, float] | None
    cpk: Estimate | None


@dataclasses.dataclass(frozen=True)
class MeasuredParts:
    """Tolerances and statistics of a table of measured parts.

    Attributes:
        tolerances: {field: `Tolerance` of the distribution "empirical"}; columns of several elements of a field make
            one distribution.
        columns: statistics by field or element.
        together: parts of which all columns were measured.
        pairs: correlation of the normal scores of two columns over these parts, with Fisher's interval.
        still: columns that do not vary over these parts.
        source: name of the file.
    """

    tolerances: dict[str, Tolerance]
    columns: dict[str, MeasuredColumn]
    together: int
    pairs: dict[tuple[str, str], Estimate]
    still: tuple[str, ...]
    source: str

    @property
    def correlation(self) -> dict[tuple[str, str], float]:
        """{(field or element, field or element): correlation of their z}, as `correlation=` takes it.

        A column for all elements of a field is excluded: the measured element is unknown.

        Raises:
            ValueError: too few parts for so many columns, a column that does not vary, or columns that follow from each
                other.
        """
        single = [name for name in self.columns if "[" in name or not self.tolerances[name].shape]
        if len(single) > 1 and (still := [name for name in single if name in self.still]):
            raise ValueError(
                f"{self.source}: {', '.join(still)}: {self.together} equal readings do not vary: no correlation; "
                "leave the column out (columns=), or measure with a finer step"
            )
        found = {pair: self.pairs[pair].value for pair in itertools.combinations(single, 2)}
        matrix = np.eye(len(single))
        for (first, second), value in found.items():
            i, j = single.index(first), single.index(second)
            matrix[i, j] = matrix[j, i] = value
        if found and not (np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 1e-9 * len(matrix)):
            raise ValueError(
                f"{self.source}: {self.together} parts with all of {', '.join(single)} do not give a correlation of "
                f"{len(single)} columns: more parts than columns are needed, and none that follows from others"
            )
        return found

    def to_pandas(self) -> "frames.DataFrame":
        """Return a `pandas.DataFrame`, SI: one row for each column, every statistic with its error and interval."""

        def row(name: str, found: MeasuredColumn) -> dict[str, object]:
            lower, upper = found.limits or (math.nan, math.nan)
            said = {
                "error": name,
                "unit": found.unit,
                "n": found.n,
                "distinct": found.distinct,
                "lower_limit": lower,
                "upper_limit": upper,
            }
            said |= {"minimum": found.minimum, "maximum": found.maximum}
            said |= frames.spread("mean", found.mean) | frames.spread("sd", found.sd)
            nothing = Estimate(math.nan, math.nan, math.nan, math.nan)
            return said | frames.spread("cpk", found.cpk or nothing)

        return frames.tidy(itertools.starmap(row, self.columns.items()), ["error"])


def measured(
    path: str | Path,
    columns: Mapping[str, str | Mapping[str, str]] | None = None,
    *,
    design: Design | None = None,
    limits: object = None,
    confidence: float = 0.95,
    encoding: str | None = None,
) -> MeasuredParts:
    """Tolerances that follow measured parts, from a CSV file with a row for each part.

    The limits of an error without given limits are mean -+ 3 sd. A distribution never goes beyond the values it was
    measured at: n parts do not show what fewer than one in 2 n parts does. Where the sd of the readings is below a step
    of the instrument, a warning names the column; equal readings then fill the step that they were rounded to.

    Args:
        path: the file: a header "name [unit]"; commas, semicolons or tabs, decimal commas where no comma separates; an
            empty cell was not measured.
        columns: {field or element, such as "disc_bore[0,1,0]": header of its column, or {"column", "unit"} where that
            has no unit}; None: every column whose header is a name and a known unit.
        design: whose error record declares names, units and shapes; without it every known unit is used as given.
        limits: record or dict with a `Tolerance`, (lower, upper) or None by field, for Cpk and the tolerances; one of
            the two may be infinite, and is mean - 3 sd or mean + 3 sd in the tolerance.
        confidence: of every interval.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Returns:
        `MeasuredParts`.

    Raises:
        ValueError: names file, column or row, value and unit; fewer than two parts; an unknown field.
        FileNotFoundError: there is no such file.
    """
    deviate_of(confidence)
    about = None if design is None else {f.name: f.metadata for f in dataclasses.fields(design.error_record)}
    wanted = _found(path, about, encoding) if columns is None else dict(columns)
    units = {name: _family(name, about) for name in wanted}
    read = read_table(path, wanted, units=units, encoding=encoding)
    shown = {name: "turn" if unit == "count" else unit for name, unit in read.shown.items()}
    si = {name: next(si for si, own in KNOWN.items() if unit in own) for name, unit in shown.items()}
    given = _limits(limits)
    figures, filled = {}, {}
    for name in wanted:
        values = read.numbers[name][~np.isnan(read.numbers[name])]
        if len(values) < 2:
            raise ValueError(f"{path}: {name}: {len(values)} parts measured, at least 2 are needed")
        step = step_of(values, read.digits[name])
        figures[name] = found = _figures(values, step, si[name], given.get(_field(name)), confidence)
        filled[name] = in_steps(values, step)
        if filled[name] is not values:
            if _is_positive(given.get(_field(name)), (about or {}).get(_field(name), {})) and values.min() >= 0:
                filled[name] = np.maximum(filled[name], 0.0)
            own = shown[name]
            warnings.warn(
                f"{path}: {name}: {len(values)} readings with {found.distinct} different values, in steps of "
                f"{step / _family(name, about)[own]:.3g} {own}: their spread below a step is not known",
                stacklevel=2,
            )
    groups: dict[str, list[str]] = {}
    for name in wanted:
        groups.setdefault(_field(name), []).append(name)
    made = {}
    for field, names in groups.items():
        if len(names) > 1 and field in names:
            raise ValueError(f"{path}: {field} has both a column and columns of elements: {', '.join(names)}")
        pooled = np.concatenate([filled[name] for name in names])
        made[field] = _tolerance(field, names, pooled, given.get(field), design, about)
    whole = np.array([read.numbers[name] for name in wanted])
    whole = whole[:, ~np.isnan(whole).any(0)]
    still = tuple(name for name, row in zip(wanted, whole) if len(row) > 1 and not np.ptp(row))
    return MeasuredParts(made, figures, whole.shape[1], _pairs(list(wanted), whole, confidence), still, str(path))


def _found(path: str | Path, about: Mapping[str, Metadata] | None, encoding: str | None) -> dict[str, str]:
    """Columns by name, of those with a known unit in the header."""

    def has_unit(header: str) -> bool:
        return recognised(name_and_unit(header)[1] or "?", _EVERY_UNIT) is not None

    header = read_cells(path, named=has_unit, encoding=encoding).header
    plain = {split(text)[0]: text for text in header if spelling(split(text)[1] or "?") in _EVERY_UNIT}
    found = plain or {name_and_unit(text)[0]: text for text in header if has_unit(text)}
    if about is not None:
        found = {name: text for name, text in found.items() if _field(name) in about}
    if not found:
        raise ValueError(f'{path}: no column is called as an error with its unit, such as "pin_radius [um]"')
    return found


def _family(name: str, about: Mapping[str, Metadata] | None) -> Mapping[str, float]:
    """Units that a column may have."""
    if about is None:
        return _EVERY_UNIT
    if _field(name) not in about:
        raise unknown(f"columns: {name!r}", name, sorted(about), " is no error of this design; it has")
    return KNOWN[about[_field(name)]["unit"]]


def _is_positive(given: Limit | None, about: Metadata) -> bool:
    return about.get("sign", "any") != "any" or (isinstance(given, Tolerance) and given.clearance)


def _field(name: str) -> str:
    return name.partition("[")[0]


def _limits(limits: PyTree) -> dict[str, Limit]:
    given = limits or {}
    if not isinstance(given, Mapping):
        given = {f.name: getattr(given, f.name) for f in dataclasses.fields(given)}
    found = {}
    for name, item in given.items():
        if item is None or item == (-math.inf, math.inf):
            continue
        pair = isinstance(item, tuple) and len(item) == 2 and item[0] <= item[1]
        if not isinstance(item, Tolerance) and not (pair and item[0] < math.inf and item[1] > -math.inf):
            raise ValueError(f"limits: {name} = {item!r}: must be a Tolerance, or (lower, upper) in SI")
        found[name] = item
    return found


def _figures(values: np.ndarray, step: float, unit: str, given: Limit | None, confidence: float) -> MeasuredColumn:
    n, mean, seen = len(values), float(values.mean()), float(values.std(ddof=1))
    sd = max(seen, step / math.sqrt(12))
    tail, error = (1 - confidence) / 2, sd / math.sqrt(n)
    middle = Estimate.about(mean, error, float(special.stdtrit(n - 1, 1 - tail)))
    ends = (s * math.sqrt((n - 1) / float(special.chdtri(n - 1, p))) for s, p in ((seen, tail), (sd, 1 - tail)))
    spread = Estimate(sd, sd / math.sqrt(2 * (n - 1)), *ends)
    limits = cpk = None
    if given is not None:
        low, high = (given.lower, given.upper) if isinstance(given, Tolerance) else given
        limits = float(low), float(high)
        cpk = _capability(mean, sd, n, limits, confidence)
    distinct = len(np.unique(values))
    return MeasuredColumn(
        unit, n, distinct, step, middle, spread, float(values.min()), float(values.max()), limits, cpk
    )


def _capability(mean: float, sd: float, n: int, limits: tuple[float, float], confidence: float) -> Estimate:
    """Cpk with the interval of Bissell (1990)."""
    room = min(limits[1] - mean, mean - limits[0])
    value = room / (3 * sd)
    error = math.sqrt(1 / (9 * n) + value**2 / (2 * (n - 1)))
    return Estimate.about(value, error, deviate_of(confidence))


def _tolerance(
    field: str,
    names: list[str],
    values: np.ndarray,
    given: Limit | None,
    design: Design | None,
    about: Mapping[str, Metadata] | None,
) -> Tolerance:
    law: dict[str, Any] = dict(distribution="empirical", values=values)
    places = [tuple(map(int, re.findall(r"\d+", name[len(field) :]))) for name in names]
    shape = given.shape if isinstance(given, Tolerance) else ()
    if design is not None and about is not None:
        shape = axis_sizes(about[field]["shape"], design.counts, shape)
    elif not shape and places[0]:
        shape = tuple(max(place[axis] for place in places) + 1 for axis in range(len(places[0])))
    for name, place in zip(names, places):
        if place and (len(place) != len(shape) or any(k >= size for k, size in zip(place, shape))):
            raise ValueError(f"columns: {name!r} is no element of shape {shape}")
    if isinstance(given, Tolerance):
        own = given.batch if names == [field] else 0.0  # measured elements determine their correlation
        return given.replace(**law, shape=shape, cp=1.0, shift=0.0, batch=own)
    mean, sd = float(values.mean()), float(values.std(ddof=1))
    low, high = given or (-math.inf, math.inf)
    low, high = (
        low if math.isfinite(low) else min(mean - NATURAL * sd, high),
        high if math.isfinite(high) else max(mean + NATURAL * sd, low),
    )
    return Tolerance(low, high, shape=shape, **law)


def _pairs(names: list[str], values: np.ndarray, confidence: float) -> dict[tuple[str, str], Estimate]:
    """Correlation of normal scores, which estimates that of a Gaussian copula for any distributions of the columns.

    Boudt, Cornelissen and Croux (2012); the interval is that of atanh r, whose error is 1/sqrt(n - 3) (Fisher 1921).
    """
    from scipy import stats  # slow to import

    n, found = values.shape[1], {}
    scores = special.ndtri((stats.rankdata(values, axis=1) - 0.5) / max(n, 1))
    scores -= scores.mean(1, keepdims=True) if n else 0.0
    size = np.sqrt((scores**2).sum(1))
    for i, j in itertools.combinations(range(len(names)), 2):
        if n < 2 or size[i] * size[j] == 0:  # a column without spread goes with nothing
            found[names[i], names[j]] = Estimate(math.nan, math.nan, math.nan, math.nan)
            continue
        r = float(np.clip(scores[i] @ scores[j] / (size[i] * size[j]), -1.0, 1.0))
        way = deviate_of(confidence) / math.sqrt(n - 3) if n > 3 else math.inf
        ends = (math.tanh(math.atanh(r) + side * way) if abs(r) < 1 and n > 3 else side * 1.0 for side in (-1, 1))
        found[names[i], names[j]] = Estimate(r, (1 - r**2) / math.sqrt(n - 1), *ends)
    return found
