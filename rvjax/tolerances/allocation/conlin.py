"""The cheapest half-widths under a separable model of the constraints.

Around a known point each constraint is modelled as a root sum of squares, s^2 = s0^2 + sum_j b_j
(t_j^2 - t0_j^2), s = margin + distance of the nominal response from the limit: exact for linear
responses without mean shift, and right to first order for all; worst cases as a sum, with power 1 for 2.
With reciprocal costs its optimum is the closed form t_j ~ (c_j k_j / b_j)^(1/(k_j+2)). The model costs
nothing to evaluate, so an augmented Lagrangian with Adam (Hestenes 1969, Powell 1969; optax) solves it
for any number of constraints and any cost.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from rvjax.records import promote
from rvjax.tolerances.allocation.sample_average import Point

_MULTIPLIER_STEPS, _STEPS = 30, 120
_PENALTY = 4.0
_RATES = optax.cosine_decay_schedule(0.05, _STEPS, alpha=0.002)


def cheapest(
    costs: tuple[Any, ...],
    point: Point,
    distance: np.ndarray,
    powers: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Half-widths (j,) of least cost under the model around `point`, and its multipliers, cost per unit of each margin.

    `distance` (c,) is that of the nominal response from each limit, `powers` (c,) those by which half-widths add up;
    `low` and `high` (j,) bound the half-widths.
    """
    reach = np.maximum(point.margins + distance, 1e-3 * distance)
    constant = (reach / distance) ** powers
    weights = (constant / reach)[:, None] * point.slopes  # b_j t0_j^2 / distance^2
    total = float(total_cost(costs, jnp.asarray(point.half_widths)))
    arrays = [jnp.asarray(a) for a in (np.log(point.half_widths), np.log(low), np.log(high), constant, weights, powers)]
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        found, prices = _solve(costs, total, *arrays)
    return np.clip(np.exp(np.asarray(found)), low, high), np.asarray(prices) * total / distance


@jax.jit
def total_cost(costs: tuple[Any, ...], half_widths: jax.Array) -> jax.Array:
    """Sum of the costs of all fields."""
    return _summed(costs)(half_widths)


def _summed(costs: tuple[Any, ...]) -> Callable[[jax.Array], jax.Array]:
    """The sum as a function; costs of one kind are stacked, so that hundreds of fields stay a few operations."""
    kinds: dict[Any, list[int]] = {}
    for j, cost in enumerate(costs):
        shapes = tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(cost))
        kinds.setdefault((type(cost), shapes), []).append(j)
    groups = [(np.array(js), promote(*(costs[j] for j in js))) for js in kinds.values()]
    stacks = [
        (js, jax.tree.map(lambda *leaves: jnp.stack(leaves), *([same] if len(js) == 1 else same)))
        for js, same in groups
    ]

    def total(half_widths: jax.Array) -> jax.Array:
        parts = [jnp.sum(jax.vmap(lambda cost, t: cost(t))(stack, half_widths[js])) for js, stack in stacks]
        return jnp.sum(jnp.stack(parts))

    return total


@jax.jit
def _solve(costs: Any, total: Any, start: Any, low: Any, high: Any, constant: Any, weights: Any, powers: Any) -> Any:
    """Augmented Lagrangian in logarithms of the half-widths, projected to the bounds."""
    cost = _summed(costs)
    optimiser = optax.adam(_RATES, b1=0.8, b2=0.95)

    def constraints(x: jax.Array) -> jax.Array:
        grown = jnp.sum(weights * jnp.expm1(jnp.outer(powers, x - start)), axis=1)
        return jnp.log(jnp.maximum(constant + grown, 1e-6)) / powers  # log(s/distance), gentle where far violated

    def lagrangian(x: jax.Array, prices: jax.Array) -> jax.Array:
        pressed = jnp.maximum(0.0, prices + _PENALTY * constraints(x))
        return cost(jnp.exp(x)) / total + (pressed @ pressed - prices @ prices) / (2 * _PENALTY)

    def step(_: int, carry: Any) -> Any:
        x, state, prices = carry
        updates, state = optimiser.update(jax.grad(lagrangian)(x, prices), state)
        return jnp.clip(optax.apply_updates(x, updates), low, high), state, prices

    def round_(_: int, carry: Any) -> Any:
        x, prices = carry
        x, _state, _prices = jax.lax.fori_loop(0, _STEPS, step, (x, optimiser.init(x), prices))
        return x, jnp.maximum(0.0, prices + _PENALTY * constraints(x))

    return jax.lax.fori_loop(0, _MULTIPLIER_STEPS, round_, (jnp.clip(start, low, high), jnp.zeros_like(constant)))
