"""Equilibrium of a block of cases: one torque against all rollers of each, a scalar root per case.

    approach(u_i) = tau a_i + g_i  where the right side is positive, else u_i = 0
    sum_i a_i u_i = torque

The moment of the loads is a nondecreasing function of the windup tau with slope sum a^2 S, S = stiffness
of a loaded roller. Three stages, each of which may fail without harm but for the last:

1. `_linear`: Newton steps on the windup with linear contacts, which end exactly once the set of loaded
   rollers is right; for contact laws with an approximate inverse more steps with it.
2. `_newton`: Newton steps on the windup and all loads together, with the exact contact law, from there.
3. `safe.solve` for the cases that this left open: a bracket for the windup, every load solved exactly.

The last two count the windup from where they begin, depths being x a_i + (tau_0 a_i + g_i). The shift x is as
small as the elastic approach, so nothing cancels even where a clearance is many orders larger.

Arrays are (rollers, cases). What all steps need of a roller is formed once, as the loops read it: XLA
recomputes in every kernel what is not the operand of a loop. Sums over the rollers are unrolled, which makes one kernel
along the cases of a step.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.blocks import LEFT_OPEN
from rvjax._jax.elementary import power
from rvjax.mesh_force import laws, line_contact, safe
from rvjax.mesh_force.case import Case, all_rollers, lever
from rvjax.mesh_force.laws import Compliance
from rvjax.records import PyTree
from rvjax.status import window

_LINEAR_STEPS = 8  # at most; 3 to 5 are usual
_GUESS_STEPS = 8  # at most; 1 or 2 are usual, 4 for "palmgren"
_NEWTON_STEPS = 4  # at most; 1 is usual


class Found(NamedTuple):
    """The equilibrium and how it was found."""

    windup: jax.Array  # tau
    load: jax.Array  # u (n,)
    steps: jax.Array
    residual: jax.Array  # moment missing, relative to the larger of the torque and the sum of |moments|
    loaded: jax.Array  # a roller is; read here, where rollers come first
    overload: jax.Array  # a load limit is passed
    finite: jax.Array


class _Rows(NamedTuple):
    """Quantities of every roller (n, cases) for all stages."""

    arm: jax.Array
    gap: jax.Array
    stiffness: jax.Array  # load over approach, for "palmgren" at a typical load
    bends: tuple[jax.Array, ...]  # for "hertz", of `laws.series`
    typical: jax.Array  # load of a case (1, cases)
    compliance: Compliance


def solve_block(law: str, teeth: int, case: Case, size: int) -> Found:
    """Equilibrium of `size` cases; leaves of the result (size, ...).

    Args:
        law: one of `laws.CONTACTS`.
        teeth: z.
        case: leaves (size,), or (1,) where shared; `radius_error` also (size, n) or (1, n).
        size: cases.
    """
    if case.radius_error.ndim == 2:
        case = case._replace(radius_error=case.radius_error.T)
    torque = jnp.broadcast_to(case.torque, (size,))
    rows = _rows(law, teeth, case, torque)
    windup, linear_steps = _linear(rows, torque)
    windup, guess_steps = _guess(law, rows, torque, windup)
    start, x, load, fine, newton_steps = _newton(law, rows, torque, windup)
    found = {
        "windup": start + x,
        "load": load,
        "steps": jnp.broadcast_to(linear_steps + guess_steps + newton_steps, (size,)),
        "overload": jnp.zeros(size, bool),
        "finite": jnp.ones(size, bool),
    }
    # A step from far away is right but for its rounding: the safe way begins where it ended.
    exact = _missing(rows, load, torque) <= 32 * float(jnp.finfo(torque.dtype).eps)
    windup = jnp.where(fine & ~exact, found["windup"], windup)
    found = _left_open(law, teeth, case, torque, ~(fine & exact), windup, found)
    residual = _missing(rows, found["load"], torque)
    load, loaded = found["load"], _largest(found["load"]) > 0
    return Found(found["windup"], load.T, found["steps"], residual, loaded, found["overload"], found["finite"])


def _moment(rows: _Rows, roller: Callable[[int], tuple[jax.Array, jax.Array]]) -> tuple[jax.Array, jax.Array]:
    """Moment of the loads and its derivative, (cases,), of `roller(i)`, the load of a roller and its stiffness."""
    moment, slope = jnp.zeros_like(rows.arm[0]), jnp.zeros_like(rows.arm[0])
    for i in range(len(rows.arm)):
        arm, (load, rate) = rows.arm[i], roller(i)
        moment, slope = moment + arm * load, slope + arm * arm * rate
    return moment, slope


def _largest(rows: jax.Array) -> jax.Array:
    """Largest value of all rollers, (cases,); NaN where one is NaN."""
    return functools.reduce(jnp.maximum, [rows[i] for i in range(len(rows))])


def _missing(rows: _Rows, load: jax.Array, torque: jax.Array) -> jax.Array:
    """Moment missing, relative to the larger of the torque and the sum of |moments|."""
    moment, size = jnp.zeros_like(torque), jnp.zeros_like(torque)
    for i in range(len(load)):
        part = rows.arm[i] * load[i]
        moment, size = moment + part, size + jnp.abs(part)
    scale, missing = jnp.maximum(jnp.abs(torque), size), jnp.abs(moment - torque)
    return jnp.where(scale > 0, missing / jnp.where(scale > 0, scale, 1), 0)


def _rows(law: str, teeth: int, case: Case, torque: jax.Array) -> _Rows:
    rollers = all_rollers(teeth, case)
    typical = jnp.maximum(jnp.abs(torque) / (teeth + 1), window(torque, 0.5)[0])
    stiffness = laws.secant_stiffness(law, typical[None], rollers.compliance)
    bends = laws.bends(stiffness, rollers.compliance) if law == "hertz" else ()
    shape = (teeth + 1, *torque.shape)
    arm, gap, stiffness = (jnp.broadcast_to(row, shape) for row in (lever(rollers.arm), rollers.gap, stiffness))
    return _Rows(arm, gap, stiffness, bends, typical[None], rollers.compliance)


def _linear(rows: _Rows, torque: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Windup of linear contacts, and the steps taken."""
    forward = torque >= 0

    def working(i: int) -> tuple[jax.Array, jax.Array]:
        stiffness = jnp.where((rows.arm[i] > 0) == forward, rows.stiffness[i], 0)
        return stiffness * rows.gap[i], stiffness

    # All rollers of the working half loaded; without errors this is the solution.
    preload, slope = _moment(rows, working)
    windup = (torque - preload) / jnp.where(slope > 0, slope, 1)
    least = jnp.where(slope > 0, slope, 1) / 20  # of the slope, where few rollers touch

    def moves(windup: jax.Array, last: jax.Array) -> jax.Array:
        return jnp.abs(windup - last) > 1e-6 * jnp.abs(windup)

    def running(state: PyTree) -> jax.Array:
        windup, last, steps = state
        return jnp.any(moves(windup, last)) & (steps < _LINEAR_STEPS)

    def step(state: PyTree) -> PyTree:
        windup, last, steps = state

        def loaded(i: int) -> tuple[jax.Array, jax.Array]:
            depth = windup * rows.arm[i] + rows.gap[i]
            stiffness = jnp.where(depth > 0, rows.stiffness[i], 0)
            return stiffness * depth, stiffness

        moment, slope = _moment(rows, loaded)
        damping = jnp.where(steps < _LINEAR_STEPS - 3, 1, 0.5).astype(torque.dtype)  # against a cycle of two steps
        after = windup + damping * (torque - moment) / jnp.maximum(slope, least)
        # A case that is done stays: none depends on its neighbours.
        return jnp.where(moves(windup, last), after, windup), windup, steps + 1

    first = (windup, jnp.full_like(windup, jnp.inf), jnp.zeros((), jnp.int32))
    windup, _, steps = jax.lax.while_loop(running, step, first)
    return windup, steps


