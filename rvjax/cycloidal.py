"""Single-stage cycloidal drives: a shaft with an eccentric per disc, a ring of pins, output pins in holes of the discs.

The carrier of the output pins is the output, or the ring of pins while the carrier is at rest.
"""

import dataclasses
from typing import Any, ClassVar, Self

import jax
import numpy as np

from rvjax.base.words import choose
from rvjax.bearings import Bearings, Friction
from rvjax.designs import Contact, CycloidStage, RVReducer, check_teeth
from rvjax.errors import RUNNING, Errors, RVErrors, centre, deviation, part, placed, share
from rvjax.records import Record, Scalar, concrete, count, field, quantity, record, text

MEMBERS = ("carrier", "ring")
"""Parts that may be the output; the other one is at rest."""

SHAFT, OUTPUT = part("shaft", stage="cranks"), part("output_pins", stage="output")
DISCS, CARRIER = "discs", "carrier"  # as of an RV reducer
READ_BY = ("loaded", "life", "running")


@record
class OutputPins(Record):
    """Pins of the carrier in holes of the discs: hole diameter = pin diameter + 2 eccentricity + clearance."""

    count: int = count("output pins, n", minimum=3, maximum=256)
    circle_radius: Scalar = field("m", "radius of the circle of output pins and holes, Rw", sign="positive")
    pin_radius: Scalar = field("m", "radius of an output pin with its sleeve, rw", sign="positive")
    hole_clearance: Scalar = field("m", "diametral clearance of a pin in its hole", default=0.0)
    pin_stiffness: Scalar | None = field(
        "N/m", "one pin in one disc, linear contact law", default=None, sign="positive"
    )
    pin_support: Scalar | None = field(
        "N/m",
        "each pin in the carrier and bending, for one disc, in series with its contact (hertz, linear); None: rigid. "
        "Not used: palmgren",
        shape=("output_pins",),
        default=None,
        sign="positive",
    )

    @classmethod
    def from_hole(
        cls,
        count: int,
        circle_radius: Scalar,
        pin_radius: Scalar,
        *,
        hole_radius: Scalar,
        eccentricity: Scalar,
    ) -> Self:
        """Output pins of a drawing that gives the holes.

        Args:
            count: output pins.
            circle_radius: m.
            pin_radius: m.
            hole_radius: of the holes in the discs, m.
            eccentricity: of the shaft, m.
        """
        return cls(count, circle_radius, pin_radius, 2 * (hole_radius - pin_radius - eccentricity))


@record
class CycloidalStiffness(Record):
    """Stiffness of the bearings of a single-stage drive."""

    eccentric_bearing: Scalar = field("N/m", "disc on its eccentric", shape=("discs",), sign="positive")
    shaft_support: Scalar | None = field(
        "N/m", "shaft in its supports; None: its centre is fixed", default=None, sign="positive"
    )
    output_support: Scalar = field("N/m", "radial support of a floating carrier", default=0.0, sign="nonnegative")


def _as_rv(name: str, meaning: str = "", part: str = "", reader: tuple[str, ...] = READ_BY) -> Any:
    """An error that an RV reducer has too, with another meaning, part or reader where they are given."""
    about = dict(RVErrors.__dataclass_fields__[name].metadata) | dict(read_by=reader, bounds=None)
    about |= {key: given for key, given in (("meaning", meaning), ("part", part)) if given}
    return dataclasses.field(default=0.0, metadata=about)


