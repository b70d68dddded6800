"""Gradients of a response to the errors of single units, by one program."""

import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.sizes import PULLED, calls
from rvjax.population import Population
from rvjax.response.devices import mesh_of, on
from rvjax.response.response import NUMBERS, UNITS, Response, evaluate, is_costly, per_response, response_names
from rvjax.response.solving import pulls, sloped_together, solution


@per_response(static=("names",), shared=(NUMBERS, UNITS, NUMBERS))
def pulled(
    response: Response, population: Population, errors: jax.Array, cotangents: jax.Array, *, names: tuple[str, ...]
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Values (k, n), status (n,) and gradients (elements, n) of sum_k cotangent_k y_k of units: one reverse pass.

    The population maps elements to fields; its tolerances have no effect. Gradients to the numbers of the design, one
    row each in the order of their names, follow those to the elements.
    """

    def values(vector: jax.Array, free: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
        there = population.replace(values=free) if free else population
        found, status = evaluate(response, there.fill(there.by_field(vector)))
        return jnp.stack([found[name] for name in names]), status

    def one(vector: jax.Array, cotangent: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        found, pull, status = jax.vjp(values, vector, free, has_aux=True)
        slope, to_free = pull(cotangent)
        return found, status, jnp.concatenate([slope, jnp.stack(list(to_free.values()))]) if to_free else slope

    free = {name: jnp.asarray(value, errors.dtype) for name, value in sorted((population.values or {}).items())}

    return jax.vmap(one, in_axes=-1, out_axes=-1)(errors, cotangents)


def _on_all_devices(
    response: Response, population: Population, errors: jax.Array, cotangents: jax.Array, *, names: tuple[str, ...]
) -> tuple[jax.Array, jax.Array, jax.Array]:
    mesh = mesh_of(errors.shape[1])
    return pulled(response, population, on(mesh, errors), on(mesh, cotangents), names=names, mesh=mesh)


def gradients(
    response: Response, population: Population, errors: np.ndarray, cotangents: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Values (k, n) and gradients (elements, n) of weighted responses, any number of units by the one program.

    Where the population has numbers of the design, gradients to these follow, as rows in the order of their names.

    Args:
        response: of one unit.
        population: whose active fields the elements are.
        errors: (elements, n) of the active fields, one after the other.
        cotangents: (k, n) weights of the named responses.
        names: of the responses.
    """
    if is_costly(response):
        own, inverse = np.unique(errors, axis=1, return_inverse=True)  # a unit that is given twice is solved once
        names_of = response_names(response, population)
        rows = np.array([names_of.index(name) for name in names])
        weights = np.zeros((len(names_of), errors.shape[1]))
        weights[rows] = cotangents
        values, _, state = solution(response, population, own.shape[1], lambda lanes: jnp.asarray(own[:, lanes]))
        units = inverse.ravel()
        return values[rows][:, units], pulls(response, population, errors, state[:, units], weights)
    found, dtype = [], jnp.result_type(float)
    for lanes in calls(errors.shape[1], sloped_together()):
        arrays: Any = (np.asarray(rows[:, lanes], dtype) for rows in (errors, cotangents))
        found.append(_on_all_devices(response, population, *arrays, names=names))
    parts = zip(*((value, slope) for value, _, slope in found))
    values, slopes = (np.concatenate([np.asarray(row, float) for row in part], axis=1) for part in parts)
    return values[:, : errors.shape[1]], slopes[:, : errors.shape[1]]


def nominal_status(response: Response, population: Population) -> int:
    """Status of the unit without errors, by the program of the gradients."""
    names, count = response_names(response, population), sum(math.prod(t.shape) for t in population.active.values())
    lanes = (jnp.zeros((rows, sloped_together()), jnp.result_type(float)) for rows in (count, len(names)))
    return int(_on_all_devices(response, population, *lanes, names=names)[1][0])


@jax.jit
def elements(population: Population, z: jax.Array) -> jax.Array:
    """Errors (elements, n) of the active fields, one after the other, from z (numbers, n)."""
    return _rows(population.deviations(z), z)


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
        return _rows(population.with_half_widths(t).deviations(z), z)

    return jax.jvp(errors, (half_widths,), (jax.tree.map(jnp.ones_like, half_widths),))


def _rows(deviations: dict[str, jax.Array], z: jax.Array) -> jax.Array:
    return jnp.concatenate(
        [jnp.zeros((0, z.shape[-1]), z.dtype), *(v.reshape(-1, z.shape[-1]) for v in deviations.values())]
    )
