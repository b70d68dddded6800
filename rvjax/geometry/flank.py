"""Line of pin centres round a disc: an epitrochoid; the flank is its offset by the pin radius."""

import math

import jax
import jax.numpy as jnp

from rvjax.records import Scalar


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
    """Radius R* of a cylinder on a plane that touches as a pin touches the flank, m: 1/R* = 1/rr + kc/(1 - rr kc).

    Args:
        pin_radius: rr, m.
        bend: curvature kc of the line of pin centres, 1/m.
    """
    return pin_radius * (1 - bend * pin_radius)
