"""Host side of a Monte Carlo run: moments, histograms and counts of all chunks, in constant memory."""

import math

import numpy as np

from rvjax.base.files import Arrays, pack, unpack
from rvjax.population import CentralMoments, Pairwise
from rvjax.status import Status, succeeded
from rvjax.tolerances.batch.quantiles import ExactOrder, Order
from rvjax.tolerances.batch.shares import Chunks, Processes, take
from rvjax.tolerances.limits import Limits

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
