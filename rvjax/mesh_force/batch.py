"""Equilibrium of a case: its derivatives, and how batches of cases are laid out.

A batch is solved in blocks small enough for the cache, as arrays (rollers, cases): arithmetic then runs along
the cases, and a sum over the rollers is a sum of rows. `jax.vmap` alone would put the cases first, where sums
over two dozen rollers cost several times as much; the rule in `_batched` chooses the layout.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from rvjax.batching import along_lanes
from rvjax.mesh_force import laws
from rvjax.mesh_force.block import Found, solve_block
from rvjax.mesh_force.case import Case, lever
from rvjax.mesh_force.laws import Compliance
from rvjax.records import PyTree

_BLOCK = 512  # cases; a block's arrays (26, 512) stay in the cache of one core


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def attach(
    law: str,
    arm: jax.Array,
    gap: jax.Array,
    compliance: Compliance,
    torque: jax.Array,
    windup: jax.Array,
    load: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Windup and loads unchanged, with the derivatives of the equilibrium.

    By the implicit function theorem, du_i = S_i (a_i dtau + tau da_i + dg_i - dD_i), with dtau from the
    derivative of the moment; 0 for an unloaded roller. Forward, reverse and repeated.

    Args:
        law: one of `laws.CONTACTS`.
        arm: moment arms (n,).
        gap: interference (n,).
        compliance: of the rollers.
        torque: ().
        windup: () of the equilibrium.
        load: (n,) of the equilibrium.
    """
    return windup, load


@attach.defjvp
def _attach_jvp(law: str, primals: PyTree, tangents: PyTree) -> PyTree:
    arm, gap, compliance, _, _, _ = primals
    darm, dgap, dcompliance, dtorque, _, _ = tangents
    windup, load = attach(law, *primals)
    rate = jnp.where(load > 0, 1 / laws.slope(law, load, compliance), 0)
    _, dapproach = jax.jvp(lambda c: laws.approach(law, load, c), (compliance,), (dcompliance,))
    ddepth = windup * darm + dgap - dapproach
    arm = lever(arm)
    slope = jnp.sum(arm**2 * rate)
    dmissing = dtorque - jnp.sum(load * darm) - jnp.sum(arm * rate * ddepth)
    # Nothing loaded: the windup is where the first roller touches.
    first = (arm > 0) & (windup * arm + gap >= -1e-12 * jnp.abs(gap))
    touching = jnp.sum(jnp.where(first, arm, 0))
    dedge = -jnp.sum(jnp.where(first, windup * darm + dgap, 0)) / jnp.where(touching > 0, touching, 1)
    dwindup = jnp.where(slope > 0, dmissing / jnp.where(slope > 0, slope, 1), dedge)
    return (windup, load), (dwindup, rate * (arm * dwindup + ddepth))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def equilibrium(law: str, teeth: int, case: Case) -> Found:
    """Return the equilibrium of a case, (n,) loads; carries no derivative.

    Args:
        law: one of `laws.CONTACTS`.
        teeth: z.
        case: the case.
    """
    found = _batched(law, teeth)(jax.tree.map(lambda leaf: leaf[None], case))
    return jax.tree.map(lambda leaf: leaf[0], found)


@equilibrium.defjvp
def _equilibrium_jvp(law: str, teeth: int, primals: PyTree, tangents: PyTree) -> PyTree:
    found = equilibrium(law, teeth, *primals)
    return found, jax.custom_derivatives.zero_from_primal(found)


@functools.lru_cache(maxsize=64)
def _batched(law: str, teeth: int) -> Callable[[Case], Found]:
    """Batch (cases, ...) -> Found (cases, ...); vmap makes a larger batch of it."""
    return along_lanes(functools.partial(_in_blocks, law, teeth))


def _in_blocks(law: str, teeth: int, case: Case) -> Found:
    size = max(len(leaf) for leaf in case)
    if size <= _BLOCK:
        return solve_block(law, teeth, case, size)
    blocks = -(-size // _BLOCK)

    def cut(leaf: jax.Array) -> jax.Array:
        leaf = jnp.concatenate([leaf, jnp.broadcast_to(leaf[-1:], (blocks * _BLOCK - size, *leaf.shape[1:]))])
        return leaf.reshape(blocks, _BLOCK, *leaf.shape[1:])

    shared = [len(leaf) == 1 for leaf in case]

    def block(parts: list[jax.Array]) -> Found:
        rest = iter(parts)
        whole = Case(*(leaf if is_shared else next(rest) for leaf, is_shared in zip(case, shared)))
        return solve_block(law, teeth, whole, _BLOCK)

    found = jax.lax.map(block, [cut(leaf) for leaf, is_shared in zip(case, shared) if not is_shared])
    return jax.tree.map(lambda leaf: leaf.reshape(blocks * _BLOCK, *leaf.shape[2:])[:size], found)
