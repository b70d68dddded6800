"""Root finding: a differentiable scalar Newton method safeguarded with bisection, and bisection on the host.

A root x with residual(x, params) = 0 is differentiated by the implicit function theorem,

    dx = -(d residual / dx)^-1 (d residual / d params) dparams,

so a derivative costs one evaluation at the root, not a walk back through the iteration. Forward and
reverse mode work, and again on the result (second derivatives). Everything the root depends on must
enter through `params`; start values and brackets only choose the root and carry no derivative.

Under `jax.vmap` every batch element has its own status. One that fails has the value NaN and the
derivative zero, and leaves its neighbours as they are.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.ad_checkpoint
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax._jax.kernels import while_loop
from rvjax._jax.solved_state import SOLVED
from rvjax.records import Array, PyTree, Record, Scalar, field, promote, record
from rvjax.status import SolveInfo, Status, succeeded

Tree = TypeVar("Tree")

__all__ = ["Root", "bracketed"]

Residual = Callable[[Array, PyTree], jax.Array]
R = TypeVar("R")

_RUNNING = -1  # not a Status: the loop continues


@record
class Root(Record):
    """A root and how it was found."""

    value: Array = field("as the unknown", "the root; NaN where the solve failed")
    info: SolveInfo = field("-", "residual is |residual(value)|", kind="record")


def solved(state: R) -> R:
    """Mark what an iteration has found: a program of slopes that saves it by name does not iterate again.

    Args:
        state: arrays without derivatives, outside of any loop.
    """
    return jax.ad_checkpoint.checkpoint_name(state, SOLVED)


def bisect(
    above: Callable[[np.ndarray], bool | np.ndarray], low: float | np.ndarray, high: float | np.ndarray, *, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Halve intervals on the host; each keeps the half in which `above` changes from true to false.

    Args:
        above: true of a mid-point below the wanted place; a bool, or one for each interval.
        low: lower ends, a number or an array.
        high: upper ends.
        steps: halvings.
    """
    low, high = np.asarray(low), np.asarray(high)
    for _ in range(steps):
        middle = (low + high) / 2
        beyond = above(middle)
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    return low, high


@checked
def bracketed(
    residual: Residual,
    params: object,
    lower: Scalar,
    upper: Scalar,
    *,
    start: Scalar | None = None,
    max_steps: int = 128,
    tolerance: float | None = None,
) -> Root:
    """Root of a scalar function inside a bracket, by Newton steps safeguarded with bisection.

    A Newton step is taken where it stays inside the bracket and the last one has at least halved the
    residual, else the bracket is halved, so a continuous function always converges.

    Args:
        residual: residual(x, params) -> scalar, differentiable, of opposite signs at the two ends. A function that
            outlives the call is compiled once, one made for the call (a lambda) at each.
        params: pytree of floats the residual depends on.
        lower: one finite end of the bracket.
        upper: the other end, above or below it.
        start: first iterate, clipped to the bracket; the mid-point by default.
        max_steps: residual evaluations at most.
        tolerance: largest last step relative to the root; 8 epsilons of the dtype by default.

    Returns:
        Root with status CONVERGED, NO_BRACKET, MAX_STEPS or NONFINITE.
    """
    for leaf in jax.tree.leaves(params):
        if np.dtype(getattr(leaf, "dtype", type(leaf))).kind not in "biufV":  # V: formats such as bfloat16
            raise ValueError(f"params: {leaf!r} must be a real number, or an array of them")
    return _bracketed(residual, params, lower, upper, start, max_steps=max_steps, tolerance=tolerance)


@partial(jax.jit, inline=True, static_argnums=0, static_argnames=("max_steps", "tolerance"))
def _bracketed(
    residual: Residual,
    params: object,
    lower: Array,
    upper: Array,
    start: Array | None,
    *,
    max_steps: int,
    tolerance: float | None,
) -> Root:
    params, lower, upper, start = promote(params, lower, upper, 0.5 * (lower + upper) if start is None else start)
    tolerance = 8 * float(jnp.finfo(lower.dtype).eps) if tolerance is None else tolerance
    iterate = partial(_bracketed_iteration, max_steps=max_steps, tolerance=tolerance)
    value, info = _implicit(residual, iterate, params, (lower, upper, start))
    return Root(jnp.where(succeeded(info.status), value, jnp.nan), info)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _implicit(
    residual: Residual, iterate: Callable[..., tuple[jax.Array, SolveInfo]], params: object, guess: object
) -> tuple[jax.Array, SolveInfo]:
    return iterate(residual, params, guess)


