"""Values that follow from the numbers of an RV reducer, and numbers that are impossible or that no known reducer has.

Pins of the ring are those of RV reducers and single-stage drives.

Ratio, gaps, undercut, contact ratio; radii of standard gears; scaling laws (`scaling.toml`) for a number that changes.

Where a study changes what a number follows from, the number follows; where it gives both, they must agree. A published
design that contradicts itself keeps its numbers as long as nothing of that part is changed.
"""

import math
import tomllib
from collections.abc import Collection, Iterator, Mapping
from importlib import resources

import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import ONCE, quick
from rvjax.catalogue import BASES, sharp_from, shown
from rvjax.designs import BallBearing, CycloidStage, InvoluteStage, RollerBearing, RVReducer
from rvjax.geometry import contact_ratio
from rvjax.life import dynamic_rating, static_rating
from rvjax.records import PyTree, Scalar
from rvjax.study.kinds.scaling import Following, Law, number_at
from rvjax.study.values import Toml, subtable
from rvjax.units import rpm


def half_pitch(cycloid: CycloidStage) -> float:
    """Half of the distance of neighbouring pins of the ring, m: pins of this radius touch."""
    return float(cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count))


def pin_facts(cycloid: CycloidStage) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a cycloid stage.

    Args:
        cycloid: numbers, not traced.
    """
    least = sharp_from(cycloid)
    sharp = "undercut" if cycloid.pin_radius >= least else "no undercut"
    yield "K1", f"{float(cycloid.shortening_coefficient):.4g}"
    yield "gap between pins", shown(2 * (half_pitch(cycloid) - cycloid.pin_radius), "m")
    yield (
        "largest pin without undercut",
        f"{shown(least, 'm')} radius; the pins have {shown(cycloid.pin_radius, 'm')}: {sharp}",
    )


def refuse_overlap(cycloid: CycloidStage) -> None:
    """Raise an error for pins of the ring that overlap.

    Raises:
        ValueError: names the key and its value.
    """
    if cycloid.pin_radius >= (pitch := half_pitch(cycloid)):
        raise ValueError(
            f"design.cycloid.pin_radius = {shown(cycloid.pin_radius, 'm')}: the pins overlap from {shown(pitch, 'm')} "
            f"on ({cycloid.pin_count} pins on a circle of radius {shown(cycloid.pin_circle_radius, 'm')})"
        )


GEARS = ("sun_teeth", "planet_teeth", "module", "pressure_angle")
PROFILE = ("eccentricity", "pin_count", "pin_circle_radius")
# Share by which a given number may differ from what it follows from: rounding of drawings; profile shift of the gears
# (one module at ten and thirty teeth); cranks off the planets' axes by a rounded shift (0.8 % in the RV-320E).
AGREE = {"sun_radius": 2e-3, "sun_base_radius": 2e-3, "planet_base_radius": 2e-3, "centre_distance": 0.05}
AGREE_CIRCLE = 0.02
DERIVED_FROM = frozenset(f"involute.{name}" for name in (*GEARS, *AGREE))
"""Paths that gears and crank circle are derived from."""


def facts(design: RVReducer) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design."""
    yield "ratio", f"{design.ratio:.6g}"
    yield from pin_facts(design.cycloid)
    yield "contact ratio of the gears", f"{float(_overlap(design.involute)):.3g} (teeth without shift)"


_overlap = quick(options=ONCE)(contact_ratio)  # one program instead of one for each operation


def _standard(values: Mapping[str, PyTree]) -> InvoluteStage:
    """Gears without profile shift, with these teeth, module and pressure angle."""
    return InvoluteStage.from_teeth(**{name: values[name] for name in GEARS})


