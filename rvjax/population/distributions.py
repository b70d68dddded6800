"""The distributions of tolerance stacks, from normal to Rayleigh, and an error that follows measured values."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf, log_ndtr, ndtr, ndtri
from scipy import special

from rvjax.base.columns import read_table
from rvjax.population.tolerance import Distribution, Moments, Tolerance, bad
from rvjax.records import IN_ERROR_UNIT, Array, Scalar, concrete, field, is_concrete, record, text
from rvjax.units import KNOWN, recognised, unknown_unit

NODES = np.linspace(-9.0, 9.0, 8193)
"""z of a table's values."""


@record
class Normal(Distribution):
    """N(m + shift h, sigma^2) with sigma = h/(3 cp), not cut at the limits."""

    name = "normal"
    shifts = True

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """m + h (shift + z/(3 cp))."""
        return tolerance.middle + tolerance.half_width * (tolerance.shift + z / (3 * tolerance.cp))

    def moments(self, tolerance: Tolerance) -> Moments:
        """Mean m + shift h, variance sigma^2, 0, 3 sigma^4."""
        sigma = 1 / (3 * float(tolerance.cp))
        return stretch((float(tolerance.shift), sigma**2, 0.0, 3 * sigma**4), *_placement(tolerance))

    def is_normal(self, tolerance: Tolerance) -> bool:
        """Always."""
        return True


@record
class TruncatedNormal(Distribution):
    """The normal distribution cut at the limits and renormalised."""

    name = "truncated_normal"
    shifts = True

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """Return the upper half is mirrored, where Phi keeps its digits."""
        cp, shift = tolerance.cp, tolerance.shift
        low, high, upper = -3 * cp * (1 + shift), 3 * cp * (1 - shift), z > 0
        side, start, end = jnp.where(upper, -z, z), jnp.where(upper, -high, low), jnp.where(upper, -low, high)
        cut = ndtri(ndtr(start) + ndtr(side) * (ndtr(end) - ndtr(start)))
        return tolerance.middle + tolerance.half_width * (shift + jnp.where(upper, -cut, cut) / (3 * cp))

    def moments(self, tolerance: Tolerance) -> Moments:
        """Moments of the standard normal cut to [a, b]: M_k = (k-1) M_{k-2} + (a^(k-1) phi(a) - b^(k-1) phi(b))/Z."""
        cp, shift = float(tolerance.cp), float(tolerance.shift)
        a, b = -3 * cp * (1 + shift), 3 * cp * (1 - shift)
        mass = float(special.ndtr(b) - special.ndtr(a))
        at_a, at_b = (math.exp(-(x**2) / 2) / math.sqrt(2 * math.pi) / mass for x in (a, b))
        raw = [1.0, at_a - at_b]
        for k in (2, 3, 4):
            raw.append((k - 1) * raw[k - 2] + a ** (k - 1) * at_a - b ** (k - 1) * at_b)
        middle, half = _placement(tolerance)
        return stretch(central(*raw[1:]), middle + shift * half, half / (3 * cp))


@record
class Lognormal(Distribution):
    """lower + 2 h exp(log_sd (z - 3 cp)), so that P(e > upper) = Phi(-3 cp) as for a centred normal distribution."""

    name = "lognormal"
    log_sd: Scalar = field("-", "the standard deviation of the logarithm of the error above `lower`", sign="positive")

    def _check(self) -> None:
        if concrete(self.log_sd) and np.any(np.greater(self.log_sd, 9)):  # fourth moment: exp(8 log_sd^2)
            raise bad("log_sd", self.log_sd, "must be at most 9: beyond, its moments exceed every float")

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """Return the upper limit lies at z = 3 cp."""
        return tolerance.lower + 2 * tolerance.half_width * jnp.exp(self.log_sd * (z - 3 * tolerance.cp))

    def moments(self, tolerance: Tolerance) -> Moments:
        """E exp(k s z) = exp(k^2 s^2/2)."""
        s, cp = float(self.log_sd), float(tolerance.cp)
        w = math.expm1(s**2)  # central moments from w: differences of raw ones lose all digits of a small s
        mean = math.exp(s**2 / 2)
        third = mean**3 * w**2 * (w + 3)
        q = 1 + w
        fourth = mean**4 * w**2 * (q**4 + 2 * q**3 + 3 * q**2 - 3)
        scale = 2 * float(tolerance.half_width) * math.exp(-3 * cp * s)
        return stretch((mean, mean**2 * w, third, fourth), float(tolerance.lower), scale)

    def scaled(self, tolerance: Tolerance, half_width: Scalar) -> dict[str, Scalar]:
        """About the lower limit, which is a bound of nature."""
        return dict(upper=tolerance.lower + 2 * half_width)


