"""Equilibrium of a case: found by Newton's method in blocks of lanes, differentiated by the implicit function theorem."""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.loaded import laws
from rvjax.loaded.contacts import contacts, displacements, gradient, hessian
from rvjax.loaded.elimination import solve
from rvjax.loaded.lanes import in_blocks, in_lanes
from rvjax.loaded.newton import Found, linear_start, minimise
from rvjax.loaded.system import Layout, System

_BLOCK = 128  # lanes; a block's arrays stay in the cache of one core
_CHUNK = 32  # slow lanes that are solved together in the end


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def balance(layout: Layout, system: System, start: jax.Array) -> Found:
    """The minimum of the energy; carries no derivative.

    Args:
        layout: counts and methods.
        system: the case.
        start: (n,), or NaN: the linear solution of `linear_start`.
    """
    return in_lanes(_balance, layout)(system, start)


@balance.defjvp
def _balance_jvp(layout: Layout, primals: Any, tangents: Any) -> Any:
    found = balance(layout, *primals)
    return found, jax.custom_derivatives.zero_from_primal(found)


def _balance(layout: Layout, system: System, start: jax.Array) -> Found:
    lanes = max(leaf.shape[-1] for leaf in jax.tree.leaves((system, start)))
    start = jnp.broadcast_to(start, (len(start), lanes))
    system = system._replace(gap=jnp.broadcast_to(system.gap, (*system.gap.shape[:-1], lanes)))
    few = lanes <= 2 * _CHUNK

    def block(arguments: tuple[System, jax.Array]) -> Found:
        part, begin = arguments
        return minimise(layout, part, _begin(layout, part, begin), leave=0 if few else begin.shape[-1] // 8)

    found = in_blocks(block, lanes, _BLOCK, (system, start))
    return found if few else _rest(layout, system, found)


def _begin(layout: Layout, system: System, start: jax.Array) -> jax.Array:
    """`start`, where it is usable, else the linear solution."""
    good = jnp.all(jnp.isfinite(start), axis=0)
    warm = jnp.where(good[None], start, 0)
    if layout.law == "hertz":
        depth = displacements(layout, system, warm)[0]
        limit = laws.largest_depth(system.compliance[None, None], system.level)
        good &= ~jnp.any(depth >= limit, axis=(0, 1))
    return jax.lax.cond(jnp.all(good), lambda: warm, lambda: jnp.where(good[None], warm, linear_start(layout, system)))


def _rest(layout: Layout, system: System, found: Found) -> Found:
    """`found` with the lanes left open solved too, some at a time: they would have held up their blocks."""
    lanes = found.open.shape[-1]

    def some(found: Found) -> Found:
        (picked,) = jnp.nonzero(found.open, size=_CHUNK, fill_value=lanes)
        safe = jnp.minimum(picked, lanes - 1)
        taken = jax.tree.map(lambda leaf: leaf if leaf.shape[-1] == 1 else leaf[..., safe], system)
        part = minimise(layout, taken, found.q[:, safe])
        part = part._replace(steps=part.steps + found.steps[safe])
        return jax.tree.map(lambda all_, new: all_.at[..., picked].set(new, mode="drop"), found, part)

    return jax.lax.while_loop(lambda found: jnp.any(found.open), some, found)


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

    def times(v: jax.Array) -> jax.Array:
        return jax.jvp(lambda x: residual(layout, system, x), (q,), (v,))[1]

    def divided(_: Any, b: jax.Array) -> jax.Array:
        return in_lanes(_compliance, layout)(jax.lax.stop_gradient(system), jax.lax.stop_gradient(q), b)

    return jax.lax.custom_linear_solve(times, load, divided, symmetric=True)


def _compliance(layout: Layout, system: System, q: jax.Array, load: jax.Array) -> jax.Array:
    lanes = max(leaf.shape[-1] for leaf in jax.tree.leaves((system, q, load)))
    q, load = (jnp.broadcast_to(x, (len(x), lanes)) for x in (q, load))

    def block(arguments: tuple[System, jax.Array, jax.Array]) -> jax.Array:
        part, at, right = arguments
        return solve(layout, hessian(layout, part, at, contacts(layout, part, at)), right)

    return in_blocks(block, lanes, _BLOCK, (system, q, load))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def attach(layout: Layout, system: System, q: jax.Array) -> jax.Array:
    """q unchanged, with the derivatives of the equilibrium: dq = -H^-1 d(grad E) at fixed q. Eq. 23.

    Args:
        layout: counts and methods.
        system: the case.
        q: its equilibrium (n,).
    """
    return q


@attach.defjvp
def _attach_jvp(layout: Layout, primals: Any, tangents: Any) -> Any:
    system, q = primals
    q = attach(layout, system, q)
    _, change = jax.jvp(lambda s: residual(layout, s, q), (system,), (tangents[0],))
    return q, -compliance(layout, system, q, change)
