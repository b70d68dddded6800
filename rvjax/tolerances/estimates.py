"""Figures with their uncertainty: estimates and intervals, mergeable moments, quantiles in constant memory."""

import dataclasses
import math

import numpy as np
from scipy import special

PILOT = 4096
BINS = 2**16


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A sampled figure.

    Attributes:
        value: the figure.
        error: its standard error.
        lower: lower end of its confidence interval.
        upper: upper end.
    """

    value: float
    error: float
    lower: float
    upper: float


def deviate_of(confidence: float) -> float:
    """Normal deviate of a two-sided confidence, 1.96 for 0.95."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence!r}: must lie between 0 and 1")
    return float(special.ndtri((1 + confidence) / 2))


def wilson(successes: int, samples: int, confidence: float) -> Estimate:
    """A share with the score interval of Wilson (1927), which holds at 0 and 1 too."""
    z, n = deviate_of(confidence), samples
    share = successes / n
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    lower = 0.0 if successes == 0 else max(0.0, centre - half)
    upper = 1.0 if successes == n else min(1.0, centre + half)
    return Estimate(share, math.sqrt(share * (1 - share) / n), lower, upper)


@dataclasses.dataclass
class Moments4:
    """Count, mean and sums of central powers 2..4, extremes; combined pairwise without loss (Pebay 2008)."""

    n: int = 0
    mean: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    minimum: float = math.nan
    maximum: float = math.nan

    @classmethod
    def of(cls, values: np.ndarray) -> "Moments4":
        """Moments of one block."""
        if not values.size:
            return cls()
        centred = values - values[0]  # equal values give exactly zero spread
        offset = float(centred.mean())
        centred -= offset
        squares = centred * centred
        # Not `@`: BLAS threads would fight with the device for the cores.
        sums = float(squares.sum()), float((squares * centred).sum()), float((squares * squares).sum())
        return cls(values.size, float(values[0]) + offset, *sums, float(values.min()), float(values.max()))

    def merge(self, b: "Moments4") -> "Moments4":
        """Moments of both blocks together."""
        if not b.n or not self.n:
            return b if b.n else self
        na, nb, n = self.n, b.n, self.n + b.n
        d = b.mean - self.mean
        s2 = self.s2 + b.s2 + d**2 * na * nb / n
        s3 = self.s3 + b.s3 + d**3 * na * nb * (na - nb) / n**2 + 3 * d * (na * b.s2 - nb * self.s2) / n
        s4 = self.s4 + b.s4 + d**4 * na * nb * (na**2 - na * nb + nb**2) / n**3
        s4 += 6 * d**2 * (na**2 * b.s2 + nb**2 * self.s2) / n**2 + 4 * d * (na * b.s3 - nb * self.s3) / n
        extremes = min(self.minimum, b.minimum), max(self.maximum, b.maximum)
        return Moments4(n, self.mean + d * nb / n, s2, s3, s4, *extremes)

    @property
    def sd(self) -> float:
        """Sample standard deviation; nan for fewer than two values."""
        return math.sqrt(self.s2 / (self.n - 1)) if self.n > 1 else math.nan

    def mean_estimate(self, confidence: float) -> Estimate:
        """The mean; its error sd/sqrt(n)."""
        if not self.n:
            return Estimate(math.nan, math.nan, math.nan, math.nan)
        error = self.sd / math.sqrt(self.n)
        half = deviate_of(confidence) * error
        return Estimate(self.mean, error, self.mean - half, self.mean + half)

    def sd_estimate(self, confidence: float) -> Estimate:
        """The standard deviation; its error holds for any law, from the fourth moment."""
        sd, n = self.sd, self.n
        if n < 2:
            return Estimate(math.nan, math.nan, math.nan, math.nan)
        m2, m4 = self.s2 / n, self.s4 / n
        spread = math.sqrt(max(0.0, m4 - m2**2 * (n - 3) / (n - 1)) / n)
        error = spread / (2 * sd) if sd > 0 else 0.0
        half = deviate_of(confidence) * error
        return Estimate(sd, error, max(0.0, sd - half), sd + half)


