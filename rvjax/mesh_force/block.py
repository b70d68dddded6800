"""Equilibrium of a block of cases: one torque against all rollers of each, a scalar root per case.

    approach(u_i) = tau a_i + g_i  where the right side is positive, else u_i = 0
    sum_i a_i u_i = torque

The moment of the loads is a nondecreasing function of the windup tau with slope sum a^2 S, S = stiffness
of a loaded roller. Three stages, each of which may fail without harm but for the last:

1. `_linear`: Newton steps on the windup with linear contacts, which end exactly once the set of loaded
   rollers is right; for laws with an approximate inverse more steps with that.
2. `_newton`: Newton steps on the windup and all loads together, with the exact law, from there.
3. `safe.solve` for the cases that this left open: a bracket for the windup, every load solved exactly.

The last two count the windup from where they begin, depths being x a_i + (tau_0 a_i + g_i). The shift x is as
small as the elastic approach, so nothing cancels even where a clearance is many orders larger.

Arrays are (rollers, cases). A pass is a loop over the rollers whose body is one kernel over all cases; two
numbers of a roller travel as one complex number, because XLA makes a kernel of its own for every result, and
would compute or store twice what two results share.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.elementary import power
from rvjax.mesh_force import laws, safe
from rvjax.mesh_force.case import Case, Roller, lever, roller
from rvjax.mesh_force.geometry import roller_directions
from rvjax.records import PyTree, Scalar

_LINEAR_STEPS = 8  # at most; 3 to 5 are usual
_GUESS_STEPS = 8  # at most; 1 or 2 are usual, 4 for Palmgren's law
_NEWTON_STEPS = 4  # at most; 1 is usual
_CHUNK = 256  # cases that `safe.solve` gets at a time

Inverse = Callable[[Scalar, jax.Array], jax.Array]


class Found(NamedTuple):
    """The equilibrium and how it was found."""

    windup: jax.Array  # tau
    load: jax.Array  # u (n,)
    steps: jax.Array
    residual: jax.Array  # moment missing, relative to the larger of the torque and the sum of |moments|
    overload: jax.Array  # a load limit is passed
    finite: jax.Array


class _Rows(NamedTuple):
    """What all stages need of every roller (n, cases)."""

    arm: jax.Array
    gap: jax.Array
    stiffness: jax.Array  # load over approach, for Palmgren's law at a typical load


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
    sines, cosines = (jnp.asarray(x) for x in roller_directions(teeth, torque.dtype))

    def roller_at(i: Scalar) -> Roller:
        error = case.radius_error
        return roller(teeth, case, sines[i], cosines[i], error[i] if error.ndim == 2 else error)

    typical = jnp.maximum(jnp.abs(torque) / (teeth + 1), float(jnp.finfo(torque.dtype).tiny) ** 0.5)
    rows = _rows(law, roller_at, typical, teeth + 1)
    inverse = _inverse(law, roller_at, typical, rows)
    windup, linear_steps = _linear(rows, torque)
    windup, guess_steps = _guess(law, inverse, rows, torque, windup)
    start, x, load, fine, newton_steps = _newton(law, roller_at, inverse, rows, torque, windup)
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
    return Found(found["windup"], found["load"].T, found["steps"], residual, found["overload"], found["finite"])


def _missing(rows: _Rows, load: jax.Array, torque: jax.Array) -> jax.Array:
    """Moment missing, relative to the larger of the torque and the sum of |moments|."""
    moments = rows.arm * load
    scale = jnp.maximum(jnp.abs(torque), jnp.sum(jnp.abs(moments), axis=0))
    missing = jnp.abs(jnp.sum(moments, axis=0) - torque)
    return jnp.where(scale > 0, missing / jnp.where(scale > 0, scale, 1), 0)


def _put(rows: jax.Array, row: jax.Array, i: Scalar) -> jax.Array:
    return jax.lax.dynamic_update_index_in_dim(rows, row, i, 0)  # in place; .at[i].set is a scatter


def _per_roller(term: Callable[[Scalar], jax.Array], like: jax.Array) -> jax.Array:
    """Rows `term(i)` of all rollers, of the shape and type of `like` (n, cases)."""

    def put(i: Scalar, rows: jax.Array) -> jax.Array:
        return _put(rows, term(i), i)

    return jax.lax.fori_loop(0, len(like), put, jnp.zeros_like(like))


def _sums(term: Callable[[Scalar], jax.Array], like: jax.Array) -> jax.Array:
    """Sum of the complex `term(i)` over the rollers, (cases,); `like` (n, cases)."""
    count, size = like.shape
    zero = jnp.zeros(size, like.dtype)
    return jax.lax.fori_loop(0, count, lambda i, total: total + term(i), jax.lax.complex(zero, zero))


def _rows(law: str, roller_at: Callable[[Scalar], Roller], typical: jax.Array, count: int) -> _Rows:
    def put(i: Scalar, rows: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        r = roller_at(i)
        place = jnp.broadcast_to(jax.lax.complex(lever(r.arm), jnp.broadcast_to(r.gap, r.arm.shape)), typical.shape)
        stiffness = jnp.broadcast_to(laws.secant_stiffness(law, typical, r.compliance), typical.shape)
        return _put(rows[0], place, i), _put(rows[1], stiffness, i)

    empty = jnp.zeros((count, *typical.shape), typical.dtype)
    place, stiffness = jax.lax.fori_loop(0, count, put, (jax.lax.complex(empty, empty), empty))
    return _Rows(jnp.real(place), jnp.imag(place), stiffness)


def _linear(rows: _Rows, torque: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Windup of linear contacts, and the steps taken."""
    forward = torque >= 0

    def working(i: Scalar) -> jax.Array:
        arm = rows.arm[i]
        stiff_arm = jnp.where((arm > 0) == forward, arm * rows.stiffness[i], 0)
        return jax.lax.complex(stiff_arm * rows.gap[i], stiff_arm * arm)

    # All rollers of the working half loaded; without errors this is the solution.
    total = _sums(working, rows.arm)
    preload, slope = jnp.real(total), jnp.imag(total)
    windup = (torque - preload) / jnp.where(slope > 0, slope, 1)
    least = jnp.where(slope > 0, slope, 1) / 20  # of the slope, where few rollers touch

    def running(state: PyTree) -> jax.Array:
        windup, change, steps = state
        return jnp.any(jnp.abs(change) > 1e-6 * jnp.abs(windup)) & (steps < _LINEAR_STEPS)

    def step(state: PyTree) -> PyTree:
        windup, change, steps = state

        def loaded(i: Scalar) -> jax.Array:
            depth = windup * rows.arm[i] + rows.gap[i]
            stiff_arm = jnp.where(depth > 0, rows.arm[i] * rows.stiffness[i], 0)
            return jax.lax.complex(stiff_arm * depth, stiff_arm * rows.arm[i])

        total = _sums(loaded, rows.arm)
        damping = jnp.where(steps < _LINEAR_STEPS - 3, 1, 0.5).astype(torque.dtype)  # against a cycle of two steps
        newton = damping * (torque - jnp.real(total)) / jnp.maximum(jnp.imag(total), least)
        # A case that is done stays: none depends on its neighbours.
        change = jnp.where(jnp.abs(change) > 1e-6 * jnp.abs(windup), newton, 0)
        return windup + change, change, steps + 1

    first = (windup, jnp.full_like(windup, jnp.inf), jnp.zeros((), jnp.int32))
    windup, _, steps = jax.lax.while_loop(running, step, first)
    return windup, steps


