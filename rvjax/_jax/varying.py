"""Numbers within `jax.shard_map`, whose checks give each a type: the mesh axes over which it varies.

JAX brings the operands of an operation to one type, but neither the state of a loop nor the right side of a linear
solve. Outside of `jax.shard_map`, and without its checks, all of this leaves its arguments as they are.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import jax
from jax._src import config

from rvjax.records import PyTree

State = TypeVar("State")
Axes = frozenset[Any]


def unchecked() -> AbstractContextManager[None]:
    """A context that traces without these types: what one device computes with its own numbers."""
    return config._check_vma(False)


def unvarying(number: Any) -> Any:
    """Return the type of a number without the axes over which it varies."""
    return jax.core.ShapedArray(number.shape, number.dtype, number.weak_type) if _axes(number) else number


def axes_of(*trees: PyTree) -> Axes:
    """Mesh axes over which any number of the trees varies."""
    return Axes().union(*(_axes(jax.typeof(leaf)) for leaf in jax.tree.leaves(trees)))


def like(tree: State, *others: PyTree) -> State:
    """Return a tree whose numbers vary over all axes over which one of them, or of the others, does."""
    axes = axes_of(tree, others)
    return jax.tree.map(lambda leaf: _cast(leaf, axes), tree) if axes else tree


def while_loop(running: Callable[[State], Any], body: Callable[[State], State], start: State) -> State:
    """`jax.lax.while_loop`."""
    return jax.lax.while_loop(running, body, _settled(body, start))


def fori_loop(lower: Any, upper: Any, body: Callable[[Any, State], State], start: State) -> State:
    """`jax.lax.fori_loop`."""
    return jax.lax.fori_loop(lower, upper, body, _settled(lambda state: body(lower, state), start))


def scan(body: Callable[[State, Any], tuple[State, Any]], start: State, rows: PyTree, **options: Any) -> Any:
    """`jax.lax.scan`."""

    def first(state: State) -> State:
        return body(state, jax.tree.map(lambda leaf: leaf[0], rows))[0]

    return jax.lax.scan(body, _settled(first, start), rows, **options)


def _settled(step: Callable[[State], State], start: State) -> State:
    """The start of a loop, each number of the type that the loop gives it."""
    if not jax.sharding.get_abstract_mesh().manual_axes:
        return start
    while True:
        after = jax.eval_shape(step, start)
        settled = jax.tree.map(lambda leaf, following: _cast(leaf, _axes(following)), start, after)
        if [*map(axes_of, jax.tree.leaves(settled))] == [*map(axes_of, jax.tree.leaves(start))]:
            return start
        start = settled


def _cast(leaf: Any, axes: Axes) -> Any:
    missing = tuple(axes - axes_of(leaf))
    return jax.lax.pcast(leaf, missing, to="varying") if missing else leaf


def _axes(number: Any) -> Axes:
    """Axes of the type of a number, or of a shape; JAX 0.11 and later keep them with others."""
    found = number.vma if hasattr(number, "vma") else getattr(number.manual_axis_type, "varying", None)
    return found or Axes()