class Order:
    """Order statistics: exact up to `PILOT` values, then from a histogram, within one of its bins.

    The range comes from the first `PILOT` values, whatever the chunks they arrive in, and is half
    their span wider on each side; what falls outside is counted apart.
    """

    def __init__(self) -> None:
        self._first: list[np.ndarray] = []
        self._waiting = 0
        self._counts = np.zeros(BINS, np.int64)
        self._low, self._width = math.nan, math.nan
        self._below = self._above = self.n = 0
        self.minimum, self.maximum = math.inf, -math.inf

    def add(self, values: np.ndarray) -> None:
        """Take in one block of finite values."""
        if not values.size:
            return
        self.n += values.size
        self.minimum, self.maximum = min(self.minimum, values.min()), max(self.maximum, values.max())
        if math.isnan(self._low):
            self._first.append(values)
            self._waiting += values.size
            if self._waiting >= PILOT:
                block = np.concatenate(self._first)
                self._set_range(block[:PILOT])
                self._first = []
                self._count(block)
        else:
            self._count(values)

    def _set_range(self, pilot: np.ndarray) -> None:
        low, high = float(pilot.min()), float(pilot.max())
        margin = (high - low) / 2 or max(abs(low), 1e-300) * 1e-9
        self._low, self._width = low - margin, (high - low + 2 * margin) / BINS

    def _count(self, values: np.ndarray) -> None:
        place = np.floor((values - self._low) / self._width)
        below, above = place < 0, place >= BINS
        self._below += int(below.sum())
        self._above += int(above.sum())
        self._counts += np.bincount(place[~(below | above)].astype(np.int64), minlength=BINS)

    def at(self, rank: float) -> float:
        """The value of a (fractional) rank, 1 .. n."""
        if math.isnan(self._low):
            return _interpolated(np.sort(np.concatenate(self._first)), rank)
        k = min(max(int(rank), 1), self.n)
        low = self._at(k)
        return low + (self._at(min(k + 1, self.n)) - low) * min(max(rank - k, 0.0), 1.0)

    def _at(self, k: int) -> float:
        """Order statistic k, 1 .. n; spread evenly over the bin or tail it falls into."""
        inside = np.cumsum(self._counts) + self._below
        if k <= self._below:
            return float(np.interp(k, [1, self._below + 1], [self.minimum, self._low]))
        if k > inside[-1]:
            return float(np.interp(k, [inside[-1], self.n], [self._low + BINS * self._width, self.maximum]))
        place = int(np.searchsorted(inside, k))
        share = (k - (inside[place] - self._counts[place]) - 0.5) / self._counts[place]
        return float(np.clip(self._low + self._width * (place + share), self.minimum, self.maximum))


class ExactOrder:
    """Order statistics of values that are all kept."""

    def __init__(self, values: np.ndarray) -> None:
        self._sorted = np.sort(values)
        self.n = values.size

    def at(self, rank: float) -> float:
        """The value of a (fractional) rank, 1 .. n."""
        return _interpolated(self._sorted, rank)


def _interpolated(ordered: np.ndarray, rank: float) -> float:
    k = min(max(int(rank), 1), ordered.size)
    low, high = float(ordered[k - 1]), float(ordered[min(k, ordered.size - 1)])
    return low + (high - low) * min(max(rank - k, 0.0), 1.0)


def quantile_estimate(order: Order | ExactOrder, p: float, confidence: float) -> Estimate:
    """The p-quantile, linear between order statistics, with the distribution-free binomial interval.

    Where the sample is too small to bound the quantile, that end of the interval is infinite.
    """
    n = order.n
    if not n:
        return Estimate(math.nan, math.nan, math.nan, math.nan)
    first, last = _binomial_quantile((1 - confidence) / 2, n, p), _binomial_quantile((1 + confidence) / 2, n, p) + 1
    lower = order.at(first) if first >= 1 else -math.inf
    upper = order.at(last) if last <= n else math.inf
    return Estimate(order.at(1 + (n - 1) * p), (upper - lower) / (2 * deviate_of(confidence)), lower, upper)


def _binomial_quantile(share: float, n: int, p: float) -> int:
    """Smallest k with P(B <= k) >= share, B ~ binomial(n, p)."""
    low, high = -1, n  # P(B <= low) < share <= P(B <= high)
    while high - low > 1:
        k = (low + high) // 2
        low, high = (low, k) if special.bdtr(k, n, p) >= share else (k, high)
    return high
