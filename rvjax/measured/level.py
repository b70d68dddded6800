"""Noise of an order from the orders about it.

Readings with memory (a warm bench, a filter, a drifting zero) have more noise at low orders than at high ones. The
level follows from the spectrum of the residual, without what the measured object causes.
"""

import math
from collections.abc import Iterable

import numpy as np
import scipy

from rvjax.measured.atoms import Model
from rvjax.measured.sampling import spectrum

KNOTS = 4  # of a level, equal distances of the logarithm of the order
LOWEST = 5.0  # order from which the level is read; below it is extended, since mountings cause the lowest orders
STEEPEST = -2.0  # power of the order; noise that adds up from reading to reading has -2
COLOURED = 6.25  # likelihood ratio of noise without memory: chance of 0.1 with three degrees of freedom
FEWEST = 16  # orders that determine a level
KNOWN = 1e12  # orders that determine the level of independent readings: it is that of all residuals
REACH, LEAST = 0.6, 3  # logarithm of the order over which a level is one; fewest orders of it
OUTLIER = 2.0  # logarithm of a power beyond which it counts as content, not as noise
EULER, MEDIAN = float(np.euler_gamma), math.log(math.log(2))  # of the logarithm of an exponential number


def factor(
    model: Model, sd: float, orders: np.ndarray, parts: Iterable[float], top: float
) -> tuple[np.ndarray, np.ndarray]:
    """Power of the noise at each order, of that of independent readings, at least 1; and how many orders determine it.

    Args:
        model: of the curve.
        sd: of a reading about all orders that are fitted.
        orders: whose noise is required (k,).
        parts: orders that the measured object causes.
        top: highest order of the noise that is used.
    """
    white = np.ones(len(orders)), np.full(len(orders), KNOWN)
    span = float(np.ptp(model.angle)) * len(model.angle) / max(len(model.angle) - 1, 1)
    if not sd > 0 or not span > 0 or top < 2 * LOWEST:
        return white
    step = 2 * math.pi / span
    named = list(parts)
    weak = [a for a in model.atoms if a.kind == "order" and LOWEST <= a.at <= 2 * LOWEST and a.at not in named]
    residual = model.residual + model.curve(weak)  # content among the lowest orders of noise is an outlier there
    taken = np.array([-1.0, *(a.at for a in model.atoms if a.kind in ("order", "line") and a not in weak)])
    bins = np.arange(math.ceil(LOWEST / step), math.floor(top / step) + 1) * step
    bins = bins[np.min(np.abs(bins[:, None] - taken), axis=1) > 0.9 * step] if len(bins) else bins
    if len(bins) < FEWEST:
        return white
    order, size = spectrum(model.angle, residual, top + step)
    power = np.interp(bins, order, np.abs(size) ** 2) / (len(residual) * sd**2)  # exponential, mean 1
    knots = np.linspace(math.log(bins[0]), math.log(bins[-1]), KNOTS)
    log_power = np.log(np.maximum(power, 1e-12))
    hats = np.array([np.interp(np.log(bins), knots, row) for row in np.eye(KNOTS)]).T

    def cost(numbers: np.ndarray, shape: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the logarithm of the likelihood; a power far above the level counts as content."""
        off = log_power - shape @ numbers
        held = np.exp(np.minimum(off, OUTLIER))
        inside = off < OUTLIER
        return float(np.sum(held - np.minimum(off, OUTLIER))), shape.T @ (inside * (1 - held))

    def fit(shape: np.ndarray) -> scipy.optimize.OptimizeResult:
        first = np.full(shape.shape[1], np.median(log_power) - MEDIAN)
        near = scipy.optimize.least_squares(
            lambda x: shape @ x - log_power - EULER, first, lambda _: shape, loss="soft_l1"
        )
        return scipy.optimize.minimize(cost, near.x, args=(shape,), jac=True, method="BFGS")

    found, flat = fit(hats), fit(np.ones((len(bins), 1)))
    if 2 * (flat.fun - found.fun) < COLOURED:
        return white
    at = np.log(orders)
    falling = np.maximum.accumulate(found.x[::-1])[::-1]  # no less at low orders than at high ones
    slopes = (falling[1:3] - falling[0]) / (knots[1:3] - knots[0])
    size = np.interp(at, knots, falling) + max(float(slopes.min()), STEEPEST) * np.minimum(at - knots[0], 0.0)
    reach = np.abs(np.log(bins) - np.maximum(at, knots[0])[:, None]) < REACH
    return np.maximum(np.exp(size), 1.0), np.maximum(np.sum(reach, axis=1), LEAST).astype(float)
