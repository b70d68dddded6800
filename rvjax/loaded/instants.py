"""Equilibria of one reducer at several instants: each has a torque and an input angle."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rvjax._jax.kernels import scan
from rvjax.loaded.balance import forces
from rvjax.loaded.case import placed, pressures, solve, turned
from rvjax.loaded.inputs import Read
from rvjax.loaded.kinds import named, prepare
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout
from rvjax.roots import solved
from rvjax.status import SolveInfo, Status, succeeded

Pair = tuple[jax.Array, jax.Array]


class Loads(NamedTuple):
    """Forces on the parts at one instant; fields as in `Revolution`."""

    largest_pin: jax.Array
    largest_pressure: jax.Array
    largest_arm_bearing: jax.Array
    largest_support_bearing: jax.Array
    crank_sharing: jax.Array | None
    disc_sharing: jax.Array
    largest_output_pin: jax.Array | None = None
    largest_output_pressure: jax.Array | None = None


class Instants(NamedTuple):
    """Results at n instants."""

    error: jax.Array  # rotation of the carrier against the ideal motion, (n,) rad
    loads: Loads  # (n,)
    arm: jax.Array  # (n, d, c, 2) N, crank on disc; 0 where an equilibrium failed or carries nothing
    support: jax.Array  # (n, c, 2) N, crank on carrier; likewise
    info: SolveInfo  # (n,)


def instants(
    layout: Layout, read: Read, torques: jax.Array, input_angles: jax.Array, before: NDArray[np.integer]
) -> Instants:
    """Equilibria one after the other, each from those before.

    Args:
        layout: counts and methods.
        read: finite and possible numbers; its torque and angle are not read.
        torques: of the discs on the carrier, (n,) N m.
        input_angles: of the sun, (n,) rad.
        before: (n,) instants that the start of each follows from: none (the linear step), the last, or the line through
            the last two.
    """

    def from_start(start: jax.Array, torque: jax.Array, angle: jax.Array) -> tuple[Found, SolveInfo]:
        case = prepare(layout, read, jax.lax.stop_gradient(angle)).loaded(torque)
        return solve(layout, read, jax.lax.stop_gradient(case), start)

    def onward(known: Pair, at: tuple[jax.Array, ...]) -> tuple[Pair, tuple[Found, SolveInfo]]:
        (last, earlier), (torque, angle, number) = known, at  # NaN where there is none
        start = jnp.where((number == 2) & jnp.isfinite(earlier), 2 * last - earlier, last)
        found, info = from_start(jnp.where(number == 0, jnp.nan, start), torque, angle)
        here = jnp.where(succeeded(info.status), found.q, jnp.nan)
        return (here, jnp.where(number == 0, jnp.nan, last)), (found, info)

    none = jnp.full((layout.unknowns,), jnp.nan, torques.dtype)
    if np.any(before):
        found, info = solved(scan(onward, (none, none), (torques, input_angles, jnp.asarray(before)))[1])
    else:  # one queue for all instants, so that slow ones are waited for once
        found, info = solved(jax.vmap(partial(from_start, none))(torques, input_angles))
    measure = jax.checkpoint(partial(_measure, layout), static_argnums=())
    error, loads, arm, support = jax.lax.map(lambda x: measure(read, *x), (torques, input_angles, found, info.status))
    return Instants(error, loads, arm, support, info)


def _measure(
    layout: Layout, read: Read, torque: jax.Array, angle: jax.Array, found: Found, status: jax.Array
) -> tuple[jax.Array, Loads, jax.Array, jax.Array]:
    """Error, loads and forces of an instant, with their derivatives."""
    case = prepare(layout, read, angle).loaded(torque)
    q = placed(layout, case, found, status)
    at = forces(layout, case.system, q)
    of_names = named(layout, read, case, at)
    arm, support = of_names.disc_bearing, of_names.support_bearing
    loads = Loads(
        largest_pin=jnp.max(at.pins),
        largest_pressure=jnp.max(pressures(case, at.pins)),
        largest_arm_bearing=_largest(arm),
        largest_support_bearing=_largest(support),
        crank_sharing=None if of_names.gear is None else _sharing(of_names.gear),
        disc_sharing=_sharing(jnp.sum(case.lever * at.pins, axis=1)),
        largest_output_pin=None if of_names.output_pins is None else jnp.max(of_names.output_pins),
        largest_output_pressure=None if of_names.output_pressure is None else jnp.max(of_names.output_pressure),
    )
    arm, support = (jnp.where(status == Status.CONVERGED, force, 0) for force in (arm, support))
    return turned(layout, case, q), loads, arm, support


def _largest(force: jax.Array) -> jax.Array:
    """Length of the longest of some vectors (..., 2)."""
    square = jnp.sum(force * force, axis=-1)
    return jnp.max(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0))


def _sharing(load: jax.Array) -> jax.Array:
    """Largest of some loads over their mean; 0 where they sum to nothing."""
    total = jnp.abs(jnp.sum(load))
    return jnp.where(total > 0, load.size * jnp.max(jnp.abs(load)) / jnp.where(total > 0, total, 1), 0)
