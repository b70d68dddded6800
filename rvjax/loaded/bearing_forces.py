"""Forces of the crank bearings at several input angles and torques: what a bearing life is computed from."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded.balance import forces
from rvjax.loaded.case import placed, solve
from rvjax.loaded.inputs import Read
from rvjax.loaded.kinds import named, prepare
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout
from rvjax.roots import solved
from rvjax.status import SolveInfo, Status, succeeded


class BearingForces(NamedTuple):
    """At n angles under t torques, in the frame of the ideal carrier; 0 where an equilibrium failed or carries nothing.

    The displacements carry no derivative; they are a start for torques near these.
    """

    arm: jax.Array  # (n, t, d, c, 2) N, crank on disc
    support: jax.Array  # (n, t, c, 2) N, crank on carrier
    info: SolveInfo  # (n, t)
    displacements: jax.Array | None  # (n, t, unknowns), NaN where an equilibrium failed; None: not needed


def bearing_forces(
    layout: Layout,
    read: Read,
    torques: jax.Array,
    input_angles: jax.Array,
    start: jax.Array | None = None,
    *,
    near: bool = False,
) -> BearingForces:
    """Equilibria at every angle under every torque.

    Args:
        layout: counts and methods.
        read: finite and possible numbers; its torque and angle are not read.
        torques: of the discs on the carrier, (t,) N m.
        input_angles: of the sun, (n,) rad, constants.
        start: displacements (n, t, unknowns) to start from; NaN or None: the linear step, or those at the angle before.
        near: start from the angle before, because the crank angle differs little.
    """
    none = jnp.full((len(torques), layout.unknowns), jnp.nan, torques.dtype)
    of_torques = jax.lax.stop_gradient(torques)

    def onward(last: jax.Array, at: tuple[jax.Array, jax.Array | None]) -> tuple[jax.Array, tuple[Found, SolveInfo]]:
        angle, given = at
        case = jax.lax.stop_gradient(prepare(layout, read, angle))

        def under(torque: jax.Array, start: jax.Array) -> tuple[Found, SolveInfo]:
            return solve(layout, read, case.loaded(torque), start)

        begin = last if given is None else jnp.where(jnp.isfinite(given), given, last)
        found, info = jax.vmap(under)(of_torques, begin)
        here = jnp.where(succeeded(info.status)[:, None], found.q, jnp.nan) if near else none
        return here, (found, info)

    found, info = solved(jax.lax.scan(onward, none, (input_angles, start))[1])
    measure = jax.checkpoint(partial(_measure, layout))
    arm, support = jax.lax.map(lambda x: measure(read, torques, *x), (input_angles, found, info.status))
    q = jnp.where(succeeded(info.status)[..., None], found.q, jnp.nan)
    return BearingForces(arm, support, info, jax.lax.stop_gradient(q))


def _measure(
    layout: Layout, read: Read, torques: jax.Array, angle: jax.Array, found: Found, status: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Forces at one angle under every torque, with their derivatives."""
    case = prepare(layout, read, angle)

    def of_one(torque: jax.Array, found: Found, status: jax.Array) -> tuple[jax.Array, jax.Array]:
        loaded = case.loaded(torque)
        q = placed(layout, loaded, found, status)
        of_names = named(layout, read, loaded, forces(layout, loaded.system, q))
        both = of_names.disc_bearing, of_names.support_bearing
        return jax.tree.map(lambda force: jnp.where(status == Status.CONVERGED, force, 0), both)

    return jax.vmap(of_one)(torques, found, status)
