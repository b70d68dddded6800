"""Costs of half-widths, one for all elements of a field, and losses: what deviations cost inside the limits (Taguchi).

A new cost function is one class: `@record class Mine(Cost)` with `name`, its parameters as fields, `finest`,
`coarsest` and `__call__`. Allocation, studies and pages take it from `COSTS`.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Estimate, deviate_of
from rvjax.records import IN_ERROR_UNIT, Array, Record, Scalar, concrete, field, promote, record
from rvjax.tolerances.batch.statistics import Statistics

COSTS: dict[str, type["Cost"]] = {}
"""Cost functions by their names in study files."""


class Cost(Record):
    """Cost of a half-width, within the range of a process; its fields are the keys of a study file."""

    name: ClassVar[str] = ""
    finest: Scalar
    coarsest: Scalar

    def __init_subclass__(cls) -> None:
        if cls.name:
            COSTS[cls.name] = cls

    def __call__(self, half_width: Scalar) -> Array:
        """Cost of a half-width."""
        raise NotImplementedError


@record
class _Process(Cost):
    """Costs within the range of a process."""

    _: dataclasses.KW_ONLY
    finest: Scalar = field(IN_ERROR_UNIT, "smallest half-width the process can hold", sign="positive")
    coarsest: Scalar = field(IN_ERROR_UNIT, "largest half-width of the process", sign="positive")
    fixed: Scalar = field("-", "cost that no tolerance saves", default=0.0)
    scale: Scalar = field("-", "cost above fixed, at the reference or at half-width 0", default=1.0, sign="positive")

    def _check(self) -> None:
        finest, coarsest = self.finest, self.coarsest
        if concrete(finest, coarsest) and not (finest <= coarsest and math.isfinite(coarsest)):
            owner = type(self).__name__
            raise ValueError(f"{owner}.finest = {finest:.6g}: must not exceed coarsest = {coarsest:.6g}")


@record
class ReciprocalPower(_Process):
    """Cost fixed + scale (reference/t)^power of a half-width t, within the process range."""

    name: ClassVar[str] = "reciprocal_power"

    _: dataclasses.KW_ONLY
    reference: Scalar = field(
        IN_ERROR_UNIT, "half-width that scale belongs to; give it for angles", default=10e-6, sign="positive"
    )
    power: Scalar = field("-", "exponent", default=1.0, sign="positive")

    def __call__(self, half_width: Scalar) -> Array:
        """Cost of a half-width."""
        return jnp.asarray(self.fixed + self.scale * (self.reference / half_width) ** self.power)


@record
class Exponential(_Process):
    """Cost fixed + scale exp(-t/decay) of a half-width t, within the process range."""

    name: ClassVar[str] = "exponential"

    _: dataclasses.KW_ONLY
    decay: Scalar = field(IN_ERROR_UNIT, "half-width over which the cost falls by e", sign="positive")

    def __call__(self, half_width: Scalar) -> Array:
        """Cost of a half-width."""
        return jnp.asarray(self.fixed + self.scale * jnp.exp(-half_width / self.decay))


@record
class Table(Cost):
    """Measured costs, interpolated linearly in log cost over log half-width; the table is the process range."""

    name: ClassVar[str] = "table"

    half_widths: Array | np.ndarray = field(IN_ERROR_UNIT, "ascending half-widths", shape=("pairs",), sign="positive")
    costs: Array | np.ndarray = field("-", "cost at each half-width, falling", shape=("pairs",), sign="positive")

    @property
    def finest(self) -> Scalar:  # type: ignore[override]
        """First half-width of the table."""
        return self.half_widths[0]

    @property
    def coarsest(self) -> Scalar:  # type: ignore[override]
        """Last half-width of the table."""
        return self.half_widths[-1]

    def __call__(self, half_width: Scalar) -> Array:
        """Cost of a half-width."""
        t = jnp.asarray(half_width)
        xs, ys = (jnp.log(jnp.asarray(values, t.dtype)) for values in (self.half_widths, self.costs))
        return jnp.exp(jnp.interp(jnp.log(t), xs, ys))

    def _check(self) -> None:
        if not concrete(self.half_widths, self.costs):
            return
        if np.ndim(self.half_widths) != 1 or np.size(self.half_widths) < 2:
            raise ValueError(f"Table.half_widths = {self.half_widths!r}: needs at least two")
        if np.shape(self.costs) != np.shape(self.half_widths):
            raise ValueError(f"Table.costs = {self.costs!r}: must have one cost for each half-width")
        if not np.all(np.diff(self.half_widths) > 0):
            raise ValueError(f"Table.half_widths = {np.asarray(self.half_widths)}: must ascend")
        if not np.all(np.diff(self.costs) < 0):
            raise ValueError(f"Table.costs = {np.asarray(self.costs)}: must fall as the half-width grows")


class Costs:
    """Costs of several fields, by one program for all fields of a kind."""

    def __init__(self, costs: Sequence[Cost]) -> None:
        leaves, self._tree = jax.tree.flatten(tuple(costs))
        self._leaves = jax.device_put(leaves)  # flat: records take as long to flatten as all the rest of a call

    def at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Costs (j,), their first and second derivatives (j,) to the logarithms (j,) of the half-widths."""
        if not len(logs):
            return logs, logs, logs
        found, slopes, bends = np.asarray(_along(self._tree, logs, *self._leaves), float)  # one copy for all three
        return found, slopes, bends


