"""An objective on a sample of units, and its gradient to the half-widths through every unit ("pathwise").

The random numbers of a unit do not depend on the half-widths. So J = objective + sum of costs is a smooth function of
these where no unit begins to fail.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import unknown
from rvjax.population import Population, drawn, root_key
from rvjax.records import PyTree
from rvjax.response import Response, Values, evaluate, per_response, unwrapped
from rvjax.status import succeeded
from rvjax.tolerances.allocation.cost import Cost, total_cost

if TYPE_CHECKING:
    import optax

Objective = Callable[[Any, dict[str, Any]], Any]
"""Function of the responses of a sample and of the half-widths by field."""

Look = tuple[jax.Array, jax.Array, jax.Array]
"""J, its gradient, and the number of failed units."""


class Priced(NamedTuple):
    """Population, costs of its fields, and the logarithms of the ends of their half-widths."""

    population: Population
    costs: tuple[Cost, ...]
    low: jax.Array
    high: jax.Array


class Sampled:
    """J and its gradient to the logarithms x of the half-widths, on samples of units."""

    def __init__(
        self, objective: Objective, response: Response, population: Population, priced: Mapping[str, Cost], samples: int
    ) -> None:
        self.response, self.population, self.samples = response, population, samples
        self.fields, costs = tuple(priced), tuple(priced.values())
        self.ends = np.array([(cost.finest, cost.coarsest) for cost in costs], float).T
        given = np.array([population.active[name].half_width for name in self.fields], float)
        logs = jnp.asarray(np.log([*self.ends, np.clip(given, *self.ends)]), jnp.result_type(float))
        self.start, self.given = logs[2], Priced(population, costs, logs[0], logs[1])
        self._options = dict(fields=self.fields, objective=objective)

    def units(self, seed: int, number: int) -> jax.Array:
        """Random numbers (numbers, samples) of a sample.

        Args:
            seed: of the units.
            number: of the sample; its units follow those of the sample before.
        """
        return drawn(self.population, root_key(seed), np.uint32(number * self.samples % 2**32), count=self.samples)

    def look(self, x: jax.Array, z: jax.Array) -> Look:
        """J, its gradient, and the number of failed units.

        Args:
            x: logarithms of the half-widths (fields,).
            z: random numbers of the units.
        """
        return _look(self.response, self.given, x, z, **self._options)

    def step(
        self, optimizer: "optax.GradientTransformation", state: PyTree, x: jax.Array, z: jax.Array, look: Look
    ) -> tuple[PyTree, jax.Array]:
        """State of the optimiser and x after a step.

        Args:
            optimizer: of optax.
            state: of it, before the step.
            x: logarithms of the half-widths (fields,).
            z: random numbers of the units.
            look: J and its gradient there.
        """
        return _step(self.response, self.given, x, z, state, *look[:2], optimizer=optimizer, **self._options)

    def half_widths(self, x: jax.Array) -> dict[str, float]:
        """Half-widths; at their ends without a rounding."""
        low, high, t = (np.asarray(rows) for rows in (x <= self.given.low, x >= self.given.high, jnp.exp(x)))
        finest, coarsest = self.ends
        t = np.where(low, finest, np.where(high, coarsest, np.clip(t, finest, coarsest)))
        return dict(zip(self.fields, map(float, t)))

    def cost(self, half_widths: Mapping[str, float]) -> float:
        """Sum of costs."""
        return float(total_cost(self.given.costs, jnp.asarray(list(half_widths.values()))))


@per_response(static=("fields", "objective"))
def _look(
    response: Response,
    given: Priced,
    x: jax.Array,
    z: jax.Array,
    *,
    fields: tuple[str, ...],
    objective: Objective,
) -> Look:
    total = _total(response, given, z, fields, objective)
    (value, failed), slope = jax.value_and_grad(total, has_aux=True)(x)
    return value, slope, failed


@per_response(static=("fields", "objective", "optimizer"))
def _step(
    response: Response,
    given: Priced,
    x: jax.Array,
    z: jax.Array,
    state: PyTree,
    value: jax.Array,
    slope: jax.Array,
    *,
    fields: tuple[str, ...],
    objective: Objective,
    optimizer: "optax.GradientTransformation",
) -> tuple[PyTree, jax.Array]:
    import optax

    total, slope = _total(response, given, z, fields, objective), inwards(slope, x, given)
    update = optax.with_extra_args_support(optimizer).update
    with jax.numpy_dtype_promotion("standard"):  # optax raises numbers to powers of its counts
        moved, state = update(slope, state, x, value=value, grad=slope, value_fn=lambda x: total(x)[0])
    return state, jnp.clip(x + moved, given.low, given.high)


def inwards(slope: jax.Array, x: jax.Array, given: Priced) -> jax.Array:
    """Slopes, 0 where a step against them leads beyond the ends.

    Args:
        slope: dJ/dx (fields,).
        x: logarithms of the half-widths.
        given: with the ends.
    """
    outwards = ((x <= given.low) & (slope > 0)) | ((x >= given.high) & (slope < 0))
    return jnp.where(outwards, 0, slope)


def _total(
    response: Response,
    given: Priced,
    z: jax.Array,
    fields: tuple[str, ...],
    objective: Objective,
) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """Return J and the number of failed units as a function of x; beyond its ends J is that of the ends."""
    population, costs, low, high = given
    values_of = _values(response, population)

    def total(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        t = jnp.exp(jnp.where(x < low, low, jnp.where(x > high, high, x)))  # not `clip`: half a slope at an end
        half_widths = dict(zip(fields, t))
        values, failed = values_of(population.with_half_widths(half_widths).deviations(z))
        return _objective(objective, values, half_widths).astype(x.dtype) + total_cost(costs, t), failed.sum()

    return total


def _objective(objective: Objective, values: Values, half_widths: dict[str, jax.Array]) -> jax.Array:
    """Value of the objective; a ValueError names what is wrong with it."""
    names = (*values, *half_widths)
    try:
        value = objective(unwrapped(values), half_widths)
    except KeyError as error:
        if not isinstance(key := error.args[0], str) or key in names:
            raise
        rule = " is no name of the response or of a field; these are"
        raise unknown(f"objective: {key!r}", key, names, rule) from None
    if value is None:
        raise ValueError("objective: must return one real number, got None")
    number = jnp.asarray(value)
    if number.shape or not jnp.issubdtype(number.dtype, jnp.floating):
        raise ValueError(f"objective: must return one real number, got shape {number.shape} {number.dtype}")
    return number


def _values(response: Response, population: Population) -> Callable[..., tuple[Values, jax.Array]]:
    """Return values, NaN of failed units, and which failed, as a function of the errors by field, units last.

    A failed unit adds nothing to the gradient: its derivatives may be NaN, which 0 does not hide.
    """

    def units(errors: Values) -> tuple[Values, jax.Array]:
        return jax.vmap(lambda active: evaluate(response, population.fill(active)), in_axes=-1)(errors)

    def masked(values: Values, failed: jax.Array, absent: float) -> Values:
        return jax.tree.map(lambda rows: jnp.where(failed, absent, rows), values)

    @jax.custom_vjp
    def values_of(errors: Values) -> tuple[Values, jax.Array]:
        values, status = units(errors)
        failed = ~succeeded(status)
        return masked(values, failed, jnp.nan), failed

    def forward(errors: Values) -> tuple[tuple[Values, jax.Array], PyTree]:
        values, pull, status = jax.vjp(units, errors, has_aux=True)
        failed = ~succeeded(status)
        return (masked(values, failed, jnp.nan), failed), (pull, failed)

    def backward(kept: PyTree, slopes: tuple[Values, Any]) -> tuple[Values]:
        pull, failed = kept
        (found,) = pull(masked(slopes[0], failed, 0.0))
        return (masked(found, failed, 0.0),)

    values_of.defvjp(forward, backward)
    return values_of
