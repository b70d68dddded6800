"""Check of Laplace's method: draws from the normal distribution about the mode, weighted by the true density.

The tail of the weights is fitted by a generalised Pareto distribution (Zhang and Stephens 2009, Technometrics 51, 316);
a shape k above 0.7 means that averages over the normal distribution are not reliable (Vehtari, Simpson, Gelman, Yao and
Gabry 2024, J. Mach. Learn. Res. 25, 72).
"""

import dataclasses
import math

import numpy as np

MOST_PARETO = 0.7
"""Largest shape of weights whose averages can be trusted."""

LEAST_DRAWS = 40
"""Below, the tail holds too few weights for a fit."""


@dataclasses.dataclass(frozen=True)
class Laplace:
    """Reliability of the intervals about the mode.

    Attributes:
        pareto_k: shape of the tail of the importance weights; 0 where they are equal to rounding.
        ess: effective number of the draws.
        trusted: pareto_k <= 0.7, and a single mode holds more than 1 %.
    """

    pareto_k: float
    ess: float
    trusted: bool


def pareto_shape(log_weights: np.ndarray) -> float:
    """Shape k of the tail of importance weights; inf if so many are zero that no tail is left."""
    size = log_weights.size
    tail = min(size // 5, math.ceil(3 * math.sqrt(size)))
    ordered = np.sort(log_weights - log_weights.max())
    cutoff, above = ordered[-tail - 1], ordered[-tail:]
    if not math.isfinite(cutoff):
        return math.inf
    if above[-1] - cutoff < 1e-9:
        return 0.0
    excess = np.exp(above) - math.exp(cutoff)
    excess = excess[excess > 0]
    return _generalised_pareto(excess) if excess.size > 4 else math.inf


def _generalised_pareto(x: np.ndarray) -> float:
    """Shape k of sorted excesses: the profile likelihood over theta = -k/sigma averaged, and a weak prior at 0.5."""
    n = x.size
    points = 30 + int(math.sqrt(n))
    quarter = x[int(n / 4 + 0.5) - 1]
    theta = 1 / x[-1] + (1 - np.sqrt(points / (np.arange(points) + 0.5))) / (3 * quarter)
    shape = np.log1p(-theta[:, None] * x).mean(axis=1)
    likelihood = n * (np.log(-theta / shape) - shape - 1)
    weights = np.exp(likelihood - likelihood.max())
    k = float(np.log1p(-(theta @ weights / weights.sum()) * x).mean())
    return (n * k + 5.0) / (n + 10.0)


def reliability(log_weights: np.ndarray, modes: int) -> Laplace:
    """Return the verdict on draws.

    Args:
        log_weights: of draws from the normal distribution; -inf where the model is not finite.
        modes: that hold more than 1 %.
    """
    weights = np.exp(log_weights - log_weights.max()) if np.isfinite(log_weights.max()) else np.zeros(1)
    k = pareto_shape(log_weights) if weights.any() else math.inf
    ess = float(weights.sum() ** 2 / (weights**2).sum()) if weights.any() else 0.0
    return Laplace(k, ess, bool(k <= MOST_PARETO and modes <= 1))
