"""Report of `rvjax allocate`: tables of tolerances, requirements and cost, and plots."""

import dataclasses
import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

import rvjax
from rvjax.base.files import versions
from rvjax.commands import cells
from rvjax.commands.allocate.answer import Answer
from rvjax.commands.budget.effects import IN_FILE, NOT_IN_FILE
from rvjax.outputs import Output
from rvjax.render import (
    PAGE,
    Figure,
    Interval,
    Limits,
    Number,
    Quantity,
    Table,
    Text,
    Titled,
    Value,
    Zone,
    column,
    number,
)
from rvjax.study import sizes_of
from rvjax.tolerances import Allocation, least_yield
from rvjax.units import readable

GRADED = ("graded", "grade", "cost_graded")
"""Fields of a row that only a result in grades has."""
MOVED = "middles moved"
"""Row with the cost of moved mid-points: with it, the column of costs adds up to the total."""


def moved(allocation: Allocation) -> float:
    """Cost of moved mid-points; 0 if it is rounding."""
    found = allocation.cost - sum(allocation.costs.values())
    return found if found > 1e-9 * allocation.cost else 0.0


@dataclass(frozen=True)
class ToleranceRow:
    """Limits and cost of an error: before, after, and in grades."""

    error: str = column(Text("error"))
    unit: str = column(Text("unit", on=IN_FILE))
    stated: str = column(Text("stated as", on=IN_FILE))
    before: Zone | str = column(Limits("before"))
    after: Zone | str = column(Limits("after"))
    cost_before: float | str | None = column(Number("cost before", form=".3f"))
    cost_after: float | None = column(Number("cost after", form=".3f"))
    graded: Zone | str = column(Limits("graded"))
    grade: str | None = column(Text("grade"))
    cost_graded: float | None = column(Number("cost graded", form=".3f"))


def tolerance_tables(answer: Answer) -> list[Table]:
    """Limits and cost of each error, and of moved mid-points: before, after, and in grades if required.

    With the sums in text and page, without them in the file.
    """
    study, allocation = answer.study, answer.allocation
    graded = allocation.graded
    rows = []
    for field in study.fields:
        elements = math.prod(getattr(study.tolerances, field).shape)
        name = Titled(field, f"{elements} elements, each with a separate value" if elements > 1 else "")
        before, after = (
            cells.limits_of(study, field, getattr(x, field)) for x in (study.tolerances, allocation.tolerances)
        )
        costs = answer.before.cost.get(field), answer.after.cost.get(field)
        grades: tuple[Any, ...] = ()
        if graded:
            limits = cells.limits_of(study, field, getattr(graded.tolerances, field))
            grades = limits, (graded.grades or {}).get(field), graded.costs.get(field)
        unit = readable(study.unit(field))[0]
        rows.append(ToleranceRow(name, unit, before.stated or "limits", before, after, *costs, *grades))
    if price := moved(allocation):
        rows.append(ToleranceRow(MOVED, cost_after=price, cost_graded=price))
    sums = allocation.start_cost, allocation.cost
    total = ToleranceRow("sum", cost_before=sums[0], cost_after=sums[1], cost_graded=graded.cost if graded else None)
    table = functools.partial(Table.of, ToleranceRow, "tolerances", without=() if graded else GRADED)
    return [table(rows, on=IN_FILE), table([*rows, total], on=NOT_IN_FILE, total=True)]


def drawing_table(answer: Answer) -> Table:
    """Sizes for the drawing of the tolerances after."""
    return cells.sizes_table(sizes_of(answer.study.design, answer.allocation.tolerances))


def _price(price: float, output: Output, interval: tuple[float, float] | None) -> str:
    """A shadow price per unit of the response as text; `price` and its interval are per SI unit."""
    unit, size = output.shown
    if not price:
        return "not binding"
    if math.isnan(price):
        return "unknown"
    ends = "" if interval is None else " [{:.4g}, {:.4g}]".format(*(end * size for end in interval))
    return f"{price * size:.4g}{ends} /{unit}"


