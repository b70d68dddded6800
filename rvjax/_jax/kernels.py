"""Functions of whole batches: a primitive with a rule of its own for `jax.vmap`, stored results, folded sums, loops.

`BatchedKernel` is a primitive whose parameter is a function. Its types come from a function of shapes, `jax.vmap` calls
its rule, which calls the kernel again with a larger batch, and the function is traced once, where the whole program is
lowered. Gain: tracing and lowering the values of a loaded study takes 6.5 instead of 13.1 CPU s, its gradients 6.3
instead of 6.8. The other functions keep XLA from computing a number again for each of its readers, or from reductions
without vectors; each states its gain.

Within `jax.shard_map` the checks of JAX give a number a type: the mesh axes over which it varies. JAX brings the
operands of an operation to one type, but neither the state of a loop nor the right side of a linear solve; the loops
here and `like` do. Outside of `jax.shard_map` they leave all as it is. No gain in time: the models pass these checks.
"""

import functools
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax._src import config
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

from rvjax._jax import sizes
from rvjax.records import PyTree

Result = TypeVar("Result")
State = TypeVar("State")
Axes = frozenset[Any]


_batched_kernel = Primitive("batched_kernel")
_batched_kernel.multiple_results = True


class BatchedKernel:
    """A function with a rule of its own under `jax.vmap`, traced once: when the program that calls it is lowered.

    `jax.custom_batching.custom_vmap` traces it for one case and again at every level of `jax.vmap`: two or three times
    as long for a batch of `loaded`. It has no derivatives.
    """

    def __init__(self, function: Callable[..., object], shapes: Callable[..., object]) -> None:
        """A function of arrays.

        Args:
            function: to compute.
            shapes: of its results, from its arguments.
        """
        self._function, self._shapes = jax.jit(function), shapes
        self.rule: Callable[..., PyTree] | None = None
        """(size, whether each argument is batched, first axis; *arguments) -> results, batch first."""

    def __call__(self, *arguments: object) -> PyTree:
        """The results."""
        leaves, tree = jax.tree.flatten(like(arguments))
        found = _batched_kernel.bind(*leaves, kernel=self, tree=tree)
        return jax.tree.unflatten(jax.tree.structure(self._shapes(*arguments)), found)

    def flat(self, *leaves: object, tree: object) -> list[jax.Array]:
        """Leaves of the results."""
        return jax.tree.leaves(self._function(*jax.tree.unflatten(tree, leaves)))

    def types(self, *leaves: Any, tree: object) -> list[Any]:
        """Types of these."""
        found = jax.tree.leaves(self._shapes(*jax.tree.unflatten(tree, leaves)))
        return [leaves[0].update(shape=leaf.shape, dtype=leaf.dtype, weak_type=False) for leaf in found]


@functools.partial(jax.jit, static_argnames=("kernel", "tree"))
def _computed(*leaves: object, kernel: BatchedKernel, tree: object) -> list[jax.Array]:
    return _batched_kernel.bind(*leaves, kernel=kernel, tree=tree)


def _lowered(platform: str) -> Callable[..., Any]:
    """The rule that lowers the function for a platform."""

    def computed(*leaves: object, kernel: BatchedKernel, tree: object) -> list[jax.Array]:
        with sizes.lowering(platform):
            return kernel.flat(*leaves, tree=tree)

    lower = mlir.lower_fun(computed, multiple_results=True)

    def rule(ctx: Any, *leaves: Any, **parameters: Any) -> object:
        with unchecked():
            return lower(ctx.replace(avals_in=[*map(unvarying, ctx.avals_in)]), *leaves, **parameters)

    return rule


def _batched(leaves: Any, axes: Any, *, kernel: BatchedKernel, tree: object) -> tuple[list[jax.Array], list[int]]:
    own = [axis is not None for axis in axes]
    size = next(leaf.shape[axis] for leaf, axis, is_own in zip(leaves, axes, own) if is_own)
    moved = [jnp.moveaxis(leaf, axis, 0) if is_own else leaf for leaf, axis, is_own in zip(leaves, axes, own)]
    assert kernel.rule is not None
    found = jax.tree.leaves(kernel.rule(size, jax.tree.unflatten(tree, own), *jax.tree.unflatten(tree, moved)))
    return found, [0] * len(found)


_batched_kernel.def_impl(_computed)
_batched_kernel.def_abstract_eval(lambda *leaves, kernel, tree: kernel.types(*leaves, tree=tree))
batching.primitive_batchers[_batched_kernel] = _batched
mlir.register_lowering(_batched_kernel, _lowered(sizes.GPU))
mlir.register_lowering(_batched_kernel, _lowered(sizes.CPU), platform=sizes.CPU)


