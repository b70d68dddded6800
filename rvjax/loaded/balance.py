"""Equilibrium of a case: found by Newton's method for many at once, differentiated by the implicit function theorem.

A batch is laid out in groups that share a geometry, the elements of a group along the last axis. `jax.vmap` alone would
put the cases first, where sums over eighty pins cost several times as much, and would copy the geometry of an angle for
every unit. The rule of `in_lanes` lets it be shared: an axis over which the geometry does not vary becomes elements,
any other becomes groups.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from rvjax._jax.kernels import BatchedKernel, block_by_block, like
from rvjax._jax.sizes import EQUILIBRIA, GROUP
from rvjax.loaded.hessian import frame, hessian, solve
from rvjax.loaded.newton import Minimum, minimise
from rvjax.loaded.system import Contacts, Layout, System, contacts, gradient
from rvjax.records import PyTree

Kernel = Callable[..., PyTree]


@functools.lru_cache(maxsize=64)
def in_lanes(kernel: Kernel, layout: Layout, shapes: Callable[[Layout, object], object]) -> Kernel:
    """The function (system, *arrays) of one case that `kernel` computes for many.

    Args:
        kernel: (layout, system, *arrays) -> arrays, cases first; leaves of one case are shared by all.
        layout: counts and methods.
        shapes: (layout, dtype) -> shapes and dtypes of the results of one case.
    """

    def results(*arguments: object) -> object:
        leaves = jax.tree.leaves(arguments)
        batch = tuple(max(leaf.shape[axis] for leaf in leaves) for axis in (0, 1))
        one = shapes(layout, leaves[-1].dtype)
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*batch, *leaf.shape), leaf.dtype), one)

    grouped = BatchedKernel(functools.partial(_over_groups, kernel, layout), results)

    def rule(size: int, batched: list[PyTree], *arguments: object) -> object:
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

        result = grouped(*jax.tree.unflatten(tree, [merge(leaf, flag) for leaf, flag in zip(leaves, flags)]))

        def split(leaf: jax.Array) -> jax.Array:
            if by_group:
                return leaf.reshape(size, groups, *leaf.shape[1:])
            return jnp.swapaxes(leaf.reshape(groups, size, lanes, *leaf.shape[2:]), 0, 1)

        return jax.tree.map(split, result)

    grouped.rule = rule

    def of_one(*arguments: object) -> object:
        result = grouped(*jax.tree.map(lambda leaf: leaf[None, None], arguments))
        return jax.tree.map(lambda leaf: leaf[0, 0], result)

    return of_one


def _over_groups(kernel: Kernel, layout: Layout, system: System, *arrays: jax.Array) -> object:
    """Arguments (groups or 1, elements or 1, ...) -> results (groups, elements, ...)."""
    leaves, tree = jax.tree.flatten((system, *arrays))
    groups, lanes = (max(leaf.shape[axis] for leaf in leaves) for axis in (0, 1))
    if groups > 1 and lanes < GROUP:
        flat = [jnp.broadcast_to(leaf, (groups, lanes, *leaf.shape[2:])) for leaf in leaves]
        flat = [leaf.reshape(groups * lanes, *leaf.shape[2:]) for leaf in flat]
        found = kernel(layout, *jax.tree.unflatten(tree, flat))
        return jax.tree.map(lambda leaf: leaf.reshape(groups, lanes, *leaf.shape[1:]), found)
    batched_leaves = [len(leaf) > 1 for leaf in leaves]

    def group(given: list[jax.Array]) -> object:
        rest = iter(given)
        return kernel(
            layout, *jax.tree.unflatten(tree, [next(rest) if o else x[0] for x, o in zip(leaves, batched_leaves)])
        )

    if groups == 1:
        return jax.tree.map(lambda leaf: leaf[None], group([]))
    return jax.lax.map(group, [leaf for leaf, is_own in zip(leaves, batched_leaves) if is_own])


def in_blocks(kernel: Kernel, arguments: tuple[object, ...]) -> PyTree:
    """Apply `kernel` to leaves (cases or 1, ...), a block of cases at a time; results have the cases first.

    Args:
        kernel: takes the arguments, batch axis last; all but the first (the system) fill the block.
        arguments: system and arrays.
    """
    width = min(max(len(leaf) for leaf in jax.tree.leaves(arguments)), EQUILIBRIA.here)

    def block(arguments: tuple[object, ...]) -> PyTree:
        system, *arrays = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), arguments)
        result = kernel(system, *(jnp.broadcast_to(x, (*x.shape[:-1], width)) for x in arrays))
        return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), result)

    return block_by_block(block, arguments, width)


Inputs = tuple[System, jax.Array]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def balance(layout: Layout, system: System, start: jax.Array) -> Minimum:
    """The minimum of the energy; carries no derivative.

    Args:
        layout: counts and methods.
        system: the case.
        start: (n,), NaN: none, see `newton`, or inf: nothing is solved.
    """
    return in_lanes(minimise, layout, Minimum.shapes)(system, start)


@balance.defjvp
def _balance_jvp(layout: Layout, primals: Inputs, tangents: object) -> tuple[Minimum, Minimum]:
    minimum = balance(layout, *primals)
    return minimum, jax.custom_derivatives.zero_from_primal(minimum)


class Forces(NamedTuple):
    """Contact forces of one case, N."""

    pins: jax.Array  # (d, p)
    joints: jax.Array  # (j,)
    bearings: jax.Array  # (b, 2), sign of grad E

    @classmethod
    def of(cls, at: Contacts) -> "Forces":
        """Those of some contacts."""
        return cls(at.pins.force, at.joints.force, at.bearings.force)

    @classmethod
    def shapes(cls, layout: Layout, dtype: DTypeLike) -> "Forces":
        """Shapes of one case."""
        joints, bearings = layout.contacts(layout.joints), layout.contacts(layout.bearings)
        sizes = (layout.discs, layout.pins), (joints,), (bearings, 2)
        return cls(*(jax.ShapeDtypeStruct(size, dtype) for size in sizes))  # type: ignore[arg-type]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def forces(layout: Layout, system: System, q: jax.Array) -> Forces:
    """Forces of one case at q (n,); `jax.vmap` of it computes with the batch axis last.

    Args:
        layout: counts and methods.
        system: the case.
        q: its equilibrium (n,).
    """
    return in_lanes(_forces, layout, Forces.shapes)(system, q)


@forces.defjvp
def _forces_jvp(layout: Layout, primals: Inputs, tangents: Inputs) -> tuple[Forces, Forces]:
    def of_one(system: System, q: jax.Array) -> Forces:
        at = contacts(layout, jax.tree.map(lambda leaf: leaf[..., None], system), q[:, None])
        return jax.tree.map(lambda x: x[..., 0], Forces.of(at))

    return forces(layout, *primals), jax.jvp(of_one, primals, tangents)[1]


def _forces(layout: Layout, system: System, q: jax.Array) -> Forces:
    def block(part: System, q: jax.Array) -> Forces:
        return Forces.of(contacts(layout, part, q))

    return in_blocks(block, (system, q))


def residual(layout: Layout, system: System, q: jax.Array) -> jax.Array:
    """Gradient of the energy of one case, (n,) N."""
    return gradient(layout, jax.tree.map(lambda leaf: leaf[..., None], system), q[:, None])[:, 0]


def compliance(layout: Layout, system: System, q: jax.Array, load: jax.Array) -> jax.Array:
    """H^-1 load of one case, H the second derivatives of the energy at q; linear in `load` (n,), differentiable.

    Args:
        layout: counts and methods.
        system: the case.
        q: its equilibrium (n,).
        load: (n,) N.
    """

    system, q, load = like((system, q, load))

    def times(v: jax.Array) -> jax.Array:
        return jax.jvp(lambda x: residual(layout, system, x), (q,), (v,))[1]

    def divided(_: object, b: jax.Array) -> jax.Array:
        return in_lanes(_compliance, layout, _unknowns)(jax.lax.stop_gradient(system), jax.lax.stop_gradient(q), b)

    return jax.lax.custom_linear_solve(times, load, divided, symmetric=True)


def _unknowns(layout: Layout, dtype: DTypeLike) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((layout.unknowns,), dtype)


def _compliance(layout: Layout, system: System, q: jax.Array, load: jax.Array) -> jax.Array:
    def block(part: System, q: jax.Array, right: jax.Array) -> jax.Array:
        return solve(layout, hessian(layout, part, contacts(layout, part, q), frame(layout, part)), right)

    return in_blocks(block, (system, q, load))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def with_implicit_derivative(layout: Layout, system: System, q: jax.Array) -> jax.Array:
    """q unchanged, with the derivatives of the equilibrium: dq = -H^-1 d(grad E) at fixed q. Eq. 23.

    Args:
        layout: counts and methods.
        system: the case.
        q: its equilibrium (n,).
    """
    return q


@with_implicit_derivative.defjvp
def _with_implicit_derivative_jvp(layout: Layout, primals: Inputs, tangents: Inputs) -> tuple[jax.Array, jax.Array]:
    system, q = primals
    q = with_implicit_derivative(layout, system, q)
    _, change = jax.jvp(lambda s: residual(layout, s, q), (system,), (tangents[0],))
    return q, -compliance(layout, system, q, change)
