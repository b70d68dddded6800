"""Progress of a run of the command line: one line with its phase, its time so far and the estimated rest.

Computations call `begin` and `detail`. Outside `shown` both do nothing.
"""

import contextlib
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from typing import Any, TextIO

OVERRUN = 0.2  # of the time of a phase so far: the rest of a phase beyond its expected time


class Phases:
    """The phases of one run and how far it is."""

    def __init__(
        self,
        expected: Mapping[str, float],
        stream: TextIO,
        counted: str = "",
        *,
        clock: Callable[[], float] = time.monotonic,
        tick: float = 0.5,
        trusted: float = 15.0,
        first: float = 4.0,
        again: float = 20.0,
    ) -> None:
        """Prepare the line; no phase has begun.

        Args:
            expected: seconds of each phase, in their order, on some computer; only their ratios count later.
            stream: where the line goes.
            counted: the phase whose details contain the finished part of it.
            clock: s, of the run.
            tick: s between two updates on a terminal.
            trusted: s of expected time before the pace counts: a phase of a second does not show it.
            first: s until a file or pipe gets the line of a phase; bad input ends earlier and stays one line.
            again: s until it gets the line of the same phase again.
        """
        self.expected, self.stream, self.counted = dict(expected), stream, counted
        self.clock, self.tick, self.trusted, self.first, self.again = clock, tick, trusted, first, again
        self.names = list(expected)
        self.terminal = stream.isatty()
        self.spent: dict[str, float] = {}
        self.name, self.since, self.said, self.note, self.part = "", self.clock(), 0.0, "", 0.0
        self._lock, self._over = threading.Lock(), threading.Event()
        self._watch = threading.Thread(target=self._tick, daemon=True)

    def begin(self, name: str) -> None:
        """Begin a phase and end the one before; a name that is not expected is a detail of the current phase."""
        if name not in self.expected:
            return self.detail(name)
        with self._lock:
            self._end()
            self.name, self.since, self.note, self.part = name, self.clock(), "", 0.0
            self.said = self.since - self.again + self.first
            if self.terminal:
                self._show()

    def detail(self, note: str, part: float = 0.0) -> None:
        """Note the current work, such as "certifying 40 %", for the next update; `part` of the phase is done."""
        self.note, self.part = note, part

    def left(self) -> float | None:
        """Seconds until the end: the expected rest at the pace so far; None without expected times."""
        done = sum(self.expected[name] for name in self.spent)
        here, now = self.expected.get(self.name, 0.0), self.clock() - self.since
        if self.name == self.counted and self.part > 0.01:
            return now * (1 / self.part - 1)
        if not any(self.expected.values()):
            return None
        pace = (sum(self.spent.values()) + self.trusted) / (done + self.trusted)
        rest = sum(seconds for name, seconds in self.expected.items() if name not in self.spent and name != self.name)
        # A phase that takes longer than expected lengthens the estimate of the rest, and has a share of its time to go.
        return max(pace * here - now, OVERRUN * now) + max(pace, now / here if here else 0.0) * rest

    def line(self) -> str:
        """Current text of the line."""
        number = self.names.index(self.name) + 1
        note = f", {self.note}" if self.note else ""
        left, taken = self.left(), spelled(self.clock() - self.since)
        rest = "" if left is None else f"about {spelled(left)} left, "
        return f"phase {number} of {len(self.names)}, {rest}{taken} in: {self.name}{note}"

    def _end(self) -> None:
        if self.name:
            self.spent[self.name] = self.clock() - self.since

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Clear the line during other output."""
        with self._lock:
            self._wipe()
            yield

    def _show(self) -> None:
        if not self.name:
            return
        self.said = self.clock()
        if self.terminal:
            width = shutil.get_terminal_size((80, 24)).columns - 1
            self._write(f"\r{self.line()[:width]:<{width}}")
        else:
            self._write(f"rvjax: {self.line()}\n")

    def _wipe(self) -> None:
        if self.terminal and self.name:
            self._write("\r" + " " * (shutil.get_terminal_size((80, 24)).columns - 1) + "\r")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # the reader is gone, or the stream is closed
            self.stream.write(text)
            self.stream.flush()

    def _tick(self) -> None:
        while not self._over.wait(self.tick):
            with self._lock:
                if self.terminal or self.clock() - self.said > self.again:
                    self._show()

    def __enter__(self) -> "Phases":
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._watch.join()
        self._end()
        self._wipe()


_WATCHED: ContextVar[Phases | None] = ContextVar("watched", default=None)


@contextlib.contextmanager
def shown(expected: Mapping[str, float], *, counted: str = "", quiet: bool = False) -> Iterator[None]:
    """Show the phases of what runs inside, on standard error.

    Args:
        expected: seconds of each phase, in their order; 0 throughout where unknown.
        counted: the phase whose details say how much of it is done.
        quiet: show nothing.
    """
    if quiet:
        yield
        return
    with watched(Phases(expected, sys.stderr, counted)):
        yield


@contextlib.contextmanager
def watched(phases: Phases) -> Iterator[None]:
    """Show these phases of what runs inside."""
    with phases:
        token = _WATCHED.set(phases)
        try:
            yield
        finally:
            _WATCHED.reset(token)


def begin(name: str) -> None:
    """Begin a phase. A name that is not expected is a detail of the current phase."""
    if (phases := _WATCHED.get()) is not None:
        phases.begin(name)


def detail(note: str, part: float = 0.0) -> bool:
    """Report the current work of the phase; False without a progress line."""
    _go_on()
    phases = _WATCHED.get()
    if phases is not None:
        phases.detail(note, part)
    return phases is not None


_ASKED: list[BaseException] = []


@contextlib.contextmanager
def ended_by(number: int, error: BaseException) -> Iterator[None]:
    """End what runs inside by a signal: raise an error there, at the latest at its next step.

    Python drops an exception from a callback of the garbage collector; JAX has such a callback.

    Args:
        number: of the signal; without effect outside the main thread.
        error: that it raises.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: object) -> None:
        _ASKED.append(error)
        raise error

    before = signal.signal(number, stop)
    try:
        yield
    finally:
        _ASKED.clear()
        signal.signal(number, signal.SIG_DFL if before is None else before)


