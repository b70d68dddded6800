"""Single-stage cycloidal drives: what follows from their numbers, and numbers that do not fit together."""

import itertools
import math
from collections.abc import Collection, Iterator
from operator import attrgetter
from typing import Any

import numpy as np

from rvjax.catalogue import shown, walk
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.mounting import unit_errors
from rvjax.records import Scalar
from rvjax.study.kinds.drive_starts import FLANK, HOLE, NEEDED, PROCESSES, RATED, START, free_play, rated_torque
from rvjax.study.kinds.kind import Drawing, Kind, drawn, features
from rvjax.study.kinds.rv_facts import pin_facts, refuse_overlap
from rvjax.units import arcmin

INTERFERENCE = 0.1  # of the eccentricity; a smaller hole is a mistake in its diameter
FAR_CLEARANCE = 1 / 25  # of the eccentricity; up to it the angles of the equilibrium hold within 1 %
CONFORMAL = 10.0  # pin radius over eccentricity; beyond, pin and hole are too alike for the Hertzian theory
OF_CURVE = ("loaded_transmission_error", "second_transmission_error", "unloaded_transmission_error", "mean_shift")
"""Outputs that are read from the curve of a span at its samples."""
USUAL = ("backlash", "torsional_stiffness", "turn_pin_pressure", "loaded_pins", "hole_pressure", "efficiency")
TURNING = 0.99  # share of units for which clearances are recommended
HARMONICS = 3  # of the passing holes and pins


