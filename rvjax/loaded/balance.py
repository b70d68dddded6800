"""Equilibrium of a case: found by Newton's method for many at once, differentiated by the implicit function theorem."""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.loaded.contacts import contacts, gradient, hessian
from rvjax.loaded.elimination import solve
from rvjax.loaded.lanes import in_lanes, take
from rvjax.loaded.newton import Found, minimise
from rvjax.loaded.system import Layout, System

_BLOCK = 128  # lanes; a block's arrays stay in the cache of one core


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def balance(layout: Layout, system: System, start: jax.Array) -> Found:
    """The minimum of the energy; carries no derivative.

    Args:
        layout: counts and methods.
        system: the case.
        start: (n,), or NaN: the linear solution of `linear_start`.
    """
    return in_lanes(minimise, layout)(system, start)


@balance.defjvp
def _balance_jvp(layout: Layout, primals: Any, tangents: Any) -> Any:
    found = balance(layout, *primals)
    return found, jax.custom_derivatives.zero_from_primal(found)


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
    cases = max(len(leaf) for leaf in jax.tree.leaves((system, q, load)))
    width = min(cases, _BLOCK)

    def block(first: jax.Array) -> jax.Array:
        index = jnp.minimum(first + jnp.arange(width, dtype=jnp.int32), cases - 1)
        part, at, right = take((system, q, load), index)
        at, right = (jnp.broadcast_to(x, (len(x), width)) for x in (at, right))
        pressed = jax.lax.optimization_barrier(contacts(layout, part, at))
        square = jax.lax.optimization_barrier(hessian(layout, part, at, pressed))
        return solve(layout, square, right).T

    if cases == width:
        return block(jnp.zeros((), jnp.int32))
    found = jax.lax.map(block, jnp.arange(-(-cases // width), dtype=jnp.int32) * width)
    return found.reshape(-1, layout.unknowns)[:cases]


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