@record
class CycloidalErrors(Errors):
    """Manufacturing errors of the parts of a single-stage cycloidal drive.

    Positions of holes and output pins are [radial, tangential] at their place in disc or carrier, pin offsets in the
    frame of their ring pin: radial away from the axis, tangential counter-clockwise. Pin 0, eccentric 0 and output pin
    0 lie on the x axis at input angle 0. A runout of the disc is a `disc_centre`, a pitch error of its holes a
    `hole_position`. Errors from `pin_offset` on have a place.
    """

    of_design: ClassVar[str] = "CycloidalReducer"

    bearing_clearance: Scalar = _as_rv("bearing_clearance", "radial clearance of the eccentric bearings")
    support_clearance: Scalar = _as_rv("support_clearance", "radial clearance of a shaft that `shaft_support` holds")
    eccentricity: Scalar = _as_rv(
        "eccentricity", "eccentricity of flanks and shaft alike; > 0 takes clearance from every hole", SHAFT
    )
    pin_circle_radius: Scalar = _as_rv("pin_circle_radius")
    pin_radius: Scalar = _as_rv("pin_radius")
    pin_hole_clearance: Scalar = _as_rv("pin_hole_clearance", "diametral clearance of the pins of the ring")
    equidistant_modification: Scalar = _as_rv("equidistant_modification")
    shift_modification: Scalar = _as_rv("shift_modification")
    pin_offset: Scalar = _as_rv("pin_offset", "position of each pin in the ring")
    pin_radii: Scalar = _as_rv("pin_radii")
    ring_centre: Scalar = _as_rv("ring_centre", "pin circle against the main axis, ring x, y")
    disc_centre: Scalar = _as_rv("disc_centre", "teeth against bore, x, y at input angle 0")
    disc_pitch: Scalar = _as_rv("disc_pitch")
    disc_profile: Scalar = _as_rv("disc_profile")
    throw: Scalar = placed(
        "longer throw of each eccentric of the shaft than of the flank",
        SHAFT,
        READ_BY,
        shape=("discs",),
        of="cycloid.eccentricity",
    )
    eccentric_phase: Scalar = deviation(
        "rad", "angle of each eccentric on the shaft", SHAFT, READ_BY, shape=("discs",), placed=True
    )
    hole_position: Scalar = placed(
        "position of each hole against the bore of its disc",
        DISCS,
        READ_BY,
        shape=("discs", "output_pins", 2),
        of="output.circle_radius",
        vector="polar",
        carried_by="disc",
        mirrored=(1, -1),
    )
    hole_radius: Scalar = placed(
        "radius of each hole; > 0 is clearance", DISCS, READ_BY, shape=("discs", "output_pins"), carried_by="disc"
    )
    output_pin_offset: Scalar = placed(
        "position of each output pin in the carrier",
        OUTPUT,
        READ_BY,
        shape=("output_pins", 2),
        of="output.circle_radius",
        vector="polar",
        carried_by="carrier",
    )
    output_pin_radius: Scalar = placed(
        "radius of each output pin; < 0 is clearance",
        OUTPUT,
        READ_BY,
        shape=("output_pins",),
        of="output.pin_radius",
        carried_by="carrier",
    )
    shaft_centre: Scalar = centre(
        "axis of the shaft against the main axis, x, y in the part at rest at input angle 0",
        SHAFT,
        READ_BY,
        breaks_pitch=True,
    )
    carrier_centre: Scalar = centre(
        "circle of output pins against the main axis, x, y at input angle 0; turns with the carrier",
        CARRIER,
        READ_BY,
        carried_by="carrier",
    )
    ring_pin_friction: Scalar = _as_rv("ring_pin_friction", reader=RUNNING)
    output_pin_friction: Scalar = share("the friction of output pins is larger", OUTPUT, RUNNING)
    arm_bearing_friction: Scalar = _as_rv(
        "arm_bearing_friction", "share by which the friction of the eccentric bearings is larger", reader=RUNNING
    )
    drag_friction: Scalar = _as_rv("drag_friction", reader=RUNNING)


