"""Cells and tables of several commands: limits and influence of errors, evaluated values, prices, failed units."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rvjax.outputs import Output
from rvjax.records import PyTree
from rvjax.render import CSV, EVERYWHERE, Cell, Column, Interval, Note, Quantity, Table, Text, Zone, number
from rvjax.study import Study
from rvjax.tolerances import Allocation, Estimate, Influence, Limits, Statistics, Tolerance, Verdict, slopes_change_sign
from rvjax.units import readable, rpm, suited, with_unit


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


def limit_text(requirement: Limits, output: Output) -> str:
    """The limits of a response, such as "<= 1 arcmin".

    Args:
        requirement: with its limits.
        output: what the response is.
    """
    unit, size = output.shown
    bounds = ((">=", requirement.lower), ("<=", requirement.upper))
    return " and ".join(f"{sign} {with_unit(limit / size, unit)}" for sign, limit in bounds if math.isfinite(limit))


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


def searched_texts(study: Study, tolerances: PyTree) -> list[str]:
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


UNMOVED = "no slope"
UNMOVED_MEANS = (
    "no slope: raising and lowering the error act alike, or the model ignores it (share -); "
    "rms: slope of single units, root mean square."
)
SHARE_MEANS = "share: variance that the error causes, alone and with others [95 %]; scaled to sum to 100 %."
KNOWN = 5e-4  # half of the last digit of a share: no interval within it is shown


def influence_share(found: Influence, field: str) -> Quantity | None:
    """Share of an error in the variance, with its interval; None if the error does nothing.

    Args:
        found: influences on a response.
        field: name of the error.
    """
    one = found.shares[field]
    if one.value == 0 and found.scatter[field] == 0:
        return None
    if one.upper - one.lower < KNOWN:
        return Quantity(one.value, read_in="%", form=".1f")
    return Quantity.of(one, read_in="%", form=".1f")


def slope_text(found: Influence, field: str, study: Study, output: Output) -> str:
    """Mean slope of a response along an error, or that there is none.

    Args:
        found: influences on the response.
        field: name of the error.
        study: with both.
        output: what the response is.
    """
    unit, size = output.shown
    per = f"{unit}/{readable(study.unit(field))[0]}"
    sizes = {name: readable(study.unit(name))[1] / size for name in found.slopes}
    shown = [slope * sizes[name] for each in (found.slopes, found.scatter) for name, slope in each.items()]
    largest = max((slope for slope in shown if math.isfinite(slope) and slope > 0), default=1.0)
    decimals = min(4, max(0, 3 - math.floor(math.log10(largest))))  # fewer where the largest then has four digits
    mean, single = (each[field] * sizes[field] for each in (found.slopes, found.scatter))
    if mean:
        return f"{mean:.{decimals}f} {per}"
    said = f"{single:.{decimals}f}"
    return f"{UNMOVED} [rms {said} {per}]" if float(said) > 0 else UNMOVED


def together_text(influence: Mapping[str, Influence]) -> str:
    """A line on responses in which errors act together; "" if there are none.

    Args:
        influence: of the errors, by response.
    """
    sums = {name: found.total for name, found in influence.items() if found.total.lower > 1 + KNOWN}
    said = ", ".join(f"{name} {100 * total.value:.0f} %" for name, total in sums.items())
    return f"errors act together; before scaling the shares sum to: {said}." if said else ""


NOT_IN_FILE, IN_FILE = EVERYWHERE - {CSV}, frozenset({CSV})
MOST_ERRORS = 6  # of a response in text and page


def influence_tables(study: Study, influence: Mapping[str, Influence]) -> list[Table | Note]:
    """Mean slope of each response along each error and share of the variance, with its interval, after.

    In text and page a table for each response with the errors that cause most of it; in the file all of them.

    Args:
        study: with the errors.
        influence: of the errors, by response.
    """
    titles = ("error", "response", "slope", "unit of the slope", "share of variance")
    ends = ("share, lower end", "share, upper end", "slope of a unit, rms")
    rows = [_influence_row(study, influence[name], field, name) for field in study.fields for name in influence]
    means = Note("\n".join(filter(None, [UNMOVED_MEANS, SHARE_MEANS, together_text(influence)])))
    shown = (_influence_on(study, influence[name], name) for name in study.requirements)
    return [Table("influence", [Column(title) for title in (*titles, *ends)], rows, on=IN_FILE), *shown, means]


def _influence_row(study: Study, one: Influence, field: str, name: str) -> list[Cell]:
    """Numbers of an error and a response for the file."""
    (error_unit, error_size), (unit, size) = readable(study.unit(field)), study.output(name).shown
    mean, single = (each[field] * error_size / size or None for each in (one.slopes, one.scatter))
    known = one.shares[field]
    three = (known.value, known.lower, known.upper) if influence_share(one, field) else (None, None, None)
    return [field, name, number(mean), f"{unit}/{error_unit}", *map(number, three), number(single)]


def _influence_on(study: Study, one: Influence, name: str) -> Table:
    """The errors that cause most of a response, the largest share first, and what the others cause together."""
    acting = [field for field in study.fields if influence_share(one, field)]
    acting.sort(key=lambda field: -one.shares[field].value)
    listed = [field for field in acting[:MOST_ERRORS] if not one.shares[field].value < KNOWN]
    rows = [[f, influence_share(one, f), slope_text(one, f, study, study.output(name))] for f in listed]
    others, left = acting[len(listed) :], len(study.fields) - len(acting)
    rest = [f"{len(others)} more: {100 * sum(one.shares[field].value for field in others):.2g} %"] if others else []
    rest += [f"{left} without influence"] if left else []
    columns: list[Column] = [Text("error"), Interval("share [interval]"), _Slope(f"d {name} / d error")]
    note = f"{'; '.join(rest)} (influence.csv)" if rest else ""
    return Table("influence", columns, rows, f"Influence on {name}:", note, on=NOT_IN_FILE)


@dataclass(frozen=True)
class _Slope(Text):
    """Mean slopes, or "no slope" with the root mean square of single units."""

    @property
    def narrow(self) -> int:
        """The root mean square may be on the next line."""
        return 20
