"""Designs of reducers: their parts as explicit numbers. Classmethods derive them from teeth and module.

An RV reducer is an involute stage (sun, planets), cranks carried by the planets, and cycloid discs
on the cranks that roll in a ring of pins; the carrier is the output. A cam roller reducer is the second
stage of a compound oscillatory roller reducer: an eccentric cam pushes rollers in a slotted cage against
an inner gear; the cage is the output.
"""

import math
from typing import ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.bearings import (
    BallBearing as BallBearing,
    Bearings as Bearings,
    Friction as Friction,
    RollerBearing as RollerBearing,
)
from rvjax.errors import CamRollerErrors, RVErrors
from rvjax.records import Array, Record, Scalar, concrete, count, field, quantity, record
from rvjax.units import deg


def ratio_of(sun: float, planet: float, disc: float, pins: float) -> float:
    """Turns of the sun for one of the carrier, ring of pins at rest.

    Args:
        sun: teeth of the sun, z1.
        planet: teeth of a planet, z2.
        disc: teeth of a disc, zc.
        pins: zp.
    """
    return 1 + planet * pins / (sun * (pins - disc))


@record
class InvoluteStage(Record):
    """First stage: sun and planets."""

    sun_teeth: int = count("teeth of the sun, z1")
    planet_teeth: int = count("teeth of a planet, z2")
    module: Scalar = field("m", "module", sign="positive")
    pressure_angle: Scalar = field("rad", "pressure angle", sign="positive")
    centre_distance: Scalar = field("m", "sun axis to planet axis, a0", sign="positive")
    sun_radius: Scalar = field("m", "reference radius of the sun, r1", sign="positive")
    sun_base_radius: Scalar = field("m", "base radius of the sun", sign="positive")
    planet_base_radius: Scalar = field("m", "base radius of a planet", sign="positive")

    @classmethod
    def from_teeth(
        cls, sun_teeth: int, planet_teeth: int, *, module: Scalar, pressure_angle: Scalar = 20 * deg
    ) -> Self:
        """Standard spur gears without profile shift: every radius follows from teeth and module.

        Args:
            sun_teeth: teeth of the sun.
            planet_teeth: teeth of a planet.
            module: m.
            pressure_angle: rad.
        """
        cosine = math.cos(pressure_angle) if concrete(pressure_angle) else jnp.cos(pressure_angle)
        return cls(
            sun_teeth=sun_teeth,
            planet_teeth=planet_teeth,
            module=module,
            pressure_angle=pressure_angle,
            centre_distance=module * (sun_teeth + planet_teeth) / 2,
            sun_radius=module * sun_teeth / 2,
            sun_base_radius=module * sun_teeth / 2 * cosine,
            planet_base_radius=module * planet_teeth / 2 * cosine,
        )


@record
class CycloidStage(Record):
    """Second stage: cycloid discs rolling in the pin ring.

    The shortening coefficient K1 is eccentricity * pin_count / pin_circle_radius unless
    `shortening` overrides it.
    """

    disc_teeth: int = count("teeth of a disc, zc")
    pin_count: int = count("pins of the ring, zp")
    disc_count: int = count("discs, nd", maximum=64)
    eccentricity: Scalar = field("m", "nominal eccentricity of cranks and discs, e", sign="positive")
    pin_circle_radius: Scalar = field("m", "radius of the pin circle, rp", sign="positive")
    pin_radius: Scalar = field("m", "radius of a pin, rrp", sign="positive")
    equidistant_modification: Scalar = field("m", "profile modification; > 0 removes flank material", default=0.0)
    shift_modification: Scalar = field("m", "profile modification; < 0 removes flank material", default=0.0)
    profile_modification: Array | None = field(
        "m",
        "profile modification a_f cos(f psi), f = 1 .. 4, over the lobe angle psi, 0 in a tooth space; > 0 adds flank "
        "material; None: none",
        shape=(4,),
        default=None,
    )
    force_angle: Scalar = field("rad", "direction of the disc-pin mesh force (dynamics)", default=30 * deg)
    disc_phase: Scalar = field("rad", "eccentric direction of disc 1 (dynamics)", default=0.0)
    shortening: Scalar | None = field("-", "K1 where it is given, not derived", default=None)

    @property
    def shortening_coefficient(self) -> Scalar:
        """K1, dimensionless; a proper cycloid needs 0 < K1 < 1."""
        return self.derived_shortening if self.shortening is None else self.shortening

    @property
    def derived_shortening(self) -> Scalar:
        """K1 where none is given."""
        return self.eccentricity * self.pin_count / self.pin_circle_radius

    @property
    def counts(self) -> dict[str, int]:
        """Sizes of the axes of discs, pins and teeth."""
        return {"discs": self.disc_count, "pins": self.pin_count, "teeth": self.disc_teeth}

    @property
    def orders(self) -> dict[str, float]:
        """Orders of the output turn that disc teeth and pins cause."""
        teeth, pins = float(self.disc_teeth), float(self.pin_count)
        return {"disc teeth": teeth, "pins": pins, "twice the disc teeth": 2 * teeth, "twice the pins": 2 * pins}

    def _check(self) -> None:
        values = (self.eccentricity, self.pin_circle_radius, 0.0 if self.shortening is None else self.shortening)
        if concrete(*values) and (self.shortening_coefficient >= 1 or self.shortening_coefficient <= 0):
            source = "shortening" if self.shortening is not None else "eccentricity * pin_count / pin_circle_radius"
            raise ValueError(
                f"CycloidStage.{source} = {quantity(self.shortening_coefficient, '-')}: the shortening coefficient K1 "
                f"must lie between 0 and 1 (eccentricity = {quantity(self.eccentricity, 'm')}, "
                f"pin_circle_radius = {quantity(self.pin_circle_radius, 'm')})"
            )


