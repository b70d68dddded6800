"""Equilibrium of a block of cases: one torque against all rollers of each, a scalar root per case.

    approach(u_i) = tau a_i + g_i  where the right side is positive, else u_i = 0
    sum_i a_i u_i = torque

The moment of the loads is a nondecreasing function of the windup tau with slope sum a^2 S, S = stiffness
of a loaded roller. Three stages, each of which may fail without harm but for the last:

1. `_start`: Newton steps on the windup with linear contacts, which end exactly once the set of loaded
   rollers is right, and one with the law itself.
2. `_newton`: a Newton step on the windup and all loads together, with the exact law, from there.
3. `_safe`: where that did not converge, Newton steps on the windup inside a bracket, every load solved exactly.

Stages 2 and 3 count the windup from that of the stage before, depths being x a_i + (tau_0 a_i + g_i). The
shift x is as small as the elastic approach, so nothing cancels even where a clearance is many orders larger.

Arrays are (rollers, cases), or (1, cases) for what a case has once. A block goes on until its last case is done.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.mesh_force import laws
from rvjax.mesh_force.case import Case, Roller, all_rollers

DEAD_CENTRE = 1e-6  # arm over eccentricity below which a roller does not decide where contact begins
_MANY = 64  # cases from which sums are unrolled
_LINEAR_STEPS = 12  # at most; 3 to 5 are usual
_NEWTON_STEPS = 6  # at most; 1 is usual, 5 for Palmgren's law
_SAFE_STEPS = 100


class Balance(NamedTuple):
    """The equilibrium and how it was found."""

    windup: jax.Array  # tau
    load: jax.Array  # u (n,)
    steps: jax.Array
    residual: jax.Array  # moment missing, relative to the larger of the torque and the sum of |moments|
    overload: jax.Array  # a load limit is passed
    finite: jax.Array


def solve_block(law: str, teeth: int, case: Case, size: int) -> Balance:
    """Equilibrium of `size` cases; leaves of the result (size, ...).

    Args:
        law: one of `laws.CONTACTS`.
        teeth: z.
        case: leaves (size,), or (1,) where shared; `radius_error` also (size, n) or (1, n).
        size: cases.
    """
    if case.radius_error.ndim == 2:
        case = case._replace(radius_error=case.radius_error.T)
    rollers = all_rollers(teeth, case)
    rollers = rollers._replace(gap=jnp.broadcast_to(rollers.gap, (teeth + 1, size)))
    rollers = jax.lax.optimization_barrier(rollers)  # once, not again for every sum
    torque = jnp.broadcast_to(case.torque, (1, size))
    start, stride, steps = _start(law, rollers, torque)
    start, x, load, fine, steps = _newton(law, rollers, torque, start, steps)
    windup, load, steps, overload, finite = jax.lax.cond(
        jnp.all(fine), _as_it_is, functools.partial(_safe, law), rollers, torque, stride, start, x, load, fine, steps
    )
    windup, load = jax.lax.cond(
        jnp.any(torque == 0), _rest, lambda *unchanged: unchanged[2:], rollers, torque, windup, load
    )
    missing = jnp.abs(_sum(jnp.multiply, rollers.arm, load) - torque)
    scale = jnp.maximum(jnp.abs(torque), _sum(lambda a, u: jnp.abs(a * u), rollers.arm, load))
    residual = jnp.where(scale > 0, missing / jnp.where(scale > 0, scale, 1), 0)
    return Balance(windup[0], load.T, steps[0], residual[0], overload[0], finite[0])


def _as_it_is(
    rollers: Roller,
    torque: jax.Array,
    stride: jax.Array,
    start: jax.Array,
    x: jax.Array,
    load: jax.Array,
    fine: jax.Array,
    steps: jax.Array,
) -> tuple[jax.Array, ...]:
    return start + x, load, jnp.broadcast_to(steps, x.shape), jnp.zeros_like(fine), fine


def _rest(rollers: Roller, torque: jax.Array, windup: jax.Array, load: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Without torque and preload: no loads, and the windup at the upper edge of where nothing is loaded."""
    edge, slack = _dead_band(rollers)
    idle = slack & (torque == 0)
    return jnp.where(idle, edge, windup), jnp.where(idle & (jnp.abs(rollers.arm) > DEAD_CENTRE), 0, load)


def _dead_band(rollers: Roller) -> tuple[jax.Array, jax.Array]:
    """Upper edge of the range of windups at which nothing is loaded, and whether there is such a range."""
    forward, backward = rollers.arm > DEAD_CENTRE, rollers.arm < -DEAD_CENTRE
    threshold = -rollers.gap / jnp.where(forward | backward, rollers.arm, 1)
    upper = jnp.min(jnp.where(forward, threshold, jnp.inf), axis=0, keepdims=True)
    lower = jnp.max(jnp.where(backward, threshold, -jnp.inf), axis=0, keepdims=True)
    return upper, lower <= upper


