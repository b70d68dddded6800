"""Errors round a circle: harmonics of known size, and vectors with a preferred direction.

The pitch of teeth has larger slow harmonics; parts are mounted by a mark, runouts are turned against each other.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from scipy import special

from rvjax.population.distributions import NODES, Normal, Rayleigh, central, interpolate, raw_rayleigh
from rvjax.population.tolerance import Moments, Tolerance, bad
from rvjax.records import Scalar, field, record, text
from rvjax.roots import bisect


@record
class Spectrum(Normal):
    """Normal errors along the last axis of a field, closed to a circle, with harmonics of given relative size.

    e_j = sum_h w_h (u_h cos(2 pi h j / n) + v_h sin(2 pi h j / n)), u and v normal, w_h in the ratios of `spectrum`
    and such that every error has the standard deviation h/(3 cp) of the normal distribution. No direction is preferred.
    """

    name = "spectrum"
    shifts = False
    couples = True
    spectrum: tuple[float, ...] = text("the relative sizes of the waves of 1, 2, .. periods in a turn")

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """m + h C z/(3 cp), with the symmetric matrix of rows of length 1 that leaves those waves of white noise."""
        axis = len(tolerance.shape) - 1
        waves = jnp.asarray(self._filter(tolerance.shape[-1]), z.dtype)
        along = jnp.moveaxis(jnp.tensordot(waves, z, (1, axis), precision="highest"), 0, axis)
        return tolerance.middle + tolerance.half_width * along / (3 * tolerance.cp)

    def correlation(self, tolerance: Tolerance) -> np.ndarray:
        """C C' of the errors round one circle."""
        waves = self._filter(tolerance.shape[-1])
        return waves @ waves.T

    def check(self, tolerance: Tolerance) -> None:
        """An own correlation leaves no place for a batch."""
        if tolerance.batch:
            raise bad("batch", tolerance.batch, "must be 0 for spectrum, whose errors are correlated by it")

    def check_field(self, name: str, tolerance: Tolerance) -> None:
        """A circle resolves fewer waves than half its errors."""
        pair = tolerance.vector or tolerance.shape[-1:] == (2,)
        most = (tolerance.shape[-1] - 1) // 2 if tolerance.shape else 0
        if pair or len(self.spectrum) > most:
            raise ValueError(
                f"{name}: spectrum of {len(self.spectrum)} waves, but a field of shape {tolerance.shape} has at most "
                f"{0 if pair else most} round its last axis"
            )

    def _filter(self, count: int) -> np.ndarray:
        """C (n, n): a circulant matrix whose rows have length 1."""
        size = np.zeros(count)
        orders = 1 + np.arange(len(self.spectrum))
        size[orders] = size[-orders] = self.spectrum
        row = np.fft.ifft(size / np.sqrt(np.mean(size**2))).real
        return row[(np.arange(count)[:, None] - np.arange(count)) % count]

    def _check(self) -> None:
        try:
            sizes = tuple(float(number) for number in self.spectrum)
        except (TypeError, ValueError):
            sizes = ()
        if not (sizes and all(0 <= number < np.inf for number in sizes) and any(sizes)):
            raise bad("spectrum", self.spectrum, "must be sizes of waves, zero or positive and not all zero")
        object.__setattr__(self, "spectrum", sizes)


