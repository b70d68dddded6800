"""Largest root of an equation that falls in the end, each evaluation being a whole turn of equilibria.

The unknown is the logarithm of a torque, the value a tenth of three times that of life over the life that is wanted:
where life falls with the exponent 10/3 the value is the step to the root.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.status import SolveInfo, Status, succeeded

EVALUATIONS = 64
_RANGE = 16.0  # below the start, in the logarithm: a ten millionth of it is no load
_EDGE = 1e-4  # of the torque: from here on a root lies where a contact law ends

Evaluated = tuple[jax.Array, jax.Array, jax.Array, jax.Array]  # value, status, steps of the equilibria, memory
Evaluate = Callable[[jax.Array, jax.Array], Evaluated]
Root = tuple[jax.Array, jax.Array, SolveInfo]


class Search(NamedTuple):
    """State of the search."""

    x: jax.Array  # next
    memory: jax.Array  # of the evaluations, from which the next one starts
    lower: jax.Array  # highest x with a value >= 0; -inf: none yet
    upper: jax.Array  # lowest x with a value < 0, or beyond a contact law; inf: none yet
    beyond: jax.Array  # whether `upper` is beyond a contact law
    last: jax.Array  # x before, NaN at first
    value: jax.Array  # there
    pace: jax.Array  # multiple of the value that a step without bracket takes
    status: jax.Array  # -1 while it runs
    evaluations: jax.Array
    steps: jax.Array  # of the equilibria


def largest_root(evaluate: Evaluate, start: jax.Array, memory: jax.Array) -> Root:
    """The root, what the evaluations remember of it, and how the search ended.

    Args:
        evaluate: (x, memory) -> (value, status, steps of the equilibria, memory); CONTACT_OVERLOAD: x is too high.
        start: ().
        memory: of the first evaluation.
    """
    accuracy = max(1e-10, 100 * float(jnp.finfo(start.dtype).eps))

    def onward(state: Search) -> Search:
        value, status, steps, memory = evaluate(state.x, state.memory)
        x, fine = state.x, succeeded(status)
        over = status == Status.CONTACT_OVERLOAD
        value = jnp.where(fine, value, -jnp.log(2.0)).astype(x.dtype)
        above = (over | (fine & (value < 0))) & (x < state.upper)
        lower = jnp.where(fine & (value >= 0), x, state.lower)
        upper, beyond = jnp.where(above, x, state.upper), jnp.where(above, over, state.beyond)

        slope = (value - state.value) / jnp.where(x == state.last, 1, x - state.last)
        secant = x - value / jnp.where(slope < 0, slope, -1)
        usable = fine & (slope < 0) & jnp.isfinite(secant)
        bracketed = jnp.isfinite(lower) & jnp.isfinite(upper)
        middle = 0.5 * (lower + upper)
        inside = usable & (secant > lower) & (secant < upper) & (state.evaluations % 8 != 7)
        # Without bracket: from above the value undershoots where life falls less steeply, so the root is not passed.
        stuck = jnp.abs(value) > 0.5 * jnp.abs(state.value)
        pace = jnp.where(stuck, 2 * state.pace, 1)
        open_step = jnp.where(
            usable & ~stuck, jnp.clip(secant - x, -4 * jnp.abs(value), 4 * jnp.abs(value)), pace * value
        )
        target = jnp.where(bracketed, jnp.where(inside, secant, middle), x + open_step)

        reached = fine & ((jnp.abs(value) <= accuracy) | (upper - lower <= accuracy))
        ended = jnp.where(bracketed & beyond & (upper - lower <= _EDGE), int(Status.CONTACT_OVERLOAD), -1)
        ended = jnp.where(target < start - _RANGE, int(Status.NO_BRACKET), ended)
        ended = jnp.where(state.evaluations + 1 >= EVALUATIONS, int(Status.MAX_STEPS), ended)
        ended = jnp.where(reached, int(Status.CONVERGED), ended)
        ended = jnp.where(fine | over, ended, status).astype(jnp.int32)
        return Search(
            x=jnp.where(ended == -1, target, x),
            memory=memory,
            lower=lower,
            upper=upper,
            beyond=beyond,
            last=x,
            value=value,
            pace=pace,
            status=ended,
            evaluations=state.evaluations + 1,
            steps=state.steps + steps.astype(jnp.int32),
        )

    zero = jnp.zeros((), jnp.int32)
    far = jnp.asarray(jnp.inf, start.dtype)
    nothing = jnp.asarray(jnp.nan, start.dtype)
    first = Search(
        start, memory, -far, far, jnp.zeros((), bool), nothing, nothing, jnp.ones((), start.dtype), zero - 1, zero, zero
    )
    found = jax.lax.while_loop(lambda state: state.status == -1, onward, first)
    return found.x, found.memory, SolveInfo(found.status, found.steps, jnp.abs(found.value))
