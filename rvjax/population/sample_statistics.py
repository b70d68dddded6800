"""Statistics of one response over the units of a run, with their errors.

Central moments that can be merged: what a run keeps of any number of values.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from rvjax.population.estimates import Estimate, deviate_of, of_groups, share_estimate, skewed, wilson


@dataclasses.dataclass
class CentralMoments:
    """Count, mean and sums of central powers 2..6, extremes; combined pairwise without loss (Pebay 2008)."""

    n: int = 0
    mean: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    s5: float = 0.0
    s6: float = 0.0
    minimum: float = math.nan
    maximum: float = math.nan

    @classmethod
    def of(cls, values: np.ndarray) -> "CentralMoments":
        """Moments of one block."""
        if not values.size:
            return cls()
        centred = values - values[0]  # equal values give exactly zero spread
        offset = float(centred.mean())
        centred -= offset
        power, sums = centred, []
        with np.errstate(over="ignore", invalid="ignore"):  # the sixth power of 1e60 is infinite
            for _ in range(2, 7):
                power = power * centred
                sums.append(float(power.sum()))  # not `@`: BLAS threads would fight with the device for the cores
        s2, s3, s4, s5, s6 = sums
        mean, least, most = float(values[0]) + offset, float(values.min()), float(values.max())
        return cls(values.size, mean, s2, s3, s4, s5, s6, least, most)

    @property
    def sums(self) -> tuple[float, ...]:
        """Sums of the central powers 0..6."""
        return float(self.n), 0.0, self.s2, self.s3, self.s4, self.s5, self.s6

    def merge(self, b: "CentralMoments") -> "CentralMoments":
        """Moments of both blocks together."""
        if not b.n or not self.n:
            return b if b.n else self
        n, d = self.n + b.n, b.mean - self.mean
        mean = self.mean + d * b.n / n
        ours, theirs = -d * b.n / n, d * self.n / n  # of the blocks' own means from the common one
        x, y = self.sums, b.sums
        s2, s3, s4, s5, s6 = (
            sum(math.comb(p, k) * (_power(ours, k) * x[p - k] + _power(theirs, k) * y[p - k]) for k in range(p + 1))
            for p in range(2, 7)
        )
        least, most = min(self.minimum, b.minimum), max(self.maximum, b.maximum)
        return CentralMoments(n, mean, s2, s3, s4, s5, s6, least, most)

    @property
    def sd(self) -> float:
        """Sample standard deviation; nan for fewer than two values."""
        return math.sqrt(self.s2 / (self.n - 1)) if self.n > 1 else math.nan

    @property
    def mean_or_nan(self) -> float:
        """The mean; nan without values."""
        return self.mean if self.n else math.nan

    def mean_estimate(self, confidence: float) -> Estimate:
        """Return the mean; its error sd/sqrt(n)."""
        error = self.sd / math.sqrt(self.n) if self.n else math.nan
        skewness = math.sqrt(self.n) * (self.s3 / self.s2) / math.sqrt(self.s2) if self.s2 > 0 else 0.0
        skewness = skewness if math.isfinite(skewness) else 0.0
        return skewed(self.mean_or_nan, error, skewness, self.n, deviate_of(confidence))

    def sd_estimate(self, confidence: float) -> Estimate:
        """The standard deviation; its error holds for any distribution, its interval is that of the mean square."""
        sd, n = self.sd, self.n
        if n < 2:
            return Estimate.about(math.nan, math.nan, 0.0)
        if not (m2 := self.s2 / n) > 0:
            return Estimate(sd, 0.0, sd, sd)
        # Over the powers of the mean square; a sum that no number holds: of a normal distribution.
        m4, m6 = (s / n / m2 / m2 for s in (self.s4, self.s6 / m2))
        m4, m6 = (own if math.isfinite(own) else normal for own, normal in ((m4, 3.0), (m6, 15.0)))
        spread = math.sqrt(max(0.0, m4 - (n - 3) / (n - 1)) / n)
        if not spread > 0:
            return Estimate(sd, 0.0, sd, sd)
        skewness = (m6 - 3 * m4 + 2) / max(m4 - 1, spread**2) ** 1.5  # of the squares, whose mean is 1
        square = skewed(n / (n - 1), spread, skewness, n, deviate_of(confidence))
        low, high = (math.sqrt(max(0.0, end)) for end in (square.lower, square.upper))
        rms = math.sqrt(m2)
        return Estimate(sd, spread * m2 / (2 * sd), low * rms, high * rms)


def _power(x: float, k: int) -> float:
    """x^k; infinite where no number holds it."""
    try:
        return x**k
    except OverflowError:
        return math.inf


class Pairwise:
    """Moments of a row of blocks, merged in pairs of neighbours, then pairs of pairs.

    The tree depends on the numbers of the blocks only: the sum is bit-identical for any order of the
    blocks and any number of processes. It holds one node for each bit of the count
    while the blocks come in order.
    """

    def __init__(self) -> None:
        self._nodes: dict[tuple[int, int], CentralMoments] = {}

    def add(self, place: int, block: CentralMoments, level: int = 0) -> None:
        """Take in the block of number `place`, or the node `place` of a higher level."""
        while (level, place ^ 1) in self._nodes:
            other = self._nodes.pop((level, place ^ 1))
            block = other.merge(block) if place & 1 else block.merge(other)
            level, place = level + 1, place >> 1
        self._nodes[level, place] = block

    def total(self) -> CentralMoments:
        """Moments of all blocks."""
        whole = CentralMoments()
        for _, node in sorted(self._nodes.items(), key=lambda item: item[0][1] << item[0][0]):
            whole = whole.merge(node)
        return whole

    def state(self) -> np.ndarray:
        """Nodes as rows of level, place and moments."""
        rows = [[level, place, *dataclasses.astuple(node)] for (level, place), node in self._nodes.items()]
        return np.array(rows, float).reshape(len(rows), 2 + len(dataclasses.fields(CentralMoments)))

    def merge(self, state: np.ndarray) -> None:
        """Take in the nodes of another row's `state`."""
        for level, place, n, *figures in state.tolist():
            self.add(int(place), CentralMoments(int(n), *figures), int(level))


