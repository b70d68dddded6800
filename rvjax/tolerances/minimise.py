"""Half-widths that minimise any smooth objective, by any optimiser of optax.

Where `allocate` meets requirements, this minimises J = objective + sum of costs.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.progress import progress_bar
from rvjax.population import Estimate, Population, of_groups, student
from rvjax.response import Response
from rvjax.status import SolveInfo, Status
from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.problem import check_counts, costs_by_field
from rvjax.tolerances.pathwise import Objective, Sampled, inwards

if TYPE_CHECKING:
    import optax

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
    tolerances: Any,
    *,
    costs: Any,
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
    sampled = Sampled(objective, response, population, priced, samples)
    with progress_bar(progress, steps + _ENDS, "minimising", "step") as advance:
        x, history, finite = _descend(sampled, optimizer, steps, seed, fresh, advance)
        looks = []
        for k in range(_ENDS if finite else 0):
            looks.append(sampled.look(x, sampled.units(seed + 1, k))[:2])
            advance(1)
    return _minimum(sampled, x, history, steps if finite else len(history) - 1, looks)


def _check(population: Population, costs: Any, priced: Mapping[str, Cost], **counts: int) -> None:
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
    sampled: Sampled,
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
        look = value, slope, failed = sampled.look(x, z)
        history.append(float(value))
        if step == 0 and not math.isfinite(history[0]):
            count = f"{int(failed)} of {sampled.samples} units fail"
            raise ValueError(f"objective = {history[0]:.6g} at the start: must be finite; {count}")
        if not (math.isfinite(history[-1]) and np.isfinite(slope).all()):
            return x, history, False
        state, x = sampled.step(optimizer, state, x, z, look)
        advance(1)
    return x, history, True


def _minimum(
    sampled: Sampled, x: jax.Array, history: list[float], steps: int, looks: list[tuple[jax.Array, jax.Array]]
) -> Minimum:
    """The result, from J and its gradient on independent samples; none where an earlier one was not finite."""
    t = sampled.half_widths(x)
    cost = sampled.cost(t)
    value = gradient = Estimate.about(math.nan, math.nan, 0.0)
    status = Status.NONFINITE
    values, slopes = (np.array(rows, float) for rows in zip(*looks)) if looks else (np.array([math.nan]),) * 2
    if np.isfinite(values).all() and np.isfinite(slopes).all():
        value = of_groups(values, float(values.mean()), 0.95)
        mean = np.asarray(inwards(jnp.asarray(slopes.mean(axis=0)), x, sampled.given))
        length = float(np.linalg.norm(mean)) / abs(cost)
        error = math.sqrt(float(slopes.var(axis=0, ddof=1)[mean != 0].sum()) / len(slopes)) / abs(cost)
        sides = Estimate.about(length, error, student(0.95, len(slopes)))
        gradient = dataclasses.replace(sides, lower=max(0.0, sides.lower))
        status = Status.CONVERGED if length < _FLAT + 3 * error else Status.MAX_STEPS
    info = SolveInfo(jnp.int32(status), jnp.int32(steps), jnp.asarray(gradient.value))
    moved = sampled.population.with_half_widths(t).tolerances
    return Minimum(t, moved, value, gradient, cost, np.array(history), info)
