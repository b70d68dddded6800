"""Errors of the parts of a reducer. Every field is a deviation from nominal and defaults to zero.

One physical error has one home: each model reads the fields it depends on, and the derivative of a
model to a field it does not read is exactly zero. The metadata of its field (`deviation`) describe an error
to the other layers: a new error is one field.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp

from rvjax._reducer.deviations import (
    STAGES,
    Bound,
    Errors,
    described,
    deviation,
    length,
    part,
    placed,
    placed_by,
    read_by,
    share,
)
from rvjax.records import Scalar, record

__all__ = ["STAGES", "Bound", "CamRollerErrors", "Errors", "RVErrors", "described", "deviation", "length", "part"]
__all__ += ["placed", "placed_by", "read_by", "share"]

SUN, PLANETS, GEARS = (part(name, stage="involute") for name in ("sun", "planets", "gears"))
DISCS, RING = (part(name, stage="cycloid") for name in ("discs", "ring"))
CRANKS, BEARINGS, CARRIER = (part(name, stage="cranks") for name in ("cranks", "bearings", "carrier"))
CAM, ROLLERS = (part(name, stage="rollers") for name in ("cam", "rollers"))

LOADED = ("loaded", "life", "running")  # models that read an error
RUNNING = ("running",)
LINKS = ("four_bar", "dynamics", *LOADED)
CLEARANCES = ("lost_motion", *LOADED)
EXCITATION = ("dynamics", *LOADED)


def _runout(centres: jax.Array) -> jax.Array:
    """Twice the largest length; the derivative at zero is zero."""
    square = jnp.max(jnp.sum(jnp.square(jnp.broadcast_to(centres, (*centres.shape[:-1], 2))), axis=-1))
    return 2 * jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _tangential(offsets: jax.Array) -> jax.Array:
    """Largest size of the second component."""
    return jnp.max(jnp.abs(offsets[..., 1] if offsets.ndim else offsets))


def _range(pitch: jax.Array) -> jax.Array:
    """Largest less smallest, of the worst disc."""
    return jnp.max(jnp.max(pitch, axis=-1) - jnp.min(pitch, axis=-1)) if pitch.ndim else 0 * pitch


@record
class RVErrors(Errors):
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

    of_design: ClassVar[str] = "RVReducer"

    crank_eccentricity: Scalar = length(
        "eccentricity of each crank journal",
        CRANKS,
        LINKS,
        shape=("discs", "cranks"),
        of="cycloid.eccentricity",
        carried_by="crank",
    )
    crank_phase: Scalar = deviation(
        "rad", "angle of each crankshaft", CRANKS, LINKS, shape=("cranks",), carried_by="crank"
    )
    disc_bore: Scalar = length(
        "position of the bores in the discs",
        DISCS,
        LINKS,
        shape=("discs", "cranks", 2),
        of="cranks.circle_radius",
        vector="polar",
        carried_by="disc",
        mirrored=(1, -1),
    )
    carrier_bore: Scalar = length(
        "position of the bores in the carrier",
        CARRIER,
        LINKS,
        shape=("cranks", 2),
        of="cranks.circle_radius",
        vector="polar",
        carried_by="carrier",
    )
    bearing_clearance: Scalar = length(
        "radial clearance of the crank bearings, half the diametral clearance",
        BEARINGS,
        ("four_bar", *CLEARANCES),
        sign="nonnegative",
    )
    eccentricity: Scalar = length(
        "eccentricity of discs and cranks alike", CRANKS, ("four_bar", *CLEARANCES), of="cycloid.eccentricity"
    )
    pin_circle_radius: Scalar = length(
        "radius of the pin circle; > 0 is clearance", RING, CLEARANCES, of="cycloid.pin_circle_radius"
    )
    pin_radius: Scalar = length("radius of the pins; < 0 is clearance", RING, CLEARANCES, of="cycloid.pin_radius")
    pin_hole_clearance: Scalar = length(
        "diametral clearance of the pins", RING, CLEARANCES, sign="nonnegative", of="cycloid.pin_radius"
    )
    pin_position: Scalar = length(
        "circumferential position of the pins", RING, ("lost_motion",), bounds=Bound("pin_offset", _tangential)
    )
    disc_runout: Scalar = length(
        "radial runout of the disc teeth", DISCS, ("lost_motion",), bounds=Bound("disc_centre", _runout)
    )
    disc_cumulative_pitch: Scalar = length(
        "cumulative pitch error of the disc", DISCS, ("lost_motion",), bounds=Bound("disc_pitch", _range)
    )
    equidistant_modification: Scalar = length("deviation of the equidistant modification", DISCS, CLEARANCES)
    shift_modification: Scalar = length("deviation of the shift modification", DISCS, CLEARANCES)
    base_tangent_upper: Scalar = length(
        "upper deviation of the base tangent length; < 0 thins the tooth", GEARS, CLEARANCES
    )
    base_tangent_lower: Scalar = length(
        "lower deviation of the base tangent length; < 0 thins the tooth", GEARS, CLEARANCES
    )
    support_clearance: Scalar = placed(
        "radial clearance of the cranks in the carrier", BEARINGS, LOADED, sign="nonnegative"
    )
    pin_offset: Scalar = placed(
        "position of each pin in the housing", RING, EXCITATION, shape=("pins", 2), vector="polar", breaks_pitch=True
    )
    pin_radii: Scalar = placed(
        "radius of each pin, added to the common one",
        RING,
        EXCITATION,
        shape=("pins",),
        of="cycloid.pin_radius",
        breaks_pitch=True,
    )
    ring_centre: Scalar = placed(
        "pin circle against the main bearings, housing x, y",
        RING,
        EXCITATION,
        shape=(2,),
        vector="xy",
        breaks_pitch=True,
    )
    disc_centre: Scalar = placed(
        "teeth against bores, x, y at input angle 0",
        DISCS,
        EXCITATION,
        shape=("discs", 2),
        vector="xy",
        carried_by="disc",
    )
    disc_pitch: Scalar = placed(
        "position of each tooth on its circle, counter-clockwise",
        DISCS,
        LOADED,
        shape=("discs", "teeth"),
        carried_by="disc",
        mirrored=(-1,),
    )
    disc_profile: Scalar = placed(
        "material normal to the flank, [cosine, sine] of 0 to 4 times the angle of a lobe",
        DISCS,
        LOADED,
        shape=("discs", 5, 2),
        carried_by="disc",
        mirrored=(1, -1),
    )
    sun_runout: Scalar = placed(
        "eccentricity of the sun teeth, x, y at input angle 0",
        SUN,
        EXCITATION,
        shape=(2,),
        vector="xy",
        breaks_pitch=True,
    )
    planet_runout: Scalar = placed(
        "eccentricity of the planet teeth", PLANETS, EXCITATION, shape=("cranks", 2), vector="polar", carried_by="crank"
    )
    sun_planet_stiffness: Scalar = share(
        "all meshes of sun and planets are stiffer", GEARS, of="stiffness.sun_planet_mesh"
    )
    disc_pin_stiffness: Scalar = share("all meshes of discs and pins are stiffer", RING, of="stiffness.disc_pin_mesh")
    turning_arm_stiffness: Scalar = share(
        "all bearings in the discs are stiffer", BEARINGS, of="stiffness.turning_arm_bearing"
    )
    support_stiffness: Scalar = share(
        "all bearings in the carrier are stiffer", BEARINGS, of="stiffness.support_bearing"
    )
    ring_pin_friction: Scalar = share("the friction of ring pins is larger", RING, RUNNING)
    arm_bearing_friction: Scalar = share("the friction of the bearings in the discs is larger", BEARINGS, RUNNING)
    support_bearing_friction: Scalar = share("the friction of the bearings in the carrier is larger", BEARINGS, RUNNING)
    gear_mesh_friction: Scalar = share("the loss of the meshes of sun and planets is larger", GEARS, RUNNING)
    drag_friction: Scalar = share("drags, viscous drags and moments of unloaded bearings are larger", BEARINGS, RUNNING)
    sun_flank: Scalar = length(
        "flanks of the sun; > 0 is material", SUN, ("dynamics",), shape=("sun_orders", 2), series=True
    )
    planet_flank: Scalar = length(
        "flanks of each planet; > 0 is material",
        PLANETS,
        ("dynamics",),
        shape=("cranks", "planet_orders", 2),
        series=True,
    )
    disc_flank: Scalar = length(
        "flank of each disc; > 0 is material", DISCS, ("dynamics",), shape=("discs", "disc_orders", 2), series=True
    )
    ring_flank: Scalar = length(
        "pins of the ring; > 0 is material", RING, ("dynamics",), shape=("ring_orders", 2), series=True
    )


@record
class CamRollerErrors(Errors):
    """Manufacturing errors of an oscillatory roller stage; > 0 is extra material or throw, that is interference."""

    of_design: ClassVar[str] = "CamRollerReducer"

    cam_radius: Scalar = length("radius of the disc cam", CAM, ("mesh_force",), of="cam_radius")
    eccentricity: Scalar = length("eccentricity of the cam (installation)", CAM, ("mesh_force",), of="eccentricity")
    roller_radius: Scalar = length(
        "radius of the rollers, one number or one per roller",
        ROLLERS,
        ("mesh_force",),
        shape=("rollers",),
        of="roller_radius",
    )
