"""Orders of a measured curve by least squares on the angles as they were measured; a Fourier bin is no order."""

import dataclasses
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True, eq=False)
class Spectrum:
    """Orders of one curve: mean + Re sum value exp(i order angle).

    Attributes:
        order: per output turn (k,).
        value: complex amplitudes, rad (k,).
        sd: standard deviation of their real and imaginary parts, rad (k,).
        mean: of the curve, rad.
        residual_sd: of what the orders leave, rad.
    """

    order: np.ndarray
    value: np.ndarray
    sd: np.ndarray
    mean: float
    residual_sd: float


def spectrum(angle: Any, error: Any, order: Any) -> Spectrum:
    """Fit orders to a curve.

    Args:
        angle: of the output, rad (n,).
        error: of the output, rad (n,).
        order: per output turn, each once (k,).

    Raises:
        ValueError: lengths that differ, or fewer points or directions than 2 k + 2 numbers need.
    """
    x, y, orders = np.asarray(angle, float), np.asarray(error, float), np.asarray(order, int)
    if x.ndim != 1 or x.shape != y.shape:
        raise ValueError(f"error: {y.size} numbers for {x.size} angles")
    count = 2 * len(orders) + 1
    if len(x) <= count:
        raise ValueError(f"angle: {len(x)} points are too few for {len(orders)} orders, which need {count + 1}")
    turned = np.multiply.outer(x, orders)
    columns = np.concatenate([np.ones((len(x), 1)), np.cos(turned), -np.sin(turned)], axis=1)
    q, r = np.linalg.qr(columns)
    if np.abs(np.diag(r)).min() < 1e-6 * np.sqrt(len(x)):
        raise ValueError(f"angle: the points do not tell {len(orders)} orders apart")
    found = np.linalg.solve(r, q.T @ y)
    left = y - columns @ found
    residual_sd = float(np.sqrt(left @ left / (len(x) - count)))
    variance = residual_sd**2 * (np.linalg.inv(r) ** 2).sum(axis=1)[1:]
    cosine, sine = np.split(found[1:], 2)
    sd = np.sqrt(np.mean(np.split(variance, 2), axis=0))
    return Spectrum(orders, cosine + 1j * sine, sd, float(found[0]), residual_sd)


def significant(found: Spectrum, chance: float = 0.001) -> np.ndarray:
    """Places of the orders that noise alone would not show, with this chance that any of them is noise (s,).

    |value|^2/(2 sd^2) of pure noise is exponential; k orders pass ln(k/chance) with that chance at most.

    Args:
        found: orders of a curve.
        chance: of one order of noise among all.
    """
    level = np.log(max(len(found.order), 1) / chance)
    return np.flatnonzero(np.abs(found.value) ** 2 > 2 * found.sd**2 * level)
