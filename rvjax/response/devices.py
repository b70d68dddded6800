"""Chunks of units on all local devices: each draws and evaluates its own part, none waits for another."""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.sizes import default_platform
from rvjax.population import TURN, Population, SobolPoints, drawn, key_of, root_key
from rvjax.response.response import EVERYWHERE, NUMBERS, Response, Values, respond

_chosen: list[jax.Device] = []  # by `units_on`


@contextlib.contextmanager
def units_on(devices: Sequence[jax.Device]) -> Iterator[None]:
    """A context within which units are computed on these devices; everything else stays where it is.

    Args:
        devices: of one platform; none: the default ones.
    """
    before = list(_chosen)
    _chosen[:] = devices
    try:
        yield
    finally:
        _chosen[:] = before


def units_devices() -> list[jax.Device]:
    """Devices that compute units: those of `units_on`, else all local ones of the default platform."""
    return list(_chosen) or jax.local_devices(backend=default_platform())


class Evaluator:
    """Evaluates chunks of one study; devices compute while the host continues."""

    def __init__(self, response: Response, population: Population, seed: int, method: str, chunk: int) -> None:
        """Checked inputs of an evaluation, as in `monte_carlo`; `chunk` units at once."""
        self._response, self._population, self._key = response, population, root_key(seed)
        self._points = SobolPoints(population.numbers, seed) if method == "sobol" else None
        devices = units_devices()
        self._mesh = jax.sharding.Mesh(np.array(devices), ("units",)) if len(devices) > 1 else None
        if self._mesh is None:
            self._key = on(None, self._key)  # the device that computes draws as well
        # Every device gets the same number of units; those past the end of the chunk are never looked at.
        self._count = -(-chunk // len(devices)) * len(devices)

    @property
    def shared(self) -> bool:
        """True if several devices share each chunk."""
        return self._mesh is not None

    def start(self, first: int) -> tuple[Values, jax.Array]:
        """Values and status of the chunk that begins with unit `first`, still being computed."""
        return respond(self._response, self._population, self.z(first), mesh=self._mesh)

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


def mesh_of(units: int) -> jax.sharding.Mesh | None:
    """All devices of units, where they can share so many evenly; None for one alone."""
    devices = units_devices()
    return jax.sharding.Mesh(np.array(devices), ("units",)) if len(devices) > 1 and units % len(devices) == 0 else None


def on(mesh: jax.sharding.Mesh | None, rows: jax.Array) -> jax.Array:
    """Rows (numbers, units) shared out, as a kept program takes them; without a mesh on the device of `units_on`."""
    if mesh is not None:
        return jax.device_put(rows, jax.sharding.NamedSharding(mesh, NUMBERS))
    return jax.device_put(rows, _chosen[0]) if _chosen else rows