@record
class Uniform(Distribution):
    """Uniform distribution between the limits."""

    name = "uniform"
    capable = False

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """m + h (2 Phi(z) - 1)."""
        return tolerance.middle + tolerance.half_width * erf(z / math.sqrt(2))

    def moments(self, tolerance: Tolerance) -> Moments:
        """m, h^2/3, 0, h^4/5."""
        return stretch((0.0, 1 / 3, 0.0, 1 / 5), *_placement(tolerance))


@record
class Triangular(Distribution):
    """A triangle between the limits with its mode at m + shift h."""

    name = "triangular"
    capable = False
    shifts = True

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """Return the quantile from the nearer end, where Phi keeps its digits."""
        mode, below, above = (1 + tolerance.shift) / 2, ndtr(z), ndtr(-z)
        share = jnp.where(below < mode, jnp.sqrt(below * mode), 1 - jnp.sqrt(above * (1 - mode)))
        return tolerance.lower + 2 * tolerance.half_width * share

    def moments(self, tolerance: Tolerance) -> Moments:
        """Moments of the triangle over -1 .. 1 with mode c: c/3, (3 + c^2)/18, c (c^2 - 9)/135, 2.4 v^2."""
        c = float(tolerance.shift)
        variance = (3 + c**2) / 18
        return stretch((c / 3, variance, c * (c**2 - 9) / 135, 2.4 * variance**2), *_placement(tolerance))


@record
class Beta(Distribution):
    """lower + 2 h B(p, q)."""

    name = "beta"
    capable = False
    beta: tuple[float, float] = text("(p, q)")

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """Deviate from a table of the quantile: JAX has no inverse incomplete beta function."""
        return tolerance.lower + 2 * tolerance.half_width * interpolate(z, *_beta_table(*self.beta))

    def moments(self, tolerance: Tolerance) -> Moments:
        """Central moments of B(p, q) in closed form: differences of raw ones lose all digits where it is narrow."""
        p, q = self.beta
        total = p + q
        mean, below, skew = p / total, q / total, (q - p) / total
        variance = mean * below / (total + 1)
        third = 2 * variance * skew / (total + 2)
        fourth = 3 * variance * (2 + mean * below * (total - 6)) / ((total + 2) * (total + 3))
        moments = mean, variance, third, fourth
        return stretch(moments, float(tolerance.lower), 2 * float(tolerance.half_width))

    def _check(self) -> None:
        try:
            pair = tuple(float(number) for number in self.beta)
        except (TypeError, ValueError):
            pair = ()
        if len(pair) != 2 or not all(0 < number < math.inf for number in pair):
            raise bad("beta", self.beta, "must be two positive numbers (p, q)")
        object.__setattr__(self, "beta", pair)


@functools.lru_cache(maxsize=32)
def _beta_table(p: float, q: float) -> tuple[np.ndarray, np.ndarray]:
    below = special.betaincinv(p, q, special.ndtr(NODES))
    above = 1 - special.betaincinv(q, p, special.ndtr(-NODES))  # near 1 this side keeps the digits
    values = np.where(NODES < 0, below, above)
    return values, np.gradient(values, NODES, edge_order=2)