@dataclass(frozen=True)
class _Met(Text):
    """Column for a met requirement, cells are by `met_text`: 1 or 0 in a file."""

    def text(self, cell: object) -> str:
        """The text with its sign."""
        return f"{'✔' if cell == 'met' else '✘'} {cell}"

    def _given(self, cell: object) -> list[Value]:
        return [int(cell == "met")]


ON_PAGE = frozenset({PAGE})


@dataclass(frozen=True)
class RequirementRow:
    """A requirement with the values that are evaluated, shadow price and verdict."""

    requirement: str = column(Text("requirement"))
    unit: str = column(Text("unit", on=IN_FILE))
    limit: str = column(Text("limit", on=NOT_IN_FILE))
    lower: float | None = column(Number("lower limit", on=IN_FILE))
    upper: float | None = column(Number("upper limit", on=IN_FILE))
    goal: float | None = column(Number("target", on=IN_FILE))
    target: str = column(Text("target", file_title="requires"))
    unit_of_value: str = column(Text("unit of the figure", on=IN_FILE))
    before: Quantity = column(Interval("yield before [interval]", file_title="before"))
    after: Quantity = column(Interval("yield after [interval]", file_title="after"))
    met: str = column(_Met("met after", on=IN_FILE))
    price: str = column(Text("shadow price", on=NOT_IN_FILE))
    per_unit: float | None = column(Number("shadow price per unit", on=IN_FILE))
    graded: Quantity | str = column(Interval("yield graded [interval]", on=ON_PAGE))
    verdict: str = column(_Met("verdict", on=ON_PAGE))


def requirement_table(answer: Answer) -> Table:
    """Limits, the values that are evaluated with their intervals, shadow prices, verdicts."""
    study, allocation = answer.study, answer.allocation
    graded, rows = allocation.graded, []
    for name, requirement in study.requirements.items():
        output, price = study.output(name), cells.binding(allocation, name)
        unit, size = output.shown
        before, after = (side.verdicts[name] for side in (answer.certificate_before, allocation.certificate))
        met = cells.met_text(requirement, after, allocation.certificate.samples)
        row = RequirementRow(
            requirement=Titled(name, output.meaning),
            unit=unit,
            limit=cells.limit_text(requirement, output),
            lower=number(requirement.lower, size),
            upper=number(requirement.upper, size),
            goal=getattr(requirement, requirement.goal) if requirement.goal else None,
            target=requirement.text(),
            unit_of_value=unit if before.kind == "response" else "-",
            before=cells.evaluated(before, output),
            after=cells.evaluated(after, output),
            met=met,
            price=_price(price, output, allocation.multiplier_intervals.get(name)),
            per_unit=number(price * size),
            graded=cells.evaluated(graded.certificate.verdicts[name], output) if graded else "",
            verdict=met,
        )
        rows.append(row)
    prices = {name: cells.binding(allocation, name) for name in study.requirements}
    without = () if graded else ("graded",)
    return Table.of(RequirementRow, "requirements", rows, without=without, note=cells.price_text(study, prices))


