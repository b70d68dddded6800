"""Units of a dear response and of cheap ones: the values of all on the same units, and what they cost."""

import math
import time
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Population, root_key
from rvjax.response import Response, respond, response_names
from rvjax.status import succeeded


class Units:
    """Values of all responses of any units, and the seconds that they took once compiled."""

    def __init__(
        self, dear: Response, cheap: Mapping[str, Response], population: Population, names: tuple[str, ...], seed: int
    ) -> None:
        self.dear, self.cheap, self.population, self.names = dear, cheap, population, names
        self.key, self.taken = root_key(seed), {"dear": math.nan, "cheap": math.nan}
        self.cheap_names = {label: response_names(of, population) for label, of in cheap.items()}

    def dear_values(self, index: np.ndarray, block: int) -> dict[str, np.ndarray]:
        """Values of the dear response by name, nan where one failed."""
        return {name: v[0] for name, v in self._values({"": self.dear}, index, block, "dear").items()}

    def cheap_values(self, index: np.ndarray, block: int) -> dict[str, np.ndarray]:
        """Cheap values (n, j) by name of the dear response."""
        return {name: v.T for name, v in self._values(self.cheap, index, block, "cheap").items()}

    def _values(
        self, responses: Mapping[str, Response], index: np.ndarray, block: int, kind: str
    ) -> dict[str, np.ndarray]:
        rows: dict[str, list[np.ndarray]] = {name: [] for name in self.names}
        for start in range(0, len(index), block):
            part = index[start : start + block]
            z = _picked(self.population, self.key, jnp.asarray(np.resize(part, block).astype(np.uint32)))
            z.block_until_ready()
            begun, found = time.perf_counter(), []
            for of in responses.values():
                values, status = respond(of, self.population, z)
                good = np.asarray(succeeded(status))
                found.append({n: np.where(good, np.asarray(v, float), np.nan) for n, v in values.items()})
            if start:  # the first block may wait for a compilation
                self.taken[kind] = (time.perf_counter() - begun) / block
            for name in self.names:
                of_name = [row for each in found for row in ([each[name]] if name in each else each.values())]
                rows[name].append(np.stack(of_name)[:, : len(part)])
        return {name: np.concatenate(parts, axis=1) for name, parts in rows.items()}

    def first_of(self, name: str) -> dict[str, int]:
        """Column of the first value of every cheap response."""
        columns, column = {}, 0
        for label, own in self.cheap_names.items():
            columns[label] = column
            column += 1 if name in own else len(own)
        return columns


@jax.jit
def _picked(population: Population, key: jax.Array, index: jax.Array) -> jax.Array:
    return population.draw(key, index)
