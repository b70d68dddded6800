"""Line of pin centres round a disc, an epitrochoid, and the flank: its offset by the pin radius, with modifications."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.designs import CycloidStage
from rvjax.records import Scalar

STEEPEST = 0.005
"""Slope of a profile modification along the flank up to which the models, of first order in it, hold."""


def curvature(cosine: jax.Array, *, pins: int, shortening: jax.Array, pin_circle_radius: jax.Array) -> jax.Array:
    """Curvature of the line of pin centres at a lobe angle, > 0 convex, 1/m (docs/models/loaded.md, Eq. 7).

    Args:
        cosine: of the lobe angle psi; 1 is the tooth space.
        pins: zp.
        shortening: K1.
        pin_circle_radius: rp, m.
    """
    k1 = shortening
    size = jnp.sqrt(1 + k1 * k1 - 2 * k1 * cosine)
    return (1 + pins * k1 * k1 - k1 * (1 + pins) * cosine) / (pin_circle_radius * size**3)


def least_convex_radius(shortening: Scalar, *, pins: int) -> jax.Array:
    """Least radius of convex curvature of the line of pin centres, in pin circle radii.

    A pin of at least this radius cuts into the flank. With K1 from (zp - 2)/(2 zp - 1) on, the least radius is inside
    the flank, sqrt(27 (zp - 1)(1 - K1^2)/(zp + 1)^3); below, it is at the tip, (1 + K1)^2/(1 + zp K1).

    Args:
        shortening: K1, between 0 and 1.
        pins: zp.
    """
    k1 = jnp.asarray(shortening)
    inside = k1 >= (pins - 2) / (2 * pins - 1)
    left = jnp.where(inside, 1 - k1 * k1, 1)
    at_flank = math.sqrt(27 * (pins - 1) / (pins + 1) ** 3) * jnp.sqrt(jnp.where(left > 0, left, jnp.nan))
    return jnp.where(inside, at_flank, (1 + k1) ** 2 / (1 + pins * k1))


def relative_radius(pin_radius: jax.Array, bend: jax.Array) -> jax.Array:
    """Radius R* of a cylinder on a plane that touches as a pin touches the flank, m: 1/R* = 1/rr + kd.

    Args:
        pin_radius: rr, m.
        bend: curvature kd of the flank, 1/m.
    """
    return pin_radius / (1 + pin_radius * bend)


class Ground(NamedTuple):
    """Numbers by which a flank is ground: the modifications move the wheel, and harmonics change its flank."""

    shortening: jax.Array  # of the line of wheel centres
    circle: jax.Array  # its pin circle radius: rp + shift modification
    offset: jax.Array  # of the flank from it: rr + equidistant modification

    @classmethod
    def of(cls, cycloid: CycloidStage) -> "Ground":
        """The flank of a disc, harmonics not included.

        Args:
            cycloid: its numbers.
        """
        circle = jnp.asarray(cycloid.pin_circle_radius + cycloid.shift_modification)
        k1 = cycloid.shortening_coefficient * cycloid.pin_circle_radius / circle
        return cls(jnp.asarray(k1), circle, jnp.asarray(cycloid.pin_radius + cycloid.equidistant_modification))

    def least_convex(self, pins: int) -> jax.Array:
        """Least radius of its convex part, m; <= 0 is undercut."""
        return self.circle * least_convex_radius(self.shortening, pins=pins) - self.offset


def profile(amplitudes: Scalar, cosine: jax.Array, sine: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Material of the profile modification over the lobe angle, m, and its first two derivatives.

    Args:
        amplitudes: of cos(f psi), f = 1 .. 4, (4,) m.
        cosine: of the lobe angle.
        sine: of the lobe angle.
    """
    c, s = cosine, sine
    found = [jnp.zeros_like(c)] * 3
    for f, a in enumerate(jnp.broadcast_to(amplitudes, (4,)), start=1):
        found = [total + a * wave for total, wave in zip(found, (c, -f * s, -f * f * c))]
        c, s = cosine * c - sine * s, sine * c + cosine * s
    return found[0], found[1], found[2]


def steepest(cycloid: CycloidStage) -> float:
    """Largest slope of the harmonics of a profile modification along the flank; 0 without them, nan for an undercut.

    Args:
        cycloid: numbers, not traced.
    """
    ground = Ground.of(cycloid)
    if cycloid.profile_modification is None or not ground.least_convex(cycloid.pin_count) > 0:
        return 0.0 if cycloid.profile_modification is None else math.nan
    psi = np.linspace(0, np.pi, 1025)
    return float(jnp.max(jnp.abs(modified(ground, cycloid, jnp.asarray(np.cos(psi)), jnp.asarray(np.sin(psi)))[1])))


def modified(ground: Ground, cycloid: CycloidStage, cosine: jax.Array, sine: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Curvature of the flank with its harmonics, 1/m, > 0 convex, and the slope of the harmonics along it.

    Material m on a flank of curvature kd = kc/(1 - rr kc) and arc length s changes its curvature by -m kd^2 - m''
    (docs/models/loaded.md, Eq. 17a). Along the flank ds = sigma dpsi, sigma = rp S (1 - rr kc)/zc:
    m'' = (m_pp - m_p sigma_p/sigma)/sigma^2.

    Args:
        ground: flank without harmonics.
        cycloid: with its harmonics.
        cosine: of the lobe angle.
        sine: of the lobe angle.
    """
    k1, rp, rr = ground
    pins = cycloid.pin_count
    bend = curvature(cosine, pins=pins, shortening=k1, pin_circle_radius=rp)
    slack = 1 - rr * bend
    own = bend / slack
    if cycloid.profile_modification is None:
        return own, jnp.zeros_like(own)
    m, m_p, m_pp = profile(cycloid.profile_modification, cosine, sine)
    size = jnp.sqrt(1 + k1 * k1 - 2 * k1 * cosine)
    size_p = k1 * sine / size  # dS/dpsi
    bend_p = k1 * (1 + pins) * sine / (rp * size**3) - 3 * bend * size_p / size
    sigma = rp * size * slack / cycloid.disc_teeth
    sigma_p = rp * (size_p * slack - size * rr * bend_p) / cycloid.disc_teeth
    return own - m * own * own - (m_pp - m_p * sigma_p / sigma) / sigma**2, m_p / sigma
