"""Layout of batches: groups that share a geometry, the elements of a group along the last axis.

`jax.vmap` alone would put the cases first, where sums over eighty pins cost several times as much, and would copy the
geometry of an angle for every unit. The rule of `in_lanes` lets it be shared: an axis over which the geometry does not
vary becomes elements, any other becomes groups.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import BatchedKernel
from rvjax._jax.sizes import EQUILIBRIA, GROUP
from rvjax.loaded.system import Layout, System
from rvjax.records import PyTree

Kernel = Callable[..., PyTree]


@functools.lru_cache(maxsize=64)
def in_lanes(kernel: Kernel, layout: Layout, shapes: Callable[[Layout, Any], PyTree]) -> Kernel:
    """The function (system, *arrays) of one case that `kernel` computes for many.

    Args:
        kernel: (layout, system, *arrays) -> arrays, cases first; leaves of one case are shared by all.
        layout: counts and methods.
        shapes: (layout, dtype) -> shapes and dtypes of the results of one case.
    """

    def results(*arguments: PyTree) -> PyTree:
        leaves = jax.tree.leaves(arguments)
        batch = tuple(max(leaf.shape[axis] for leaf in leaves) for axis in (0, 1))
        one = shapes(layout, leaves[-1].dtype)
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*batch, *leaf.shape), leaf.dtype), one)

    grouped = BatchedKernel(functools.partial(_over_groups, kernel, layout), results)

    def rule(size: int, batched: list[PyTree], *arguments: PyTree) -> PyTree:
        leaves, tree = jax.tree.flatten(arguments)
        flags = jax.tree.leaves(batched)
        groups = max(leaf.shape[flag] for leaf, flag in zip(leaves, flags))
        lanes = max(leaf.shape[1 + flag] for leaf, flag in zip(leaves, flags))
        by_group = batched[0].pins.rows

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

        return jax.tree.map(split, found)

    grouped.rule = rule

    def of_one(*arguments: PyTree) -> PyTree:
        found = grouped(*jax.tree.map(lambda leaf: leaf[None, None], arguments))
        return jax.tree.map(lambda leaf: leaf[0, 0], found)

    return of_one


def _over_groups(kernel: Kernel, layout: Layout, system: System, *arrays: jax.Array) -> PyTree:
    """Arguments (groups or 1, elements or 1, ...) -> results (groups, elements, ...)."""
    leaves, tree = jax.tree.flatten((system, *arrays))
    groups, lanes = (max(leaf.shape[axis] for leaf in leaves) for axis in (0, 1))
    if groups > 1 and lanes < GROUP:
        flat = [jnp.broadcast_to(leaf, (groups, lanes, *leaf.shape[2:])) for leaf in leaves]
        flat = [leaf.reshape(groups * lanes, *leaf.shape[2:]) for leaf in flat]
        found = kernel(layout, *jax.tree.unflatten(tree, flat))
        return jax.tree.map(lambda leaf: leaf.reshape(groups, lanes, *leaf.shape[1:]), found)
    own = [len(leaf) > 1 for leaf in leaves]

    def group(given: list[jax.Array]) -> PyTree:
        rest = iter(given)
        return kernel(layout, *jax.tree.unflatten(tree, [next(rest) if o else x[0] for x, o in zip(leaves, own)]))

    if groups == 1:
        return jax.tree.map(lambda leaf: leaf[None], group([]))
    return jax.lax.map(group, [leaf for leaf, is_own in zip(leaves, own) if is_own])


def take(tree: PyTree, index: jax.Array) -> PyTree:
    """The cases `index` of leaves (cases or 1, ...), batch axis last; a shared leaf keeps length 1."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf if len(leaf) == 1 else leaf[index], 0, -1), tree)


def in_blocks(kernel: Kernel, arguments: tuple[PyTree, ...]) -> PyTree:
    """Apply `kernel` to leaves (cases or 1, ...), a block of cases at a time; results have the cases first.

    Args:
        kernel: takes the arguments, batch axis last; all but the first (the system) fill the block.
        arguments: system and arrays.
    """
    cases = max(len(leaf) for leaf in jax.tree.leaves(arguments))
    width = min(cases, EQUILIBRIA.here)

    def block(first: jax.Array) -> PyTree:
        def part(leaf: jax.Array) -> jax.Array:
            own = leaf if len(leaf) == 1 else jax.lax.dynamic_slice_in_dim(leaf, first, width)
            return jnp.moveaxis(own, 0, -1)

        system, *arrays = jax.tree.map(part, arguments)
        found = kernel(system, *(jnp.broadcast_to(x, (*x.shape[:-1], width)) for x in arrays))
        return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), found)

    if cases == width:
        return block(jnp.zeros((), jnp.int32))

    def write(number: jax.Array, results: PyTree) -> PyTree:
        first = jnp.minimum(number * width, cases - width)  # the last block is whole
        return jax.tree.map(
            lambda all_, new: jax.lax.dynamic_update_slice_in_dim(all_, new, first, 0), results, block(first)
        )

    shapes = jax.eval_shape(block, jax.ShapeDtypeStruct((), jnp.int32))
    nothing = jax.tree.map(lambda x: jnp.zeros((cases, *x.shape[1:]), x.dtype), shapes)
    return jax.lax.fori_loop(jnp.int32(0), jnp.int32(-(-cases // width)), write, nothing)
