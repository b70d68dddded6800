"""Sizes for the drawing: nominal, limits, grade and geometric tolerance of the features of the parts, from tolerances.

A size is its nominal plus one deviation from each row with the same numbers of the design. The nominal is the target:
number of the design plus mid-points of its errors, rounded to a step of the process. The first row has the rest.
"""

import dataclasses
import math
from collections.abc import Sequence
from decimal import Decimal

from rvjax.population import Tolerance, coarsest_grade
from rvjax.records import Design, Record
from rvjax.study.kinds import kind_of, number_at
from rvjax.study.kinds.kind import Feature
from rvjax.study.tolerances import FORMS, by_error, metadata
from rvjax.units import mm, um

DIGITS, COARSE_DIGITS = 3, 2
"""Decimals of a nominal in mm: steps of 1 um, and of 10 um for coarse processes such as 3D print. Assumed."""
COARSE = 25 * um
"""Half-width of an error; a size whose errors all exceed it is of a coarse process. Assumed."""
GEOMETRIC = {
    "position": "position, diametral (ISO 1101)",
    "runout": "circular runout (ISO 1101)",
    "cumulative": "total cumulative pitch deviation Fp (ISO 1328)",
}
COMPONENTS = {"polar": "position, radial and tangential", "xy": "position, x and y"}
"""Of vectors with limits of each component."""


@dataclasses.dataclass(frozen=True)
class Size:
    """A row of the drawing.

    Attributes:
        part: its name, with the number of equal parts.
        feature: of one part.
        count: equal features of one part.
        nominal: m; None where the design does not have it.
        upper: upper deviation from the nominal, or width of the zone of a geometric tolerance; SI.
        lower: lower deviation, SI; None for a zone.
        grade: of a diameter, the coarsest ISO 286 grade inside the limits; "" for none.
        geometric: characteristic of a geometric tolerance; "" for a size.
        datum: of a geometric tolerance.
        error: that has the tolerance.
        unit: SI unit of both limits.
    """

    part: str
    feature: str
    count: int
    nominal: float | None
    upper: float
    lower: float | None
    grade: str
    geometric: str
    datum: str
    error: str
    unit: str


def sizes_of(design: Design, tolerances: Record) -> list[Size]:
    """Rows of the drawing for all errors with a tolerance, part by part.

    Args:
        design: the reducer, with the numbers that deviations refer to.
        tolerances: record with a Tolerance or None in each field.
    """
    given = by_error(tolerances)
    features = {name: _feature(design, name) for name in given}
    sized: dict[frozenset[str], list[str]] = {}
    for name, feature in features.items():
        if feature.nominal and not feature.form:
            sized.setdefault(feature.size, []).append(name)
    rows = []
    for name, feature in features.items():
        names = sized.get(feature.size, [])
        nominal, rest = _target(design, feature, [(features[n].factor, given[n]) for n in names])
        rows.append(_row(design, name, feature, given[name], nominal, rest if names[:1] == [name] else 0.0))
    parts = list(dict.fromkeys(row.part for row in rows))
    return sorted(rows, key=lambda row: parts.index(row.part))


def _feature(design: Design, error: str) -> Feature:
    """Feature that an error belongs to; without a table for its kind, part and meaning of the error."""
    about = metadata(design.error_record, error)
    return kind_of(design).features.get(error, Feature(about["part"], about["meaning"]))


def _target(
    design: Design, feature: Feature, deviations: Sequence[tuple[float, Tolerance]]
) -> tuple[float | None, float]:
    """Nominal of a size in m, and how much it exceeds the number of the design; not rounded without deviations."""
    numbers = [(factor, number_at(design, path)) for path, factor in feature.nominal.items()]
    if not numbers or any(number is None for _, number in numbers):
        return None, 0.0
    due = float(f"{sum(factor * float(number) for factor, number in numbers) / mm:.15g}")
    if not deviations:
        return due * mm, 0.0
    coarse = min(float(one.half_width) for _, one in deviations) > COARSE
    middle = sum(factor * float(one.middle) for factor, one in deviations) / mm
    nominal = round(due + middle, COARSE_DIGITS if coarse else DIGITS)
    return nominal * mm, float(Decimal(str(nominal)) - Decimal(str(due))) * mm  # without cancellation


def _row(
    design: Design, error: str, feature: Feature, tolerance: Tolerance, nominal: float | None, rest: float
) -> Size:
    """The row of one error; its limits are about the nominal, which exceeds the number of the design by the rest."""
    about, form = metadata(design.error_record, error), FORMS.get(feature.form)
    lower, upper = (feature.factor * float(end) - rest for end in (tolerance.lower, tolerance.upper))
    zone = form.number(tolerance) if form and (tolerance.law.of_vectors or not form.vector) else None
    geometric = feature.geometric or GEOMETRIC.get(feature.form, "")
    if zone is None and form and form.vector:
        geometric = COMPONENTS[about["vector"]]
    parts = design.counts.get(feature.each, 1)
    return Size(
        part=f"{feature.part}, {parts} x" if parts > 1 else feature.part,
        feature=feature.feature,
        count=math.prod(design.counts[axis] for axis in feature.count),
        nominal=nominal,
        upper=upper if zone is None else zone,
        lower=lower if zone is None else None,
        grade="" if geometric or nominal is None or feature.factor != 2 else coarsest_grade(upper - lower, nominal),
        geometric=geometric,
        datum=feature.datum,
        error=error,
        unit=about["unit"],
    )
