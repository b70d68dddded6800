"""Quantiles without a closed form: tabulated on the host over z, interpolated by cubic Hermite pieces."""

import jax
import jax.numpy as jnp
import numpy as np

NODES = np.linspace(-9.0, 9.0, 8193)
"""z of a table's values."""


def interpolate(z: jax.Array, values: np.ndarray, slopes: np.ndarray) -> jax.Array:
    """The function with these values and derivatives to z at `NODES`, at z of any shape; constant beyond them."""
    first, last, step = float(NODES[0]), float(NODES[-1]), float(NODES[1] - NODES[0])
    position = (jnp.clip(z, first, last) - first) / step
    left = jnp.clip(position.astype(int), 0, len(NODES) - 2)
    s = position - left.astype(position.dtype)
    v, d = jnp.asarray(values, position.dtype), jnp.asarray(slopes * step, position.dtype)
    rise = v[left + 1] - v[left]
    curve = (d[left] - rise) * (1 - s) - (d[left + 1] - rise) * s
    return v[left] + s * (rise + (1 - s) * curve)
