"""Outlines of discs, rings and carriers for CAD and wire EDM: flank as a closed line, holes, bores and pins as circles.

Each part is seen along the axis, in its frame: origin on its axis, x axis as at input angle 0. The flank of a disc is
the line at the distance rr + equidistant modification from the path of the pin centres (docs/models/loaded.md, Eq. 7;
docs/models/single_stage.md, Eq. 3):

    C(t) = (rp + shift) u(t) - e u(zp t)     F(t) = C(t) + (rr + equidistant - m(zc t)) n(t)

u(t) is the direction of an angle, n the unit normal from the pin into the material, m the material of the profile
modification. The first tooth space of disc 0 is at t = 0; the flank of disc k is turned by -k/nd of a tooth pitch
against its holes.

The flank of an oscillatory roller stage is that of its ring, the inner gear (docs/models/mesh_force.md, Eqs. 1 to 3),
with a tooth space on the y axis; its disc is the cam.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import choose
from rvjax.bearings import RollingBearing
from rvjax.catalogue import undercut
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer, Reducer, ReducerErrors
from rvjax.designs import CamRollerReducer, CycloidStage, RVReducer, expect
from rvjax.errors import CamRollerErrors, RVErrors
from rvjax.flank import profile
from rvjax.geometry.inner_gear import largest_roller_radius, tooth_profile
from rvjax.records import Array, PyTree, Record, Scalar, concrete, field, promote, quantity, record, text
from rvjax.units import um

PARTS = ("disc", "ring", "carrier")
_FIRST, _MOST = 64, 1 << 16  # points of a tooth: of the first look, and at most


@record
class Circle(Record):
    """A circle of an outline."""

    name: str = text("feature of the part")
    x: Scalar = field("m", "centre")
    y: Scalar = field("m", "centre")
    radius: Scalar = field("m", "radius")


@record
class Outline(Record):
    """Outline of a part in its frame."""

    flank: Array = field(
        "m", "points of the closed flank, counter-clockwise; none where the part has no flank", shape=("points", 2)
    )
    normal: Array = field("rad", "direction of the normal from the pin into the material", shape=("points",))
    curvature: Array = field("1/m", "of the flank, > 0 convex", shape=("points",))
    circles: tuple[Circle, ...] = field("-", "holes, bores and pins", kind="record")
    unknown: tuple[str, ...] = text("features whose size the design does not have")


Outlined = RVReducer | CycloidalReducer | CamRollerReducer
Deviations = RVErrors | CycloidalErrors | CamRollerErrors
Line = tuple[Array, Array, Array]  # points (n, 2), direction of the normal (n,), curvature (n,)


def outline(
    design: Outlined, *, part: str = "disc", disc: int = 0, chord: float = 1 * um,
    errors: Deviations | None = None, points: int | None = None,
) -> Outline:  # fmt: skip
    """Outline of a disc, the ring or the carrier; of a roller stage the cam, the inner gear or the cage.

    The flank has derivatives to all numbers of the design, at fixed places of its points.

    Args:
        design: cycloid stage; output pins or cranks; bearings. Or a roller stage.
        part: "disc", "ring" or "carrier".
        disc: number of the disc.
        chord: largest distance between the flank and the line through its points, m.
        errors: sizes of one unit, such as the mid-points of tolerances: modifications, eccentricity, radii and circles
            of pins and holes are read; None: those of the design.
        points: equally spaced on each tooth, in place of the chord: under `jit` and `vmap` their number is given.

    Raises:
        ValueError: a flank that crosses itself, holes that overlap, a number that is out of range, or another kind.
    """
    expect(design, "geometry.outline", *_KINDS)
    kind = _KINDS[type(design)]
    choose("part", part, PARTS)
    if not chord > 0:
        raise ValueError(f"chord = {chord:g} m: must be positive")
    if points is not None and points < 3:
        raise ValueError(f"points = {points}: a tooth needs at least 3")
    discs = design.counts.get("discs", 1)
    if not 0 <= disc < discs:
        raise ValueError(f"disc = {disc}: must lie between 0 and {discs - 1}")
    given = design.error_record() if errors is None else errors
    circles, unknown = kind.circles(design, given, part, disc)
    if part != kind.toothed:
        return Outline(jnp.zeros((0, 2)), jnp.zeros(0), jnp.zeros(0), tuple(circles), tuple(unknown))
    flank, numbers, teeth = kind.flank(design, given, disc)
    plain = jax.lax.stop_gradient(numbers)  # its numbers, under `grad` too
    traced = not concrete(*jax.tree.leaves(plain))
    if traced and points is None:
        raise ValueError("geometry.outline: a design that jit or vmap traces needs `points`")
    if not traced and (lines := kind.undercut(design, plain)):
        raise ValueError(lines[0])
    if points is None:
        t = _places(functools.partial(flank, plain), teeth, chord)
    else:
        t = 2 * np.pi / (points * teeth) * np.arange(points * teeth)
    return Outline(*flank(numbers, jnp.asarray(t)), tuple(circles), tuple(unknown))


Flank = tuple[Callable[..., Line], PyTree, int]
"""The flank as a function of some numbers and the parameters of its points; these numbers; its teeth."""


def _disc_flank(design: Reducer, errors: ReducerErrors, disc: int) -> Flank:
    cycloid = design.cycloid
    ground = cycloid.replace(
        shortening=None, eccentricity=cycloid.eccentricity + errors.eccentricity,
        equidistant_modification=cycloid.equidistant_modification + errors.equidistant_modification,
        shift_modification=cycloid.shift_modification + errors.shift_modification,
    )  # fmt: skip
    turned = -2 * np.pi * disc / (cycloid.disc_count * cycloid.disc_teeth)
    return functools.partial(flank_along, turned=turned), ground, cycloid.disc_teeth


def _of_gear(design: CamRollerReducer, errors: CamRollerErrors, disc: int) -> Flank:
    return _gear_flank, design, design.gear_teeth


def _gear_undercut(design: CamRollerReducer, numbers: CamRollerReducer) -> list[str]:
    limit = float(largest_roller_radius(numbers))
    if numbers.roller_radius < limit:
        return []
    size, most = quantity(numbers.roller_radius, "m"), quantity(limit, "m")
    return [f"CamRollerReducer.roller_radius = {size}: undercut of the inner gear from {most} on"]


@jax.jit
def _gear_flank(design: CamRollerReducer, t: Array) -> Line:
    """Flank of the inner gear at angles t from the y axis, counter-clockwise; its material is outside."""
    found = jax.vmap(tooth_profile, in_axes=(None, 0))(design, -jnp.asarray(t))
    return found.flank, jnp.pi / 2 - found.normal_angle, -found.flank_curvature


def _flank_of(cycloid: CycloidStage, t: Array) -> Array:
    """Points (2, n) of a flank."""
    circle, e, pins = cycloid.pin_circle_radius + cycloid.shift_modification, cycloid.eccentricity, cycloid.pin_count
    wave = pins * t
    across = (
        e * pins * jnp.cos(wave) - circle * jnp.cos(t),
        e * pins * jnp.sin(wave) - circle * jnp.sin(t),
    )  # into the disc
    offset = cycloid.pin_radius + cycloid.equidistant_modification
    if cycloid.profile_modification is not None:
        lobe = cycloid.disc_teeth * t
        offset -= profile(cycloid.profile_modification, jnp.cos(lobe), jnp.sin(lobe))[0]
    part = offset / jnp.sqrt(across[0] ** 2 + across[1] ** 2)
    x, y = circle * jnp.cos(t) - e * jnp.cos(wave), circle * jnp.sin(t) - e * jnp.sin(wave)
    return jnp.stack([x + part * across[0], y + part * across[1]])


@jax.jit
def flank_along(cycloid: CycloidStage, t: Scalar, turned: Scalar = 0.0) -> Line:
    """Points (n, 2) of a flank, undercut or not, direction of its normal (n,) and curvature (n,), turned by an angle.

    Args:
        cycloid: numbers of the flank.
        t: parameters (n,) of the path of the pin centres, rad.
        turned: () rad, counter-clockwise.
    """
    cycloid = promote(cycloid)
    t, turned = (jnp.asarray(x, jnp.asarray(cycloid.eccentricity).dtype) for x in (t, turned))
    ones = jnp.ones_like(t)

    def rate(t: Array) -> tuple[Array, Array]:
        return jax.jvp(functools.partial(_flank_of, cycloid), (t,), (ones,))

    ((x, y), (dx, dy)), (_, (ddx, ddy)) = jax.jvp(rate, (t,), (ones,))
    c, s = jnp.cos(turned), jnp.sin(turned)
    points = jnp.stack([c * x - s * y, s * x + c * y], axis=1)
    return points, jnp.arctan2(dx, -dy) + turned, (dx * ddy - dy * ddx) / (dx * dx + dy * dy) ** 1.5


def _places(flank: Callable[[Array], Line], teeth: int, chord: float) -> np.ndarray:
    """Parameters (n,) of points of all teeth: halved intervals, each short enough for its largest curvature.

    An arc of length s whose curvature is at most k leaves its chord by at most k s^2/8.
    """
    pitch, count = 2 * np.pi / teeth, _FIRST
    while True:
        t = pitch / count * np.arange(count + 1)
        points, _, bend = (np.asarray(values) for values in flank(jnp.asarray(t)))
        bend, length = np.abs(bend), np.hypot(*np.diff(points, axis=0).T) * (1 + 1e-3)
        sagitta = np.maximum(bend[1:], bend[:-1]) * length**2 / 8
        needed = 2 ** math.ceil(math.log2(max(4 * count * math.sqrt(sagitta.max() / chord), 1)))
        if needed <= count:
            break
        if needed > _MOST:
            raise ValueError(f"chord = {chord:g} m: too small, a tooth would have {needed:,} points")
        count = needed
    kept, step = np.ones(count, bool), 1  # beginnings of intervals
    while step < count // 4:  # neighbours become one interval where its arc is flat enough
        starts = np.arange(0, count, 2 * step)
        ends = starts + 2 * step
        bends = np.array([bend[a : b + 1].max() for a, b in zip(starts, ends)])
        lengths = np.array([length[a:b].sum() for a, b in zip(starts, ends)])
        whole = np.array([kept[a:b].sum() == 2 for a, b in zip(starts, ends)])
        joined = whole & (bends * lengths**2 / 8 <= chord)
        kept[starts[joined] + step] = False
        if not joined.any():
            break
        step *= 2
    one = t[:-1][kept]
    return (one + pitch * np.arange(teeth)[:, None]).ravel()


# The circles of a part, and features whose size the design does not have.

Circles = tuple[list[Circle], list[str]]


def _around(name: str, radius: Scalar, count: int, size: Scalar, first: float = 0.0) -> list[Circle]:
    """Circles on a circle of a radius; `size` is one radius, or one for each."""
    angles = first + 2 * np.pi * np.arange(count) / count
    each = [size] * count if np.ndim(size) == 0 else list(jnp.asarray(size))
    return [
        Circle(f"{name} {k}", radius * math.cos(angle), radius * math.sin(angle), own)
        for k, (angle, own) in enumerate(zip(angles, each))
    ]


def _ring(cycloid: CycloidStage, errors: ReducerErrors) -> Circles:
    circle, pin = cycloid.pin_circle_radius + errors.pin_circle_radius, cycloid.pin_radius + errors.pin_radius
    pins = _around("pin", circle, cycloid.pin_count, pin + errors.pin_radii)
    return [*pins, Circle("pin circle", 0.0, 0.0, circle)], ["outside of the ring", "seats of the pins"]


def _of_drive(design: CycloidalReducer, errors: CycloidalErrors, part: str, disc: int) -> Circles:
    cycloid, output = design.cycloid, design.output
    if part == "ring":
        return _ring(cycloid, errors)
    if part == "carrier":
        pin = output.pin_radius + errors.output_pin_radius
        return _around("output pin", output.circle_radius, output.count, pin), ["plate of the carrier", "bolts"]
    hole = output.pin_radius + cycloid.eccentricity + output.hole_clearance / 2
    half = output.circle_radius * math.sin(math.pi / output.count)
    if concrete(hole, half) and hole >= half:
        size, most = quantity(hole, "m"), quantity(half, "m")
        raise ValueError(f"OutputPins.pin_radius: holes of radius {size} overlap from {most} on")
    larger = jnp.asarray(errors.hole_radius)
    own = larger if larger.ndim == 0 else larger[disc]
    holes = _around("hole", output.circle_radius, output.count, hole + own)
    if design.bearings is None:
        return holes, ["bore of the eccentric bearing"]
    return [*holes, Circle("bore", 0.0, 0.0, _outside(design.bearings.arm))], []


def _of_rv(design: RVReducer, errors: RVErrors, part: str, disc: int) -> Circles:
    cranks, bearings = design.cranks, design.bearings
    if part == "ring":
        return _ring(design.cycloid, errors)
    bearing = None if bearings is None else bearings.arm if part == "disc" else bearings.support
    missing = ["middle bore"] if part == "disc" else ["outside of the carrier", "bolts"]
    if bearing is None:
        return [], ["bores of the cranks", *missing]
    return _around("bore of crank", cranks.circle_radius, cranks.count, _outside(bearing), np.pi), missing


def _of_rollers(design: CamRollerReducer, errors: CamRollerErrors, part: str, disc: int) -> Circles:
    if part == "disc":
        return [Circle("cam", 0.0, 0.0, design.cam_radius + errors.cam_radius)], ["bore of the cam"]
    return [], ["outside of the ring"] if part == "ring" else ["slots of the rollers", "outside of the cage"]


def _outside(bearing: RollingBearing) -> Scalar:
    """Radius outside the rollers or balls of a bearing without an outer ring, m."""
    return jnp.asarray(bearing.pitch_diameter + bearing.element_diameter) / 2


class _Kind(NamedTuple):
    """Functions of a kind of reducer."""

    toothed: str  # the part with the flank
    flank: Callable[..., Flank]  # of design, errors, number of the disc
    undercut: Callable[..., list[str]]  # of design and numbers of the flank: errors
    circles: Callable[..., Circles]  # of design, errors, part, number of the disc


_CYCLOID = _Kind(
    "disc", _disc_flank,
    lambda design, numbers: undercut(design.replace(cycloid=numbers)), _of_rv,
)  # fmt: skip
_KINDS = {
    RVReducer: _CYCLOID,
    CycloidalReducer: _CYCLOID._replace(circles=_of_drive),
    CamRollerReducer: _Kind("ring", _of_gear, _gear_undercut, _of_rollers),
}
