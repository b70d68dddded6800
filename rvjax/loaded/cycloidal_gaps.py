"""Contacts of a single-stage drive at the ideal position, and its fit without load.

Depths of pins and holes and offsets of the eccentric bearings are linear in the displacements, holes too: a norm of the
distance of both axes in the holes alone would turn their forces while those of the pins keep their directions, and
input torque and output torque would no longer balance. Equation numbers: docs/models/single_stage.md.

Fit: does the drive turn freely, or does it jam? The discs sit on their eccentrics, without clearance of the bearings.
Every disc and the carrier are turned to where the least gap of all pins and holes is largest.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.flank import Ground
from rvjax.loaded.geometry import STEPS, Geometry, Lines, Turn, geometry, largest_gap, pin_depths
from rvjax.loaded.system import Layout
from rvjax.records import Scalar, promote
from rvjax.status import SolveInfo, Status, admit, converged


class Drive(NamedTuple):
    """Directions of one input angle; d discs, n output pins."""

    ring: Geometry  # of the pins of the ring
    swing: Turn  # b_k - a_m, (d, n)


class DriveGaps(NamedTuple):
    """Depths and bearing offsets where every part is at its ideal position, m."""

    pins: jax.Array  # (d, p)
    holes: jax.Array  # (d, n)
    centres: jax.Array  # (d, 2) ideal centre of a disc less the centre of its eccentric


class DriveRows(NamedTuple):
    """Changes of depths and offsets with the displacements (unknowns u)."""

    pins: jax.Array  # (3, d, p) of the disc alone
    holes: jax.Array  # (d, n, u)
    bearings: jax.Array  # (b, 2, u) of the eccentrics, then of a held shaft in its supports


def drive_at(design: CycloidalReducer, eccentricity: jax.Array, input_angle: jax.Array) -> Drive:
    """Directions and levers at an input angle.

    Args:
        design: counts, radii and the output member are read.
        eccentricity: e, nominal and error, () m.
        input_angle: of the shaft against the part at rest, () rad.
    """
    discs, pins = design.cycloid.disc_count, design.output.count
    ring = geometry(design.cycloid, eccentricity, input_angle / design.carrier_ratio)  # Eqs. 1 and 2
    places = np.arange(discs)[:, None] / discs - np.arange(pins)[None] / pins
    return Drive(ring, ring.crank.plus(2 * np.pi * places))


def drive_gaps(design: CycloidalReducer, errors: CycloidalErrors, at: Drive, eccentricity: Scalar) -> DriveGaps:
    """All gaps of one angle.

    Args:
        design: modifications, clearances and the output member are read.
        errors: array fields in full shape or scalars.
        at: directions of the angle.
        eccentricity: nominal and error, () m.
    """
    return DriveGaps(
        pins=pin_depths(design.cycloid, errors, at.ring),
        holes=_hole_depths(design, errors, at, eccentricity),
        centres=_centres(design, errors, at, eccentricity),
    )


def _hole_depths(design: CycloidalReducer, errors: CycloidalErrors, at: Drive, eccentricity: Scalar) -> jax.Array:
    """Depth of every output pin in its hole, (d, n) m: Eq. 6. A longer eccentricity closes every hole."""
    discs, pins = design.cycloid.disc_count, design.output.count
    hole = jnp.broadcast_to(errors.hole_position, (discs, pins, 2))
    away = hole - jnp.broadcast_to(errors.output_pin_offset, (pins, 2))[None]
    centre = jnp.broadcast_to(errors.carrier_centre, (2,))
    b = at.ring.eccentric
    clearance = design.output.hole_clearance / 2 + jnp.broadcast_to(errors.hole_radius, (discs, pins))
    clearance -= jnp.broadcast_to(errors.output_pin_radius, (pins,))[None]
    depth = away[..., 0] * at.swing.cosine + away[..., 1] * at.swing.sine
    depth -= (b.cosine * centre[0] + b.sine * centre[1])[:, None]
    return depth - clearance + (eccentricity - design.cycloid.eccentricity)


def _centres(design: CycloidalReducer, errors: CycloidalErrors, at: Drive, eccentricity: Scalar) -> jax.Array:
    """Eq. 7: ideal centre of a disc less that of its eccentric, (d, 2) m."""
    discs, b = design.cycloid.disc_count, at.ring.eccentric
    longer = jnp.broadcast_to(errors.throw, (discs,))
    ahead = jnp.asarray(eccentricity * jnp.broadcast_to(errors.eccentric_phase, (discs,)))
    x, y = jnp.broadcast_to(errors.shaft_centre, (2,))
    if design.member == "carrier":  # its supports are in the housing, which the carrier's frame turns against
        x, y = at.ring.carrier.back.of(x, y)
    return -jnp.stack([longer * b.cosine - ahead * b.sine + x, longer * b.sine + ahead * b.cosine + y], axis=-1)


def drive_rows(design: CycloidalReducer, layout: Layout, at: Drive) -> DriveRows:
    """Rows of all contacts and bearings of one angle.

    Args:
        design: radius of the circle of output pins, the length of every rotation.
        layout: counts and what floats.
        at: directions of the angle.
    """
    discs, output_pins = at.swing.sine.shape
    normal_x, normal_y = at.ring.normal
    towards = jnp.stack([at.ring.eccentric.cosine, at.ring.eccentric.sine], axis=-1)  # u(b_k)
    eye, frame = jnp.eye(2, dtype=towards.dtype), layout.carried + 1
    holes = jnp.zeros((discs, output_pins, layout.unknowns), towards.dtype)
    bearings = jnp.zeros((discs + layout.input_moves, 2, layout.unknowns), towards.dtype)
    for k in range(discs):
        holes = holes.at[k, :, 3 * k : 3 * k + 2].set(towards[k]).at[k, :, 3 * k + 2].set(at.swing.sine[k])
        bearings = bearings.at[k, :, 3 * k : 3 * k + 2].set(eye)
    holes = holes.at[:, :, layout.carried].set(-at.swing.sine)
    if layout.carrier_floats:
        holes = holes.at[:, :, frame : frame + 2].set(-towards[:, None])
    if layout.input_moves:
        shaft = slice(layout.unknowns - 2, layout.unknowns)
        bearings = bearings.at[:discs, :, shaft].set(-eye).at[discs, :, shaft].set(eye)
    return DriveRows(jnp.stack([-normal_x, -normal_y, at.ring.lever / design.output.circle_radius]), holes, bearings)


UNREAD = ("bearing_clearance", "support_clearance")
"""Errors that do not change the fit."""


def gaps_of_turn(
    samples: int, turns: float, design: CycloidalReducer, errors: CycloidalErrors
) -> tuple[tuple[jax.Array, jax.Array], SolveInfo]:
    """Least gap of pins and holes along a turn of the output, of all angles () and of each (n,), m.

    NONFINITE: a number that is read is NaN or inf; INVALID_GEOMETRY: K1 outside (0, 1), a radius that is not positive,
    or holes not larger than their pins; UNDERCUT.

    Args:
        samples: n, angle j at input angle 2 pi ratio turns j / n.
        turns: of the output.
        design: cycloid stage, output pins and output member are read.
        errors: of all parts but the bearings.
    """
    cycloid, output = design.cycloid.replace(force_angle=0.0, disc_phase=0.0, shortening=None), design.output
    lengths = output.circle_radius, output.hole_clearance
    read = promote((cycloid, lengths, errors.replace(**dict.fromkeys(UNREAD, 0.0))))
    (cycloid, lengths, used), zero = read, jax.tree.map(jnp.zeros_like, read)
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    k1, e = cycloid.shortening_coefficient, cycloid.eccentricity + used.eccentricity
    short, room = e * cycloid.pin_count / cycloid.pin_circle_radius, cycloid.eccentricity + lengths[1] / 2
    positive = jnp.stack([k1, short, cycloid.pin_circle_radius, cycloid.pin_radius, lengths[0], room])
    possible = jnp.all(positive > 0) & (k1 < 1) & (short < 1)
    spare = zero[0].replace(eccentricity=0.5 / cycloid.pin_count, pin_circle_radius=1.0, pin_radius=1e-6)
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (cycloid, lengths, used), gate = admit(read, (spare, (1.0, 0.0), zero[2]), *checks)
    sharp = Ground.of(cycloid).least_convex(cycloid.pin_count) <= 0
    whole = design.replace(cycloid=cycloid, output=output.replace(circle_radius=lengths[0], hole_clearance=lengths[1]))
    step = 2 * np.pi * design.ratio * turns / samples

    def at(j: jax.Array) -> tuple[jax.Array, jax.Array]:
        return largest_gap(*lines(whole, used, step * j))

    least, left = jax.lax.map(at, jnp.arange(samples, dtype=k1.dtype))  # an angle of a batch stays in the cache
    return gate.close((jnp.min(least), least), (sharp, Status.UNDERCUT), info=converged(jnp.max(left), STEPS))


def lines(design: CycloidalReducer, errors: CycloidalErrors, input_angle: jax.Array) -> tuple[Lines, Lines]:
    """Gaps of pins over the rotation of their disc, and of holes over its rotation against the carrier.

    Args:
        design: the drive.
        errors: array fields in full shape or scalars.
        input_angle: () rad.
    """
    e = jnp.asarray(design.cycloid.eccentricity + errors.eccentricity)
    there = drive_at(design, e, input_angle)
    depth = drive_gaps(design, errors, there, e)
    x, y = -depth.centres[:, :1], -depth.centres[:, 1:]  # of the disc on its eccentric
    normal, b = there.ring.normal, there.ring.eccentric
    pins = depth.pins - normal[0] * x - normal[1] * y
    holes = depth.holes + b.cosine[:, None] * x + b.sine[:, None] * y
    arm = jnp.asarray(design.output.circle_radius * there.swing.sine)
    return Lines(-pins, there.ring.lever), Lines(-holes, arm)