def _go_on() -> None:
    if _ASKED:
        raise _ASKED[0]


@contextlib.contextmanager
def progress_bar(shown: bool, total: int | None, description: str, unit: str, *, initial: int = 0) -> Iterator[Any]:
    """A function that advances a tqdm bar, or does nothing; the bar shows "compiling" until its first call.

    If a command shows its phases, the bar is a detail of the phase, also with `shown=False`.

    Args:
        shown: whether there is a bar.
        total: units of work; None where it is not known.
        description: before the bar, once the work goes on: the phase.
        unit: of the work.
        initial: done already.
    """
    if detail("compiling"):
        done = initial

        def tell(count: int) -> None:
            nonlocal done
            done += count
            part = 0.0 if total is None else done / max(total, 1)
            detail(f"{description}, {done} {unit}s" if total is None else f"{description} {100 * part:.0f} %", part)

        yield tell
        return
    if not shown:
        yield lambda count: _go_on()
        return
    from tqdm import tqdm

    with tqdm(total=total, unit=unit, unit_scale=True, desc="compiling", initial=initial) as bar:

        def advance(count: int) -> None:
            if not bar.desc.startswith(description):
                bar.set_description(description)
            bar.update(count)
            _go_on()

        yield advance


@contextlib.contextmanager
def aside() -> Iterator[None]:
    """Print on a separate line inside."""
    with contextlib.nullcontext() if (phases := _WATCHED.get()) is None else phases.aside():
        yield


def spelled(seconds: float) -> str:
    """A time in words: "7 s", "3 min", "1.5 h"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5970 else f"{seconds / 3600:.1f} h"
