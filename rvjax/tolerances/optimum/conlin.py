"""The cheapest half-widths under a separable model of the constraints.

Around a known point each constraint is modelled as a root sum of squares, s^2 = s0^2 + sum_j b_j
(t_j^2 - t0_j^2), s = margin + distance of the nominal response from the limit: exact for linear
responses without mean shift, and right to first order for all; worst cases as a sum, with power 1 for 2.
The model is separable, so its dual function is a sum over the fields (convex linearization, Fleury 1989):
at given prices of the constraints every field has its own minimum between its bounds, found by a grid and
bisection. The prices that maximise the dual function are those of the optimum: by Newton's method, and where minima
of the fields jump by a quasi-Newton method. With reciprocal costs a field inside its bounds has the closed form
t_j ~ (c_j k_j / b_j)^(1/(k_j+2)).
"""

import bisect
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from rvjax.records import promote
from rvjax.tolerances.optimum.sample_average import Point

_CELLS, _HALVINGS = 32, 45  # of the range of a field: a table of costs may have several minima
_MOST = 1e5  # price of a constraint, in total costs, that no half-widths within the bounds can meet
_KNOWN = 1e-7  # of a constraint of the model
_TRIALS = 2.0 ** np.arange(-12, 17)  # prices common to all constraints, one of which is near the largest of the optimum
_STEPS, _LEAST = 60, 1e-9  # of Newton's method, and the least damping, in parts of the curvature
_LONGEST, _NEXT = 5.0, 0.01  # growth of a price in a step, and the price after 0 over that
_FLAT = 1e-9  # a smaller curvature of the dual function is none
_GROWTH = 1e-6  # of prices that leave a constraint violated, where the minimum of a field jumps; doubled at each trial


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
    `low` and `high` (j,) bound the half-widths. Where these cannot meet a constraint, its violation is as small as
    they let it be.
    """
    constant, weights = _model(point, distance, powers)
    model = _Model(costs, np.log(point.half_widths), np.log(low), np.log(high), constant, weights, powers)
    first = model.first()
    prices = model.by_newton(first)
    if prices is None:

        def dual(prices: np.ndarray) -> tuple[float, np.ndarray]:
            value, excess, _, _ = model.minima(prices)
            return -value, -excess

        bounds = [(0.0, _MOST)] * len(distance)
        options = dict(ftol=1e-15, gtol=_KNOWN, maxiter=200, maxcor=20)
        prices = scipy.optimize.minimize(dual, first, jac=True, bounds=bounds, options=options).x
    growth = _GROWTH
    while True:
        _, excess, found, _ = model.minima(prices)
        violated = excess > 10 * _KNOWN
        if not (violated & (prices < _MOST)).any():
            break
        prices = np.where(violated, np.minimum((1 + growth) * np.maximum(prices, _GROWTH), _MOST), prices)
        growth *= 2
    return np.clip(np.exp(found), low, high), prices * powers * model.total / distance


class _Model:
    """The separable model, in logarithms of half-widths and parts of the total cost."""

    def __init__(self, costs: tuple[Any, ...], start: np.ndarray, *limits: np.ndarray) -> None:
        self.total = float(total_cost(costs, np.exp(start)))
        self._count = len(limits[-1])
        leaves, self._tree = jax.tree.flatten((costs, self.total, start, *limits))
        self._given = jax.device_put(leaves)  # flat: records of costs take as long to flatten as all the rest of a call

    def minima(self, prices: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Value of the dual function, excess (c,), logarithms of the half-widths (j,) and -Hessian (c, c) at prices."""
        value, excess, x, bent = jax.device_get(_minima(self._tree, prices, *self._given))
        return float(value), excess, x, bent

    def first(self) -> np.ndarray:
        """A common price of all constraints from which the dual function falls either way, to a factor of 2."""
        count = self._count

        def falls(trial: float) -> bool:
            return bool(self.minima(np.full(count, trial))[1].sum() <= 0)

        return np.full(count, _TRIALS[bisect.bisect_left(_TRIALS[:-1], True, key=falls)])

    def by_newton(self, prices: np.ndarray) -> np.ndarray | None:
        """Prices of the optimum from others on, by damped Newton steps; None where these do not arrive."""
        value, excess, _, bent = self.minima(prices)
        damping = _LEAST
        for _ in range(_STEPS):
            free = ((prices > 0) | (excess > 0)) & ((prices < _MOST) | (excess < 0))
            if not (np.abs(excess[free]) > _KNOWN).any():
                return prices
            damped = (bent + damping * np.diag(np.maximum(np.diag(bent), _FLAT)))[np.ix_(free, free)]
            trial = prices.copy()
            trial[free] += np.linalg.solve(damped, excess[free])
            trial = np.clip(trial, 0.0, np.minimum(_LONGEST * (prices + _NEXT), _MOST))
            rise, found = float(excess @ (trial - prices)), self.minima(trial)
            if rise > 0 and found[0] >= value + 1e-4 * rise - 1e-14 * abs(value):
                prices, damping, (value, excess, _, bent) = trial, max(damping / 10, _LEAST), found
            else:
                damping = max(10 * damping, 1e-2)
        return prices if (prices == _MOST).any() else None  # the rest of what cannot be met