@record
class CrankStage(Record):
    """Crankshafts, equally spaced on a circle; the distance of two cranks is 2 * circle_radius."""

    count: int = count("crankshafts, each with its planet", minimum=2, maximum=64)
    circle_radius: Scalar = field("m", "radius of the circle of crank axes, R", sign="positive")
    bearing_stiffness: Scalar | None = field("N/m", "crank arm and bearings in series", default=None, sign="positive")


@record
class Inertia(Record):
    """Masses and polar moments of inertia of the parts (dynamics); arrays where members differ."""

    sun_mass: Scalar = field("kg", "sun", sign="positive")
    sun_inertia: Scalar = field("kg m2", "sun", sign="positive")
    planet_mass: Scalar = field("kg", "one planet", shape=("cranks",), sign="positive")
    planet_inertia: Scalar = field("kg m2", "one planet", shape=("cranks",), sign="positive")
    crank_mass: Scalar = field("kg", "one crankshaft", shape=("cranks",), sign="positive")
    crank_inertia: Scalar = field("kg m2", "one crankshaft", shape=("cranks",), sign="positive")
    disc_mass: Scalar = field("kg", "one disc", shape=("discs",), sign="positive")
    disc_inertia: Scalar = field("kg m2", "one disc", shape=("discs",), sign="positive")
    output_mass: Scalar = field("kg", "output wheel", sign="positive")
    output_inertia: Scalar = field("kg m2", "output wheel", sign="positive")


@record
class Stiffness(Record):
    """Stiffness of supports, shafts, bearings and meshes (dynamics); arrays where members differ.

    Meshes as mean values over their period.
    """

    sun_support: Scalar = field("N/m", "radial support of the sun", sign="nonnegative")
    sun_torsion: Scalar = field("N m/rad", "input shaft", sign="nonnegative")
    planet_crank_bending: Scalar = field("N/m", "planet on its crankshaft", shape=("cranks",), sign="nonnegative")
    planet_crank_torsion: Scalar = field("N m/rad", "planet on its crankshaft", shape=("cranks",), sign="nonnegative")
    support_bearing: Scalar = field("N/m", "crankshaft in the output wheel", shape=("cranks",), sign="nonnegative")
    turning_arm_bearing: Scalar = field("N/m", "disc on the crankshaft", shape=("discs", "cranks"), sign="nonnegative")
    sun_planet_mesh: Scalar = field("N/m", "one involute mesh", shape=("cranks",), sign="nonnegative")
    disc_pin_mesh: Scalar = field("N/m", "one disc in the pin ring", shape=("discs",), sign="nonnegative")
    output_support: Scalar = field("N/m", "radial support of the output wheel", default=0.0, sign="nonnegative")
    output_torsion: Scalar = field("N m/rad", "output shaft", default=0.0, sign="nonnegative")