@record
class CycloidalReducer(Record):
    """A single-stage cycloidal drive (K-H-V). The angle of its input is that of the shaft against the part at rest.

    `shortening`, `force_angle` and `disc_phase` of the cycloid stage are not read.
    """

    kind: ClassVar[str] = "cycloidal"  # in study files
    error_record: ClassVar[type[CycloidalErrors]] = CycloidalErrors
    places: ClassVar[str] = "output_pins"  # as in an RV reducer

    cycloid: CycloidStage = field("-", "discs and ring of pins", kind="record")
    output: OutputPins = field("-", "output pins in the holes of the discs", kind="record")
    stiffness: CycloidalStiffness | None = field("-", "stiffnesses of the bearings", kind="record", default=None)
    contact: Contact | None = field("-", "contact of discs and pins", kind="record", default=None)
    bearings: Bearings | None = field("-", "bearings of the eccentrics", kind="record", default=None)
    friction: Friction | None = field("-", "friction by place, for `running`", kind="record", default=None)
    member: str = text(
        'the output: "carrier" (ring at rest) or "ring" (carrier at rest)', default="carrier", choices=MEMBERS
    )

    @property
    def ratio(self) -> float:
        """Turns of the shaft for one of the output: -zc of the carrier, which turns against it; zp of the ring."""
        return -self.cycloid.disc_teeth if self.member == "carrier" else self.cycloid.pin_count

    @property
    def carrier_ratio(self) -> float:
        """Turns of the shaft against the part at rest for one of the carrier against the ring: -zc or -zp."""
        return -self.cycloid.disc_teeth if self.member == "carrier" else -self.cycloid.pin_count

    @property
    def carrier_factor(self) -> float:
        """Torque of the carrier over that of the output; error of the output over that of the carrier: 1 or -zc/zp."""
        return 1.0 if self.member == "carrier" else -self.cycloid.disc_teeth / self.cycloid.pin_count

    @property
    def counts(self) -> dict[str, int]:
        """Sizes of the named axes in the shapes of this design's errors; the shaft counts as the one crank."""
        return self.cycloid.counts | {"cranks": 1, "output_pins": self.output.count}

    @property
    def orders(self) -> dict[str, float]:
        """Orders of the output turn that parts of the drive cause, as `RVReducer.orders`.

        In a turn of the output the shaft turns zp times against the carrier and passes all holes each time, and zc
        times against the ring and passes all its pins. Discs without errors make the orders of these passings.
        """
        teeth, pins = self.cycloid.disc_teeth, self.cycloid.pin_count
        holes = float(self.output.count * pins)
        passing = {"holes": holes, "twice the holes": 2 * holes, "three times the holes": 3 * holes}
        passing |= {"passing of the pins": float(teeth * pins)}
        shaft = {"shaft": abs(self.ratio), "shaft against the output": abs(self.ratio - 1)}
        return self.cycloid.orders | passing | shaft

    @property
    def multiples(self) -> tuple[int, ...]:
        """Teeth and pins: every order of the output turn that one part makes is a multiple of one of them."""
        return self.cycloid.disc_teeth, self.cycloid.pin_count

    def stiffer(self, factor: Scalar) -> Self:
        """Drive with all spring stiffnesses multiplied by a factor."""
        return self.replace(stiffness=jax.tree.map(lambda k: factor * k, self.stiffness))

    def _check(self) -> None:
        choose("CycloidalReducer.member", self.member, MEMBERS)
        cycloid, output = self.cycloid, self.output
        check_teeth(cycloid)
        if concrete(cycloid.eccentricity, output.hole_clearance):
            room = np.asarray(cycloid.eccentricity) + np.asarray(output.hole_clearance) / 2
            if np.any(room <= 0):
                raise ValueError(
                    f"OutputPins.hole_clearance = {quantity(output.hole_clearance, 'm')}: must be larger than "
                    f"-2 eccentricity = {quantity(-2 * cycloid.eccentricity, 'm')}: holes are larger than their pins"
                )


Reducer = RVReducer | CycloidalReducer
ReducerErrors = RVErrors | CycloidalErrors
"""Designs with cycloid discs, and the errors of their parts."""
