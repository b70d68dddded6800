"""The tables of an answer as numbers, for spreadsheets and programs: one unit a row, named in a column of its own."""

import math
from collections.abc import Iterator
from typing import Any

from rvjax.study.answer import Answer
from rvjax.tolerances import Allocation, Verdict
from rvjax.units import readable

Cell = str | float | None  # None: there is no such number, an empty cell
Rows = tuple[list[str], list[list[Cell]]]


MOVED = "middles moved"
"""Row of the cost of moving middles, beside that of the half-widths: columns of costs add up to the cost."""


def moved(allocation: Allocation) -> float:
    """Cost of having moved middles; 0 where that is rounding."""
    found = allocation.cost - sum(allocation.costs.values())
    return found if found > 1e-9 * allocation.cost else 0.0


def tables(answer: Answer) -> Iterator[tuple[str, Rows]]:
    """(name, (headers, rows)) of each table."""
    yield "tolerances", _tolerances(answer)
    yield "influence", _influence(answer)
    yield "requirements", _requirements(answer)


def _tolerances(answer: Answer) -> Rows:
    """Limits and cost of each error, and of moved middles: before, after, and snapped to grades if asked."""
    study, allocation = answer.study, answer.allocation
    graded = allocation.graded
    sides = [("before", study.tolerances, answer.before.cost), ("after", allocation.tolerances, answer.after.cost)]
    sides += [("graded", graded.tolerances, graded.costs)] if graded else []
    headers = ["error", "unit", *(f"{end} {side}" for side, _, _ in sides for end in ("lower", "upper"))]
    headers += [f"cost {side}" for side, _, _ in sides] + (["grade"] if graded else [])
    rows: list[list[Cell]] = []
    for field in study.fields:
        unit, size = readable(study.unit(field))
        limits = (getattr(getattr(found, field), end) for _, found, _ in sides for end in ("lower", "upper"))
        row: list[Cell] = [field, unit, *(number(limit, size) for limit in limits)]
        row += [costs.get(field) for _, _, costs in sides]
        rows.append(row + ([(graded.grades or {}).get(field)] if graded else []))
    if price := moved(allocation):
        empty: list[Cell] = [None] * (2 * len(sides))
        rows.append([MOVED, None, *empty, None, price] + ([price, None] if graded else []))
    return headers, rows


def _influence(answer: Answer) -> Rows:
    """Slope of each response along each error, and its share of the variance, after; empty where it is not seen."""
    study, side = answer.study, answer.after
    rows: list[list[Cell]] = []
    for field in study.fields:
        error_unit, error_size = readable(study.unit(field))
        for name in study.requirements:
            unit, size = study.output(name).shown
            slope, share = side.sensitivities[name][field], side.shares[name][field]
            seen = slope != 0 or share != 0
            found = (number(slope * error_size, size), number(share)) if seen else (None, None)
            rows.append([field, name, found[0], f"{unit}/{error_unit}", found[1]])
    return ["error", "response", "slope", "unit of the slope", "share of variance"], rows


def _requirements(answer: Answer) -> Rows:
    """Limits, the figures that are judged, with their intervals, and the shadow price; shares are parts of one."""
    allocation = answer.allocation
    headers = ["requirement", "unit", "lower limit", "upper limit", "target", "unit of the figure"]
    for side in ("before", "after"):
        headers += [side, f"{side}, lower end", f"{side}, upper end"]
    rows: list[list[Cell]] = []
    for name, requirement in answer.study.requirements.items():
        unit, size = answer.study.output(name).shown
        sides = [answer.certificate_before.verdicts[name], allocation.certificate.verdicts[name]]
        of_response = sides[0].kind == "response"
        row: list[Cell] = [name, unit, number(requirement.lower, size), number(requirement.upper, size)]
        row += [requirement.text(), unit if of_response else "-"]
        for verdict in sides:
            row += _figure(verdict, size if of_response else 1.0)
        rows.append([*row, "yes" if sides[1].met else "no", number(allocation.multipliers[name] * size)])
    return [*headers, "met after", "shadow price per unit"], rows


def _figure(verdict: Verdict, size: float) -> list[Cell]:
    return [number(getattr(verdict.estimate, name), size) for name in ("value", "lower", "upper")]


def number(value: Any, size: float = 1.0) -> float | None:
    """To ten digits, in a unit of this size; None for what is not finite."""
    found = float(value) / size
    return float(f"{found:.10g}") if math.isfinite(found) else None
