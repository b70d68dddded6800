"""Contribution of each field to the explained observation, along the straight path from zero error.

c_F = integral_0^1 (df/de_F)(t e) e_F dt, so that the contributions sum to f(e) - f(0); in a group of the observation
the share of F is <c_F, sum c>/<sum c, sum c>, weighed by 1/sd^2.
"""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.identify.observation import flatten
from rvjax.identify.problem import Model, Problem, slopes
from rvjax.population import Population
from rvjax.response import per_response

NODES = 8


@per_response(static=("size",))
def contributions(model: Model, population: Population, values: dict[str, jax.Array], *, size: int) -> jax.Array:
    """Contribution of each field (m, fields) to the observation of `values`."""

    def along(parts: jax.Array) -> tuple[jax.Array, None]:
        scaled = {name: parts[k] * value for k, (name, value) in enumerate(values.items())}
        return flatten(model(population.fill(scaled))), None

    points, weights = np.polynomial.legendre.leggauss(NODES)
    every = jnp.asarray(np.tile((points[:, None] + 1) / 2, len(values)))
    found = jax.lax.map(lambda parts: slopes(along, parts, size)[1], every)
    return jnp.tensordot(jnp.asarray(weights / 2), found, axes=1)


def shares(problem: Problem, values: np.ndarray) -> dict[str, dict[str, float]]:
    """{group: {field: share}} of element values (p,); NaN where nothing is explained or the model fails on the way."""
    population = problem.elements.population
    fields = population.by_field(jnp.asarray(values))
    found = np.asarray(contributions(problem.model, population, fields, size=problem.layout.size))
    whitened = found / problem.sd[:, None]
    made = {}
    for group, places in problem.layout.groups.items():
        part = whitened[places]
        total = part.sum(axis=1)
        square = total @ total
        share = (part.T @ total) / square if square > 0 else np.full(len(fields), np.nan)
        made[group] = {name: float(number) for name, number in zip(fields, share)}
    return made
