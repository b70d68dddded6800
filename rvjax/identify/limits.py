"""Which limit is broken: the chance that each element lies outside its drawing."""

import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.identify.elements import FAR, Elements, mapped_values, standard
from rvjax.records import PyTree
from rvjax.tolerances.distribution.tolerance import Tolerance

DRAWS = 20_000
"""Of vectors, whose length follows no law that is known."""


def limits_of(elements: Elements, limits: PyTree) -> np.ndarray:
    """Lower and upper limits (2, p) of every element, SI.

    Args:
        elements: of the prior.
        limits: structure of the prior with a `Tolerance` in each field, or None: the prior's own.

    Raises:
        ValueError: another structure, or a field without limits.
    """
    given = elements.population.active if limits is None else elements.beside("limits", limits)
    for name, item in given.items():
        if not isinstance(item, Tolerance):
            raise ValueError(f"limits.{name} = {item!r}: must be a Tolerance, in SI")
    return np.array([[float(given[field].lower), float(given[field].upper)] for field in elements.fields]).T


def broken(
    elements: Elements, ends: np.ndarray, u: np.ndarray, root: np.ndarray, rng: np.random.Generator
) -> dict[str, float]:
    """{element: probability} of u ~ N(u, root root') outside its limits; vectors by their length, both elements alike.

    Args:
        elements: of the prior.
        ends: limits (2, p).
        u: mode (p,).
        root: factor of its covariance (p, k).
        rng: of the draws for vectors.
    """
    active = elements.population.active
    sd = np.linalg.norm(root, axis=1)
    places = np.asarray(standard(elements.population, jnp.asarray(ends)))
    reach = mapped_values(elements, np.full((2, u.size), [[-FAR], [FAR]]))
    margin = 1e-12 * (ends[1] - ends[0])
    below = np.where(reach[0] < ends[0] - margin, (places[0] - u) / sd, -np.inf)
    above = np.where(reach[1] > ends[1] + margin, (u - places[1]) / sd, -np.inf)
    chance = special.ndtr(below) + special.ndtr(above)
    vectors = np.array([active[field].is_vector for field in elements.fields])
    if vectors.any():
        values = mapped_values(elements, u + rng.standard_normal((DRAWS, root.shape[1])) @ root.T)
        pairs = np.flatnonzero(vectors)[::2]
        outside = np.hypot(values[:, pairs], values[:, pairs + 1]) > ends[1, pairs]
        chance[pairs] = chance[pairs + 1] = outside.mean(axis=0)
    return {name: float(number) for name, number in zip(elements.names, chance)}
