"""Gradients of a response to the errors of single units, by one program.

A costly response has two: one solves units, one takes what that has found and gives gradients without solving. What an
iteration finds is marked by `roots.solved`. It is all of a unit that the second program needs besides its errors, and
so the iteration is compiled once.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.sizes import PULLED, SLOPED, SOLVED, calls
from rvjax._jax.solved_state import Marked
from rvjax.population import Population
from rvjax.records import Record
from rvjax.response.response import (
    CURVE,
    NUMBERS,
    UNITS,
    Response,
    Values,
    evaluate,
    is_costly,
    mesh_of,
    on,
    per_response,
    response_names,
    units_devices,
)

Errors = Callable[[np.ndarray], jax.Array]  # of the indices of some units
Solution = tuple[np.ndarray, np.ndarray, np.ndarray]


def solve(response: Response, population: Population, count: int, errors: Errors, curve: bool = False) -> Solution:
    """Solve some units, `SOLVED` in a call.

    Args:
        response: of one unit.
        population: gives the elements of each field; its tolerances have no effect.
        count: of the units.
        errors: (elements, n) of the active fields, of n of the units.
        curve: the numbers of the curve of an `Outcome`, in the place of its outputs.

    Returns:
        Values (k, n) by `response_names` or along the curve, status (n,) and state (numbers, n), which gradients need.
    """
    size, names = SOLVED.on(units_devices()[0].platform), response_names(response, population)
    mesh, running, rows = mesh_of(size), list[Any](), []
    place = np.arange(size).reshape(1 if mesh is None else mesh.size, -1)  # of each unit, one device after another
    unit = np.argsort(place.T.ravel())
    for first in range(0, count, size):
        given = jnp.where(first + unit < count, errors(np.minimum(first + unit, count - 1)), jnp.nan)
        named, *others = _solved(response, population, on(mesh, given), mesh=mesh)
        running.append(([named[name] for name in (CURVE,) * curve or names], *others))
    for own, *others in running:
        found = np.vstack([np.asarray(value, float).T for value in own]), *map(np.asarray, others)
        rows.append([each[..., place.T.ravel()] for each in found])
    values, status, state = (np.concatenate(parts, axis=-1)[..., :count] for parts in zip(*rows))
    return values, status, state


def pulls(
    response: Response, population: Population, errors: np.ndarray, state: np.ndarray, cotangents: np.ndarray
) -> np.ndarray:
    """Gradients (elements, n) of sum_k cotangent_k y_k of solved units, which are not solved again.

    Gradients to the numbers of the design, one row each in the order of their names, follow those to the elements.

    Args:
        response: as in `solve`.
        population: as in `solve`.
        errors: (elements, n).
        state: (numbers, n) of these units, by `solve`.
        cotangents: (k, n), values by `response_names`.
    """
    size, dtype, found = sloped_together(), jnp.result_type(float), []
    mesh = mesh_of(size)
    for lanes in calls(errors.shape[1], size):
        given: Any = [np.asarray(each[:, lanes], dtype) for each in (errors, state, cotangents)]
        rows = [on(mesh, each) for each in given]
        found.append(_pulled(response, population, *rows, mesh=mesh))
    return np.concatenate([np.asarray(row, float) for row in found], axis=1)[:, : errors.shape[1]]


def sloped_together() -> int:
    """Units of a call for gradients, on their devices."""
    return SLOPED.on(units_devices()[0].platform)


def _unit(
    response: Response, population: Population, vector: jax.Array, free: dict[str, jax.Array]
) -> tuple[Values, jax.Array]:
    there = population.replace(values=free) if free else population
    among = getattr(response, "among", None)
    return evaluate(response if among is None else among(there), there.fill(there.by_field(vector)))


_unit_of_record = jax.jit(_unit)  # the program of the slopes need not trace it again


def _traced(
    response: Response, population: Population, errors: jax.Array, free: dict[str, jax.Array]
) -> tuple[Marked, tuple[Record, ...]]:
    """One unit, traced, and its first arguments; a plain function is none."""
    plain = not isinstance(response, Record)
    function: Any = functools.partial(_unit, response) if plain else _unit_of_record
    first: Any = (population,) if plain else (response, population)
    return Marked.of(function, *first, jax.ShapeDtypeStruct(errors.shape[:1], errors.dtype), free), first


@per_response(shared=(UNITS, UNITS, NUMBERS))
def _solved(response: Response, population: Population, errors: jax.Array) -> tuple[Values, jax.Array, jax.Array]:
    free = _free(population, errors)
    unit, first = _traced(response, population, errors, free)

    def one(vector: jax.Array) -> tuple[Values, jax.Array, jax.Array]:
        (values, status), state = unit.with_state(*first, vector, free)
        kept = [jnp.ravel(leaf).astype(errors.dtype) for leaf in state]
        return values, status, jnp.concatenate([jnp.zeros(0, errors.dtype), *kept])

    return jax.vmap(one, in_axes=-1, out_axes=(0, 0, -1))(errors)


@per_response(shared=NUMBERS)
def _pulled(
    response: Response, population: Population, errors: jax.Array, state: jax.Array, cotangents: jax.Array
) -> jax.Array:
    free = _free(population, errors)
    unit, first = _traced(response, population, errors, free)
    names = response_names(response, population)

    def one(vector: jax.Array, state: jax.Array, cotangent: jax.Array) -> jax.Array:
        def weighted(vector: jax.Array, free: dict[str, jax.Array]) -> jax.Array:
            values, _ = unit.from_state(state, *first, vector, free)
            return jnp.stack([values[name] for name in names])

        slope, to_free = jax.vjp(weighted, vector, free)[1](cotangent)
        return jnp.concatenate([slope, jnp.stack(list(to_free.values()))]) if to_free else slope

    return jax.vmap(one, in_axes=-1, out_axes=-1)(errors, state, cotangents)


def _free(population: Population, errors: jax.Array) -> dict[str, jax.Array]:
    """Numbers of the design, by name."""
    return {name: jnp.asarray(value, errors.dtype) for name, value in sorted((population.values or {}).items())}


@per_response(static=("names",), shared=(NUMBERS, UNITS, NUMBERS))
def pulled(
    response: Response, population: Population, errors: jax.Array, cotangents: jax.Array, *, names: tuple[str, ...]
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Values (k, n), status (n,) and gradients (elements, n) of sum_k cotangent_k y_k of units: one reverse pass.

    The population maps elements to fields; its tolerances have no effect. Gradients to the numbers of the design, one
    row each in the order of their names, follow those to the elements.
    """

    def values(vector: jax.Array, free: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
        found, status = _unit(response, population, vector, free)
        return jnp.stack([found[name] for name in names]), status

    def one(vector: jax.Array, cotangent: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        found, pull, status = jax.vjp(values, vector, free, has_aux=True)
        slope, to_free = pull(cotangent)
        return found, status, jnp.concatenate([slope, jnp.stack(list(to_free.values()))]) if to_free else slope

    free = _free(population, errors)
    return jax.vmap(one, in_axes=-1, out_axes=-1)(errors, cotangents)


def gradients(response: Response, population: Population, errors: np.ndarray, cotangents: np.ndarray) -> Solution:
    """Values (k, n), status (n,) and gradients (elements, n) of weighted responses, any number of units by one program.

    Where the population has numbers of the design, gradients to these follow, as rows in the order of their names.

    Args:
        response: of one unit.
        population: whose active fields the elements are.
        errors: (elements, n) of the active fields, one after the other.
        cotangents: (k, n) weights of the values, by `response_names`.
    """
    count = errors.shape[1]
    if is_costly(response):
        own, inverse = np.unique(errors, axis=1, return_inverse=True)  # a unit that is given twice is solved once
        values, status, state = solve(response, population, own.shape[1], lambda lanes: jnp.asarray(own[:, lanes]))
        units = inverse.ravel()
        return values[:, units], status[units], pulls(response, population, errors, state[:, units], cotangents)
    names, size, dtype, found = response_names(response, population), sloped_together(), jnp.result_type(float), []
    mesh = mesh_of(size)
    for lanes in calls(count, size):
        arrays: Any = [np.asarray(each[:, lanes], dtype) for each in (errors, cotangents)]
        found.append(pulled(response, population, *(on(mesh, each) for each in arrays), names=names, mesh=mesh))
    values, status, slopes = (np.concatenate(list(map(np.asarray, part)), axis=-1)[..., :count] for part in zip(*found))
    return values.astype(float), status, slopes.astype(float)


@jax.jit
def elements(population: Population, z: jax.Array) -> jax.Array:
    """Errors (elements, n) of the active fields, one after the other.

    Args:
        population: of the units.
        z: (numbers, n) of the units.
    """
    own = population.deviations(z).values()
    return jnp.concatenate([jnp.zeros((0, z.shape[-1]), z.dtype), *(v.reshape(-1, z.shape[-1]) for v in own)])


def elements_and_rates(
    population: Population, half_widths: Mapping[str, float], z: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same with other half-widths, and their derivatives to that of their field; 0 for fields without one.

    Any number of units by the one program.

    Args:
        population: of the units.
        half_widths: by name of the field.
        z: (numbers, n) of the units.
    """
    given = {name: np.asarray(t, jnp.result_type(float)) for name, t in half_widths.items()}
    rows = np.asarray(z, jnp.result_type(float))
    found = [_elements_and_rates(population, given, rows[:, lanes]) for lanes in calls(z.shape[1], PULLED)]
    errors, rates = (np.concatenate([np.asarray(row, float) for row in part], axis=1) for part in zip(*found))
    return errors[:, : z.shape[1]], rates[:, : z.shape[1]]


@jax.jit
def _elements_and_rates(
    population: Population, half_widths: dict[str, jax.Array], z: jax.Array
) -> tuple[jax.Array, jax.Array]:
    def errors(t: dict[str, jax.Array]) -> jax.Array:
        return elements(population.with_half_widths(t), z)

    return jax.jvp(errors, (half_widths,), (jax.tree.map(jnp.ones_like, half_widths),))
