"""Cells and tables of several commands.

Limits of errors, evaluated values, prices, failed units; properties of a measurement.
"""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rvjax.measured import Finding
from rvjax.outputs import Output
from rvjax.render import (
    CSV,
    PAGE,
    TEXT,
    Column,
    Content,
    Figure,
    Number,
    Quantity,
    Section,
    Table,
    Text,
    Zone,
    column,
    number,
)
from rvjax.study import COARSE, Size, Study
from rvjax.tolerances import Allocation, Estimate, Limits, Statistics, Tolerance, Verdict, slopes_change_sign
from rvjax.units import mm, readable, rpm, suited, um, with_unit


def limits_of(study: Study, field: str, tolerance: Tolerance) -> Zone:
    """The limits of an error, as the study states them: like a drawing, or about their mid-point.

    Args:
        study: that the error belongs to.
        field: name of the error.
        tolerance: of the error; not that of the study where it is allocated.
    """
    ends = float(tolerance.middle), study.unit(field), float(tolerance.lower), float(tolerance.upper)
    form = study.forms.get(field)
    if form is None or not form.stated or (drawn := form.number(tolerance)) is None:
        return Zone(*ends)
    return Zone(*ends, stated=form.stated, drawn=drawn)


def limit_text(requirement: Limits | None, output: Output) -> str:
    """The limits of a response, such as "<= 1 arcmin"; "" where there are none.

    Args:
        requirement: with its limits.
        output: what the response is.
    """
    if requirement is None:
        return ""
    bounds = ((">=", requirement.lower), ("<=", requirement.upper))
    return " and ".join(f"{sign} {output.text(limit)}" for sign, limit in bounds if math.isfinite(limit))


def against_limit(value: float, requirement: Limits, output: Output) -> str:
    """A value and its nearer limit, such as "4,780 h, below 6000 h".

    Args:
        value: SI.
        requirement: with limits of the value.
        output: what the value is.
    """
    beyond = {"below": requirement.lower - value, "above": value - requirement.upper}
    side = max(beyond, key=lambda name: beyond[name])
    limit = output.text(requirement.lower if side == "below" else requirement.upper)
    return f"{output.text(value, ',.4g')}, {side if beyond[side] > 0 else 'limit'} {limit}"


def share(estimate: Estimate) -> Quantity:
    """A yield with its interval."""
    return Quantity.of(estimate, read_in="%", form=".3f")


def evaluated(verdict: Verdict, output: Output) -> Quantity:
    """The value that a requirement evaluates, with its interval.

    Args:
        verdict: on the requirement.
        output: what the response is.
    """
    if verdict.kind == "share":
        return share(verdict.estimate)
    if verdict.kind == "response":
        return Quantity.of(verdict.estimate, output.unit, output.read_in)
    return Quantity.of(verdict.estimate)


def met_text(requirement: Limits, verdict: Verdict, samples: int) -> str:
    """Text on a requirement: met, not met, or met by the estimate while the interval of so few units is too wide.

    Args:
        requirement: as required.
        verdict: on it.
        samples: units behind the verdict.
    """
    one, value = verdict.estimate, verdict.estimate.value
    if verdict.met:
        return "met"
    unsure = requirement.holds(Estimate(value, 0.0, value, value)) and not requirement.holds(one)
    return f"not shown with {samples:,} units" if unsure else "not met"


def rejects_texts(study: Study, found: Statistics) -> dict[str, str]:
    """A line for each response with the only limit zero on what units below do, such as "1.2 % of the units jam".

    Args:
        study: with the limits.
        found: statistics of units; failed ones are not below.
    """
    lines = {}
    for name, verdict in (found.verdicts or {}).items():
        verb, limits = study.output(name).rejects, study.requirements[name]
        if verb and verdict.kind == "share" and limits.lower == 0 and math.isinf(limits.upper):
            below = 1 - verdict.estimate.value - found.failed / found.samples
            lines[name] = f"{100 * max(below, 0.0):.3g} % of the units {verb} ({name} below 0)"
    return lines


def binding(found: Allocation, name: str) -> float:
    """d cost / d limit of a response; 0 where its interval contains zero: the limit is not shown to bind.

    Args:
        found: the optimum.
        name: of the response.
    """
    lower, upper = found.multiplier_intervals.get(name, (-math.inf, -math.inf))
    return 0.0 if lower <= 0 <= upper else found.multipliers.get(name, 0.0)