@_implicit.defjvp
def _implicit_jvp(
    residual: Residual, iterate: Callable[..., object], primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]
) -> tuple[tuple[jax.Array, SolveInfo], tuple[jax.Array, SolveInfo]]:
    (params, guess), (dparams, _) = primals, tangents
    value, info = _implicit(residual, iterate, params, guess)
    good = succeeded(info.status)

    # A failed batch element may hold NaN. Selecting before and after the linear map keeps both its tangent and,
    # transposed, its cotangent exactly zero, here and in second derivatives.
    def keep(tree: Tree) -> Tree:
        return jax.tree.map(lambda leaf: jnp.where(good, leaf, jax.lax.stop_gradient(leaf)), tree)

    value, params = keep(value), keep(params)
    dparams = jax.tree.map(lambda tangent: jnp.where(good, tangent, jnp.zeros_like(tangent)), dparams)
    _, change = jax.jvp(lambda p: residual(value, p), (params,), (dparams,))
    slope = jax.jacfwd(residual)(value, params)
    regular = good & (slope != 0)
    dvalue = jnp.where(regular, -change / jnp.where(regular, slope, 1), 0)
    return (value, info), (dvalue, jax.custom_derivatives.zero_from_primal(info))


def _bracketed_iteration(
    residual: Residual, params: tuple[jax.Array, ...], guess: PyTree, *, max_steps: int, tolerance: float
) -> tuple[jax.Array, SolveInfo]:
    lower, upper, start = guess
    at_lower, at_upper = residual(lower, params), residual(upper, params)
    rising = at_lower <= at_upper
    below, above = jnp.where(rising, lower, upper), jnp.where(rising, upper, lower)  # residual <= 0, >= 0
    status = jnp.where(at_lower * at_upper > 0, int(Status.NO_BRACKET), _RUNNING)
    status = jnp.where(jnp.isfinite(at_lower) & jnp.isfinite(at_upper), status, int(Status.NONFINITE))
    x = jnp.clip(start, jnp.minimum(lower, upper), jnp.maximum(lower, upper))
    x = jnp.where(at_lower == 0, lower, jnp.where(at_upper == 0, upper, x))  # an end that is a root

    def running(state: tuple[jax.Array, ...]) -> jax.Array:
        return state[-2] == _RUNNING

    def at(x: jax.Array) -> PyTree:
        return jax.jvp(lambda y: residual(y, params), (x,), (jnp.ones_like(x),))

    def body(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        # The residual comes with the state: computed here it might be rounded differently for each result, and one
        # would take x for the root while another moves on.
        x, value, slope, below, above, last, stride, status, steps = state
        below, above = jnp.where(value <= 0, x, below), jnp.where(value >= 0, x, above)
        target = x - value / jnp.where(slope == 0, 1, slope)
        inside = (slope != 0) & ((target - below) * (target - above) <= 0)
        use = inside & (2 * jnp.abs(value) <= last)
        # Near the root rounding may keep the residual from halving. The mid-point of a bracket that is still wide
        # would lead away, to another root perhaps: strides that grow find the sign change next to here.
        half = 0.5 * (jnp.where(value < 0, above, below) - x)
        stride = jnp.where(use, jnp.abs(target - x), 4 * stride)
        near = x + jnp.clip(half, -stride, stride)
        target = jnp.where(use, target, near)
        target = jnp.where(value == 0, x, target)
        last = jnp.where(use, jnp.abs(value), jnp.inf)  # after halving, a Newton step gets its chance
        steps = steps + 1
        done = jnp.abs(target - x) <= tolerance * jnp.abs(target)
        status = jnp.where(done, int(Status.CONVERGED), jnp.where(steps >= max_steps, int(Status.MAX_STEPS), _RUNNING))
        status = jnp.where(jnp.isfinite(value), status, int(Status.NONFINITE))
        return target, *at(target), below, above, last, stride, status, steps

    first = (x, *at(x), below, above, jnp.full_like(x, jnp.inf), jnp.abs(upper - lower), status, jnp.zeros_like(status))
    x, value, _, _, _, _, _, status, steps = while_loop(running, body, first)
    info = SolveInfo(status.astype(jnp.int32), steps.astype(jnp.int32), jnp.abs(value))
    return x, info
