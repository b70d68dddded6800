"""Geometry of discs and ring at one angle: places of the pins, errors as penetrations, least clearance without load.

The frame is that of the ideal carrier, without errors but the eccentricity. Forward is counter-clockwise, as the
output turns. Pin 0 and eccentric 0 lie on the x axis at input angle 0. Derivation and equations: docs/models/loaded.md.

For the clearance all discs turn together, each at its ideal place on the cranks. A turn by beta takes lever * beta from
the clearance of a pin. The largest least clearance over all beta is the highest point of a concave function of straight
lines: two pins, one on either side, or one on the line of centres, are equally close there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import sin_cos
from rvjax.cycloidal import ReducerErrors
from rvjax.designs import CycloidStage, RVReducer
from rvjax.errors import RVErrors
from rvjax.flank import Ground, curvature, modified, profile
from rvjax.loaded.largest_gap import STEPS, Lines, largest_gap
from rvjax.records import promote
from rvjax.status import SolveInfo, Status, admit, converged


class Turn(NamedTuple):
    """Cosine and sine of an angle."""

    cosine: jax.Array
    sine: jax.Array

    def plus(self, angle: np.ndarray) -> "Turn":
        """The angle and a constant one."""
        c, s = (jnp.asarray(x, self.cosine.dtype) for x in (np.cos(angle), np.sin(angle)))
        return Turn(self.cosine * c - self.sine * s, self.sine * c + self.cosine * s)

    def of(self, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The vector (x, y) turned by the angle."""
        return self.cosine * x - self.sine * y, self.sine * x + self.cosine * y

    @property
    def back(self) -> "Turn":
        """The opposite angle."""
        return Turn(self.cosine, -self.sine)


def turn(angle: jax.Array) -> Turn:
    """Cosine and sine of `angle`, () rad."""
    sine, cosine = sin_cos(angle)
    return Turn(cosine, sine)


class Geometry(NamedTuple):
    """Directions at one angle; d discs, p pins."""

    carrier: Turn  # th, (): from the housing to the ideal carrier
    crank: Turn  # -zp th, ()
    eccentric: Turn  # b_k, (d,)
    pin: Turn  # g_j, (p,)
    lobe: Turn  # psi_kj, (d, p)
    size: jax.Array  # S, (d, p)
    shortening: jax.Array  # K1, ()
    lever: jax.Array  # e zc sin(psi) / S, (d, p) m
    normal: tuple[jax.Array, ...]  # n, x and y (d, p): from the pin centre into the disc
    tooth: jax.Array  # tooth of disc k that pin j meets, (d, p) integer


def geometry(cycloid: CycloidStage, eccentricity: jax.Array, th: jax.Array) -> Geometry:
    """Directions and levers at an angle of the carrier against the ring.

    Args:
        cycloid: counts and pin circle radius are read.
        eccentricity: e, nominal and error, () m.
        th: () rad.
    """
    zc, zp, discs = cycloid.disc_teeth, cycloid.pin_count, cycloid.disc_count
    crank = turn(-zp * th)
    places, pins = np.arange(discs) / discs, np.arange(zp) / zp
    eccentric = crank.plus(2 * np.pi * places)  # Eq. 2
    pin = turn(-th).plus(2 * np.pi * pins)
    # psi / 2 = (2 pi j / zp + zc th - 2 pi k / nd) / 2: its sine keeps what is near a tooth space exact
    half = turn(zc * th / 2).plus(np.pi * (pins[None] - places[:, None]))
    lobe = Turn(1 - 2 * half.sine * half.sine, 2 * half.sine * half.cosine)
    k1 = eccentricity * zp / cycloid.pin_circle_radius
    size = jnp.sqrt((1 - k1) ** 2 + 4 * k1 * half.sine * half.sine)  # Eq. 4
    laps = jnp.floor(jax.lax.stop_gradient(zc * th / (2 * np.pi)) + jnp.asarray(pins[None] - places[:, None], th.dtype))
    return Geometry(
        carrier=turn(th),
        crank=crank,
        eccentric=eccentric,
        pin=pin,
        lobe=lobe,
        size=size,
        shortening=k1,
        lever=eccentricity * zc * lobe.sine / size,  # Eq. 5
        normal=tuple(
            (k1 * b[:, None] - g[None]) / size for b, g in ((eccentric.cosine, pin.cosine), (eccentric.sine, pin.sine))
        ),
        tooth=jnp.mod(jnp.arange(zp, dtype=jnp.int32)[None] - laps.astype(jnp.int32), zc),  # Eq. 6
    )


