"""Half-widths that minimise any smooth objective, by any optimiser of optax.

Where `allocate` meets requirements, this minimises J = objective + sum of costs. The random numbers of a unit do not
depend on the half-widths, so J on a sample of units is a smooth function of these where no unit begins to fail, and its
gradient passes through every unit ("pathwise").
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.progress import progress_bar
from rvjax.base.words import unknown
from rvjax.population import Estimate, Population, drawn, of_groups, root_key, student
from rvjax.records import PyTree
from rvjax.response import Response, Values, evaluate, per_response, unwrapped
from rvjax.status import SolveInfo, Status, succeeded
from rvjax.tolerances.allocation.cost import Cost, total_cost
from rvjax.tolerances.allocation.problem import check_counts, costs_by_field

if TYPE_CHECKING:
    import optax


Objective = Callable[[Any, dict[str, Any]], Any]
"""Function of the responses of a sample and of the half-widths by field."""

Look = tuple[jax.Array, jax.Array, jax.Array]
"""J, its gradient, and the number of failed units."""


class _Priced(NamedTuple):
    """Population, costs of its fields, and the logarithms of the ends of their half-widths."""

    population: Population
    costs: tuple[Cost, ...]
    low: jax.Array
    high: jax.Array


class _Sampled:
    """J and its gradient to the logarithms x of the half-widths, on samples of units."""

    def __init__(
        self, objective: Objective, response: Response, population: Population, priced: Mapping[str, Cost], samples: int
    ) -> None:
        self.response, self.population, self.samples = response, population, samples
        self.fields, costs = tuple(priced), tuple(priced.values())
        self.ends = np.array([(cost.finest, cost.coarsest) for cost in costs], float).T
        given = np.array([population.active[name].half_width for name in self.fields], float)
        logs = jnp.asarray(np.log([*self.ends, np.clip(given, *self.ends)]), jnp.result_type(float))
        self.start, self.given = logs[2], _Priced(population, costs, logs[0], logs[1])
        self.options = dict(fields=self.fields, objective=objective)

    def units(self, seed: int, number: int) -> jax.Array:
        """Random numbers (numbers, samples) of a sample; its units follow those of the sample before."""
        return drawn(self.population, root_key(seed), np.uint32(number * self.samples % 2**32), count=self.samples)

    def look(self, x: jax.Array, z: jax.Array) -> Look:
        """J, its gradient, and the number of failed units with random numbers z at x (fields,)."""
        return _look(self.response, self.given, x, z, **self.options)

    def half_widths(self, x: jax.Array) -> dict[str, float]:
        """Half-widths; at their ends without a rounding."""
        low, high, t = (np.asarray(rows) for rows in (x <= self.given.low, x >= self.given.high, jnp.exp(x)))
        finest, coarsest = self.ends
        t = np.where(low, finest, np.where(high, coarsest, np.clip(t, finest, coarsest)))
        return dict(zip(self.fields, map(float, t)))


@per_response(static=("fields", "objective"))
def _look(
    response: Response, given: _Priced, x: jax.Array, z: jax.Array, *, fields: tuple[str, ...], objective: Objective
) -> Look:
    total = _total(response, given, z, fields, objective)
    (value, failed), slope = jax.value_and_grad(total, has_aux=True)(x)
    return value, slope, failed


@per_response(static=("fields", "objective", "optimizer"))
def _step(
    response: Response,
    given: _Priced,
    x: jax.Array,
    z: jax.Array,
    state: object,
    value: jax.Array,
    slope: jax.Array,
    *,
    fields: tuple[str, ...],
    objective: Objective,
    optimizer: "optax.GradientTransformation",
) -> tuple[object, jax.Array]:
    import optax

    total, slope = _total(response, given, z, fields, objective), _inwards(slope, x, given)
    update = optax.with_extra_args_support(optimizer).update
    with jax.numpy_dtype_promotion("standard"):  # optax raises numbers to powers of its counts
        moved, state = update(slope, state, x, value=value, grad=slope, value_fn=lambda x: total(x)[0])
    return state, jnp.clip(x + moved, given.low, given.high)


def _inwards(slope: jax.Array, x: jax.Array, given: _Priced) -> jax.Array:
    """Slopes dJ/dx (fields,) at x, 0 where a step against them leads beyond the ends."""
    outwards = ((x <= given.low) & (slope > 0)) | ((x >= given.high) & (slope < 0))
    return jnp.where(outwards, 0, slope)


def _total(
    response: Response, given: _Priced, z: jax.Array, fields: tuple[str, ...], objective: Objective
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

    def forward(errors: Values) -> tuple[tuple[Values, jax.Array], object]:
        values, pull, status = jax.vjp(units, errors, has_aux=True)
        failed = ~succeeded(status)
        return (masked(values, failed, jnp.nan), failed), (pull, failed)

    def backward(kept: PyTree, slopes: tuple[Values, object]) -> tuple[Values]:
        pull, failed = kept
        (found,) = pull(masked(slopes[0], failed, 0.0))
        return (masked(found, failed, 0.0),)

    values_of.defvjp(forward, backward)
    return values_of


_FLAT = 0.02  # gradient of a minimum, as a part of all costs: J exceeds the least by about its square
_ENDS = 16  # independent samples that estimate the end
_PEAK = 0.1  # rate of adam: with a cosine decay 400 steps move a half-width by up to e^20
_MEMORY = 0.95  # of squared slopes: from starts up to 40 times too coarse within 0.4 %; with 0.999 145 % off


@dataclasses.dataclass(frozen=True)
class Minimum:
    """End of a minimisation of J = objective + sum of costs.

    Attributes:
        half_widths: {field: half-width}; of a NONFINITE end those at which it was met.
        tolerances: structure of the given ones, with these half-widths.
        objective: J on independent units, with its interval of 95 %.
        gradient: length of dJ/d log h over the sum of costs, on the same units; its error is that of the vector. A
            slope that leads beyond `finest` or `coarsest` counts as 0.
        cost: sum of costs, a part of J.
        history: J before each step, on the units of this step (steps,).
        info: CONVERGED if the gradient is below 0.02 + 3 of its errors, else MAX_STEPS. NONFINITE if J or its
            gradient is not finite; `steps` is then the number of steps before. `residual` is the gradient.
    """

    half_widths: dict[str, float]
    tolerances: Any
    objective: Estimate
    gradient: Estimate
    cost: float
    history: np.ndarray
    info: SolveInfo


@checked
def minimise(
    objective: Objective,
    response: Response,
    tolerances: object,
    *,
    costs: object,
    optimizer: "optax.GradientTransformation | None" = None,
    samples: int = 4096,
    steps: int = 400,
    seed: int = 0,
    fresh: bool = True,
    progress: bool = False,
) -> Minimum:
    """Minimise J = objective + sum of costs over the half-widths, between `finest` and `coarsest` of their costs.

    Changing a half-width scales the limits about their mid-point; shift and cp stay.

    Args:
        objective: pure, differentiable function of (values, half_widths) that returns one real number. `values` is a
            dict of arrays (samples,) by name of the response, or one array of a response without names; NaN where a
            unit fails. `half_widths` is a dict of numbers by field, SI.
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field; the optimiser starts there.
        costs: record or dict with a cost for each field that has a tolerance, or None to keep its half-width.
        optimizer: of optax, on the logarithms of the half-widths; None is adam with a cosine decay. One that searches
            along lines, such as `optax.lbfgs()`, needs `fresh=False`.
        samples: units of one sample, at least 100.
        steps: of the optimiser.
        seed: of the units; the independent units at the end have the next seed.
        fresh: True samples independent units at every step, False uses one sample.
        progress: show a progress bar.

    Returns:
        `Minimum`. Its estimates are from 16 independent samples.

    Raises:
        ValueError: names that do not fit, a field without a cost, or an objective that is not one finite number at
            the start.
    """
    import optax  # takes 0.2 s

    if not (optimizer is None or isinstance(optimizer, optax.GradientTransformation)):
        raise ValueError(f"optimizer = {optimizer!r}: must be an optax.GradientTransformation")
    population = Population.of(tolerances)
    priced = costs_by_field(costs, population.active)
    _check(population, costs, priced, samples=samples, steps=steps)
    optimizer = optimizer or _adam(steps)
    sampled = _Sampled(objective, response, population, priced, samples)
    with progress_bar(progress, steps + _ENDS, "minimising", "step") as advance:
        x, history, finite = _descend(sampled, optimizer, steps, seed, fresh, advance)
        looks = []
        for k in range(_ENDS if finite else 0):
            looks.append(sampled.look(x, sampled.units(seed + 1, k))[:2])
            advance(1)
    return _minimum(sampled, x, history, steps if finite else len(history) - 1, looks)


def _check(population: Population, costs: object, priced: Mapping[str, Cost], **counts: int) -> None:
    for name in population.active:
        given = costs.get(name, 0.0) if isinstance(costs, Mapping) else getattr(costs, name, 0.0)
        if name not in priced and given is not None:
            raise ValueError(f"costs: {name!r} has a tolerance and no cost; give None to keep its half-width")
    check_counts(**counts)


@functools.lru_cache(32)
def _adam(steps: int) -> "optax.GradientTransformation":
    """Adam whose rate decays to 0 over so many steps; one object, so that its program is compiled once."""
    import optax

    return optax.adam(optax.cosine_decay_schedule(_PEAK, steps), b2=_MEMORY)


def _descend(
    sampled: _Sampled,
    optimizer: "optax.GradientTransformation",
    steps: int,
    seed: int,
    fresh: bool,
    advance: Callable[[int], object],
) -> tuple[jax.Array, list[float], bool]:
    """Logarithms of the half-widths after all steps, J before each, and whether all were finite."""
    x, history = sampled.start, list[float]()
    state = jax.jit(optimizer.init)(x)
    for step in range(steps):
        if fresh or step == 0:
            z = sampled.units(seed, step)
        value, slope, failed = sampled.look(x, z)
        history.append(float(value))
        if step == 0 and not math.isfinite(history[0]):
            count = f"{int(failed)} of {sampled.samples} units fail"
            raise ValueError(f"objective = {history[0]:.6g} at the start: must be finite; {count}")
        if not (math.isfinite(history[-1]) and np.isfinite(slope).all()):
            return x, history, False
        state, x = _step(
            sampled.response, sampled.given, x, z, state, value, slope, optimizer=optimizer, **sampled.options
        )
        advance(1)
    return x, history, True


def _minimum(
    sampled: _Sampled, x: jax.Array, history: list[float], steps: int, looks: list[tuple[jax.Array, jax.Array]]
) -> Minimum:
    """The result, from J and its gradient on independent samples; none where an earlier one was not finite."""
    t = sampled.half_widths(x)
    cost = float(total_cost(sampled.given.costs, jnp.asarray(list(t.values()))))
    value = gradient = Estimate.about(math.nan, math.nan, 0.0)
    status = Status.NONFINITE
    values, slopes = (np.array(rows, float) for rows in zip(*looks)) if looks else (np.array([math.nan]),) * 2
    if np.isfinite(values).all() and np.isfinite(slopes).all():
        value = of_groups(values, float(values.mean()), 0.95)
        mean = np.asarray(_inwards(jnp.asarray(slopes.mean(axis=0)), x, sampled.given))
        length = float(np.linalg.norm(mean)) / abs(cost)
        error = math.sqrt(float(slopes.var(axis=0, ddof=1)[mean != 0].sum()) / len(slopes)) / abs(cost)
        sides = Estimate.about(length, error, student(0.95, len(slopes)))
        gradient = dataclasses.replace(sides, lower=max(0.0, sides.lower))
        status = Status.CONVERGED if length < _FLAT + 3 * error else Status.MAX_STEPS
    info = SolveInfo(jnp.int32(status), jnp.int32(steps), jnp.asarray(gradient.value))
    moved = sampled.population.with_half_widths(t).tolerances
    return Minimum(t, moved, value, gradient, cost, np.array(history), info)
