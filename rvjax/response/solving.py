"""Programs of a costly response: one solves units, one takes what it has found and gives gradients without solving.

What an iteration finds is marked by `roots.solved`. It is all of a unit that the second program needs besides its
errors, and so the iteration is compiled once.
"""

import functools
from collections.abc import Callable
from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Population
from rvjax.response.devices import NUMBERS, UNITS, mesh_of, on, shared_out
from rvjax.response.response import Response, Values, evaluate, per_response, response_names
from rvjax.roots import SOLVED

AT_ONCE = 128
"""Units of one call: a few blocks of a slow model, so that little is wasted where few units decide."""


Errors = Callable[[np.ndarray], jax.Array]  # of the indices of some units
Solution = tuple[np.ndarray, np.ndarray, np.ndarray]


class Units(NamedTuple):
    """Some solved units; `state` (numbers, n) is what their gradients need."""

    values: Values
    status: jax.Array
    state: jax.Array


def solve(response: Response, population: Population, count: int, errors: Errors) -> list[Units]:
    """Solve some units, `AT_ONCE` in a call; the last call has more than are wanted.

    Args:
        response: of one unit.
        population: gives the elements of each field; its tolerances have no effect.
        count: of the units.
        errors: (elements, n) of the active fields, of n of the units.
    """
    mesh = mesh_of(AT_ONCE)
    if mesh is None:
        return [Units(*_solved(response, population, errors(lanes))) for lanes in chunks(count)]
    return [Units(*_solved_on(response, population, on(mesh, errors(lanes)), mesh=mesh)) for lanes in chunks(count)]


def solution(response: Response, population: Population, count: int, errors: Errors) -> Solution:
    """Values (k, n) by `response_names`, status (n,) and state (numbers, n) of some units, as in `solve`."""
    found, names = solve(response, population, count, errors), response_names(response, population)
    rows = [np.stack([np.asarray(each.values[name], float) for name in names]) for each in found]
    status = np.concatenate([np.asarray(each.status) for each in found])[:count]
    state = np.concatenate([np.asarray(each.state) for each in found], axis=1)[:, :count]
    return np.concatenate(rows, axis=1)[:, :count], status, state


def pulls(
    response: Response, population: Population, errors: np.ndarray, state: np.ndarray, cotangents: np.ndarray
) -> np.ndarray:
    """Gradients (elements, n) of sum_k cotangent_k y_k of solved units, which are not solved again.

    Gradients to the numbers of the design, one row each in the order of their names, follow those to the elements.

    Args:
        response: as in `solve`.
        population: as in `solve`.
        errors: (elements, n).
        state: (numbers, n) of these units, by `solution`.
        cotangents: (k, n), values by `response_names`.
    """
    mesh, dtype, found = mesh_of(AT_ONCE), jnp.result_type(float), []
    for lanes in chunks(errors.shape[1]):
        rows = [jnp.asarray(each[:, lanes], dtype) for each in (errors, state, cotangents)]
        if mesh is None:
            found.append(_pulled(response, population, *rows))
        else:
            found.append(_pulled_on(response, population, *(on(mesh, each) for each in rows), mesh=mesh))
    return np.concatenate([np.asarray(row, float) for row in found], axis=1)[:, : errors.shape[1]]


def begin(response: Response, population: Population, *, slopes: bool = False) -> None:
    """Begin one of the two programs, see `Compiled.begin`.

    Args:
        response: as in `solve`.
        population: as in `solve`.
        slopes: that of the gradients.
    """
    mesh, rows = mesh_of(AT_ONCE), [without_errors(population)]
    if slopes:
        shapes = jax.eval_shape(_solved.__wrapped__, response, population, rows[0])  # type: ignore[attr-defined]
        counts = shapes[2].shape[0], len(response_names(response, population))
        rows += [jnp.zeros((count, AT_ONCE), rows[0].dtype) for count in counts]
    if mesh is None:
        (_pulled if slopes else _solved).begin(response, population, *rows)
    else:
        program = _pulled_on if slopes else _solved_on
        program.begin(response, population, *(on(mesh, each) for each in rows), mesh=mesh)