def data_of(answer: Answer) -> dict[str, object]:
    """Result as JSON values in SI, without single units."""
    study, allocation = answer.study, answer.allocation
    graded = allocation.graded
    return {
        "study": study.name,
        "about": study.about,
        "status": allocation.status,
        "feasible": allocation.feasible,
        "seed": study.seed,
        "samples": study.samples,
        "versions": versions(),
        "conditions": dataclasses.asdict(study.conditions),
        "cost": {"before": allocation.start_cost, "after": allocation.cost, "middles": moved(allocation)},
        "tolerances": {
            field: {
                "unit": study.unit(field),
                "before": cells.limits_data(study, field, getattr(study.tolerances, field)),
                "after": cells.limits_data(study, field, getattr(allocation.tolerances, field)),
                "graded": cells.limits_data(study, field, getattr(graded.tolerances, field)) if graded else None,
            }
            for field in study.fields
        },
        "sizes": sizes_of(study.design, allocation.tolerances),
        "shares": {"after": answer.after.shares},
        "influence": answer.after.influence,
        "limits": {name: cells.limit_text(item, study.output(name)) for name, item in study.requirements.items()},
        "multipliers": allocation.multipliers,
        "multiplier_intervals": allocation.multiplier_intervals,
        **({"losses": allocation.losses, "objective": allocation.objective} if study.losses else {}),
        "shortfall": allocation.shortfall,
        "certificate": dataclasses.replace(allocation.certificate, values=None),
        "certificate_before": dataclasses.replace(answer.certificate_before, values=None),
        "graded": {"status": graded.status, "cost": graded.cost} if graded else None,
        **({} if answer.whole is None else {"whole": answer.whole}),
        **({"unlimited": answer.unlimited} if answer.unlimited else {}),
        "cost_curve": answer.cost_curve,
    }


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def figures(answer: Answer) -> Iterator[Figure]:
    """Draw the plots of a result."""
    study = answer.study
    if study.curve is not None:
        yield Figure("curves", f"{study.curve.title} of sample units, before and after", partial(_curves, answer))
    for name in study.requirements:
        yield Figure(f"histogram_{name}", _caption(answer, name), partial(_histogram, answer, name))
    yield Figure(
        "variance_shares",
        "Share of each error in the variance of each response, after",
        lambda: rvjax.plotting.variance_shares(answer.after.shares, title="Shares of the variance, after"),
    )
    if answer.cost_curve:
        ends = [f"{cost:.3g} at {100 * share:.5g} %" for share, cost in (answer.cost_curve[0], answer.cost_curve[-1])]
        caption = f"Cheapest cost for each yield, from {' to '.join(ends)}, with this study and the start"
        yield Figure("cost_against_yield", caption, partial(_costs, answer))


def _curves(answer: Answer) -> "Axes":
    study, curve = answer.study, answer.study.curve
    assert curve is not None
    alike = (output for name in study.requirements if (output := study.output(name)).unit == curve.unit)
    read_in = next((output.read_in for output in alike), None)
    sides = answer.before.curves, answer.after.curves
    return rvjax.plotting.unit_curves(answer.after.angle, *sides, curve.title, curve.unit, read_in=read_in)


def _caption(answer: Answer, name: str) -> str:
    study, certificate, values = answer.study, answer.allocation.certificate, answer.after.values[name]
    caption = f"Distribution of {name.replace('_', ' ')} before and after, with its limits"
    valid = values[np.isfinite(values)]
    if not valid.size:
        return caption
    mean, sd = (study.output(name).text(number, ".3g") for number in (valid.mean(), valid.std()))
    caption += f"; after: mean {mean}, sd {sd}"
    known = (("Cp", certificate.cp_estimate), ("Cpk", certificate.cpk_estimate))
    return caption + "".join(
        f", {label} {found[name].value:.3g}" for label, found in known if found and math.isfinite(found[name].value)
    )


def _histogram(answer: Answer, name: str) -> "Axes":
    output, requirement = answer.study.output(name), answer.study.requirements[name]
    return rvjax.plotting.histogram(
        {"after": answer.after.values[name], "before": answer.before.values[name]},
        unit=output.unit,
        read_in=output.read_in,
        name=name,
        limits=(requirement.lower, requirement.upper) if requirement.limits_values else (),
    )


def _costs(answer: Answer) -> "Axes":
    return rvjax.plotting.cost_against_yield(
        *zip(*answer.cost_curve),
        chosen=(least_yield(answer.allocation.certificate), answer.allocation.cost),
        start=(least_yield(answer.certificate_before), answer.allocation.start_cost),
    )
