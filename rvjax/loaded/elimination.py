"""Newton's linear system, eliminated body by body: discs touch the border only, so that the dense matrix is small.

Arrays have the batch axis (independent cases) last; arithmetic runs along it. Every body has up to three unknowns and
is factored as L D L', which stays exact to rounding where a body is held by its centring springs alone.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import folded, stored
from rvjax.loaded.system import Layout


class Hessian(NamedTuple):
    """Second derivatives of the energy, batch axis last; discs touch the first `near` of m unknowns of the border."""

    disc: jax.Array  # (6, d, l): 00, 10, 11, 20, 21, 22
    bridge: jax.Array  # (3, d, near, l)
    border: jax.Array  # (m, m, l)


_DIAGONAL = (0, 2, 5)  # of a triangle
_Block = list[list[jax.Array]]  # rows of the lower triangle of a small symmetric block


@functools.partial(jax.jit, static_argnums=0)  # traced once for each batch size
def solve(layout: Layout, hessian: Hessian, rhs: jax.Array) -> jax.Array:
    """x with H x = rhs.

    Args:
        layout: counts.
        hessian: H.
        rhs: (n, l).
    """
    discs, near, lanes = layout.discs, layout.near, rhs.shape[-1]
    inner = rhs[: layout.inner].reshape(discs, 3, lanes).transpose(1, 0, 2)  # (3, d, l)
    right = jnp.concatenate([hessian.bridge, inner[:, :, None]], axis=2)
    inverse = _inverse(_rows(hessian.disc), [hessian.disc[a] for a in _DIAGONAL])
    forward = stored(_forward, _rows(hessian.disc), inverse, right)  # (3, d, near + 1, l)

    def left_by_discs(forward: jax.Array, inverse: list[jax.Array], border: jax.Array, outer: jax.Array) -> jax.Array:
        """System of the border, right side in the last column."""
        dense = jnp.concatenate([border[:near, :near], outer[:near]], axis=1)
        for a in range(3):
            for k in range(discs):
                dense = dense - (forward[a, k, :near] * inverse[a][k, None])[:, None] * forward[a, k, None]
        above = jnp.concatenate([dense[:, :-1], border[:near, near:], dense[:, -1:]], axis=1)
        return jnp.concatenate([above, jnp.concatenate([border[near:], outer[near:]], axis=1)])

    matrix = stored(left_by_discs, forward, inverse, hessian.border, rhs[layout.inner :, None])
    border = _border(layout, matrix, [hessian.border[a, a] for a in range(len(hessian.border))])

    def of_discs(block: _Block, inverse: list[jax.Array], forward: jax.Array, border: jax.Array) -> jax.Array:
        left = forward[:, :, -1] - folded(forward[:, :, :-1] * border[None, None, :near], 2)
        return _backward(block, inverse, left).transpose(1, 0, 2).reshape(layout.inner, lanes)

    return jnp.concatenate([of_discs(_rows(hessian.disc), inverse, forward, border), border])


def _border(layout: Layout, matrix: jax.Array, own: list[jax.Array]) -> jax.Array:
    """Unknowns of the border from their system (m, m + 1, l), body by body; `own`: its diagonal with the discs held."""
    steps = []
    for size in (*[3] * layout.links, *layout.common):
        inverse = _inverse(_corner(matrix, size), own[-len(matrix) :])
        forward, rest = stored(functools.partial(_reduced, size), matrix, inverse)
        steps.append((matrix, inverse, forward))
        matrix = rest
    found = jnp.zeros((0, matrix.shape[-1]), matrix.dtype)
    for step in reversed(steps):
        found = stored(_resolved, *step, found)
    return found


def _reduced(size: int, matrix: jax.Array, inverse: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """L^-1 times the columns right of the first block, and the Schur complement in the rows below."""
    forward = _forward(_corner(matrix, size), inverse, matrix[:size, size:])
    rest = matrix[size:, size:]
    for a in range(size if len(rest) else 0):
        rest = rest - (forward[a, :-1] * inverse[a][None])[:, None] * forward[a, None]
    return forward, rest


def _resolved(matrix: jax.Array, inverse: list[jax.Array], forward: jax.Array, found: jax.Array) -> jax.Array:
    """The unknowns of the first block before those that are found."""
    left = forward[:, -1]
    if len(found):
        left = left - folded(forward[:, :-1] * found[None], 1)
    return jnp.concatenate([_backward(_corner(matrix, len(inverse)), inverse, left), found])


def _corner(matrix: jax.Array, size: int) -> _Block:
    return [[matrix[a, b] for b in range(a + 1)] for a in range(size)]


def _rows(triangle: jax.Array) -> _Block:
    """Rows of a lower triangle that is given in one axis."""
    return [[triangle[a * (a + 1) // 2 + b] for b in range(a + 1)] for a in range(3)]


def _factor(block: _Block, inverse: list[jax.Array]) -> tuple[_Block, list[jax.Array]]:
    """L below its diagonal and D of the first rows of a small symmetric block, 1 / D being known above the last."""
    lower: _Block = []
    pivots: list[jax.Array] = []
    for a in range(min(len(inverse) + 1, len(block))):
        row = list(block[a])  # row[b] becomes L[a][b] D[b]
        for b in range(1, a + 1):
            for s in range(b):
                row[b] = row[b] - row[s] * (lower[b][s] if b < a else row[s] * inverse[s])
        lower.append([row[b] * inverse[b] for b in range(a)])
        pivots.append(row[a])
    return lower, pivots


def _inverse(block: _Block, own: list[jax.Array]) -> list[jax.Array]:
    """1 / D of L D L'; a pivot lost to rounding is raised to it. L is computed from it wherever it is used.

    Args:
        block: to be factored.
        own: its diagonal before any body was eliminated, of which all that is left may be rounding.
    """
    least = 8 * float(jnp.finfo(block[0][0].dtype).eps)
    inverse: list[jax.Array] = []
    for a in range(len(block)):
        inverse.append(1 / jnp.maximum(_factor(block, inverse)[1][a], least * own[a]))
    return inverse


def _forward(block: _Block, inverse: list[jax.Array], right: jax.Array) -> jax.Array:
    """L^-1 times the rows of `right` (size, ..., columns, l)."""
    rows: list[jax.Array] = []
    for a, weights in enumerate(_factor(block, inverse)[0]):
        row = right[a]
        for weight, above in zip(weights, rows):
            row = row - weight[..., None, :] * above
        rows.append(row)
    return jnp.stack(rows)


def _backward(block: _Block, inverse: list[jax.Array], left: jax.Array) -> jax.Array:
    """L'^-1 D^-1 times the rows of `left` (size, ..., l)."""
    lower = _factor(block, inverse)[0]
    rows = [left[a] * inverse[a] for a in range(len(lower))]
    for a in reversed(range(len(lower))):
        for b in range(a):
            rows[b] = rows[b] - lower[a][b] * rows[a]
    return jnp.stack(rows)
