"""Contributions to the lost motion: the sum of the paper, term by term, and the free rotation between flank and pins.

Sum: Liu et al. 2022, Eq. 4 to 21, in radians. Rigid parts; positive is backlash, negative interference. Where print
and units or the derivation disagree, the reading "consistent" follows the latter, each place marked "mended". Rotation:
all profile and pin deviations act through two lengths. The disc is ground as the envelope of pins whose circle is
larger by `d` and whose radius is larger by `D` than those of the pins it runs in; parallel curves leave nothing else. A
flank point belongs to a flank angle phi, the crank angle (z_c times the pin angle) at which it touches its pin
nominally; `b(phi)` brings it into contact, and the backlash of both flanks together is twice its minimum.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import fori_loop, while_loop
from rvjax.designs import ratio_of
from rvjax.errors import RVErrors
from rvjax.records import Array, PyTree, Record, field, record
from rvjax.units import arcmin, mm

# Eq. 11 needs planet mass times planet speed squared, which is not published. This value, kg/s^2, makes a
# normal force of 0.5075 N return the published 0.5467 arcmin of the RV-20E; it is no confirmation.
CALIBRATED_INERTIA = 24.1786361758745


@record
class LostMotionTerms(Record):
    """Contributions to the lost motion; they sum to its total. Equations of Liu et al. 2022."""

    base_tangent: Array = field("rad", "backlash of the involute stage, Eq. 5 and 12")
    nominal_equidistant: Array = field("rad", "equidistant modification of the design, Eq. 14")
    nominal_shift: Array = field("rad", "shift modification of the design, Eq. 15")
    pin_circle_radius: Array = field("rad", "error of the pin circle radius, Eq. 16")
    pin_radius: Array = field("rad", "error of the pin radius, Eq. 16")
    pin_hole_clearance: Array = field("rad", "fit of the pins in their holes, Eq. 16")
    disc_runout: Array = field("rad", "radial runout of the disc, Eq. 16")
    pin_position: Array = field("rad", "circumferential position of the pins, Eq. 16")
    disc_cumulative_pitch: Array = field("rad", "cumulative pitch error of the disc, Eq. 16")
    equidistant_modification: Array = field("rad", "error of the equidistant modification, Eq. 16")
    shift_modification: Array = field("rad", "error of the shift modification, Eq. 16")
    eccentricity: Array = field("rad", "eccentricity error times modification, Eq. 16 and 17")
    bearing_clearance: Array = field("rad", "crank bearings, Eq. 20")
    contact_remainder: Array = field("rad", "what the flank profile adds to the sum of the paper; 0 in first order")


# The part of the sum that a flank profile replaces.
FLANK_TERMS = (
    "nominal_equidistant",
    "nominal_shift",
    "pin_circle_radius",
    "pin_radius",
    "pin_hole_clearance",
    "equidistant_modification",
    "shift_modification",
    "eccentricity",
)


class Teeth(NamedTuple):
    """Counts as floats: products of large ones would overflow 32-bit integers."""

    z1: float
    z2: float
    zc: float
    zp: float

    @property
    def ratio(self) -> float:
        """Turns of the sun for one of the output."""
        return ratio_of(*self)  # Eq. 4, ring fixed


class Unit(NamedTuple):
    """Inputs from a design and its conditions, in m, rad, N; None where something is not read."""

    alpha: PyTree  # pressure angle of the involute stage
    force: PyTree  # normal force, in place of the pressure angle
    a0: PyTree
    a1: PyTree  # centre shift
    r1: PyTree
    e: PyTree
    rp: PyTree
    given_k1: PyTree  # None: it follows from e and rp
    equidistant: PyTree  # modifications of the design
    shift: PyTree
    tilt: PyTree

    def k1(self, teeth: Teeth) -> PyTree:
        """Shortening coefficient: as given, else e z_p / r_p.

        Args:
            teeth: counts of the same design.
        """
        return self.e * teeth.zp / self.rp if self.given_k1 is None else self.given_k1


def contributions(unit: Unit, parts: RVErrors, teeth: Teeth, reading: str) -> tuple[LostMotionTerms, jax.Array]:
    """Every term of Eq. 21, and the cosine of the pressure angle that the first one uses."""
    e, rp, zc = unit.e, unit.rp, teeth.zc
    k1 = unit.k1(teeth)
    s = jnp.sqrt((1 - k1) * (1 + k1))
    per_length = 1 / (e * zc)
    centres = unit.a0 + unit.a1
    cos_tilt = jnp.cos(unit.tilt)
    if unit.force is None:
        cosine = jnp.cos(unit.alpha)
    else:
        planet_radius = centres * (teeth.z2 / (teeth.z1 + teeth.z2)) / cos_tilt  # Eq. 7, mended: / not * (Z1 + Z2)
        cosine = CALIBRATED_INERTIA * planet_radius / unit.force  # Eq. 11
    if reading == "consistent":
        # Eq. 17, mended: -1/2 d(Eq. 14 + Eq. 15)/de at fixed rp; the published form mixes 1/mm^3 with 1/mm.
        k_n = unit.equidistant / (e * e * zc)
        k_n = k_n - (teeth.zp * teeth.zp / (zc * s) / (rp * rp) + s / (e * e * zc)) * unit.shift
        rest, nominal = 1.0, 2 * per_length  # Eq. 16, mended: the factor into arcmin belongs to every term
    else:
        k_n = unit.equidistant / (e * e * zc)  # Eq. 17 as published, lengths in mm
        k_n = k_n - (zc * mm / (e * rp * rp * s) + s / (e * zc * mm)) * unit.shift
        rest, nominal = arcmin, 2 * s * per_length  # Eq. 16 as published: nine terms stay in rad, s on all the bracket
    terms = LostMotionTerms(
        base_tangent=-(parts.base_tangent_upper + parts.base_tangent_lower)
        / (2 * teeth.ratio * unit.r1 * cosine),  # Eq. 12
        nominal_equidistant=nominal * unit.equidistant,  # Eq. 14
        nominal_shift=-2 * s * per_length * unit.shift,  # Eq. 15
        # Eq. 16; mended: of the two terms in delta r_p and in delta Delta r_p those without s belong to r_rp
        pin_circle_radius=2 * rest * s * per_length * parts.pin_circle_radius,
        pin_radius=-2 * rest * per_length * parts.pin_radius,
        pin_hole_clearance=rest * per_length * parts.pin_hole_clearance,
        disc_runout=rest / 2 * per_length * parts.disc_runout,
        pin_position=2 * rest * k1 * per_length * parts.pin_position,
        disc_cumulative_pitch=-rest * k1 * per_length * parts.disc_cumulative_pitch,
        equidistant_modification=2 * rest * per_length * parts.equidistant_modification,
        shift_modification=-2 * rest * s * per_length * parts.shift_modification,
        eccentricity=-2 * rest * k_n * parts.eccentricity,
        bearing_clearance=2 * cos_tilt / centres * parts.bearing_clearance,  # Eq. 20; once, unlike the print of Eq. 21
        contact_remainder=jnp.zeros_like(e),
    )
    return terms, cosine


_Place = tuple[Array, Array, Array, Array]
_WIDEST, _POINTS = 20.0, 256  # search over the whole flank, where the first-order minima are out of reach
STEPS = 11  # near d = s D, where b is flat, they leave 1e-10 of b; elsewhere five reach rounding


class Flank(NamedTuple):
    """Flank and pins; lengths in m."""

    e: jax.Array  # eccentricity of disc and crank, error included
    ring: jax.Array  # radius of the pin circle, error included, R
    k: jax.Array  # shortening coefficient of the disc as ground, K
    D: jax.Array  # pin radius that the disc is ground for, less the pin radius
    d: jax.Array  # pin circle radius that the disc is ground for, less the pin circle radius
    teeth: float  # of the disc, z_c


def first_order_minimum(flank: Flank) -> jax.Array:
    """Backlash of both flanks, rad: minimum over phi of the free rotation to first order in D and d.

    To first order b = [D S - d (1 - K cos phi)] / (e z_c sin phi) with S^2 = 1 + K^2 - 2 K cos phi. Both
    quotients are stationary at cos phi = K, the single minimum while d <= s D. Beyond, two equal minima
    lie where S / r = 1 -+ sqrt(1 - (s / r)^2), r = d / D.
    """
    e, k, D, d = flank.e, flank.k, flank.D, flank.d
    s = jnp.sqrt((1 - k) * (1 + k))
    twofold, product = d > s * D, (D - d) * (D + d)
    usable = twofold & (product > 0)
    root = jnp.where(usable, jnp.sqrt(jnp.where(usable, product, 1)), 0)
    return 2 * jnp.where(twofold, k * root, D - s * d) / (e * flank.teeth)


def free_rotation(position: jax.Array, flank: Flank) -> jax.Array:
    """Rotation b of the disc that brings one flank point into contact, rad; inf where none does.

    `position` is ln tan(phi / 2): sin phi, 1 - cos phi and 1 + cos phi keep their digits at both ends,
    and b grows smoothly without bound towards them, so that the search needs no limits.

    The offset flank point must come to lie on the pin circle. Its distance from the crank axis fixes the
    cosine of the flank angle phi' at which a nominal pin centre has the same distance; the difference
    cos phi' - cos phi is formed directly from the deviations, so that small ones keep their digits.
    """
    e, ring, k, D, d, teeth = flank
    ground = ring + d
    t = jnp.exp(position)
    scale = 1 / (1 + t * t)
    cosine, sine = (1 - t * t) * scale, 2 * t * scale
    below, above = 2 * t * t * scale, 2 * scale  # 1 - cos phi, 1 + cos phi
    normal_x = (1 - k) + k * below  # 1 - K cos phi
    S = jnp.sqrt((1 - k) * (1 - k) + 2 * k * below)
    offset = D / S
    change = -d * (ring + ground) + 2 * e * d * cosine - D * D
    change = change + 2 * offset * (ground * normal_x - e * (cosine - k))
    change = change / (2 * ring * e)  # cos phi' - cos phi
    product = (below - change) * (above + change)  # sin^2 phi'
    reachable = (below > change) & (above > -change)
    sine_2 = jnp.where(reachable, jnp.sqrt(jnp.where(reachable, product, 1)), 1)
    tan_h = -change / (sine + sine_2)  # h = (phi' - phi) / 2
    cos_h = 1 / jnp.sqrt(1 + tan_h * tan_h)
    sin_h = tan_h * cos_h
    cos_1, sin_1 = cosine * cos_h - sine * sin_h, sine * cos_h + cosine * sin_h  # phi + h
    cos_2, sin_2 = cos_1 * cos_h - sin_1 * sin_h, sin_1 * cos_h + cos_1 * sin_h  # phi'
    px, py = ring - e * cos_2, -e * sin_2  # pin centre seen from the crank axis
    mx = d - 2 * e * sin_h * sin_1 - offset * normal_x  # offset flank point less pin centre
    my = 2 * e * sin_h * cos_1 + offset * k * sine
    turn = jnp.arctan2(my * px - mx * py, px * px + py * py + mx * px + my * py)
    return jnp.where(reachable, turn - 2 * jnp.arctan(tan_h) / teeth, jnp.inf)


class Minimum(NamedTuple):
    """Exact backlash of both flanks and the accuracy of its position."""

    play: jax.Array  # rad
    angle: jax.Array  # flank angle of the minimum, rad
    slope: jax.Array  # |db / d position| left, rad
    converged: jax.Array
    reaches: jax.Array  # whether any point of the flank reaches the pins


def minimum(flank: Flank) -> Minimum:
    """Backlash of both flanks, exact: twice the minimum of `free_rotation` over the flank.

    Guarded Newton steps on b'(position) = 0 descend from the two first-order minima. Where these merge
    (d near s D) the starts are kept apart by as much as higher orders may shift the merging, since b may
    then have two minima where the first order has one.
    """
    position, slope, converged, reaches = _place(flank)
    # A search without end continues with an unmodified flank, so that no derivative of it is NaN.
    flank = flank._replace(D=jnp.where(converged, flank.D, 0), d=jnp.where(converged, flank.d, 0))
    position = jnp.where(converged, position, 0)
    return Minimum(2 * _lowest(flank, position), 2 * jnp.arctan(jnp.exp(position)), jnp.abs(slope), converged, reaches)


@jax.custom_jvp
def _lowest(flank: Flank, position: jax.Array) -> jax.Array:
    """Free rotation at its minimum, where its derivative is the partial one at fixed position."""
    return free_rotation(position, flank)


@_lowest.defjvp
def _lowest_jvp(primals: tuple[Flank, jax.Array], tangents: tuple[Flank, jax.Array]) -> tuple[jax.Array, jax.Array]:
    (flank, position), (dflank, _) = primals, tangents
    return jax.jvp(lambda f: free_rotation(position, f), (flank,), (dflank,))


@jax.custom_jvp
def _place(flank: Flank) -> _Place:
    """Position of the minimum, the slope left there, whether the search came to an end and reached anything."""
    best, converged = _descend(flank, _starts(flank))

    def once_more(state: tuple[_Point, jax.Array, jax.Array]) -> tuple[_Point, jax.Array, jax.Array]:
        points = jnp.linspace(-_WIDEST, _WIDEST, _POINTS, dtype=flank.k.dtype)
        start = points[jnp.argmin(free_rotation(points, flank))]
        new = (*_descend(flank, (start, start)), jnp.zeros((), bool))
        return jax.tree.map(lambda after, before: jnp.where(state[2], after, before), new, state)

    # A loop, so that a batch runs it only where one of its cases needs it.
    best, converged, _ = while_loop(lambda state: state[2], once_more, (best, converged, ~converged))
    return best.position, best.slope, converged, jnp.isfinite(best.rotation)


@_place.defjvp
def _place_jvp(primals: tuple[Flank], tangents: tuple[Flank]) -> tuple[_Place, _Place]:
    """Second derivatives of the backlash need dposition = -db' / b'', from b' = 0."""
    (flank,), (dflank,) = primals, tangents
    position, slope, converged, reaches = _place(flank)
    curvature = _at(position, flank).curvature
    curved = curvature > 1e-9 * _size(flank)  # not at D = d = 0, where every point is a minimum

    def rate(f: Flank) -> jax.Array:
        return jax.jvp(lambda x: free_rotation(x, f), (position,), (jnp.ones_like(position),))[1]

    _, drate = jax.jvp(rate, (flank,), (dflank,))
    dposition = jnp.where(curved, -drate / jnp.where(curved, curvature, 1), 0)
    rest = (slope, converged, reaches)
    return (position, *rest), (dposition, *jax.custom_derivatives.zero_from_primal(rest))


def _size(flank: Flank) -> jax.Array:
    """Size of b: the rotations that D and d alone would give."""
    return (jnp.abs(flank.D) + jnp.abs(flank.d)) / (flank.e * flank.teeth)


def _starts(flank: Flank) -> tuple[jax.Array, jax.Array]:
    """Positions of the two first-order minima, separated where they coincide."""
    k, D, d = flank.k, flank.D, flank.d
    s = jnp.sqrt((1 - k) * (1 + k))
    twofold = d > s * D
    ratio = jnp.where(twofold, d / jnp.where(twofold, D, 1), s)
    apart = s + (1 - s) * jnp.minimum((jnp.abs(D) + jnp.abs(d)) / flank.e, 0.1)
    ratio = jnp.clip(ratio, apart, 1)
    gap = jnp.sqrt((ratio - s) * (ratio + s))
    far = ratio + gap  # S at the two minima; their product is s^2
    return _position(s * s / far, k), _position(far, k)


def _position(S: jax.Array, k: jax.Array) -> jax.Array:
    """ln tan(phi / 2) of the flank point with the given S."""
    eps = float(jnp.finfo(S.dtype).eps)
    low, high = S - (1 - k), (1 + k) - S
    low, high = jnp.maximum(low, 4 * eps), jnp.maximum(high, 4 * eps)
    return 0.5 * jnp.log(low * (S + (1 - k)) / (high * (S + (1 + k))))


class _Point(NamedTuple):
    position: jax.Array
    rotation: jax.Array
    slope: jax.Array
    curvature: jax.Array


def _at(position: jax.Array, flank: Flank) -> _Point:
    """Free rotation there with its first two derivatives."""
    one = jnp.ones_like(position)

    def slope(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(lambda y: free_rotation(y, flank), (x,), (one,))

    (rotation, first), (_, second) = jax.jvp(slope, (position,), (one,))
    return _Point(position, rotation, first, second)


def _descend(flank: Flank, starts: tuple[jax.Array, jax.Array]) -> tuple[_Point, jax.Array]:
    """Return the lower of the two minima, and whether what remains to descend is negligible.

    Where the curvature vanishes or is negative the step goes down the slope; a step that does not
    descend is taken back and shortened.
    """
    size = _size(flank)
    limits = jnp.finfo(size.dtype)
    least = float(limits.eps) ** 0.5 * size + float(limits.tiny)  # a smaller curvature is rounding
    rounding = 4 * float(limits.eps) * size

    def step(state: tuple[_Point, jax.Array]) -> tuple[_Point, jax.Array]:
        best, damping = state
        move = -damping * best.slope / jnp.maximum(jnp.abs(best.curvature), least)
        trial = _at(best.position + jnp.clip(move, -0.5, 0.5), flank)
        lower = trial.rotation <= best.rotation + rounding  # false for NaN and out of reach
        best = _Point(*(jnp.where(lower, new, old) for new, old in zip(trial, best)))
        return best, jnp.where(lower, jnp.minimum(2 * damping, 1), damping / 4)

    def body(_: object, states: PyTree) -> PyTree:
        return tuple(step(state) for state in states)

    # The first step has length zero and evaluates the start.
    zero, one = jnp.zeros_like(size), jnp.ones_like(size)
    states = tuple((_Point(start, jnp.full_like(size, jnp.inf), zero, zero), one) for start in starts)
    (near, _), (far, _) = fori_loop(0, STEPS, body, states)
    best = _Point(*(jnp.where(near.rotation <= far.rotation, one, other) for one, other in zip(near, far)))
    remaining = best.slope**2 / jnp.maximum(jnp.abs(best.curvature), least)
    return best, jnp.isfinite(best.rotation) & (remaining <= max(1e-7, 32 * float(limits.eps)) * size)
