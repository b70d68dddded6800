"""Statistics of a Monte Carlo run, each with its standard error and confidence interval; the moments, histograms and
counts of all chunks that they come from, in constant memory."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from rvjax.base import frames
from rvjax.base.files import Arrays, pack, unpack
from rvjax.population import CentralMoments, Estimate, Pairwise
from rvjax.records import PyTree
from rvjax.status import Status, succeeded
from rvjax.tolerances.batch.quantiles import ExactOrder, Order
from rvjax.tolerances.batch.shares import Chunks, Processes, take
from rvjax.tolerances.limits import Limits

if TYPE_CHECKING:
    from rvjax.base.frames import DataFrame


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Statistics of a sample of units.

    Fields that depend on the response have its structure: plain for a scalar response, a dict of the
    same names otherwise (quantiles: {p: ...}). A failed unit is a reject in every yield, and takes no
    part in moments, extremes and quantiles.

    Attributes:
        samples: units, failed ones included.
        seed: of the random numbers.
        method: of the random numbers.
        standard_errors: where the errors of the estimates come from: "independent units", or the spread of
            "16 independent scrambles".
        confidence: of every interval.
        failed: units without a valid response.
        failures: their number by status name.
        examples: index of the first failed unit by status name; `sample` replays it.
        worst_index: index of the first unit that failed for the worst reason, None without failures.
        mean: `Estimate` of the mean, unit of the response.
        sd: `Estimate` of the standard deviation; its error holds for any distribution.
        quantiles: {p: `Estimate`}, linear between order statistics; exact with `keep` or up to 4096 units, else
            from counts in bins: the interval contains the bins of its ends. Intervals are binomial for independent
            units.
        minimum: smallest value.
        maximum: largest value.
        infinite: units whose response is infinite on the side without a limit. They are successes, count in yields and
            quantiles, and take no part in mean, sd, cp and cpk, which are those of the finite responses.
        yield_: `Estimate` of the share of units within the limits, Wilson interval; None without limits of units.
        ppm: `Estimate` of the rejects per million units.
        cp: (U - L)/(6 sd); nan for a one-sided requirement.
        cpk: min(U - mean, mean - L)/(3 sd).
        cp_estimate: `Estimate` of cp, nan where there is none.
        cpk_estimate: `Estimate` of cpk, by the delta method for any distribution.
        joint_yield: `Estimate` of the share of units that meet all requirements.
        verdicts: `Verdict` on each requirement; None without.
        values: response of every unit, nan for failed ones, if `keep`; else None.
        study: inputs, as text: tolerances, requirements, response (its hash, with a checkpoint) ...
        versions: of rvjax and what the numbers come from.
    """

    samples: int
    seed: int
    method: str
    standard_errors: str
    confidence: float
    failed: int
    failures: dict[str, int]
    examples: dict[str, int]
    worst_index: int | None
    mean: PyTree
    sd: PyTree
    quantiles: dict[float, PyTree]
    minimum: PyTree
    maximum: PyTree
    infinite: PyTree
    yield_: PyTree
    ppm: PyTree
    cp: PyTree
    cpk: PyTree
    cp_estimate: PyTree
    cpk_estimate: PyTree
    joint_yield: Estimate | None
    verdicts: PyTree
    values: PyTree
    study: dict[str, str]
    versions: dict[str, str]

    def to_pandas(self) -> "DataFrame":
        """Return a `pandas.DataFrame`, SI: one row for each response, every estimate with its error and interval."""
        some = isinstance(self.mean, dict)

        def of(item: PyTree, name: str) -> PyTree:
            return item[name] if some and item is not None else item

        def row(name: str) -> dict[str, object]:
            found: dict[str, object] = {"response": name, **frames.spread("mean", of(self.mean, name))}
            found |= frames.spread("sd", of(self.sd, name))
            found |= {end: of(getattr(self, end), name) for end in ("minimum", "maximum", "infinite")}
            for p, quantile in self.quantiles.items():
                found |= frames.spread(f"quantile_{p:g}", of(quantile, name))
            found |= frames.spread("yield", of(self.yield_, name))
            return found | {"cp": of(self.cp, name), "cpk": of(self.cpk, name)}

        return frames.tidy(map(row, self.mean if some else ["response"]), ["response"])


def shares_alone(statistics: Statistics) -> Statistics:
    """Shares and verdicts; other figures are nan, for only units near the limits were solved.

    Args:
        statistics: of all units, by name, with old values of units that are far from the limits.
    """
    nothing = Estimate(*[math.nan] * 4)
    estimates, numbers = (dict.fromkeys(statistics.mean, value) for value in (nothing, math.nan))
    return dataclasses.replace(
        statistics, mean=estimates, sd=estimates, quantiles=dict.fromkeys(statistics.quantiles, estimates),
        minimum=numbers, maximum=numbers, cp=numbers, cpk=numbers, cp_estimate=estimates, cpk_estimate=estimates,
        failures={}, examples={}, worst_index=None, values=None,
    )  # fmt: skip


