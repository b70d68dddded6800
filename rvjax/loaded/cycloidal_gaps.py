"""Contacts of a single-stage drive at the ideal position, and its fit without load.

Depths of pins and holes and offsets of the eccentric bearings are linear in the displacements, holes too: a norm of the
distance of both axes in the holes alone would turn their forces while those of the pins keep their directions, and
input torque and output torque would no longer balance. Equation numbers: docs/models/single_stage.md.

Fit: does the drive turn freely, or does it jam? The discs sit on their eccentrics, without clearance of the bearings.
Every disc and the carrier are turned to where the least gap of all pins and holes is largest. At a gap s, the pins of
disc k leave its rotation an interval [lo, hi], the holes leave its rotation against the carrier [lo', hi']. All ends
are piecewise linear in s:

    s is feasible if lo <= hi and lo' <= hi' for every disc, and max (lo - hi') <= min (hi - lo')

The largest feasible s is the least root of concave falling functions, each exact in a few Newton steps from above.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import fori_loop
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.flank import Ground
from rvjax.loaded.geometry import Geometry, Turn, geometry, highest, pin_depths
from rvjax.records import Scalar, promote
from rvjax.status import SolveInfo, Status, admit, converged


class Unknowns(NamedTuple):
    """Order of the displacements: x, y, Rw beta of each disc; Rw alpha; x, y of a floating carrier, of a held shaft."""

    discs: int
    floats: bool  # the carrier
    held: bool  # the shaft in its supports; else its centre is fixed

    @property
    def carrier(self) -> int:
        """Row of the carrier rotation."""
        return 3 * self.discs

    @property
    def shaft(self) -> int:
        """First row of the shaft."""
        return self.carrier + 1 + 2 * self.floats

    @property
    def total(self) -> int:
        """Their number."""
        return self.shaft + 2 * self.held


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


def drive_rows(design: CycloidalReducer, unknowns: Unknowns, at: Drive) -> DriveRows:
    """Rows of all contacts and bearings of one angle.

    Args:
        design: radius of the circle of output pins, the length of every rotation.
        unknowns: their order.
        at: directions of the angle.
    """
    discs, output_pins = at.swing.sine.shape
    normal_x, normal_y = at.ring.normal
    towards = jnp.stack([at.ring.eccentric.cosine, at.ring.eccentric.sine], axis=-1)  # u(b_k)
    eye, frame = jnp.eye(2, dtype=towards.dtype), unknowns.carrier + 1
    holes = jnp.zeros((discs, output_pins, unknowns.total), towards.dtype)
    bearings = jnp.zeros((discs + unknowns.held, 2, unknowns.total), towards.dtype)
    for k in range(discs):
        holes = holes.at[k, :, 3 * k : 3 * k + 2].set(towards[k]).at[k, :, 3 * k + 2].set(at.swing.sine[k])
        bearings = bearings.at[k, :, 3 * k : 3 * k + 2].set(eye)
    holes = holes.at[:, :, unknowns.carrier].set(-at.swing.sine)
    if unknowns.floats:
        holes = holes.at[:, :, frame : frame + 2].set(-towards[:, None])
    if unknowns.held:
        shaft = slice(unknowns.shaft, unknowns.shaft + 2)
        bearings = bearings.at[:discs, :, shaft].set(-eye).at[discs, :, shaft].set(eye)
    return DriveRows(jnp.stack([-normal_x, -normal_y, at.ring.lever / design.output.circle_radius]), holes, bearings)


STEPS = 10  # from corner to corner
ROUNDING = 1e3  # of levers, in units of the last place
UNREAD = ("bearing_clearance", "support_clearance")
"""Errors that do not change the fit."""


class Lines(NamedTuple):
    """Gaps that change linearly with a rotation: gap - lever rotation; a row for each disc, (d, n)."""

    gap: jax.Array  # m
    lever: jax.Array  # m, > 0 and < 0 in every row


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


def largest_gap(pins: Lines, holes: Lines) -> tuple[jax.Array, jax.Array]:
    """Largest least gap over the rotations of all discs and of the carrier, and its distance from a lower bound; () m.

    Args:
        pins: gaps over the rotation of each disc.
        holes: gaps over the rotation of each disc against the carrier.
    """
    alone = [jax.vmap(highest)(*each) for each in (pins, holes)]
    bounds, left = (jnp.stack(each) for each in zip(*alone))  # (2, d)
    most = jnp.min(bounds)
    if pins.gap.shape[0] == 1:  # the carrier follows its one disc
        return most, jax.lax.stop_gradient(most) - jnp.min(jax.lax.stop_gradient(bounds) - left)
    still = jax.lax.stop_gradient((pins, holes))
    start = jax.lax.stop_gradient(most)

    def lower(_: int, s: jax.Array) -> jax.Array:
        room, root = _carrier(*still, s)
        return jnp.where(room < 0, jnp.minimum(root, s), s)

    s = fori_loop(0, STEPS, lower, start)
    crossing = jnp.where(s < start, _carrier(pins, holes, s)[1], most)
    return crossing, jax.lax.stop_gradient(crossing) - _least(*still, s)


def _ends(of: Lines, s: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rotations up to which each gap is at least s: forwards, and backwards with the sign changed; (d, n) rad.

    A pin on the line of centres has no lever but that of rounding, and bounds s alone.
    """
    over, least = of.gap - s, ROUNDING * jnp.finfo(s.dtype).eps * jnp.max(jnp.abs(of.lever))
    up, down = of.lever > least, of.lever < -least
    forwards = jnp.where(up, over / jnp.where(up, of.lever, 1), jnp.inf)
    return forwards, jnp.where(down, over / jnp.where(down, -of.lever, 1), jnp.inf)


def _carrier(pins: Lines, holes: Lines, s: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Interval of the carrier between all discs at s, () rad, and the s at which its bounds meet, () m."""
    (pin_up, pin_down), (hole_up, hole_down) = (_ends(jax.lax.stop_gradient(each), s) for each in (pins, holes))
    room, gaps, slopes = (jnp.zeros_like(s) for _ in range(3))
    for one, other in (((pin_up, pins), (hole_down, holes)), ((hole_up, holes), (pin_down, pins))):
        each = jnp.min(one[0], axis=1) + jnp.min(other[0], axis=1)
        k = jnp.argmin(each)  # the disc that bounds the carrier on this side
        room += each[k]
        for ends, of in (one, other):
            i = jnp.argmin(ends[k])
            size = jnp.abs(of.lever[k, i])
            gaps += of.gap[k, i] / size
            slopes += 1 / size
    return room, gaps / slopes


def _least(pins: Lines, holes: Lines, s: jax.Array) -> jax.Array:
    """Least gap with discs and carrier in the middle of what s leaves them, () m."""
    (hi, down), (far, back) = (tuple(jnp.min(end, axis=1) for end in _ends(each, s)) for each in (pins, holes))
    lo, near = -down, -back
    carrier = (jnp.max(lo - far) + jnp.min(hi - near)) / 2
    disc = (jnp.maximum(lo, carrier + near) + jnp.minimum(hi, carrier + far)) / 2
    return jnp.minimum(
        jnp.min(pins.gap - pins.lever * disc[:, None]), jnp.min(holes.gap - holes.lever * (disc - carrier)[:, None])
    )
