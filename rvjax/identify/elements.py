"""Elements of a prior, and which of them a measurement identifies.

Every element is e = d(u), where d is the map of its tolerance's distribution and u is standard normal; M has rows of
length one and holds correlation and batches, so that z ~ N(0, I) are exactly the numbers a `Population` draws, and
u = M z. With slopes J over z and J = U S V', lambda = s^2: the posterior covariance of z is V diag(1/(1 + lambda)) V',
a sum of positive terms that keeps its digits next to a lambda of 1e10. Equal lambda have no unique vectors: only their
subspace has a meaning.
"""

import dataclasses
import math
from collections.abc import Iterable
from functools import cached_property, partial
from typing import NamedTuple

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

_HALVINGS = 64  # of the interval (-FAR, FAR): to the last bit


def values_of(population: Population, u: jax.Array) -> PyTree:
    """Return the structure of the prior with the values that belong to standard numbers u (p,)."""
    return population.fill({n: population.active[n].deviate(part) for n, part in population.by_field(u).items()})


def elementwise(population: Population, u: jax.Array) -> jax.Array:
    """Return the values of all elements (p,) as one vector."""
    parts = [population.active[n].deviate(part).reshape(-1) for n, part in population.by_field(u).items()]
    return jnp.concatenate(parts)


@jax.jit
def _mapped(population: Population, u: jax.Array) -> jax.Array:
    """Values (k, p) of several units u (k, p)."""
    return jax.vmap(partial(elementwise, population))(u)


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
    of_block = partial(_mapped, elements.population)
    return np.asarray(in_blocks(of_block, PRIORS[len(u) > PRIORS[1]], np.asarray(u, float)), float)


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
        active = self.population.active.items()
        return tuple(name for field, tolerance in active for name in elements(field, tolerance.shape))

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
        leaves, parts = self.beside(argument, values), []
        for name, tolerance in self.population.active.items():
            try:
                parts.append(np.broadcast_to(np.asarray(leaves[name], float), tolerance.shape).reshape(-1))
            except (TypeError, ValueError):
                raise ValueError(f"{argument}.{name}: must be numbers of shape {tolerance.shape}, in SI") from None
        return np.concatenate(parts)

    def beside(self, argument: str, other: object) -> dict[str, PyTree]:
        """Leaves of `other`, a structure like the prior, by active field.

        Raises:
            ValueError: another structure.
        """
        _, treedef = self.population._flat
        try:
            leaves = treedef.flatten_up_to(other)
        except (ValueError, TypeError):
            raise ValueError(f"{argument}: must have the structure of the prior, got {type(other).__name__}") from None
        by_field = dict(zip(self.population._leaves, leaves))
        return {name: by_field[name] for name in self.population.active}

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


IDENTIFIED = 0.5
"""Largest standard deviation, in those of the prior, of an element that counts as known by itself."""

LOADED = 0.05
"""Least share of an element's variance in the directions seen for it to count as part of a combination."""

SEEN = 1.0
"""Least lambda of a direction: there the data weigh more than the drawing."""

INSEPARABLE = 0.95
"""Least posterior correlation, by size, of two elements that are not distinguishable."""


def compress_rows(rows: np.ndarray) -> np.ndarray:
    """Rows (..., m, n) turned into at most n of the same lengths and angles between columns: their factor R."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if rows.shape[-2] > rows.shape[-1] else rows


class Spectrum(NamedTuple):
    """Singular values and right vectors of slopes J (..., m, n)."""

    eigenvalues: np.ndarray  # (..., n) lambda, largest first
    right: np.ndarray  # (..., n, n), columns

    @classmethod
    def of(cls, slopes: np.ndarray) -> "Spectrum":
        """Return the spectrum of finite slopes."""
        n = slopes.shape[-1]
        _, singular, right = np.linalg.svd(compress_rows(slopes), full_matrices=True)
        missing = np.zeros((*singular.shape[:-1], n - singular.shape[-1]))
        eigenvalues = np.concatenate([singular, missing], axis=-1) ** 2
        return cls(eigenvalues, np.swapaxes(right, -1, -2))

    @property
    def root(self) -> np.ndarray:
        """L (..., n, n) with L L' = (I + J'J)^-1."""
        return self.right / np.sqrt(1 + self.eigenvalues)[..., None, :]

    @property
    def nats(self) -> np.ndarray:
        """Information gained, sum ln(1 + lambda)/2."""
        return np.log1p(self.eigenvalues).sum(axis=-1) / 2


@dataclasses.dataclass(frozen=True)
class Direction:
    """One combination of elements that the data determine.

    Attributes:
        information: lambda, the variance before over the variance after, less one.
        loadings: {element: its correlation with the combination}, the largest positive.
    """

    information: float
    loadings: dict[str, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Identifiability:
    """Elements of a prior that a measurement identifies.

    Attributes:
        names: of the elements, (p,).
        u_sd: standard deviations after the measurement, in those of the prior (p,).
        resolution: {element: 1 - u_sd}.
        verdict: {element: "identified" (u_sd <= 0.5), "combination" (seen only together with others) or "unseen"}.
        directions: combinations with lambda >= 1, strongest first.
        inseparable: (element, element, posterior correlation) of pairs beyond 0.95.
        information: of the whole measurement, nats.
    """

    names: tuple[str, ...]
    u_sd: np.ndarray
    resolution: dict[str, float]
    verdict: dict[str, str]
    directions: tuple[Direction, ...]
    inseparable: tuple[tuple[str, str, float], ...]
    information: float


def findings(names: tuple[str, ...], mixing: np.ndarray, spectrum: Spectrum) -> Identifiability:
    """Compute the identifiability of one unit."""
    root = mixing @ spectrum.root
    u_sd = np.linalg.norm(root, axis=1)
    loadings = (mixing @ spectrum.right)[:, spectrum.eigenvalues >= SEEN]
    largest = np.abs(loadings).argmax(axis=0)
    loadings = loadings * np.where(loadings[largest, np.arange(loadings.shape[1])] < 0, -1.0, 1.0)
    seen = (loadings**2).sum(axis=1) >= LOADED
    verdict = np.where(u_sd <= IDENTIFIED, "identified", np.where(seen, "combination", "unseen"))
    scaled = root / u_sd[:, None]
    correlation = scaled @ scaled.T
    pairs = np.argwhere(np.tril(np.abs(correlation) >= INSEPARABLE, -1))
    return Identifiability(
        names=names,
        u_sd=u_sd,
        resolution={name: float(1 - sd) for name, sd in zip(names, u_sd)},
        verdict={name: str(word) for name, word in zip(names, verdict)},
        directions=tuple(
            Direction(float(value), {name: float(number) for name, number in zip(names, column)})
            for value, column in zip(spectrum.eigenvalues, loadings.T)
        ),
        inseparable=tuple((names[i], names[j], float(correlation[i, j])) for i, j in pairs),
        information=float(spectrum.nats),
    )
