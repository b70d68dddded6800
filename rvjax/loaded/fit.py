"""Least clearance between flanks and pins at an angle, without load.

All discs turn together, each at its ideal place on the cranks. A turn by beta takes lever * beta from the clearance of
a pin. The largest least clearance over all beta is the highest point of a concave function of straight lines: two pins,
one on either side, or one on the line of centres, are equally close there.
"""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.flank import Ground
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.gaps import pin_depths
from rvjax.loaded.geometry import geometry
from rvjax.records import Scalar, promote
from rvjax.status import SolveInfo, Status, admit, converged

STEPS = 8  # from corner to corner; 6 were the most of 40,000 random cases
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
        return highest(-pin_depths(cycloid, used, there).ravel(), there.lever.ravel())

    found, left = jax.lax.map(at, jnp.arange(samples, dtype=k1.dtype))  # an angle of a batch stays in the cache
    return gate.close((jnp.min(found), found), (sharp, Status.UNDERCUT), info=converged(jnp.max(left), STEPS))


def highest(gap: Scalar, lever: Scalar) -> tuple[jax.Array, jax.Array]:
    """Largest over beta of the least gap - lever * beta, and the distance of a lower bound from it; () m.

    The corner of two lines of opposite slope is an upper bound; the lowest line there replaces the one of its sign.

    Args:
        gap: (n,) m.
        lever: (n,) m, some > 0 and some < 0.
    """
    gap, lever = jnp.asarray(gap), jnp.asarray(lever)
    gaps, levers = (jax.lax.stop_gradient(x) for x in (gap, lever))
    falling, rising = jnp.argmax(levers), jnp.argmin(levers)

    def place() -> jax.Array:
        return (gaps[falling] - gaps[rising]) / (levers[falling] - levers[rising])

    for _ in range(STEPS):
        low = jnp.argmin(gaps - levers * place())
        falling, rising = jnp.where(levers[low] >= 0, low, falling), jnp.where(levers[low] < 0, low, rising)
    across = lever[falling] - lever[rising]
    value = (lever[falling] * gap[rising] - lever[rising] * gap[falling]) / across
    return value, jax.lax.stop_gradient(value) - jnp.min(gaps - levers * place())
