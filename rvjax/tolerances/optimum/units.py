"""Units of an allocation with design variables: their values and gradients at one vector of decisions."""

import hashlib
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.blocks import PULLED, calls, padded
from rvjax.population import Population
from rvjax.response import (
    BLOCK,
    Part,
    Response,
    elements,
    elements_and_rates,
    gradients,
    is_costly,
    parts,
    respond,
)  # fmt: skip
from rvjax.status import succeeded
from rvjax.tolerances.batch.checkpoint import describe
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.optimum.decisions import Decisions

Weights = dict[str, np.ndarray]  # of units, by name of the response


class Units:
    """Values of units and their derivatives; what a memo holds is not computed again."""

    def __init__(self, response: Response, decisions: Decisions, wanted: set[str], memo: Memo | None) -> None:
        self.parts = [p for p in parts(response, decisions.base) if wanted & set(p.names)] if wanted else []
        self.evaluated = 0
        self._decisions, self._memo = decisions, memo
        self._costly = is_costly(response)

    def population(self, x: np.ndarray) -> Population:
        """The units at a vector of decisions."""
        return self._decisions.population(x)

    def values(self, x: np.ndarray, z: np.ndarray, what: str) -> dict[str, np.ndarray]:
        """Values (n,) by name of units with these z, nan where one failed."""
        population = self._decisions.population(x)
        found: dict[str, np.ndarray] = {}
        for part in self.parts:
            found |= dict(zip(part.names, self._solved(part, population, z)))
        self.evaluated += z.shape[1] if what != "centre" else 1
        if what != "centre" and len(found) > 1:
            failed = np.any([np.isnan(row) for row in found.values()], axis=0)
            found = {name: np.where(failed, np.nan, row) for name, row in found.items()}
        return found

    def _solved(self, part: Part, population: Population, z: np.ndarray) -> np.ndarray:
        """Values (k, n) of a part of the response."""

        def compute() -> np.ndarray:
            if self._costly:
                values, status = part.solve(population, z)
            else:
                blocks = [np.asarray(z[:, units], jnp.result_type(float)) for units in calls(z.shape[1], BLOCK)]
                found = [respond(part.response, population, block) for block in blocks]
                rows = [np.stack([np.asarray(values[name], float) for name in part.names]) for values, _ in found]
                values = np.concatenate(rows, axis=1)[:, : z.shape[1]]
                status = np.concatenate([np.asarray(flags) for _, flags in found])[: z.shape[1]]
            return np.where(succeeded(np.asarray(status)), values, np.nan)

        if self._memo is None:
            return compute()
        about = repr((part.names, sorted(describe(population, {}).items()))).encode()
        return self._memo.recall({"design": hashlib.sha256(about + z.tobytes()).hexdigest()}, compute)

    def _gradients(
        self, population: Population, errors: np.ndarray, pulled: dict[str, np.ndarray], units: np.ndarray | None = None
    ) -> np.ndarray:
        """Gradients (elements and numbers, n) of sums of responses, with weights (n,) by name."""
        return self.pulled(population, errors, pulled)[1]

    def pulled(
        self, population: Population, errors: np.ndarray, pulled: dict[str, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Values (n,) by name, and gradients (elements and numbers, n) of sums of responses with weights (n,) by name.

        Args:
            population: with the numbers of the design.
            errors: (elements, n) of the units.
            pulled: {response: weights}; other parts of the response are not computed.
        """
        total = np.zeros((errors.shape[0] + len(population.values or {}), errors.shape[1]))
        values: dict[str, np.ndarray] = {}
        for part in self.parts:
            if not set(part.names) & set(pulled):
                continue
            nothing = np.zeros(errors.shape[1])
            cotangents = np.stack([pulled.get(name, nothing) for name in part.names])

            def compute(part: Part = part, cotangents: np.ndarray = cotangents) -> np.ndarray:
                return np.concatenate(gradients(part.response, population, errors, cotangents, part.names))

            if self._memo is None:
                found = compute()
            else:
                about = repr((part.names, sorted((population.values or {}).items()))).encode()
                weighted = hashlib.sha256(about + errors.tobytes() + cotangents.tobytes()).hexdigest()
                found = self._memo.recall({"values and gradients of": weighted}, compute)
            values |= dict(zip(part.names, found))
            total += found[len(part.names) :]
        self.evaluated += errors.shape[1]
        return values, total

    def slopes(
        self, x: np.ndarray, population: Population, z: np.ndarray, several: list[tuple[np.ndarray, Weights]]
    ) -> list[np.ndarray]:
        """Derivatives (n,) of weighted sums of responses to the vector of decisions, each of its own units.

        Args:
            x: the vector.
            population: with these decisions.
            z: (numbers, n) of a sample.
            several: units (m,) of the sample, and {response: weights (m,)}, of each sum.
        """
        if self._costly:  # each solves its own part of the response
            return [self.slope(x, population, z[:, units], pulled, units) for units, pulled in several]
        ends = np.cumsum([0, *(len(units) for units, _ in several)])
        parts = [slice(*both) for both in itertools.pairwise(ends)]
        names = sorted({name for _, pulled in several for name in pulled})
        weights = {name: np.zeros(ends[-1]) for name in names}
        for part, (_, pulled) in zip(parts, several):
            for name, own in pulled.items():
                weights[name][part] = own
        units = np.concatenate([units for units, _ in several])
        return self._sums(x, population, z[:, units], weights, None, parts)

    def slope(
        self,
        x: np.ndarray,
        population: Population,
        z: np.ndarray,
        pulled: Weights,
        units: np.ndarray | None = None,
    ) -> np.ndarray:
        """Derivative (n,) of a weighted sum of responses to the vector of decisions.

        Args:
            x: the vector.
            population: with these decisions.
            z: (numbers, n) of the units.
            pulled: {response: weights (n,)}.
            units: (n,) their places in the sample of the tails, or None for others.
        """
        return self._sums(x, population, z, pulled, units, [slice(None)])[0]

    def _sums(
        self,
        x: np.ndarray,
        population: Population,
        z: np.ndarray,
        pulled: Weights,
        units: np.ndarray | None,
        several: list[slice],
    ) -> list[np.ndarray]:
        """Derivatives as `slope`, of several parts of the units."""
        errors, rates = self.errors_and_rates(x, population, z)
        slopes = self._gradients(population, errors, pulled, units)
        return [self.to_vector(x, population, slopes[:, part], rates[:, part]) for part in several]

    def to_vector(self, x: np.ndarray, population: Population, slopes: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Derivative (n,) of a sum over units to the vector of decisions, from gradients of the units.

        Args:
            x: the vector.
            population: with these decisions.
            slopes: (elements and numbers, m) gradients.
            rates: (elements, m) derivatives of errors to the half-width of their field.
        """
        decisions, count = self._decisions, len(rates)
        used = np.isfinite(slopes).all(axis=0)
        own, free = slopes[:count, used], slopes[count:, used].sum(axis=1)
        widths = population.by_field((own * rates[:, used]).sum(axis=1))
        places = population.by_field(own.sum(axis=1))
        to_widths = [float(widths[name].sum()) for name in decisions.fields] * decisions.half_widths(x)
        to_middles = [float(places[name].sum()) for name, _ in decisions.moves]
        by_number = dict(zip(sorted(population.values or {}), free))
        to_numbers = [float(by_number[name]) for name in decisions.free]
        return np.concatenate([to_widths, np.array([*to_middles, *to_numbers]) * decisions.rates()])

    def errors_and_rates(self, x: np.ndarray, population: Population, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors (elements, n) of units, and their derivatives to the half-width of their field.

        Args:
            x: the vector of decisions.
            population: with these decisions.
            z: (numbers, n) of the units.
        """
        return elements_and_rates(population, dict(zip(self._decisions.fields, self._decisions.half_widths(x))), z)

    def slopes_to_z(self, population: Population, z: np.ndarray, pulled: dict[str, np.ndarray]) -> np.ndarray:
        """Gradients (numbers, n) of responses of units to their z."""
        lanes = np.asarray(padded(z, PULLED, axis=1), jnp.result_type(float))
        errors = np.asarray(elements(population, lanes), float)[:, : z.shape[1]]
        slopes = self._gradients(population, errors, pulled)[: len(errors)]
        return np.asarray(_to_z(population, lanes, padded(slopes, PULLED, axis=1)), float)[:, : z.shape[1]]


def _rows(population: Population, z: jax.Array) -> jax.Array:
    nothing = jnp.zeros((0, z.shape[-1]), z.dtype)
    return jnp.concatenate([nothing, *(v.reshape(-1, z.shape[-1]) for v in population.deviations(z).values())])


@jax.jit
def _to_z(population: Population, z: jax.Array, slopes: jax.Array) -> jax.Array:
    return jax.vjp(lambda z: _rows(population, z), z)[1](slopes.astype(z.dtype))[0]
