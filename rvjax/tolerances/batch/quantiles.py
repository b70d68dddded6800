"""Order statistics: of all values where they are kept, else in constant memory from a histogram."""

import math
from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from scipy import special

from rvjax.population import Estimate, deviate_of, share_error, student

PILOT = 4096
BINS = 2**16
COARSE = 16  # bins that are one where the scrambles are counted apart


class Order:
    """Order statistics: exact up to `PILOT` values, then from a histogram, within one of its bins.

    The range comes from the first `PILOT` values in the order of the units, independent of chunks and
    processes, and is half their span wider on each side; what falls outside is
    counted apart.
    """

    def __init__(self, streams: int = 1) -> None:
        self._pilot = np.empty(0)
        self._waiting, self._waiting_streams = np.empty(0), np.empty(0, np.int64)
        self._counts = np.zeros(BINS, np.int64)
        # Counts of every stream below the range, in bins of `COARSE`, above the range.
        self._coarse = np.zeros((streams, BINS // COARSE + 2), np.int64)
        self._low, self._width = math.nan, math.nan
        self._below = self._above = 0
        self.n, self.streams = 0, streams
        self.minimum, self.maximum = math.inf, -math.inf

    @property
    def settled(self) -> bool:
        """True once the range is known."""
        return not math.isnan(self._low)

    def add(self, values: np.ndarray, streams: np.ndarray | None = None, *, own: bool = True) -> None:
        """Take in one block of finite values in the order of the units, with their streams where there are several.

        Values that are not `own` are counted by another process: they only help to find the range.
        """
        if not values.size:
            return
        if own:
            self.n += values.size
            self.minimum = min(self.minimum, float(values.min()))
            self.maximum = max(self.maximum, float(values.max()))
        if self.settled:
            if own:
                self._count(values, streams)
            return
        self._pilot = np.concatenate([self._pilot, values[: PILOT - self._pilot.size]])
        if own:
            self._waiting = np.concatenate([self._waiting, values])
            if streams is not None:
                self._waiting_streams = np.concatenate([self._waiting_streams, streams])
        if self._pilot.size == PILOT:
            self._set_range()
            self._count(self._waiting, self._waiting_streams if self.streams > 1 else None)
            self._pilot = self._waiting = np.empty(0)
            self._waiting_streams = np.empty(0, np.int64)

    def _set_range(self) -> None:
        low, high = float(self._pilot.min()), float(self._pilot.max())
        margin = (high - low) / 2 or max(abs(low), 1e-280) * 1e-9
        self._low, self._width = low - margin, (high - low + 2 * margin) / BINS

    def _count(self, values: np.ndarray, streams: np.ndarray | None) -> None:
        # One slot below the range and one above it; clipped first, so that nothing overflows as an integer.
        slot = np.clip((values - self._low) * (1 / self._width) + 1, 0, BINS + 1).astype(np.int64)
        counts = np.bincount(slot, minlength=BINS + 2)
        self._counts += counts[1:-1]
        self._below += int(counts[0])
        self._above += int(counts[-1])
        if streams is not None:
            slots = self._coarse.shape[1]
            coarse = (slot + (COARSE - 1)) // COARSE  # 0, then COARSE bins each, then the slot above
            self._coarse += np.bincount(streams * slots + coarse, minlength=self._coarse.size).reshape(-1, slots)

    def at(self, rank: float) -> float:
        """Return the value of a (fractional) rank, 1 .. n."""
        if not self.settled:
            return self._exact().at(rank)
        k = min(max(int(rank), 1), self.n)
        low = self._at(k)
        return low + (self._at(min(k + 1, self.n)) - low) * min(max(rank - k, 0.0), 1.0)

    def _exact(self) -> "ExactOrder":
        return ExactOrder(self._waiting, self._waiting_streams, count=self.streams)

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

    def below(self, value: float) -> tuple[np.ndarray, np.ndarray]:
        """Values of every stream up to `value` (interpolated within a bin), and all of them (streams,)."""
        if not self.settled:
            return self._exact().below(value)
        high = self._low + BINS * self._width
        inner = np.linspace(self._low, high, BINS // COARSE + 1)
        edges = np.concatenate([[min(self.minimum, self._low)], inner, [max(self.maximum, high)]])
        place = int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))
        share = np.clip((value - edges[place]) / ((edges[place + 1] - edges[place]) or 1.0), 0.0, 1.0)
        return self._coarse[:, :place].sum(axis=1) + share * self._coarse[:, place], self._coarse.sum(axis=1)

    def state(self) -> dict[str, np.ndarray]:
        """Everything that `merge` needs."""
        return {
            "scalars": np.array([self._low, self._width, self.minimum, self.maximum]),
            "numbers": np.array([self._below, self._above, self.n]),
            "pilot": self._pilot,
            "waiting": self._waiting,
            "waiting_streams": self._waiting_streams,
            "counts": self._counts,
            "coarse": self._coarse,
        }

    def merge(self, state: Mapping[str, np.ndarray]) -> None:
        """Take in the `state` of other units of the same study; a ValueError where the ranges differ."""
        low, width, minimum, maximum = (float(v) for v in state["scalars"])
        below, above, n = (int(v) for v in state["numbers"])
        if not self.n and not self.settled:  # nothing here yet: the other's range, or its search for one, goes on
            self._low, self._width, self._pilot = low, width, state["pilot"]
        elif (self._low, self._width) != (low, width) and not (math.isnan(low) and math.isnan(self._low)):
            raise ValueError("processes: they computed different values for the same units; use like machines")
        self._waiting = np.concatenate([self._waiting, state["waiting"]])
        self._waiting_streams = np.concatenate([self._waiting_streams, state["waiting_streams"]])
        self._counts += state["counts"]
        self._coarse += state["coarse"]
        self._below, self._above, self.n = self._below + below, self._above + above, self.n + n
        self.minimum, self.maximum = min(self.minimum, minimum), max(self.maximum, maximum)


class ExactOrder:
    """Order statistics of values that are all kept."""

    def __init__(self, values: np.ndarray, streams: np.ndarray | None = None, *, count: int = 1) -> None:
        self._sorted = np.sort(values)
        self._values, self.streams, self.n = values, count, values.size
        self._streams = np.zeros(self.n, np.int64) if streams is None or count == 1 else streams

    def at(self, rank: float) -> float:
        """Return the value of a (fractional) rank, 1 .. n."""
        k = min(max(int(rank), 1), self.n)
        low, high = float(self._sorted[k - 1]), float(self._sorted[min(k, self.n - 1)])
        return low + (high - low) * min(max(rank - k, 0.0), 1.0)

    def below(self, value: float) -> tuple[np.ndarray, np.ndarray]:
        """Values of every stream up to `value`, and all of them (streams,)."""
        inside, count = self._values <= value, self.streams
        return np.bincount(self._streams[inside], minlength=count), np.bincount(self._streams, minlength=count)


def quantile_estimate(order: Order | ExactOrder, p: float, confidence: float) -> Estimate:
    """Return the p-quantile, linear between order statistics.

    Its interval is the distribution-free binomial one of independent units; with several scrambles it
    comes from the spread, between them, of the share of units below the quantile. Where the sample is
    too small to bound the quantile, that end of the interval is infinite.
    """
    n = order.n
    if not n:
        return Estimate.about(math.nan, math.nan, 0.0)
    value = order.at(1 + (n - 1) * p)
    if order.streams == 1:
        deviate = deviate_of(confidence)
        first, last = _binomial_quantile((1 - confidence) / 2, n, p), _binomial_quantile((1 + confidence) / 2, n, p) + 1
    else:
        error, streams = share_error(*order.below(value))
        deviate = student(confidence, streams)
        half = deviate * error * n
        first, last = math.floor(n * p - half), math.ceil(n * p + half) + 1
    lower = order.at(first) if first >= 1 else -math.inf
    upper = order.at(last) if last <= n else math.inf
    return Estimate(value, (upper - lower) / (2 * deviate), lower, upper)


def _binomial_quantile(share: float, n: int, p: float) -> int:
    """Smallest k with P(B <= k) >= share, B ~ binomial(n, p)."""
    return bisect_left(range(n), share, key=lambda k: special.bdtr(k, n, p))