def chunks(count: int, size: int = AT_ONCE) -> list[np.ndarray]:
    """Indices (size,) of the units of each call; the last ones are repeated to fill it."""
    return [np.resize(np.arange(start, min(start + size, count)), size) for start in range(0, count, size)]


def without_errors(population: Population) -> jax.Array:
    """Errors (elements, `AT_ONCE`) of units without errors."""
    return jnp.zeros((sum(prod(t.shape) for t in population.active.values()), AT_ONCE), jnp.result_type(float))


class _Linear(NamedTuple):
    """One unit and its linear part."""

    values: Values
    status: jax.Array
    pull: Callable[[jax.Array], tuple[jax.Array, dict[str, jax.Array]]]  # to gradients of elements, numbers of a design


def _linear(response: Response, population: Population, free: dict[str, jax.Array], vector: jax.Array) -> _Linear:
    names = response_names(response, population)

    @functools.partial(jax.checkpoint, policy=jax.checkpoint_policies.save_only_these_names(SOLVED))
    def values(vector: jax.Array, free: dict[str, jax.Array]) -> tuple[jax.Array, tuple[Values, jax.Array]]:
        there = population.replace(values=free) if free else population
        found, status = evaluate(response, there.fill(there.by_field(vector)))
        return jnp.stack([found[name] for name in names]), (found, status)

    _, pull, (found, status) = jax.vjp(values, vector, free, has_aux=True)
    return _Linear(found, status, pull)


def _own(leaf: jax.Array) -> bool:
    """True if a number differs between the units of a batch."""
    return hasattr(leaf, "batch_dim")  # JAX exports no type of these tracers


@per_response()
def _solved(response: Response, population: Population, errors: jax.Array) -> tuple[Values, jax.Array, jax.Array]:
    free = _free(population, errors)

    def one(vector: jax.Array) -> tuple[Values, jax.Array, jax.Array]:
        found = _linear(response, population, free, vector)
        kept = [jnp.ravel(leaf).astype(errors.dtype) for leaf in jax.tree.leaves(found.pull) if _own(leaf)]
        return found.values, found.status, jnp.concatenate([jnp.zeros(0, errors.dtype), *kept])

    return jax.vmap(one, in_axes=-1, out_axes=(0, 0, -1))(errors)


@per_response()
def _pulled(
    response: Response, population: Population, errors: jax.Array, state: jax.Array, cotangents: jax.Array
) -> jax.Array:
    free = _free(population, errors)

    def one(vector: jax.Array, state: jax.Array, cotangent: jax.Array) -> jax.Array:
        found = _linear(response, population, free, vector)  # XLA removes what only the values need
        leaves, tree = jax.tree.flatten(found.pull)
        sizes = [np.size(leaf) if _own(leaf) else 0 for leaf in leaves]
        parts = jnp.split(state, np.cumsum(sizes)[:-1])
        leaves = [p.reshape(x.shape).astype(x.dtype) if _own(x) else x for p, x in zip(parts, leaves)]
        slope, to_free = jax.tree.unflatten(tree, leaves)(cotangent)
        return jnp.concatenate([slope, jnp.stack(list(to_free.values()))]) if to_free else slope

    return jax.vmap(one, in_axes=-1, out_axes=-1)(errors, state, cotangents)


def _free(population: Population, errors: jax.Array) -> dict[str, jax.Array]:
    """Numbers of the design, by name."""
    return {name: jnp.asarray(value, errors.dtype) for name, value in sorted((population.values or {}).items())}


@per_response(static=("mesh",))
def _solved_on(
    response: Response, population: Population, errors: jax.Array, *, mesh: jax.sharding.Mesh
) -> tuple[Values, jax.Array, jax.Array]:
    return shared_out(_solved, mesh, (UNITS, UNITS, NUMBERS), response, population, errors)


@per_response(static=("mesh",))
def _pulled_on(
    response: Response,
    population: Population,
    errors: jax.Array,
    state: jax.Array,
    cotangents: jax.Array,
    *,
    mesh: jax.sharding.Mesh,
) -> jax.Array:
    return shared_out(_pulled, mesh, NUMBERS, response, population, errors, state, cotangents)