class Capable(Protocol):
    """Limits of one response."""

    def capability(self, mean: float, sd: float) -> tuple[float, float]:
        """Cp and Cpk."""

    def outward(self, value: float) -> float:
        """+1 where the margin falls with the value, -1 where it grows."""


@dataclasses.dataclass(frozen=True)
class Sampled:
    """Moments and counts by stream: one stream of independent units, or several scrambles.

    Attributes:
        streams: moments of each.
        passed: (streams,) units within the limits; None without any.
        seen: (streams,) units.
        confidence: of every interval.
        extremes: smallest and largest response within the limits of all errors, nan where it fails there; not sampled,
            and computed only where a requirement needs it.
    """

    streams: list[CentralMoments]
    passed: np.ndarray | None
    seen: np.ndarray
    confidence: float
    extremes: tuple[float, float] = (math.nan, math.nan)

    @functools.cached_property
    def whole(self) -> CentralMoments:
        """Moments of all units."""
        return functools.reduce(CentralMoments.merge, self.streams)

    def _figure(self, of: Callable[[CentralMoments], float], alone: Callable[[CentralMoments], Estimate]) -> Estimate:
        if len(self.streams) == 1:
            return alone(self.whole)
        # Contribution of each scramble to the statistic (jackknife): no bias of small groups where it is no mean.
        filled, value = [part for part in self.streams if part.n], of(self.whole)
        count, none = len(filled), CentralMoments()
        before = itertools.accumulate(filled, CentralMoments.merge, initial=none)
        after = [*itertools.accumulate(filled[:0:-1], CentralMoments.merge, initial=none)][::-1]
        others = [head.merge(tail) for head, tail in zip(before, after)]
        figures = np.array([count * value - (count - 1) * of(rest) for rest in others])
        return of_groups(figures, value, self.confidence)

    def mean(self) -> Estimate:
        """Return the mean."""
        return self._figure(lambda m: m.mean_or_nan, lambda m: m.mean_estimate(self.confidence))

    def sd(self) -> Estimate:
        """Return the standard deviation."""
        return self._figure(lambda m: m.sd, lambda m: m.sd_estimate(self.confidence))

    def _capability(self, limits: Capable, place: int, spread: Callable[[float, CentralMoments], Estimate]) -> Estimate:
        """Number `place` of the capabilities; `spread` gives the estimate of a finite one of independent units."""

        def of(m: CentralMoments) -> float:
            return limits.capability(m.mean, m.sd)[place] if m.n > 1 else math.nan

        def alone(m: CentralMoments) -> Estimate:
            value = of(m)
            if not math.isfinite(value):  # one limit, no spread, or no two units
                return Estimate(value, 0.0 if math.isinf(value) else math.nan, value, value)
            return spread(value, m)

        return self._figure(of, alone)

    def cp(self, limits: Capable) -> Estimate:
        """Cp = (U - L)/(6 sd) of two limits; its ends are those of the sd."""

        def spread(value: float, m: CentralMoments) -> Estimate:
            sd = m.sd_estimate(self.confidence)
            upper = value * sd.value / sd.lower if sd.lower > 0 else math.inf
            return Estimate(value, value * sd.error / sd.value, value * sd.value / sd.upper, upper)

        return self._capability(limits, 0, spread)

    def cpk(self, limits: Capable) -> Estimate:
        """Cpk = margin/(3 sd) of limits."""

        def spread(value: float, m: CentralMoments) -> Estimate:
            # d Cpk = (-o dm - 3 Cpk ds)/(3 s), with var m = m2/n, var s of any distribution, cov(m, s) = m3/(2 s n).
            s, sd_error = m.sd, m.sd_estimate(self.confidence).error
            o = float(limits.outward(m.mean))  # +1 where the margin falls with the mean, -1 where it grows
            variance = s**2 / m.n + (3 * value * sd_error) ** 2 + 2 * o * 3 * value * m.s3 / m.n / (2 * s * m.n)
            error = math.sqrt(max(0.0, variance)) / (3 * s)
            return Estimate.about(value, error, deviate_of(self.confidence))

        return self._capability(limits, 1, spread)

    def failed(self) -> Estimate:
        """Return the share of units that moments exclude: failed ones, and those whose response is infinite."""
        return self.share(self.seen - np.array([part.n for part in self.streams]))

    def share(self, passed: np.ndarray | None = None) -> Estimate:
        """Return the share of units within the limits, or of others that are counted."""
        hits = self.passed if passed is None else passed
        assert hits is not None
        if len(self.seen) == 1:
            return wilson(int(hits[0]), int(self.seen[0]), self.confidence)
        return share_estimate(hits, self.seen, self.confidence)