def price_text(study: Study, prices: Mapping[str, float]) -> str:
    """Text on the meaning of shadow prices, such as "100 h less life saves 0.98"; "" if no limit binds.

    Args:
        study: with the limits.
        prices: change of the cost if both limits of a response move outwards, per SI unit, by response.
    """
    said = []
    for name, requirement in study.requirements.items():
        unit, size = study.output(name).shown
        ends = {"more": requirement.upper, "less": requirement.lower}
        limited = {way: abs(limit) / size for way, limit in ends.items() if math.isfinite(limit)}
        if not prices[name] < 0 or not limited:
            continue
        largest = max(limited.values())
        step = 10.0 ** math.floor(math.log10(largest / 10)) if largest > 0 else 1.0
        saved = f"saves {-prices[name] * step * size:.3g}"
        if len(limited) > 1:
            said.append(f"{with_unit(step, unit, 'g')} wider limits of {requirement.prefix}{name} save{saved[5:]}")
        else:
            said.append(f"{with_unit(step, unit, 'g')} {next(iter(limited))} {requirement.prefix}{name} {saved}")
    return f"shadow price: {'; '.join(said)}." if said else ""


def failures_text(found: Statistics) -> str:
    """Text on failed units: number, statuses, and one unit of each status; on units with an infinite response."""
    text = "0 failed"
    if found.failed:
        kinds = (f"{count:,} {name} (unit {found.examples[name]})" for name, count in found.failures.items())
        text = f"{found.failed:,} failed, each a reject in every yield: {', '.join(kinds)}"
    endless = ", ".join(f"{name} of {count:,} units" for name, count in found.infinite.items() if count)
    return f"{text}; infinite: {endless} (mean, sd and Cpk exclude them)" if endless else text


def searched_texts(study: Study, tolerances: object) -> list[str]:
    """A line for each limited worst case that is the result of a search, because slopes change sign.

    Args:
        study: with the limits.
        tolerances: of the errors.
    """
    limited = [name for name, requirement in study.requirements.items() if requirement.of_extremes]
    bent = slopes_change_sign(study.response(solve=False), tolerances) if limited else {}
    why = "slopes change sign within the limits of the errors; the value is the worst of a search"
    return [f"Worst case of {name}: {why}, not certainly the worst." for name in limited if bent[name]]


def condition_text(value: Any, about: Mapping[str, Any]) -> str:
    """A condition in units that a person reads; rows of a table such as "784 N m, 15 rpm, 1 h".

    Args:
        value: SI.
        about: metadata of its field, see `rvjax.outputs.condition`.
    """
    if about["columns"]:
        rows = (zip(row, about["columns"].values()) for row in value)
        return "; ".join(", ".join(_suited(number, unit) for number, unit in row) for row in rows)
    return str(value) if about["unit"] in (None, "-") else _suited(value, about["unit"])


def _suited(value: float, unit: str) -> str:
    name, size = ("rpm", rpm) if unit == "rad/s" else suited(value, unit) if value else (unit, 1.0)
    return f"{value / size:.4g} {name}"


def limits_data(study: Study, field: str, tolerance: Tolerance) -> dict[str, object]:
    """Limits and distribution of a tolerance as JSON values, SI, with form and number of the drawing if it has them.

    Args:
        study: that the error belongs to.
        field: name of the error.
        tolerance: of the error.
    """
    lower, upper, cp, shift = (float(getattr(tolerance, name)) for name in ("lower", "upper", "cp", "shift"))
    zone = limits_of(study, field, tolerance)
    drawn = {} if zone.drawn is None else {"form": zone.stated, "drawing": zone.drawn}
    return {"lower": lower, "upper": upper, "distribution": tolerance.distribution, "cp": cp, "shift": shift, **drawn}


def assumed_text(study: Study) -> str:
    """List the assumed values; if all values of a part are assumed, only the part."""
    stated = [number for number in study.numbers if number.origin != "default"]
    known = {number.path.rpartition(".")[0] for number in stated if not number.assumed} | {""}
    paths = (number.path for number in stated if number.assumed)
    parts = (path if path.rpartition(".")[0] in known else path.rpartition(".")[0] for path in paths)
    return ", ".join(dict.fromkeys(parts))


