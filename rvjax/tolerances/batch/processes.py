"""Processes that share a run: messages between them, and a clear end when one of them is missing.

Statistics need a few messages of some megabytes in all, at the start and at the end. They go through files of a shared
folder, not through collectives of JAX: a process that dies leaves its checkpoint, its name and no other one waiting.
"""

import contextlib
import shutil
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Protocol

from rvjax.base.files import pack, unpack, write_atomically
from rvjax.tolerances.batch.accumulator import Accumulator

SILENCE = 120.0
"""Time without a sign of life after which a process counts as ended, s."""
_LOOKS = 10  # signs of life in that time
_LONGEST = 5.0  # s between two of them
_MOST_WAITING = 2**21  # values that wait for the bins, 16 MiB, before a process waits for the first
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


def agree(counted: Accumulator, group: Processes, *, last: bool = False) -> bool:
    """Place the bins of the quantiles alike in all processes: the first one says its first values.

    Args:
        counted: counts of this process.
        group: all processes.
        last: this process has counted all its units.

    Returns:
        True if nothing is left to do.
    """
    if group.number == 0:
        if counted.settled or last:
            group.put("bins", pack(counted.first))
        return counted.settled
    if not counted.settled:
        content = take(group, "bins") if counted.waiting > _MOST_WAITING and not last else group.get("bins")
        if content is not None:
            counted.settle(unpack(content))
    return counted.settled


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
