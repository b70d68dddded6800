"""Section of the page with sliders for numbers of the design and half-widths: a linear prediction near the optimum."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from markupsafe import Markup

from rvjax.base.words import words
from rvjax.commands.design.optimum import Designed
from rvjax.commands.design.prices import nominal_limit, unit_of_number
from rvjax.commands.report import cost_data, script_of
from rvjax.commands.sections.cells import limit_text
from rvjax.render import Block
from rvjax.study import Study, number_at, stated_by
from rvjax.units import mm, readable

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


def _distance(study: Study, found: Designed, sliders: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """Distance of a requirement from its limit, and its slopes."""
    joint, output = found.joint.found, study.output(name)
    unit, size = output.shown
    slopes = joint.margin_slopes[name]
    return {
        "label": words(name), "limit": limit_text(study.requirements[name], output), "unit": unit,
        "required": study.requirements[name].text(), "margin": min(joint.margins[name], 0.0) / size,
        "slopes": [slopes.get(one["name"], 0.0) * one["size"] / size for one in sliders],
        "scale": max(abs(x) for x in _ends(study.requirements[name])) / size,
    }  # fmt: skip


def _nominal(study: Study, found: Designed, sliders: list[dict[str, Any]]) -> list[dict[str, Any]]:
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
        lower, upper = (None, None) if limits is None else _ends_or_none(limits.lower, limits.upper, size)
        price = study.objective[name](size) if name in study.objective else 0.0
        rates = [float(slopes[name].get(one["name"], 0.0)) * one["size"] / size for one in sliders]
        rows.append(
            {"label": words(name), "unit": unit, "value": found.joint.outputs[name] / size, "price": price}
            | {"lower": lower, "upper": upper, "slopes": rates}
            | {"limit": nominal_limit(study, name)}
        )
    return rows


def _ends(limits: Any) -> list[float]:
    return [end for end in (limits.lower, limits.upper) if math.isfinite(end)]


def _ends_or_none(lower: float | None, upper: float | None, size: float) -> tuple[float | None, float | None]:
    ends = [None if end is None or math.isinf(end) else end / size for end in (lower, upper)]
    return ends[0], ends[1]
