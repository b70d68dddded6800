"""Sum of the paper, term by term: Liu et al. 2022, Eq. 4 to 21, in radians.

Rigid parts; positive is backlash, negative interference. Where print and units or the derivation of the
paper disagree, the reading "consistent" follows units and derivation, each place marked "mended".
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

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


def harmless(teeth: Teeth, like: Unit) -> Unit:
    """Numbers on which every formula is finite: K1 = 1/2, nothing modified; None where `like` has it."""
    safe = Unit(
        alpha=0.0, force=1.0, a0=1.0, a1=0.0, r1=1.0, e=1.0, rp=2 * teeth.zp, given_k1=0.5,
        equidistant=0.0, shift=0.0, tilt=0.0,
    )  # fmt: skip
    return Unit(*(None if given is None else value for given, value in zip(like, safe)))


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
