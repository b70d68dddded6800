"""`orders`: the harmonics of a measured curve, by least squares at the angles that were really measured."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.linear import svd
from rvjax.records import Array

DEPENDENT = 1e-8
"""Least ratio of singular values at which the samples distinguish all orders."""


@dataclasses.dataclass(frozen=True, eq=False)
class Orders:
    """Harmonics of a curve, value(angle) = mean + Re sum_k value_k exp(i order_k angle).

    Attributes:
        order: as required (k,).
        value: complex amplitudes (k,), unit of the curve.
        sd: standard deviation of their real and imaginary part (k,), from the residual.
        mean: of the curve.
        residual_sd: standard deviation of what no order explains, unit of the curve.
    """

    order: np.ndarray
    value: np.ndarray
    sd: np.ndarray
    mean: float
    residual_sd: float


@checked
def orders(
    angle: Array | np.ndarray, value: Array | np.ndarray, orders: Sequence[float] | np.ndarray, *, drift: bool = False
) -> Orders:
    """Harmonics of a curve that may be sampled unevenly, over any number of turns.

    Args:
        angle: rad (n,).
        value: of the curve (n,), NaN where missing.
        orders: per turn, positive and distinct (k,).
        drift: whether the curve may also creep in proportion to the angle; that part is fitted and removed.

    Raises:
        ValueError: shapes that do not fit, numbers that are not finite, or more orders than the samples distinguish.
    """
    wanted = np.asarray(orders, float)
    if wanted.ndim != 1 or not (wanted > 0).all() or np.unique(wanted).size != wanted.size or np.isinf(wanted).any():
        raise ValueError(f"orders = {orders!r}: must be positive and distinct, per turn")
    x, y = np.asarray(angle, float), np.asarray(value, float)
    if x.ndim != 1 or x.shape != y.shape:
        raise ValueError(f"value: shape {y.shape}, angle has {x.shape} rad; both must be (n,)")
    seen = ~np.isnan(y)
    x, y = x[seen], y[seen]
    for name, item, unit in (("angle", x, "rad"), ("value", y, "unit of the curve")):
        if not np.isfinite(item).all():
            raise ValueError(f"{name} = {item[~np.isfinite(item)][0]}: must be finite, {unit}")
    # Columns of one length, about the mid-point of the angles: the scale of the angles does not change the condition.
    centred = (x - x.mean()) / max(float(np.ptp(x)), 1e-300) if x.size else x
    extra = [centred] if drift else []
    phase = x[:, None] * wanted
    matrix = np.concatenate([np.ones((x.size, 1)), *(c[:, None] for c in extra), np.cos(phase), -np.sin(phase)], axis=1)
    numbers = matrix.shape[1]
    left, singular, right = svd(matrix)
    if x.size <= numbers or singular[-1] < DEPENDENT * singular[0]:
        raise ValueError(f"orders = {wanted.tolist()}: {x.size} samples cannot determine {numbers} numbers per turn")
    found = right.T @ ((left.T @ y) / singular)
    residual_sd = float(np.sqrt(((y - matrix @ found) ** 2).sum() / (x.size - numbers)))
    variance = ((right.T / singular) ** 2).sum(axis=1)
    first = 1 + len(extra)
    real, imaginary = slice(first, first + wanted.size), slice(first + wanted.size, None)
    return Orders(
        order=wanted,
        value=found[real] + 1j * found[imaginary],
        sd=residual_sd * np.sqrt((variance[real] + variance[imaginary]) / 2),
        mean=float(found[0]),
        residual_sd=residual_sd,
    )
