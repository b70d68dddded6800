"""Linear solves that are differentiated as solves and hold no LAPACK call.

Independent batched LAPACK calls in one compiled program can wait for each other for ever on two cores with some
versions of jaxlib. The dynamic model keeps one such call in flight, its eigenproblem; what else it solves goes
through the elimination here.
"""

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import fori_loop
from rvjax.records import PyTree, Scalar


def solve(matrix: jax.Array, rhs: jax.Array) -> tuple[jax.Array, jax.Array]:
    """x with matrix @ x = rhs and the smallest pivot; derivatives of all orders are solves with the same matrix.

    Args:
        matrix: (n, n), real, scaled so that its rows are comparable.
        rhs: (n, m).
    """
    frozen = jax.lax.stop_gradient(matrix)

    def forward(multiply: PyTree, b: jax.Array) -> tuple[jax.Array, jax.Array]:
        return eliminate(frozen, b)

    def transposed(multiply: PyTree, b: jax.Array) -> tuple[jax.Array, jax.Array]:
        return eliminate(frozen.T, b)

    return jax.lax.custom_linear_solve(lambda x: matrix @ x, rhs, forward, transposed, has_aux=True)


def eliminate(matrix: jax.Array, rhs: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Gauss-Jordan elimination with row pivoting: the solution (n, m) and the smallest pivot.

    A zero pivot is replaced by one, so that a singular system gives numbers, not NaN; the smallest pivot shows it.
    """
    size = matrix.shape[0]
    rows = jnp.arange(size)

    def step(k: Scalar, carry: PyTree) -> PyTree:
        work, free, order, smallest = carry
        column = jax.lax.dynamic_index_in_dim(work, k, 1, keepdims=False)
        chosen = jnp.argmax(jnp.where(free, jnp.abs(column), -1))
        pivot = column[chosen]
        row = work[chosen] / jnp.where(pivot == 0, jnp.ones_like(pivot), pivot)
        here = rows == chosen
        work = jnp.where(here[:, None], row[None, :], work - column[:, None] * row[None, :])
        return work, free & ~here, jnp.where(rows == k, chosen, order), jnp.minimum(smallest, jnp.abs(pivot))

    start = (
        jnp.concatenate([matrix, rhs], axis=1),
        jnp.ones(size, bool),
        jnp.zeros(size, rows.dtype),
        jnp.full((), jnp.inf, matrix.dtype),
    )
    work, _, order, smallest = fori_loop(0, size, step, start)
    return work[order, size:], smallest
