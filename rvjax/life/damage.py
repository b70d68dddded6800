"""Ratings of a roller or ball bearing, and its damage by a history of loads.

Dynamic and static rating are those of ISO 281 and ISO 76, in N and mm. Damage is `basic`, by the size
of the loads, or `raceway`, point by point. A damage of 1 is that of a million revolutions at the rating. It is finite
and 0 without load; lives are inverted last.
"""

import math
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax._jax.elementary import power
from rvjax.bearings import LARGEST_BALL, BallBearing, RollerBearing, RollingBearing
from rvjax.designs import expect
from rvjax.records import concrete, promote, quantity, signs_hold
from rvjax.status import Check, Status
from rvjax.units import mm

REDUCTION = 0.83  # lambda nu of ISO 281: the rating of a whole bearing against that of its laminae
_FACTOR = 551.13373 * 0.377 * REDUCTION  # Eq. 2
_INNER, _OUTER = 0.378, 0.364  # Eq. 5


LEAST = 0.5  # of C / C0 by the size: makers' ratings of one bearing differ less
Bearing = TypeVar("Bearing", bound=RollingBearing)


_STATIC = (
    14.7, 14.9, 15.1, 15.3, 15.5, 15.7, 15.9, 16.1, 16.3, 16.5, 16.4, 16.1, 15.9, 15.6, 15.4, 15.2, 14.9, 14.7, 14.4,
    14.2, 14.0, 13.7, 13.5, 13.2, 13.0, 12.8, 12.5, 12.3, 12.1, 11.8, 11.6, 11.4, 11.2, 10.9, 10.7, 10.5, 10.3, 10.0,
    9.8, 9.6, 9.4,
)  # fmt: skip
"""f0 of ISO 76 at g = 0, 0.01 .. 0.40: 4200 MPa under the most loaded ball, on the ring where it is reached first."""


class Ratings(NamedTuple):
    """Load ratings of one bearing, N."""

    dynamic: jax.Array  # C
    static: jax.Array  # C0
    inner: jax.Array  # Qi, of one roller on the inner ring; NaN of balls, as no method reads it
    outer: jax.Array  # Qe


def dynamic_rating(bearing: RollingBearing) -> jax.Array:
    """Basic dynamic radial load rating C: 90 % of such bearings reach a million revolutions under it. ISO 281.

    Args:
        bearing: its `capacity` if given, else its rollers or balls.

    Returns:
        () N; NaN where traced dimensions are not finite or do not fit.

    Raises:
        ValueError: `bearing` is neither a RollerBearing nor a BallBearing.
    """
    expect(bearing, "life.dynamic_rating", RollerBearing, BallBearing)
    return _rated(bearing)[0]


def static_rating(bearing: RollingBearing) -> jax.Array:
    """Basic static radial load rating C0: a permanent dent of 1e-4 of the roller or ball. ISO 76.

    Args:
        bearing: its `static_capacity` if given, else its rollers or balls.

    Returns:
        () N; NaN where traced dimensions are not finite or do not fit.

    Raises:
        ValueError: `bearing` is neither a RollerBearing nor a BallBearing.
    """
    expect(bearing, "life.static_rating", RollerBearing, BallBearing)
    return _rated(bearing)[1]


@jax.jit
def _rated(bearing: RollingBearing) -> tuple[jax.Array, jax.Array]:
    bearing = promote(bearing)
    failed = [failed for failed, _ in unfit(bearing)]
    good = ~(failed[0] | failed[1])
    rated = ratings(jax.tree.map(lambda x, spare: jnp.where(good, x, spare), bearing, harmless(bearing)))
    return jnp.where(good, rated.dynamic, jnp.nan), jnp.where(good, rated.static, jnp.nan)


