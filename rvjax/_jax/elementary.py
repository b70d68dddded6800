"""Elementary functions that XLA leaves to scalar library calls in float64, written so that they vectorise.

Each has its own derivative rule, agrees with the exact function to a few units in the last place, and is kept only
where `python -m benchmarks.elementary` shows a gain on the installed JAX. Each is a program of its own, so that a model
that calls it fifty times traces it once: a loaded unit with lives is traced and lowered in three quarters of the time,
with the same bits.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import PyTree

# ln 2 = high + low; high has so few bits that its multiples by an exponent are exact.
_LN2_HIGH, _LN2_LOW = float.fromhex("0x1.62e42ffp-1"), float.fromhex("-0x1.718432a1b0e26p-35")
_ROOT_HALF = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
_ATANH = [1 / (2 * n + 1) for n in range(1, 10)]  # of s^3, s^5 ..; the next is below 3e-17


@jax.custom_jvp
@jax.jit
def log(x: jax.Array) -> jax.Array:
    """Natural logarithm of positive normal numbers; anything else gives a number without meaning.

    Args:
        x: > 0.
    """
    if x.dtype != jnp.float64:
        return jnp.log(x)  # vectorised as it is
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    exponent = (bits - _ROOT_HALF) >> 52  # x = m 2^exponent with m in [sqrt(1/2), sqrt(2))
    m = jax.lax.bitcast_convert_type(bits - (exponent << 52), jnp.float64)
    s = (m - 1) / (m + 1)
    k = exponent.astype(jnp.float64)  # log m = 2 atanh s
    return k * _LN2_HIGH + (2 * s + (2 * s * _polynomial(_ATANH, s * s) + k * _LN2_LOW))


@log.defjvp
def _log_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    (x,), (dx,) = primals, tangents
    return log(x), dx / x


def nonnegative(x: jax.Array) -> jax.Array:
    """x, or 0 where it is negative; the derivative at 0 is that of the positive side, not the mean of both.

    Args:
        x: a number or array; NaN stays NaN.
    """
    return jnp.where(x < 0, 0, x)


def root(x: jax.Array) -> jax.Array:
    """Square root of x > 0; 0 with derivative 0 elsewhere: a root mean square without any amplitude has no slope.

    Args:
        x: a number or array; NaN stays NaN.
    """
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1)), 0 * x)


@functools.partial(jax.jit, static_argnums=1)
def power(base: jax.Array, exponent: float) -> jax.Array:
    """base ** exponent for a constant exponent; 0 with derivative 0 at base = 0.

    The relative error grows with |exponent log base| units in the last place.

    Args:
        base: >= 0, normal numbers or 0.
        exponent: a number.
    """
    positive = base > 0
    return jnp.where(positive, jnp.exp(exponent * log(jnp.where(positive, base, 1))), 0)


# pi/2 in three parts; multiples of the first two by a whole number up to 2^20 are exact.
_HALF_PI = tuple(float.fromhex(part) for part in ("0x1.921fb544p0", "0x1.0b4611a4p-34", "0x1.13198a2e03707p-65"))
_SINE = [(-1) ** n / math.factorial(2 * n + 1) for n in range(1, 9)]  # of r^3, r^5 ..; the next is below 1e-18
_COSINE = [(-1) ** n / math.factorial(2 * n) for n in range(1, 9)]  # of r^2, r^4 ..


LARGEST_ANGLE = 2.0**50
"""Largest angle of `sin_cos`; one unit in the last place of float64 is then a quarter rad."""


@jax.custom_jvp
@jax.jit
def sin_cos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine: to 2 units in the last place up to 1e5, of an angle within rounding of x up to `LARGEST_ANGLE`.

    Args:
        x: rad; beyond `LARGEST_ANGLE` the result has no meaning.
    """
    if x.dtype != jnp.float64:
        return jnp.sin(x), jnp.cos(x)
    quarter = jnp.round(x * (2 / math.pi))
    r = ((x - quarter * _HALF_PI[0]) - quarter * _HALF_PI[1]) - quarter * _HALF_PI[2]
    square = r * r
    sine, cosine = r + r * _polynomial(_SINE, square), 1 + _polynomial(_COSINE, square)
    turn = quarter - 4 * jnp.floor(quarter / 4)  # 0 to 3; whole numbers as floats stay in vectors
    swapped, minus_sine, minus_cosine = (turn == 1) | (turn == 3), turn >= 2, (turn == 1) | (turn == 2)
    first, second = jnp.where(swapped, cosine, sine), jnp.where(swapped, sine, cosine)
    first = jnp.where(x == 0, x, jnp.where(minus_sine, -first, first))  # keeps the sign of a zero
    return first, jnp.where(minus_cosine, -second, second)


