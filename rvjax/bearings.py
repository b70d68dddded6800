"""Roller and ball bearings of the cranks, and friction of a reducer by place. No maker publishes its coefficients.

Of a bearing: its rollers or balls, its ratings where a maker gives them, and where it sits.
"""

import math
from typing import Any, ClassVar, TypeVar

import numpy as np

from rvjax.records import Array, Record, concrete, count, field, quantity, record

Number = TypeVar("Number", float, Array, np.ndarray)


class RollingBearing(Record):
    """A radial bearing with rollers or balls: the common part of both classes."""

    element: ClassVar[str]  # its fields begin with it
    life_exponent: ClassVar[float]  # life = 1e6 (C / P)^exponent, ISO 281
    weibull_slope: ClassVar[float]  # of the lives of such bearings

    pitch_diameter: Any
    contact_angle: Any
    rating_factor: Any
    capacity: Any
    static_capacity: Any

    @property
    def elements(self) -> int:
        """Rollers or balls of a row, Z."""
        return int(getattr(self, f"{self.element}s"))

    @property
    def element_diameter(self) -> Any:
        """Diameter of a roller or a ball, m."""
        return getattr(self, f"{self.element}_diameter")

    def _check(self) -> None:
        kind, size, circle = type(self).__name__, self.element_diameter, self.pitch_diameter
        if concrete(size, circle):
            most = largest_roller(self.elements, np.asarray(circle))
            given = f"{kind}.{self.element}_diameter = {quantity(size, 'm')}"
            if np.any(np.asarray(size) >= np.asarray(circle)):
                raise ValueError(f"{given}: must be less than pitch_diameter = {quantity(circle, 'm')}")
            if np.any(np.asarray(size) > most * (1 + 1e-12)):
                raise ValueError(
                    f"{given}: must be at most {quantity(most, 'm')}; {self.elements} {self.element}s overlap "
                    f"on pitch_diameter = {quantity(circle, 'm')}"
                )
        angle = np.asarray(self.contact_angle) if concrete(self.contact_angle) else np.zeros(())
        if np.any((angle < 0) | (angle >= math.pi / 2)):
            raise ValueError(
                f"{kind}.contact_angle = {quantity(self.contact_angle, 'rad')}: must lie between 0 and pi/2; "
                f"multiply degrees by rvjax.units.deg"
            )


@record
class RollerBearing(RollingBearing):
    """A radial roller bearing. Both ratings follow from the rollers (ISO 281, ISO 76) unless they are given."""

    element: ClassVar[str] = "roller"
    life_exponent: ClassVar[float] = 10 / 3
    weibull_slope: ClassVar[float] = 9 / 8

    rollers: int = count("rollers of a row, Z", minimum=3, maximum=1000)
    roller_diameter: Any = field("m", "diameter of a roller at its middle, Dwe", sign="positive")
    roller_length: Any = field("m", "length of a roller that carries, Lwe; two rows: the sum", sign="positive")
    pitch_diameter: Any = field("m", "diameter of the circle of roller axes, Dpw", sign="positive")
    contact_angle: Any = field("rad", "between roller load and radial plane; > 0 tapered", default=0.0)
    rating_factor: Any = field(
        "-", "bm: 1.1 cylindrical, tapered, machined needle; 1.0 drawn cup", default=1.1, sign="positive"
    )
    capacity: Any = field("N", "dynamic rating C where it is given", default=None, sign="positive")
    static_capacity: Any = field("N", "static rating C0 where it is given", default=None, sign="positive")


LARGEST_BALL = 0.4  # over the pitch diameter: end of the tables of ISO 281 and ISO 76


@record
class BallBearing(RollingBearing):
    """A radial groove ball bearing. Both ratings follow from the balls (ISO 281, ISO 76) unless they are given."""

    element: ClassVar[str] = "ball"
    life_exponent: ClassVar[float] = 3.0
    weibull_slope: ClassVar[float] = 10 / 9

    balls: int = count("balls of a row, Z", minimum=3, maximum=1000)
    ball_diameter: Any = field("m", "diameter of a ball, D", sign="positive")
    pitch_diameter: Any = field("m", "diameter of the circle of ball centres, dm", sign="positive")
    rows: int = count("rows of balls, i; two: rating_factor times 0.90/0.95, as in ISO 281", maximum=10, default=1)
    inner_groove: Any = field("-", "radius of the inner groove over D, fi; above 0.5", default=0.52, sign="positive")
    outer_groove: Any = field("-", "radius of the outer groove over D, fe; above 0.5", default=0.52, sign="positive")
    rating_factor: Any = field("-", "bm: 1.3; 1.1 with filling slots", default=1.3, sign="positive")
    contact_angle: Any = field("rad", "between ball load and radial plane; enters the ratings", default=0.0)
    capacity: Any = field("N", "dynamic rating C where it is given", default=None, sign="positive")
    static_capacity: Any = field("N", "static rating C0 where it is given", default=None, sign="positive")

    def _check(self) -> None:
        super()._check()
        size, circle = self.ball_diameter, self.pitch_diameter
        if concrete(size, circle) and np.any(np.asarray(size) > LARGEST_BALL * np.asarray(circle) * (1 + 1e-12)):
            raise ValueError(
                f"BallBearing.ball_diameter = {quantity(size, 'm')}: must be at most {LARGEST_BALL:g} of "
                f"pitch_diameter = {quantity(circle, 'm')}, where the tables of ISO 281 and ISO 76 end"
            )
        for name in ("inner_groove", "outer_groove"):
            groove = getattr(self, name)
            if concrete(groove) and np.any((np.asarray(groove) <= 0.5) | (np.asarray(groove) > 1)):
                raise ValueError(
                    f"BallBearing.{name} = {quantity(groove, '-')}: must be above 0.5 and at most 1, "
                    f"the radius of the groove over the ball diameter"
                )