def check_bearing(bearing: RollingBearing, name: str, method: str, argument: str = "method") -> None:
    """Raise ValueError for a method that balls have not, and a dynamic rating that is too small for the static rating.

    Both are ratings of the same rollers or balls, which fix C / C0 (Eqs. 3, 4, 28, 29). No standard bounds the ratings
    that a maker gives; less than half of that ratio is an input error here, such as a wrong unit. Traced numbers are
    not checked.

    Args:
        bearing: with or without given ratings.
        name: of the bearing, for the message.
        method: of the life.
        argument: name of the method, for the message.

    Raises:
        ValueError: names the rating, its value and its unit, or the method.
    """
    if isinstance(bearing, BallBearing) and method != "basic":
        raise ValueError(f'{argument} = "{method}": must be "basic"; {name} has balls, not rollers')
    if (bearing.capacity is None and bearing.static_capacity is None) or not concrete(*jax.tree.leaves(bearing)):
        return
    by_size = _rated(bearing.replace(capacity=None, static_capacity=None))
    dynamic, static = (np.asarray(x) for x in _rated(bearing))
    least = LEAST * static * np.asarray(by_size[0] / by_size[1])
    if np.any(dynamic < least):
        given = "capacity" if bearing.capacity is not None else "static_capacity"
        value, bound = (quantity(x, "N") for x in (getattr(bearing, given), least))
        rule = f"must be at least {bound}" if given == "capacity" else f"needs a dynamic rating of at least {bound}"
        raise ValueError(
            f"{name}.{given} = {value}: {rule}, {LEAST:g} of what ISO 281 and ISO 76 give these {bearing.element}s "
            f"for C0 = {quantity(static, 'N')}; check the unit"
        )


def unfit(bearing: RollingBearing) -> tuple[Check, Check]:
    """Conditions under which no such bearing exists, each with its status.

    Args:
        bearing: numbers as arrays.
    """
    numbers = jax.tree.leaves(bearing)
    finite = jnp.all(jnp.stack([jnp.all(jnp.abs(x) < _largest(x)) for x in numbers]))
    size, circle = bearing.element_diameter, bearing.pitch_diameter
    fits = signs_hold(bearing) & (size < circle)
    fits &= size <= circle * math.sin(math.pi / bearing.elements) * (1 + 1e-6)  # float32 too
    if isinstance(bearing, BallBearing):
        fits &= size <= LARGEST_BALL * circle * (1 + 1e-6)
        for groove in (bearing.inner_groove, bearing.outer_groove):
            fits &= (groove > 0.5) & (groove <= 1)
    fits &= (bearing.contact_angle >= 0) & (bearing.contact_angle < math.pi / 2)
    return (~finite, Status.NONFINITE), (~fits, Status.INVALID_GEOMETRY)


def _largest(x: jax.Array) -> float:
    return float(jnp.finfo(x.dtype).max) ** (1 / 3)  # products of three stay in the arithmetic


def harmless(bearing: Bearing, contact_angle: float = 0.0) -> Bearing:
    """A bearing of the same structure that exists.

    Args:
        bearing: numbers as arrays.
        contact_angle: rad.
    """
    spare = dict(roller_diameter=1e-3, roller_length=1e-3, ball_diameter=5e-4, contact_angle=contact_angle)
    spare |= dict(pitch_diameter=2e-3 / math.sin(math.pi / bearing.elements), inner_groove=0.52, outer_groove=0.52)
    return jax.tree_util.tree_map_with_path(lambda path, _: spare.get(path[-1].name, 1.0), bearing)


def ratings(bearing: RollingBearing) -> Ratings:
    """All ratings of a bearing that exists.

    Args:
        bearing: numbers as arrays.
    """
    if isinstance(bearing, BallBearing):
        return _of_balls(bearing)
    assert isinstance(bearing, RollerBearing)
    z, cosine = bearing.rollers, jnp.cos(bearing.contact_angle)
    diameter, length = bearing.roller_diameter / mm, bearing.roller_length / mm
    g = bearing.roller_diameter * cosine / bearing.pitch_diameter  # Eq. 1
    ratio = power((1 - g) / (1 + g), 143 / 108)
    shape = power(1 + power(1.04 * ratio, 4.5), -2 / 9)
    fc = _FACTOR * power(g, 2 / 9) * power(1 - g, 29 / 27) * power(1 + g, -1 / 4) * shape  # Eq. 2
    dynamic = bearing.capacity
    if dynamic is None:  # Eq. 3
        dynamic = bearing.rating_factor * fc * power(length * cosine, 7 / 9) * z**0.75 * power(diameter, 29 / 27)
    static = bearing.static_capacity
    if static is None:
        static = 44 * (1 - g) * z * length * diameter * cosine  # Eq. 4
    t = power(1.038 * ratio, 4.5)
    roller = dynamic / (REDUCTION * z * cosine)
    return Ratings(
        dynamic=dynamic,
        static=static,
        inner=roller / _INNER * power(1 + t, 2 / 9),  # Eq. 5
        outer=roller / _OUTER * power(1 + 1 / t, 2 / 9),
    )