@record
class VonMises(Rayleigh):
    """A Rayleigh magnitude whose direction has the density exp(k cos(a - a0))/(2 pi I0(k)).

    Only for fields of vectors [radial, tangential]; k = 0 is the Rayleigh distribution of vectors. The first number of
    a pair draws the magnitude, the second the direction.
    """

    name = "von_mises"
    couples = True
    concentration: float = text("the concentration k of the direction, 0 for none")
    direction: Scalar = field("rad", "preferred direction a0, from radial towards tangential", default=0.0)

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """(rho cos a, rho sin a)."""
        axis = len(tolerance.shape) - 1
        first, second = (jax.lax.index_in_dim(z, k, axis, keepdims=False) for k in (0, 1))
        size = tolerance.upper / (3 * tolerance.cp) * jnp.sqrt(-2 * log_ndtr(-first))
        angle = self.direction + interpolate(second, *_table(self.concentration))
        return jnp.stack([size * jnp.cos(angle), size * jnp.sin(angle)], axis)

    def moments(self, tolerance: Tolerance) -> Moments:
        """Moments of both components, in the shape of the field."""
        powers = [1.0, *raw_rayleigh(float(tolerance.upper) / (3 * float(tolerance.cp)))]
        pairs = []
        for toward in (0.0, math.pi / 2):  # cos(a - 0) and cos(a - pi/2) = sin a
            raw = [power * self._cosine_power(k, float(self.direction) - toward) for k, power in enumerate(powers)]
            pairs.append(central(*raw[1:]))
        first, second, third, fourth = (np.broadcast_to(np.array(both), tolerance.shape) for both in zip(*pairs))
        return first, second, third, fourth

    def is_normal(self, tolerance: Tolerance) -> bool:
        """Never, for a concentration of 0 either: the numbers of a pair are mapped together."""
        return False

    def correlation(self, tolerance: Tolerance) -> np.ndarray:
        """Of both components: E[rho^2 cos a sin a] - E x E y over both standard deviations."""
        first, second = (np.reshape(m, (-1, 2))[0] for m in self.moments(tolerance)[:2])
        square = raw_rayleigh(float(tolerance.upper) / (3 * float(tolerance.cp)))[1]
        shared = square * self._ratio(2) * math.sin(2 * float(self.direction)) / 2 - first[0] * first[1]
        spread = math.sqrt(second[0] * second[1])
        both = shared / spread if spread else 0.0
        return np.array([[1.0, both], [both, 1.0]])

    def check(self, tolerance: Tolerance) -> None:
        """Check as for Rayleigh; the concentration must be a number."""
        super().check(tolerance)
        if not isinstance(self.concentration, (int, float)) or not 0 <= self.concentration <= 1e6:
            raise bad("concentration", self.concentration, "must be a number from 0 to 1e6")

    def check_field(self, name: str, tolerance: Tolerance) -> None:
        """A direction belongs to a vector."""
        if not tolerance.is_vector:
            raise ValueError(f"{name}: von_mises is for vectors [radial, tangential], this field has {tolerance.shape}")

    def _ratio(self, order: int) -> float:
        """E cos(n (a - a0)) = I_n(k)/I_0(k)."""
        return float(special.ive(order, self.concentration) / special.ive(0, self.concentration))

    def _cosine_power(self, power: int, direction: float) -> float:
        """E cos^k(b) of b about `direction`: cos^k b as a sum of cos(n b)."""
        orders = range(-power, power + 1, 2)
        terms = [math.cos(n * direction) * self._ratio(abs(n)) for n in orders]
        return sum(math.comb(power, j) * term for j, term in enumerate(terms)) / 2**power


@functools.lru_cache(maxsize=32)
def _table(concentration: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles from the preferred direction at the nodes, and their slopes to z.

    The share beyond an angle, S(a) = integral of the density from a to pi, is solved for Phi(-z), z >= 0 (the
    distribution is symmetric), by bisection to 3e-6 and Newton steps: relative digits everywhere, for any
    concentration.
    """
    k, z = float(concentration), NODES[NODES >= 0]
    points, weights = np.polynomial.legendre.leggauss(48)
    points, weights = (points + 1) / 2, weights / 2

    def density(a: np.ndarray) -> np.ndarray:
        return np.exp(-2 * k * np.sin(a / 2) ** 2) / (2 * np.pi * special.i0e(k))

    def beyond(a: np.ndarray) -> np.ndarray:
        span = np.minimum(np.pi - a, 12 / math.sqrt(max(k, 1.0)))  # 12 standard deviations of a narrow distribution
        return span * (density(a[:, None] + span[:, None] * points) @ weights)

    target = special.ndtr(-z)
    low, high = bisect(lambda a: beyond(a) > target, np.zeros_like(z), np.full_like(z, np.pi), steps=20)
    angle = (low + high) / 2
    for _ in range(4):
        angle = np.clip(angle + (beyond(angle) - target) / density(angle), low, high)
    slope = np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi) / density(angle)
    return np.concatenate([-angle[:0:-1], angle]), np.concatenate([slope[:0:-1], slope])