def along_lanes(function: Callable[..., Result]) -> Callable[..., Result]:
    """Make a function of batches whose batch grows under `jax.vmap`: every vmap joins the one axis of the batch.

    Sums over the rollers of a case then run along the cases.

    Args:
        function: of pytrees whose leaves have the batch first, its size or 1 where all share it, to a pytree
            whose leaves have the whole batch.
    """
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _rule(size: int, is_batched: PyTree, *arguments: PyTree) -> tuple[PyTree, PyTree]:
        if not any(jax.tree.leaves(is_batched)):  # tangents alone are a batch: another call would come here for ever
            found = function(*arguments)
            return found, jax.tree.map(lambda _: False, found)
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
    """Return x, stored in memory: XLA otherwise evaluates it again in each kernel that reads it.

    XLA removes any barrier except a loop. The gradient of a crank turn takes 174 ns in the place of 307. A GPU, where
    each loop starts kernels, has x itself.
    """
    return jax.lax.platform_dependent(x, cpu=lambda x: jax.lax.fori_loop(0, 2, lambda _, x: -x, x), default=lambda x: x)


def once_more(
    function: Callable[[PyTree], jax.Array], arguments: object, found: jax.Array, todo: jax.Array
) -> jax.Array:
    """Return `found`, or `function(arguments)` in the batch elements `todo`, at the cost of their neighbourhood only.

    A crank turn takes 57 ns with windows of 32 batch elements, 63 ns with 128.

    Args:
        function: of one case to a number.
        arguments: of the function; pytree of numbers and arrays.
        found: ().
        todo: () bool.
    """

    def repair(arguments: object, found: jax.Array, todo: jax.Array) -> jax.Array:
        lanes = max(len(leaf) for leaf in jax.tree.leaves((arguments, found, todo)))
        found, todo = (jnp.broadcast_to(x, (lanes,)) for x in (found, todo))
        window = min(sizes.REPAIRED, lanes)
        of_window = jnp.any(sizes.padded(todo, window, fill=False).reshape(-1, window), axis=1)

        def step(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            found, left = state
            number = jnp.argmax(left)
            start = jnp.minimum(number * window, lanes - window)

            def cut(leaf: jax.Array) -> jax.Array:
                return leaf if len(leaf) == 1 else jax.lax.dynamic_slice_in_dim(leaf, start, window)

            axes = jax.tree.map(lambda leaf: None if len(leaf) == 1 and lanes > 1 else 0, arguments)
            some = jax.tree.map(lambda leaf, axis: cut(leaf)[0] if axis is None else cut(leaf), arguments, axes)
            new = jax.vmap(function, (axes,), axis_size=window)(some)
            new = jnp.where(cut(todo), new, cut(found))  # no batch element depends on its neighbours
            return jax.lax.dynamic_update_slice_in_dim(found, new, start, 0), left.at[number].set(False)

        return jax.lax.while_loop(lambda state: jnp.any(state[1]), step, (found, of_window))[0]

    first = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (arguments, found, todo))
    return along_lanes(repair)(*first)[0]


_WHOLE: dict[Callable[..., jax.Array], Callable[..., jax.Array]] = {
    jnp.add: jnp.sum,
    jnp.maximum: jnp.max,
    jnp.minimum: jnp.min,
    jnp.logical_and: jnp.all,
    jnp.logical_or: jnp.any,
}


def folded(x: jax.Array, *axes: int, by: Callable[..., jax.Array] = jnp.add) -> jax.Array:
    """Sum or another reduction over leading axes, halves onto halves: XLA's own has no vectors along the batch.

    A maximum of 80 x 64 numbers takes 0.2 us in the place of 10, one over the speeds of 128 units an eighth. One batch
    element has no vectors, and the derivatives of a sum are simpler. A GPU has XLA's own.

    Args:
        x: batch last.
        axes: all but the last, ascending.
        by: one of `_WHOLE`.
    """
    if x.shape[-1] == 1 or not sizes.for_processor():
        return _WHOLE[by](x, axis=axes)
    for axis in reversed(axes):
        rest = []
        while x.shape[axis] > 1:
            half = x.shape[axis] // 2
            if x.shape[axis] % 2:
                rest.append(jax.lax.slice_in_dim(x, 2 * half, 2 * half + 1, axis=axis))
            x = by(jax.lax.slice_in_dim(x, 0, half, axis=axis), jax.lax.slice_in_dim(x, half, 2 * half, axis=axis))
        x = jax.lax.squeeze(functools.reduce(by, rest, x), (axis,))
    return x