def _start(law: str, rollers: Roller, torque: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Windup near the equilibrium, the size of windups to reckon with, and the steps taken."""
    arm, gap = rollers.arm, rollers.gap
    stiff_arm = jax.lax.optimization_barrier(2 * arm / rollers.compliance.weight)
    # All rollers of the working half loaded; without errors this is the solution.
    direction = jnp.where(torque < 0, -1.0, 1.0).astype(torque.dtype)
    slope = _sum(lambda a, k: jnp.where(a * direction > 0, a * k, 0), arm, stiff_arm)
    preload = _sum(lambda a, k, g: jnp.where(a * direction > 0, k * g, 0), arm, stiff_arm, gap)
    windup = (torque - preload) / jnp.where(slope > 0, slope, 1)
    stride = jnp.abs(windup) + _largest(jnp.abs, gap)
    least = jnp.where(slope > 0, slope, 1) / 20  # of the slope, where few rollers touch

    def moment_slope(windup: jax.Array) -> jax.Array:
        return _sum(lambda a, k, g: jnp.where(windup * a + g > 0, a * k, 0), arm, stiff_arm, gap)

    def running(state: Any) -> jax.Array:
        windup, change, steps = state
        return jnp.any(jnp.abs(change) > 1e-6 * jnp.abs(windup)) & (steps < _LINEAR_STEPS)

    def step(state: Any) -> Any:
        windup, change, steps = state
        moment = _sum(lambda a, k, g: jnp.where(windup * a + g > 0, k * (windup * a + g), 0), arm, stiff_arm, gap)
        slope = jnp.maximum(moment_slope(windup), least)
        damping = jnp.where(steps < _LINEAR_STEPS // 2, 1, 0.5).astype(torque.dtype)  # against a cycle of two steps
        # A case that is done stays: none depends on its neighbours.
        change = jnp.where(jnp.abs(change) > 1e-6 * jnp.abs(windup), damping * (torque - moment) / slope, 0)
        return windup + change, change, steps + 1

    first = (windup, jnp.full_like(windup, jnp.inf), jnp.zeros((), jnp.int32))
    windup, _, steps = jax.lax.while_loop(running, step, first)
    if law == "hertz":
        load, _ = laws.guess(law, jnp.maximum(windup * arm + gap, 0), rollers.compliance)
        missing, slope = _sum(jnp.multiply, arm, load) - torque, moment_slope(windup)
        windup -= missing / jnp.maximum(slope, least)
    return windup, stride, steps


def _newton(law: str, rollers: Roller, torque: jax.Array, start: jax.Array, steps: jax.Array) -> tuple[Any, ...]:
    """`_newton_step` once, and again while a case of the block needs it and it may help."""

    def running(state: Any) -> jax.Array:
        *_, fine, taken = state
        return jnp.any(~fine) & (taken < steps + _NEWTON_STEPS)

    def step(state: Any) -> Any:
        *before, fine, taken = state
        start = state[0] + state[1]
        after = (start, *_newton_step(law, rollers, torque, start))
        kept = [jnp.where(fine, old, new) for old, new in zip((*before, fine), after)]  # whatever neighbours need
        return *kept, taken + 1

    first = (start, jnp.zeros_like(start), jnp.zeros_like(rollers.gap), jnp.zeros(start.shape, bool), steps)
    return jax.lax.while_loop(running, step, first)


def _newton_step(law: str, rollers: Roller, torque: jax.Array, start: jax.Array) -> tuple[Any, ...]:
    """Shift of the windup, loads, and whether they are the solution."""
    arm, gap, compliance = rollers.arm, rollers.gap, rollers.compliance
    depth = start * arm + gap
    load, rate = laws.guess(law, jnp.maximum(depth, 0), compliance)
    rate = jnp.where(depth > 0, rate, 0)
    change = rate * (depth - laws.approach(law, load, compliance))
    load, rate, change = jax.lax.optimization_barrier((load, rate, change))
    slope = _sum(lambda a, k: a * a * k, arm, rate)
    missing = _sum(lambda a, u, du: a * (u + du), arm, load, change) - torque
    x = -missing / jnp.where(slope > 0, slope, 1)
    change = change + rate * arm * x
    # A Newton step leaves its square times the relative change of the stiffness up to this load, and the error of
    # that stiffness, a third power of the same. A roller that changes sides spoils the step.
    tolerance = 8 * float(jnp.finfo(load.dtype).eps) * _largest(jnp.positive, load)

    def too_much(g: Any, a: Any, u: Any, k: Any, weight: Any, du: Any) -> Any:
        if law == "palmgren":  # load ~ depth^(10/9); the stiffness is exact
            left = 0.1 * du * du - tolerance * u
        else:
            bend = jnp.abs(k * weight / 2 - 1)
            left = jnp.abs(du) * (jnp.abs(du) + 27 * u * bend**2) * bend - tolerance * u
        return jnp.where(start * a + g > 0, jnp.maximum(left, -(u + du)), (start + x) * a + g)

    worst = _largest(too_much, gap, arm, load, rate, compliance.weight, change)
    return x, load + change, (torque != 0) & (worst <= 0)  # false for NaN


def _safe(
    law: str,
    rollers: Roller,
    torque: jax.Array,
    stride: jax.Array,
    start: jax.Array,
    x: jax.Array,
    load: jax.Array,
    fine: jax.Array,
    steps: jax.Array,
) -> tuple[jax.Array, ...]:
    """Windup, loads, steps, overload, finite: as they are where `fine`, else by a bracket and exact loads."""
    arm, compliance = rollers.arm, rollers.compliance
    start = jnp.where(jnp.isfinite(start), start, 0)
    tolerance = 4 * float(jnp.finfo(x.dtype).eps)

    def running(state: dict[str, Any]) -> jax.Array:
        return jnp.any(state["running"])

    def step(state: dict[str, Any]) -> dict[str, Any]:
        x = state["x"]
        load, rate, beyond = laws.inverse(law, x * arm + (start * arm + rollers.gap), compliance)
        missing = jnp.sum(arm * load, axis=0, keepdims=True) - torque
        slope = jnp.sum(arm**2 * rate, axis=0, keepdims=True)
        scale = jnp.maximum(jnp.abs(torque), jnp.sum(jnp.abs(arm * load), axis=0, keepdims=True))
        bracket, target = _advance(state["bracket"], x, missing, slope)
        finite, overload = jnp.isfinite(target) & jnp.isfinite(scale), jnp.any(beyond, axis=0, keepdims=True)
        done = (jnp.abs(missing) <= tolerance * scale) | (jnp.abs(target - x) <= tolerance * jnp.abs(target)) | ~finite
        # What rounding of x leaves is shared out along the stiffness.
        rest = jnp.where(slope > 0, missing / jnp.where(slope > 0, slope, 1), 0)
        corrected = jnp.maximum(load - rate * arm * rest, 0)
        good = finite & ~overload  # a failed lane returns zeros, so that no derivative of it is NaN
        new = {
            "x": jnp.where(done, jnp.where(good, x, 0), target),
            "load": jnp.where(done, jnp.where(good, corrected, 0), load),
            "bracket": bracket,
            "steps": state["steps"] + 1,
            "overload": overload,
            "finite": finite,
            "running": ~done & (state["steps"] < _SAFE_STEPS),
        }
        return jax.tree.map(lambda after, before: jnp.where(state["running"], after, before), new, state)

    state: dict[str, Any] = {
        "x": jnp.where(fine, x, 0),
        "load": load,
        "bracket": _open_bracket(stride),
        "steps": jnp.broadcast_to(steps, x.shape),
        "overload": jnp.zeros_like(fine),
        "finite": jnp.ones_like(fine),
        "running": ~fine,
    }
    state = jax.lax.while_loop(running, step, state)
    return start + state["x"], state["load"], state["steps"], state["overload"], state["finite"]


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
    replaced by the middle of the bracket; while one end is open, by a stride that doubles. At the root, where
    rounding decides, Newton steps stand.
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


def _sum(term: Callable[..., jax.Array], *columns: jax.Array) -> jax.Array:
    """Sum of `term` over the rollers, (1, cases)."""
    return _fold(jnp.add, jnp.sum, term, columns)


def _largest(term: Callable[..., jax.Array], *columns: jax.Array) -> jax.Array:
    """Largest `term` of all rollers, (1, cases)."""
    return _fold(jnp.maximum, jnp.max, term, columns)


def _fold(combine: Callable[..., Any], whole: Callable[..., Any], term: Any, columns: tuple[jax.Array, ...]) -> Any:
    """Terms of all rollers combined; of many cases one row after the other, in a single pass over the columns."""
    first = term(*(column[:1] for column in columns))
    if first.shape[1] < _MANY:
        return whole(term(*columns), axis=0, keepdims=True)  # a smaller program
    rows = (term(*(column[i : i + 1] for column in columns)) for i in range(1, len(columns[0])))
    return functools.reduce(combine, rows, first)
