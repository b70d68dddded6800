"""Numbers that a drawing does not give, from the nearest known reducer by scaling laws (`scaling.toml`).

Every such number has a reason with the word "assumed", the scaling law and the interval in which it is used.
"""

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from rvjax import catalogue
from rvjax._reducer.plausible import shown
from rvjax.designs import InvoluteStage, RVReducer
from rvjax.life import static_rating
from rvjax.records import PyTree, Scalar
from rvjax.study.kinds.following import Law, fields_of_kind, number_at, outside
from rvjax.study.kinds.kind import Assumed, Numbers
from rvjax.study.kinds.rv import plausible
from rvjax.study.kinds.rv.facts import AXIAL, FOLLOWING, LAWS, NAMES, SIZES
from rvjax.study.kinds.rv.plausible import RATED
from rvjax.units import mm

RING, CIRCLE, DISCS = "cycloid.pin_circle_radius", "cranks.circle_radius", "cycloid.disc_count"
ARM = "bearings.arm.pitch_diameter"
NEEDED = (
    "involute.sun_teeth", "involute.planet_teeth", "involute.module", "cycloid.disc_teeth", "cycloid.pin_count",
    "cycloid.eccentricity", RING, "cycloid.pin_radius", "cranks.count",
)  # fmt: skip
"""Numbers that a drawing must give."""
PARTS = ("involute", "cycloid", "cranks", "stiffness", "contact", "bearings")
"""Parts of a design that the loaded model reads."""
PLACES = ("bearings.disc_position", "bearings.planet_position", "bearings.support_span")
SAFETY, START = 1.5, 2.5  # assumed: static safety at start and stop, whose torque is 2.5 times the rated one


def completed(given: Numbers) -> dict[str, Assumed]:
    """Numbers of the loaded reducer that are not given, by path.

    Args:
        given: numbers by path, SI; those in `NEEDED` among them.
    """
    found = _geometry(given)
    numbers = {**given, **{path: item.value for path, item in found.items()}}
    follows = {path: numbers[path] for path in NAMES if path in numbers}
    for path, _, default in fields_of_kind(RVReducer):
        if path.split(".")[0] not in PARTS or path in numbers or path in PLACES:
            continue
        if default is not dataclasses.MISSING and _law_of(path) is None:
            continue
        if near := [name for name in OWN if number_at(OWN[name], path)]:
            found[path] = _scaled(path, follows, _nearest(numbers[RING], near))
    if not any(path in numbers for path in PLACES):
        found |= _places(follows, numbers[DISCS])
    if ARM in found and (tight := _tight({**numbers, **{path: item.value for path, item in found.items()}})):
        found[ARM] = dataclasses.replace(found[ARM], outside=(*found[ARM].outside, tight))
    return found


OWN = {name: design for name, design in plausible.OWN.items() if name != "rv-40e"}  # a part of the whole one
"""Known reducers, from whose numbers others are scaled."""


def _law_of(path: str) -> Law | None:
    return next((law for law in LAWS if path in law.numbers), None)


@functools.cache
def _whole(name: str) -> RVReducer:
    """A known reducer with every number that a scaling law reads."""
    design = OWN[name]
    if design.contact is None:
        width = FOLLOWING.changed(catalogue.RV_40E_WHOLE, {RING: design.cycloid.pin_circle_radius}, whole=True).contact
        design = design.replace(contact=width)
    return design


def called(name: str) -> str:
    """Name of a known reducer in text, such as "RV-40E"."""
    return name.upper().removesuffix("-WHOLE")


def _nearest(ring: Scalar, names: list[str]) -> str:
    """The known reducer whose pin circle is nearest by its ratio."""
    return min(names, key=lambda name: abs(float(np.log(ring / OWN[name].cycloid.pin_circle_radius))))


def _geometry(given: Numbers) -> dict[str, Assumed]:
    """Numbers of gears, cranks and discs that a drawing may leave open."""
    found = dict[str, Assumed]()
    near = _nearest(given[RING], list(OWN))
    angle = "involute.pressure_angle"
    if angle not in given:
        found[angle] = Assumed(OWN[near].involute.pressure_angle, "assumed: standard")
    teeth = (given["involute.sun_teeth"], given["involute.planet_teeth"])
    pressure = given.get(angle, OWN[near].involute.pressure_angle)
    gears = InvoluteStage.from_teeth(*teeth, module=given["involute.module"], pressure_angle=pressure)
    for name in ("centre_distance", "sun_radius", "sun_base_radius", "planet_base_radius"):
        if f"involute.{name}" not in given:
            found[f"involute.{name}"] = Assumed(getattr(gears, name), "follows from teeth and module")
    if CIRCLE not in given:
        centre = given.get("involute.centre_distance", gears.centre_distance)
        found[CIRCLE] = Assumed(centre, "follows: the centre distance")
    if DISCS not in given:
        found[DISCS] = Assumed(OWN[near].cycloid.disc_count, f"assumed: as the {called(near)}")
    return found


