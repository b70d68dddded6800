"""Noise of an order from the orders about it.

Readings with memory (a warm bench, a filter, a drifting zero) have more noise at low orders than at high ones. The
level follows from the spectrum of the residual, without what the measured object causes.
"""

import math
from collections.abc import Iterable

import numpy as np
from scipy import optimize

from rvjax.measured.sampling import spectrum

KNOTS = 3  # of a level, equal distances of the logarithm of the order
LOWEST = 7.0  # order from which the level is read; below it is extended, since mountings cause the lowest orders
STEEPEST = -2.5  # power of the order; noise that adds up from reading to reading has -2
COLOURED = 16.3  # likelihood ratio of noise without memory: chance of 0.001 with three degrees of freedom
FEWEST = 16  # orders that determine a level
OUTLIER = 2.0  # logarithm of a power beyond which it counts as content, not as noise
EULER = float(np.euler_gamma)


def factor(
    angle: np.ndarray, residual: np.ndarray, sd: float, orders: np.ndarray, contents: Iterable[float], top: float
) -> tuple[np.ndarray, float]:
    """Power of the noise at each order, of that of independent readings, at least 1; and how many orders set the level.

    Args:
        angle: ascending, rad (n,).
        residual: of the contents (n,).
        sd: of the residual.
        orders: whose noise is required (k,).
        contents: orders that the residual does not contain any more.
        top: highest order of the noise that is used.
    """
    white = np.ones(len(orders)), math.inf
    span = float(np.ptp(angle)) * len(angle) / max(len(angle) - 1, 1)
    step = 2 * math.pi / span
    if not sd > 0 or top < 2 * LOWEST:
        return white
    bins = np.arange(math.ceil(LOWEST / step), math.floor(top / step) + 1) * step
    taken = np.array([*contents, -1.0])
    bins = bins[np.min(np.abs(bins[:, None] - taken), axis=1) > 0.9 * step] if len(bins) else bins
    if len(bins) < FEWEST:
        return white
    order, size = spectrum(angle, residual, top + step)
    power = np.interp(bins, order, np.abs(size) ** 2) / (len(angle) * sd**2)  # exponential, mean 1
    knots = np.linspace(math.log(bins[0]), math.log(bins[-1]), KNOTS)
    log_power = np.log(np.maximum(power, 1e-12)) + EULER

    def level(numbers: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Logarithm of the level: straight lines between the knots, the first one extended."""
        slope = np.clip((numbers[1] - numbers[0]) / (knots[1] - knots[0]), STEEPEST, 0.0)
        below = np.minimum(at - knots[0], 0.0)
        return np.asarray(np.interp(at, knots, numbers) + slope * below)

    def cost(numbers: np.ndarray) -> float:
        off = log_power - EULER - level(numbers, np.log(bins))
        return float(np.sum(np.exp(np.minimum(off, OUTLIER)) - np.minimum(off, OUTLIER)))

    start = np.full(KNOTS, np.median(log_power))
    found = optimize.minimize(cost, start, method="Nelder-Mead", options={"maxiter": 600, "fatol": 1e-3})
    flat = optimize.minimize_scalar(lambda x: cost(np.full(KNOTS, x)), bounds=(-8, 8), method="bounded")
    if 2 * (flat.fun - found.fun) < COLOURED:
        return white
    return np.maximum(np.exp(level(found.x, np.log(orders))), 1.0), len(bins) / KNOTS
