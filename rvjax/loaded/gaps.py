"""Manufacturing errors as penetrations of the contacts at the ideal position, m (docs/models/loaded.md, Eqs. 13-16)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._reducer.flank import Ground, curvature, modified, profile
from rvjax.designs import CycloidStage, RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.geometry import Geometry
from rvjax.loaded.system import directions
from rvjax.records import Scalar


class Gaps(NamedTuple):
    """Depths and bearing displacements where every part sits at its ideal position."""

    pins: jax.Array  # (d, p)
    gear: jax.Array  # (c, 2)
    arm: jax.Array  # (d, c, 2)
    seat: jax.Array  # (c, 2)


def gaps(design: RVReducer, errors: RVErrors, at: Geometry, eccentricity: Scalar, flank: jax.Array) -> Gaps:
    """All gaps of one angle.

    Args:
        design: modifications and radii of the cycloid stage are read.
        errors: array fields in full shape or scalars.
        at: geometry of the angle.
        eccentricity: nominal and error, () m.
        flank: directions of the gear flanks (c, 2, 2).
    """
    return Gaps(
        pins=pin_depths(design, errors, at),
        gear=_gear(design, errors, at, flank),
        arm=_arm(design, errors, at, eccentricity),
        seat=-_placed(_full(errors.carrier_bore, (design.cranks.count, 2)), design.cranks.count),
    )


def _full(value: Scalar, shape: tuple[int, ...]) -> jax.Array:
    return jnp.broadcast_to(value, shape)


def _placed(bore: jax.Array, cranks: int) -> jax.Array:
    """[radial, tangential] at each crank (..., c, 2) as x, y."""
    radial, tangential = (
        jnp.asarray(x, bore.dtype).reshape((1,) * (bore.ndim - 2) + (cranks, 2)) for x in directions(cranks)
    )
    return bore[..., :1] * radial + bore[..., 1:] * tangential


def pin_depths(design: RVReducer, errors: RVErrors, at: Geometry) -> jax.Array:
    """Depth of every pin in its disc at the ideal position, (d, p) m: Eq. 13, term by term.

    Args:
        design: modifications of the cycloid stage are read.
        errors: array fields in full shape or scalars.
        at: geometry of the angle.
    """
    cycloid = design.cycloid
    zc, zp, discs = cycloid.disc_teeth, cycloid.pin_count, cycloid.disc_count
    equidistant = cycloid.equidistant_modification + errors.equidistant_modification
    play = equidistant - errors.pin_radius + errors.pin_hole_clearance / 2
    shift = cycloid.shift_modification + errors.shift_modification - errors.pin_circle_radius
    away = (1 - at.shortening * at.lobe.cosine) / at.size  # -n . u(g_j)
    aside = at.shortening * at.lobe.sine / at.size  # -n . J u(g_j)
    offset = _full(errors.pin_offset, (zp, 2))
    ring_x, ring_y = at.carrier.back.of(*_full(errors.ring_centre, (2,)))
    centre = _full(errors.disc_centre, (discs, 2))
    total = -play + shift * away + _full(errors.pin_radii, (zp,))[None]
    total += -away * offset[:, 0][None] - aside * offset[:, 1][None]
    total += at.normal[0] * (ring_x - centre[:, :1]) + at.normal[1] * (ring_y - centre[:, 1:])
    if jnp.ndim(errors.disc_pitch):
        pitch = jnp.take_along_axis(_full(errors.disc_pitch, (discs, zc)), at.tooth, axis=1, mode="clip")
    else:
        pitch = jnp.asarray(errors.disc_pitch)
    total += pitch * (zp / (zc * cycloid.pin_circle_radius)) * at.lever
    if cycloid.profile_modification is not None:
        total += profile(cycloid.profile_modification, at.lobe.cosine, at.lobe.sine)[0]
    if jnp.ndim(errors.disc_profile):
        waves = _full(errors.disc_profile, (discs, 5, 2))
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


def _gear(design: RVReducer, errors: RVErrors, at: Geometry, flank: jax.Array) -> jax.Array:
    """Eq. 14: half the backlash on either flank, and the runouts, which turn with their parts."""
    cranks = design.cranks.count
    thinner = (errors.base_tangent_upper + errors.base_tangent_lower) / 4
    sun_x, sun_y = at.sun.of(*_full(errors.sun_runout, (2,)))
    planet = _placed(_full(errors.planet_runout, (cranks, 2)), cranks)
    planet_x, planet_y = at.crank.of(planet[:, 0], planet[:, 1])
    return jnp.asarray(
        thinner + flank[:, :, 0] * (sun_x - planet_x)[:, None] + flank[:, :, 1] * (sun_y - planet_y)[:, None]
    )


def _arm(design: RVReducer, errors: RVErrors, at: Geometry, eccentricity: Scalar) -> jax.Array:
    """Eq. 15: bore of the disc less the journal that the crank carries there, x, y."""
    discs, cranks = design.cycloid.disc_count, design.cranks.count
    bore = _placed(_full(errors.disc_bore, (discs, cranks, 2)), cranks)
    longer = _full(errors.crank_eccentricity, (discs, cranks))
    ahead = jnp.asarray(eccentricity * _full(errors.crank_phase, (cranks,))[None])
    bx, by = at.eccentric.cosine[:, None], at.eccentric.sine[:, None]
    return bore - jnp.stack([longer * bx - ahead * by, longer * by + ahead * bx], axis=-1)