def derivation(design: RVReducer, path: str, value: Scalar) -> str:
    """Derivation of a number of standard gears, or of the crank circle, with the numbers of this design; else "".

    Args:
        design: the reducer.
        path: of the number.
        value: of the number, SI.
    """
    stage = design.involute
    gears = _standard(vars(stage))
    module, angle = shown(stage.module, "m"), f"cos {math.degrees(float(stage.pressure_angle)):g} deg"
    how = {
        "involute.centre_distance": (gears.centre_distance, f"{module} ({stage.sun_teeth} + {stage.planet_teeth})/2"),
        "involute.sun_radius": (gears.sun_radius, f"{module} * {stage.sun_teeth}/2"),
        "involute.sun_base_radius": (gears.sun_base_radius, f"{module} * {stage.sun_teeth}/2 * {angle}"),
        "involute.planet_base_radius": (gears.planet_base_radius, f"{module} * {stage.planet_teeth}/2 * {angle}"),
        "cranks.circle_radius": (stage.centre_distance, "the centre distance"),
    }
    if path not in how or not math.isclose(float(value), float(how[path][0]), rel_tol=1e-9):
        return ""
    return f"derived: {how[path][1]}"


def implied(numbers: Mapping[str, object]) -> list[str]:
    """Radii of standard gears: they follow from teeth and module."""
    own = {path.partition(".")[2]: value for path, value in numbers.items() if path.startswith("involute.")}
    due = _standard(own)
    standard = all(abs(own[name] / getattr(due, name) - 1) < 1e-3 for name in AGREE)
    return [f"involute.{name}" for name in AGREE] if standard else []


def followed(design: RVReducer, given: Toml) -> RVReducer:
    """The design, with what follows from the numbers that a study gives.

    Args:
        design: with these numbers.
        given: the table [design].

    Raises:
        ValueError: a given number contradicts those it follows from; names both.
    """
    gears, profile, cranks = (set(subtable(given, part)) for part in ("involute", "cycloid", "cranks"))
    involute = design.involute
    standard = _standard(vars(involute))
    if gears & set(GEARS):
        involute = involute.replace(**{name: getattr(standard, name) for name in AGREE if name not in gears})
    for name in sorted(gears & set(AGREE)):
        _agree(f"involute.{name}", getattr(involute, name), "teeth and module", getattr(standard, name), AGREE[name])
    circle = design.cranks
    if involute.centre_distance != design.involute.centre_distance or "centre_distance" in gears:
        circle = circle if "circle_radius" in cranks else circle.replace(circle_radius=involute.centre_distance)
    if "circle_radius" in cranks:
        _agree(
            "cranks.circle_radius", circle.circle_radius, "centre_distance", involute.centre_distance, AGREE_CIRCLE,
            "each planet sits on its crank",
        )  # fmt: skip
    cycloid = design.cycloid
    if profile & set(PROFILE) and "shortening" not in profile:
        cycloid = cycloid.replace(shortening=None)
    return design.replace(involute=involute, cranks=circle, cycloid=cycloid)


def _agree(name: str, value: Scalar, source: str, due: Scalar, share: float, why: str = "") -> None:
    if np.any(np.abs(value - due) > share * np.abs(due)):
        reason = f"; {why}" if why else ""
        raise ValueError(
            f"design.{name} = {1e3 * value:.6g} mm: {source} make it {1e3 * due:.6g} mm, more than {share:.3g} of it "
            f"apart{reason}"
        )


_FILE: dict[str, PyTree] = tomllib.loads((resources.files("rvjax.study") / "scaling.toml").read_text("utf-8"))
ANGLE = "involute.pressure_angle"
BASE_RADII = ("involute.sun_base_radius", "involute.planet_base_radius")
SHORTENING = "cycloid.shortening"
LENGTHS = ("cycloid.eccentricity", "cycloid.pin_circle_radius")  # K1 follows them

