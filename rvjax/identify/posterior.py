"""Result of `solve`: most probable values of one unit, their uncertainty, goodness of fit, shares, broken limits.

The share of a field in the explained observation is a path integral from zero error,
c_F = integral_0^1 (df/de_F)(t e) e_F dt, so that the contributions sum to f(e) - f(0); in a group of the observation
the share of F is <c_F, sum c>/<sum c, sum c>, weighed by 1/sd^2.
"""

import dataclasses
import enum
import itertools
import math

import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.identify.elements import FAR, Elements, Identifiability, mapped_values, standard
from rvjax.identify.goodness_of_fit import Fit, Laplace
from rvjax.identify.identification import Problem
from rvjax.identify.search import Peak
from rvjax.population import Tolerance
from rvjax.records import PyTree
from rvjax.status import SolveInfo, Status


class Outcome(enum.StrEnum):
    """Status of an identification; the first that applies is returned."""

    NONFINITE = "NONFINITE"
    MAX_STEPS = "MAX_STEPS"
    REJECTED = "REJECTED"
    MULTIMODAL = "MULTIMODAL"
    LAPLACE_DOUBTFUL = "LAPLACE_DOUBTFUL"
    CONVERGED = "CONVERGED"


@dataclasses.dataclass(frozen=True, eq=False)
class Mode:
    """One maximum of the posterior.

    Attributes:
        value: structure of the prior, SI.
        weight: share of the posterior, by Laplace's method.
    """

    value: PyTree
    weight: float


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior(Identifiability):
    """Elements of one unit from its measurement; all numbers are NaN where `info` reports that no mode was found.

    Attributes:
        names: of the elements, (p,).
        u_sd: posterior standard deviations, in those of the prior (p,).
        resolution: {element: 1 - u_sd}.
        verdict: {element: "identified", "combination" or "unseen"}.
        directions: combinations with lambda >= 1, strongest first.
        inseparable: (element, element, posterior correlation) of pairs beyond 0.95.
        information: of the measurement, nats.
        u: most probable standard numbers (p,).
        u_covariance: of them (p, p).
        value: most probable values, structure of the prior, SI.
        lower: lower ends of their intervals.
        upper: upper ends.
        fit: how well model and prior explain the data.
        adequate: p_model >= 0.001.
        shares: {group of the observation: {field: share of what is explained}}.
        broken: {element: probability outside its limits}.
        modes: maxima of the posterior, the heaviest first.
        laplace: whether the intervals can be trusted.
        evidence: logarithm of the data's density, by Laplace's method.
        prediction: of the model at the mode, structure of the data.
        residual: data less prediction, NaN where missing.
        status: NONFINITE, MAX_STEPS, REJECTED, MULTIMODAL, LAPLACE_DOUBTFUL or CONVERGED.
        info: of the solver alone; `rvjax.check` takes the result.
        problem: model, prior and noise; for `sample` and `predict`.
        data: the measured numbers (m,), NaN where missing.
        peaks: the modes' numbers.
    """

    u: np.ndarray
    u_covariance: np.ndarray
    value: PyTree
    lower: PyTree
    upper: PyTree
    fit: Fit
    adequate: bool
    shares: dict[str, dict[str, float]]
    broken: dict[str, float]
    modes: tuple[Mode, ...]
    laplace: Laplace
    evidence: float
    prediction: PyTree
    residual: PyTree
    status: Outcome
    info: SolveInfo
    problem: Problem = dataclasses.field(repr=False)
    data: np.ndarray = dataclasses.field(repr=False)
    peaks: tuple[Peak, ...] = dataclasses.field(repr=False)


def outcome(solver: int, adequate: bool, heavy: int, trusted: bool) -> Outcome:
    """Return the first outcome that applies."""
    if solver == Status.NONFINITE:
        return Outcome.NONFINITE
    if solver == Status.MAX_STEPS:
        return Outcome.MAX_STEPS
    if not adequate:
        return Outcome.REJECTED
    if heavy > 1:
        return Outcome.MULTIMODAL
    return Outcome.CONVERGED if trusted else Outcome.LAPLACE_DOUBTFUL


PATH_NODES = 8


def contributions(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Contribution of each field (m, fields) to the observation of element values (p,)."""
    points, weights = np.polynomial.legendre.leggauss(PATH_NODES)
    slopes = problem.evaluate((points[:, None] + 1) / 2 * values, plain=True)[1]
    each = np.tensordot(weights / 2, slopes, axes=1) * values
    fields = np.array(problem.elements.fields)
    return np.stack([each[:, fields == name].sum(axis=1) for name in problem.elements.population.active], axis=1)


def shares(problem: Problem, values: np.ndarray) -> dict[str, dict[str, float]]:
    """{group: {field: share}} of element values (p,); NaN where nothing is explained or the model fails on the way."""
    fields = problem.elements.population.active
    parts = contributions(problem, values)
    whitened = parts / problem.sd[:, None]
    made = {}
    for group, places in problem.layout.groups.items():
        part = whitened[places]
        total = part.sum(axis=1)
        square = total @ total
        share = (part.T @ total) / square if square > 0 else np.full(len(fields), np.nan)
        made[group] = {name: float(number) for name, number in zip(fields, share)}
    return made


DRAWS = 20_000
"""Draws for vectors whose two elements depend on each other."""

NODES = 96
REACH = 12.0
"""Integral over a vector's wider axis: nodes for each piece, and standard deviations to each side."""


def limits_of(elements: Elements, limits: object) -> np.ndarray:
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
