"""Lines of a batch of units over many speeds, and the largest of each: a product with a matrix that all units share.

The lines of a unit are many more numbers than its peaks. So the units go block by block, small enough for the cache,
and the derivative of a peak takes the speed of the peak alone.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from rvjax.batching import folded
from rvjax.records import PyTree

_NUMBERS = 2**15  # of the lines of a block of units, a quarter of a megabyte: the second cache of a core holds them


def factors(value: jax.Array, excitation: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Real factors of the product of transfer (speeds, orders, outputs, springs) and excitation (orders, springs).

    Rows (orders, 2, speeds, outputs, 2 springs) give real and imaginary part: one product of real matrices runs several
    times as fast as the complex one.
    """
    value = jnp.moveaxis(value, 1, 0)
    rows = jnp.stack(
        [jnp.concatenate([value.real, -value.imag], axis=-1), jnp.concatenate([value.imag, value.real], axis=-1)],
        axis=1,
    )
    return rows, jnp.concatenate([excitation.real, excitation.imag], axis=-1)


def lines(rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Return the product (orders, 2, speeds, outputs).

    Args:
        rows: of `factors`.
        columns: likewise (orders, 2 springs), or (orders, 2 springs, batch), which becomes the last axis.
    """
    return jax.lax.dot_general(rows, columns, (((4,), (1,)), ((0,), (0,))))


@jax.custom_jvp
def largest(rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Largest |line|^2 over the speeds (orders, outputs), NaN if one is."""
    return _highest(rows, columns[None])[0]


@largest.defjvp
def _largest_jvp(primals: PyTree, tangents: PyTree) -> PyTree:
    (rows, columns), (rows_change, columns_change) = primals, tangents
    place = place_of_largest(rows, columns)[:, None, None, :, None]
    rows, rows_change = (jnp.take_along_axis(x, place, axis=2)[:, :, 0] for x in (rows, rows_change))
    columns, columns_change = (x[:, None, None] for x in (columns, columns_change))
    line = jnp.sum(rows * columns, axis=-1)
    change = jnp.sum(rows_change * columns + rows * columns_change, axis=-1)
    return jnp.sum(line**2, axis=1), 2 * jnp.sum(line * change, axis=1)


def place_of_largest(rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Index of the speed, the first of equal values."""
    rows, columns = jax.lax.stop_gradient((rows, columns))
    return _place(rows, columns[None])[0].astype(int)


def _of_units(of_block: Callable[[jax.Array], jax.Array]) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Return a function of all |line|^2 of a batch of units, in blocks of units whose lines stay in the cache.

    Args:
        of_block: of (orders, speeds, outputs, units) to (orders, outputs, units).

    Returns:
        Function of rows and columns (units, orders, 2 springs) to (units, orders, outputs); every vmap over errors
        alone joins the units.
    """

    def function(rows: jax.Array, columns: jax.Array) -> jax.Array:
        units, columns = len(columns), jnp.moveaxis(columns, 0, -1)
        block = min(max(32, _NUMBERS // (rows.size // rows.shape[-1]) // 8 * 8), units)

        def step(number: jax.Array, found: jax.Array) -> jax.Array:
            start = jnp.minimum(number * block, units - block)
            line = lines(rows, jax.lax.dynamic_slice_in_dim(columns, start, block, axis=-1))
            square = jnp.square(line[:, 0]) + jnp.square(line[:, 1])
            return jax.lax.dynamic_update_slice_in_dim(found, of_block(square), start, axis=-1)

        found = jnp.zeros((rows.shape[0], rows.shape[3], units), columns.dtype)
        return jnp.moveaxis(jax.lax.fori_loop(0, -(-units // block), step, found), -1, 0)

    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _rule(size: int, is_batched: list[bool], rows: jax.Array, columns: jax.Array) -> tuple[jax.Array, bool]:
        if is_batched[0]:  # different designs
            return jax.vmap(function, (0, 0 if is_batched[1] else None))(rows, columns), True
        found = batched(rows, columns.reshape(-1, *columns.shape[2:]))
        return found.reshape(size, -1, *found.shape[1:]), True

    return batched


def _first(square: jax.Array) -> jax.Array:
    """Index of the largest value along axis 1, the first of equal values."""
    last = square.shape[1] - 1
    number = jnp.arange(last + 1, dtype=square.dtype)[:, None, None]
    highest = folded(square, 1, by=jnp.maximum)[:, None]
    return folded(jnp.where(square == highest, number, last), 1, by=jnp.minimum)


_highest = _of_units(lambda square: folded(square, 1, by=jnp.maximum))
_place = _of_units(_first)
