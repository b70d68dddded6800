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

from rvjax._jax.elementary import power
from rvjax._jax.sizes import LEFT_OPEN
from rvjax.mesh_force import laws, line_contact, safe
from rvjax.mesh_force.geometry import Case, all_rollers, lever
from rvjax.mesh_force.laws import Compliance
from rvjax.status import window

_LINEAR_STEPS = 8  # at most; 3 to 5 are usual
_GUESS_STEPS = 8  # at most; 1 or 2 are usual, 4 for "palmgren"
_NEWTON_STEPS = 4  # at most; 1 is usual

_Three = tuple[jax.Array, jax.Array, jax.Array]
_Newton = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]


class Solution(NamedTuple):
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
    hollow: jax.Array  # for "hertz", `line_contact.hollow` at the gear
    square: jax.Array  # for "hertz", `laws.square`
    typical: jax.Array  # load of a case (1, cases)
    compliance: Compliance


def solve_block(law: str, teeth: int, case: Case, size: int) -> Solution:
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
    start, x, load, residual, fine, newton_steps = _newton(law, rows, torque, windup)
    solution = {
        "windup": start + x,
        "load": load,
        "residual": residual,
        "steps": jnp.broadcast_to(linear_steps + guess_steps + newton_steps, (size,)),
        "overload": jnp.zeros(size, bool),
        "finite": jnp.ones(size, bool),
    }
    # A step from far away is right but for its rounding: the safe way begins where it ended.
    exact = residual <= 32 * float(jnp.finfo(torque.dtype).eps)
    windup = jnp.where(fine & ~exact, solution["windup"], windup)
    solution = _left_open(law, rows, torque, ~(fine & exact), windup, solution)
    loaded = _largest(list(solution["load"])) > 0
    return Solution(**solution | {"load": solution["load"].T, "loaded": loaded})


def _moment(rows: _Rows, roller: Callable[[_Rows, int], tuple[jax.Array, jax.Array]]) -> tuple[jax.Array, jax.Array]:
    """Moment of the loads and its derivative, (cases,), of `roller`: the load of roller i and its stiffness."""
    moment, slope = jnp.zeros_like(rows.arm[0]), jnp.zeros_like(rows.arm[0])
    for i in range(len(rows.arm)):
        row = _row(rows, i)
        load, rate = roller(row, i)
        moment, slope = moment + row.arm * load, slope + row.arm * (row.arm * rate)
    return moment, slope


def _row(rows: _Rows, i: int) -> _Rows:
    """Quantities of roller i, (cases,)."""
    return jax.tree.map(lambda leaf: leaf[i if len(leaf) > 1 else 0], rows)


def _largest(values: list[jax.Array]) -> jax.Array:
    """Largest value of all rollers, (cases,); NaN where one is NaN."""
    return functools.reduce(jnp.maximum, values)


def _rows(law: str, teeth: int, case: Case, torque: jax.Array) -> _Rows:
    rollers = all_rollers(teeth, case)
    typical = jnp.maximum(jnp.abs(torque) / (teeth + 1), window(torque, 0.5)[0])
    stiffness = laws.secant_stiffness(law, typical[None], rollers.compliance)
    hollow = line_contact.hollow(rollers.compliance.gear_radius)
    bends = laws.bends(stiffness, rollers.compliance, hollow) if law == "hertz" else ()
    shape = (teeth + 1, *torque.shape)
    arm, gap, stiffness = (jnp.broadcast_to(row, shape) for row in (lever(rollers.arm), rollers.gap, stiffness))
    square = laws.square(rollers.compliance, hollow)
    return _Rows(arm, gap, stiffness, bends, hollow, square, typical[None], rollers.compliance)