def stored(compute: Callable[..., Result], *arguments: object) -> Result:
    """Return compute(*arguments), written to memory: by a branch that is always taken, which XLA cannot see.

    Without it, and with `optimization_barrier` too, XLA computes what several results share again for each of them: a
    Newton step of the loaded reducer takes 8.7 us in the place of 6.5. A GPU only computes: 3.3 us a unit of 24 angles
    in the place of 4.2.

    Args:
        compute: to arrays; what does not depend on the arguments is computed in every pass of a loop around it.
        arguments: with a floating point array.
    """
    if not sizes.for_processor():
        return compute(*arguments)
    number = next(x for x in jax.tree.leaves(arguments) if jnp.issubdtype(x.dtype, jnp.floating)).ravel()[0]
    compute = jax.jit(compute)  # traced once
    shapes = jax.eval_shape(compute, *arguments)
    always = (number == number) | (number != number)
    return jax.lax.cond(
        always, compute, lambda *_: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes), *arguments
    )


def block_by_block(function: Callable[[State], Result], arguments: State, width: int) -> Result:
    """`function` of a batch, a block of cases at a time: what a block needs stays in the cache.

    Args:
        function: of leaves with `width` cases first, or 1 where all share it, to leaves with as many cases.
        arguments: leaves with the cases first, or 1.
        width: cases of a block, at most those of the batch.
    """
    cases = max(len(leaf) for leaf in jax.tree.leaves(arguments))
    if cases == width:
        return function(arguments)

    @jax.jit  # traced once
    def block(first: jax.Array) -> Result:
        def part(leaf: jax.Array) -> jax.Array:
            return leaf if len(leaf) == 1 else jax.lax.dynamic_slice_in_dim(leaf, first, width)

        return function(jax.tree.map(part, arguments))

    def write(number: jax.Array, results: Result) -> Result:
        first = jnp.minimum(number * width, cases - width)  # the last block overlaps: no case depends on its neighbours
        return jax.tree.map(
            lambda all_, new: jax.lax.dynamic_update_slice_in_dim(all_, new, first, 0), results, block(first)
        )

    shapes = jax.eval_shape(block, 0)
    nothing = jax.tree.map(lambda x: jnp.zeros((cases, *x.shape[1:]), x.dtype), shapes)
    return jax.lax.fori_loop(0, -(-cases // width), write, nothing)


def in_blocks(function: Callable[..., object], size: int, *arrays: np.ndarray) -> PyTree:
    """Evaluate rows block by block on the host: one program for any number of rows, bounded memory.

    Args:
        function: of arrays with `size` rows each, to a pytree of arrays with as many.
        size: rows of a block.
        *arrays: (rows, ...), at least one row.

    Returns:
        The pytree of NumPy arrays with all rows.
    """
    rows = len(arrays[0])
    parts = [jax.device_get(function(*(array[index] for array in arrays))) for index in sizes.calls(rows, size)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:rows], *parts)


def unchecked() -> AbstractContextManager[None]:
    """A context that traces without these types: what one device computes with its own numbers."""
    return config._check_vma(False)


def unvarying(number: Any) -> Any:
    """Return the type of a number without the axes over which it varies."""
    return jax.core.ShapedArray(number.shape, number.dtype, number.weak_type) if _axes(number) else number


def axes_of(*trees: object) -> Axes:
    """Mesh axes over which any number of the trees varies."""
    return Axes().union(*(_axes(jax.typeof(leaf)) for leaf in jax.tree.leaves(trees)))


def like(tree: State, *others: object) -> State:
    """Return a tree whose numbers vary over all axes over which one of them, or of the others, does."""
    axes = axes_of(tree, others)
    return jax.tree.map(lambda leaf: _cast(leaf, axes), tree) if axes else tree


def while_loop(running: Callable[[State], object], body: Callable[[State], State], start: State) -> State:
    """`jax.lax.while_loop`."""
    return jax.lax.while_loop(running, body, _settled(body, start))


def fori_loop(lower: object, upper: object, body: Callable[[Any, State], State], start: State) -> State:
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


def _cast(leaf: object, axes: Axes) -> Any:
    missing = tuple(axes - axes_of(leaf))
    return jax.lax.pcast(leaf, missing, to="varying") if missing else leaf


def _axes(number: Any) -> Axes:
    """Axes of the type of a number, or of a shape; JAX 0.11 and later keep them with others."""
    found = number.vma if hasattr(number, "vma") else getattr(number.manual_axis_type, "varying", None)
    return found or Axes()
