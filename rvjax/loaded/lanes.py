"""How batches of cases are laid out: groups that share a geometry, lanes within a group, lanes last.

`jax.vmap` alone would put the cases first, where sums over eighty pins cost several times as much, and would copy the
geometry of an angle for every unit. The rule of `in_lanes` lets it be shared: an axis over which the geometry does not
vary becomes lanes, any other becomes groups.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.loaded.system import Layout, System

Kernel = Callable[..., Any]

_FEW = 8  # lanes of a group; with fewer all cases are lanes, each with its own geometry


@functools.cache
def in_lanes(kernel: Kernel, layout: Layout) -> Callable[..., Any]:
    """The function (system, *arrays) of one case that `kernel` computes for many.

    Args:
        kernel: (layout, system, *arrays) -> arrays, all with lanes last.
        layout: counts and methods.
    """
    grouped = jax.custom_batching.custom_vmap(functools.partial(_over_groups, kernel, layout))

    @grouped.def_vmap
    def _rule(size: int, batched: list[Any], *arguments: Any) -> tuple[Any, Any]:
        leaves, tree = jax.tree.flatten(arguments)
        flags = jax.tree.leaves(batched)
        groups = max(leaf.shape[flag] for leaf, flag in zip(leaves, flags))
        lanes = max(leaf.shape[1 + flag] for leaf, flag in zip(leaves, flags))
        by_group = batched[0].rows

        def merge(leaf: jax.Array, of_batch: bool) -> jax.Array:
            if not of_batch and leaf.shape[0 if by_group else 1] == 1:
                return leaf  # shared by all
            leaf = leaf if of_batch else jnp.broadcast_to(leaf, (size, *leaf.shape))
            _, g, count, *rest = leaf.shape
            if by_group:
                return jnp.broadcast_to(leaf, (size, groups, count, *rest)).reshape(size * groups, count, *rest)
            leaf = jnp.broadcast_to(leaf, (size, g, lanes, *rest))
            return jnp.swapaxes(leaf, 0, 1).reshape(g, size * lanes, *rest)

        found = grouped(*jax.tree.unflatten(tree, [merge(leaf, flag) for leaf, flag in zip(leaves, flags)]))

        def split(leaf: jax.Array) -> jax.Array:
            if by_group:
                return leaf.reshape(size, groups, *leaf.shape[1:])
            return jnp.swapaxes(leaf.reshape(groups, size, lanes, *leaf.shape[2:]), 0, 1)

        found = jax.tree.map(split, found)
        return found, jax.tree.map(lambda _: True, found)

    def of_one(*arguments: Any) -> Any:
        found = grouped(*jax.tree.map(lambda leaf: leaf[None, None], arguments))
        return jax.tree.map(lambda leaf: leaf[0, 0], found)

    return of_one


def _over_groups(kernel: Kernel, layout: Layout, system: System, *arrays: Any) -> Any:
    """Arguments (groups or 1, lanes or 1, ...) -> results (groups, lanes, ...)."""
    arguments = (system, *arrays)
    leaves, tree = jax.tree.flatten(arguments)
    groups, lanes = (max(leaf.shape[axis] for leaf in leaves) for axis in (0, 1))

    def last(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(leaf, 0, -1)

    def first(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(jnp.broadcast_to(leaf, (*leaf.shape[:-1], lanes)), -1, 0)

    if groups > 1 and lanes < _FEW:
        flat = [jnp.broadcast_to(leaf, (groups, lanes, *leaf.shape[2:])) for leaf in leaves]
        flat = [last(leaf.reshape(groups * lanes, *leaf.shape[2:])) for leaf in flat]
        found = kernel(layout, *jax.tree.unflatten(tree, flat))
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0).reshape(groups, lanes, *leaf.shape[:-1]), found)

    own = [len(leaf) > 1 for leaf in leaves]

    def group(given: list[jax.Array]) -> Any:
        rest = iter(given)
        whole = [last(next(rest) if is_own else leaf[0]) for leaf, is_own in zip(leaves, own)]
        return jax.tree.map(first, kernel(layout, *jax.tree.unflatten(tree, whole)))

    if groups == 1:
        return jax.tree.map(lambda leaf: leaf[None], group([]))
    return jax.lax.map(group, [leaf for leaf, is_own in zip(leaves, own) if is_own])


def in_blocks(of_block: Callable[..., Any], lanes: int, size: int, arguments: Any) -> Any:
    """Results (..., lanes) of `of_block`, which gets `size` lanes at a time.

    Args:
        of_block: arguments, lanes last -> results, lanes last.
        lanes: how many there are.
        size: of a block.
        arguments: lanes last; leaves with one lane are shared.
    """
    if lanes <= size:
        return of_block(arguments)
    blocks = -(-lanes // size)
    leaves, tree = jax.tree.flatten(arguments)
    own = [leaf.shape[-1] > 1 for leaf in leaves]

    def cut(leaf: jax.Array) -> jax.Array:
        fill = jnp.broadcast_to(leaf[..., -1:], (*leaf.shape[:-1], blocks * size - lanes))
        whole = jnp.concatenate([leaf, fill], axis=-1)
        return jnp.moveaxis(whole.reshape(*leaf.shape[:-1], blocks, size), -2, 0)

    def block(given: list[jax.Array]) -> Any:
        rest = iter(given)
        return of_block(jax.tree.unflatten(tree, [next(rest) if is_own else leaf for leaf, is_own in zip(leaves, own)]))

    found = jax.lax.map(block, [cut(leaf) for leaf, is_own in zip(leaves, own) if is_own])
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], -1)[..., :lanes], found)
