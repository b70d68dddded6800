"""Checks of the input values: impossible values raise an error, unusual values give a warning.

A wrong unit in a file is not detected elsewhere.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rvjax import catalogue
from rvjax.designs import RVReducer
from rvjax.errors import described
from rvjax.records import Design, PyTree, Scalar
from rvjax.study.design import walk
from rvjax.study.values import Metadata
from rvjax.tolerances import Cost, Middle, Tolerance
from rvjax.units import suited

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MOST_PRESSURE = math.radians(45)  # beyond, no tooth has a tip
FAR = 30.0  # factor from every known reducer beyond which a number is doubted
FAR_INERTIA = 1000.0  # grows with the fifth power of a length: 50 between the sizes 20 and 320
KNOWN_DESIGNS = (catalogue.CORR, catalogue.RV_20E, catalogue.RV_40E, catalogue.RV_80E, catalogue.RV_320E)
RATED = {"rv-20e": 167.0, "rv-40e": 412.0, "rv-80e": 784.0, "rv-320e": 3136.0}  # N m at 15 rpm, as makers print it
TORQUE = min(RATED.values()), max(RATED.values())
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
            widest[f"cost.{field}.coarsest = {shown(coarsest, about['unit'])}"] = tolerance.with_half_width(coarsest)
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


def doubts(design: PyTree, conditions: "DataclassInstance", tolerances: PyTree) -> list[str]:
    """Numbers that are far from those of every known reducer, a line each."""
    known = [dict(numbers(one)) for one in KNOWN_DESIGNS if type(one) is type(design)]
    found = []
    for name, (value, unit) in numbers(design):
        seen = [abs(one[name][0]) for one in known if name in one and one[name][0]]
        if value and seen:
            found += _doubt(f"design.{name}", abs(value), unit, min(seen), max(seen))
    for f in dataclasses.fields(conditions):
        if f.metadata["torque"] and isinstance(design, RVReducer):
            value = abs(getattr(conditions, f.name) or 0.0)
            found += _doubt(f"conditions.{f.name}", value, "N m", 0.0, TORQUE[1])  # small loads are tests
    for field, tolerance, about in _toleranced(tolerances):
        half, unit = float(tolerance.half_width), about["unit"]
        if half and unit in HALF_WIDTH:
            found += _doubt(f"tolerances.{field}: half-width", half, unit, *HALF_WIDTH[unit])
    given = {name for name, _, _ in _toleranced(tolerances)}
    found += [
        f"tolerances.{name}: {bound.placed} is the same error with its place, and sampled separately; without {name} "
        "the one follows"
        for name, bound in described(tolerances, "bounds").items()
        if {name, bound.placed} <= given
    ]
    if isinstance(design, RVReducer) and (odd := design.cycloid.pin_count - design.cycloid.disc_teeth) != 1:
        found.append(f"design.cycloid.pin_count: {odd} more than disc_teeth; known reducers have one more")
    return found + (_collisions(design) if isinstance(design, RVReducer) else [])


def _doubt(name: str, value: float, unit: str, least: float, most: float) -> list[str]:
    far = FAR_INERTIA if unit == "kg m2" else FAR
    if least / far <= value <= far * most:
        return []
    span = f"{shown(least, unit)} to {shown(most, unit)}" if least else f"up to {shown(most, unit)}"
    return [f"{name} = {shown(value, unit)}: known reducers have {span}; is the unit right?"]


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
            f"whose teeth end {shown(root, 'm')} from the middle"
        )


def _collisions(design: RVReducer) -> list[str]:
    """Neighbouring planets of one plane whose teeth overlap; published numbers that do so stay without a word."""
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
    """The size of what an error deviates from, or None."""
    if not path:
        return None
    for name in path.split("."):
        design = getattr(design, name)
    return abs(float(np.max(np.asarray(design))))


def _toleranced(tolerances: PyTree) -> Iterator[tuple[str, Tolerance, Metadata]]:
    for f in dataclasses.fields(tolerances):
        if (tolerance := getattr(tolerances, f.name)) is not None:
            yield f.name, tolerance, f.metadata


def numbers(design: PyTree) -> Iterator[tuple[str, tuple[float, str]]]:
    """(path, (value of the largest size, SI unit)) of every quantity with a unit in a design."""
    for path, value, about in walk(design):
        if about["kind"] != "count" and about["unit"] not in ("-", "rad"):
            flat = np.ravel(np.asarray(value, float))
            yield path, (float(flat[np.argmax(np.abs(flat))]), about["unit"])


def shown(value: Scalar, unit: str) -> str:
    """A number with the largest unit in which it is at least one.

    Args:
        value: SI.
        unit: its SI unit.
    """
    name, size = suited(float(value), unit)
    return f"{float(value) / size:.4g} {name}" if unit != "-" else f"{float(value):.4g}"