def pin_depths(cycloid: CycloidStage, errors: ReducerErrors, at: Geometry) -> jax.Array:
    """Depth of every pin in its disc at the ideal position, (d, p) m: Eq. 13, term by term.

    Args:
        cycloid: counts, pin circle radius and modifications are read.
        errors: array fields in full shape or scalars.
        at: geometry of the angle.
    """
    zc, zp, discs = cycloid.disc_teeth, cycloid.pin_count, cycloid.disc_count
    equidistant = cycloid.equidistant_modification + errors.equidistant_modification
    play = equidistant - errors.pin_radius + errors.pin_hole_clearance / 2
    shift = cycloid.shift_modification + errors.shift_modification - errors.pin_circle_radius
    away = (1 - at.shortening * at.lobe.cosine) / at.size  # -n . u(g_j)
    aside = at.shortening * at.lobe.sine / at.size  # -n . J u(g_j)
    offset = jnp.broadcast_to(errors.pin_offset, (zp, 2))
    ring_x, ring_y = at.carrier.back.of(*jnp.broadcast_to(errors.ring_centre, (2,)))
    centre = jnp.broadcast_to(errors.disc_centre, (discs, 2))
    total = -play + shift * away + jnp.broadcast_to(errors.pin_radii, (zp,))[None]
    total += -away * offset[:, 0][None] - aside * offset[:, 1][None]
    total += at.normal[0] * (ring_x - centre[:, :1]) + at.normal[1] * (ring_y - centre[:, 1:])
    if jnp.ndim(errors.disc_pitch):
        pitch = jnp.take_along_axis(jnp.broadcast_to(errors.disc_pitch, (discs, zc)), at.tooth, axis=1, mode="clip")
    else:
        pitch = jnp.asarray(errors.disc_pitch)
    total += pitch * (zp / (zc * cycloid.pin_circle_radius)) * at.lever
    if cycloid.profile_modification is not None:
        total += profile(cycloid.profile_modification, at.lobe.cosine, at.lobe.sine)[0]
    if jnp.ndim(errors.disc_profile):
        waves = jnp.broadcast_to(errors.disc_profile, (discs, 5, 2))
        cosine, sine = jnp.ones_like(at.size), jnp.zeros_like(at.size)
        for f in range(5):
            total += waves[:, f, :1] * cosine + waves[:, f, 1:] * sine
            cosine, sine = at.lobe.of(cosine, sine)
    else:
        cosine, sine = jnp.ones_like(at.size), jnp.zeros_like(at.size)
        for _ in range(5):
            total += errors.disc_profile * (cosine + sine)
            cosine, sine = at.lobe.of(cosine, sine)
    return jnp.asarray(total)


def flank_rounding(cycloid: CycloidStage, at: Geometry) -> jax.Array:
    """rr^2 / R* of a pin and the flank, m, R* = rr (1 - rr kc), with the curvature of the profile modification (17a).

    Args:
        cycloid: its numbers.
        at: geometry of the angle.
    """
    rr, rp = jnp.asarray(cycloid.pin_radius), jnp.asarray(cycloid.pin_circle_radius)
    if cycloid.profile_modification is None:
        bend = curvature(at.lobe.cosine, pins=cycloid.pin_count, shortening=at.shortening, pin_circle_radius=rp)
        return rr / (1 - rr * bend)
    bend, _ = modified(Ground(at.shortening, rp, rr), cycloid, at.lobe.cosine, at.lobe.sine)
    return rr + rr * rr * bend


READ = (
    "eccentricity", "pin_circle_radius", "pin_radius", "pin_hole_clearance", "equidistant_modification",
    "shift_modification", "pin_offset", "pin_radii", "ring_centre", "disc_centre", "disc_pitch", "disc_profile",
)  # fmt: skip
"""Errors that Eq. 13 reads."""


def no_orders(design: RVReducer) -> tuple[int, ...]:
    """None: the pins of a ring pass zc zp times in a turn of the output, beyond the orders of a bench.

    Args:
        design: not read.
    """
    return ()


def flanks(
    samples: int, turns: float, design: RVReducer, errors: RVErrors
) -> tuple[tuple[jax.Array, jax.Array], SolveInfo]:
    """Least clearance of any pin along a turn, (), and at each input angle, (n,) m.

    Args:
        samples: n.
        turns: of the output.
        design: involute teeth and cycloid stage are read.
        errors: of pins, ring and discs.
    """
    used = RVErrors(**{name: getattr(errors, name) for name in READ})
    read = promote((design.cycloid.replace(force_angle=0.0, disc_phase=0.0), used))
    cycloid = read[0]
    k1 = cycloid.shortening_coefficient
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    e = cycloid.eccentricity + read[1].eccentricity
    short = e * cycloid.pin_count / cycloid.pin_circle_radius
    positive = jnp.stack([jnp.asarray(x) for x in (k1, short, cycloid.pin_circle_radius, cycloid.pin_radius)])
    possible = jnp.all(positive > 0) & (k1 < 1) & (short < 1)
    harmless = jax.tree.map(jnp.zeros_like, read[1])
    spare = jax.tree.map(jnp.zeros_like, cycloid).replace(
        eccentricity=0.5 / cycloid.pin_count,
        pin_circle_radius=1.0,
        pin_radius=1e-6,
        shortening=None if cycloid.shortening is None else 0.5,
    )
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (cycloid, used), gate = admit(read, (spare, harmless), *checks)
    sharp = Ground.of(cycloid).least_convex(cycloid.pin_count) <= 0
    step = 2 * np.pi * design.ratio * turns / samples

    def at(j: jax.Array) -> tuple[jax.Array, jax.Array]:
        there = geometry(cycloid, cycloid.eccentricity + used.eccentricity, step * j / design.ratio)
        return largest_gap(Lines(-pin_depths(cycloid, used, there).reshape(1, -1), there.lever.reshape(1, -1)))

    least, left = jax.lax.map(at, jnp.arange(samples, dtype=k1.dtype))  # an angle of a batch stays in the cache
    return gate.close((jnp.min(least), least), (sharp, Status.UNDERCUT), info=converged(jnp.max(left), STEPS))
