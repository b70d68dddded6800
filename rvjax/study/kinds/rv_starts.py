"""New studies of an RV reducer, those of `rvjax init`: of the loaded reducer, and of the four-bar model.

Numbers that a drawing does not give are those of the nearest known reducer by scaling laws (`scaling.toml`). Every such
number has a reason with the word "assumed", the scaling law and the interval in which it is used.
"""

import dataclasses
import functools
import re
from collections.abc import Mapping

import numpy as np

from rvjax.bearings import RollingBearing
from rvjax.catalogue import ASSUMED, RV_40E_WHOLE, fields_of_kind, part_class, shown
from rvjax.designs import Bearings, InvoluteStage, RVReducer
from rvjax.life import static_rating
from rvjax.population import it_width, tolerance_unit
from rvjax.records import PyTree, Scalar
from rvjax.study.kinds.kind import Assumed, Choices, Known, Numbers, Start
from rvjax.study.kinds.rv_facts import AXIAL, FOLLOWING, KNOWN_REDUCERS, LAWS, NAMES, RATED, SIZES
from rvjax.study.kinds.scaling import Law, number_at, outside, rewritten, scaled_line, stated, with_torque
from rvjax.study.values import in_unit
from rvjax.units import mm, um

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
MODIFICATIONS = ("cycloid.equidistant_modification", "cycloid.shift_modification")
STIFFNESS = "cranks.bearing_stiffness"
IN_DISC = "bearings.arm."
EQUIDISTANT = "equidistant_modification"
CHOICES = Choices(
    {"cycloid.eccentricity": (0.8, 1.2), RING: (0.95, 1.1), "cycloid.pin_radius": (0.85, 1.15),
     MODIFICATIONS[0]: (-5.0, 5.0)},
    volume=10.0, limits={"convex_radius": 0.6, "pin_gap": 0.5, "crank_room": 0.99, "envelope_diameter": 1.03},
)  # fmt: skip
RULE = """# Tolerances, costs and process ranges are assumed. They are those of the study rv-40e-whole in proportion to
# the tolerance unit of ISO 286, i = 0.45 D^(1/3) + 0.001 D, of the size that each belongs to (in brackets).
# Angles and prices stay.

"""
HEAD = """# A study of the loaded reducer to change, with the numbers of the {name}: replace them by those of
# your drawing, then run rvjax check on this file. A line with "assumed" has no published value. It has that
# of the nearest known reducer, by a scaling law of rvjax/study/scaling.toml where sizes differ.

"""
UNREAD = """# The loaded model uses teeth, base circles and pressure angle of the gears, and K1 = e zp / rp = {k1:.4g}.
# It does not use module, centre distance, radius of the sun and a published K1, so that no contradiction remains.
"""


def completed(given: Numbers) -> dict[str, Assumed]:
    """Numbers of the loaded reducer that are not given, by path.

    Args:
        given: numbers by path, SI; those in `NEEDED` among them.
    """
    found = _geometry(given)
    numbers = {**given, **{path: item.value for path, item in found.items()}}
    follows = {path: numbers[path] for path in NAMES if path in numbers}
    for path, _, default in fields_of_kind(RVReducer, given=given):
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


OWN = {name: design for name, design in KNOWN_REDUCERS.items() if name != "rv-40e"}  # a part of the whole one
"""Known reducers, from whose numbers others are scaled."""


def _law_of(path: str) -> Law | None:
    return next((law for law in LAWS if path in law.numbers), None)


@functools.cache
def _whole(name: str) -> RVReducer:
    """A known reducer with every number that a scaling law reads."""
    design = OWN[name]
    if design.contact is None:
        width = FOLLOWING.changed(RV_40E_WHOLE, {RING: design.cycloid.pin_circle_radius}, whole=True).contact
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


def rated_torque(given: Known) -> Assumed:
    """Rated torque at 15 r/min, N m: of a known size, else from the nearest size of a catalogue.

    Args:
        given: the reducer as its source gives it.
    """
    if given.name in RATED:
        return Assumed(RATED[given.name], "rated torque of the catalogue")
    law, ring = _law_of("rated_torque"), given.numbers[RING]
    assert law is not None
    name = _nearest(ring, list(OWN))
    donor = OWN[name]
    target = FOLLOWING.changed(donor, {RING: ring}, whole=True)
    ratio = ring / donor.cycloid.pin_circle_radius
    value = RATED[name] * ratio ** law.follows[RING]
    return Assumed(float(f"{value:.3g}"), *_reason(law, donor, target, name))


def tolerance_ratios(numbers: Numbers) -> dict[str, tuple[float, str]]:
    """Ratio of each tolerance to that of `rv-40e-whole`, rounded to 0.01, and the size that it belongs to.

    Args:
        numbers: of the design by path, SI.
    """
    found = dict[str, tuple[float, str]]()
    for entry in SIZES:
        factor, path = (2, entry["radius"]) if "radius" in entry else (1, entry["diameter"])
        own, known = (tolerance_unit(factor * x) for x in (numbers[path], number_at(RV_40E_WHOLE, path)))
        found |= dict.fromkeys(entry["errors"], (round(float(own / known), 2), entry["size"]))
    return found