@dataclass(frozen=True)
class SizeRow:
    """A size for the drawing, see `rvjax.study.Size`."""

    part: str = column(Text("part"))
    feature: str = column(Text("feature", wraps=True))
    count: int = column(Column("count"))
    nominal: float | None = column(Number("nominal [mm]", form=".7g"))
    upper: float | None = column(Number("upper [um]", form=".2f"))
    lower: float | None = column(Number("lower [um]", form=".2f"))
    grade: str = column(Text("grade"))
    geometric: str = column(Text("geometric", wraps=True))
    datum: str = column(Text("datum", wraps=True))
    error: str = column(Text("error"))


def sizes_table(rows: Sequence[Size]) -> Table:
    """Sizes for the drawing; in a file all digits of the limits. Limits that are no lengths have their unit in the row.

    Args:
        rows: as `rvjax.study.sizes_of` gives them.
    """
    found = []
    for row in rows:
        name, unit = ("%", 0.01) if row.unit == "-" else readable(row.unit)
        feature = row.feature if row.unit == "m" else f"{row.feature} [{name}]"
        upper, lower = (None if end is None else float(f"{end / unit:.13g}") for end in (row.upper, row.lower))
        ends = number(row.nominal, mm), upper, lower
        found.append(SizeRow(row.part, feature, row.count, *ends, row.grade, row.geometric, row.datum, row.error))
    note = (
        "A size is its nominal plus one deviation from each of its rows. An upper limit alone is the width of a zone. "
        "A nominal is the target, rounded to 1 um, or to 10 um where all half-widths of its errors exceed "
        f"{COARSE / um:g} um (assumed)."
    )
    return Table.of(SizeRow, "sizes", found, caption="Sizes for the drawing:", note=note)


MOST = 4  # items whose findings the text and the page show; the file has all
LARGE = 0.02  # rad: angles above are read in deg, others in arcsec
MOST_WARNINGS = 12


@dataclass(frozen=True)
class FindingRow:
    """A property of a measurement."""

    measured: str = column(Text("measured"))
    name: str = column(Text("property"))
    value: Quantity | str = column(Column("value"))
    unit: str = column(Text("unit", on=frozenset({CSV})))
    remark: str = column(Text("remark", wraps=True))


def measurement_section(found: Mapping[str, Sequence[Finding]], figures: Sequence[Figure] = ()) -> list[Content]:
    """The section; empty without findings.

    Args:
        found: findings by the name of what was measured; "" for a single item.
        figures: plots of the measurement.
    """
    if not any(found.values()):
        return []
    findings = [(name, f, _quantity(f)) for name, several in found.items() for f in several]
    rows = [FindingRow(name, f.name, size, size.shown[0], f.text) for name, f, size in findings]
    content: list[Content] = [Table.of(FindingRow, "measurement", rows, on=frozenset({CSV}))]
    if len(found) <= MOST:
        table = functools.partial(Table.of, FindingRow, "measurement", without=() if len(found) > 1 else ("measured",))
        plain = [row for row, (_, f, _) in zip(rows, findings) if not f.warning]
        content.append(table(plain, caption="The measurement:", on=frozenset({TEXT})))
        content.append(table(rows, on=frozenset({PAGE})))
    return [Section("The measurement", (*content, *figures))]


def measurement_warnings(found: Mapping[str, Sequence[Finding]]) -> list[str]:
    """A line for each warning.

    Args:
        found: findings by the name of what was measured.
    """
    lines = []
    for name, several in found.items():
        for finding in several:
            if finding.warning:
                size = finding.name if finding.unit == "-" else f"{finding.name}, {_quantity(finding).text('.4g')}"
                lead = f"{name}: " if name and len(found) > 1 else ""
                lines.append(f"warning: {lead}{size}: {finding.text}")
    left = len(lines) - MOST_WARNINGS
    return lines if left <= 0 else [*lines[:MOST_WARNINGS], f"warning: {left} more; the file measurement.csv has all"]


def findings_data(several: Sequence[Finding]) -> list[dict[str, object]]:
    """Findings as JSON values, SI.

    Args:
        several: of one item.
    """
    return [{"name": f.name, "value": f.value, "unit": f.unit, "text": f.text, "warning": f.warning} for f in several]


def _quantity(finding: Finding) -> Quantity:
    """The number in the unit that a person reads."""
    angle = "deg" if abs(finding.value) > LARGE else "arcsec"
    return Quantity(finding.value, finding.unit, read_in=angle if finding.unit == "rad" else None)
