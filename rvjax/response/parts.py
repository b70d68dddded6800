"""A response in parts, and any of its units; chunks of units on all local devices.

Outputs that share no computation are solved for different units. Each device draws and evaluates its own part of a
chunk, none waits for another.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.sizes import AT_ONCE, calls
from rvjax.population import TURN, Population, SobolPoints, drawn, key_of, root_key
from rvjax.response.derivatives import (
    Errors,
    Solution,
    elements,
    gradients,
    pulls,
    solve,
)
from rvjax.response.response import (
    BLOCK,
    EVERYWHERE,
    NUMBERS,
    Response,
    Values,
    is_costly,
    on,
    respond,
    response_names,
    units_devices,
)
from rvjax.status import succeeded, worst


class Part:
    """Some outputs of a costly response, as a separate response."""

    at_once = AT_ONCE
    """Units of a call that differ in one error."""
    keeps = True
    """Gradients take what solving has found of their units."""

    def __init__(self, response: Response, population: Population) -> None:
        self.response, self.names = response, response_names(response, population)

    def solve(self, population: Population, z: np.ndarray) -> Solution:
        """Values (k, n) by `names`, status (n,) and state of the units with random numbers z (numbers, n)."""
        return solve(self.response, population, z.shape[1], lambda lanes: elements(population, z[:, lanes]))

    def slopes_of_elements(
        self, population: Population, errors: np.ndarray, state: np.ndarray, cotangents: np.ndarray
    ) -> np.ndarray:
        """Gradients (elements, n) of weighted values of solved units, which are not solved again.

        Args:
            population: of the units.
            errors: of the units (elements, n).
            state: of these units, by `solve` or `of_elements`.
            cotangents: weights (k, n) of the values.
        """
        return pulls(self.response, population, errors, state, cotangents)

    def of_elements(self, population: Population, errors: np.ndarray) -> Solution:
        """Values (k, n) by `names`, nan where a unit failed, status and state, of units with errors (elements, n)."""
        values, status, state = self._of(population, errors)
        return np.where(succeeded(np.asarray(status)), values, np.nan), status, state

    def curves(self, population: Population, z: np.ndarray) -> np.ndarray:
        """Curves (n, numbers) of an `Outcome` that has one, of units with random numbers z (numbers, n)."""
        errors: Errors = lambda lanes: elements(population, z[:, lanes])  # noqa: E731
        return solve(self.response, population, z.shape[1], errors, curve=True)[0].T

    def one(self, population: Population, errors: np.ndarray) -> tuple[np.ndarray, int]:
        """Values (k,) and status of the unit with errors (elements,), by the program of all the others.

        Args:
            population: of the units.
            errors: of the unit.
        """
        values, status, _ = self._of(population, errors[:, None])
        return values[:, 0], int(status[0])

    def _of(self, population: Population, errors: np.ndarray) -> Solution:
        return solve(self.response, population, errors.shape[1], lambda lanes: jnp.asarray(errors[:, lanes]))


class Whole(Part):
    """A response that is not costly: gradients of its units need nothing but their errors."""

    keeps = False

    def __init__(self, response: Response, population: Population, chunk: int) -> None:
        super().__init__(response, population)
        self.at_once = chunk

    def solve(self, population: Population, z: np.ndarray) -> Solution:
        """Values (k, n) and status (n,); the state has no rows."""
        found = []
        for lanes in calls(z.shape[1], self.at_once):
            own, codes = respond(self.response, population, z[:, lanes])
            found.append((np.stack([np.asarray(own[name], float) for name in self.names]), np.asarray(codes)))
        values, status = (np.concatenate(rows, axis=-1)[..., : z.shape[1]] for rows in zip(*found))
        return values, status, np.zeros((0, z.shape[1]))

    def slopes_of_elements(
        self, population: Population, errors: np.ndarray, state: np.ndarray, cotangents: np.ndarray
    ) -> np.ndarray:
        """The same, which needs no state."""
        return gradients(self.response, population, errors, cotangents)[2]

    def _of(self, population: Population, errors: np.ndarray) -> Solution:
        """The same, by the program of the gradients; the state has no rows."""
        values, status, _ = gradients(self.response, population, errors, np.zeros((len(self.names), errors.shape[1])))
        return values, status, np.zeros((0, errors.shape[1]))


def parts(response: Response, population: Population, chunk: int = BLOCK) -> list[Part]:
    """A `costly` response in the `parts` that it names; another is a whole.

    Args:
        response: of one unit.
        population: of the units.
        chunk: units of one call of a whole.
    """
    if not is_costly(response):
        return [Whole(response, population, chunk)]
    split = getattr(response, "parts", None)
    own: Sequence[Response] = [response] if split is None else split()
    return [Part(part, population) for part in own]


class Evaluator:
    """Evaluates chunks of one study; devices compute while the host continues."""

    def __init__(
        self,
        response: Response,
        population: Population,
        seed: int,
        method: str,
        chunk: int,
        names: tuple[str, ...] | None = None,
    ) -> None:
        """Checked inputs of an evaluation, as in `monte_carlo`.

        Args:
            response: of one unit.
            population: of the units.
            seed: of the random numbers.
            method: of the random numbers.
            chunk: units at once.
            names: of the outputs that are wanted, None for all; parts of a costly response without any of them are not
                solved. Its programs are those of an allocation, if one was run before.
        """
        self._response, self._population, self._key = response, population, root_key(seed)
        own = [part for part in parts(response, population) if part.keeps]
        self._parts = [part for part in own if names is None or set(part.names) & set(names)]
        self._points = SobolPoints(population.numbers, seed) if method == "sobol" else None
        devices = units_devices()
        self._mesh = jax.sharding.Mesh(np.array(devices), ("units",)) if len(devices) > 1 else None
        if self._mesh is None:
            self._key = on(None, self._key)  # the device that computes draws as well
        # Every device gets the same number of units; those past the end of the chunk are never looked at.
        self._count = -(-chunk // len(devices)) * len(devices)

    def start(self, first: int) -> tuple[Values, jax.Array]:
        """Values and status of the chunk that begins with unit `first`; still being computed if units are quick."""
        if not self._parts:
            return respond(self._response, self._population, self.z(first), mesh=self._mesh)
        z, values, status = np.asarray(self.z(first)), dict[str, Any](), []
        for part in self._parts:
            rows, own, _ = part.solve(self._population, z)
            values |= dict(zip(part.names, rows))
            status.append(own)
        flags: Any = worst(np.stack(status), axis=0)  # on the host
        return values, flags

    def errors(self, first: int) -> dict[str, np.ndarray]:
        """Sampled errors of the chunk that begins with unit `first`, by field (*shape, n)."""
        return {field: np.asarray(drawn) for field, drawn in _deviations(self._population, self.z(first)).items()}

    def z(self, first: int) -> jax.Array:
        """Random numbers (numbers, n) of the chunk that begins with unit `first`."""
        if self._points is not None:
            points: Any = np.asarray(self._points.z(first, self._count), jnp.result_type(float))
            return on(self._mesh, points)
        turn, first = divmod(first, TURN)
        z = self._drawn(turn, first)
        if (rest := TURN - first) < self._count:  # numbers of 32 bits begin again within the chunk
            z = jnp.where(jnp.arange(self._count) < rest, z, self._drawn(turn + 1, first))
        return z

    def _drawn(self, turn: int, first: int) -> jax.Array:
        key = key_of(self._key, turn)
        if self._mesh is None:
            return drawn(self._population, key, np.uint32(first), count=self._count)
        return _drawn_on(self._mesh, self._count, self._population, key, np.uint32(first))


@jax.jit
def _deviations(population: Population, z: jax.Array) -> dict[str, jax.Array]:
    return population.deviations(z)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _drawn_on(
    mesh: jax.sharding.Mesh, count: int, population: Population, key: jax.Array, first: jax.Array
) -> jax.Array:
    def part(population: Population, key: jax.Array, first: jax.Array) -> jax.Array:
        own = count // mesh.size
        begin = first + jax.lax.axis_index("units").astype(jnp.uint32) * jnp.uint32(own)
        return population.draw(key, begin + jnp.arange(own, dtype=jnp.uint32))

    specs = (EVERYWHERE, EVERYWHERE, EVERYWHERE)
    return jax.shard_map(part, mesh=mesh, in_specs=specs, out_specs=NUMBERS, check_vma=False)(population, key, first)


def status_without_errors(response: Response, population: Population) -> int:
    """Status of the unit without errors, the worst of all parts."""
    return unit_of(response, population, np.zeros(sum(math.prod(t.shape) for t in population.active.values())))[1]


def unit_at_mid_points(response: Response, population: Population) -> tuple[dict[str, float], int]:
    """Values of the unit at the mid-points of all limits, vectors at 0, and its status, the worst of all parts."""
    active = population.active.values()
    middles = [np.full(math.prod(t.shape), float(t.centre)) for t in active]
    return unit_of(response, population, np.concatenate([np.zeros(0), *middles]))


def unit_of(response: Response, population: Population, errors: np.ndarray) -> tuple[dict[str, float], int]:
    """Values of one unit by name, and its status, the worst of all parts; of a response that has one its `central`.

    Args:
        response: of one unit.
        population: whose active fields the errors are.
        errors: (elements,) of the active fields, one after the other.
    """
    central = getattr(response, "central", response)
    solved = [(part.names, *part.one(population, errors)) for part in parts(central, population)]
    values = {name: float(value) for names, row, _ in solved for name, value in zip(names, row)}
    return values, int(worst(np.array([status for *_, status in solved])))
