"""Equilibria at several input angles, each under several torques; the forces of the crank bearings among them."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax.loaded.balance import forces
from rvjax.loaded.case import Case, placed, solve
from rvjax.loaded.inputs import Read
from rvjax.loaded.kinds import named, prepare
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout
from rvjax.records import PyTree
from rvjax.roots import solved
from rvjax.status import SolveInfo, Status, succeeded

Take = Callable[[Case, jax.Array, jax.Array], PyTree]
"""(case, displacements (unknowns,), whether it carries) -> what is wanted of an equilibrium. If it does not, forces are
to count as 0; where an equilibrium failed, its displacements are 0."""


_Row = tuple[jax.Array, jax.Array | None, jax.Array | None, jax.Array | None]
"""Angle, start, torques and whether to follow the row before, as far as rows have their own."""


class Equilibria(NamedTuple):
    """At n angles under t torques. The displacements carry no derivative; they are a start for torques near these."""

    taken: PyTree  # leaves (n, t, ...)
    info: SolveInfo  # (n, t)
    displacements: jax.Array  # (n, t, unknowns), NaN where an equilibrium failed


def equilibria(
    layout: Layout,
    read: Read,
    torques: jax.Array,
    input_angles: jax.Array,
    take: Take,
    start: jax.Array | None = None,
    *,
    near: bool | np.ndarray = False,
) -> Equilibria:
    """Equilibria at every angle under every torque, in one loop, because each loop compiles for seconds.

    Args:
        layout: counts and methods.
        read: finite and possible numbers; its torque and angle are not read.
        torques: of the discs on the carrier, (t,) N m, or (n, t) where every angle has its own.
        input_angles: of the sun, (n,) rad, constants.
        take: from each equilibrium, with its derivatives.
        start: displacements (n, t, unknowns) to start from; NaN or None: the linear step, or those at the angle before.
        near: start from the angle before, because the crank angle differs little; or (n,) whether each does.
    """
    none = jnp.full((torques.shape[-1], layout.unknowns), jnp.nan, torques.dtype)
    own = None if torques.ndim == 1 else torques
    some = None if isinstance(near, bool) else jnp.asarray(near)

    def onward(last: jax.Array, at: _Row) -> tuple[jax.Array, tuple[Found, SolveInfo]]:
        angle, given, own, follows = at
        of_torques = jax.lax.stop_gradient(torques if own is None else own)
        last = last if follows is None else jnp.where(follows, last, none)
        case = jax.lax.stop_gradient(prepare(layout, read, angle))

        def under(torque: jax.Array, start: jax.Array) -> tuple[Found, SolveInfo]:
            return solve(layout, read, case.loaded(torque), start)

        begin = last if given is None else jnp.where(jnp.isfinite(given), given, last)
        found, info = jax.vmap(under)(of_torques, begin)
        here = jnp.where(succeeded(info.status)[:, None], found.q, jnp.nan) if near is not False else none
        return here, (found, info)

    found, info = solved(scan(onward, none, (input_angles, start, own, some))[1])
    measure = jax.checkpoint(partial(_measure, layout, take))
    taken = jax.lax.map(
        lambda x: measure(read, torques if x[0] is None else x[0], *x[1:]), (own, input_angles, found, info.status)
    )
    q = jnp.where(succeeded(info.status)[..., None], found.q, jnp.nan)
    return Equilibria(taken, info, jax.lax.stop_gradient(q))


def _measure(
    layout: Layout,
    take: Take,
    read: Read,
    torques: jax.Array,
    angle: jax.Array,
    found: Found,
    status: jax.Array,
) -> PyTree:
    """Results at one angle under every torque, with their derivatives."""
    case = prepare(layout, read, angle)

    def of_one(torque: jax.Array, found: Found, status: jax.Array) -> PyTree:
        loaded = case.loaded(torque)
        return take(loaded, placed(layout, loaded, found, status), status == Status.CONVERGED)

    return jax.vmap(of_one)(torques, found, status)


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
    """Forces of the crank bearings at every angle under every torque: what a bearing life is computed from.

    Args:
        layout: as in `equilibria`.
        read: as in `equilibria`.
        torques: as in `equilibria`.
        input_angles: as in `equilibria`.
        start: as in `equilibria`.
        near: as in `equilibria`.
    """

    def take(case: Case, q: jax.Array, carries: jax.Array) -> tuple[jax.Array, jax.Array]:
        of_names = named(layout, read, case, forces(layout, case.system, q))
        both = of_names.disc_bearing, of_names.support_bearing
        return jax.tree.map(lambda force: jnp.where(carries, force, 0), both)

    found = equilibria(layout, read, torques, input_angles, take, start, near=near)
    arm, support = found.taken
    return BearingForces(arm, support, found.info, found.displacements)