def facts(design: CycloidalReducer) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design."""
    cycloid, output, hole = design.cycloid, design.output, _hole(design)
    sense = "opposite to the input" if design.ratio < 0 else "with the input"
    yield "ratio", f"{abs(design.ratio)}:1, output {sense}"
    yield (
        "hole diameter",
        f"{_exact(2 * hole)} = pin {_exact(2 * output.pin_radius)} + 2 x {_exact(cycloid.eccentricity)} + clearance "
        f"{shown(output.hole_clearance, 'm')}",
    )
    yield "discs", _discs(design)
    yield from pin_facts(cycloid)
    yield "gap between holes", shown(2 * (_half_spacing(design) - hole), "m")
    yield "wall outside the holes", shown(_root(design) - output.circle_radius - hole, "m")


def _exact(length: Scalar) -> str:
    """A length as drawings give it."""
    return f"{1e3 * float(length):.6g} mm"


def _hole(design: CycloidalReducer) -> float:
    """Radius of the holes, m."""
    return float(design.output.pin_radius + design.cycloid.eccentricity + design.output.hole_clearance / 2)


def _half_spacing(design: CycloidalReducer) -> float:
    """Half of the distance of neighbouring holes, m."""
    return float(design.output.circle_radius * math.sin(math.pi / design.output.count))


def _root(design: CycloidalReducer) -> float:
    """Radius at which the teeth of the discs end, m."""
    cycloid = design.cycloid
    return float(cycloid.pin_circle_radius - cycloid.pin_radius - cycloid.eccentricity)


def _alike(pins: int, teeth: int, discs: int) -> bool:
    """True if one part serves as every disc: the pattern of holes repeats in the turn between two of them."""
    return pins // math.gcd(pins, teeth) % discs == 0


def _discs(design: CycloidalReducer) -> str:
    """Number of discs, and whether they are equal parts."""
    pins, teeth, discs = design.output.count, design.cycloid.disc_teeth, design.cycloid.disc_count
    if discs == 1:
        return "1"
    if _alike(pins, teeth, discs):
        return f"{discs}, equal parts"
    fits = next(n for n in range(pins + 1, pins + 2 * discs * teeth + 1) if _alike(n, teeth, discs))
    return (
        f"{discs}, different parts: holes turned by {360 / (teeth * discs):.4g} deg against the lobes "
        f"(equal parts with {fits} output pins)"
    )


def refuse(design: CycloidalReducer) -> None:
    """Raise an error for parts that do not fit into each other.

    Raises:
        ValueError: names the key, its value and what it collides with.
    """
    cycloid, output, hole = design.cycloid, design.output, _hole(design)
    if output.hole_clearance < -INTERFERENCE * cycloid.eccentricity:
        due = _exact(2 * (output.pin_radius + cycloid.eccentricity))
        raise ValueError(
            f"design.output.hole_clearance = {shown(output.hole_clearance, 'm')}: holes must have pin diameter + 2 "
            f"eccentricity = {due}, here they have {_exact(2 * hole)}"
        )
    refuse_overlap(cycloid)
    if hole >= (half := _half_spacing(design)):
        raise ValueError(
            f"design.output.pin_radius = {shown(output.pin_radius, 'm')}: the holes have a radius of "
            f"{shown(hole, 'm')} and overlap from {shown(half, 'm')} on ({output.count} holes on a circle of radius "
            f"{shown(output.circle_radius, 'm')})"
        )
    if output.circle_radius + hole >= (root := _root(design)):
        raise ValueError(
            f"design.output.circle_radius = {shown(output.circle_radius, 'm')}: the holes break out of the discs: they "
            f"reach {shown(output.circle_radius + hole, 'm')} from the centre, the teeth end at {shown(root, 'm')}"
        )


def doubts(design: CycloidalReducer) -> list[str]:
    """Numbers with which a drive does not turn freely, or which the contact law is not made for, a line each."""
    cycloid, output, found = design.cycloid, design.output, list[str]()
    if output.hole_clearance < 0:
        found.append(
            f"design.output.hole_clearance = {shown(output.hole_clearance, 'm')}: interference, the output pins are "
            "pressed into their holes"
        )
    if design.bearings is not None:
        arm, inside = design.bearings.arm, output.circle_radius - _hole(design)
        if (reach := (arm.pitch_diameter + arm.element_diameter) / 2) >= inside:
            found.append(
                f"design.bearings.arm.pitch_diameter = {shown(arm.pitch_diameter, 'm')}: the {arm.element}s reach "
                f"{shown(reach, 'm')} from the centre of the disc, its holes begin at {shown(inside, 'm')}"
            )
    if design.contact is not None and output.pin_radius > CONFORMAL * cycloid.eccentricity:
        found.append(
            f"design.output.pin_radius = {shown(output.pin_radius, 'm')}: more than ten times the eccentricity; "
            'pin and hole are too alike for contact = "hertz"'
        )
    return found


def coarse(design: CycloidalReducer, conditions: Any, outputs: Collection[str]) -> list[str]:
    """Angles of a span that see the holes or pins, which the shaft passes, at equal phases: they look like the mean."""
    seen = [name for name in outputs if name in OF_CURVE]
    if not seen:
        return []
    turns = design.cycloid.pin_count if conditions.span == "output_turn" else 1
    each = {"holes": turns * design.output.count, "pins": turns * design.cycloid.disc_teeth}
    orders = {k * order: what for what, order in each.items() for k in range(1, HARMONICS + 1)}
    alike = [f"order {k} of the {what}" for k, what in sorted(orders.items()) if not k % conditions.samples]
    if not alike:
        return []
    fine = next(n for n in itertools.count(conditions.samples) if all(k % n for k in orders))
    return [
        f"conditions.samples = {conditions.samples}: {', '.join(alike)} over the span looks like the mean of "
        f"{', '.join(seen)}; set {fine} or more, no divisor of such an order"
    ]


def inaccurate(design: CycloidalReducer, tolerances: CycloidalErrors) -> list[str]:
    """Clearances with which the linear gaps give wrong forces, at the loose limits of their tolerances: one line."""

    def loosest(name: str, sign: float = 1.0) -> float:
        error = getattr(tolerances, name)
        return 0.0 if error is None else max(sign * float(error.lower), sign * float(error.upper), 0.0)

    flank = float(design.cycloid.equidistant_modification) + loosest("equidistant_modification")
    hole = float(design.output.hole_clearance / 2) + loosest("hole_radius") + loosest("output_pin_radius", -1.0)
    most = float(FAR_CLEARANCE * design.cycloid.eccentricity)
    both = (("of the flanks", flank), ("of the holes (radial)", hole))
    far = " and ".join(f"{shown(each, 'm')} {where}" for where, each in both if each > most)
    if not far:
        return []
    return [
        f"clearance up to {far}: above eccentricity/25 = {shown(most, 'm')} forces and pressures are too low, by a "
        "third at eccentricity/8"
    ]


def turning(design: CycloidalReducer, tolerances: Any, fits: np.ndarray) -> list[str]:
    """Share of units that jam, and the clearances with which 99 % turn.

    Flanks and holes with the same change of their radial clearance change the least clearance of every unit by as much,
    because it is the largest s that all gaps have at one position (docs/models/single_stage.md, Eq. 15).

    Args:
        design: the drive.
        tolerances: of its errors.
        fits: least clearances of random units, m.
    """
    jam = f"{100 * float(np.mean(fits < 0)):.3g} % of {len(fits):,} units jam with these tolerances"
    change = -float(np.quantile(fits, 1 - TURNING))
    numbers = {path: value for path, value, _ in walk(design)}
    flank, hole = numbers[FLANK] + change, numbers[HOLE] + 2 * change
    bearing = tolerances.bearing_clearance
    loose = 0.0 if bearing is None else float(bearing.middle)
    before, after = (free_play({**numbers, **other}, loose) for other in ({}, {FLANK: flank, HOLE: hole}))
    more = f"{abs(after - before) / arcmin:.3g} arcmin {'more' if after > before else 'less'} backlash"
    wide = f"equidistant_modification {shown(flank, 'm')} and hole_clearance {shown(hole, 'm')}"
    return [f"{jam}; {100 * TURNING:g} % turn, flanks and holes changed alike, with {wide}, which have {more}"]


def _caption(design: CycloidalReducer) -> str:
    cycloid, output = design.cycloid, design.output
    return (
        f"Drive along its axis, to scale; diameters: {cycloid.pin_count} pins of {shown(2 * cycloid.pin_radius, 'm')} "
        f"on a circle of {shown(2 * cycloid.pin_circle_radius, 'm')}, {output.count} output pins of "
        f"{shown(2 * output.pin_radius, 'm')} on a circle of {shown(2 * output.circle_radius, 'm')} in holes of "
        f"{_exact(2 * _hole(design))}"
    )


KIND = Kind(
    design=CycloidalReducer,
    name="a single-stage cycloidal drive",
    facts=facts,
    refuse=refuse,
    doubts=doubts,
    coarse=coarse,
    inaccurate=inaccurate,
    remedies=("contact.face_width", "stiffness.eccentric_bearing"),
    usual=USUAL,
    turning=turning,
    rated=RATED,
    orders=attrgetter("orders"),
    multiples=attrgetter("multiples"),
    unit_errors=unit_errors,
    drawing=Drawing(
        drawn("drive.reducer"),
        _caption,
        drawn("drive.before_and_after"),
        "Section of the drive, drawn to scale, before and after",
    ),
    starts={"loaded": START},
    needed=NEEDED,
    torque=rated_torque,
    processes=tuple(PROCESSES),
    features=features("ring", "cycloidal"),
)