def _inverse(law: str, roller_at: Callable[[Scalar], Roller], typical: jax.Array, rows: _Rows) -> Inverse:
    """(i, depth) -> load + i stiffness of roller i, for "hertz" approximate."""

    def inverse(i: Scalar, depth: jax.Array) -> jax.Array:
        loaded, depth = depth > 0, jnp.maximum(depth, 0)
        if law == "hertz":
            load, rate = laws.series(depth, roller_at(i).compliance)
        elif law == "linear":
            load, rate = rows.stiffness[i] * depth, rows.stiffness[i]
        else:  # u = y (y / typical)^(1/9), y = secant stiffness * depth
            secant = rows.stiffness[i] * power(rows.stiffness[i] * depth / typical, 1 / 9)
            load, rate = secant * depth, 10 / 9 * secant
        return jax.lax.complex(load, jnp.where(loaded, rate, 0))

    return inverse


def _guess(
    law: str, inverse: Inverse, rows: _Rows, torque: jax.Array, windup: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Windup after Newton steps with `inverse`, and the steps taken."""
    # `_newton` squares what is left. For "hertz" one step leaves little; for Palmgren's law the inverse is exact.
    at_most = {"linear": 0, "hertz": 1, "palmgren": _GUESS_STEPS}[law]

    def running(state: PyTree) -> jax.Array:
        _, open_, steps = state
        return jnp.any(open_) & (steps < at_most)

    def step(state: PyTree) -> PyTree:
        windup, open_, steps = state

        def moment(i: Scalar) -> jax.Array:
            load = inverse(i, windup * rows.arm[i] + rows.gap[i])
            return jax.lax.complex(rows.arm[i] * jnp.real(load), rows.arm[i] ** 2 * jnp.imag(load))

        total = _sums(moment, rows.arm)
        missing, slope = jnp.real(total) - torque, jnp.imag(total)
        shift = jnp.where(open_, -missing / jnp.where(slope > 0, slope, 1), 0)
        return windup + shift, open_ & ~(jnp.abs(missing) <= 1e-7 * jnp.abs(torque)), steps + 1

    windup, _, steps = jax.lax.while_loop(running, step, (windup, torque != 0, jnp.zeros((), jnp.int32)))
    return windup, steps


def _newton(
    law: str,
    roller_at: Callable[[Scalar], Roller],
    inverse: Inverse,
    rows: _Rows,
    torque: jax.Array,
    windup: jax.Array,
) -> tuple[jax.Array, ...]:
    """Start, shift from there, loads, whether they are the solution, steps: `_newton_step` while it may help."""

    def running(state: PyTree) -> jax.Array:
        *_, fine, steps = state
        return jnp.any(~fine) & (steps < _NEWTON_STEPS)

    def step(state: PyTree) -> PyTree:
        *before, fine, steps = state
        start = before[0] + before[1]
        after = (start, *_newton_step(law, roller_at, inverse, rows, torque, start))
        # A case that is done stays, whatever its neighbours need.
        kept = [jnp.where(fine if new.ndim == 1 else fine[None], old, new) for old, new in zip((*before, fine), after)]
        return *kept, steps + 1

    first = (windup, jnp.zeros_like(windup), jnp.zeros_like(rows.arm), torque == 0, jnp.zeros((), jnp.int32))
    start, x, load, fine, steps = jax.lax.while_loop(running, step, first)
    return start, x, load, fine & (torque != 0), steps


def _newton_step(
    law: str,
    roller_at: Callable[[Scalar], Roller],
    inverse: Inverse,
    rows: _Rows,
    torque: jax.Array,
    start: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Shift of the windup, loads, and whether they are the solution."""
    depth = start[None] * rows.arm + rows.gap
    guessed = _per_roller(lambda i: inverse(i, depth[i]), jax.lax.complex(depth, depth))
    load, rate = jnp.real(guessed), jnp.imag(guessed)
    change = jnp.zeros_like(load)
    if law == "hertz":  # else the guess is exact

        def correction(i: Scalar) -> jax.Array:
            return rate[i] * (depth[i] - laws.approach(law, load[i], roller_at(i).compliance))

        change = _per_roller(correction, depth)
    total = _sums(lambda i: jax.lax.complex(rows.arm[i] * (load[i] + change[i]), rows.arm[i] ** 2 * rate[i]), depth)
    missing, slope = jnp.real(total) - torque, jnp.imag(total)
    x = -missing / jnp.where(slope > 0, slope, 1)

    def verdict(i: Scalar, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        loads, worst = state
        shift = change[i] + rate[i] * rows.arm[i] * x
        after, moved = load[i] + shift, jnp.abs(shift)
        # A Newton step of relative size m leaves m^2 times the relative change of the stiffness up to this load, which
        # is `bend`, and m times the relative error of the stiffness it used.
        part = moved / jnp.where(load[i] > 0, load[i], 1)
        if law == "palmgren":  # load ~ depth^(10/9); the stiffness is exact
            left = 0.1 * moved * part
        else:
            bend = jnp.abs(rate[i] / rows.stiffness[i] - 1)
            left = moved * (part * bend + laws.series_error(bend))
        left = jnp.where(moved > 0, left, 0)  # and a roller that changes sides spoils the step:
        left = jnp.where(after >= 0, left, jnp.inf)
        left = jnp.where(depth[i] > 0, left, jnp.where(depth[i] + x * rows.arm[i] <= 0, 0, jnp.inf))
        worst = jax.lax.complex(jnp.maximum(jnp.real(worst), left), jnp.maximum(jnp.imag(worst), load[i]))
        return _put(loads, after, i), worst

    zero = jnp.zeros_like(x)
    loads, worst = jax.lax.fori_loop(0, len(depth), verdict, (load, jax.lax.complex(zero, zero)))
    tolerance = 8 * float(jnp.finfo(x.dtype).eps) * jnp.imag(worst)
    return x, loads, jnp.real(worst) <= tolerance  # false for NaN


def _left_open(
    law: str,
    teeth: int,
    case: Case,
    torque: jax.Array,
    todo: jax.Array,
    start: jax.Array,
    found: dict[str, jax.Array],
) -> dict[str, jax.Array]:
    """`found` with the cases `todo` solved the safe way, a chunk of them at a time."""
    size = len(todo)

    def some(state: PyTree) -> PyTree:
        todo, found = state
        (lanes,) = jnp.nonzero(todo, size=min(_CHUNK, size), fill_value=size)
        taken = jax.tree.map(lambda leaf: leaf if leaf.shape[-1] == 1 else leaf[..., lanes], case)
        part = safe.solve(law, teeth, taken, torque[lanes], start[lanes])
        part["steps"] += found["steps"][lanes]
        found = {name: found[name].at[..., lanes].set(part[name], mode="drop") for name in found}
        return todo.at[lanes].set(False, mode="drop"), found

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), some, (todo, found))[1]
