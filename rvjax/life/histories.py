"""Damage of one bearing by a history of loads: `basic` by their size, `raceway` point by point.

A damage of 1 is that of a million revolutions at the rating. It is finite and 0 without load; lives are inverted last.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax._jax.elementary import power
from rvjax.life.ratings import Ratings

METHODS = ("basic", "raceway", "slices")
LIFE, WEIBULL = 10 / 3, 9 / 8  # exponent of life (Eq. 6); slope of a system (Eqs. 8, 15, 24)

_RING = 32  # points of a ring; Eq. 8 to 1e-7; halves of them fill the vectors of a processor


def mean_cosine(m: float) -> float:
    """Mean of cos+^m over a turn. Eq. 9."""
    return math.gamma((m + 1) / 2) / (2 * math.sqrt(math.pi) * math.gamma(m / 2 + 1))


J4, J45 = mean_cosine(40 / 9) ** (1 / 4), mean_cosine(5.0) ** (2 / 9)  # moving load; stationary load


def _power_coefficients() -> list[float]:
    """Coefficients of c^2, c^3 .. in a polynomial for c^(40/9), 0 <= c <= 1, within 5e-9; faster than powers."""
    c = (1 - np.cos(np.pi * (np.arange(1000) + 0.5) / 1000)) / 2
    columns = np.polynomial.chebyshev.chebvander(2 * c - 1, 12) * (c * c)[:, None]
    found = np.linalg.lstsq(columns, c ** (40 / 9), rcond=None)[0]
    series = np.polynomial.Chebyshev(found, domain=[0, 1])
    return [float(x) for x in series.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef]


_POWER = _power_coefficients()


def _passed(cosine: jax.Array) -> jax.Array:
    """c^(40/9) of cosines from 0 to 1."""
    total = jnp.zeros_like(cosine)
    for coefficient in reversed(_POWER):
        total = total * cosine + coefficient
    return total * cosine * cosine


class Damage(NamedTuple):
    """By one history."""

    load: jax.Array  # P, equivalent load, () N
    rate: jax.Array  # 1e6 / life in revolutions, ()


def magnitude(force: jax.Array) -> jax.Array:
    """Size of forces (..., 2), with derivative 0 at 0.

    Args:
        force: (..., 2) N.
    """
    largest = scale(force)
    square = jnp.sum((force / largest) ** 2, axis=-1)
    return largest * jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def scale(force: jax.Array) -> jax.Array:
    """Largest component of all forces, without derivative; 1 where all are 0.

    Args:
        force: any shape.
    """
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(force)))
    return jnp.where(largest > 0, largest, 1)


def by_load(load: jax.Array, ratings: Ratings) -> Damage:
    """Damage of a million revolutions under an equivalent load. Eq. 6.

    Args:
        load: () N.
        ratings: of the bearing.
    """
    return Damage(load, power(load / ratings.dynamic, LIFE))


def basic(size: jax.Array, weight: jax.Array, ratings: Ratings) -> Damage:
    """Power mean of the loads over the revolutions. Eq. 7.

    Args:
        size: of the loads, (n,) N.
        weight: shares of the revolutions, (n,).
        ratings: of the bearing.
    """
    largest = scale(size)
    return by_load(largest * power(jnp.sum(weight * power(size / largest, LIFE)), 1 / LIFE), ratings)


def raceway(force: jax.Array, angle: jax.Array, weight: jax.Array, ratings: Ratings) -> Damage:
    """Damage point by point of both rings, no clearance. Eqs. 8-10.

    Args:
        force: (n, 2) N, in the frame of the outer ring.
        angle: of the inner ring against the outer one, (n,) rad.
        weight: shares of the revolutions, (n,).
        ratings: of the bearing.
    """
    largest = scale(force)
    force = force / largest
    size = magnitude(force)
    x = power(J45 * ratings.inner / (J4 * ratings.outer), 4.5)

    half = points(_RING, force.dtype)[:, : _RING // 2]  # a force loads each of these points, or the one opposite

    direction = force / jnp.where(size > 0, size, 1)[:, None]
    share = (weight * size**4)[:, None]

    def ring(direction: jax.Array) -> jax.Array:
        """E^(9/2) of a ring."""
        cosine = (
            direction[:, :1] * half[:1] + direction[:, 1:] * half[1:]
        )  # (n, points); products of matrices are slower
        passed = share * _passed(jnp.abs(cosine))  # (F.u)^(40/9) |F|^(-4/9)
        near = jnp.where(cosine > 0, passed, 0)
        damage = jnp.concatenate([jnp.sum(near, axis=0), jnp.sum(passed - near, axis=0)])
        return jnp.mean(power(damage, WEIBULL))

    inner, outer = ring(turned_back(direction, angle)) / J4**4.5, ring(direction) / J45**4.5
    return by_load(largest * power((inner + x * outer) / (1 + x), 2 / 9), ratings)


def points(number: int, dtype: DTypeLike) -> jax.Array:
    """Unit vectors to points of a ring, (2, number).

    Args:
        number: of points.
        dtype: of the result.
    """
    angle = 2 * np.pi * np.arange(number) / number
    return jnp.asarray(np.stack([np.cos(angle), np.sin(angle)]), dtype)


def turned_back(force: jax.Array, angle: jax.Array) -> jax.Array:
    """Forces in the frame of the inner ring.

    Args:
        force: (n, 2) N, in the frame of the outer ring.
        angle: of the inner ring, (n,) rad.
    """
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y = force[:, 0], force[:, 1]
    return jnp.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)