def _scaled(path: str, follows: Mapping[str, Scalar], name: str) -> Assumed:
    """A number of a known reducer, by the scaling law that it follows."""
    donor = _whole(name)
    target = FOLLOWING.changed(donor, follows, whole=True)
    return Assumed(number_at(target, path), *_reason(_law_of(path), donor, target, name))


def _reason(law: Law | None, donor: RVReducer, target: RVReducer, name: str) -> tuple[str, tuple[str, ...]]:
    """Reason of an assumed number, and lines on ratios outside the interval."""
    same = f"assumed: as the {called(name)}"
    if law is None:
        return same, ()
    ratios = {path: float(number_at(target, path) / number_at(donor, path)) for path in law.follows}
    if all(abs(ratio - 1) < 1e-9 for ratio in ratios.values()):
        return same, ()
    said = ", ".join(f"{NAMES[path].replace('_', ' ')} {ratio:.3g}" for path, ratio in ratios.items())
    holds = f"holds for {law.interval[0]:g} to {law.interval[1]:g}"
    far = tuple(outside(donor, target, [law], f"the {called(name)}"))
    why = f'assumed: scaling law "{law.name}", {said} of the {called(name)} ({holds})'
    return why + ("; warning: outside of it" if far else ""), far


def _places(follows: Mapping[str, Scalar], discs: int) -> dict[str, Assumed]:
    """Axial places: those of a known reducer in proportion to the width; further discs side by side."""
    name = "rv-40e-whole"  # no other has them
    donor = _whole(name)
    target = FOLLOWING.changed(donor, follows, whole=True)
    own, why = target.bearings, _reason(AXIAL, donor, target, name)
    assert own is not None
    first, last = (float(own.disc_position[k]) for k in (0, -1))
    pitch = (last - first) / (len(own.disc_position) - 1)
    more = discs - len(own.disc_position)
    if more:
        why = (f"{why[0]}; {discs} discs side by side", why[1])
    places = [first + pitch * k for k in range(discs)]
    values = places, float(own.planet_position), float(own.support_span) + pitch * more
    return {path: Assumed(value, *why) for path, value in zip(PLACES, values)}


def _tight(numbers: Numbers) -> str:
    """Line on a turning-arm bearing without space between the crank axis and the roots of the disc, else ""."""
    ring, pin, e = (numbers[f"cycloid.{name}"] for name in ("pin_circle_radius", "pin_radius", "eccentricity"))
    least = 2 * min(ring - pin - 2 * e - numbers[CIRCLE], numbers[CIRCLE] * np.sin(np.pi / numbers["cranks.count"]))
    outer = numbers[ARM] + numbers["bearings.arm.roller_diameter"]
    if outer < least:
        return ""
    return f"bearings.arm: {shown(outer, 'm')} across the rollers, but the disc has {shown(least, 'm')} there (assumed)"


def rated_torque(numbers: Numbers) -> Assumed:
    """Rated torque at 15 r/min, N m, from the nearest size of a catalogue."""
    law, ring = _law_of("rated_torque"), numbers[RING]
    assert law is not None
    name = _nearest(ring, list(OWN))
    donor = OWN[name]
    target = FOLLOWING.changed(donor, {RING: ring}, whole=True)
    ratio = ring / donor.cycloid.pin_circle_radius
    value = RATED[name] * ratio ** law.follows[RING]
    return Assumed(float(f"{value:.3g}"), *_reason(law, donor, target, name))


def tolerance_unit(diameter: Scalar) -> Scalar:
    """Tolerance unit i of ISO 286-1, m.

    Args:
        diameter: nominal size, m.
    """
    size = diameter / mm
    return 1e-6 * (0.45 * size ** (1 / 3) + 0.001 * size)


def tolerance_ratios(numbers: Numbers) -> dict[str, tuple[float, str]]:
    """Ratio of each tolerance to that of `rv-40e-whole`, rounded to 0.01, and the size that it belongs to.

    Args:
        numbers: of the design by path, SI.
    """
    found = dict[str, tuple[float, str]]()
    for entry in SIZES:
        factor, path = (2, entry["radius"]) if "radius" in entry else (1, entry["diameter"])
        own, known = (tolerance_unit(factor * x) for x in (numbers[path], number_at(catalogue.RV_40E_WHOLE, path)))
        found |= dict.fromkeys(entry["errors"], (round(float(own / known), 2), entry["size"]))
    return found


def arm_force(bearing: PyTree) -> float:
    """Largest force of a turning-arm bearing at rated torque for static safety at start and stop, N.

    Args:
        bearing: in a disc.
    """
    return float(np.floor(float(static_rating(bearing)) / SAFETY / START / 100) * 100)