def _inverse(law: str, rows: _Rows, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Load for an approach, and its stiffness over `rows.stiffness`; for "hertz" approximate."""
    loaded, y = depth > 0, rows.stiffness * jnp.maximum(depth, 0)
    if law == "hertz":
        load, ratio = laws.series(y, *rows.bends)
    elif law == "linear":
        load, ratio = y, jnp.ones_like(y)
    else:  # u = y (y / typical)^(1/9)
        secant = power(y / rows.typical, 1 / 9)
        load, ratio = secant * y, 10 / 9 * secant
    return load, jnp.where(loaded, ratio, 0)


def _guess(law: str, rows: _Rows, torque: jax.Array, windup: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Windup after Newton steps with `_inverse`, and the steps taken."""
    # `_newton` squares what is left. For "hertz" one step leaves little; for "palmgren" the inverse is exact.
    at_most = {"linear": 0, "hertz": 1, "palmgren": _GUESS_STEPS}[law]

    def running(state: PyTree) -> jax.Array:
        _, open_, steps = state
        return jnp.any(open_) & (steps < at_most)

    def step(state: PyTree) -> PyTree:
        windup, open_, steps = state
        load, ratio = _inverse(law, rows, windup[None] * rows.arm + rows.gap)
        moment, slope = _moment(rows, lambda i: (load[i], rows.stiffness[i] * ratio[i]))
        missing = moment - torque
        shift = jnp.where(open_, -missing / jnp.where(slope > 0, slope, 1), 0)
        return windup + shift, open_ & ~(jnp.abs(missing) <= 1e-7 * jnp.abs(torque)), steps + 1

    windup, _, steps = jax.lax.while_loop(running, step, (windup, torque != 0, jnp.zeros((), jnp.int32)))
    return windup, steps


def _newton(law: str, rows: _Rows, torque: jax.Array, windup: jax.Array) -> tuple[jax.Array, ...]:
    """Start, shift from there, loads, whether they are the solution, steps: `_newton_step` while it may help."""

    def running(state: PyTree) -> jax.Array:
        *_, fine, steps = state
        return jnp.any(~fine) & (steps < _NEWTON_STEPS)

    def step(state: PyTree) -> PyTree:
        *before, fine, steps = state
        start = before[0] + before[1]
        after = (start, *_newton_step(law, rows, torque, start, steps == 0))
        # A finished case does not change while its neighbours iterate.
        kept = [jnp.where(fine if new.ndim == 1 else fine[None], old, new) for old, new in zip((*before, fine), after)]
        return *kept, steps + 1

    first = (windup, jnp.zeros_like(windup), jnp.zeros_like(rows.arm), torque == 0, jnp.zeros((), jnp.int32))
    start, x, load, fine, steps = jax.lax.while_loop(running, step, first)
    return start, x, load, fine & (torque != 0), steps


def _newton_step(
    law: str, rows: _Rows, torque: jax.Array, start: jax.Array, near: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Shift of the windup, loads, and whether they are the solution.

    Where `near`, "hertz" is evaluated as for small loads, and larger ones are not yet the solution.
    """
    depth = start[None] * rows.arm + rows.gap
    load, ratio = _inverse(law, rows, depth)
    rate = rows.stiffness * ratio
    change, square = jnp.zeros_like(load), jnp.zeros_like(start)
    if law == "hertz":  # else the guess is exact

        def small(load: jax.Array) -> tuple[jax.Array, jax.Array]:
            approach, squares = laws.approach_near(load, rows.compliance)
            return approach, _largest(squares)

        def every(load: jax.Array) -> tuple[jax.Array, jax.Array]:
            return laws.approach(law, load, rows.compliance), jnp.zeros_like(start)

        approach, square = jax.lax.cond(near, small, every, load)
        change = rate * (depth - approach)
    moment, slope = _moment(rows, lambda i: (load[i] + change[i], rate[i]))
    x = (torque - moment) / jnp.where(slope > 0, slope, 1)

    shift = change + rate * rows.arm * x[None]
    after, moved = load + shift, jnp.abs(shift)
    # A Newton step of relative size m leaves m^2 times the relative change of the stiffness up to this load, which
    # is `bend`, and m times the relative error of the stiffness it used.
    if law == "palmgren":  # load ~ depth^(10/9); the stiffness is exact
        left = 0.1 * moved
    else:
        bend = jnp.abs(ratio - 1)
        left = moved * bend + load * laws.series_error(bend)
    # Tolerance of m left, times load. A quotient, where XLA ends a kernel: it would form a maximum for every roller.
    unit = 1 / (8 * float(jnp.finfo(x.dtype).eps) * _largest(load))
    # A roller that changes sides spoils the step.
    stays = (after >= 0) & ((depth > 0) | (depth + x[None] * rows.arm <= 0))
    worst = _largest(jnp.where(stays, moved * unit[None] * left - load, jnp.inf))
    return x, after, (worst <= 0) & (square <= line_contact.NEAR)  # false for NaN


def _left_open(
    law: str, teeth: int, case: Case, torque: jax.Array, todo: jax.Array, start: jax.Array, found: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """`found` with the cases `todo` solved the safe way, a chunk of them at a time."""
    size = len(todo)

    def some(state: PyTree) -> PyTree:
        todo, found = state
        (lanes,) = jnp.nonzero(todo, size=min(LEFT_OPEN, size), fill_value=size)
        taken = jax.tree.map(lambda leaf: leaf if leaf.shape[-1] == 1 else leaf[..., lanes], case)
        part = safe.solve(law, teeth, taken, torque[lanes], start[lanes])
        part["steps"] += found["steps"][lanes]
        found = {name: found[name].at[..., lanes].set(part[name], mode="drop") for name in found}
        return todo.at[lanes].set(False, mode="drop"), found

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), some, (todo, found))[1]
