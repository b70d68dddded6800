"""How the parts of a reducer deviate from nominal. Every field is a deviation and defaults to zero.

One physical error has one home: each model reads the fields it depends on, and the derivative of a
model to a field it does not read is exactly zero.
"""

from collections.abc import Iterable
from typing import Any, Self

import jax.numpy as jnp

from rvjax.designs import CamRollerReducer, RVReducer, expect
from rvjax.records import Record, broadcast_fields, field, record


@record
class RVErrors(Record):
    """Manufacturing errors of the parts of an RV reducer.

    Bore positions are [radial, tangential] in the frame of their crank, pin offsets in the frame of their pin, planet
    runouts in the frame of their planet at input angle 0: radial away from the main axis, tangential counter-clockwise.
    Pin 0 and eccentric 0 lie on the x axis at input angle 0. The errors from `support_clearance` on have a place;
    `rvjax.loaded` and, as excitation, `rvjax.dynamics` read them. `pin_position`, `disc_runout` and
    `disc_cumulative_pitch` are bounds without a place.

    A flank series holds [a, b] of a cos(h chi) + b sin(h chi), h = 1, 2, ..: excess material on the loaded flank. chi
    is the angle in the part at which it meets: of the planet in the sun, of the sun in a planet, of the eccentric in
    disc and ring; it counts from crank 0 (in a planet: from its own crank outwards) at input angle 0. The series brings
    its own length; 0.0 is none. `rvjax.dynamics` alone reads it.
    """

    crank_eccentricity: Any = field(
        "m",
        "eccentricity of each crank journal",
        shape=("discs", "cranks"),
        default=0.0,
        of="cycloid.eccentricity",
        part="cranks",
    )
    crank_phase: Any = field("rad", "angle of each crankshaft", shape=("cranks",), default=0.0, part="cranks")
    disc_bore: Any = field(
        "m",
        "position of the bores in the discs",
        shape=("discs", "cranks", 2),
        default=0.0,
        of="cranks.circle_radius",
        part="discs",
    )
    carrier_bore: Any = field(
        "m",
        "position of the bores in the carrier",
        shape=("cranks", 2),
        default=0.0,
        of="cranks.circle_radius",
        part="carrier",
    )
    bearing_clearance: Any = field(
        "m", "radial clearance of the crank bearings, half the play", default=0.0, sign="nonnegative", part="bearings"
    )
    eccentricity: Any = field(
        "m", "eccentricity of discs and cranks alike", default=0.0, of="cycloid.eccentricity", part="cranks"
    )
    pin_circle_radius: Any = field(
        "m", "radius of the pin circle; > 0 is play", default=0.0, of="cycloid.pin_circle_radius", part="ring"
    )
    pin_radius: Any = field("m", "radius of the pins; < 0 is play", default=0.0, of="cycloid.pin_radius", part="ring")
    pin_hole_clearance: Any = field(
        "m", "diametral clearance of the pins", default=0.0, sign="nonnegative", of="cycloid.pin_radius", part="ring"
    )
    pin_position: Any = field("m", "circumferential position of the pins", default=0.0, part="ring")
    disc_runout: Any = field("m", "radial runout of the disc teeth", default=0.0, part="discs")
    disc_cumulative_pitch: Any = field("m", "cumulative pitch error of the disc", default=0.0, part="discs")
    equidistant_modification: Any = field("m", "deviation of the equidistant modification", default=0.0, part="discs")
    shift_modification: Any = field("m", "deviation of the shift modification", default=0.0, part="discs")
    base_tangent_upper: Any = field(
        "m", "upper deviation of the base tangent length; < 0 thins the tooth", default=0.0, part="gears"
    )
    base_tangent_lower: Any = field(
        "m", "lower deviation of the base tangent length; < 0 thins the tooth", default=0.0, part="gears"
    )
    support_clearance: Any = field(
        "m", "radial clearance of the cranks in the carrier", default=0.0, sign="nonnegative", part="bearings"
    )
    pin_offset: Any = field("m", "position of each pin in the housing", shape=("pins", 2), default=0.0, part="ring")
    pin_radii: Any = field(
        "m",
        "radius of each pin, beside the common one",
        shape=("pins",),
        default=0.0,
        of="cycloid.pin_radius",
        part="ring",
    )
    ring_centre: Any = field(
        "m", "pin circle against the main bearings, housing x, y", shape=(2,), default=0.0, part="ring"
    )
    disc_centre: Any = field(
        "m", "teeth against bores, x, y at input angle 0", shape=("discs", 2), default=0.0, part="discs"
    )
    disc_pitch: Any = field(
        "m",
        "position of each tooth on its circle, counter-clockwise",
        shape=("discs", "teeth"),
        default=0.0,
        part="discs",
    )
    disc_profile: Any = field(
        "m",
        "material normal to the flank, [cosine, sine] of 0 to 4 times the angle of a lobe",
        shape=("discs", 5, 2),
        default=0.0,
        part="discs",
    )
    sun_runout: Any = field(
        "m", "eccentricity of the sun teeth, x, y at input angle 0", shape=(2,), default=0.0, part="sun"
    )
    planet_runout: Any = field(
        "m", "eccentricity of the planet teeth", shape=("cranks", 2), default=0.0, part="planets"
    )
    sun_planet_stiffness: Any = field(
        "-", "share by which all meshes of sun and planets are stiffer", default=0.0, part="gears"
    )
    disc_pin_stiffness: Any = field(
        "-", "share by which all meshes of discs and pins are stiffer", default=0.0, part="ring"
    )
    turning_arm_stiffness: Any = field(
        "-", "share by which all bearings in the discs are stiffer", default=0.0, part="bearings"
    )
    support_stiffness: Any = field(
        "-", "share by which all bearings in the carrier are stiffer", default=0.0, part="bearings"
    )
    sun_flank: Any = field("m", "flanks of the sun; > 0 is material", shape=("sun_orders", 2), default=0.0, part="sun")
    planet_flank: Any = field(
        "m", "flanks of each planet; > 0 is material", shape=("cranks", "planet_orders", 2), default=0.0, part="planets"
    )
    disc_flank: Any = field(
        "m", "flank of each disc; > 0 is material", shape=("discs", "disc_orders", 2), default=0.0, part="discs"
    )
    ring_flank: Any = field(
        "m", "pins of the ring; > 0 is material", shape=("ring_orders", 2), default=0.0, part="ring"
    )

    def stiffened(self, design: RVReducer) -> RVReducer:
        """The design with the stiffness of this unit, for the models that read it."""
        if design.stiffness is None:
            return design
        shares = {
            "sun_planet_mesh": self.sun_planet_stiffness,
            "disc_pin_mesh": self.disc_pin_stiffness,
            "turning_arm_bearing": self.turning_arm_stiffness,
            "support_bearing": self.support_stiffness,
        }
        own = {name: getattr(design.stiffness, name) * (1 + share) for name, share in shares.items()}
        return design.replace(stiffness=design.stiffness.replace(**own))

    def bounded(self, names: Iterable[str]) -> Self:
        """The same errors with some bounds without a place as what they bound: of one unit, one home.

        Args:
            names: keys of `BOUNDS`. `disc_runout` becomes twice the largest length of a `disc_centre`, `pin_position`
                the largest tangential `pin_offset`, `disc_cumulative_pitch` the largest range of a `disc_pitch`.
        """
        made = {}
        for name in names:
            values = jnp.asarray(getattr(self, BOUNDS[name]))
            if name == "disc_runout":
                square = jnp.max(jnp.sum(jnp.square(jnp.broadcast_to(values, (*values.shape[:-1], 2))), axis=-1))
                made[name] = 2 * jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
            elif name == "pin_position":
                made[name] = jnp.max(jnp.abs(values[..., 1] if values.ndim else values))
            else:
                made[name] = jnp.max(jnp.max(values, axis=-1) - jnp.min(values, axis=-1)) if values.ndim else 0 * values
        return self.replace(**made)

    @classmethod
    def for_design(cls, design: RVReducer, **errors: Any) -> Self:
        """Errors with full array shapes; a scalar for an array field is broadcast.

        Args:
            design: tells the counts of the shapes.
            **errors: fields by name; absent ones are zero, those with a place as a plain number.

        Raises:
            ValueError: unknown field, or a shape that does not fit the design.
        """
        expect(design, "RVErrors.for_design", RVReducer)
        full = broadcast_fields(cls, design.counts, errors)
        return cls(**full | {name: 0.0 for name in PLACED if name not in errors})