@functools.partial(jax.jit, static_argnums=0)
def _along(tree: Any, logs: jax.Array, *leaves: jax.Array) -> jax.Array:
    each, ones = _each(jax.tree.unflatten(tree, leaves)), jnp.ones_like(logs)

    def slopes(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(lambda x: each(jnp.exp(x)), (x,), (ones,))

    (found, first), (_, second) = jax.jvp(slopes, (logs,), (ones,))
    return jnp.stack([found, first, second])


@jax.jit
def total_cost(costs: tuple[Cost, ...], half_widths: jax.Array) -> jax.Array:
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


@record
class QuadraticLoss(Record):
    """Loss price ((y - target)/at)^2 of a unit with the response y.

    Its mean over units is price (Var[y] + (E[y] - target)^2)/at^2, so it is smooth in the half-widths.
    """

    price: Scalar = field("-", "loss of a unit with the deviation `at`, in units of the costs", sign="nonnegative")
    at: Scalar = field("-", "deviation from the target that costs the price, unit of the response", sign="positive")
    target: Scalar = field("-", "response without loss, unit of the response", default=0.0)

    def __call__(self, values: Scalar) -> Array:
        """Loss of each value.

        Args:
            values: of the response, any shape.
        """
        return self.price * ((values - self.target) / self.at) ** 2  # type: ignore[return-value]

    def slope(self, values: Scalar) -> Array:
        """Derivative of the loss to each value.

        Args:
            values: of the response, any shape.
        """
        return 2 * self.price * (values - self.target) / self.at**2  # type: ignore[return-value]

    def expected(self, mean: Estimate, sd: Estimate, deviate: float) -> Estimate:
        """Mean loss of units by the statistics of their response: price (sd^2 + (mean - target)^2)/at^2.

        The errors of both add up: no correlation makes the true one larger.

        Args:
            mean: of the response.
            sd: of the response.
            deviate: standard normal one of the confidence.
        """
        off, scale = mean.value - float(self.target), float(self.price) / float(self.at) ** 2
        error = 2 * scale * (sd.value * sd.error + abs(off) * mean.error) + scale * (sd.error**2 + mean.error**2)
        found = Estimate.about(scale * (sd.value**2 + off**2), error, deviate)
        return dataclasses.replace(found, lower=max(found.lower, 0.0))

    def _check(self) -> None:
        for name in ("price", "at", "target"):
            value = getattr(self, name)
            if concrete(value) and not math.isfinite(value):
                raise ValueError(f"QuadraticLoss.{name} = {value!r}: must be finite")


def expected_losses(losses: Mapping[str, QuadraticLoss], statistics: Statistics) -> dict[str, Estimate]:
    """Mean loss of each response by the statistics of units that do not fail; inf where a response was infinite.

    Args:
        losses: by name of the response.
        statistics: of the units.
    """
    deviate, mean, sd = deviate_of(statistics.confidence), statistics.mean, statistics.sd
    endless = Estimate(math.inf, math.nan, math.inf, math.inf)
    return {
        name: endless if statistics.infinite[name] else item.expected(mean[name], sd[name], deviate)
        for name, item in losses.items()
    }