@sin_cos.defjvp
def _sin_cos_jvp(
    primals: tuple[jax.Array], tangents: tuple[jax.Array]
) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]:
    sine, cosine = sin_cos(*primals)
    (dx,) = tangents
    return (sine, cosine), (cosine * dx, -sine * dx)


_EIGHTH = math.tan(math.pi / 8)
_INVERSE = 0x7FDE623822FC16E6  # bits of y and of about 1 / y add up to this
_PI, _PI_LOW = 2 * _HALF_PI[0], 2 * (_HALF_PI[1] + _HALF_PI[2])


def _arctan_coefficients() -> list[float]:
    """Coefficients of t^3, t^5 .. up to tan(pi/8): the series, cut by interpolation in Chebyshev points."""

    def tail(z: PyTree) -> PyTree:  # (arctan t - t) / t^3 at z = t^2
        return sum((-1) ** (n + 1) * z**n / (2 * n + 3) for n in range(30))

    cut = np.polynomial.Chebyshev.interpolate(tail, 11, domain=[0, _EIGHTH**2])
    return [float(c) for c in cut.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef]


_ARCTAN = _arctan_coefficients()


@jax.custom_jvp
@jax.jit
def arctan2(y: jax.Array, x: jax.Array) -> jax.Array:
    """Angle of the vector (x, y), -pi to pi, as `jnp.arctan2`, with a derivative of zero at (0, 0).

    Args:
        y: zero, or in size between 1e-150 and 1e150.
        x: as y.
    """
    if x.dtype != jnp.float64:
        return jnp.arctan2(y, x)
    width, height = jnp.abs(x), jnp.abs(y)
    small, large = jnp.minimum(width, height), jnp.maximum(width, height)
    beyond = small > _EIGHTH * large  # measured from 45 degrees
    t = divide(jnp.where(beyond, small - large, small), jnp.where(beyond, small + large, large))
    base = jnp.where(beyond, _PI / 4, 0)
    for flipped, middle in ((height > width, _PI / 2), (jnp.signbit(x), _PI), (jnp.signbit(y), -0.0)):
        base, t = jnp.where(flipped, middle - base, base), jnp.where(flipped, -t, t)
    return base + (t * (1 + _polynomial(_ARCTAN, t * t)) + base * (_PI_LOW / _PI))


@arctan2.defjvp
def _arctan2_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    (y, x), (dy, dx) = primals, tangents
    square = x * x + y * y
    return arctan2(y, x), (x * dy - y * dx) / jnp.where(square == 0, 1, square)


@jax.jit
def divide(x: jax.Array, y: jax.Array) -> jax.Array:
    """x / y in multiplications, 0 for y = 0; within one unit in the last place.

    XLA ends a kernel behind a division whose result is used more than once, and recomputes in the
    next kernel what both need. Plain where the numbers are not float64.

    Args:
        x: in size below 1e150.
        y: zero, or from 1e-150 to 1e150.
    """
    if y.dtype != jnp.float64:
        return jnp.where(y == 0, 0, x / jnp.where(y == 0, 1, y))
    bits = jax.lax.bitcast_convert_type(y, jnp.int64)
    inverse = jax.lax.bitcast_convert_type(_INVERSE - bits, jnp.float64)  # minus the exponent: within 5.1 %
    inverse = jnp.where(y == 0, 0, inverse)
    for _ in range(3):  # Newton's step squares the error
        inverse = inverse + inverse * (1 - y * inverse)
    quotient = x * inverse
    return quotient + inverse * (x - quotient * y)  # and so does this


def _polynomial(coefficients: list[float], x: jax.Array) -> jax.Array:
    """Sum of coefficients[n] x^(n + 1)."""
    total = jnp.zeros_like(x)
    for coefficient in reversed(coefficients):
        total = x * (total + coefficient)
    return total