@record
class Rayleigh(Distribution):
    """A magnitude with scale s = upper/(3 cp), or the vector of this magnitude and a random direction."""

    name = "rayleigh"
    of_vectors = True

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """s sqrt(-2 ln(1 - u)); a vector is two independent N(0, s^2)."""
        scale = tolerance.upper / (3 * tolerance.cp)
        if tolerance.is_vector:
            return scale * z
        return scale * jnp.sqrt(-2 * log_ndtr(-z))  # 1 - u = Phi(-z)

    def moments(self, tolerance: Tolerance) -> Moments:
        """Moments of the magnitude, or of one component."""
        scale = float(tolerance.upper) / (3 * float(tolerance.cp))
        if tolerance.is_vector:
            return 0.0, scale**2, 0.0, 3 * scale**4
        return central(*raw_rayleigh(scale))

    def is_normal(self, tolerance: Tolerance) -> bool:
        """Return the components of a vector are."""
        return tolerance.is_vector

    def scaled(self, tolerance: Tolerance, half_width: Scalar) -> dict[str, Scalar]:
        """About 0."""
        return dict(upper=2 * half_width)

    def check(self, tolerance: Tolerance) -> None:
        """A magnitude begins at 0."""
        if concrete(tolerance.lower) and tolerance.lower != 0:
            raise bad("lower", tolerance.lower, f"must be 0 for {self.name}, a magnitude")


def _placement(tolerance: Tolerance) -> tuple[float, float]:
    return float(tolerance.middle), float(tolerance.half_width)


def central(m1: float, m2: float, m3: float, m4: float) -> Moments:
    """Raw moments to mean and central moments."""
    return m1, m2 - m1**2, m3 - 3 * m1 * m2 + 2 * m1**3, m4 - 4 * m1 * m3 + 6 * m1**2 * m2 - 3 * m1**4


def stretch(moments: Moments, origin: float, scale: float) -> Moments:
    """Moments of origin + scale x from those of x."""
    mean, variance, third, fourth = moments
    return origin + scale * mean, scale**2 * variance, scale**3 * third, scale**4 * fourth


def raw_rayleigh(scale: float) -> list[float]:
    """Raw moments 1 .. 4 of a magnitude with this scale: s^k 2^(k/2) Gamma(1 + k/2)."""
    return [scale**k * 2 ** (k / 2) * math.gamma(1 + k / 2) for k in (1, 2, 3, 4)]


def interpolate(z: jax.Array, values: np.ndarray, slopes: np.ndarray) -> jax.Array:
    """The function with these values and derivatives to z at `NODES`, at z of any shape; constant beyond them."""
    first, last, step = float(NODES[0]), float(NODES[-1]), float(NODES[1] - NODES[0])
    position = (jnp.clip(z, first, last) - first) / step
    left = jnp.clip(position.astype(int), 0, len(NODES) - 2)
    s = position - left.astype(position.dtype)
    v, d = jnp.asarray(values, position.dtype), jnp.asarray(slopes * step, position.dtype)
    rise = v[left + 1] - v[left]
    curve = (d[left] - rise) * (1 - s) - (d[left + 1] - rise) * s
    return v[left] + s * (rise + (1 - s) * curve)


def step_of(values: np.ndarray, digit: float) -> float:
    """Step of an instrument: one unit of the last digit, or the least difference of readings that mostly repeat.

    Args:
        values: readings.
        digit: one unit of the last digit that is written, unit of the readings.
    """
    distinct = np.unique(values)
    repeat = 2 <= len(distinct) <= len(values) / 2
    return max(digit, float(np.diff(distinct).min())) if repeat else digit


def in_steps(values: np.ndarray, step: float) -> np.ndarray:
    """Readings of an instrument too coarse for their spread: equal ones evenly over the step that they were rounded to.

    Readings whose sd is a step or more stay: rounding adds less than 4 % to it. n equal ones would have no spread at
    all, and no half-width any effect.

    Args:
        values: readings (n,).
        step: of the instrument.
    """
    counts = np.unique(values, return_counts=True)[1]
    if len(counts) == len(values) or values.std(ddof=1) >= step:
        return values
    places = np.concatenate([(np.arange(n) + 0.5) / n - 0.5 for n in counts])
    return np.sort(values) + step * places


