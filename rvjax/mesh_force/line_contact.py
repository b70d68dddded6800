"""Line contact of a roller with a cam, a plane or a hollow flank: approach, its limit, its pressure.

Everything is dimensionless. The roller has radius r, the other body curvature k (> 0 hollow); the
relative radius of the contact is lambda = r m with m = 1 / (1 - r k), the half-width is
b = r sqrt(m v), and v is the load in units of pi l r / (4 C), the load that would make b = r on a plane.
C = 2 (1 - nu^2) / E for two bodies of one material, l is the length.

Source: Wei et al. 2021, Chin. J. Mech. Eng. 34:84, Eqs. 9-12: each body yields by the depth (sagitta) of
the flat of half-width b. Written with 1 - sqrt(1 - x) = x / (1 + sqrt(1 - x)) nothing cancels, not even
in float32, and m holds for convex, flat and hollow bodies alike.
"""

import itertools

import jax
import jax.numpy as jnp

from rvjax.records import PyTree, Scalar

NEAR = 0.025
"""Square of a half-width over a radius up to which the series of the approach is good to rounding."""

# 1/2, 1/8, 1/16, ..; the first neglected one adds 0.018 NEAR^9 < 7e-17 of the sum
_RISE = list(itertools.accumulate(range(1, 9), lambda c, j: c * (2 * j - 1) / (2 * j + 2), initial=0.5))


def compliance(young_modulus: Scalar, poisson_ratio: Scalar) -> PyTree:
    """C of two bodies of one material, 1/Pa (Eq. 9).

    Args:
        young_modulus: Pa.
        poisson_ratio: of both bodies.
    """
    return 2 * (1 - poisson_ratio**2) / young_modulus


def load_unit(young_modulus: Scalar, poisson_ratio: Scalar, length: Scalar, radius: Scalar) -> PyTree:
    """Load that would make the half-width equal to the roller radius on a plane, N.

    Args:
        young_modulus: Pa.
        poisson_ratio: of both bodies.
        length: of the contact, m.
        radius: of the roller, m.
    """
    return jnp.pi * length * radius / (4 * compliance(young_modulus, poisson_ratio))


def sagitta(square: jax.Array) -> jax.Array:
    """1 - sqrt(1 - square): the approach on a plane (m = 1) under the load v = square (Eq. 12).

    Args:
        square: of a half-width over a radius, 0 to 1.
    """
    return square / (1 + jnp.sqrt(1 - square))


def sagitta_slope(square: jax.Array) -> jax.Array:
    """Derivative of `sagitta`.

    Args:
        square: as in `sagitta`.
    """
    return 0.5 / jnp.sqrt(1 - square)


def approach(load: jax.Array, relative_radius: jax.Array) -> jax.Array:
    """Approach of the two bodies in roller radii, load / 2 for small loads (Eq. 11).

    Args:
        load: v >= 0, smaller than `load_limit`.
        relative_radius: m > 0 of the contact.
    """
    v, m = load, relative_radius
    return sagitta(m * v) + (1 - m) * v / (1 + jnp.sqrt(1 - (1 - m) ** 2 / m * v))


def approach_slope(load: jax.Array, relative_radius: jax.Array) -> jax.Array:
    """Derivative of `approach` to the load.

    Args:
        load: v, as in `approach`.
        relative_radius: m, as in `approach`.
    """
    v, m = load, relative_radius
    return m * sagitta_slope(m * v) + (1 - m) * sagitta_slope((1 - m) ** 2 / m * v)


def hollow(relative_radius: Scalar) -> PyTree:
    """Square of the half-width over the radius of the other body, for a load of 1: (1 - m)^2 / m.

    Args:
        relative_radius: m, as in `approach`.
    """
    return (1 - relative_radius) ** 2 / relative_radius


def approach_near(load: jax.Array, relative_radius: jax.Array, other: jax.Array | None = None) -> jax.Array:
    """`approach` without roots; right while the squares of its half-width over both radii are up to `NEAR`.

    Args:
        load: v, as in `approach`.
        relative_radius: m, as in `approach`.
        other: `hollow`, if it is known.
    """
    v, m = load, relative_radius
    other = hollow(m) if other is None else other
    return v * (m * _rise(m * v) + (1 - m) * _rise(other * v))


def _rise(square: jax.Array) -> jax.Array:
    """`sagitta` over its argument by power series, to rounding up to `NEAR`."""
    total = jnp.full_like(square, _RISE[-1])
    for coefficient in _RISE[-2::-1]:
        total = total * square + coefficient
    return total


def load_limit(relative_radius: jax.Array) -> jax.Array:
    """Load at which the half-width reaches the radius of one of the bodies.

    Args:
        relative_radius: m, as in `approach`.
    """
    m = relative_radius
    return 1 / jnp.maximum(m, (1 - m) ** 2 / m)


def approach_series(relative_radius: Scalar, other: jax.Array | None = None) -> tuple[PyTree, PyTree]:
    """Coefficients of v^2 and v^3 in the power series of `approach`.

    Args:
        relative_radius: m, as in `approach`; 1.0 for a plane.
        other: `hollow`, if it is known.
    """
    m = relative_radius
    other = hollow(m) if other is None else other
    return (m**2 + (1 - m) * other) / 8, (m**3 + (1 - m) * other**2) / 16


def pressure(
    force: jax.Array, young_modulus: Scalar, poisson_ratio: Scalar, length: Scalar, relative_radius: Scalar
) -> jax.Array:
    """Largest contact pressure of a Hertzian line contact, Pa; its derivative at zero force is set to zero.

    Args:
        force: >= 0, N.
        young_modulus: Pa.
        poisson_ratio: of both bodies.
        length: of the contact, m.
        relative_radius: lambda, m.
    """
    square = force / (jnp.pi * length * relative_radius * compliance(young_modulus, poisson_ratio))
    loaded = square > 0
    return jnp.where(loaded, jnp.sqrt(jnp.where(loaded, square, 1)), 0)
