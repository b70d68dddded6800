"""Inner gear of an oscillatory roller stage: centre curve, flank, curvature, directions of the forces of a roller.

A roller centre lies on its ray at distance s from the axis, and on a circle of radius L = Rj + r about
the cam centre. psi is the lead of the cam over the ray; the signed angle g between the ray and the cam
normal has sin g = (e/L) sin psi. All forms are exact on both flanks and need no convex/concave branch.

Source: Wei et al. 2021, Chin. J. Mech. Eng. 34:84, Eqs. 1-7. Eqs. 1-3 are missing from the text at hand
and follow from the envelope construction it describes; in Eqs. 6 and 7 the link has the length L that its
section 2 defines (with Rj, as published, the roller radius could not change the cage force).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.catalogue import checked
from rvjax.designs import CamRollerReducer, expect
from rvjax.records import Array, Record, Scalar, field, promote, record


class Rollers(NamedTuple):
    """Positions of rollers and directions of their forces; every entry has the shape of psi."""

    cos_g: jax.Array
    sin_g: jax.Array
    distance: jax.Array  # s, roller centre from the axis, m
    arm: jax.Array  # sin(psi + g) = moment arm of the cam force over e
    throw: jax.Array  # cos(psi + g) = part of an eccentricity error along the cam normal
    cage_ratio: jax.Array  # Fs / Fj, signed
    gear_ratio: jax.Array  # Fn / Fj
    centre_curvature: jax.Array  # kc, > 0 hollow, 1/m


@record
class ToothProfile(Record):
    """A point of the inner gear; x = s sin(angle), y = s cos(angle), curvature > 0 is hollow."""

    centre: Array = field("m", "roller centre, point of the centre curve", shape=(2,))
    flank: Array = field("m", "point of the working profile", shape=(2,))
    normal_angle: Array = field("rad", "profile normal from the y axis, alpha")
    pressure_angle: Array = field("rad", "profile normal from the roller's ray, signed")
    centre_curvature: Array = field("1/m", "curvature of the centre curve")
    flank_curvature: Array = field("1/m", "curvature of the working profile")
    undercut: Array = field("-", "True where the design has no complete working profile", kind="integer")


def rollers(eccentricity: Scalar, link: Scalar, teeth: int, sin_psi: jax.Array, cos_psi: jax.Array) -> Rollers:
    """Geometry of rollers from the cam lead psi over their rays; elementwise in any shape.

    Args:
        eccentricity: e, m.
        link: L = Rj + r, m.
        teeth: z.
        sin_psi: sine of the cam lead.
        cos_psi: cosine of the cam lead.
    """
    sin_g = jnp.asarray(eccentricity / link * sin_psi)  # (6)
    cos_g = jnp.sqrt(1 - sin_g**2)
    distance = jnp.asarray(eccentricity * cos_psi + link * cos_g)  # (7)
    square = (1 - sin_g**2) + teeth**2 * sin_g**2  # of no other root
    root = jnp.sqrt(square)
    return Rollers(
        cos_g=cos_g,
        sin_g=sin_g,
        distance=distance,
        arm=sin_psi * cos_g + cos_psi * sin_g,  # (8): s sin g = e sin(psi + g)
        throw=cos_psi * cos_g - sin_psi * sin_g,
        cage_ratio=(teeth + 1) * sin_g,  # (4)
        gear_ratio=root,  # (4): cos g / cos(pressure angle)
        centre_curvature=(cos_g * square + teeth**2 * (eccentricity / link) * cos_psi) / (distance * square * root),
    )


def undercut_margin(design: CamRollerReducer) -> Scalar:
    """1 + r kc at the tooth crest, where the centre curve is most convex; the profile exists where it is > 0.

    Args:
        design: the stage.
    """
    expect(design, "mesh_force.undercut_margin", CamRollerReducer)
    link = design.cam_radius + design.roller_radius
    curvature = (1 - design.gear_teeth**2 * design.eccentricity / link) / (link - design.eccentricity)
    return 1 + design.roller_radius * curvature


def largest_roller_radius(design: CamRollerReducer) -> jax.Array:
    """Roller radius at which the inner gear begins to be undercut, m; infinite where none does.

    `undercut_margin` = 0 is a quadratic in the roller radius.

    Args:
        design: the stage; its roller radius is not read.
    """
    expect(design, "mesh_force.largest_roller_radius", CamRollerReducer)
    radius, e, z = design.cam_radius, design.eccentricity, design.gear_teeth
    half = (3 * radius - (1 + z**2) * e) / 4  # 2 r^2 + 4 half r + Rj (Rj - e) = 0
    discriminant = half**2 - radius * (radius - e) / 2
    exists = (discriminant >= 0) & (half < 0)
    root = radius * (radius - e) / 2 / (-half + jnp.sqrt(jnp.where(exists, discriminant, 1)))  # the smaller one
    return jnp.where(exists, root, jnp.inf)


@checked
@jax.jit
def tooth_profile(design: CamRollerReducer, angle: Scalar) -> ToothProfile:
    """Compute the point of the inner gear for a roller at `angle`.

    Args:
        design: the stage.
        angle: of the roller's ray from the y axis on the fixed gear, () rad; a tooth every 2 pi / z.

    Returns:
        ToothProfile. Where `undercut` is true the flank crosses itself near the tooth crest. Wei et al. 2021,
        Eqs. 1-3 (reconstructed).
    """
    expect(design, "mesh_force.tooth_profile", CamRollerReducer)
    design, angle = promote(design, angle)
    z = design.gear_teeth
    r, link = design.roller_radius, design.cam_radius + design.roller_radius
    place = rollers(design.eccentricity, link, z, jnp.sin(z * angle), jnp.cos(z * angle))
    pressure_angle = jnp.arctan2(z * place.sin_g, place.cos_g)
    normal_angle = jnp.add(angle, pressure_angle)  # (3)
    centre = place.distance * _direction(angle)  # (1)
    return ToothProfile(
        centre=centre,
        flank=centre + r * _direction(normal_angle),  # (2)
        normal_angle=normal_angle,
        pressure_angle=pressure_angle,
        centre_curvature=place.centre_curvature,
        flank_curvature=place.centre_curvature / (1 + r * place.centre_curvature),
        undercut=jnp.asarray(undercut_margin(design)) <= 0,
    )


def _direction(angle: Scalar) -> jax.Array:
    return jnp.stack([jnp.sin(angle), jnp.cos(angle)])
