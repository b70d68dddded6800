"""Equilibrium of the cases that Newton steps left open: a bracket for the windup, every load solved exactly.

Rare cases only: no torque, a load limit passed, rollers that change sides at the last step, rounding.
Arrays are (rollers, cases), or (1, cases) for what a case has once.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.mesh_force import laws
from rvjax.mesh_force.laws import Compliance
from rvjax.records import PyTree

_STEPS = 100


class _Rollers(NamedTuple):
    arm: jax.Array
    gap: jax.Array
    compliance: Compliance


def solve(
    law: str, arm: jax.Array, gap: jax.Array, compliance: Compliance, torque: jax.Array, start: jax.Array
) -> dict[str, jax.Array]:
    """Windup, steps, residual, overload and finite (cases,), and load (n, cases).

    Args:
        law: one of `laws.CONTACTS`.
        arm: `case.lever` of the rollers (n, cases).
        gap: their interference (n, cases).
        compliance: of the rollers (n, cases), or common to some.
        torque: (cases,).
        start: windup near which to search, (cases,); 0 serves where it is not finite.
    """
    rollers = _Rollers(arm, gap, compliance)
    torque = torque[None]
    start = jnp.where(jnp.isfinite(start), start, 0)[None]
    solution = _bracketed(law, rollers, torque, start)
    windup, load = _rest(rollers, torque, solution["windup"], solution["load"])
    solution = {**solution, "windup": windup}
    rest = {"load": load, "residual": missing(rollers.arm, load, torque[0])}
    return {name: value[0] for name, value in solution.items() if name != "load"} | rest


def missing(arm: jax.Array, load: jax.Array, torque: jax.Array) -> jax.Array:
    """Moment missing, relative to the larger of the torque and the sum of |moments|, (cases,).

    Args:
        arm: (n, cases).
        load: (n, cases).
        torque: (cases,).
    """
    moment, size = jnp.zeros_like(torque), jnp.zeros_like(torque)
    for i in range(len(load)):
        part = arm[i] * load[i]
        moment, size = moment + part, size + jnp.abs(part)
    scale, rest = jnp.maximum(jnp.abs(torque), size), jnp.abs(moment - torque)
    return jnp.where(scale > 0, rest / jnp.where(scale > 0, scale, 1), 0)


def _bracketed(law: str, rollers: _Rollers, torque: jax.Array, start: jax.Array) -> dict[str, jax.Array]:
    arm, compliance = rollers.arm, rollers.compliance
    from_start = start * arm + rollers.gap
    tolerance = 4 * float(jnp.finfo(torque.dtype).eps)
    depth_rounding = tolerance / 4 * (jnp.abs(start * arm) + jnp.abs(rollers.gap))

    def running(state: dict[str, PyTree]) -> jax.Array:
        return jnp.any(state["running"])

    def step(state: dict[str, PyTree]) -> dict[str, PyTree]:
        x = state["x"]
        load, rate, beyond = laws.inverse(law, x * arm + from_start, compliance)
        missing = jnp.sum(arm * load, axis=0, keepdims=True) - torque
        slope = jnp.sum(arm**2 * rate, axis=0, keepdims=True)
        scale = jnp.maximum(jnp.abs(torque), jnp.sum(jnp.abs(arm * load), axis=0, keepdims=True))
        bracket, target = _advance(state["bracket"], x, missing, slope)
        finite, overload = jnp.isfinite(target) & jnp.isfinite(scale), jnp.any(beyond, axis=0, keepdims=True)
        done = (jnp.abs(missing) <= tolerance * scale) | (jnp.abs(target - x) <= tolerance * jnp.abs(target)) | ~finite
        # A step below the rounding of the depths never ends: depths may be small compared with gap and windup.
        done |= jnp.any(load > 0, axis=0, keepdims=True) & ~jnp.any(
            (load > 0) & (jnp.abs(arm * (target - x)) > depth_rounding), axis=0, keepdims=True
        )
        # What rounding of x leaves is shared out along the stiffness.
        rest = jnp.where(slope > 0, missing / jnp.where(slope > 0, slope, 1), 0)
        corrected = jnp.maximum(load - rate * arm * rest, 0)
        good = finite & ~overload  # a failed case returns zeros, so that no derivative of it is NaN
        new = {
            "x": jnp.where(done, jnp.where(good, x, 0), target),
            "load": jnp.where(done, jnp.where(good, corrected, 0), load),
            "bracket": bracket,
            "steps": state["steps"] + 1,
            "overload": overload,
            "finite": finite,
            "running": ~done & (state["steps"] < _STEPS),
        }
        return jax.tree.map(lambda after, before: jnp.where(state["running"], after, before), new, state)

    stride = jnp.abs(start) + jnp.max(jnp.abs(rollers.gap), axis=0, keepdims=True)
    state: dict[str, Any] = {
        "x": jnp.zeros_like(start),
        "load": jnp.zeros_like(rollers.gap),
        "bracket": _open_bracket(stride),
        "steps": jnp.zeros(start.shape, jnp.int32),
        "overload": jnp.zeros(start.shape, bool),
        "finite": jnp.ones(start.shape, bool),
        "running": jnp.ones(start.shape, bool),
    }
    state = jax.lax.while_loop(running, step, state)
    return {"windup": start + state["x"], **{name: state[name] for name in ("load", "steps", "overload", "finite")}}


def _rest(rollers: _Rollers, torque: jax.Array, windup: jax.Array, load: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Without torque and preload: no loads, and the windup at the upper edge of where nothing is loaded."""
    edge, slack = _dead_band(rollers)
    idle = slack & (torque == 0)
    return jnp.where(idle, edge, windup), jnp.where(idle & (rollers.arm != 0), 0, load)


