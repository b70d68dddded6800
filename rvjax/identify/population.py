"""Mean and standard deviation of a process, from the measurements of many units.

Expectation maximisation (Dempster, Laird and Rubin 1977, J. R. Stat. Soc. B 39, 1). The elements of unit i are
u_i = mu + D M z_i; their distribution given mu, D and the linearised data is normal. The next mu is the mean of the
units' expectations, the next D^2 the mean of their squared distances from mu plus their variances.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from rvjax.identify.elements import FAR, Elements, mapped_values, standard

ROUNDS = 1000
SETTLED = 1e-6
"""Largest change of a mean or spread, in standard deviations of the prior, that ends the iteration."""


@dataclasses.dataclass(frozen=True, eq=False)
class Process:
    """Mean and spread over units of every element; without information in the data they are those of the prior.

    Attributes:
        names: of the elements (p,).
        u_mean: mean of the standard numbers, 0 for the process of the drawing (p,).
        u_sd: their spread, 1 for the process of the drawing (p,).
        u_mean_sd: standard deviation of the mean; beyond about 1 the data do not determine it (p,).
        mean: {element: value at u_mean, SI}.
        sd: {element: half the distance of the values one spread to each side, SI}.
        cp: {element: distance of the limits over six spreads}, on the scale of u; inf for distributions within their
            limits.
        cpk: {element: distance of the mean from the nearer limit over three spreads}.
        units: how many were used.
    """

    names: tuple[str, ...]
    u_mean: np.ndarray
    u_sd: np.ndarray
    u_mean_sd: np.ndarray
    mean: dict[str, float]
    sd: dict[str, float]
    cp: dict[str, float]
    cpk: dict[str, float]
    units: int


def process(elements: Elements, names: tuple[str, ...], factors: np.ndarray) -> Process:
    """Estimate the process from its units.

    Args:
        elements: of the prior.
        names: of the elements that each unit has for itself.
        factors: triangular factors of [slopes over u, linearised data] of each unit (units, p + 1, p + 1).

    Raises:
        ValueError: fewer than two units.
    """
    if len(factors) < 2:
        raise ValueError(f"population: {len(factors)} units with a mode, a spread needs at least 2")
    places = [elements.names.index(name) for name in names]
    mixing = elements.mixing[places]
    mean, spread = _maximise(factors[:, :-1, :-1], factors[:, :-1, -1], mixing)
    every = np.zeros((3, elements.count))
    every[:, places] = mean + np.array([[0.0], [-1.0], [1.0]]) * spread
    values = mapped_values(elements, every)[:, places]
    low, high = _limits(elements)[:, places]
    cp = (high - low) / (6 * spread)
    cpk = np.minimum(high - mean, mean - low) / (3 * spread)

    def named(numbers: np.ndarray) -> dict[str, float]:
        return {name: float(number) for name, number in zip(names, numbers)}

    return Process(
        names=names,
        u_mean=mean,
        u_sd=spread,
        u_mean_sd=_mean_sd(factors[:, :-1, :-1], mixing, spread),
        mean=named(values[0]),
        sd=named(np.abs(values[2] - values[1]) / 2),
        cp=named(cp),
        cpk=named(cpk),
        units=len(factors),
    )


def _maximise(slopes: np.ndarray, data: np.ndarray, mixing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean, spread = np.zeros(len(mixing)), np.ones(len(mixing))
    eye = np.eye(mixing.shape[1])
    for _ in range(ROUNDS):
        over = slopes @ (spread[:, None] * mixing)
        turned = np.swapaxes(over, -1, -2)
        covariance = np.linalg.inv(eye + turned @ over)
        expected = covariance @ (turned @ (data - slopes @ mean)[..., None])
        root = spread[:, None] * mixing
        shift = (root @ expected)[..., 0]
        variance = ((root @ covariance) * root).sum(axis=-1)
        step = shift.mean(axis=0)
        new = np.sqrt(((shift - step) ** 2 + variance).mean(axis=0))
        change = max(np.abs(step).max(), np.abs(new - spread).max())
        mean, spread = mean + step, new
        if change < SETTLED:
            break
    return mean, spread


def _mean_sd(slopes: np.ndarray, mixing: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Standard deviation of the mean, from the information of all units and their spread; large without information."""
    over = slopes @ (spread[:, None] * mixing)
    inner = np.linalg.inv(np.eye(over.shape[-2]) + over @ np.swapaxes(over, -1, -2))
    information = (np.swapaxes(slopes, -1, -2) @ inner @ slopes).sum(axis=0)
    return np.sqrt(np.diag(np.linalg.inv(information + 1e-12 * np.eye(len(information)))))


def _limits(elements: Elements) -> np.ndarray:
    """Limits of the drawing on the scale of u (2, p), infinite where a distribution never reaches them."""
    active = elements.population.active
    ends = np.array([[float(active[f].lower), float(active[f].upper)] for f in elements.fields]).T
    vectors = np.array([active[f].is_vector for f in elements.fields])
    ends[0, vectors] = -ends[1, vectors]  # a component has the limit of the length to both sides
    places = np.asarray(standard(elements.population, jnp.asarray(ends)))
    return np.where(np.abs(places) > FAR - 1, np.sign(places) * np.inf, places)
