"""The elements of a prior: their names, how their standard numbers u = M z mix, and the values that belong to them.

Every element is e = d(u), where d is the map of its tolerance's distribution and u is standard normal; M has rows of
length one and holds correlation and batches, so that z ~ N(0, I) are exactly the numbers a `Population` draws.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import fori_loop, in_blocks
from rvjax._jax.sizes import PRIORS
from rvjax.base.fields import elements
from rvjax.population import Correlation, Population
from rvjax.records import PyTree

FAR = 38.0
"""Standard deviations beyond which a normal distribution has no mass that a float distinguishes from 0."""

"""Units in one call of the map: one program, and another one for draws."""

_HALVINGS = 64  # of the interval (-FAR, FAR): to the last bit


def values_of(population: Population, u: jax.Array) -> PyTree:
    """Return the structure of the prior with the values that belong to standard numbers u (p,)."""
    return population.fill({n: population.active[n].deviate(part) for n, part in population.by_field(u).items()})


def elementwise(population: Population, u: jax.Array) -> jax.Array:
    """Return the values of all elements (p,) as one vector."""
    parts = [population.active[n].deviate(part).reshape(-1) for n, part in population.by_field(u).items()]
    return jnp.concatenate(parts)


@jax.jit
def mapped(population: Population, u: jax.Array) -> tuple[jax.Array, PyTree]:
    """Values (k, p), and as structures with k on axis 0, of several units u (k, p)."""
    return jax.vmap(partial(elementwise, population))(u), jax.vmap(partial(values_of, population))(u)


@jax.jit
def standard(population: Population, values: jax.Array) -> jax.Array:
    """Find the u (k, p) at which the distributions have these values (k, p), by bisection; their slopes are positive.

    -FAR and FAR where the distribution does not reach the value.
    """

    def halve(_: object, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        middle = (ends[0] + ends[1]) / 2
        below = jax.vmap(partial(elementwise, population))(middle) < values
        return jnp.where(below, middle, ends[0]), jnp.where(below, ends[1], middle)

    start = jnp.full_like(values, FAR)
    low, high = fori_loop(0, _HALVINGS, halve, (-start, start))
    return (low + high) / 2


def mapped_values(elements: "Elements", u: np.ndarray) -> np.ndarray:
    """Values (k, p) of units u (k, p), on the host."""
    few = lambda part: mapped(elements.population, part)[0]  # noqa: E731
    return np.asarray(in_blocks(few, PRIORS[len(u) > PRIORS[1]], np.asarray(u, float)), float)


@dataclasses.dataclass(frozen=True, eq=False)
class Elements:
    """The elements of a prior, host side.

    Attributes:
        population: the prior.
    """

    population: Population

    @classmethod
    def of(cls, prior: object, correlation: Correlation = None) -> "Elements":
        """Return the elements of a prior.

        Raises:
            ValueError: no field has a tolerance, or as `Population.of`.
        """
        population = Population.of(prior, correlation)
        if not population.active or not sum(math.prod(t.shape) for t in population.active.values()):
            raise ValueError("prior: no active field; at least one must have a Tolerance")
        return cls(population)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each element, "field[i,j]"; scalars bare, nested fields dotted."""
        names = []
        for field, tolerance in self.population.active.items():
            names += elements(field, tolerance.shape)
        return tuple(names)

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Field of each element."""
        active = self.population.active.items()
        return tuple(name for name, tolerance in active for _ in range(math.prod(tolerance.shape)))

    @property
    def count(self) -> int:
        """Elements, p."""
        return len(self.names)

    @cached_property
    def mixing(self) -> np.ndarray:
        """M (p, numbers) with u = M z, its rows of length one."""
        population = self.population
        if population.mixing is not None:
            return np.asarray(population.mixing, float)
        matrix, row, column = np.zeros((self.count, population.numbers)), 0, 0
        for name, tolerance in population.active.items():
            size, numbers = math.prod(tolerance.shape), population.numbers_by_field[name]
            own, shared = np.arange(size), numbers - math.prod(tolerance.shape)
            matrix[row + own, column + own] = math.sqrt(1 - tolerance.batch) if shared else 1.0
            if shared:  # one factor, or one for each component of a vector
                matrix[row + own, column + size + own % shared] = math.sqrt(tolerance.batch)
            row, column = row + size, column + numbers
        return matrix

    def places(self, argument: str, given: str | Iterable[str]) -> np.ndarray:
        """Places of the elements that are named: by element, field, or the record or dict that holds fields.

        Raises:
            ValueError: a name that is none of them.
        """
        chosen: set[int] = set()
        for name in [given] if isinstance(given, str) else given:
            inside = (f"{name}[", f"{name}.")
            places = [i for i, own in enumerate(self.names) if own == name or own.startswith(inside)]
            if not places:
                known = ", ".join(self.population.active)
                raise ValueError(f"{argument} = {name!r}: no field of the prior with a Tolerance; these have: {known}")
            chosen.update(places)
        return np.array(sorted(chosen), int)

    def structure(self, values: np.ndarray) -> PyTree:
        """Return the structure of the prior with values (..., p): arrays (..., *shape), one number as a float."""
        parts: Mapping[str, Any] = {}
        ends = np.cumsum([math.prod(t.shape) for t in self.population.active.values()])
        pieces = np.split(np.asarray(values, float), ends[:-1], axis=-1)
        shapes = (values.shape[:-1] + t.shape for t in self.population.active.values())
        parts = {
            name: piece.reshape(shape) if shape else float(piece[0])
            for name, piece, shape in zip(self.population.active, pieces, shapes)
        }
        return self.population.fill(parts)

    def vector(self, argument: str, values: object) -> np.ndarray:
        """Return the active elements (p,) of a structure of values.

        Raises:
            ValueError: another structure or shape.
        """
        leaves = self._beside(argument, values)
        parts = []
        for name, tolerance in self.population.active.items():
            try:
                parts.append(np.broadcast_to(np.asarray(leaves[name], float), tolerance.shape).reshape(-1))
            except (TypeError, ValueError):
                raise ValueError(f"{argument}.{name}: must be numbers of shape {tolerance.shape}, in SI") from None
        return np.concatenate(parts)

    def beside(self, argument: str, other: object) -> dict[str, PyTree]:
        """Leaves of `other`, a structure like the prior, by active field."""
        leaves = self._beside(argument, other)
        return {name: leaves[name] for name in self.population.active}

    def _beside(self, argument: str, other: object) -> dict[str, PyTree]:
        _, treedef = self.population._flat
        try:
            leaves = treedef.flatten_up_to(other)
        except (ValueError, TypeError):
            raise ValueError(f"{argument}: must have the structure of the prior, got {type(other).__name__}") from None
        return dict(zip(self.population._leaves, leaves))

    def at(self, argument: str, values: object) -> np.ndarray:
        """Find the u (p,) of values within the prior's distributions.

        Raises:
            ValueError: another structure, outside the support of a distribution, or one whose elements depend on each
                other.
        """
        wanted = self.vector(argument, values)
        for name, tolerance in self.population.active.items():
            if tolerance.law.couples:
                raise ValueError(f"{argument}.{name}: {tolerance.distribution} vectors cannot be placed")
        u = np.asarray(standard(self.population, jnp.asarray(wanted[None])))[0]
        back = mapped_values(self, u[None])[0]
        widths = np.asarray([float(self.population.active[field].half_width) for field in self.fields])
        constant = widths == 0
        off = np.abs(back - wanted) > 1e-6 * np.maximum(widths, 1e-9 * np.abs(wanted))
        if off.any():
            worst = int(np.argmax(off))
            raise ValueError(f"{argument}.{self.names[worst]} = {wanted[worst]:.6g}: outside its distribution, in SI")
        return np.where(constant, 0.0, u)
