"""Checks of the input values: impossible values raise an error, unusual values give a warning.

A wrong unit in a file is not detected elsewhere.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from rvjax.catalogue import doubt, doubtful, shown, steep, undercut
from rvjax.errors import described
from rvjax.outputs import Output
from rvjax.records import Design, Record
from rvjax.study.kinds import kind_of, number_at
from rvjax.study.tolerances import Form, stated_by
from rvjax.study.values import Metadata
from rvjax.tolerances import Cost, Limits, Middle, Tolerance
from rvjax.units import with_unit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FAR_LIMIT = 10.0  # below the smallest known value of an output; assumed
HALF_WIDTH = {"m": (0.5e-6, 40e-6), "rad": (1e-4, 9e-3), "-": (0.01, 0.3)}  # of the studies and sources in this package


def refuse_impossible(design: Design, tolerances: Record, costs: dict[str, Cost], middles: dict[str, Middle]) -> None:
    """Raise an error for parts that do not fit into each other, and for errors as large as the part.

    Raises:
        ValueError: names the key, its value and what it collides with.
    """
    kind_of(design).refuse(design)
    for field, tolerance, about in _toleranced(tolerances):
        nominal = number_at(design, about["of"]) if about["of"] and about["unit"] != "-" else None
        part = None if nominal is None else abs(float(np.max(np.asarray(nominal))))
        widest = {f"tolerances.{field}": tolerance}
        if field in costs:
            coarsest = max(costs[field].coarsest, float(tolerance.half_width))
            widest[f"cost.{field}.coarsest = {shown(coarsest, about['unit'])}"] = tolerance.scaled(coarsest)
        if field in middles:
            half, lowest = max(float(t.half_width) for t in widest.values()), middles[field].lower
            widest[f"middle.{field}.lower = {shown(lowest, about['unit'])}"] = Tolerance(lowest - half, lowest + half)
        for name, limits in widest.items():
            unit, lower, upper = about["unit"], float(limits.lower), float(limits.upper)
            span = f"limits of {shown(lower, unit)} and {shown(upper, unit)}"
            if about["sign"] == "nonnegative" and lower < -1e-12 * abs(upper):
                raise ValueError(f"{name}: {span}, but a clearance cannot be negative")
            if part is not None and max(-lower, upper) >= part:
                raise ValueError(f"{name}: {span}, as large as the part itself, {shown(part, unit)}")


def doubts(
    design: Design,
    conditions: "DataclassInstance",
    tolerances: Record,
    forms: Mapping[str, Form] = MappingProxyType({}),
) -> list[str]:
    """Numbers that are far from those of every known reducer, a line each; tolerances as the file states them."""
    kind, found = kind_of(design), [f"design.{line}" for line in (undercut(design) or steep(design)) + doubtful(design)]
    for f in dataclasses.fields(conditions):
        if f.metadata["torque"]:
            value = abs(getattr(conditions, f.name) or 0.0)
            found += doubt(f"conditions.{f.name}", value, "N m", 0.0, kind.largest_torque)  # small loads are tests
    for number, (torque, speed, _) in enumerate(getattr(conditions, "duty", None) or ()):
        found += doubt(f"duty[{number}].output_torque", abs(torque), "N m", 0.0, kind.largest_torque)
        found += doubt(f"duty[{number}].output_speed", abs(speed), "rad/s", 0.0, kind.speed)
        found += _of_another_size(design, f"duty[{number}].output_torque", abs(torque))
    found += _of_another_size(design, "conditions.rated_torque", abs(getattr(conditions, "rated_torque", None) or 0.0))
    for field, tolerance, about in _toleranced(tolerances):
        half, unit = float(tolerance.half_width), about["unit"]
        what, times = stated_by(forms, field)
        if half and unit in HALF_WIDTH:
            ends = [times * end for end in (half, *HALF_WIDTH[unit])]
            found += doubt(f"tolerances.{field}: {what}", ends[0], unit, *ends[1:])
    given = {name for name, _, _ in _toleranced(tolerances)}
    found += [
        f"tolerances.{name}: {bound.placed} is the same error with its place, and sampled separately; without {name} "
        "the one follows"
        for name, bound in described(tolerances, "bounds").items()
        if {name, bound.placed} <= given
    ]
    return found + kind.doubts(design)


def _of_another_size(design: Design, name: str, torque: float) -> list[str]:
    """A rated torque of catalogues that does not fit the design: it may be left from the study of another size."""
    line = kind_of(design).of_another_size(design, torque)
    return [f"{name} = {shown(torque, 'N m')}: {line}"] if line else []


def doubtful_limits(requirements: Mapping[str, Limits], outputs: Mapping[str, Output]) -> list[str]:
    """Upper limits far below what any known reducer has, a line each.

    Args:
        requirements: by name of the output.
        outputs: by name.
    """
    found = []
    for name, requirement in requirements.items():
        (unit, size), least = outputs[name].shown, outputs[name].least
        if 0 < requirement.upper < least / FAR_LIMIT:
            limit, known = (with_unit(number / size, unit) for number in (requirement.upper, least))
            found.append(f"requirement.{name}.upper = {limit}: no known reducer has less than {known}; check the unit")
    return found


def doubtful_costs(costs: Mapping[str, Cost], tolerances: Record) -> list[str]:
    """Process ranges that are far from those of known parts, or that exclude the initial tolerance, a line each.

    Args:
        costs: by field.
        tolerances: of the study.
    """
    found = []
    for field, tolerance, about in _toleranced(tolerances):
        if field not in costs:
            continue
        unit, half = about["unit"], float(tolerance.half_width)
        finest, coarsest = float(costs[field].finest), float(costs[field].coarsest)
        for name, value in (("finest", finest), ("coarsest", coarsest)):
            if unit in HALF_WIDTH:
                found += doubt(f"cost.{field}.{name}", value, unit, *HALF_WIDTH[unit])
        likely = unit not in HALF_WIDTH or not doubt("", half, unit, *HALF_WIDTH[unit])  # else it has its line already
        if half and likely and not finest * (1 - 1e-9) <= half <= coarsest * (1 + 1e-9):
            found.append(
                f"cost.{field}: the process holds half-widths of {shown(finest, unit)} to {shown(coarsest, unit)}; "
                f"the initial one is {shown(half, unit)}"
            )
    return found


def _toleranced(tolerances: Record) -> Iterator[tuple[str, Tolerance, Metadata]]:
    for f in dataclasses.fields(tolerances):
        if (tolerance := getattr(tolerances, f.name)) is not None:
            yield f.name, tolerance, f.metadata
