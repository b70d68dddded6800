"""Manufacturing errors of discs and ring as penetrations of the pins at the ideal position (docs/models/loaded.md)."""

import jax
import jax.numpy as jnp

from rvjax._reducer.flank import Ground, curvature, modified, profile
from rvjax.designs import CycloidStage
from rvjax.loaded.geometry import Geometry
from rvjax.records import PyTree, Scalar


def full(value: Scalar, shape: tuple[int, ...]) -> jax.Array:
    """An error in its full shape.

    Args:
        value: a number, or that shape.
        shape: of the array field.
    """
    return jnp.broadcast_to(value, shape)


def pin_depths(cycloid: CycloidStage, errors: PyTree, at: Geometry) -> jax.Array:
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
    offset = full(errors.pin_offset, (zp, 2))
    ring_x, ring_y = at.carrier.back.of(*full(errors.ring_centre, (2,)))
    centre = full(errors.disc_centre, (discs, 2))
    total = -play + shift * away + full(errors.pin_radii, (zp,))[None]
    total += -away * offset[:, 0][None] - aside * offset[:, 1][None]
    total += at.normal[0] * (ring_x - centre[:, :1]) + at.normal[1] * (ring_y - centre[:, 1:])
    if jnp.ndim(errors.disc_pitch):
        pitch = jnp.take_along_axis(full(errors.disc_pitch, (discs, zc)), at.tooth, axis=1, mode="clip")
    else:
        pitch = jnp.asarray(errors.disc_pitch)
    total += pitch * (zp / (zc * cycloid.pin_circle_radius)) * at.lever
    if cycloid.profile_modification is not None:
        total += profile(cycloid.profile_modification, at.lobe.cosine, at.lobe.sine)[0]
    if jnp.ndim(errors.disc_profile):
        waves = full(errors.disc_profile, (discs, 5, 2))
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
