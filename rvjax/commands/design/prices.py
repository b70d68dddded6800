"""Prices of an optimum in the unit of the costs, and the sliders of the page, which predict with the same slopes."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from markupsafe import Markup

from rvjax.base.words import words
from rvjax.commands.cells import binding, limit_text
from rvjax.commands.design.optimum import Designed, Point
from rvjax.commands.report import cost_data, script_of
from rvjax.outputs import Output
from rvjax.render import Block, Note
from rvjax.study import Study, fields_of, number_at, stated_by
from rvjax.units import mm, readable, suited, with_unit

BINDING = 1e-6  # least change of the cost, per doubled limit (from 0: per unit it is read in), of a binding limit
HOURS = "1000 h", 3.6e6  # the price of one hour of life is small


def unit_of_number(study: Study, path: str) -> str:
    """SI unit of a number of a design.

    Args:
        study: with variables.
        path: of the number.
    """
    return str(dict(fields_of(study.design))[path.partition("[")[0]]["unit"])


def per_output(output: Output) -> tuple[str, float]:
    """Name and SI size of the unit of a price: that in which the study reads the output, of times 1000 h.

    Args:
        output: that has a price.
    """
    return HOURS if output.unit == "s" else output.shown


def per_number(study: Study, path: str) -> tuple[str, float]:
    """Name and SI size of the unit of the price of a bound: that of the bounds.

    Args:
        study: with variables.
        path: of the number.
    """
    item = study.variables[path]
    return suited(max(abs(item.lower), abs(item.upper)), unit_of_number(study, path))


def slope(study: Study, found: Point, field: str) -> float:
    """d cost / d half-width of an error, per SI unit.

    Args:
        study: with variables.
        found: an optimum.
        field: name of the error.
    """
    cost, half_width = study.costs[field], float(getattr(found.found.tolerances, field).half_width)
    return float(jax.grad(lambda t: jnp.asarray(cost(t)))(half_width))


def multiplier(study: Study, point: Point, name: str) -> float:
    """d cost / d limit, outwards >= 0; 0 for a limit that does not bind, nan where it is unknown.

    It does not where the price is rounding, or its interval contains zero.

    Args:
        study: with variables.
        point: an optimum.
        name: of the requirement.
    """
    price = abs(binding(point.found, name))
    limits = {**study.requirements, **study.nominal}.get(name)
    sizes = [abs(x) for x in (limits.lower, limits.upper) if math.isfinite(x)] if limits else [1.0]
    size = max(sizes, default=0.0) or study.output(name).shown[1]
    return 0.0 if price * size <= BINDING * abs(point.found.cost) else price


def limit_price(study: Study, point: Point, name: str) -> str:
    """Price of a limit with its unit, as text, of costly units with its interval.

    Args:
        study: with variables.
        point: an optimum.
        name: of the requirement.
    """
    price = multiplier(study, point, name)
    unit, size = per_output(study.output(name))
    if not price > 0:
        return "unknown" if math.isnan(price) else "not binding"
    ends = point.found.multiplier_intervals.get(name)
    within = "" if ends is None else f" [{-ends[1] * size:.3g}, {-ends[0] * size:.3g}]"
    return f"{price * size:.3g}{within}{per(unit)}"


def per(unit: str) -> str:
    """The unit of a price as text, "" for a plain number.

    Args:
        unit: name of the unit of what has the price.
    """
    return "" if unit == "-" else f" /{unit}"


def nominal_limit(study: Study, name: str) -> str:
    """Limits of an output without errors, as text; "-" without any.

    Args:
        study: with variables.
        name: of the output.
    """
    if name not in study.nominal:
        return "-"
    return limit_text(study.nominal[name], study.output(name))


def price_note(study: Study, found: Designed) -> Note:
    """Prices of one unit each of half-widths, limits, priced outputs and active bounds, in the unit of cost.

    Args:
        study: with variables.
        found: the optima.
    """
    joint, said = found.joint, []
    for field in joint.found.costs:
        (name, size), (what, half_widths) = readable(study.unit(field)), stated_by(study.forms, field)
        said.append((f"1 {name} of the {what} of {field}", -slope(study, joint, field) * size / half_widths))
    for name in joint.found.multipliers:
        unit, size = per_output(study.output(name))
        said.append((f"{_one(unit)} of the limit of {name}", multiplier(study, joint, name) * size))
    for name, per in study.objective.items():
        unit, size = per_output(study.output(name))
        said.append((f"{_one(unit)} of {name}", per(size)))
    for path, price in joint.found.value_prices.items():
        unit, size = per_number(study, path)
        said.append((f"{_one(unit)} of the bound of {path}", abs(price) * size))
    lines = [f"  {what}: {price:.3g}" for what, price in said if price and math.isfinite(price)]
    return Note("\n".join(["At the optimum, in the unit of the costs:", *lines]))


def _one(unit: str) -> str:
    """One of a unit, as text: "1 mm", "1000 h", "1"."""
    return unit if unit[0].isdigit() else with_unit(1, unit)


NEAR = 0.1  # of the range of a variable, or of a half-width: a change beyond it is marked
LONG = 1e-4  # m, above which a number is read in mm


def block() -> Block:
    """The section of the page, hidden until its script runs."""
    return Block("rvjax.commands.design:live.html.j2", {"near": f"{100 * NEAR:g} %"})


def script(study: Study, found: Designed) -> Markup:
    """Numbers and script of the section, for the end of the page.

    Args:
        study: with variables.
        found: with a feasible optimum.
    """
    return script_of(data(study, found), "design/live.js")


def data(study: Study, found: Designed) -> dict[str, Any]:
    """Data of the script, in the measurement units of the page.

    Args:
        study: with variables.
        found: with a feasible optimum.
    """
    joint = found.joint.found
    sliders, fields = [], []
    for path, item in study.variables.items():
        if not item.free:
            continue
        unit, size = readable(unit_of_number(study, path))
        if unit == "um" and max(abs(item.lower), abs(item.upper)) > LONG:
            unit, size = "mm", mm
        before = float(number_at(study.design, path)) / size
        own = 0.0 if item.cost is None else (item.own_cost(item.upper) - item.own_cost(item.lower)) * size
        sliders.append(
            {"name": path, "label": words(path), "unit": unit, "low": item.lower / size, "high": item.upper / size}
            | {"centre": joint.values[path] / size, "before": before, "size": size, "number": True}
            | {"reach": NEAR * (item.upper - item.lower) / size, "own": own / (item.upper - item.lower)}
        )
    for name, half in joint.half_widths.items():
        (unit, size), cost = readable(study.unit(name)), study.costs[name]
        what, half_widths = stated_by(study.forms, name)
        sign = "±" if what == "half-width" else what
        size /= half_widths  # the slider has the number of the drawing
        before = float(getattr(study.tolerances, name).half_width) / size
        ends = [half / size, before, float(cost.finest) / size, float(cost.coarsest) / size]
        fields.append({"half": len(sliders), "place": None, "stands": 0, "cost": cost_data(cost, size)})
        sliders.append(
            {"name": name, "label": f"{words(name)} {sign}", "unit": unit, "low": min(ends), "high": max(ends)}
            | {"centre": half / size, "before": before, "size": size, "number": False}
            | {"reach": NEAR * half / size, "own": 0.0}
        )
    return {
        "sliders": sliders,
        "fields": fields,
        "cost": joint.cost,
        "other_cost": 0.0,
        "units": [_distance(study, found, sliders, name) for name in study.requirements if name in joint.margins],
        "nominal": _nominal(study, found, sliders),
    }


def _distance(study: Study, found: Designed, sliders: list[dict[str, Any]], name: str) -> dict[str, object]:
    """Distance of a requirement from its limit, and its slopes."""
    joint, output, limits = found.joint.found, study.output(name), study.requirements[name]
    unit, size = output.shown
    slopes = joint.margin_slopes[name]
    return {
        "label": words(name), "limit": limit_text(limits, output), "unit": unit,
        "required": limits.text(), "margin": min(joint.margins[name], 0.0) / size,
        "slopes": [slopes.get(one["name"], 0.0) * one["size"] / size for one in sliders],
        "scale": max(abs(end) for end in (limits.lower, limits.upper) if math.isfinite(end)) / size,
    }  # fmt: skip


def _nominal(study: Study, found: Designed, sliders: list[dict[str, Any]]) -> list[dict[str, object]]:
    """Outputs without errors with their slopes to the variables."""
    if not study.without_errors:
        return []
    response, nothing = study.nominal_response(), study.design.error_record()
    at = {name: jnp.asarray(value) for name, value in found.joint.found.values.items()}
    slopes = jax.jacrev(lambda values: response(nothing, values).value)(at)
    rows = []
    for name in study.without_errors:
        output = study.output(name)
        unit, size = output.shown
        limits = study.nominal.get(name)
        ends = (limits.lower, limits.upper) if limits else (None, None)
        lower, upper = (None if end is None or math.isinf(end) else end / size for end in ends)
        price = study.objective[name](size) if name in study.objective else 0.0
        rates = [float(slopes[name].get(one["name"], 0.0)) * one["size"] / size for one in sliders]
        rows.append(
            {"label": words(name), "unit": unit, "value": found.joint.outputs[name] / size, "price": price}
            | {"lower": lower, "upper": upper, "slopes": rates}
            | {"limit": nominal_limit(study, name)}
        )
    return rows
