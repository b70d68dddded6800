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

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.mesh_force import laws
from rvjax.mesh_force.case import Case, Roller, all_rollers

DEAD_CENTRE = 1e-6  # arm over eccentricity below which a roller does not decide where contact begins
_LINEAR_STEPS = 12  # at most; 3 to 5 are usual
_NEWTON_STEPS = 3  # at most; 1 is usual
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
    found = _safe(law, rollers, torque, stride, *_newton(law, rollers, torque, start, steps))
    idle = jnp.any(torque == 0)
    windup, load = jax.lax.cond(
        idle, _rest, lambda *unchanged: unchanged[2:], rollers, torque, found.windup, found.load
    )
    return Balance(*(leaf[0] for leaf in found))._replace(windup=windup[0], load=load.T)


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

    def moment_slope(windup: jax.Array) -> jax.Array:
        return _sum(lambda a, k, g: jnp.where(windup * a + g > 0, a * k, 0), arm, stiff_arm, gap)

    def running(state: Any) -> jax.Array:
        windup, change, _, steps = state
        return jnp.any(change > 1e-6 * jnp.abs(windup)) & (steps < _LINEAR_STEPS)

    def step(state: Any) -> Any:
        windup, change, bracket, steps = state
        moment = _sum(lambda a, k, g: k * jnp.maximum(windup * a + g, 0), arm, stiff_arm, gap)
        bracket, target = _advance(bracket, windup, moment - torque, moment_slope(windup), halving=False)
        target = jnp.where(change > 1e-6 * jnp.abs(windup), target, windup)  # no case depends on its neighbours
        return target, jnp.abs(target - windup), bracket, steps + 1

    stride = jnp.abs(windup) + _fold(jnp.maximum, jnp.abs(gap))
    first = (windup, jnp.full_like(windup, jnp.inf), _open_bracket(stride), jnp.zeros((), jnp.int32))
    windup, _, _, steps = jax.lax.while_loop(running, step, first)
    if law == "hertz":
        load, _ = laws.guess(law, jnp.maximum(windup * arm + gap, 0), rollers.compliance)
        missing, slope = _sum(jnp.multiply, arm, load) - torque, moment_slope(windup)
        windup -= jnp.where(slope > 0, missing / jnp.where(slope > 0, slope, 1), 0)
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
    # A Newton step leaves its square times the relative change of the stiffness up to this load, and the error
    # of that stiffness, a third power. A roller that changes sides spoils the step.
    bend = jnp.abs(rate * compliance.weight / 2 - 1)
    left = jnp.abs(change) * (jnp.abs(change) / jnp.where(load > 0, load, 1) * bend + (3 * bend) ** 3)
    tolerance = 8 * float(jnp.finfo(load.dtype).eps) * _fold(jnp.maximum, load)
    spoiled = jnp.where(depth > 0, (load + change < 0) | ~(left <= tolerance), depth + x * arm > 0)
    return x, load + change, (torque != 0) & jnp.isfinite(x) & ~_fold(jnp.logical_or, spoiled)


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
) -> Balance:
    """The equilibrium, where it is not `fine` yet by a bracket and exact loads."""
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
        bracket, target = _advance(state["bracket"], x, missing, slope, halving=True)
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

    state = {
        "x": jnp.where(fine, x, 0),
        "load": load,
        "bracket": _open_bracket(stride),
        "steps": jnp.broadcast_to(steps, x.shape),
        "overload": jnp.zeros_like(fine),
        "finite": jnp.ones_like(fine),
        "running": ~fine,
    }
    state = jax.lax.while_loop(running, step, state)
    missing = jnp.abs(_sum(jnp.multiply, arm, state["load"]) - torque)
    scale = jnp.maximum(jnp.abs(torque), _sum(lambda a, u: jnp.abs(a * u), arm, state["load"]))
    return Balance(
        windup=start + state["x"],
        load=state["load"],
        steps=state["steps"],
        residual=jnp.where(scale > 0, missing / jnp.where(scale > 0, scale, 1), 0),
        overload=state["overload"],
        finite=state["finite"],
    )


class _Bracket(NamedTuple):
    low: jax.Array
    high: jax.Array
    last: jax.Array  # |missing| before the last Newton step
    stride: jax.Array


def _open_bracket(stride: jax.Array) -> _Bracket:
    infinity = jnp.full_like(stride, jnp.inf)
    return _Bracket(-infinity, infinity, infinity, stride)


def _advance(
    bracket: _Bracket, x: jax.Array, missing: jax.Array, slope: jax.Array, *, halving: bool
) -> tuple[_Bracket, jax.Array]:
    """Newton step on a nondecreasing function inside a bracket that opens at infinity.

    A step that does not stay strictly inside the bracket, or with `halving` follows one that did not halve the
    residual, is replaced by the middle of the bracket; while one end is open, by a stride that doubles. At the
    root, where rounding decides, Newton steps stand.
    """
    low, high = jnp.where(missing <= 0, x, bracket.low), jnp.where(missing >= 0, x, bracket.high)
    closed = jnp.isfinite(low) & jnp.isfinite(high)
    newton = x - missing / jnp.where(slope > 0, slope, 1)
    settled = jnp.abs(newton - x) <= 16 * float(jnp.finfo(x.dtype).eps) * jnp.abs(newton)
    inside = (newton > low) & (newton < high)
    if halving:
        inside &= ~closed | (2 * jnp.abs(missing) <= bracket.last)
    use = (slope > 0) & (settled | inside)
    other = jnp.where(closed, (low + high) / 2, x - jnp.sign(missing) * bracket.stride)
    after = _Bracket(low, high, jnp.where(use, jnp.abs(missing), jnp.inf), 2 * bracket.stride)
    return after, jnp.where(use, newton, jnp.where(missing == 0, x, other))


def _sum(term: Callable[..., jax.Array], *columns: jax.Array) -> jax.Array:
    """Sum of `term` over the rollers, (1, cases); row by row, so that it is one pass over the columns."""
    return _pairwise(jnp.add, [term(*(column[i : i + 1] for column in columns)) for i in range(len(columns[0]))])


def _fold(combine: Callable[[jax.Array, jax.Array], jax.Array], rows: jax.Array) -> jax.Array:
    """Rows (n, cases) combined to (1, cases)."""
    return _pairwise(combine, [rows[i : i + 1] for i in range(len(rows))])


def _pairwise(combine: Callable[[jax.Array, jax.Array], jax.Array], parts: list[jax.Array]) -> jax.Array:
    while len(parts) > 1:
        pairs = [combine(a, b) for a, b in zip(parts[::2], parts[1::2])]
        parts = pairs + parts[len(parts) // 2 * 2 :]
    return parts[0]
