"""Margin of one limit on a share of the units, and its derivatives to the vector of decisions, by lines."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.blocks import padded
from rvjax.population import Population
from rvjax.response import elements
from rvjax.tolerances.optimum.lines import Crossing, Lines
from rvjax.tolerances.optimum.share import Share
from rvjax.tolerances.optimum.tail_sample import Centres
from rvjax.tolerances.optimum.units import Units

_LINES, _FEWEST = 1024, 64  # of one limit, and of one of its centres at least


class LimitLines:
    """Lines of one limit."""

    def __init__(
        self,
        units: Units,
        share: Callable[[dict[str, np.ndarray]], Share],
        reads: tuple[str, ...],
        centres: Centres,
        seed: int,
    ) -> None:
        """Lines about `centres`; `share` has the margins of units by their values of the responses `reads`."""
        self._units, self._share, self._reads = units, share, reads
        self._each = max(_FEWEST, 2 ** int(math.log2(_LINES / len(centres.places))))
        self._lines = Lines(centres, self._each, seed)
        self._last: tuple[np.ndarray, np.ndarray] = np.zeros((0, 0)), np.zeros((0, 0))

    def look(self, x: np.ndarray) -> tuple[float, np.ndarray] | None:
        """Quantile of the margins at a vector of decisions and its derivatives (n,); None where lines miss it."""
        found = self._cross(x)
        if found is None:
            return None
        slopes, rates = self._last
        return found.level, self._units.to_vector(x, self._units.population(x), slopes * found.weights, rates)

    def _cross(self, x: np.ndarray) -> Crossing | None:
        population = self._units.population(x)

        def measure(z: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            count = z.shape[1]
            errors, rates = self._units.errors_and_rates(x, population, z)
            units = padded(np.arange(count), max(count, _LINES))
            lanes = (np.asarray(rows[:, units], jnp.result_type(float)) for rows in (z, along))
            moves = np.asarray(_moves(population, *lanes), float)[:, :count]
            if len(self._reads) == 1:
                values, slopes = self._units.pulled(population, errors, {self._reads[0]: np.ones(count)})
                share = self._share(values)
                slopes = slopes * share.outward[self._reads[0]]
            else:  # which response leads decides on the gradient
                share = self._share(self._units.values(x, z, "lines"))
                slopes = self._units.pulled(population, errors, share.outward)[1]
            self._last = slopes, rates
            return share.margins, np.einsum("en,en->n", slopes[: len(moves)], moves)

        return self._lines.cross(measure, 1 - self._share(_none(self._reads)).target)


def _none(names: tuple[str, ...]) -> dict[str, np.ndarray]:
    return {name: np.zeros(1) for name in names}


@jax.jit
def _moves(population: Population, z: jax.Array, along: jax.Array) -> jax.Array:
    """Derivatives (elements, n) of errors along directions (numbers, n) of z."""
    return jax.jvp(lambda z: elements(population, z), (z,), (along,))[1]