@record
class MeshVariation(Record):
    """Periodic part of the mesh stiffness: swing (peak to peak over mean), duty, ramp width over period."""

    planetary_swing: Scalar = field("-", "sun-planet mesh", sign="nonnegative")
    planetary_duty: Scalar = field("-", "sun-planet mesh", sign="nonnegative")
    planetary_ramp: Scalar = field("-", "sun-planet mesh", sign="nonnegative")
    cycloid_swing: Scalar = field("-", "disc-pin mesh", sign="nonnegative")
    cycloid_duty: Scalar = field("-", "disc-pin mesh", sign="nonnegative")
    cycloid_ramp: Scalar = field("-", "disc-pin mesh", sign="nonnegative")


@record
class Damping(Record):
    """Damping of the whole reducer; every kind may be zero."""

    loss_factor: Scalar = field("-", "structural loss factor", default=0.0, sign="nonnegative")
    rayleigh_mass: Scalar = field("1/s", "share of the mass matrix", default=0.0, sign="nonnegative")
    rayleigh_stiffness: Scalar = field("s", "share of the stiffness matrix", default=0.0, sign="nonnegative")
    modal_ratio: Scalar = field("-", "damping ratio of every mode", default=0.0, sign="nonnegative")


@record
class Contact(Record):
    """Contact of a disc with the pins (loaded equilibrium). Pins have the material of the discs, or another one."""

    young_modulus: Scalar = field("Pa", "Young's modulus, E", sign="positive")
    poisson_ratio: Scalar = field("-", "Poisson's ratio, nu")
    face_width: Scalar = field("m", "width of a disc, L", sign="positive")
    pin_stiffness: Scalar | None = field(
        "N/m",
        "one pin, linear contact law; None: 4 cos^2(force_angle) disc_pin_mesh / pins",
        default=None,
        sign="positive",
    )
    pin_support: Array | None = field(
        "N/m",
        "each pin in its groove and bending, in series with its contact (hertz, linear); None: rigid. disc_pin_mesh "
        "includes the mean support: only the differences of the pins count there. Not used: palmgren",
        shape=("pins",),
        default=None,
        sign="positive",
    )
    pin_young_modulus: Scalar | None = field(
        "Pa", "of pins of another material; None: that of the discs", default=None, sign="positive"
    )
    pin_poisson_ratio: Scalar | None = field("-", "of pins of another material; None: that of the discs", default=None)

    @property
    def compliances(self) -> tuple[Scalar, Scalar]:
        """(1 - nu^2)/E of discs and of pins, 1/Pa."""
        disc = (1 - self.poisson_ratio**2) / self.young_modulus
        if self.pin_young_modulus is None or self.pin_poisson_ratio is None:
            return disc, disc
        return disc, (1 - self.pin_poisson_ratio**2) / self.pin_young_modulus

    def _check(self) -> None:
        for name in ("poisson_ratio", "pin_poisson_ratio"):
            ratio = getattr(self, name)
            if concrete(ratio) and np.any(np.abs(np.asarray(ratio)) >= 1):
                raise ValueError(f"Contact.{name} = {quantity(ratio, '-')}: must lie between -1 and 1")
        pair = ("pin_young_modulus", "pin_poisson_ratio")
        for name, other in (pair, pair[::-1]):
            if getattr(self, name) is None and getattr(self, other) is not None:
                raise ValueError(f"Contact.{name} = None: must be given with {other}")