LAWS = tuple(
    Law(
        **{key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
        | {"follows": {_FILE["numbers"][key]: float(power) for key, power in entry["follows"].items()}}
    )
    for entry in _FILE["law"]
)
"""Ordered: a number that follows comes before the numbers that follow it."""
NAMES: dict[str, str] = {path: name for name, path in _FILE["numbers"].items()}
"""Short names of the numbers that scaling laws read, by their path."""
SIZES: tuple[dict[str, PyTree], ...] = tuple(_FILE["tolerance"])
"""Sizes that tolerances belong to."""

KINEMATIC = next(law for law in LAWS if law.exact)
AXIAL = next(law for law in LAWS if "bearings.disc_position" in law.numbers)  # discs of another width have other places


def _others(
    design: RVReducer, values: Mapping[str, Scalar], new: Mapping[str, PyTree], stands: Collection[str]
) -> dict[str, object]:
    """The derived K1, and base circles of gears with another pressure angle."""
    found: dict[str, PyTree] = {SHORTENING: None} if {*LENGTHS} & {*values} and SHORTENING not in stands else {}
    if ANGLE in values:
        ratio = jnp.cos(values[ANGLE]) / jnp.cos(design.involute.pressure_angle)
        for path in (path for path in BASE_RADII if path not in stands):
            found[path] = (new[path] if path in new else number_at(design, path)) * ratio
    return found


FOLLOWING = Following(
    LAWS,
    _others,
    bound={
        **dict.fromkeys(KINEMATIC.follows, KINEMATIC.numbers),
        **dict.fromkeys(AXIAL.follows, AXIAL.numbers),
        ANGLE: BASE_RADII,
        **dict.fromkeys(LENGTHS, (SHORTENING,)),
    },
    instead={
        **dict.fromkeys(KINEMATIC.numbers, "involute.module; vary that one"),
        SHORTENING: "eccentricity and pin circle radius; vary these",
    },
)

MOST_PRESSURE = math.radians(45)  # beyond, no tooth has a tip
RATED = {"rv-20e": 167.0, "rv-40e": 412.0, "rv-40e-whole": 412.0, "rv-80e": 784.0, "rv-320e": 3136.0}
"""Rated torque at 15 r/min, N m, as makers print it."""
KNOWN_REDUCERS: dict[str, RVReducer] = {name: BASES[name] for name in RATED}
"""Known reducers."""
TORQUE = min(RATED.values()), max(RATED.values())
OF_SIZE = 0.9e6, 2.75e6  # rated torque over the cube of the pin circle, N/m2: 1.2e6 to 2.1e6 in RATED, widened by 1.3
FAR_RATING = 5.0  # between a given rating and that of its size; assumed
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
    refuse_overlap(cycloid)
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
    """Given ratings of the crank bearings that are far from what their rollers or balls can carry."""
    found = []
    for place in ("arm", "support"):
        bearing: RollerBearing | BallBearing | None = getattr(design.bearings, place, None)
        for name, rating in (("capacity", dynamic_rating), ("static_capacity", static_rating)):
            if bearing is not None and (given := getattr(bearing, name)) is not None:
                own = float(rating(bearing.replace(**{name: None})))
                if not own / FAR_RATING <= float(given) <= own * FAR_RATING:
                    found.append(
                        f"design.bearings.{place}.{name} = {shown(given, 'N')}: its {bearing.element}s have a "
                        f"rating of {shown(own, 'N')}; check the unit"
                    )
    return found


def _collisions(design: RVReducer) -> list[str]:
    """Neighbouring planets of one plane whose teeth overlap; published numbers with such an overlap give no warning."""
    stage, cranks = design.involute, design.cranks
    counted = stage.sun_teeth, stage.planet_teeth, cranks.count
    if any(counted == (k.involute.sun_teeth, k.involute.planet_teeth, k.cranks.count) for k in KNOWN_REDUCERS.values()):
        return []
    half = cranks.circle_radius * math.sin(math.pi / cranks.count)
    tip = stage.module * (stage.planet_teeth + 2) / 2
    if tip < half:
        return []
    return [
        f"design.involute: the planets overlap: tip radius {shown(tip, 'm')} for teeth without shift, half their "
        f"distance {shown(half, 'm')}"
    ]
