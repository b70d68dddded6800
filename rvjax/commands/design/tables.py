"""Report of `rvjax design`: verdict, numbers, prices in one currency, requirements, other optima, scaling laws."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from rvjax.commands.allocate import shortfall_text
from rvjax.commands.cells import evaluated, limit_text, limits_of, share
from rvjax.commands.design.optimum import Designed
from rvjax.commands.design.prices import limit_price, nominal_limit, per, per_number, per_output, slope, unit_of_number
from rvjax.render import Column, Interval, Limits, Note, Number, Quantity, Table, Text, Titled, Zone, column
from rvjax.study import Study, fields_of, number_at, shown, stated_by
from rvjax.units import readable, with_unit


def headline(study: Study, found: Designed) -> str:
    """Status, cost and saving, or the reason why there is no result.

    Args:
        study: with variables.
        found: result of the command.
    """
    joint = found.joint.found
    lines = [f"Study {study.name}: {joint.status}", *filter(None, [study.about.line()])]
    if (yielded := joint.certificate.joint_yield) is not None:
        lines.append(f"joint yield: {share(yielded).text()}")
    if not joint.feasible:
        lines.append("No design and tolerances within the bounds were found to meet the requirements.")
        for name, shortfall in joint.shortfall.items():
            if shortfall > 0:
                lines.append(f"  the limit of {name} {shortfall_text(shortfall, study.output(name))}")
        if joint.helps is not None:
            lines.append(f"  {_helping(study, *joint.helps)} would help most")
        return "\n".join(lines)
    lines.append(f"cost {joint.start_cost:.3f} -> {joint.cost:.3f} ({_percent(joint.cost, joint.start_cost)})")
    if found.two_step is not None:
        steps = found.two_step.found
        if steps.feasible:
            lines.append(
                f"in two steps, geometry first: {steps.cost:.3f} ({steps.status}); together saves "
                f"{steps.cost - joint.cost:.3f} ({saved_part(joint.cost, steps.cost)})"
            )
        else:
            lines.append("in two steps, geometry first: no tolerances meet the requirements")
    if found.unscaled is not None and found.unscaled.found.feasible:
        lines.append(f"without scaling laws: {found.unscaled.found.cost:.3f} (stiffness and mass would not follow)")
    return "\n".join(lines)


def _percent(after: float, before: float) -> str:
    return f"{100 * (after / before - 1):+.1f} %" if before else "-"


def saved_part(together: float, in_steps: float) -> str:
    """Part of a cost that the joint search saves, as text; a study without prices has none.

    Args:
        together: cost of the joint optimum.
        in_steps: cost of the optimum in two steps.
    """
    return f"{100 * (1 - together / in_steps):.1f} %" if in_steps else "-"


@dataclass(frozen=True)
class VariableRow:
    """A variable before and after, with range, active bound and price."""

    variable: str = column(Text("variable"))
    before: str = column(Text("before"))
    after: str = column(Text("after"))
    bounds: str = column(Text("bounds"))
    kept: str = column(Text("cost within 0.5 %"))
    bound: str = column(Text("active bound"))
    price: str = column(Text("price of the bound"))


def numbers(study: Study, found: Designed) -> Table:
    """Variables before and after, with range, active bound and price.

    Args:
        study: with variables.
        found: result of the command.
    """
    joint, rows = found.joint.found, []
    meanings = dict(fields_of(study.design))
    for path, item in study.variables.items():
        unit, value = unit_of_number(study, path), joint.values.get(path, math.nan)
        name, size = per_number(study, path)
        price, bound = joint.value_prices.get(path, 0.0), joint.bounds_active.get(path)
        kept = joint.ranges.get(path)
        row = VariableRow(
            variable=Titled(path, str(meanings[path.partition("[")[0]]["meaning"])),
            before=shown(number_at(study.design, path), unit),
            after=shown(value, unit) if math.isfinite(value) else "-",
            bounds=f"{shown(item.lower, unit)} to {shown(item.upper, unit)}",
            kept="-" if kept is None else f"{shown(kept[0], unit)} to {shown(kept[1], unit)}",
            bound=bound or "-",
            price=f"{abs(price) * size:.3g}{per(name)}" if bound and price and math.isfinite(price) else "-",
        )
        rows.append(row)
    ranges = bool(joint.ranges)
    missing = [path for path, item in study.variables.items() if ranges and item.free and path not in joint.ranges]
    note = f"cost within 0.5 %: no units were left for {', '.join(missing)}." if missing else ""
    return Table.of(VariableRow, "variables", rows, without=() if ranges else ("kept",), note=note)


@dataclass(frozen=True)
class ToleranceRow:
    """Limits and cost of an error, before and after, and the price of a unit of what states it."""

    error: str = column(Text("error"))
    before: Zone = column(Limits("before"))
    after: Zone = column(Limits("after"))
    cost: float | None = column(Number("cost after", form=".3f"))
    price: str = column(Text("price"))


def tolerances_of(study: Study, found: Designed) -> Table:
    """Limits and cost of each error, before and after, and the price of a unit of what states it.

    Args:
        study: with variables.
        found: result of the command.
    """
    joint, rows = found.joint.found, []
    for field in study.fields:
        (name, size), (_, half_widths) = readable(study.unit(field)), stated_by(study.forms, field)
        before, after = (limits_of(study, field, getattr(side, field)) for side in (study.tolerances, joint.tolerances))
        price = f"{-slope(study, found.joint, field) * size / half_widths:.3g} /{name}" if field in joint.costs else "-"
        rows.append(ToleranceRow(field, before, after, joint.costs.get(field), price))
    return Table.of(ToleranceRow, "tolerances", rows)


@dataclass(frozen=True)
class RequirementRow:
    """A requirement on units, with its certified value."""

    name: str = column(Text("requirement"))
    limit: str = column(Text("limit"))
    requires: str = column(Text("requires"))
    value: Quantity = column(Interval("independent units"))
    met: str = column(Text("met"))
    price: str = column(Text("price"))


@dataclass(frozen=True)
class NominalRow:
    """A limit or a price of an output without errors."""

    name: str = column(Text("without errors"))
    limit: str = column(Text("limit"))
    before: str = column(Text("before"))
    after: str = column(Text("after"))
    price: str = column(Text("price"))


def requirements_of(study: Study, found: Designed) -> Iterator[Table]:
    """Requirements on units with certified values, then limits without errors.

    Args:
        study: with variables.
        found: result of the command.
    """
    rows = []
    for name, requirement in study.requirements.items():
        output, verdict = study.output(name), found.joint.found.certificate.verdicts[name]
        said = limit_text(requirement, output), requirement.text(), evaluated(verdict, output)
        met, price = "yes" if verdict.met else "no", limit_price(study, found.joint, name)
        rows.append(RequirementRow(Titled(name, output.meaning), *said, met, price))
    yield Table.of(RequirementRow, "requirements", rows)
    nominal = []
    for name in study.without_errors:
        output = study.output(name)
        price = limit_price(study, found.joint, name)
        before, after = (output.text(side[name], ".5g") for side in (found.start, found.joint.outputs))
        if name in study.objective:
            named, size = per_output(output)
            price = f"{study.objective[name](size):.3g}{per(named)}"
        nominal.append(NominalRow(Titled(name, output.meaning), nominal_limit(study, name), before, after, price))
    if nominal:
        yield Table.of(NominalRow, "nominal", nominal)


def _helping(study: Study, path: str, side: str) -> str:
    """Bound of a number that an infeasible study should move outwards, in the unit of the number."""
    unit, size = readable(unit_of_number(study, path))
    bound = getattr(study.variables[path], side) / size
    sense = "lower" if side == "lower" else "higher"
    return f"a {sense} {side} bound of {path} than {with_unit(bound, unit, '.6g')}"


def others(study: Study, found: Designed) -> Iterator[Table | Note]:
    """Joint optimum, optimum in two steps, optimum without scaling laws, front: costs and numbers.

    Args:
        study: with variables.
        found: result of the command.
    """
    paths = list(study.variables)
    columns: list[Column] = [
        Text("optimum"), Text("status"), Number("cost", form=".3f"), Number("tolerances", form=".3f"),
        Number("priced outputs", form=".3f"), *(Text(path) for path in paths),
    ]  # fmt: skip
    points = [("joint", found.joint)]
    points += [("geometry first, tolerances after", found.two_step)] if found.two_step else []
    points += [("without scaling laws", found.unscaled)] if found.unscaled else []
    points += [(f"prices times {point.factor:.3g}", point) for point in found.front]
    rows: list[list[Any]] = []
    for name, point in points:
        values = [shown(point.found.values[path], unit_of_number(study, path)) for path in paths]
        costs = point.total(study), point.of_tolerances(study), point.priced(study)
        rows.append([name, point.found.status, *costs, *values])
    yield Table("optima", columns, rows)
    if said := starts_text(found.joint.found.starts):
        yield Note(said)
    if found.two_step is not None:
        yield Note(
            "Geometry first: least own cost and priced outputs within the limits without errors, nearest to the start; "
            "then the cheapest tolerances for that geometry. It never costs less than the joint optimum."
        )
    if found.front:
        named = ", ".join(name.replace("_", " ") for name in study.objective)
        yield Note(f"Prices times N: optimum at N times the price of {named}. Costs are at the prices of the study.")
    if missed := [f"{point.factor:.3g}" for point in found.front if not point.certified]:
        yield Note(
            f"warning: not certified at prices times {', '.join(missed)}: independent units miss a requirement there. "
            "The cost of such a point is too low, and the plot shows the point hollow."
        )


def starts_text(starts: Sequence[Mapping[str, Any]]) -> str:
    """Costs at the ends of the searches; "" for one start.

    Args:
        starts: of the result.
    """
    costs = [start["cost"] for start in starts if start["met"]]
    if len(starts) < 2 or not costs:
        return ""
    missed = f"; {len(starts) - len(costs)} missed a limit" if len(costs) < len(starts) else ""
    ends = f"{min(costs):.3f} to {max(costs):.3f}{missed}"
    return f"Searches from {len(starts)} starts on {starts[0]['units']} units ended at costs of {ends}."


def laws_of(study: Study, found: Designed) -> Iterator[Table | Note]:
    """Applied scaling laws with sources and changes.

    Args:
        study: with variables.
        found: result of the command.
    """
    if not found.laws:
        yield Note("No number of the design follows the variables.")
        return
    columns: list[Column] = [
        Text("follows"), Text("as"), Text("factor here"), Text("interval (assumed)"), Text("source", wraps=True),
    ]  # fmt: skip
    rows = []
    for law, followers in found.laws:
        powers = " ".join(f"{path}^{power:.3g}" if power != 1 else path for path, power in law.follows.items())
        before, after = (number_at(design, followers[0]) for design in (study.design, found.joint.design))
        ratio = float(jnp.ravel(jnp.asarray(after))[0] / jnp.ravel(jnp.asarray(before))[0])
        interval = f"{law.interval[0]:g} to {law.interval[1]:g} times"
        rows.append([", ".join(followers), powers, f"{ratio:.4g}", interval, law.source])
    yield Table("scaling", columns, rows)
    if found.unscaled is not None:
        cost, joint = found.unscaled.found.cost, found.joint.found.cost
        yield Note(f"Without scaling laws the optimum would cost {cost:.3f} ({_percent(cost, joint)}).")
