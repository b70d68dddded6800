"""Impossible and unusual numbers of an RV reducer, next to those of known reducers."""

import math

from rvjax._reducer.plausible import shown
from rvjax.catalogue import BASES
from rvjax.designs import RollerBearing, RVReducer
from rvjax.life import dynamic_rating, static_rating
from rvjax.units import rpm

MOST_PRESSURE = math.radians(45)  # beyond, no tooth has a tip
RATED = {"rv-20e": 167.0, "rv-40e": 412.0, "rv-40e-whole": 412.0, "rv-80e": 784.0, "rv-320e": 3136.0}
"""Rated torque at 15 r/min, N m, as makers print it."""
OWN: dict[str, RVReducer] = {name: BASES[name] for name in RATED}
"""Known reducers."""
TORQUE = min(RATED.values()), max(RATED.values())
OF_SIZE = 0.9e6, 2.75e6  # rated torque over the cube of the pin circle, N/m2: 1.2e6 to 2.1e6 in RATED, widened by 1.3
FAR_RATING = 5.0  # between a given rating and that of the same rollers; assumed
SPEED = 75 * rpm  # of the output, at most: an RV-20E, as its maker prints it


def refuse(design: RVReducer) -> None:
    """Raise an error for parts that do not fit into each other.

    Raises:
        ValueError: names the key, its value and what it collides with.
    """
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


def of_another_size(design: RVReducer, torque: float) -> str:
    """Line on a rated torque of catalogues that does not fit the pin circle, else "".

    It may be left from the study of another size.

    Args:
        design: the reducer.
        torque: N m.
    """
    sizes = [size for size, rated in RATED.items() if math.isclose(torque, rated, rel_tol=1e-3)]
    least, most = (share * float(design.cycloid.pin_circle_radius) ** 3 for share in OF_SIZE)
    if not sizes or least <= torque <= most:
        return ""
    return (
        f"rated torque of the {sizes[0]}; with this pin circle known reducers have {shown(least, 'N m')} to "
        f"{shown(most, 'N m')}"
    )


def doubts(design: RVReducer) -> list[str]:
    """Numbers that no known reducer has, a line each."""
    found = []
    if (odd := design.cycloid.pin_count - design.cycloid.disc_teeth) != 1:
        found.append(f"design.cycloid.pin_count: {odd} more than disc_teeth; known reducers have one more")
    return found + _bearings(design) + _collisions(design)


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
    if any(counted == (k.involute.sun_teeth, k.involute.planet_teeth, k.cranks.count) for k in OWN.values()):
        return []
    half = cranks.circle_radius * math.sin(math.pi / cranks.count)
    tip = stage.module * (stage.planet_teeth + 2) / 2
    if tip < half:
        return []
    return [
        f"design.involute: the planets overlap: tip radius {shown(tip, 'm')} for teeth without shift, half their "
        f"distance {shown(half, 'm')}"
    ]