def _of_balls(bearing: BallBearing) -> Ratings:
    """Ratings of a ball bearing that exists."""
    z, rows, cosine = bearing.balls, bearing.rows, jnp.cos(bearing.contact_angle)
    d, inner, outer = bearing.ball_diameter / mm, bearing.inner_groove, bearing.outer_groove
    g = bearing.ball_diameter * cosine / bearing.pitch_diameter  # Eq. 1
    grooves = power(inner * (2 * outer - 1) / (outer * (2 * inner - 1)), 0.41)
    ring = power(1.04 * power((1 - g) / (1 + g), 1.72) * grooves, 10 / 3)  # outer against inner
    size = power(g, 0.3) * power(1 - g, 1.39) * power(1 + g, -1 / 3) * power(2 * inner / (2 * inner - 1), 0.41)
    fc = 0.95 * 39.9 * power(1 + ring, -0.3) * size  # Eq. 27
    dynamic, static = bearing.capacity, bearing.static_capacity
    if dynamic is None:  # Eq. 28
        of_size = jnp.where(d > 25.4, 3.647 * power(d, 1.4), power(d, 1.8))
        dynamic = bearing.rating_factor * fc * power(rows * cosine, 0.7) * z ** (2 / 3) * of_size
    if static is None:  # Eq. 29
        factor = jnp.interp(g, jnp.arange(len(_STATIC), dtype=g.dtype) / 100, jnp.asarray(_STATIC, g.dtype))
        static = factor * rows * z * d * d * cosine
    return Ratings(dynamic, static, *2 * (jnp.full_like(dynamic, jnp.nan),))


METHODS = ("basic", "raceway", "slices")

_RING = 32  # points of a ring; Eq. 8 to 1e-7; halves of them fill the vectors of a processor


def mean_cosine(m: float) -> float:
    """Mean of cos+^m over a turn. Eq. 9."""
    return math.gamma((m + 1) / 2) / (2 * math.sqrt(math.pi) * math.gamma(m / 2 + 1))


J4, J45 = mean_cosine(40 / 9) ** (1 / 4), mean_cosine(5.0) ** (2 / 9)  # moving load; stationary load


def _power_coefficients() -> list[float]:
    """Coefficients of c^2, c^3 .. in a polynomial for c^(40/9), 0 <= c <= 1, within 5e-9; faster than powers."""
    c = (1 - np.cos(np.pi * (np.arange(1000) + 0.5) / 1000)) / 2
    columns = np.polynomial.chebyshev.chebvander(2 * c - 1, 12) * (c * c)[:, None]
    coefficients = np.linalg.lstsq(columns, c ** (40 / 9), rcond=None)[0]
    series = np.polynomial.Chebyshev(coefficients, domain=[0, 1])
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


def by_load(load: jax.Array, ratings: Ratings, exponent: float) -> Damage:
    """Damage of a million revolutions under an equivalent load. Eq. 6.

    Args:
        load: () N.
        ratings: of the bearing.
        exponent: of its life.
    """
    return Damage(load, power(load / ratings.dynamic, exponent))


def basic(size: jax.Array, weight: jax.Array, ratings: Ratings, exponent: float) -> Damage:
    """Power mean of the loads over the revolutions. Eq. 7.

    Args:
        size: of the loads, (n,) N.
        weight: shares of the revolutions, (n,).
        ratings: of the bearing.
        exponent: of its life.
    """
    largest = scale(size)
    mean = power(jnp.sum(weight * power(size / largest, exponent)), 1 / exponent)
    return by_load(largest * mean, ratings, exponent)


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
        return jnp.mean(power(damage, RollerBearing.weibull_slope))

    inner, outer = ring(turned_back(direction, angle)) / J4**4.5, ring(direction) / J45**4.5
    load = largest * power((inner + x * outer) / (1 + x), 2 / 9)
    return by_load(load, ratings, RollerBearing.life_exponent)


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