def _linear(rows: _Rows, torque: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Windup of linear contacts, and the steps taken."""
    forward = torque >= 0

    def working(row: _Rows, _: int) -> tuple[jax.Array, jax.Array]:
        stiffness = jnp.where((row.arm > 0) == forward, row.stiffness, 0)
        return stiffness * row.gap, stiffness

    # All rollers of the working half loaded; without errors this is the solution.
    preload, slope = _moment(rows, working)
    windup = (torque - preload) / jnp.where(slope > 0, slope, 1)
    least = jnp.where(slope > 0, slope, 1) / 20  # of the slope, where few rollers touch

    def moves(windup: jax.Array, last: jax.Array) -> jax.Array:
        return jnp.abs(windup - last) > 1e-6 * jnp.abs(windup)

    def running(state: _Three) -> jax.Array:
        windup, last, steps = state
        return jnp.any(moves(windup, last)) & (steps < _LINEAR_STEPS)

    def step(state: _Three) -> _Three:
        windup, last, steps = state

        def loaded(row: _Rows, _: int) -> tuple[jax.Array, jax.Array]:
            depth = windup * row.arm + row.gap
            stiffness = jnp.where(depth > 0, row.stiffness, 0)
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


def _each(law: str, rows: _Rows, depth: jax.Array) -> Callable[[int], tuple[jax.Array, jax.Array]]:
    """`_inverse` of roller i: in the kernels that read it, or stored for "palmgren", which takes a logarithm."""
    if law == "palmgren":
        load, ratio = _inverse(law, rows, depth)
        return lambda i: (load[i], ratio[i])
    return lambda i: _inverse(law, _row(rows, i), depth[i])


def _guess(law: str, rows: _Rows, torque: jax.Array, windup: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Windup after Newton steps with `_inverse`, and the steps taken."""
    # `_newton` squares what is left. For "hertz" one step leaves little; for "palmgren" the inverse is exact.
    at_most = {"linear": 0, "hertz": 1, "palmgren": _GUESS_STEPS}[law]

    def running(state: _Three) -> jax.Array:
        _, open_, steps = state
        return jnp.any(open_) & (steps < at_most)

    def step(state: _Three) -> _Three:
        windup, open_, steps = state
        stored = _each(law, rows, windup[None] * rows.arm + rows.gap)

        def roller(row: _Rows, i: int) -> tuple[jax.Array, jax.Array]:
            # Rows of one depth for all would be stored: 25 ns.
            load, ratio = stored(i) if law == "palmgren" else _inverse(law, row, windup * row.arm + row.gap)
            return load, row.stiffness * ratio

        moment, slope = _moment(rows, roller)
        missing = moment - torque
        shift = jnp.where(open_, -missing / jnp.where(slope > 0, slope, 1), 0)
        if at_most > 1:
            open_ &= ~(jnp.abs(missing) <= 1e-7 * jnp.abs(torque))
        return windup + shift, open_, steps + 1

    windup, _, steps = jax.lax.while_loop(running, step, (windup, torque != 0, jnp.zeros((), jnp.int32)))
    return windup, steps


def _newton(law: str, rows: _Rows, torque: jax.Array, windup: jax.Array) -> tuple[jax.Array, ...]:
    """Start, shift from there, loads, residual, whether they are the solution, steps: `_newton_step` while it helps."""

    def running(state: _Newton) -> jax.Array:
        *_, fine, steps = state
        return jnp.any(~fine) & (steps < _NEWTON_STEPS)

    def step(state: _Newton) -> _Newton:
        *before, fine, steps = state
        start = before[0] + before[1]
        x, load, residual, now = _newton_step(law, rows, torque, start, steps == 0, fine, before[2])
        # A finished case does not change while its neighbours iterate.
        start, x, residual = (jnp.where(fine, before[k], new) for k, new in ((0, start), (1, x), (3, residual)))
        return start, x, load, residual, fine | now, steps + 1

    none = jnp.zeros_like(windup)
    first = (windup, none, jnp.zeros_like(rows.arm), none, torque == 0, jnp.zeros((), jnp.int32))
    start, x, load, residual, fine, steps = jax.lax.while_loop(running, step, first)
    return start, x, load, residual, fine & (torque != 0), steps


def _newton_step(
    law: str, rows: _Rows, torque: jax.Array, start: jax.Array, near: jax.Array, fine: jax.Array, load: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Shift of the windup, loads, residual, and whether they are the solution.

    Where `near`, "hertz" is evaluated as for small loads, and larger ones are not yet the solution.
    """
    depth = start[None] * rows.arm + rows.gap
    inverse = _each(law, rows, depth)

    def corrected(depth: jax.Array, approach: Callable[[jax.Array], jax.Array]) -> jax.Array:
        load, ratio = _inverse(law, rows, depth)
        return load + rows.stiffness * ratio * (depth - approach(load))

    def small(depth: jax.Array) -> jax.Array:
        return corrected(depth, lambda load: laws.approach_near(load, rows.compliance, rows.hollow))

    def every(depth: jax.Array) -> jax.Array:
        return corrected(depth, lambda load: laws.approach(law, load, rows.compliance))

    if law == "hertz":
        base = jax.lax.cond(near, small, every, depth)
    else:  # the guess is exact
        base, _ = _inverse(law, rows, depth)

    def linearised(row: _Rows, i: int) -> tuple[jax.Array, jax.Array]:
        return base[i], row.stiffness * inverse(i)[1]

    moment, slope = _moment(rows, linearised)
    x = (torque - moment) / jnp.where(slope > 0, slope, 1)
    # A finished case keeps its loads.
    after = base + rows.stiffness * _inverse(law, rows, depth)[1] * rows.arm * x[None]
    after = jnp.where(fine[None], load, after)
    # Tolerance of m left, times load. A quotient, where XLA ends a kernel: it would form a maximum for every roller.
    unit = 1 / (8 * float(jnp.finfo(x.dtype).eps) * _largest(list(after)))

    def left(i: int) -> jax.Array:
        row = _row(rows, i)
        load, ratio = inverse(i)
        moved = jnp.abs(after[i] - load)
        # A Newton step of relative size m leaves m^2 times the relative change of the stiffness up to this load, which
        # is `bend`, and m times the relative error of the stiffness it used.
        if law == "palmgren":  # load ~ depth^(10/9); the stiffness is exact
            left = 0.1 * moved
        else:
            bend = jnp.abs(ratio - 1)
            left = moved * bend + load * laws.series_error(bend)
        # A roller that changes sides spoils the step.
        stays = (after[i] >= 0) & ((depth[i] > 0) | (depth[i] + x * row.arm <= 0))
        if law == "hertz":
            stays &= ~near | (load * row.square <= line_contact.NEAR)
        return jnp.where(stays, moved * unit * left - load, jnp.inf)

    worst = _largest([left(i) for i in range(len(after))])
    return x, after, safe.missing(rows.arm, after, torque), worst <= 0  # false for NaN


def _left_open(
    law: str, rows: _Rows, torque: jax.Array, todo: jax.Array, start: jax.Array, solution: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """`solution` with the cases `todo` solved the safe way, a chunk of them at a time."""
    size = len(todo)

    def some(state: tuple[jax.Array, dict[str, jax.Array]]) -> tuple[jax.Array, dict[str, jax.Array]]:
        todo, solution = state
        (lanes,) = jnp.nonzero(todo, size=min(LEFT_OPEN, size), fill_value=size)
        taken = jax.tree.map(lambda leaf: leaf if leaf.shape[-1] == 1 else leaf[..., lanes], rows)
        part = safe.solve(law, taken.arm, taken.gap, taken.compliance, torque[lanes], start[lanes])
        part["steps"] += solution["steps"][lanes]
        solution = {name: solution[name].at[..., lanes].set(part[name], mode="drop") for name in solution}
        return todo.at[lanes].set(False, mode="drop"), solution

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), some, (todo, solution))[1]
