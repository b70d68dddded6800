"""Prices of an optimum in the unit of the costs: of half-widths, limits, priced outputs and bounds."""

import math

import jax
import jax.numpy as jnp

from rvjax.commands.design.optimum import Designed, Point
from rvjax.commands.sections.cells import binding, limit_text
from rvjax.outputs import Output
from rvjax.render import Note
from rvjax.study import Study, fields_of, stated_by
from rvjax.units import readable, suited, with_unit

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
