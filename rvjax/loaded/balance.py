"""Equilibrium of a case: found by Newton's method for many at once, differentiated by the implicit function theorem."""

import functools
from typing import NamedTuple

import jax
from jax.typing import DTypeLike

from rvjax._jax.kernels import like
from rvjax.loaded.batching import in_blocks, in_lanes
from rvjax.loaded.contacts import Contacts, contacts, gradient
from rvjax.loaded.elimination import solve
from rvjax.loaded.hessian import hessian
from rvjax.loaded.newton import Found, minimise
from rvjax.loaded.system import Layout, System
from rvjax.records import PyTree


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def balance(layout: Layout, system: System, start: jax.Array) -> Found:
    """The minimum of the energy; carries no derivative.

    Args:
        layout: counts and methods.
        system: the case.
        start: (n,), NaN: the linear step of `newton`, or inf: nothing is solved.
    """
    return in_lanes(minimise, layout, Found.shapes)(system, start)


@balance.defjvp
def _balance_jvp(layout: Layout, primals: PyTree, tangents: PyTree) -> tuple[Found, PyTree]:
    found = balance(layout, *primals)
    return found, jax.custom_derivatives.zero_from_primal(found)


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
    def shapes(cls, layout: Layout, dtype: DTypeLike) -> PyTree:
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
def _forces_jvp(layout: Layout, primals: PyTree, tangents: PyTree) -> tuple[Forces, Forces]:
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
        return solve(layout, hessian(layout, part, contacts(layout, part, q)), right)

    return in_blocks(block, (system, q, load))


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
def _attach_jvp(layout: Layout, primals: PyTree, tangents: PyTree) -> tuple[jax.Array, jax.Array]:
    system, q = primals
    q = attach(layout, system, q)
    _, change = jax.jvp(lambda s: residual(layout, s, q), (system,), (tangents[0],))
    return q, -compliance(layout, system, q, change)
