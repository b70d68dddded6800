"""Chunks of a run: their numbers as ranges, any set of which takes little memory, and their units in order."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Self

import numpy as np

from rvjax.records import PyTree

Start = Callable[[int], tuple[dict[str, PyTree], PyTree]]  # first unit -> values and status, still computed


@dataclasses.dataclass(frozen=True)
class Chunks:
    """Chunks of units.

    Attributes:
        ranges: (first, stop) of neighbours, in order; no two touch.
    """

    ranges: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, ranges: Iterable[Iterable[int]]) -> Self:
        """Chunks of ranges in any order.

        Raises:
            ValueError: two have a chunk in common, or a range is none.
        """
        found: list[tuple[int, int]] = []
        for first, stop in sorted((int(first), int(stop)) for first, stop in ranges):
            before = found[-1][1] if found else 0
            if first < before or stop <= first:
                raise ValueError(f"chunks {first} to {stop}: counted twice, or no chunks")
            if found and first == before:
                found[-1] = (found[-1][0], stop)
            else:
                found.append((first, stop))
        return cls(tuple(found))

    @classmethod
    def up_to(cls, stop: int) -> Self:
        """The first chunks, 0 to stop - 1."""
        return cls.of([(0, stop)] if stop else [])

    @property
    def count(self) -> int:
        """Number of chunks."""
        return sum(stop - first for first, stop in self.ranges)

    @property
    def stop(self) -> int:
        """Number after the last one, 0 without any."""
        return self.ranges[-1][1] if self.ranges else 0

    @property
    def begun(self) -> int:
        """Chunks from number 0 on without a gap."""
        return self.ranges[0][1] if self.ranges and self.ranges[0][0] == 0 else 0

    def __contains__(self, number: int) -> bool:
        return any(first <= number < stop for first, stop in self.ranges)

    def __iter__(self) -> Iterator[int]:
        return (number for first, stop in self.ranges for number in range(first, stop))

    def plus(self, *others: tuple[int, int]) -> Self:
        """These and further ranges."""
        return self.of([*self.ranges, *others])

    def within(self, others: "Chunks") -> bool:
        """True if each is one of the others."""
        return all(any(low <= first and stop <= high for low, high in others.ranges) for first, stop in self.ranges)

    def rest(self, total: int) -> Self:
        """Chunks 0 to total - 1 that are not among these."""
        ends = [0, *(end for pair in self.ranges for end in pair), max(total, self.stop)]
        return self.of((first, stop) for first, stop in zip(ends[::2], ends[1::2]) if first < min(stop, total))

    def share(self, process: int, processes: int) -> Self:
        """The part of one process: neighbours, so that their moments merge and its state stays small."""
        low, high = (self.count * part // processes for part in (process, process + 1))
        found, before = [], 0
        for first, stop in self.ranges:
            start, end = first + max(low - before, 0), first + min(high - before, stop - first)
            if start < end:
                found.append((start, end))
            before += stop - first
        return self.of(found)

    def array(self) -> np.ndarray:
        """Ranges as rows (n, 2)."""
        return np.array(self.ranges, np.int64).reshape(-1, 2)


def in_order(
    start: Start, numbers: Chunks, chunk: int, samples: int
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    """Number, values and status of each chunk; the device computes the next one while the host reads this one.

    Args:
        start: begins to evaluate the chunk with this first unit.
        numbers: of the chunks.
        chunk: units of a chunk.
        samples: units of the run.
    """
    before = None
    for number in itertools.chain(numbers, [None]):
        begun = None if number is None else (number, start(number * chunk))
        if before is not None:
            done, (values, status) = before
            # The last chunk is evaluated as long as the others, and cut here: nothing is compiled twice.
            count = min(chunk, samples - done * chunk)
            yield done, {name: np.asarray(v)[:count] for name, v in values.items()}, np.asarray(status)[:count]
        before = begun