@record
class Empirical(Distribution):
    """Measured values: the k-th of n is the quantile (k - 1/2)/n, linear between them (Hazen 1914).

    The values need not keep within the limits. Another half-width scales them about the mid-point of the limits.
    In a study file, `values` is a list of texts with units, or {file = "...", column = "...", unit = "..."}; no unit is
    needed where the header of the column gives it.
    """

    name = "empirical"
    capable = False
    values: Array | np.ndarray = field(IN_ERROR_UNIT, "the measured values", shape=("parts",))

    def deviate(self, tolerance: Tolerance, z: jax.Array) -> Scalar:
        """Order statistics at n Phi(z) + 1/2."""
        values = jnp.asarray(self.values, jnp.result_type(z))
        n = len(values)
        position = jnp.clip(n * ndtr(z) - 0.5, 0.0, n - 1.0)
        left = jnp.clip(position.astype(int), 0, max(n - 2, 0))
        low, high = values[left], values[jnp.minimum(left + 1, n - 1)]
        return low + (position - left.astype(position.dtype)) * (high - low)

    def moments(self, tolerance: Tolerance) -> Moments:
        """Exact moments of the distribution as sampled: the mean is that of the data.

        A piece from a to b holds 1/n of the parts with the central moments sum_i a^i b^(k-i)/(k+1), the ends 1/(2n).
        """
        values = np.asarray(self.values, float)
        mean = float(values.mean())
        x = values - mean
        a, b, n = x[:-1], x[1:], len(x)
        found = [mean]
        for k in (2, 3, 4):
            pieces = sum(a**i * b ** (k - i) for i in range(k + 1)) / (k + 1)
            found.append(float(np.sum(pieces) + (x[0] ** k + x[-1] ** k) / 2) / n)
        return found[0], found[1], found[2], found[3]

    def scaled(self, tolerance: Tolerance, half_width: Scalar) -> dict[str, Scalar]:
        """Limits and values about the mid-point of the limits."""
        old = tolerance.half_width
        if is_concrete(old) and old == 0:
            raise bad("half_width", 0.0, "measured values with limits of no width cannot be scaled")
        values = tolerance.middle + (self.values - tolerance.middle) * (half_width / old)
        return super().scaled(tolerance, half_width) | dict(values=values)

    def _check(self) -> None:
        if not concrete(self.values):
            return
        values = np.asarray(self.values)
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise bad("values", self.values, "must be one row of finite numbers")
        object.__setattr__(self, "values", np.sort(values))

    @classmethod
    def parsed(cls, key: str, value: object, unit: str) -> object:
        """Values from a list, or from a column of a CSV file, whose header may contain the unit."""
        if not isinstance(value, dict):
            if not isinstance(value, list):
                raise ValueError(f"{key} = {value!r}: must be a list, or a table of file, column and unit")
            return super().parsed(key, value, unit)
        if not {"file", "column"} <= set(value) <= {"file", "column", "unit", "encoding"} or not all(
            isinstance(item, str) for item in value.values()
        ):
            raise ValueError(f"{key}: give file, column and unit as texts, not {', '.join(value)}")
        units = {"-": 1.0} if unit == "-" else KNOWN[unit]
        if "unit" in value and recognised(value["unit"], units) is None:
            raise unknown_unit(f"{key}.unit = {value['unit']!r}", value["unit"], units, ": is not one of")
        column = {name: value[name] for name in ("column", "unit") if name in value}
        try:
            read = read_table(value["file"], {key: column}, units={key: units}, encoding=value.get("encoding"))
        except OSError as error:
            raise ValueError(f"{key}.file = {value['file']!r}: cannot be read ({error})") from None
        values = read.numbers[key][~np.isnan(read.numbers[key])]  # an empty cell is a part that was not measured
        return in_steps(values, step_of(values, read.digits[key])) if len(values) else values
