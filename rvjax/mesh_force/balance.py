"""Equilibrium of all rollers under one torque: the scalar root behind `solve`.

    approach(u_i) = tau a_i + g_i  where the right side is positive, else u_i = 0
    sum_i a_i u_i = torque

The moment of the loads is a nondecreasing function of the windup tau with slope sum a^2 S, S = stiffness
of a loaded roller: Newton steps inside a bracket find its root. First with linear contacts, where Newton
on a piecewise linear function ends exactly after a few steps; then, for a nonlinear law, in the shift x
from that windup, depths being x a_i + (tau_0 a_i + g_i). The shift is as small as the elastic approach, so
nothing cancels even where a clearance is many orders larger.

Derivatives are those of the solution, by the implicit function theorem,

    du_i = S_i (a_i dtau + tau da_i + dg_i - dD_i),  dtau from the derivative of the moment,

forward, reverse and repeated; 0 for an unloaded roller and where nothing is loaded.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.mesh_force import laws
from rvjax.mesh_force.laws import Compliance

_MAX_STEPS = 100


class Facts(NamedTuple):
    """How the balance was found; carries no derivative."""

    steps: jax.Array
    residual: jax.Array  # moment missing, relative to the larger of the torque and the sum of |moments|
    overload: jax.Array  # a load limit is passed
    finite: jax.Array


Balance = tuple[jax.Array, jax.Array, Facts]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def balance(law: str, arm: jax.Array, gap: jax.Array, roller: Compliance, torque: jax.Array) -> Balance:
    """Windup, loads (n,) and `Facts` of the equilibrium; all dimensionless.

    Args:
        law: one of `laws.CONTACTS`.
        arm: moment arms (n,) over the eccentricity.
        gap: interference (n,) over the roller radius, > 0 loads.
        roller: compliances, (n,) each.
        torque: () over eccentricity and load unit.
    """
    stiffness = 2 / roller.weight

    def linear(tau: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        depth = tau * arm + gap
        load = jnp.where(depth > 0, stiffness * depth, 0)
        return _moment(arm, load, jnp.where(depth > 0, stiffness, 0), torque)

    # Start: all rollers of the working half loaded; without errors this is the linear solution.
    working = jnp.where(arm * jnp.where(torque < 0, -1, 1) > 0, arm * stiffness, 0)
    start = (torque - jnp.sum(working * gap)) / jnp.sum(working * arm)
    size = jnp.max(jnp.abs(gap)) + jnp.abs(start)
    tau, linear_steps = _monotone_root(linear, start, size)

    shifted = tau * arm + gap

    def exact(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        load, rate, _ = laws.inverse(law, x * arm + shifted, roller)
        return _moment(arm, load, rate, torque)

    size = jnp.max(jnp.abs(shifted))
    x, steps = _monotone_root(exact, jnp.zeros_like(tau), size)
    load, rate, beyond = laws.inverse(law, x * arm + shifted, roller)
    missing, slope, _ = _moment(arm, load, rate, torque)
    # What rounding of x leaves is shared out along the stiffness.
    load = jnp.maximum(load - rate * arm * jnp.where(slope > 0, missing / jnp.where(slope > 0, slope, 1), 0), 0)
    missing, _, scale = _moment(arm, load, rate, torque)
    overload = jnp.any(beyond)
    finite = jnp.isfinite(tau + x) & jnp.all(jnp.isfinite(load))
    good = finite & ~overload  # a failed lane returns zeros, so that no derivative of it is NaN
    facts = Facts(
        steps=linear_steps + steps,
        residual=jnp.where(scale > 0, jnp.abs(missing) / jnp.where(scale > 0, scale, 1), 0),
        overload=overload,
        finite=finite,
    )
    return jnp.where(good, tau + x, 0), jnp.where(good, load, 0), facts


@balance.defjvp
def _balance_jvp(law: str, primals: Any, tangents: Any) -> tuple[Balance, Balance]:
    arm, gap, roller, torque = primals
    darm, dgap, droller, dtorque = tangents
    tau, load, facts = balance(law, arm, gap, roller, torque)
    loaded = load > 0
    rate = jnp.where(loaded, 1 / laws.slope(law, load, roller), 0)
    _, dapproach = jax.jvp(lambda r: laws.approach(law, load, r), (roller,), (droller,))
    ddepth = tau * darm + dgap - dapproach
    slope = jnp.sum(arm**2 * rate)
    dmissing = dtorque - jnp.sum(load * darm) - jnp.sum(arm * rate * ddepth)
    dtau = jnp.where(slope > 0, dmissing / jnp.where(slope > 0, slope, 1), 0)
    dload = rate * (arm * dtau + ddepth)
    return (tau, load, facts), (dtau, dload, jax.custom_derivatives.zero_from_primal(facts))


def _moment(
    arm: jax.Array, load: jax.Array, rate: jax.Array, torque: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Moment of the loads minus the torque, its slope in the windup, and the size to judge it by."""
    moments = arm * load
    scale = jnp.maximum(jnp.abs(torque), jnp.sum(jnp.abs(moments)))
    return jnp.sum(moments) - torque, jnp.sum(arm**2 * rate), scale


def _monotone_root(
    evaluate: Callable[[jax.Array], tuple[jax.Array, jax.Array, jax.Array]], start: jax.Array, size: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Root of a nondecreasing function by Newton steps inside a bracket that opens at infinity.

    A step that leaves the bracket, or follows one that did not halve the residual, is replaced by the
    middle of the bracket; while one end is open, by a stride that doubles.
    """
    tolerance = 4 * float(jnp.finfo(start.dtype).eps)

    def running(state: Any) -> jax.Array:
        return state[-1]

    def step(state: Any) -> Any:
        x, low, high, last, stride, steps, _ = state
        missing, slope, scale = evaluate(x)
        low, high = jnp.where(missing <= 0, x, low), jnp.where(missing >= 0, x, high)
        closed = jnp.isfinite(low) & jnp.isfinite(high)
        newton = x - missing / jnp.where(slope > 0, slope, 1)
        use = (slope > 0) & (newton >= low) & (newton <= high) & (~closed | (2 * jnp.abs(missing) <= last))
        middle = jnp.where(closed, (low + high) / 2, x - jnp.sign(missing) * stride)
        target = jnp.where(use, newton, middle)
        found = jnp.abs(missing) <= tolerance * scale
        done = found | (jnp.abs(target - x) <= tolerance * jnp.abs(target)) | ~jnp.isfinite(target)
        target = jnp.where(found, x, target)
        last = jnp.where(use, jnp.abs(missing), jnp.inf)
        return target, low, high, last, 2 * stride, steps + 1, ~done & (steps + 1 < _MAX_STEPS)

    infinity = jnp.full_like(start, jnp.inf)
    state = (start, -infinity, infinity, infinity, size, jnp.zeros((), jnp.int32), jnp.ones((), bool))
    final = jax.lax.while_loop(running, step, state)
    return final[0], final[-2]
