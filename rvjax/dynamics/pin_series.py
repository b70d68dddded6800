"""Errors of the pins as a series over the turning eccentric: each pin counts by the share of the load that it carries.

With chi the angle of a pin before the eccentric, the pins with sin chi < 0 carry the torque of a loaded reducer. Their
normal n = (K1 - cos chi, -sin chi) / S gives the share of each, and the displacement of its contact.
"""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial.legendre import leggauss

from rvjax.dynamics.assembly import Lumped, circle

NODES = 256  # of the quadrature, and one more for each harmonic: K1 = 0.99 to 1e-9, K1 <= 0.95 to rounding


def in_phase(highest: int, members: int) -> list[int]:
    """Harmonics 1 .. highest that all members meet at the same time: multiples of their number."""
    return list(range(members, highest + 1, members))


def series(
    lumped: Lumped, shortening: jax.Array, harmonics: np.ndarray, offset: jax.Array, radii: jax.Array
) -> jax.Array:
    """Phasors (harmonics,) of the disc-pin mesh at orders m disc_teeth, Eqs. 10 and 11; harmonic 0 is the constant.

    Args:
        lumped: counts, force angle and disc phase are read.
        shortening: K1, (), between 0 and 1.
        harmonics: m, each zero or a multiple of the discs.
        offset: of the pins, (pins, 2) or () m.
        radii: of the pins, (pins,) or () m.
    """
    pins = lumped.disc_teeth + 1
    nodes, weights = leggauss(NODES + int(harmonics.max()))
    chi = np.pi * (1.5 + nodes / 2)
    cosine, sine = (jnp.asarray(f(chi), shortening.dtype) for f in (np.cos, np.sin))
    size = jnp.sqrt(1 + shortening * shortening - 2 * shortening * cosine)
    normal = -sine / size
    weight = jnp.asarray(weights / 4, shortening.dtype)  # (1/2 pi) integral over (pi, 2 pi)
    share = jnp.cos(lumped.force_angle) * normal / (pins * jnp.sum(weight * normal * normal))  # Eq. 10
    seen = jnp.stack([(shortening * cosine - 1) / size, shortening * normal, jnp.ones_like(size)])
    turn = np.exp(-1j * np.outer(chi, harmonics))
    real, imaginary = (
        jnp.matmul(seen * (share * weight)[None, :], jnp.asarray(part, share.dtype)) for part in (turn.real, turn.imag)
    )

    c, s = circle(pins)
    places = np.outer(harmonics, np.arange(pins)) % pins
    sign = np.where(harmonics % 2, -1.0, 1.0)  # pin 0 lies at pi
    waves = sign[:, None] * (c[places] + 1j * s[places])
    sums = jnp.stack([_sum(x, waves) for x in (*_components(offset), radii)])
    phase = jnp.asarray(-harmonics, share.dtype) * lumped.disc_phase
    factor = jnp.asarray(np.where(harmonics == 0, 1.0, 2.0), phase.dtype)
    turned = jax.lax.complex(factor * jnp.cos(phase), factor * jnp.sin(phase))
    return turned * jnp.sum(jax.lax.complex(real, imaginary) * sums, axis=0)  # Eq. 11


def _components(offset: jax.Array) -> tuple[jax.Array, jax.Array]:
    return (offset, offset) if jnp.ndim(offset) == 0 else (offset[:, 0], offset[:, 1])


def _sum(values: jax.Array, waves: np.ndarray) -> jax.Array:
    """sum_p x_p e^{i m a_p} (harmonics,); pins alike leave multiples of their number."""
    if jnp.ndim(values) == 0:
        exact = np.round(waves.sum(axis=1).real)
        return jax.lax.complex(values * jnp.asarray(exact, values.dtype), jnp.zeros(len(exact), values.dtype))
    return jax.lax.complex(*(jnp.asarray(part, values.dtype) @ values for part in (waves.real, waves.imag)))