def _dead_band(rollers: _Rollers) -> tuple[jax.Array, jax.Array]:
    """Upper edge of the range of windups at which nothing is loaded, and whether there is such a range."""
    forward, backward = rollers.arm > 0, rollers.arm < 0
    threshold = -rollers.gap / jnp.where(forward | backward, rollers.arm, 1)
    upper = jnp.min(jnp.where(forward, threshold, jnp.inf), axis=0, keepdims=True)
    lower = jnp.max(jnp.where(backward, threshold, -jnp.inf), axis=0, keepdims=True)
    return upper, lower <= upper


class _Bracket(NamedTuple):
    low: jax.Array
    high: jax.Array
    last: jax.Array  # |missing| before the last Newton step
    stride: jax.Array


def _open_bracket(stride: jax.Array) -> _Bracket:
    infinity = jnp.full_like(stride, jnp.inf)
    return _Bracket(-infinity, infinity, infinity, stride)


def _advance(bracket: _Bracket, x: jax.Array, missing: jax.Array, slope: jax.Array) -> tuple[_Bracket, jax.Array]:
    """Newton step on a nondecreasing function inside a bracket that opens at infinity.

    A step that does not stay strictly inside the bracket, or follows one that did not halve the residual, is
    replaced by the mid-point of the bracket; while one end is open, by a stride that doubles. At the root, where
    rounding decides, Newton steps are kept.
    """
    low, high = jnp.where(missing <= 0, x, bracket.low), jnp.where(missing >= 0, x, bracket.high)
    closed = jnp.isfinite(low) & jnp.isfinite(high)
    newton = x - missing / jnp.where(slope > 0, slope, 1)
    settled = jnp.abs(newton - x) <= 16 * float(jnp.finfo(x.dtype).eps) * jnp.abs(newton)
    inside = (newton > low) & (newton < high) & (~closed | (2 * jnp.abs(missing) <= bracket.last))
    use = (slope > 0) & (settled | inside)
    other = jnp.where(closed, (low + high) / 2, x - jnp.sign(missing) * bracket.stride)
    after = _Bracket(low, high, jnp.where(use, jnp.abs(missing), jnp.inf), 2 * bracket.stride)
    return after, jnp.where(use, newton, jnp.where(missing == 0, x, other))
