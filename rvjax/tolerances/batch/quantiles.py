"""Order statistics: of all values where they are kept, else in constant memory from a histogram."""

import math
from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from scipy import special

from rvjax.population import Estimate, deviate_of, share_error, student
from rvjax.tolerances.batch.shares import Chunks

PILOT = 4096
COARSE = 16  # bins that are one where the scrambles are counted apart
_SIDE, _BITS = 2**13, 7  # cells on each side of a centre; 2^7 of them in each doubling of the distance from it
_EVEN, _EACH = 2**16, 8  # bins of equal width in twice the range of the first values; bins for each of these values
BINS = 2 * _SIDE + _EVEN + _EACH * PILOT
_NEAREST = 256  # one of so many first values is nearer to the centre than the width of 128 cells
_SHIFT = 52 - _BITS  # the bits of a float are in the order of its size
_LARGEST = np.array(np.inf).view(np.int64)


class Grid:
    """Bins for values of any distribution, placed by the first of them.

    Cells cover all numbers and become wider with the distance from a centre, as floats do: the median of the first
    values or, where the values of a tail on one side then fill more cells, the end of their range on the other. Each
    cell is divided evenly: into 8 bins for each first value in it, and so that no bin is wider than 2^-16 of twice
    their range. So heavy tails have bins, and values that are dense have narrow ones.
    """

    def __init__(self, first: np.ndarray) -> None:
        """Place the bins.

        Args:
            first: values, in any order; infinite ones have no effect.
        """
        known = np.sort(first[np.isfinite(first)]) if np.isfinite(first).any() else np.zeros(1)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            filled = []
            for middle in known[[known.size // 2, 0, -1]].tolist():
                self._set_cells(middle, known)
                filled.append((np.unique(self._cell(known)).size, middle))
            self._set_cells(max(filled, key=lambda found: found[0])[1], known)
            steps = np.minimum(self._first + np.arange(1, _SIDE), _LARGEST >> _SHIFT) << _SHIFT
            steps = steps.view(np.float64) - self._size
            below, above = self._middle - steps[::-1], self._middle + steps
            ends = np.concatenate([[-np.inf], below, [self._middle], above, [np.inf]])
            width = np.diff(ends)
            margin = (known[-1] - known[0]) / 2 or self._size
            inside = np.diff(np.clip(ends, known[0] - margin, known[-1] + margin)) / (4 * margin / _EVEN)
            parts = 1 + np.nan_to_num(inside, posinf=0.0).astype(np.int64)
            parts += _EACH * np.bincount(self._cell(known), minlength=2 * _SIDE)
            parts[~np.isfinite(width)] = 1
            self._start, self._last = ends[:-1], parts - 1.0
            self._rate = parts / width
            self._place = np.concatenate([[0], np.cumsum(parts)[:-1]])
            within = np.arange(parts.sum()) - np.repeat(self._place, parts)
            step = np.where(np.isfinite(width), width / parts, 0.0)
            lower = np.repeat(self._start, parts) + within * np.repeat(step, parts)
        # Ends of the bins, beyond which rounding puts no value; there are less bins than `BINS`, the others are empty.
        self._ends = np.full(BINS + 1, np.inf)
        self._ends[: lower.size] = np.maximum.accumulate(lower)
        self._rounding = 4 * float(np.spacing(abs(self._middle) + self._size))

    def _set_cells(self, middle: float, known: np.ndarray) -> None:
        """Cells about a centre, 128 up to the distance of the nearest values and 128 in each doubling of it."""
        away = np.sort(np.abs(known - middle))
        away = away[away > 0]
        size = min(float(away[away.size // _NEAREST]), 1e300) if away.size else max(abs(middle), 1e-280) * 1e-9
        self._middle, self._size = middle, size
        self._first = np.array(size).view(np.int64) >> _SHIFT

    def _cell(self, values: np.ndarray) -> np.ndarray:
        away = values - self._middle
        steps = np.minimum(((np.abs(away) + self._size).view(np.int64) >> _SHIFT) - self._first, _SIDE - 1)
        return np.where(away < 0, _SIDE - 1 - steps, _SIDE + steps)

    def places(self, values: np.ndarray) -> np.ndarray:
        """Bin of each value, 1 .. `BINS`, 0 for -inf and `BINS` + 1 for inf: a larger value has no lower one."""
        with np.errstate(over="ignore", invalid="ignore"):
            cell = self._cell(values)
            within = np.fmin(np.fmax((values - self._start[cell]) * self._rate[cell], 0.0), self._last[cell])
            found = self._place[cell] + within.astype(np.int64) + 1
        if not math.isfinite(values.min()) or not math.isfinite(values.max()):
            found = np.where(np.isfinite(values), found, np.where(values < 0, 0, BINS + 1))
        return found

    def bounds(self, place: int, bins: int = 1) -> tuple[float, float]:
        """Ends between which all values of a bin are.

        Args:
            place: of the first bin, 1 .. `BINS`.
            bins: taken together.
        """
        low, high = float(self._ends[place - 1]), float(self._ends[place - 1 + bins])
        return low - self._near(low), high + self._near(high)

    def _near(self, end: float) -> float:
        return max(self._rounding, 4 * float(np.spacing(abs(end)))) if math.isfinite(end) else 0.0


class Order:
    """Order statistics: exact up to `PILOT` values, then from counts in bins.

    The bins come from the first `PILOT` values in the order of the units, independent of chunks and processes. Chunks
    come in any order; their values wait until the bins are known. Infinite values are counted apart, at the ends;
    `minimum` and `maximum` are those of the others.
    """

    def __init__(self, streams: int = 1) -> None:
        self.first = np.empty(0)
        """The values that placed the bins (`PILOT`,); empty before."""
        self._bins: Grid
        self._waiting: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # values and streams of the chunks with any
        self._chunks = Chunks()
        self._counts = np.zeros(BINS + 2, np.int64)
        # Counts of every stream: -inf, in bins of `COARSE`, inf.
        self._coarse = np.zeros((streams, BINS // COARSE + 2), np.int64)
        self.n, self.streams = 0, streams
        self.minimum, self.maximum = math.inf, -math.inf

    @property
    def settled(self) -> bool:
        """True once the bins are known."""
        return self.first.size == PILOT

    @property
    def waiting(self) -> int:
        """Number of values that wait for the bins."""
        return sum(values.size for values, _ in self._waiting.values())

    def add(self, values: np.ndarray, streams: np.ndarray | None = None, *, number: int | None = None) -> None:
        """Take in the values of one chunk.

        Args:
            values: in the order of the units (n,).
            streams: of them (n,), where there are several.
            number: of the chunk; None: the one after the last.
        """
        if values.size:
            self.n += values.size
            finite = values[np.isfinite(values)]
            self.minimum = min(self.minimum, float(finite.min(initial=math.inf)))
            self.maximum = max(self.maximum, float(finite.max(initial=-math.inf)))
        if self.settled:
            if values.size:
                self._count(values, streams)
            return
        number = self._chunks.stop if number is None else number
        self._chunks = self._chunks.plus((number, number + 1))
        if values.size:
            self._waiting[number] = values, np.zeros(values.size, np.int64) if streams is None else streams
        self._find()

    def _find(self) -> None:
        """Place the bins if the first values are there, those of the chunks without a gap from the first one on."""
        known = sorted(number for number in self._waiting if number < self._chunks.begun)
        if sum(self._waiting[number][0].size for number in known) >= PILOT:
            self.settle(np.concatenate([self._waiting[number][0] for number in known])[:PILOT])

    def settle(self, first: np.ndarray) -> None:
        """Place the bins and count the values that wait.

        Args:
            first: values of the run, by this process or another (`PILOT`,).

        Raises:
            ValueError: the bins are known, and others.
        """
        if self.settled:
            if not np.array_equal(self.first, first):
                raise ValueError("processes: they computed different values for the same units; use like machines")
            return
        self.first, self._bins = first, Grid(first)
        for values, streams in self._waiting.values():
            self._count(values, streams if self.streams > 1 else None)
        self._waiting, self._chunks = {}, Chunks()

    def _count(self, values: np.ndarray, streams: np.ndarray | None) -> None:
        places = self._bins.places(values)
        self._counts += np.bincount(places, minlength=BINS + 2)
        if streams is not None:
            slots = self._coarse.shape[1]
            coarse = (places + (COARSE - 1)) // COARSE
            self._coarse += np.bincount(streams * slots + coarse, minlength=self._coarse.size).reshape(-1, slots)

    def at(self, rank: float) -> float:
        """Return the value of a (fractional) rank, 1 .. n."""
        if not self.settled:
            return self._exact().at(rank)
        k = min(max(int(rank), 1), self.n)
        return _between(self._at(k), self._at(min(k + 1, self.n)), rank - k)

    def ends(self, rank: int) -> tuple[float, float]:
        """Values between which the order statistic of a rank, 1 .. n, lies for certain: the ends of its bin."""
        return self._within(rank)[:2] if self.settled else self._exact().ends(rank)

    def _exact(self) -> "ExactOrder":
        values, streams = self._queue()
        return ExactOrder(values, streams, count=self.streams)

    def _queue(self) -> tuple[np.ndarray, np.ndarray]:
        """Values that wait and their streams, in the order of the units."""
        rows = [_NONE, *(self._waiting[number] for number in sorted(self._waiting))]
        return np.concatenate([values for values, _ in rows]), np.concatenate([streams for _, streams in rows])

    def _at(self, k: int) -> float:
        """Order statistic k, 1 .. n; spread evenly over the bin it falls into."""
        return _between(*self._within(k))

    def _within(self, k: int) -> tuple[float, float, float]:
        """Ends of the bin of order statistic k, and the part of the bin's values before it."""
        first, last = int(self._counts[0]), self.n - int(self._counts[-1])  # the others are infinite
        if k <= first + 1:
            low = -math.inf if k <= first else self.minimum
            return low, low, 0.0
        if k >= last:
            high = math.inf if k > last else self.maximum
            return high, high, 0.0
        upto = np.cumsum(self._counts)
        place = int(np.searchsorted(upto, k))
        share = (k - (upto[place] - self._counts[place]) - 0.5) / self._counts[place]
        low, high = self._bins.bounds(place)
        return max(low, self.minimum), min(high, self.maximum), float(share)

    def below(self, value: float) -> tuple[np.ndarray, np.ndarray]:
        """Values of every stream up to `value` (interpolated within a bin; below inf), and all of them (streams,)."""
        if not self.settled:
            return self._exact().below(value)
        place = int(self._bins.places(np.array([value]))[0] + (COARSE - 1)) // COARSE
        share = float(value < 0)
        if math.isfinite(value):
            low, high = self._bins.bounds(COARSE * (place - 1) + 1, COARSE)
            low, high = max(low, self.minimum), min(high, self.maximum)
            share = min(max((value - low) / ((high - low) or 1.0), 0.0), 1.0)
        return self._coarse[:, :place].sum(axis=1) + share * self._coarse[:, place], self._coarse.sum(axis=1)

    def state(self) -> dict[str, np.ndarray]:
        """Everything that `merge` needs."""
        values, streams = self._queue()
        lengths = [[number, self._waiting[number][0].size] for number in sorted(self._waiting)]
        return {
            "extremes": np.array([self.minimum, self.maximum]),
            "n": np.array([self.n]),
            "pilot": self.first,
            "chunks": self._chunks.array(),
            "waiting": values,
            "waiting_streams": streams,
            "waiting_chunks": np.array(lengths, np.int64).reshape(-1, 2),
            "counts": self._counts,
            "coarse": self._coarse,
        }

    def merge(self, state: Mapping[str, np.ndarray]) -> None:
        """Take in the `state` of other units of the same study; a ValueError where the bins differ."""
        if state["pilot"].size:
            self.settle(state["pilot"])
        ends = np.cumsum(state["waiting_chunks"][:, 1])[:-1]
        parts = zip(*(np.split(state[key], ends) for key in ("waiting", "waiting_streams")))
        for number, (values, streams) in zip(state["waiting_chunks"][:, 0].tolist(), parts):
            if self.settled:
                self._count(values, streams if self.streams > 1 else None)
            else:
                self._waiting[number] = values, streams
        if not self.settled:
            self._chunks = self._chunks.plus(*state["chunks"].tolist())
            self._find()
        self._counts += state["counts"]
        self._coarse += state["coarse"]
        self.n += int(state["n"][0])
        minimum, maximum = state["extremes"].tolist()
        self.minimum, self.maximum = min(self.minimum, minimum), max(self.maximum, maximum)


_NONE = np.empty(0), np.empty(0, np.int64)


class ExactOrder:
    """Order statistics of values that are all kept."""

    def __init__(self, values: np.ndarray, streams: np.ndarray | None = None, *, count: int = 1) -> None:
        self._sorted = np.sort(values)
        self._values, self.streams, self.n = values, count, values.size
        self._streams = np.zeros(self.n, np.int64) if streams is None or count == 1 else streams

    def at(self, rank: float) -> float:
        """Return the value of a (fractional) rank, 1 .. n."""
        k = min(max(int(rank), 1), self.n)
        return _between(float(self._sorted[k - 1]), float(self._sorted[min(k, self.n - 1)]), rank - k)

    def ends(self, rank: int) -> tuple[float, float]:
        """The order statistic of a rank, 1 .. n, twice: it is known exactly."""
        value = float(self._sorted[rank - 1])
        return value, value

    def below(self, value: float) -> tuple[np.ndarray, np.ndarray]:
        """Values of every stream up to `value` (below inf), and all of them (streams,)."""
        inside, count = (self._values <= value) & (self._values < math.inf), self.streams
        return np.bincount(self._streams[inside], minlength=count), np.bincount(self._streams, minlength=count)


def quantile_estimate(order: Order | ExactOrder, p: float, confidence: float) -> Estimate:
    """Return the p-quantile, linear between order statistics.

    Its interval is the distribution-free binomial one of independent units; with several scrambles it
    comes from the spread, between them, of the share of units below the quantile. Where the sample is
    too small to bound the quantile, that end of the interval is infinite. From counts in bins the interval
    contains the whole bins that its ends fall into.
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
    lower = order.ends(first)[0] if first >= 1 else -math.inf
    upper = order.ends(last)[1] if last <= n else math.inf
    width = upper - lower if upper > lower else 0.0  # both may be the same infinity
    return Estimate(value, width / (2 * deviate), lower, upper)


def _between(low: float, high: float, share: float) -> float:
    """Return the value at a share of the way; where an end is infinite, so is all between the ends."""
    share = min(max(share, 0.0), 1.0)
    return low if share == 0 or low in (high, -math.inf) else low + (high - low) * share


def _binomial_quantile(share: float, n: int, p: float) -> int:
    """Smallest k with P(B <= k) >= share, B ~ binomial(n, p)."""
    return bisect_left(range(n), share, key=lambda k: special.bdtr(k, n, p))
