"""A response in parts, and any of its units: outputs that share no computation are solved for different units."""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Population
from rvjax.records import PyTree
from rvjax.response.devices import UNITS, Evaluator, mesh_of, on, shared_out
from rvjax.response.gradients import begin_gradients, elements
from rvjax.response.response import Response, Values, evaluate, per_response, response_names
from rvjax.status import succeeded, worst

AT_ONCE = 128
"""Units of one call: a few blocks of a slow model, so that little is wasted where few units decide."""


class Part:
    """Some outputs of a response, as a separate response."""

    def __init__(self, response: Response, population: Population) -> None:
        self.response, self.names = response, response_names(response, population)
        self._mesh = mesh_of(AT_ONCE)
        self.solved = 0
        """Units solved so far."""

    def solve(self, population: Population, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (k, n) by `names`, and status (n,), of the units with random numbers z (numbers, n)."""
        return self._of(population, z.shape[1], lambda lanes: elements(population, jnp.asarray(z[:, lanes])))

    def of_elements(self, population: Population, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (k, n) by `names`, nan where a unit failed, and status (n,), of units with errors (elements, n)."""
        values, status = self._of(population, errors.shape[1], lambda lanes: jnp.asarray(errors[:, lanes]))
        return np.where(np.asarray(succeeded(status)), values, np.nan), status

    def rows(self, population: Population, z: np.ndarray, name: str) -> np.ndarray:
        """Numbers name[0], name[1] ... (n, numbers) among the values of units with random numbers z (numbers, n)."""
        count = z.shape[1]
        found = self._run(population, count, lambda lanes: elements(population, jnp.asarray(z[:, lanes])))
        length = sum(key.startswith(f"{name}[") for key in found[0][0])
        rows = [np.stack([np.asarray(values[f"{name}[{k}]"]) for k in range(length)]) for values, _ in found]
        return np.concatenate(rows, axis=1)[:, :count].T

    def begin(self, population: Population) -> None:
        """Begin the program, see `Compiled.begin`."""
        nothing = _nothing(population)
        if self._mesh is None:
            _solved.begin(self.response, population, nothing)
        else:
            _solved_on.begin(self.response, population, on(self._mesh, nothing), mesh=self._mesh)

    def nominal_status(self, population: Population) -> int:
        """Status of the unit without errors, by the program of all the others."""
        return int(self._of(population, 1, lambda lanes: _nothing(population))[1][0])

    def _of(self, population: Population, count: int, errors: PyTree) -> tuple[np.ndarray, np.ndarray]:
        running = self._run(population, count, errors)
        rows = [np.stack([np.asarray(values[name], float) for name in self.names]) for values, _ in running]
        status = np.concatenate([np.asarray(status) for _, status in running])[:count]
        return np.concatenate(rows, axis=1)[:, :count], status

    def _run(self, population: Population, count: int, errors: PyTree) -> list[tuple[Values, jax.Array]]:
        self.solved += count
        starts = range(0, count, AT_ONCE)
        lanes = (np.resize(np.arange(start, min(start + AT_ONCE, count)), AT_ONCE) for start in starts)
        return [solved(self.response, population, errors(units), self._mesh) for units in lanes]


def _nothing(population: Population) -> jax.Array:
    """Errors (elements, `AT_ONCE`) of units without errors."""
    return jnp.zeros((sum(prod(t.shape) for t in population.active.values()), AT_ONCE), jnp.result_type(float))


def parts(response: Response, population: Population) -> list[Part]:
    """A `costly` response in the `parts` that it names; another is a whole."""
    split = getattr(response, "parts", None) if getattr(response, "costly", False) else None
    own: Sequence[Response] = [response] if split is None else split()
    return [Part(part, population) for part in own]


class InParts(Evaluator):
    """Chunks of a costly response, by the programs of its parts: those of an allocation, if one was run before."""

    def __init__(self, response: Response, population: Population, seed: int, method: str, chunk: int) -> None:
        super().__init__(response, population, seed, method, chunk)
        self._parts = parts(response, population)
        begin_programs(response, population)

    def start(self, first: int) -> tuple[Values, jax.Array]:
        """Values and status of the chunk that begins with unit `first`."""
        z, values, status = np.asarray(self._z(first)), dict[str, Any](), []
        for part in self._parts:
            rows, own = part.solve(self._population, z)
            values |= dict(zip(part.names, rows))
            status.append(own)
        return values, worst(jnp.asarray(np.stack(status)), axis=0)


def evaluator(response: Response, population: Population, seed: int, method: str, chunk: int) -> Evaluator:
    """Evaluator of the chunks of one study.

    Args:
        response: of one unit.
        population: of the units.
        seed: of the random numbers.
        method: of the random numbers.
        chunk: units at once.
    """
    kind = InParts if getattr(response, "costly", False) else Evaluator
    return kind(response, population, seed, method, chunk)


def begin_programs(response: Response, population: Population, *, slopes: bool = False) -> None:
    """Begin the programs of a costly response, see `Compiled.begin`: each is compiled while the next is traced.

    Args:
        response: in parts.
        population: of the units.
        slopes: with those of the gradients.
    """
    own = parts(response, population)
    for part in own:
        part.begin(population)
    for part in own if slopes else ():
        begin_gradients(part.response, population)


def status_without_errors(response: Response, population: Population) -> int:
    """Status of the unit without errors, the worst of all parts."""
    return int(worst(jnp.asarray([part.nominal_status(population) for part in parts(response, population)])))


def solved(
    response: Response, population: Population, errors: jax.Array, mesh: jax.sharding.Mesh | None
) -> tuple[Values, jax.Array]:
    """Values by name (n,) and status (n,) of units by their errors (elements, n) of the active fields.

    The population gives only the elements of each field.
    """
    if mesh is None:
        return _solved(response, population, errors)
    return _solved_on(response, population, on(mesh, errors), mesh=mesh)


@per_response()
def _solved(response: Response, population: Population, errors: jax.Array) -> tuple[Values, jax.Array]:
    one: Callable[[jax.Array], Any] = lambda vector: evaluate(response, population.fill(population.by_field(vector)))  # noqa: E731
    return jax.vmap(one, in_axes=-1)(errors)


@per_response(static=("mesh",))
def _solved_on(
    response: Response, population: Population, errors: jax.Array, *, mesh: jax.sharding.Mesh
) -> tuple[Values, jax.Array]:
    return shared_out(_solved, mesh, UNITS, response, population, errors)