def largest_roller(rollers: int, pitch_diameter: Number) -> Number:
    """Diameter of rollers that touch their neighbours, m: Z asin(Dwe / Dpw) = pi.

    Args:
        rollers: Z.
        pitch_diameter: Dpw, m.
    """
    return pitch_diameter * math.sin(math.pi / rollers)


@record
class Bearings(Record):
    """Bearings of every crank: one in each disc (arm), two in the carrier (support).

    Axial positions count from support 0; all three are given, or none. Without them each support carries half.
    A preload means tapered support bearings that are set against each other. Each bearing has rollers or balls.
    """

    arm: RollerBearing | BallBearing = field("-", "crank or eccentric in a disc", kind="record")
    support: RollerBearing | BallBearing | None = field(
        "-", "crank in the carrier; None: not rated, as for a single-stage drive", kind="record", default=None
    )
    disc_position: Any = field("m", "of each disc from support 0", shape=("discs",), default=None)
    planet_position: Any = field("m", "of the planet from support 0, < 0 outside", default=None)
    support_span: Any = field("m", "from support 0 to support 1", default=None, sign="positive")
    preload: Any = field("N", "axial preload of tapered supports", default=None, sign="nonnegative")

    @property
    def placed(self) -> bool:
        """True if the axial positions are given."""
        return self.disc_position is not None

    def _check(self) -> None:
        arm, support = self.arm, self.support
        if _angled(arm):
            raise ValueError(
                f"Bearings.arm.contact_angle = {quantity(arm.contact_angle, 'rad')}: must be 0; "
                f"the plane model has no axial force for an arm bearing"
            )
        places = ("disc_position", "planet_position", "support_span")
        missing = [name for name in places if getattr(self, name) is None]
        if missing and len(missing) < len(places):
            raise ValueError(f"Bearings.{missing[0]} = None: give all of {', '.join(places)} in m, or none")
        if isinstance(support, BallBearing) and self.preload is not None:
            raise ValueError("Bearings.preload: is of tapered supports; must be None with a BallBearing as support")
        if isinstance(support, BallBearing) and _angled(support):
            raise ValueError(
                f"Bearings.support.contact_angle = {quantity(support.contact_angle, 'rad')}: must be 0 for a "
                f"BallBearing; angular contact under axial load is not modelled"
            )
        if self.preload is None and _angled(support):
            assert support is not None
            raise ValueError(
                f"Bearings.support.contact_angle = {quantity(support.contact_angle, 'rad')}: "
                f"tapered supports need preload in N"
            )
        if self.preload is None:
            return
        if support is None:
            raise ValueError("Bearings.preload: is of tapered supports; give support with its contact_angle")
        if concrete(support.contact_angle) and not _angled(support):
            raise ValueError("Bearings.support.contact_angle = 0 rad: must be positive; preload is of tapered supports")


@record
class Friction(Record):
    """Friction of a reducer by place (`rvjax.running`). Coefficients are assumed or measured."""

    ring_pins: Any = field(
        "-",
        "coefficient of a disc on a ring pin that does not turn; a sleeve on a pin: times pin radius / sleeve radius",
        default=0.0,
        sign="nonnegative",
    )
    output_pins: Any = field(
        "-", "coefficient of an output pin in its hole, single-stage drives only", default=None, sign="nonnegative"
    )
    arm_bearings: Any = field(
        "-",
        "moment of an arm or eccentric bearing over load x pitch diameter / 2; None: no such loss",
        default=None,
        sign="nonnegative",
    )
    support_bearings: Any = field(
        "-",
        "moment of a support bearing over load x pitch diameter / 2; None: no such loss",
        default=None,
        sign="nonnegative",
    )
    gear_meshes: Any = field(
        "-", "lost share of the power of a mesh, seen from the carrier; below 1", default=0.0, sign="nonnegative"
    )
    arm_bearing_moment: Any = field(
        "N m", "of one arm bearing without load: preload, cage, seal", default=0.0, sign="nonnegative"
    )
    support_bearing_moment: Any = field(
        "N m", "of one support bearing without load: preload, cage, seal", default=0.0, sign="nonnegative"
    )
    input_drag: Any = field("N m", "torque of seals and bearings on the input", default=0.0, sign="nonnegative")
    output_drag: Any = field("N m", "torque of seals and main bearings on the output", default=0.0, sign="nonnegative")
    input_viscous: Any = field("N m s/rad", "torque per speed on the input", default=0.0, sign="nonnegative")
    output_viscous: Any = field("N m s/rad", "torque per speed on the output", default=0.0, sign="nonnegative")
    static_factor: Any = field("-", "all friction at rest over that in motion", default=1.0, sign="positive")

    def _check(self) -> None:
        share = self.gear_meshes
        if concrete(share) and np.any(np.asarray(share) >= 1):
            raise ValueError(f"Friction.gear_meshes = {quantity(share, '-')}: must be below 1, a share of the power")


def _angled(bearing: RollingBearing | None) -> bool:
    """True if a bearing has a concrete contact angle other than 0."""
    angle = getattr(bearing, "contact_angle", None)
    return angle is not None and concrete(angle) and bool(np.any(np.asarray(angle) != 0))
