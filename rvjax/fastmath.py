"""Elementary functions that XLA leaves to scalar library calls in float64, written so that they vectorise.

Each has its own derivative rule, agrees with the exact function to a few units in the last place, and is
kept only where a benchmark shows a gain.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp

# ln 2 = high + low; high has so few bits that its multiples by an exponent are exact.
_LN2_HIGH, _LN2_LOW = float.fromhex("0x1.62e42ffp-1"), float.fromhex("-0x1.718432a1b0e26p-35")
_ROOT_HALF = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
_ATANH = [1 / (2 * n + 1) for n in range(1, 10)]  # of s^3, s^5 ..; the next is below 3e-17


@jax.custom_jvp
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
def _log_jvp(primals: Any, tangents: Any) -> Any:
    (x,), (dx,) = primals, tangents
    return log(x), dx / x


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


LARGEST_ANGLE = 1e5
"""Up to here `sin_cos` keeps its digits."""


@jax.custom_jvp
def sin_cos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine for |x| < `LARGEST_ANGLE`; beyond, digits are lost, and then everything.

    Args:
        x: rad.
    """
    if x.dtype != jnp.float64:
        return jnp.sin(x), jnp.cos(x)
    quarter = jnp.round(x * (1 / _HALF_PI[0]))
    r = ((x - quarter * _HALF_PI[0]) - quarter * _HALF_PI[1]) - quarter * _HALF_PI[2]
    square = r * r
    sine, cosine = r + r * _polynomial(_SINE, square), 1 + _polynomial(_COSINE, square)
    turn = quarter.astype(jnp.int64) & 3
    swapped, minus_sine, minus_cosine = (turn & 1) == 1, turn >= 2, (turn == 1) | (turn == 2)
    first, second = jnp.where(swapped, cosine, sine), jnp.where(swapped, sine, cosine)
    first = jnp.where(x == 0, x, jnp.where(minus_sine, -first, first))  # keeps the sign of a zero
    return first, jnp.where(minus_cosine, -second, second)


@sin_cos.defjvp
def _sin_cos_jvp(primals: Any, tangents: Any) -> Any:
    sine, cosine = sin_cos(*primals)
    (dx,) = tangents
    return (sine, cosine), (cosine * dx, -sine * dx)


_ARCTAN = [(-1) ** n / (2 * n + 1) for n in range(1, 12)]  # of t^3, t^5 ..; the next is below 1e-18 up to tan(pi/16)


@jax.custom_jvp
def arctan(x: jax.Array) -> jax.Array:
    """Inverse tangent, also of infinity.

    Args:
        x: any number.
    """
    if x.dtype != jnp.float64:
        return jnp.arctan(x)
    size = jnp.abs(x)
    steep = size > 1
    t = jnp.where(steep, 1 / jnp.where(steep, size, 1), size)
    for _ in range(2):  # arctan t = 2 arctan(t / (1 + sqrt(1 + t^2)))
        t = t / (1 + jnp.sqrt(1 + t * t))
    angle = 4 * (t + t * _polynomial(_ARCTAN, t * t))
    angle = jnp.where(steep, _HALF_PI[0] - angle + _HALF_PI[1], angle)
    return jnp.where(x < 0, -angle, jnp.where(size > 0, angle, x))


@arctan.defjvp
def _arctan_jvp(primals: Any, tangents: Any) -> Any:
    (x,), (dx,) = primals, tangents
    return arctan(x), dx / (1 + x * x)


def _polynomial(coefficients: list[float], x: jax.Array) -> jax.Array:
    """Sum of coefficients[n] x^(n + 1)."""
    total = jnp.zeros_like(x)
    for coefficient in reversed(coefficients):
        total = x * (total + coefficient)
    return total