PLACED = (
    "support_clearance",
    "pin_offset",
    "pin_radii",
    "ring_centre",
    "disc_centre",
    "disc_pitch",
    "disc_profile",
    "sun_runout",
    "planet_runout",
)
"""Errors with a place, which `rvjax.loaded` reads."""

VECTORS = ("disc_bore", "carrier_bore", "pin_offset", "ring_centre", "disc_centre", "sun_runout", "planet_runout")
"""Errors whose last axis is a displacement in the plane of the machine."""

BOUNDS = {"disc_runout": "disc_centre", "pin_position": "pin_offset", "disc_cumulative_pitch": "disc_pitch"}
"""Errors without a place, and the errors with a place that they are bounds of: see `RVErrors.bounded`."""

STAGES = {
    "sun": "involute",
    "planets": "involute",
    "gears": "involute",
    "discs": "cycloid",
    "ring": "cycloid",
    "cranks": "cranks",
    "bearings": "cranks",
    "carrier": "cranks",
    "cam": "rollers",
    "rollers": "rollers",
}
"""Stage of each part that the fields of error records name in their metadata, for an RV reducer as in its design."""


@record
class CamRollerErrors(Record):
    """Manufacturing errors of an oscillatory roller stage; > 0 is extra material or throw, that is interference."""

    cam_radius: Any = field("m", "radius of the disc cam", default=0.0, of="cam_radius", part="cam")
    eccentricity: Any = field("m", "eccentricity of the cam (installation)", default=0.0, of="eccentricity", part="cam")
    roller_radius: Any = field(
        "m",
        "radius of the rollers, one number or one per roller",
        shape=("rollers",),
        default=0.0,
        of="roller_radius",
        part="rollers",
    )

    @classmethod
    def for_design(cls, design: CamRollerReducer, **errors: Any) -> Self:
        """Errors with full array shapes; a scalar for an array field is broadcast.

        Args:
            design: tells the counts of the shapes.
            **errors: fields by name; absent ones are zero.

        Raises:
            ValueError: unknown field, or a shape that does not fit the design.
        """
        expect(design, "CamRollerErrors.for_design", CamRollerReducer)
        return cls(**broadcast_fields(cls, design.counts, errors))
