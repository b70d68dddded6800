"""Shares of a run: chunks of units in order, and the processes that count them.

Any set of chunks takes little memory as ranges of their numbers.

Statistics need a few messages of some megabytes in all, at the start and at the end. They go through files of a shared
folder, not through collectives of JAX: a process that dies leaves its checkpoint, its name and no other one waiting.
"""

import contextlib
import dataclasses
import itertools
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from rvjax.base.files import write_atomically
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


SILENCE = 120.0
"""Time without a sign of life after which a process counts as ended, s."""
_LOOKS = 10  # signs of life in that time
_LONGEST = 5.0  # s between two of them
_POLL = 0.05  # s between two looks for a message


class Processes(Protocol):
    """The processes of a run, as one of them sees them."""

    number: int
    count: int

    def put(self, name: str, content: bytes) -> None:
        """Send a message to all."""

    def get(self, name: str) -> bytes | None:
        """Return a message, None before it is there."""

    def check(self) -> None:
        """Raise a ValueError if another process has ended too early."""

    def end(self) -> None:
        """Remove the messages that no process needs any longer."""


class Alone:
    """One process."""

    number, count = 0, 1

    def put(self, name: str, content: bytes) -> None:
        """There is no reader."""

    def get(self, name: str) -> bytes | None:
        """No message ever comes."""
        return None

    def check(self) -> None:
        """There is no other."""

    def end(self) -> None:
        """There are no messages."""


def take(processes: Processes, name: str) -> bytes:
    """Wait for a message.

    Args:
        processes: of the run.
        name: of the message.

    Raises:
        ValueError: another process has ended before.
    """
    wait = _POLL / 10
    while (content := processes.get(name)) is None:
        processes.check()
        time.sleep(wait)
        wait = min(1.5 * wait, _POLL)
    return content


class Folder:
    """Processes that share a folder. Each writes a sign of life there, the first watches all, the others the first.

    Signs are counters, compared on the clock of the reader: clocks of computers may differ.
    """

    def __init__(self, folder: str | Path, number: int, count: int, *, silence: float = SILENCE) -> None:
        """Name the folder of this run alone, which exists.

        Args:
            folder: that all processes share.
            number: of this process, 0 ...
            count: of all.
            silence: time after which a process without a sign of life has ended, s.
        """
        self.folder, self.number, self.count, self.silence = Path(folder), number, count, silence
        self._watched = range(1, count) if number == 0 else range(1)
        self._signs: dict[int, tuple[bytes | None, float]] = {}
        self._lost = ""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "Folder":
        self._beat(0)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._stop()
        if error is not None:
            with contextlib.suppress(OSError):
                reason = " ".join(str(error).split()) if isinstance(error, (ValueError, OSError)) else "interrupted"
                self.put(f"failed-{self.number}", (reason or type(error).__name__).encode())

    def put(self, name: str, content: bytes) -> None:
        """Send a message to all."""
        write_atomically(self.folder / name, content)

    def get(self, name: str) -> bytes | None:
        """Return a message, None before it is there."""
        try:
            return (self.folder / name).read_bytes()
        except FileNotFoundError:
            return None

    def check(self) -> None:
        """Raise a ValueError if another process has ended too early."""
        if self._lost:
            raise ValueError(self._lost)

    def end(self) -> None:
        """Remove the folder once all have read what they need; a process that died now is none of this run's cares."""
        self._stop()
        if self.number:
            return self.put(f"done-{self.number}", b"")
        until = time.monotonic() + self.silence
        while time.monotonic() < until and any(self.get(f"done-{n}") is None for n in range(1, self.count)):
            time.sleep(_POLL)
        shutil.rmtree(self.folder, ignore_errors=True)

    def _stop(self) -> None:
        self._over.set()
        self._thread.join()

    def _beat(self, count: int) -> None:
        with contextlib.suppress(OSError):  # a full disk must not end the run
            self.put(f"alive-{self.number}", str(count).encode())

    def _watch(self) -> None:
        count = 0
        while not self._over.wait(min(self.silence / _LOOKS, _LONGEST)):
            count += 1
            self._beat(count)
            for number in self._watched:
                self._lost = self._lost or self._end_of(number)

    def _end_of(self, number: int) -> str:
        """Message about a process that has ended too early; empty while it lives."""
        name = f"process {number + 1} of {self.count}"
        if (reason := self.get(f"failed-{number}")) is not None:
            said = reason.decode(errors="replace")
            return said if said.startswith("process ") else f"{name} has ended: {said}"
        sign, now = self.get(f"alive-{number}"), time.monotonic()
        if number not in self._signs or self._signs[number][0] != sign:
            self._signs[number] = sign, now
        finished = self.folder / (f"state-{number}" if number else "result")
        if now - self._signs[number][1] < self.silence or finished.exists():
            return ""
        return f"{name} is missing: no sign of life for {self.silence:.0f} s"
