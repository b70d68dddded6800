"""Posterior of a measured part: from the value, the spread of the gauge and the population.

Without the population a plan chases the noise of the gauge: the best of many noisy values is mostly noise.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.checks import checked, numbers
from rvjax.records import PyTree, Scalar
from rvjax.tolerances import Tolerance

NODES = 129
_REACH = 8.2  # standard normal: what lies beyond has a share of 2e-16
_DEPTH = 40.0  # in the logarithm: less likely nodes weigh nothing in double precision
_ENOUGH = 40  # nodes in the window; the trapezoidal rule then has every digit of a bell
_ROUNDS = 60


@dataclasses.dataclass(frozen=True)
class Belief:
    """Posterior of the elements of one error of many parts.

    Attributes:
        mean: (parts, *shape).
        sd: (parts, *shape).
        value: nodes of the posterior (NODES, elements), None where it is normal.
        below: share of the posterior below each node (NODES, elements).
    """

    mean: np.ndarray
    sd: np.ndarray
    value: np.ndarray | None = None
    below: np.ndarray | None = None

    @property
    def certain(self) -> bool:
        """True if no error is random."""
        return not self.sd.any()

    def drawn(self, z: np.ndarray) -> np.ndarray:
        """Errors of parts (parts, draws, *shape).

        Args:
            z: standard normal (parts or 1, draws, *shape).
        """
        if self.value is None or self.below is None:
            return self.mean[:, None] + self.sd[:, None] * z
        draws = z.shape[1]
        share = special.ndtr(np.broadcast_to(z, (len(self.mean), *z.shape[1:])))
        by_element = np.moveaxis(share, 1, 0).reshape(draws, -1)
        found = [np.interp(by_element[:, k], self.below[:, k], self.value[:, k]) for k in range(by_element.shape[1])]
        return np.moveaxis(np.stack(found, axis=1).reshape(draws, *self.mean.shape), 0, 1)


@checked
def believed(value: object, sd: PyTree, tolerance: Tolerance | None) -> tuple[Scalar, Scalar]:
    """Mean and standard deviation of an error that was measured.

    Of a normal population N(mu, s0^2) measured with s: g = s0^2/(s0^2 + s^2), mean mu + g (value - mu), sd
    s0 sqrt(1 - g). Else: the posterior on 129 nodes. A von Mises vector has the mean and spread of its
    components.

    Args:
        value: measured, unit of the error, any shape.
        sd: standard deviation of the measurement, of that shape or one number; inf: not measured.
        tolerance: the population; None: only the measurement is known.

    Raises:
        ValueError: a value that is not finite, or a negative standard deviation.
    """
    values, sds = numbers("value", value), numbers("sd", sd)
    if sds.shape not in ((), values.shape):
        raise ValueError(f"sd: shape {sds.shape}: must be one number or of the shape of value, {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"value = {value!r}: must be finite")
    if not (sds >= 0).all():
        raise ValueError(f"sd = {sd!r}: must be zero or positive")
    found = belief(values[None], np.broadcast_to(sds, values.shape)[None], tolerance)
    mean, spread = found.mean[0], found.sd[0]
    return (mean, spread) if values.ndim else (float(mean), float(spread))


def belief(value: np.ndarray, sd: np.ndarray, tolerance: Tolerance | None) -> Belief:
    """Posterior of one error of many parts.

    Args:
        value: measured (parts, *shape).
        sd: of the measurement (parts, *shape).
        tolerance: the population, or None.
    """
    if tolerance is None or not sd.any():
        return Belief(value, sd)
    own = tolerance.replace(shape=value.shape[1:])
    mean, variance = (np.broadcast_to(np.asarray(moment, float), value.shape) for moment in own.moments()[:2])
    if own.law.is_normal(own) or own.law.couples:
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = np.where(sd == 0, 1.0, np.where(np.isinf(sd), 0.0, variance / (variance + sd**2)))
        shrunk = np.where(sd == 0, value, mean + gain * (value - mean))
        return Belief(shrunk, np.where(sd == 0, 0.0, np.sqrt(variance * (1 - gain))))
    return _on_nodes(own.replace(shape=()), value, sd)


@jax.jit
def _quantile(tolerance: Tolerance, z: jax.Array) -> jax.Array:
    return tolerance.deviate(z)


def _on_nodes(tolerance: Tolerance, value: np.ndarray, sd: np.ndarray) -> Belief:
    """Nodes in z around the bulk of the posterior; all elements at once."""
    y, s = value.reshape(-1), np.maximum(sd.reshape(-1), 1e-9 * max(float(tolerance.half_width), 1e-300))
    low, high = np.full(y.size, -_REACH), np.full(y.size, _REACH)
    steps = np.linspace(0.0, 1.0, NODES)[:, None]
    for _ in range(_ROUNDS):
        z = low + (high - low) * steps
        nodes = np.asarray(_quantile(tolerance, jnp.asarray(z)), float)
        depth = -(z**2) / 2 - ((y - nodes) / s) ** 2 / 2
        depth -= depth.max(axis=0)
        kept = depth > -_DEPTH
        first, last = kept.argmax(axis=0), NODES - 1 - kept[::-1].argmax(axis=0)
        if (last - first >= _ENOUGH).all():
            break
        wide = np.take_along_axis(z, np.stack([np.maximum(first - 1, 0), np.minimum(last + 1, NODES - 1)]), axis=0)
        few = last - first < _ENOUGH
        low, high = np.where(few, wide[0], low), np.where(few, wide[1], high)
    weight = np.exp(depth)
    weight /= weight.sum(axis=0)
    mean = (weight * nodes).sum(axis=0)
    spread = np.sqrt((weight * (nodes - mean) ** 2).sum(axis=0))
    exact = sd.reshape(-1) == 0
    mean, spread = np.where(exact, y, mean), np.where(exact, 0.0, spread)
    nodes = np.where(exact, y, nodes)
    below = np.cumsum(weight, axis=0) - weight / 2
    return Belief(mean.reshape(value.shape), spread.reshape(value.shape), nodes, below)
