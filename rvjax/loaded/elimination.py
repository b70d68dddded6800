"""Newton's linear system, eliminated part by part: discs touch cranks only, so that what is dense is small.

Arrays have their lanes (independent cases) last; arithmetic runs along them. Every part has up to three unknowns and is
factored as L D L', which stays exact to rounding where a part is held by its centring springs alone.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.loaded.lanes import folded, stored
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
    forward = stored(_forward, factor, right)  # (3, d, 3c + 1, l)

    def left_by_discs(forward: jax.Array, inverse: list[jax.Array], hessian: Hessian, rhs: jax.Array) -> jax.Array:
        """Dense system of cranks, carrier and sun, right side in the last column."""
        own = jnp.asarray(np.eye(cranks), rhs.dtype)[:, None, :, None, None]
        square = own * hessian.crank.transpose(2, 0, 1, 3)[:, :, None]  # (c, 3, c, 3, l)
        outer = rhs[layout.inner : layout.carried, None]
        dense = jnp.concatenate([square.reshape(3 * cranks, 3 * cranks, lanes), outer], axis=1)
        for a in range(3):
            for k in range(discs):
                dense = dense - (forward[a, k, : 3 * cranks] * inverse[a][k])[:, None] * forward[a, k, None]
        bridge = hessian.crank_tail.reshape(3 * cranks, layout.tail, lanes)
        above = jnp.concatenate([dense[:, :-1], bridge, dense[:, -1:]], axis=1)
        below = jnp.concatenate([bridge.transpose(1, 0, 2), hessian.tail, rhs[layout.carried :, None]], axis=1)
        return jnp.concatenate([above, below])

    border = _border(layout, stored(left_by_discs, forward, factor.inverse, hessian, rhs))

    def of_discs(factor: _Factor, forward: jax.Array, border: jax.Array) -> jax.Array:
        left = forward[:, :, -1] - folded(forward[:, :, :-1] * border[: 3 * cranks], 2)
        return _backward(factor, left).transpose(1, 0, 2).reshape(layout.inner, lanes)

    return jnp.concatenate([of_discs(factor, forward, border), border])


def _border(layout: Layout, matrix: jax.Array) -> jax.Array:
    """Unknowns of cranks, carrier and sun from their dense system (m, m + 1, l)."""
    sizes = [3] * layout.cranks + [layout.tail % 3 or 3] + [3] * (layout.tail > 3)
    steps = []
    for size in sizes:
        factor = _factor([[matrix[a, b] for b in range(size)] for a in range(size)])
        forward = _forward(factor, matrix[:size, size:])
        steps.append((factor, forward))
        if matrix.shape[0] > size:

            def rest(matrix, forward, inverse):
                for a in range(size):
                    matrix = matrix - (forward[a, :-1] * inverse[a])[:, None] * forward[a, None]
                return matrix

            forward, matrix = stored(
                lambda f, r, m: (_forward(f, r), rest(m, _forward(f, r), f.inverse)),
                factor,
                matrix[:size, size:],
                matrix[size:, size:],
            )
            steps[-1] = (factor, forward)
    found = jnp.zeros((0, matrix.shape[-1]), matrix.dtype)
    for factor, forward in reversed(steps):

        def back(factor, forward, found):
            left = forward[:, -1]
            if len(found):
                left = left - folded(forward[:, :-1] * found, 1)
            return jnp.concatenate([_backward(factor, left), found])

        found = stored(back, factor, forward, found)
    return found


def _factor(block: list[list[jax.Array]]) -> _Factor:
    """L D L' of a small symmetric block; a pivot lost to rounding is raised to it."""
    lower: list[list[jax.Array]] = []
    inverse: list[jax.Array] = []
    least = 8 * float(jnp.finfo(block[0][0].dtype).eps)
    for a in range(len(block)):
        row = list(block[a][: a + 1])  # row[b] becomes L[a][b] D[b]
        for b in range(1, a + 1):
            for s in range(b):
                row[b] = row[b] - row[s] * (lower[b][s] if b < a else row[s] * inverse[s])
        inverse.append(1 / jnp.maximum(row[a], least * block[a][a]))
        lower.append([row[b] * inverse[b] for b in range(a)])
    return _Factor(lower, inverse)


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
    """L'^-1 D^-1 times the rows of `left` (size, ..., l)."""
    size = len(factor.lower)
    rows: list[jax.Array] = [left[a] * factor.inverse[a] for a in range(size)]
    for a in reversed(range(size)):
        for b in range(a):
            rows[b] = rows[b] - factor.lower[a][b] * rows[a]
    return jnp.stack(rows)
