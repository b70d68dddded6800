"""Newton's linear system, eliminated part by part: discs touch cranks only, so that what is dense is small.

Arrays have their lanes (independent cases) last; arithmetic runs along them. Every part has up to three unknowns and is
factored as L D L', which stays exact to rounding where a part is held by its centring springs alone.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.loaded.system import Layout


class Hessian(NamedTuple):
    """Second derivatives of the energy, lanes last; symmetric blocks are full."""

    disc: jax.Array  # (3, 3, d, l)
    disc_crank: jax.Array  # (3, d, c, 3, l)
    crank: jax.Array  # (3, 3, c, l)
    crank_tail: jax.Array  # (c, 3, t, l)
    tail: jax.Array  # (t, t, l)


class _Factor(NamedTuple):
    """L below its diagonal, by rows, and 1 / D."""

    lower: list[list[jax.Array]]
    inverse: list[jax.Array]


def solve(layout: Layout, hessian: Hessian, rhs: jax.Array) -> jax.Array:
    """x with H x = rhs.

    Args:
        layout: counts.
        hessian: H.
        rhs: (n, l).
    """
    discs, cranks, lanes = layout.discs, layout.cranks, rhs.shape[-1]
    inner = rhs[: layout.inner].reshape(discs, 3, lanes).transpose(1, 0, 2)  # (3, d, l)
    factor = _factor([[hessian.disc[a, b] for b in range(3)] for a in range(3)])
    right = jnp.concatenate([hessian.disc_crank.reshape(3, discs, 3 * cranks, lanes), inner[:, :, None]], axis=2)
    forward = _forward(factor, right)  # (3, d, 3c + 1, l)
    forward, scaled = jax.lax.optimization_barrier((forward, forward * jnp.stack(factor.inverse)[:, :, None]))

    # What the discs leave of the cranks, right side in the last column.
    own = jnp.asarray(np.eye(cranks), rhs.dtype)[:, None, :, None, None]
    square = own * hessian.crank.transpose(2, 0, 1, 3)[:, :, None]  # (c, 3, c, 3, l)
    outer = rhs[layout.inner : layout.carried, None]
    dense = jnp.concatenate([square.reshape(3 * cranks, 3 * cranks, lanes), outer], axis=1)
    for a in range(3):
        for k in range(discs):
            dense = dense - forward[a, k, : 3 * cranks, None] * scaled[a, k, None]
    bridge = hessian.crank_tail.reshape(3 * cranks, layout.tail, lanes)
    above = jnp.concatenate([dense[:, :-1], bridge, dense[:, -1:]], axis=1)
    below = jnp.concatenate([bridge.transpose(1, 0, 2), hessian.tail, rhs[layout.carried :, None]], axis=1)
    border = _border(layout, jax.lax.optimization_barrier(jnp.concatenate([above, below])))

    left = scaled[:, :, -1] - jnp.sum(scaled[:, :, :-1] * border[None, None, : 3 * cranks], axis=2)
    return jnp.concatenate([_backward(factor, left).transpose(1, 0, 2).reshape(layout.inner, lanes), border])


def _border(layout: Layout, matrix: jax.Array) -> jax.Array:
    """Unknowns of cranks, carrier and sun from their dense system (m, m + 1, l)."""
    sizes = [3] * layout.cranks + [layout.tail % 3 or 3] + [3] * (layout.tail > 3)
    steps = []
    for size in sizes:
        factor = _factor([[matrix[a, b] for b in range(size)] for a in range(size)])
        forward = _forward(factor, matrix[:size, size:])
        forward, scaled = jax.lax.optimization_barrier((forward, forward * jnp.stack(factor.inverse)[:, None]))
        steps.append((factor, scaled))
        matrix = matrix[size:, size:]
        for a in range(size):
            matrix = matrix - forward[a, :-1, None] * scaled[a, None]
        matrix = jax.lax.optimization_barrier(matrix)
    found = jnp.zeros((0, matrix.shape[-1]), matrix.dtype)
    for factor, scaled in reversed(steps):
        left = scaled[:, -1] - jnp.sum(scaled[:, :-1] * found[None], axis=1)
        found = jax.lax.optimization_barrier(jnp.concatenate([_backward(factor, left), found]))
    return found


def _factor(block: list[list[jax.Array]]) -> _Factor:
    """L D L' of a small symmetric block; a pivot lost to rounding is raised to it."""
    size, lower, inverse = len(block), [], []
    least = 8 * float(jnp.finfo(block[0][0].dtype).eps)
    for a in range(size):
        row = list(block[a][: a + 1])  # row[b] becomes L[a][b] D[b]
        for b in range(1, a + 1):
            for s in range(b):
                row[b] = row[b] - row[s] * (lower[b][s] if b < a else row[s] * inverse[s])
        inverse.append(1 / jnp.maximum(row[a], least * block[a][a]))
        lower.append([row[b] * inverse[b] for b in range(a)])
    return jax.lax.optimization_barrier(_Factor(lower, inverse))


def _forward(factor: _Factor, right: jax.Array) -> jax.Array:
    """L^-1 times the rows of `right` (size, ..., columns, l)."""
    rows: list[jax.Array] = []
    for a, weights in enumerate(factor.lower):
        row = right[a]
        for weight, above in zip(weights, rows):
            row = row - weight[..., None, :] * above
        rows.append(row)
    return jnp.stack(rows)


def _backward(factor: _Factor, left: jax.Array) -> jax.Array:
    """L'^-1 times the rows of `left` (size, ..., l)."""
    size = len(factor.lower)
    rows: list[jax.Array] = [left[a] for a in range(size)]
    for a in reversed(range(size)):
        for b in range(a):
            rows[b] = rows[b] - factor.lower[a][b] * rows[a]
    return jnp.stack(rows)