@record
class RVReducer(Record):
    """An RV reducer. Stiffness is read by the dynamic and the loaded model, contact by the loaded model only,
    bearings by the life and the friction, friction by `running` only."""

    kind: ClassVar[str] = "rv"  # in study files
    error_record: ClassVar[type[RVErrors]] = RVErrors
    places: ClassVar[str] = "cranks"  # axis of the equal places round the main axis where discs and carrier meet

    involute: InvoluteStage = field("-", "first stage", kind="record")
    cycloid: CycloidStage = field("-", "second stage", kind="record")
    cranks: CrankStage = field("-", "crankshafts", kind="record")
    inertia: Inertia | None = field("-", "masses and moments of inertia", kind="record", default=None)
    stiffness: Stiffness | None = field("-", "stiffnesses", kind="record", default=None)
    mesh_variation: MeshVariation | None = field("-", "periodic mesh stiffness", kind="record", default=None)
    damping: Damping | None = field("-", "damping", kind="record", default=None)
    contact: Contact | None = field("-", "contact of discs and pins", kind="record", default=None)
    bearings: Bearings | None = field("-", "bearings of the cranks", kind="record", default=None)
    friction: Friction | None = field("-", "friction by place, for `running`", kind="record", default=None)

    @property
    def ratio(self) -> float:
        """Turns of the sun for one of the carrier, ring of pins at rest: i = 1 + z2 zp / ((zp - zc) z1)."""
        involute, cycloid = self.involute, self.cycloid
        return ratio_of(involute.sun_teeth, involute.planet_teeth, cycloid.disc_teeth, cycloid.pin_count)

    @property
    def orders(self) -> dict[str, float]:
        """Orders of the output turn that parts of the reducer cause; an order need not be a whole number."""
        sun = {"sun": float(self.ratio), "sun against the carrier": float(self.ratio) - 1}
        return self.cycloid.orders | sun

    def stiffer(self, factor: Scalar) -> Self:
        """Reducer with all spring stiffnesses multiplied by a factor."""
        cranks, springs = self.cranks, self.stiffness
        if cranks.bearing_stiffness is not None:
            cranks = cranks.replace(bearing_stiffness=factor * cranks.bearing_stiffness)
        return self.replace(cranks=cranks, stiffness=jax.tree.map(lambda k: factor * k, springs))

    @property
    def counts(self) -> dict[str, int]:
        """Sizes of the named axes in the shapes of this design's errors."""
        return self.cycloid.counts | {"cranks": self.cranks.count}


@record
class CamRollerReducer(Record):
    """Oscillatory roller stage: eccentric disc cam, one roller more than gear teeth, fixed inner gear."""

    kind: ClassVar[str] = "oscillatory-roller"  # in study files
    error_record: ClassVar[type[CamRollerErrors]] = CamRollerErrors

    gear_teeth: int = count("teeth of the fixed inner gear, z; there are z + 1 rollers", minimum=2, maximum=2000)
    cam_radius: Scalar = field("m", "radius of the disc cam, Rj", sign="positive")
    roller_radius: Scalar = field("m", "radius of a roller, r", sign="positive")
    roller_length: Scalar = field("m", "length of a roller, lH", sign="positive")
    eccentricity: Scalar = field("m", "eccentricity of the cam, e", sign="positive")
    young_modulus: Scalar = field("Pa", "Young's modulus of all parts, E", sign="positive")
    poisson_ratio: Scalar = field("-", "Poisson's ratio of all parts")
    cam_share: Scalar = field("-", "part of the torque carried by one of the two cams", default=0.55)

    @property
    def counts(self) -> dict[str, int]:
        """Sizes of the named axes in the shapes of this design's errors."""
        return {"rollers": self.gear_teeth + 1}

    def _check(self) -> None:
        if concrete(self.eccentricity, self.cam_radius, self.roller_radius):
            link = self.cam_radius + self.roller_radius
            if np.any(np.asarray(self.eccentricity) >= np.asarray(link)):
                raise ValueError(
                    f"CamRollerReducer.eccentricity = {quantity(self.eccentricity, 'm')}: must be smaller than "
                    f"cam_radius + roller_radius = {quantity(link, 'm')}"
                )
        if concrete(self.poisson_ratio) and np.any(np.abs(np.asarray(self.poisson_ratio)) >= 1):
            raise ValueError(
                f"CamRollerReducer.poisson_ratio = {quantity(self.poisson_ratio, '-')}: must lie between -1 and 1"
            )


def check_teeth(cycloid: CycloidStage, where: str = "CycloidStage", model: str = "") -> None:
    """Raise ValueError for another tooth difference than one.

    Args:
        cycloid: its counts.
        where: name of the stage, for the message.
        model: end of the message.

    Raises:
        ValueError: names both counts.
    """
    pins, wanted = cycloid.pin_count, cycloid.disc_teeth + 1
    if pins != wanted:
        raise ValueError(f"{where}.pin_count = {pins}: must be disc_teeth + 1 = {wanted}{model}")


def expect(design: object, where: str, *kinds: type) -> None:
    """Raise ValueError for a design of the wrong class; only the class is read, so that a compiled call costs nothing.

    Args:
        design: as given.
        where: the function, for the message.
        *kinds: classes that it takes.

    Raises:
        ValueError: names both kinds.
    """
    if not isinstance(design, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"{where}: takes a design of kind {wanted}, got {type(design).__name__}")
