"""Progress of a run of the command line: one line with its phase, its time so far, and what is counted.

Counted are units of those that are planned. Only the rest of the counted phase is estimated: the time of compilation
and the number of steps of a search are not known.

Computations call `begin` and `detail`. Outside `shown` they do nothing.
"""

import contextlib
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from typing import Any, TextIO

COMPILING = "compiling"


class Phases:
    """The phases of one run and how far it is."""

    def __init__(
        self,
        names: Iterable[str],
        stream: TextIO,
        counted: str = "",
        *,
        clock: Callable[[], float] = time.monotonic,
        tick: float = 0.5,
        first: float = 4.0,
        again: float = 20.0,
    ) -> None:
        """Prepare the line; no phase has begun.

        Args:
            names: of the phases, in their order.
            stream: where the line goes.
            counted: the phase whose details contain the finished part of the run.
            clock: s, of the run.
            tick: s between two updates on a terminal.
            first: s until a file or pipe gets the line of a phase; bad input ends earlier and stays one line.
            again: s until it gets the line of the same phase again.
        """
        self.stream, self.counted = stream, counted
        self.clock, self.tick, self.first, self.again = clock, tick, first, again
        self.names = list(names)
        self.terminal = stream.isatty()
        self.name, self.since, self.said, self.note, self.part = "", self.clock(), 0.0, "", 0.0
        self.moving: tuple[float, float] | None = None  # time and part when the first units were done
        self.counted_at = 0.0  # time when the last ones were
        self._lock, self._over = threading.Lock(), threading.Event()
        self._watch = threading.Thread(target=self._tick, daemon=True)

    def begin(self, name: str) -> None:
        """Begin a phase and end the one before; a name of no phase is a detail of the current one."""
        if name not in self.names:
            return self.detail(name)
        with self._lock:
            self.name, self.since, self.note, self.part, self.moving = name, self.clock(), "", 0.0, None
            self.said = self.since - self.again + self.first
            if self.terminal:
                self._show()

    def detail(self, note: str, part: float = 0.0) -> None:
        """Note the current work, such as "certifying 40 %", for the next update; `part` of the phase is done."""
        if part != self.part:
            self.counted_at = self.clock()
        self.note, self.part = note, part
        if part > 0 and self.moving is None:
            self.moving = self.counted_at, part

    def left(self) -> float | None:
        """Seconds until the end at the pace of the units since the first; None where it is not known, or over."""
        if self.name != self.counted or self.moving is None or not self.part > self.moving[1]:
            return None
        begun, part = self.moving
        rest = (self.counted_at - begun) * (1 - self.part) / (self.part - part)  # when the last units were done
        left = rest - (self.clock() - self.counted_at)
        return left if left > 0 else None

    def line(self) -> str:
        """Current text of the line."""
        number = self.names.index(self.name) + 1
        notes = filter(None, [self.name, self.note])
        left, taken = self.left(), spelled(self.clock() - self.since)
        rest = "" if left is None else f"about {spelled(left)} left, "
        return f"phase {number} of {len(self.names)}, {rest}{taken} in: {', '.join(notes)}"

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
        self._wipe()


_WATCHED: ContextVar[Phases | None] = ContextVar("watched", default=None)


@contextlib.contextmanager
def shown(names: Iterable[str], *, counted: str = "", quiet: bool = False) -> Iterator[None]:
    """Show the phases of what runs inside, on standard error.

    Args:
        names: of the phases, in their order.
        counted: the phase whose details say how much of the run is done.
        quiet: show nothing.
    """
    if quiet:
        yield
        return
    with watched(Phases(names, sys.stderr, counted)):
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
    """Begin a phase. A name of no phase is a detail of the current one."""
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
    if detail(COMPILING):
        done = initial

        def tell(count: int) -> None:
            nonlocal done
            done += count
            planned = "" if total is None else f" of {total:,}"
            detail(f"{description}, {done:,}{planned} {unit}s", 0.0 if total is None else done / max(total, 1))

        yield tell
        return
    if not shown:
        yield lambda count: _go_on()
        return
    from tqdm import tqdm

    with tqdm(total=total, unit=unit, unit_scale=True, desc=COMPILING, initial=initial) as bar:

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