def predicted(point: Point, distance: np.ndarray, powers: np.ndarray, half_widths: np.ndarray) -> np.ndarray:
    """s/distance (n, c) of each constraint at sets of half-widths (n, j), under the model around `point`."""
    constant, weights = _model(point, distance, powers)
    grown = np.expm1(powers[:, None] * np.log(half_widths / point.half_widths)[:, None, :])
    return np.maximum(constant + np.sum(weights * grown, axis=2), 0.0) ** (1 / powers)


def _model(point: Point, distance: np.ndarray, powers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s0/distance)^p (c,), and b_j t0_j^p/distance^p (c, j)."""
    reach = np.maximum(point.margins + distance, 1e-3 * distance)
    constant = (reach / distance) ** powers
    return constant, (constant / reach)[:, None] * point.slopes


@jax.jit
def total_cost(costs: tuple[Any, ...], half_widths: jax.Array) -> jax.Array:
    """Sum of the costs of all fields."""
    return jnp.sum(_each(costs)(half_widths))


def _each(costs: tuple[Any, ...]) -> Callable[[jax.Array], jax.Array]:
    """Costs (j,) of half-widths (j,); costs of one kind are stacked, so that many fields stay a few operations."""
    kinds: dict[Any, list[int]] = {}
    for j, cost in enumerate(costs):
        shapes = tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(cost))
        kinds.setdefault((type(cost), shapes), []).append(j)
    groups = [(np.array(js), promote(*(costs[j] for j in js))) for js in kinds.values()]
    stacks = [
        (js, jax.tree.map(lambda *leaves: jnp.stack(leaves), *([same] if len(js) == 1 else same)))
        for js, same in groups
    ]
    order = np.argsort(np.concatenate([js for js, _ in stacks]))

    def each(half_widths: jax.Array) -> jax.Array:
        parts = [jax.vmap(lambda cost, t: cost(t))(stack, half_widths[js]) for js, stack in stacks]
        return jnp.concatenate(parts)[order]

    return each


@functools.partial(jax.jit, static_argnums=0)
def _minima(tree: Any, prices: Any, *leaves: Any) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Dual function at prices (c,), excess (c,), logarithms of the half-widths there, and -d excess/d prices (c, c)."""
    costs, total, start, low, high, constant, weights, powers = jax.tree.unflatten(tree, leaves)
    cost = _each(costs)

    def grown(x: jax.Array) -> jax.Array:
        return jnp.expm1(jnp.outer(powers, x - start))

    def lagrangian(x: jax.Array) -> jax.Array:
        return cost(jnp.exp(x)) / total + prices @ (weights * grown(x))

    def slope(x: jax.Array) -> jax.Array:
        return jax.jvp(lagrangian, (x,), (jnp.ones_like(x),))[1]

    grid = low[None] + jnp.outer(jnp.linspace(0.0, 1.0, _CELLS + 1), high - low)
    best = jnp.argmin(jax.lax.map(lagrangian, grid), axis=0)
    fields = jnp.arange(len(start))
    cell = grid[jnp.maximum(best - 1, 0), fields], grid[jnp.minimum(best + 1, _CELLS), fields]

    def halve(_: int, cell: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        middle = (cell[0] + cell[1]) / 2
        rises = slope(middle) > 0
        return jnp.where(rises, cell[0], middle), jnp.where(rises, middle, cell[1])

    left, right = jax.lax.fori_loop(0, _HALVINGS, halve, cell)
    x = jnp.where(left <= low, low, jnp.where(right >= high, high, (left + right) / 2))
    excess = constant + jnp.sum(weights * grown(x), axis=1) - 1
    # A field between its bounds gives way to a price by its reach over its curvature.
    curvature = jax.jvp(slope, (x,), (jnp.ones_like(x),))[1]
    moves = (x > low) & (x < high) & (curvature > 0)
    reach = powers[:, None] * weights * (grown(x) + 1)
    gives = jnp.where(moves, 1 / jnp.where(moves, curvature, 1.0), 0.0)
    bent = jnp.einsum("cj,j,dj->cd", reach, gives, reach)
    return jnp.sum(cost(jnp.exp(x))) / total + prices @ excess, excess, x, bent