def rejects(share: Estimate | None) -> Estimate | None:
    """Rejects per million of a share of good units."""
    if share is None:
        return None
    return Estimate(1e6 * (1 - share.value), 1e6 * share.error, 1e6 * (1 - share.upper), 1e6 * (1 - share.lower))


_GROWING = ("failures", "values", "pilot", "chunks", "waiting", "waiting_streams", "waiting_chunks")
"""Arrays with as many rows as were needed."""
_MOST_WAITING = 2**21  # values that wait for the bins, 16 MiB, before a process waits for the first


class Accumulator:
    """Moments, histograms and counts of units, separate for each stream (scramble) of units.

    Unit i belongs to stream i mod `streams`. Moments are merged in the order of the chunks' numbers,
    so that the sums have the same bits after an interruption and in any number of processes.
    """

    def __init__(self, names: tuple[str, ...], requirements: dict[str, Limits], streams: int, kept: int) -> None:
        self.names, self.streams, self.chunks = names, streams, Chunks()
        self.requirements = {name: item for name, item in requirements.items() if item.of_units}
        self.moments = {name: [Pairwise() for _ in range(streams)] for name in names}
        self._orders = {} if kept else {name: Order(streams) for name in names}
        self.values = {name: np.full(kept, math.nan) for name in names} if kept else {}
        # Units of each stream: seen, within all limits, within the limits of each requirement.
        self.seen, self.joint = np.zeros((2, streams), np.int64)
        self.passed = {name: np.zeros(streams, np.int64) for name in self.requirements}
        self.infinite = {name: np.zeros(2, np.int64) for name in names}  # successes at -inf, inf
        self.failures: dict[int, int] = {}
        self.examples: dict[int, int] = {}

    @property
    def first(self) -> dict[str, np.ndarray]:
        """Values that placed the bins, by name of the responses whose bins are known."""
        return {name: order.first for name, order in self._orders.items() if order.settled}

    @property
    def settled(self) -> bool:
        """True once the bins of all responses are known."""
        return len(self.first) == len(self._orders)

    def agree(self, group: Processes, *, last: bool = False) -> bool:
        """Place the bins of the quantiles alike in all processes: the first one says its first values.

        Args:
            group: all processes; this one has these counts.
            last: this process has counted all its units.

        Returns:
            True if nothing is left to do.
        """
        if group.number == 0:
            if self.settled or last:
                group.put("bins", pack(self.first))
            return self.settled
        if not self.settled:
            waiting = sum(order.waiting for order in self._orders.values())
            content = take(group, "bins") if waiting > _MOST_WAITING and not last else group.get("bins")
            for name, values in {} if content is None else unpack(content).items():
                self._orders[name].settle(values)
        return self.settled

    @property
    def complete(self) -> bool:
        """True if the responses of all counted units are kept."""
        successes = int(self.seen.sum()) - sum(self.failures.values())
        return all(np.count_nonzero(~np.isnan(kept)) == successes for kept in self.values.values())

    def judged(self, values: Arrays, status: np.ndarray) -> np.ndarray:
        """Status of units, NONFINITE where a response is infinite, unless its only limit is on the other side.

        Args:
            values: by name (n,).
            status: (n,) of the response itself.
        """
        for name in self.names:
            wrong = np.isinf(values[name])
            if wrong.any():
                if name in self.requirements:
                    wrong &= ~(self.requirements[name].margin(values[name]) < 0)
                status = np.where(wrong & succeeded(status), int(Status.NONFINITE), status)
        return status

    def add(self, number: int, start: int, values: Arrays, status: np.ndarray) -> None:
        """Add chunk `number`, from unit `start`: values by name (n,) and status (n,), `judged`."""
        self.chunks = self.chunks.plus((number, number + 1))
        good = succeeded(status)
        complete = bool(good.all())
        if not complete:
            for code in np.unique(status[~good]):
                units = status == code
                self._fail(int(code), int(units.sum()), start + int(np.argmax(units)))
        streams = (start + np.arange(len(status))) % self.streams if self.streams > 1 else None
        good_streams = None if streams is None else streams[good]
        joint = None
        for name in self.names:
            valid = (values[name] if complete else values[name][good]).astype(np.float64, copy=False)
            finite, its_streams = valid, good_streams
            if (endless := np.isinf(valid)).any():
                self.infinite[name] += np.bincount(valid[endless] > 0, minlength=2)
                finite = valid[~endless]
                its_streams = None if good_streams is None else good_streams[~endless]
            for stream, tree in enumerate(self.moments[name]):
                tree.add(number, CentralMoments.of(finite if its_streams is None else finite[its_streams == stream]))
            if not self.values:
                self._orders[name].add(valid, good_streams, number=number)
            if name in self.requirements:
                passed = self.requirements[name].margin(valid) <= 0
                self.passed[name] += self._count(passed, good_streams)
                joint = passed if joint is None else joint & passed
        if joint is not None:
            self.joint += self._count(joint, good_streams)
        self.seen += self._count(np.ones(len(status), bool), streams)
        self.keep(start, values, status)

    def keep(self, start: int, values: Arrays, status: np.ndarray) -> None:
        """Store the responses of units, which may be counted already, if responses are kept."""
        good = succeeded(status)
        for name, kept in self.values.items():
            kept[start : start + len(status)][good] = values[name][good]

    def _count(self, hits: np.ndarray, streams: np.ndarray | None) -> np.ndarray | int:
        if streams is None:
            return int(np.count_nonzero(hits))
        return np.bincount(streams[hits], minlength=self.streams)

    def _fail(self, code: int, units: int, example: int) -> None:
        self.failures[code] = self.failures.get(code, 0) + units
        self.examples[code] = min(self.examples.get(code, example), example)

    def orders(self) -> dict[str, Order | ExactOrder]:
        """Order statistics by name."""
        if not self.values:
            return dict(self._orders)
        found: dict[str, Order | ExactOrder] = {}
        for name, kept in self.values.items():
            good = ~np.isnan(kept)
            streams = np.arange(kept.size)[good] % self.streams
            found[name] = ExactOrder(kept[good], streams, count=self.streams)
        return found

    def state(self, stop: int) -> dict[str, np.ndarray]:
        """All counts as arrays; `stop` is the number of the unit after the last one."""
        failures = [[code, count, self.examples[code]] for code, count in self.failures.items()]
        state = {"seen": self.seen, "joint": self.joint, "chunks": self.chunks.array()}
        state["failures"] = np.array(failures, np.int64).reshape(-1, 3)
        for number, name in enumerate(self.names):
            state |= {f"{number}/moments/{s}": tree.state() for s, tree in enumerate(self.moments[name])}
            state[f"{number}/infinite"] = self.infinite[name]
            if name in self.passed:
                state[f"{number}/passed"] = self.passed[name]
            if self.values:
                state[f"{number}/values"] = self.values[name][:stop]
            else:
                state |= {f"{number}/order/{key}": array for key, array in self._orders[name].state().items()}
        return state

    def check(self, state: Arrays, chunk: int) -> None:
        """Raise a ValueError unless `state` has the arrays of this study and counts the units of its chunks.

        The digest of the file vouches for the numbers.

        Args:
            state: of an accumulator.
            chunk: units of a chunk.
        """
        mine = self.state(0)
        if state.keys() != mine.keys():
            raise ValueError(f"other arrays: {', '.join(sorted(state.keys() ^ mine.keys()))}")
        for key, like in mine.items():
            array, rows = state[key], key.rpartition("/")[2] in _GROWING or "/moments/" in key
            if (
                array.dtype.kind != like.dtype.kind
                or array.shape[rows:] != like.shape[rows:]
                or array.ndim != like.ndim
            ):
                raise ValueError(f"{key}: {array.dtype} of shape {array.shape}")
        units = Chunks.of(state["chunks"]).count * chunk
        if (seen := int(state["seen"].sum())) != units:
            raise ValueError(f"counts of {seen} units, not of {units}")

    def merge(self, state: Arrays) -> None:
        """Add the `state` of other units of the same study."""
        self.chunks = self.chunks.plus(*state["chunks"].tolist())
        self.seen += state["seen"]
        self.joint += state["joint"]
        for code, count, example in state["failures"].tolist():
            self._fail(code, count, example)
        for number, name in enumerate(self.names):
            for stream, tree in enumerate(self.moments[name]):
                tree.merge(state[f"{number}/moments/{stream}"])
            self.infinite[name] += state[f"{number}/infinite"]
            if name in self.passed:
                self.passed[name] += state[f"{number}/passed"]
            if not self.values:
                prefix = f"{number}/order/"
                parts = {key.removeprefix(prefix): array for key, array in state.items() if key.startswith(prefix)}
                self._orders[name].merge(parts)
        self.fill(state)

    def fill(self, state: Arrays) -> None:
        """Take the kept responses of a `state`, if they are kept here, and count nothing."""
        for number, name in enumerate(self.values):
            kept = state.get(f"{number}/values", np.empty(0))  # none yet: they are computed again
            mine = self.values[name][: kept.size]
            mine[:] = np.where(np.isnan(mine), kept, mine)
