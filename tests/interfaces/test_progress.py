"""The line that says where a run stands. Oracle: a clock that the test turns."""

import gc
import io
import signal
import sys
import time

import pytest

from rvjax import tolerances
from rvjax.base import progress

EXPECTED = {"reading": 10.0, "searching": 30.0, "writing": 10.0}


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Clock:
    """Seconds that pass when the test says so."""

    now = 0.0

    def __call__(self):
        return self.now


def test_only_counted_units_tell_what_is_left():
    """At the pace since the first units: what compiled before them does not count."""
    clock = Clock()
    run = progress.Phases(["reading", "drawing", "writing"], io.StringIO(), "drawing", clock=clock)
    run.begin("reading")
    clock.now = 30
    run.detail("solving, 5 of 10 units", 0.5)
    assert run.left() is None and run.line() == "phase 1 of 3, 30 s in: reading, solving, 5 of 10 units"
    run.begin("drawing")
    clock.now = 70
    run.detail("drawing, 100 of 1,000 units", 0.1)
    assert run.left() is None  # 40 s of compilation, perhaps
    clock.now = 72
    run.detail("drawing, 300 of 1,000 units", 0.3)
    assert run.left() == pytest.approx(7)
    assert run.line() == "phase 2 of 3, about 7 s left, 42 s in: drawing, drawing, 300 of 1,000 units"
    clock.now = 76
    run.detail("drawing, 300 of 1,000 units", 0.3)
    assert run.left() == pytest.approx(3)  # the next units are under way: less is left, not more
    clock.now = 80
    assert run.left() is None  # slower than before
    run.begin("writing")
    assert run.left() is None


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_a_file_gets_a_line_for_each_phase_and_a_terminal_one_that_fits(stream, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    with progress.watched(progress.Phases(EXPECTED, stream, tick=0.005, first=0.01)):
        progress.begin("reading")
        progress.begin("no phase of this run, but a detail")
        time.sleep(0.05)
        progress.begin("writing")
        time.sleep(0.05)
        with progress.aside():
            stream.write("told\n")
    text = stream.getvalue()
    if stream.isatty():
        assert all(len(line) <= 39 for line in text.replace("\n", "\r").split("\r"))
        assert text.count("\r") > 4 and "\r" + 39 * " " + "\rtold\n" in text and text.endswith("\r")
    else:
        assert [line[:19] for line in text.splitlines()] == ["rvjax: phase 1 of 3", "rvjax: phase 3 of 3", "told"]
    assert not progress.detail("outside")


def test_a_file_gets_the_line_of_a_long_phase_again():
    stream = io.StringIO()
    with progress.Phases(EXPECTED, stream, tick=0.005, first=0.01, again=0.02) as run:
        run.begin("searching")
        time.sleep(0.2)
    assert stream.getvalue().count("phase 2 of 3") > 1


class Kept(progress.Phases):
    """Phases that keep their details."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.details = []

    def detail(self, note, part=0.0):
        self.details.append((note, part))


def test_a_run_of_units_reports_its_part():
    one, kept = {"x": tolerances.Tolerance.symmetric(1.0)}, Kept({"drawing": 1.0}, io.StringIO())
    with progress.watched(kept):
        progress.begin("drawing")
        tolerances.monte_carlo(lambda e: e["x"], one, samples=200, seed=0, chunk=100)
    assert kept.details == [
        ("compiling", 0.0),
        ("Monte Carlo, 100 of 200 units", 0.5),
        ("Monte Carlo, 200 of 200 units", 1.0),
    ]


def test_a_signal_whose_exception_is_lost_ends_the_next_step(monkeypatch):
    """As in the callback by which JAX hears of the garbage collector: what it raises is written off as unraisable."""
    lost, steps = [], []
    monkeypatch.setattr(sys, "unraisablehook", lambda said: lost.append(said.exc_type))

    def callback(*_):
        gc.callbacks.remove(callback)
        signal.raise_signal(signal.SIGTERM)

    def run():
        with progress.progress_bar(False, None, "searching", "step") as advance:
            for step in range(3):
                steps.append(step)
                advance(1)
                if step == 0:
                    gc.callbacks.append(callback)
                    gc.collect(0)

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(TimeoutError), progress.ended_by(signal.SIGTERM, TimeoutError()):
        run()
    assert lost == [TimeoutError] and steps == [0, 1]
    assert signal.getsignal(signal.SIGTERM) is before
    with progress.progress_bar(False, None, "searching", "step") as advance:  # the next run is none of its business
        advance(1)


def test_bad_input_stays_one_line_in_a_file():
    stream = io.StringIO()
    with progress.Phases(EXPECTED, stream) as run:
        run.begin("reading")
    assert stream.getvalue() == ""


def test_quiet_shows_nothing(capsys):
    with progress.shown({"reading": 10.0}, quiet=True):
        assert not progress.detail("a detail")
    with progress.shown({"reading": 10.0}):
        assert progress.detail("a detail")
    assert capsys.readouterr().err == ""  # a phase of no time stays silent in a file


@pytest.mark.parametrize(("seconds", "said"), [(0.4, "0 s"), (99, "99 s"), (150, "2 min"), (7200, "2.0 h")])
def test_times_are_spelled_as_a_person_says_them(seconds, said):
    assert progress.spelled(seconds) == said
