"""`Tolerance`: limits of one manufacturing error and the law that parts follow between them.

Every variate is a map e = q(Phi(z)) of standard normal numbers z, which belong to the sample while
the tolerance only shapes and scales them: the same z serve every tolerance (common random numbers).
"""

import dataclasses
import functools
import math
import operator
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf, log_ndtr, ndtr, ndtri
from scipy import special

from rvjax.records import Record, concrete, field, record, text
from rvjax.tolerances.distribution.grades import it_width

DISTRIBUTIONS = ("normal", "truncated_normal", "uniform", "triangular", "beta", "rayleigh")
_NODES = np.linspace(-9.0, 9.0, 8193)  # of the tabulated beta quantile, in z


@record
class Tolerance(Record):
    """Limits of an error and its distribution between them; the unit is that of the error.

    Middle m = (lower + upper)/2, half-width h = (upper - lower)/2, mean m + shift h, and for the
    normal law sigma = h/(3 cp), so that the capability of the process is Cp = cp and
    Cpk = cp (1 - |shift|). h = 0 is a constant error m.

    - "normal": N(m + shift h, sigma^2), not cut at the limits.
    - "truncated_normal": the same, cut at the limits and renormalised.
    - "uniform": between the limits; no shift.
    - "triangular": between the limits, mode m + shift h.
    - "beta": lower + 2 h B(p, q) with `beta=(p, q)`; no shift.
    - "rayleigh": a magnitude with scale s = upper/(3 cp); lower and shift are 0. Where the last axis of
      the field holds [radial, tangential], the vector of this magnitude and random direction, which is
      two independent N(0, s^2).

    `batch` correlates the elements of one field by a shared factor, z_j = sqrt(batch) z_0 +
    sqrt(1 - batch) e_j, as in parts made in one set-up; each component of a Rayleigh vector has a
    factor of its own, so that its direction stays random.
    """

    lower: Any = field("-", "lower limit, unit of the error")
    upper: Any = field("-", "upper limit, unit of the error")
    _: dataclasses.KW_ONLY
    distribution: str = text("law between the limits", default="normal")
    cp: Any = field("-", "process capability (normal, truncated_normal, rayleigh)", default=1.0, sign="positive")
    shift: Any = field("-", "mean or mode off the middle, in half-widths", default=0.0)
    beta: tuple[float, float] | None = text("shape (p, q) of the beta law", default=None)
    batch: float = text("correlation of the elements of one field, 0 to below 1", default=0.0)
    size: Any = field("m", "nominal size of the part, for grades", default=None, sign="positive")
    shape: tuple[int, ...] = text("shape of the error, () is a scalar", default=())
    vector: bool | None = text("last axis is [radial, tangential]; None: if its length is 2", default=None)

    @classmethod
    def symmetric(cls, half_width: Any, **options: Any) -> Self:
        """Limits on both sides alike.

        Args:
            half_width: of the limits, unit of the error.
            **options: as in `Tolerance`.
        """
        return cls(-half_width, half_width, **options)

    @classmethod
    def grade(cls, grade: str, size: Any, **options: Any) -> Self:
        """Limits +-IT/2 of an ISO 286 grade.

        Args:
            grade: such as "IT6".
            size: nominal, m.
            **options: as in `Tolerance`.
        """
        return cls.symmetric(it_width(grade, size) / 2, size=size, **options)

    @property
    def middle(self) -> Any:
        """Middle of the limits, unit of the error."""
        return (self.lower + self.upper) / 2

    @property
    def half_width(self) -> Any:
        """Half the distance of the limits, unit of the error."""
        return (self.upper - self.lower) / 2

    @property
    def is_vector(self) -> bool:
        """True for a Rayleigh field of vectors, False for one of magnitudes and for every other law."""
        last_is_pair = bool(self.shape) and self.shape[-1] == 2
        return self.distribution == "rayleigh" and (last_is_pair if self.vector is None else self.vector)

    def with_half_width(self, half_width: Any) -> Self:
        """The same law scaled about the middle of its limits (a Rayleigh law about 0); shift and cp stay."""
        if self.distribution == "rayleigh":
            return self.replace(upper=2 * half_width)
        return self.replace(lower=self.middle - half_width, upper=self.middle + half_width)

    def _check(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise _bad("distribution", self.distribution, f"unknown, choose from {', '.join(DISTRIBUTIONS)}")
        try:
            shape = tuple(map(operator.index, self.shape))
        except TypeError:
            raise _bad("shape", self.shape, "must be a tuple of sizes") from None
        if min(shape, default=0) < 0:
            raise _bad("shape", self.shape, "must be a tuple of sizes")
        object.__setattr__(self, "shape", shape)
        if not isinstance(self.batch, (int, float)) or not 0 <= self.batch < 1:
            raise _bad("batch", self.batch, "must be a number from 0 to below 1")
        self._check_beta()
        if concrete(self.lower, self.upper):
            self._check_limits()
        if concrete(self.shift):
            self._check_shift()
        if concrete(self.cp) and not math.isfinite(self.cp):
            raise _bad("cp", self.cp, "must be finite")
        if self.size is not None and concrete(self.size):
            it_width("IT6", self.size)

    def _check_limits(self) -> None:
        for name in ("lower", "upper"):
            if np.ndim(getattr(self, name)) or not math.isfinite(getattr(self, name)):
                raise _bad(name, getattr(self, name), "must be one finite number")
        if self.lower > self.upper:
            raise _bad("lower", self.lower, f"lies above upper = {self.upper:.6g}")
        if self.distribution == "rayleigh" and self.lower != 0:
            raise _bad("lower", self.lower, "must be 0 for rayleigh, a magnitude")

    def _check_shift(self) -> None:
        if not abs(self.shift) < 1:
            raise _bad("shift", self.shift, "must lie between -1 and 1, within the limits")
        if self.shift != 0 and self.distribution in ("uniform", "beta", "rayleigh"):
            raise _bad("shift", self.shift, f"must be 0 for {self.distribution}")

    def _check_beta(self) -> None:
        if (self.beta is None) == (self.distribution == "beta"):
            raise _bad("beta", self.beta, "give (p, q) with distribution='beta', and only there")
        if self.beta is not None:
            pair = tuple(float(number) for number in self.beta)
            if len(pair) != 2 or not all(0 < number < math.inf for number in pair):
                raise _bad("beta", self.beta, "must be two positive numbers (p, q)")
            object.__setattr__(self, "beta", pair)


def _bad(name: str, value: Any, reason: str) -> ValueError:
    shown = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return ValueError(f"Tolerance.{name} = {shown}: {reason}")


def deviate(tolerance: Tolerance, z: jax.Array) -> jax.Array:
    """The error that belongs to standard normal numbers z; elementwise, unit of the tolerance."""
    lower, middle, half = tolerance.lower, tolerance.middle, tolerance.half_width
    cp, shift = tolerance.cp, tolerance.shift
    match tolerance.distribution:
        case "normal":
            return middle + half * (shift + z / (3 * cp))
        case "truncated_normal":
            return middle + half * (shift + _truncated(z, -3 * cp * (1 + shift), 3 * cp * (1 - shift)) / (3 * cp))
        case "uniform":
            return middle + half * erf(z / math.sqrt(2))  # 2 Phi(z) - 1
        case "triangular":
            return lower + 2 * half * _triangular(z, (1 + shift) / 2)
        case "beta":
            assert tolerance.beta is not None
            return lower + 2 * half * _interpolate(z, *_beta_table(*tolerance.beta))
        case _:
            scale = tolerance.upper / (3 * cp)
            if tolerance.is_vector:
                return scale * z  # magnitude and random direction are two independent normal components
            return scale * jnp.sqrt(-2 * log_ndtr(-z))  # 1 - u = Phi(-z)


def _truncated(z: jax.Array, low: Any, high: Any) -> jax.Array:
    """Standard normal cut to [low, high]; the upper half is mirrored, where Phi keeps its digits."""
    upper = z > 0
    side, start, end = jnp.where(upper, -z, z), jnp.where(upper, -high, low), jnp.where(upper, -low, high)
    cut = ndtri(ndtr(start) + ndtr(side) * (ndtr(end) - ndtr(start)))
    return jnp.where(upper, -cut, cut)


def _triangular(z: jax.Array, mode: Any) -> jax.Array:
    below, above = ndtr(z), ndtr(-z)
    return jnp.where(below < mode, jnp.sqrt(below * mode), 1 - jnp.sqrt(above * (1 - mode)))


@functools.lru_cache(maxsize=32)
def _beta_table(p: float, q: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of the beta quantile at the nodes in z (JAX has no inverse incomplete beta function)."""
    below = special.betaincinv(p, q, special.ndtr(_NODES))
    above = 1 - special.betaincinv(q, p, special.ndtr(-_NODES))  # near 1 this side keeps the digits
    values = np.where(_NODES < 0, below, above)
    return values, np.gradient(values, _NODES, edge_order=2)


def _interpolate(z: jax.Array, values: np.ndarray, slopes: np.ndarray) -> jax.Array:
    """Cubic Hermite interpolation on the nodes, constant beyond them."""
    step = _NODES[1] - _NODES[0]
    position = (jnp.clip(z, _NODES[0], _NODES[-1]) - float(_NODES[0])) / float(step)
    left = jnp.clip(position.astype(int), 0, len(_NODES) - 2)
    s = position - left.astype(position.dtype)
    v, d = jnp.asarray(values, position.dtype), jnp.asarray(slopes * step, position.dtype)
    rise = v[left + 1] - v[left]
    curve = (d[left] - rise) * (1 - s) - (d[left + 1] - rise) * s
    return v[left] + s * (rise + (1 - s) * curve)


def central_moments(tolerance: Tolerance) -> tuple[float, float, float, float]:
    """Mean, variance, third and fourth central moment of one element; host floats of a concrete tolerance."""
    low, high, half, cp = (float(v) for v in (tolerance.lower, tolerance.upper, tolerance.half_width, tolerance.cp))
    mean, sigma = float(tolerance.middle) + float(tolerance.shift) * half, half / (3 * cp)
    match tolerance.distribution:
        case "normal":
            return mean, sigma**2, 0.0, 3 * sigma**4
        case "truncated_normal":
            shift = float(tolerance.shift)
            m, v, m3, m4 = _truncated_moments(-3 * cp * (1 + shift), 3 * cp * (1 - shift))
            return mean + sigma * m, sigma**2 * v, sigma**3 * m3, sigma**4 * m4
        case "uniform":
            return mean, half**2 / 3, 0.0, half**4 / 5
        case "triangular":
            variance = (low**2 + high**2 + mean**2 - low * high - low * mean - high * mean) / 18
            skew = (low + high - 2 * mean) * (2 * low - high - mean) * (low - 2 * high + mean) / 270
            return (low + high + mean) / 3, variance, skew, 2.4 * variance**2
        case "beta":
            assert tolerance.beta is not None
            m, v, m3, m4 = _beta_moments(*tolerance.beta)
            return low + 2 * half * m, (2 * half) ** 2 * v, (2 * half) ** 3 * m3, (2 * half) ** 4 * m4
        case _:
            scale = high / (3 * cp)
            if tolerance.is_vector:
                return 0.0, scale**2, 0.0, 3 * scale**4
            raw = (scale**k * 2 ** (k / 2) * math.gamma(1 + k / 2) for k in (1, 2, 3, 4))
            return _central(*raw)


def _central(m1: float, m2: float, m3: float, m4: float) -> tuple[float, float, float, float]:
    """Raw moments to mean and central moments."""
    return m1, m2 - m1**2, m3 - 3 * m1 * m2 + 2 * m1**3, m4 - 4 * m1 * m3 + 6 * m1**2 * m2 - 3 * m1**4


def _truncated_moments(a: float, b: float) -> tuple[float, float, float, float]:
    """Of the standard normal cut to [a, b]: M_k = (k-1) M_{k-2} + (a^(k-1) phi(a) - b^(k-1) phi(b))/Z."""
    mass = float(special.ndtr(b) - special.ndtr(a))
    at_a, at_b = (math.exp(-(x**2) / 2) / math.sqrt(2 * math.pi) / mass for x in (a, b))
    raw = [1.0, at_a - at_b]
    for k in (2, 3, 4):
        raw.append((k - 1) * raw[k - 2] + a ** (k - 1) * at_a - b ** (k - 1) * at_b)
    return _central(*raw[1:])


def _beta_moments(p: float, q: float) -> tuple[float, float, float, float]:
    raw, product = [], 1.0
    for k in range(4):
        product *= (p + k) / (p + q + k)
        raw.append(product)
    return _central(*raw)
