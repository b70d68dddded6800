"""Elementary functions that XLA leaves to scalar library calls in float64, written so that they vectorise.

Each has its own derivative rule, agrees with the exact function to a few units in the last place, and is
kept only where a benchmark shows a gain.
"""

from typing import Any

import jax
import jax.numpy as jnp

# ln 2 = high + low; high has so few bits that its multiples by an exponent are exact.
_LN2_HIGH, _LN2_LOW = float.fromhex("0x1.62e42ffp-1"), float.fromhex("-0x1.718432a1b0e26p-35")
_ROOT_HALF = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
_LOG_TERMS = 9  # the next one is below 3e-17


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
    square, tail = s * s, jnp.zeros_like(s)
    for n in range(_LOG_TERMS, 0, -1):  # log m = 2 atanh s = 2 (s + s^3/3 + s^5/5 + ..)
        tail = square * (tail + 1 / (2 * n + 1))
    k = exponent.astype(jnp.float64)
    return k * _LN2_HIGH + (2 * s + (2 * s * tail + k * _LN2_LOW))


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
