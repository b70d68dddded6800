"""Geometry of discs and ring at one angle: places of the pins, errors as penetrations, least clearance without load.

The frame is that of the ideal carrier, without errors but the eccentricity. Forward is counter-clockwise, as the
output turns. Pin 0 and eccentric 0 lie on the x axis at input angle 0. Derivation and equations: docs/models/loaded.md.

For the clearance all discs turn together, each at its ideal place on the cranks. A turn by beta takes lever * beta from
the clearance of a pin. The largest least clearance over all beta is the highest point of a concave function of straight
lines: two pins, one on either side, or one on the line of centres, are equally close there.

Where parts turn separately, gaps are linear in rotations: every disc turns against the ring, and against the carrier
where it has holes. At a gap s, disc k may turn by [lo, hi] between its pins and by [lo', hi'] between its holes. The
carrier may turn by

    max (lo - hi') .. min (hi - lo')

The lengths of these intervals are concave falling functions of s, straight between corners. The tangent of each is zero
at an upper bound of the largest gap. The least of these bounds is the next s. A contact without lever bounds s itself.

Two contacts decide the interval of a disc, four that of the carrier. The gap is their mean, weighted by 1/|lever|.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import sin_cos
from rvjax._jax.kernels import BatchedKernel, along_lanes, folded, like, settle, while_loop
from rvjax.cycloidal import ReducerErrors
from rvjax.designs import CycloidStage, RVReducer
from rvjax.errors import RVErrors
from rvjax.flank import Ground, curvature, modified, profile
from rvjax.loaded.balance import in_blocks
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
    """Cosine and sine of `angle`, rad, stored: XLA copies them into their consumers, a seventh of a program."""
    sine, cosine = settle(jnp.stack(sin_cos(angle)))
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
    crank, carrier, middle = (Turn(*x) for x in zip(*turn(jnp.stack([-zp * th, th, zc * th / 2]))))
    places, pins = np.arange(discs) / discs, np.arange(zp) / zp
    eccentric = crank.plus(2 * np.pi * places)  # Eq. 2
    pin = carrier.back.plus(2 * np.pi * pins)
    # psi / 2 = (2 pi j / zp + zc th - 2 pi k / nd) / 2: its sine keeps what is near a tooth space exact
    half = middle.plus(np.pi * (pins[None] - places[:, None]))
    lobe = Turn(1 - 2 * half.sine * half.sine, 2 * half.sine * half.cosine)
    k1 = eccentricity * zp / cycloid.pin_circle_radius
    size = jnp.sqrt((1 - k1) ** 2 + 4 * k1 * half.sine * half.sine)  # Eq. 4
    laps = jnp.floor(jax.lax.stop_gradient(zc * th / (2 * np.pi)) + jnp.asarray(pins[None] - places[:, None], th.dtype))
    return Geometry(
        carrier=carrier,
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


STEPS = 12  # at most; 5 were the most of 60,000 random cases
ROUNDING = 1e3  # of levers, in units of the last place
_DECIDE = 4  # contacts


class Lines(NamedTuple):
    """Gaps that change linearly with a rotation: gap - lever rotation; a row for each disc, (d, n)."""

    gap: jax.Array  # m
    lever: jax.Array  # m, > 0 and < 0 in every row


class _Ends(NamedTuple):
    """Ends of rotations at a gap s, batch axis last."""

    turn: jax.Array  # how far the end is away, rad
    weight: jax.Array  # how much nearer it comes with s, rad/m
    contacts: jax.Array  # numbers of the contacts that decide it, (m, ..)

    def plus(self, other: "_Ends") -> "_Ends":
        """Ends of the sum of two rotations."""
        contacts = jnp.concatenate([*jnp.broadcast_arrays(self.contacts, other.contacts)])
        return _Ends(self.turn + other.turn, self.weight + other.weight, contacts)

    def nearest(self) -> "_Ends":
        """The nearest end along the first axis; of several, the first of those that come nearer fastest."""
        turn = folded(self.turn, 0, by=jnp.minimum)
        weight = folded(jnp.where(self.turn == turn[None], self.weight, 0), 0, by=jnp.maximum)
        rows = jnp.arange(len(self.turn), dtype=jnp.int32).reshape(-1, *[1] * turn.ndim)
        here = (self.turn == turn[None]) & (self.weight == weight[None])
        first = rows == folded(jnp.where(here, rows, len(rows)), 0, by=jnp.minimum)[None]
        return _Ends(turn, weight, jnp.sum(jnp.where(first[None], self.contacts, 0), axis=1, dtype=jnp.int32))


def largest_gap(*sets: Lines) -> tuple[jax.Array, jax.Array]:
    """Largest least gap over the rotations of all discs and of the carrier, and its distance from a lower bound; () m.

    Args:
        *sets: gaps of pins over the rotation of each disc; of holes over its rotation against the carrier, if any.
    """
    leaves = like(jax.lax.stop_gradient(jax.tree.leaves(sets)))
    deciding, left = _decided(*(leaf[None] for leaf in leaves))
    gap, lever = (jnp.concatenate([x.ravel() for x in each])[deciding[0]] for each in zip(*sets))
    weight = 1 / jnp.where(deciding[0, 0] == deciding[0, 1], 1, jnp.abs(lever))  # one alone bounds no rotation
    return jnp.sum(weight * gap) / jnp.sum(weight), left[0]


def _shapes(*leaves: jax.Array) -> tuple[jax.ShapeDtypeStruct, jax.ShapeDtypeStruct]:
    cases = max(leaf.shape[0] for leaf in leaves)
    return jax.ShapeDtypeStruct((cases, _DECIDE), jnp.int32), jax.ShapeDtypeStruct((cases,), leaves[0].dtype)


def _block(_: object, *leaves: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Numbers (4, l) of the contacts that decide, row by row, pins first; distance from a lower bound, (l,) m."""
    sets = [Lines(*pair) for pair in zip(leaves[::2], leaves[1::2])]
    sides, alone = _sides(sets)
    size = jnp.max(jnp.stack([jnp.max(jnp.abs(gap), axis=(0, 1)) for gap, _ in sets]), axis=0)
    fine = 8 * jnp.finfo(size.dtype).eps * size

    def ends(s: jax.Array) -> list[_Ends]:
        """Of every disc, on both sides between its pins and between its holes, (d, l)."""
        return [side._replace(turn=side.turn - s[None, None] * side.weight).nearest() for side in sides]

    def bound(s: jax.Array) -> _Ends:
        """The least upper bound of the largest gap, (l,) m, by the tangents at s."""
        up, down, *holes = ends(s)
        of_discs = [up.plus(down)] + ([holes[0].plus(holes[1])] if holes else [])
        rooms = [_Ends(*(x[..., k, :] for x in each)) for each in of_discs for k in range(len(up.turn))]
        if holes:
            rooms.append(up.plus(holes[1]).nearest().plus(holes[0].plus(down).nearest()))
        bounds = jnp.stack([s + room.turn / room.weight for room in rooms] + [one.turn for one in alone])
        contacts = [jnp.concatenate([x] * (_DECIDE // len(x))) for _, _, x in (*rooms, *alone)]
        return _Ends(bounds, jnp.zeros_like(bounds), jnp.stack(contacts, axis=1)).nearest()

    def lower(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        s, steps, _ = state
        new = bound(s).turn
        return new, steps + 1, (steps == 0) | jnp.any(new < s - fine)

    start = jnp.zeros_like(size), jnp.int32(0), jnp.bool_(True)
    s, _, _ = while_loop(lambda state: state[2] & (state[1] < STEPS), lower, start)
    found = bound(s)
    return found.contacts, found.turn - _least(sets, ends(found.turn))


def _sides(sets: list[Lines]) -> tuple[list[_Ends], list[_Ends]]:
    """Ends at no gap by both sides of every set, contacts first (n, d, l); gaps of contacts without lever, (l,) m."""
    sides, alone, first = [], [], 0
    for gap, lever in sets:
        discs, count, _ = gap.shape
        contacts = jnp.arange(first, first + discs * count, dtype=jnp.int32).reshape(1, discs, count, 1)
        least = ROUNDING * jnp.finfo(gap.dtype).eps * jnp.max(jnp.abs(lever), axis=(0, 1), keepdims=True)
        for ahead in (lever, -lever):
            weight = jnp.where(ahead > least, 1 / jnp.where(ahead > least, ahead, 1), 0)
            turn = jnp.where(ahead > least, gap * weight, jnp.inf)
            sides.append(_Ends(*(x.swapaxes(-3, -2) for x in (turn, weight, contacts))))
        own = jnp.where(jnp.abs(lever) > least, jnp.inf, gap).reshape(discs * count, -1)
        alone.append(_Ends(own, jnp.zeros_like(own), contacts.reshape(1, -1, 1)).nearest())
        first += discs * count
    return sides, alone


def _least(sets: list[Lines], ends: list[_Ends]) -> jax.Array:
    """Least gap with discs and carrier in the middle of what is left to them, (l,) m."""
    hi, lo, *holes = (end.turn * sign for end, sign in zip(ends, (1, -1, 1, -1)))
    if holes:
        far, near = holes
        carrier = (folded(lo - far, 0, by=jnp.maximum) + folded(hi - near, 0, by=jnp.minimum))[None] / 2
        disc = (jnp.maximum(lo, carrier + near) + jnp.minimum(hi, carrier + far)) / 2
        turns = [disc, disc - carrier]
    else:
        turns = [(hi + lo) / 2]
    gaps = [of.gap - of.lever * turn[:, None] for of, turn in zip(sets, turns)]
    return jnp.min(jnp.stack([folded(gap, 0, 1, by=jnp.minimum) for gap in gaps]), axis=0)


_decided = along_lanes(BatchedKernel(lambda *leaves: in_blocks(_block, ((), *leaves)), _shapes))
"""The same of a batch, cases first."""
