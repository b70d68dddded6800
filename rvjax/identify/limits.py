"""Broken limits: the probability that each element lies outside its limits on the drawing."""

import itertools
import math

import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.identify.elements import FAR, Elements, mapped_values, standard
from rvjax.population import Tolerance
from rvjax.records import PyTree

DRAWS = 20_000
"""Draws for vectors whose two elements depend on each other."""

NODES = 96
REACH = 12.0
"""Integral over a vector's wider axis: nodes for each piece, and standard deviations to each side."""


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
    start = 0
    for tolerance in active.values():
        places = start + np.arange(math.prod(tolerance.shape))
        start += places.size
        for pair in places.reshape(-1, 2) if tolerance.is_vector else ():
            chance[pair] = _beyond(elements, tolerance, ends[1, pair[0]], u, root, pair, rng)
    return {name: float(number) for name, number in zip(elements.names, chance)}


def _beyond(
    elements: Elements,
    tolerance: Tolerance,
    limit: float,
    u: np.ndarray,
    root: np.ndarray,
    pair: np.ndarray,
    rng: np.random.Generator,
) -> float:
    """Chance that the vector of two elements is longer than its limit."""
    if tolerance.law.couples:
        values = mapped_values(elements, u + rng.standard_normal((DRAWS, root.shape[1])) @ root.T)
        return float((np.hypot(*values[:, pair].T) > limit).mean())
    scale = float(mapped_values(elements, np.ones((1, u.size)))[0, pair[0]])  # components are independent N(0, scale^2)
    spread, turn = np.linalg.eigh(scale**2 * root[pair] @ root[pair].T)
    along, across = turn.T @ (scale * u[pair])
    first, second = np.sqrt(np.maximum(spread, 0.0))
    # Over the wider axis; of the other one the two tails beyond the circle.
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    edges = np.unique(np.clip([across - REACH * second, -limit, limit, across + REACH * second], -np.inf, np.inf))
    total = 0.0
    for low, high in itertools.pairwise(edges):
        angle = np.pi / 2 * nodes  # a sine, for the circle ends upright
        x = (low + high) / 2 + (high - low) / 2 * np.sin(angle)
        density = np.exp(-(((x - across) / second) ** 2) / 2) / (second * math.sqrt(2 * math.pi))
        rest = np.sqrt(np.maximum(limit**2 - x**2, 0.0))
        tails = special.ndtr((-rest - along) / first) + special.ndtr((along - rest) / first)
        outside = np.where(np.abs(x) >= limit, 1.0, tails)
        total += float((weights * np.cos(angle) * outside * density).sum() * np.pi / 2 * (high - low) / 2)
    return total
