"""Checks of the input values: impossible values raise an error, unusual values give a warning.

A wrong unit in a file is not detected elsewhere.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from rvjax._reducer.plausible import KNOWN_DESIGNS, doubt, doubtful, shown, steep
from rvjax.designs import RollerBearing, RVReducer
from rvjax.errors import described
from rvjax.life import dynamic_rating, static_rating
from rvjax.outputs import Output
from rvjax.records import Design, PyTree
from rvjax.study.toleranced import Form, stated_by
from rvjax.study.values import Metadata
from rvjax.tolerances import Cost, Limits, Middle, Tolerance
from rvjax.units import rpm

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MOST_PRESSURE = math.radians(45)  # beyond, no tooth has a tip
RATED = {"rv-20e": 167.0, "rv-40e": 412.0, "rv-80e": 784.0, "rv-320e": 3136.0}  # N m at 15 rpm, as makers print it
TORQUE = min(RATED.values()), max(RATED.values())
FAR_LIMIT = 10.0  # below the smallest known value of an output; assumed
OF_SIZE = 0.9e6, 2.75e6  # rated torque over the cube of the pin circle, N/m2: 1.2e6 to 2.1e6 in RATED, widened by 1.3
FAR_RATING = 5.0  # between a given rating and that of the same rollers; assumed
SPEED = 75 * rpm  # of the output, at most: an RV-20E, as its maker prints it
HALF_WIDTH = {"m": (0.5e-6, 40e-6), "rad": (1e-4, 9e-3), "-": (0.01, 0.3)}  # of the studies and sources in this package


def refuse_impossible(design: Design, tolerances: PyTree, costs: dict[str, Cost], middles: dict[str, Middle]) -> None:
    """Raise an error for parts that do not fit into each other, and for errors as large as the part.

    Raises:
        ValueError: names the key, its value and what it collides with.
    """
    if isinstance(design, RVReducer):
        _fits_together(design)
    for field, tolerance, about in _toleranced(tolerances):
        part = _part(design, about["of"]) if about["unit"] != "-" else None
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
    design: PyTree,
    conditions: "DataclassInstance",
    tolerances: PyTree,
    forms: Mapping[str, Form] = MappingProxyType({}),
) -> list[str]:
    """Numbers that are far from those of every known reducer, a line each; tolerances as the file states them."""
    found = [f"design.{line}" for line in steep(design) + doubtful(design)]
    for f in dataclasses.fields(conditions):
        if f.metadata["torque"] and isinstance(design, RVReducer):
            value = abs(getattr(conditions, f.name) or 0.0)
            found += doubt(f"conditions.{f.name}", value, "N m", 0.0, TORQUE[1])  # small loads are tests
    for number, (torque, speed, _) in enumerate(getattr(conditions, "duty", None) or ()):
        found += doubt(f"duty[{number}].output_torque", abs(torque), "N m", 0.0, TORQUE[1])
        found += doubt(f"duty[{number}].output_speed", abs(speed), "rad/s", 0.0, SPEED)
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
    if isinstance(design, RVReducer) and (odd := design.cycloid.pin_count - design.cycloid.disc_teeth) != 1:
        found.append(f"design.cycloid.pin_count: {odd} more than disc_teeth; known reducers have one more")
    return found + (_bearings(design) + _collisions(design) if isinstance(design, RVReducer) else [])


def _of_another_size(design: Design, name: str, torque: float) -> list[str]:
    """A rated torque of catalogues that does not fit the pin circle: it may be left from the study of another size."""
    sizes = [size for size, rated in RATED.items() if math.isclose(torque, rated, rel_tol=1e-3)]
    if not sizes or not isinstance(design, RVReducer):
        return []
    least, most = (share * float(design.cycloid.pin_circle_radius) ** 3 for share in OF_SIZE)
    if least <= torque <= most:
        return []
    return [
        f"{name} = {shown(torque, 'N m')}: rated torque of the {sizes[0]}; with this pin circle known reducers have "
        f"{shown(least, 'N m')} to {shown(most, 'N m')}"
    ]


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
            found.append(
                f"requirement.{name}.upper = {requirement.upper / size:.4g} {unit}: no known reducer has less than "
                f"{least / size:.4g} {unit}; check the unit"
            )
    return found


def doubtful_costs(costs: Mapping[str, Cost], tolerances: PyTree) -> list[str]:
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


def _fits_together(design: RVReducer) -> None:
    cycloid, cranks = design.cycloid, design.cranks
    if cycloid.pin_count <= cycloid.disc_teeth:
        raise ValueError(
            f"design.cycloid.pin_count = {cycloid.pin_count}: must exceed disc_teeth = {cycloid.disc_teeth}, by one in "
            "every known reducer"
        )
    if not design.involute.pressure_angle < MOST_PRESSURE:
        raise ValueError(
            f"design.involute.pressure_angle = {shown(design.involute.pressure_angle, 'rad')}: must lie below "
            f"{shown(MOST_PRESSURE, 'rad')}; gears have 14.5 to 30 deg"
        )
    pitch = cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count)
    if cycloid.pin_radius >= pitch:
        raise ValueError(
            f"design.cycloid.pin_radius = {shown(cycloid.pin_radius, 'm')}: the pins overlap from {shown(pitch, 'm')} "
            f"on ({cycloid.pin_count} pins on a circle of radius {shown(cycloid.pin_circle_radius, 'm')})"
        )
    root = cycloid.pin_circle_radius - cycloid.pin_radius - cycloid.eccentricity
    if cranks.circle_radius >= root:
        raise ValueError(
            f"design.cranks.circle_radius = {shown(cranks.circle_radius, 'm')}: the cranks lie outside the discs, "
            f"whose teeth end {shown(root, 'm')} from the centre"
        )


def _bearings(design: RVReducer) -> list[str]:
    """Given ratings of the crank bearings that are far from what their rollers can carry."""
    found = []
    for place in ("arm", "support"):
        bearing: RollerBearing | None = getattr(design.bearings, place, None)
        for name, rating in (("capacity", dynamic_rating), ("static_capacity", static_rating)):
            if bearing is not None and (given := getattr(bearing, name)) is not None:
                own = float(rating(bearing.replace(**{name: None})))
                if not own / FAR_RATING <= float(given) <= own * FAR_RATING:
                    found.append(
                        f"design.bearings.{place}.{name} = {shown(given, 'N')}: its rollers have a rating of "
                        f"{shown(own, 'N')}; check the unit"
                    )
    return found


def _collisions(design: RVReducer) -> list[str]:
    """Neighbouring planets of one plane whose teeth overlap; published numbers with such an overlap give no warning."""
    stage, cranks = design.involute, design.cranks
    counted = stage.sun_teeth, stage.planet_teeth, cranks.count
    if any(counted == (k.involute.sun_teeth, k.involute.planet_teeth, k.cranks.count) for k in KNOWN_DESIGNS[1:]):
        return []
    half = cranks.circle_radius * math.sin(math.pi / cranks.count)
    tip = stage.module * (stage.planet_teeth + 2) / 2
    if tip < half:
        return []
    return [
        f"design.involute: the planets overlap: tip radius {shown(tip, 'm')} for teeth without shift, half their "
        f"distance {shown(half, 'm')}"
    ]


def _part(design: Design, path: str) -> float | None:
    """Nominal size that an error deviates from, or None."""
    if not path:
        return None
    for name in path.split("."):
        design = getattr(design, name)
    return abs(float(np.max(np.asarray(design))))


def _toleranced(tolerances: PyTree) -> Iterator[tuple[str, Tolerance, Metadata]]:
    for f in dataclasses.fields(tolerances):
        if (tolerance := getattr(tolerances, f.name)) is not None:
            yield f.name, tolerance, f.metadata
