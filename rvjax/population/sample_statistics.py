"""Statistics of one response over the units of a run, with their errors."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from rvjax.population.central_moments import CentralMoments
from rvjax.population.estimates import Estimate, deviate_of, of_groups, share_estimate, wilson


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

    def cp(self, limits: Capable) -> Estimate:
        """Cp = (U - L)/(6 sd) of two limits; its ends are those of the sd."""

        def of(m: CentralMoments) -> float:
            return limits.capability(m.mean, m.sd)[0] if m.n > 1 else math.nan

        def alone(m: CentralMoments) -> Estimate:
            value, sd = of(m), m.sd_estimate(self.confidence)
            if not math.isfinite(value):  # one limit, no spread, or no two units
                return Estimate(value, 0.0 if math.isinf(value) else math.nan, value, value)
            upper = value * sd.value / sd.lower if sd.lower > 0 else math.inf
            return Estimate(value, value * sd.error / sd.value, value * sd.value / sd.upper, upper)

        return self._figure(of, alone)

    def cpk(self, limits: Capable) -> Estimate:
        """Cpk = margin/(3 sd) of limits."""

        def of(m: CentralMoments) -> float:
            return limits.capability(m.mean, m.sd)[1] if m.n > 1 else math.nan

        def alone(m: CentralMoments) -> Estimate:
            value = of(m)
            if not math.isfinite(value):  # no spread, or no two units
                return Estimate(value, 0.0 if math.isinf(value) else math.nan, value, value)
            # d Cpk = (-o dm - 3 Cpk ds)/(3 s), with var m = m2/n, var s of any distribution, cov(m, s) = m3/(2 s n).
            s, spread = m.sd, m.sd_estimate(self.confidence).error
            o = float(limits.outward(m.mean))  # +1 where the margin falls with the mean, -1 where it grows
            variance = s**2 / m.n + (3 * value * spread) ** 2 + 2 * o * 3 * value * m.s3 / m.n / (2 * s * m.n)
            error = math.sqrt(max(0.0, variance)) / (3 * s)
            return Estimate.about(value, error, deviate_of(self.confidence))

        return self._figure(of, alone)

    def failed(self) -> Estimate:
        """Return the share of failed units."""
        return self.share(self.seen - np.array([part.n for part in self.streams]))

    def share(self, passed: np.ndarray | None = None) -> Estimate:
        """Return the share of units within the limits, or of others that are counted."""
        hits = self.passed if passed is None else passed
        assert hits is not None
        if len(self.seen) == 1:
            return wilson(int(hits[0]), int(self.seen[0]), self.confidence)
        return share_estimate(hits, self.seen, self.confidence)
