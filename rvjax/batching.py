"""Functions of whole batches under `jax.vmap`: what one case alone cannot do, such as treating a few lanes apart."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from rvjax.records import PyTree

Result = TypeVar("Result")

_WINDOW = 32  # neighbouring lanes that are computed once more together


def along_lanes(function: Callable[..., Result]) -> Callable[..., Result]:
    """A function of batches, whose batch `jax.vmap` makes larger: every vmap around it joins the one axis of lanes.

    Args:
        function: of pytrees whose leaves have the lanes first, as many or 1 where all share it, to a pytree
            whose leaves have all lanes.
    """
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _rule(size: int, is_batched: PyTree, *arguments: PyTree) -> tuple[PyTree, PyTree]:
        lanes = [x.shape[1 if of_batch else 0] for x, of_batch in zip(*map(jax.tree.leaves, (arguments, is_batched)))]

        def flat(leaf: jax.Array, of_batch: bool) -> jax.Array:
            if not of_batch and len(leaf) == 1:
                return leaf  # shared by all
            leaf = leaf if of_batch else jnp.broadcast_to(leaf, (size, *leaf.shape))
            leaf = jnp.broadcast_to(leaf, (size, max(lanes), *leaf.shape[2:]))
            return leaf.reshape(size * max(lanes), *leaf.shape[2:])

        found = batched(*jax.tree.map(flat, arguments, tuple(is_batched)))
        found = jax.tree.map(lambda leaf: leaf.reshape(size, max(lanes), *leaf.shape[1:]), found)
        return found, jax.tree.map(lambda _: True, found)

    return batched


def settle(x: jax.Array) -> jax.Array:
    """x, stored: what follows reads it instead of evaluating it anew. XLA looks through all but a loop."""
    return jax.lax.fori_loop(0, 2, lambda _, x: -x, x)


def once_more(
    function: Callable[[PyTree], jax.Array], arguments: PyTree, found: jax.Array, todo: jax.Array
) -> jax.Array:
    """`found`, or `function(arguments)` in the lanes `todo`: a batch pays for the neighbourhood of those lanes only.

    Args:
        function: of one case to a number.
        arguments: of the function; pytree of numbers and arrays.
        found: ().
        todo: () bool.
    """

    def repair(arguments: PyTree, found: jax.Array, todo: jax.Array) -> jax.Array:
        lanes = max(len(leaf) for leaf in jax.tree.leaves((arguments, found, todo)))
        found, todo = (jnp.broadcast_to(x, (lanes,)) for x in (found, todo))
        window = min(_WINDOW, lanes)
        windows = -(-lanes // window)
        of_window = jnp.any(jnp.pad(todo, (0, windows * window - lanes)).reshape(windows, window), axis=1)

        def step(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            found, left = state
            number = jnp.argmax(left)
            start = jnp.minimum(number * window, lanes - window)

            def cut(leaf: jax.Array) -> jax.Array:
                return leaf if len(leaf) == 1 else jax.lax.dynamic_slice_in_dim(leaf, start, window)

            axes = jax.tree.map(lambda leaf: None if len(leaf) == 1 and lanes > 1 else 0, arguments)
            some = jax.tree.map(lambda leaf, axis: cut(leaf)[0] if axis is None else cut(leaf), arguments, axes)
            new = jax.vmap(function, (axes,), axis_size=window)(some)
            new = jnp.where(cut(todo), new, cut(found))  # no lane depends on its neighbours
            return jax.lax.dynamic_update_slice_in_dim(found, new, start, 0), left.at[number].set(False)

        return jax.lax.while_loop(lambda state: jnp.any(state[1]), step, (found, of_window))[0]

    first = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (arguments, found, todo))
    return along_lanes(repair)(*first)[0]
