"""Prices of limits and of bounds, active bounds, and the reason of an infeasible problem."""

import math

from rvjax.tolerances.codesign.design import Found
from rvjax.tolerances.codesign.margins import JOINT

_AT = 1e-6  # part of its range, nearer than which a number is at its bound


def bounds_active(found: Found) -> dict[str, str | None]:
    """The bound at which each number of the design is, or None."""
    decisions, values = found.decisions, found.decisions.values(found.x)
    active: dict[str, str | None] = {}
    for name, item in decisions.variables.items():
        near = _AT * (item.upper - item.lower)
        at_lower, at_upper = values[name] <= item.lower + near, values[name] >= item.upper - near
        free = name in decisions.free and not item.among
        active[name] = ("lower" if at_lower else "upper" if at_upper else None) if free else None
    return active


def value_prices(found: Found) -> dict[str, float]:
    """d cost / d bound of each number, of the bound at which it is; 0 elsewhere."""
    decisions, prices = found.decisions, dict.fromkeys(found.decisions.variables, 0.0)
    if found.end is None:
        return prices
    first = len(decisions.fields) + len(decisions.moves)
    for k, name in enumerate(decisions.free, first):
        rate = float(decisions.rates()[k - len(decisions.fields)])
        bound = bounds_active(found)[name]
        if bound is not None:
            prices[name] = float(found.end.at_low[k] if bound == "lower" else -found.end.at_high[k]) / rate
    return prices


def multipliers(found: Found) -> dict[str, float]:
    """d cost / d limit by requirement, all its limits moving outwards; <= 0."""
    prices = dict.fromkeys(found.margins.requirements, 0.0)
    if found.end is None:
        return prices
    for name, price, way in zip(found.margins.names, found.end.prices, found.margins.ways):
        if name in prices:
            prices[name] -= float(price / way)
    if JOINT in found.margins.names[len(found.margins.rows) :]:
        for name, part in found.margins.leading(found.x).items():
            prices[name] -= float(found.end.prices[-1]) * part
    return prices


def margins(found: Found) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Margins of the requirements at the end of the search, of two sides the larger, and their derivatives."""
    values, slopes = dict[str, float](), dict[str, dict[str, float]]()
    if found.end is None:
        return values, slopes
    decisions, point = found.decisions, found.end.point
    first = len(decisions.fields) + len(decisions.moves)
    widths = decisions.half_widths(point.x)
    for k, row in enumerate(found.margins.rows):
        value, rates = point.margins[k] * found.margins.ways[k], point.jacobian[k] * found.margins.ways[k]
        if not math.isfinite(value) or value <= values.get(row.name, -math.inf):
            continue
        values[row.name] = float(value)
        numbers = rates[first:] / decisions.rates()[len(decisions.moves) :]
        slopes[row.name] = dict(zip(decisions.fields, map(float, rates[: len(widths)] / widths)))
        slopes[row.name] |= dict(zip(decisions.free, map(float, numbers)))
    return values, slopes


def reason(found: Found) -> str | None:
    """The limits that an infeasible problem misses, and the bound of a number that would help most."""
    if found.shortage is None:
        return None
    missing = [
        f"{name or 'the response'} misses its limit by {value:.4g}"
        for name, value in found.shortage.by_name.items()
        if value > 0
    ]
    text = "; ".join(missing)
    if found.shortage.helps is not None:
        name, side = found.shortage.helps
        item = found.decisions.variables[name]
        bound = item.lower if side == "lower" else item.upper
        wider = "lower" if side == "lower" else "higher"
        text += f"; a {wider} {side} bound of {name} than {bound:.6g} would help most"
    return text