def arm_force(bearing: RollingBearing) -> float:
    """Largest force of a turning-arm bearing at rated torque for static safety at start and stop, N.

    Args:
        bearing: in a disc.
    """
    return float(np.floor(float(static_rating(bearing)) / SAFETY / START / 100) * 100)


def _of_the_loaded(given: Known, example: RVReducer) -> tuple[Numbers, dict[str, Assumed]]:
    # Modifications that a four-bar study assumes take up its bearing clearance; here they would press the pins.
    own = {
        path: x
        for path, x in given.numbers.items()
        if path not in MODIFICATIONS or not ASSUMED.search(given.said.get(path, ""))
    }
    found = completed(own)
    if not any(own.get(path) for path in MODIFICATIONS):
        ratio, _ = tolerance_ratios({**own, **{path: item.value for path, item in found.items()}})[EQUIDISTANT]
        much = f"{ratio:.3g} times" if ratio != 1 else "as"
        value = ratio * number_at(example, MODIFICATIONS[0])
        found[MODIFICATIONS[0]] = Assumed(value, f"assumed: {much} that of the study rv-40e-whole")
    return own, found


def _of_four_bars(given: Known, example: RVReducer) -> tuple[Numbers, dict[str, Assumed]]:
    """Unpublished values are assumed as in the study of the RV-40E."""
    found = completed(given.numbers) if given.drawing else {}
    lacking = [] if any(given.numbers.get(path) for path in MODIFICATIONS) else [*MODIFICATIONS]
    lacking += [STIFFNESS] if given.numbers.get(STIFFNESS) is None else []
    return given.numbers, found | {path: Assumed(number_at(example, path), "assumed") for path in lacking}


def _with_torque(text: str, numbers: Numbers, given: Known) -> str:
    """Tables of the four-bar study with the rated torque of this reducer."""
    return rewritten(text, lambda path, match: with_torque(path, match, given.torque.value if given.torque else None))


def _unread(numbers: Numbers) -> str:
    e, pins, ring = (numbers[f"cycloid.{name}"] for name in ("eccentricity", "pin_count", "pin_circle_radius"))
    return UNREAD.format(k1=float(e * pins / ring))


def _tables(text: str, numbers: Numbers, given: Known) -> str:
    """Tables after [design] of a loaded study: those of `rv-40e-whole`, in proportion to the size of the reducer.

    Args:
        text: of `rv-40e-whole`.
        numbers: of the design by path, SI.
        given: the reducer, with its rated torque.
    """
    assert given.torque is not None
    torque = given.torque
    arm = {path.removeprefix(IN_DISC): x for path, x in numbers.items() if path.startswith(IN_DISC)}
    bearing: PyTree = part_class(Bearings, "arm", arm)(**arm)
    sizes, limit = tolerance_ratios(numbers), arm_force(bearing)
    ratios = {e: (ratio, f"assumed: {ratio:g} times that of the RV-40E ({size})") for e, (ratio, size) in sizes.items()}
    scale = numbers[ARM] / number_at(RV_40E_WHOLE, ARM)
    bore = float(f"{25e-3 * scale:.4g}")

    def line(path: tuple[str, ...], match: re.Match[str]) -> str:
        if path[-1].endswith("_torque"):
            return with_torque(path, match, torque.value, torque.why)
        if path[:2] == ("requirement", "arm_bearing_force"):
            return stated(match, in_unit(limit, "N", 6), match["note"])
        if path[-1] == "size":
            return (
                match[0]
                if scale == 1
                else stated(match, f"{bore / mm:.6g} mm", "assumed: follows the turning-arm bearing")
            )
        limited = path[0] == "requirement" and path[1] != "misfit"
        return match[0] if limited else scaled_line(path, match, ratios)

    made = rewritten(text, line).replace("C0 = 33 kN", f"C0 = {float(static_rating(bearing)) / 1e3:.3g} kN")
    made = re.sub(r'^grade = "(\w+)".*', lambda grade: _grade(grade[1], bore), made, flags=re.MULTILINE)
    similar = all(ratio == 1 for ratio, _ in sizes.values())
    return made if similar else made.replace("# First stage\n", f"{RULE}# First stage\n", 1)


def _grade(grade: str, size: float) -> str:
    """Line of a grade, with its half-width at a size, m."""
    return f'grade = "{grade}" # +-{it_width(grade, size) / 2 / um:g} um'


STARTS = {
    "loaded": Start("rv-40e-whole", PARTS, HEAD, _of_the_loaded, _tables, _unread, CHOICES),
    "four-bar": Start("rv-40e", ("involute", "cycloid", "cranks"), complete=_of_four_bars, tables=_with_torque),
}
