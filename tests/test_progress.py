"""The line that says where a run stands. Oracle: a clock that the test turns."""

import gc
import io
import signal
import sys
import time

import pytest

from rvjax import progress, tolerances

EXPECTED = {"reading": 10.0, "searching": 30.0, "writing": 10.0}


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass when the test says so."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "TRUSTED", 1e-9)
    return now


def test_what_is_left_follows_the_pace_so_far(clock):
    run = progress.Phases(EXPECTED, io.StringIO())
    run.begin("reading")
    assert run.left() == pytest.approx(50)
    clock[0] = 5
    assert run.left() == pytest.approx(45)
    clock[0] = 20  # twice as slow
    run.begin("searching")
    assert run.left() == pytest.approx(60 + 20)
    clock[0] = 110  # 90 s in a phase of 30: its end is due, and the rest takes three times as long
    assert run.left() == pytest.approx(30)
    run.detail("7 steps")
    assert run.line() == "phase 2 of 3, about 30 s left, 90 s in: searching, 7 steps"


def test_a_phase_that_counts_knows_its_end(clock):
    run = progress.Phases({"reading": 5.0, "drawing": 0.0}, io.StringIO(), "drawing")
    run.begin("reading")
    run.begin("drawing")
    clock[0] = 30
    run.detail("drawing 25 %", 0.25)
    assert run.left() == pytest.approx(90)
    nobody = progress.Phases({"fit": 0.0}, io.StringIO())
    nobody.begin("fit")
    assert nobody.left() is None and nobody.line() == "phase 1 of 1, 0 s in: fit"


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_a_file_gets_a_line_for_each_phase_and_a_terminal_one_that_fits(stream, monkeypatch):
    monkeypatch.setattr(progress, "TICK", 0.005)
    monkeypatch.setattr(progress.sys, "stderr", stream)
    monkeypatch.setattr(progress, "HEARD", 0.01)
    monkeypatch.setenv("COLUMNS", "40")
    with progress.shown(EXPECTED):
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
    assert not progress.detail("nobody watches")


def test_a_long_phase_is_heard_of_again_in_a_file(monkeypatch):
    monkeypatch.setattr(progress, "TICK", 0.005)
    monkeypatch.setattr(progress, "STILL", 0.02)
    monkeypatch.setattr(progress, "HEARD", 0.01)
    stream = io.StringIO()
    with progress.Phases(EXPECTED, stream) as run:
        run.begin("searching")
        time.sleep(0.2)
    assert stream.getvalue().count("phase 2 of 3") > 1


def test_a_run_of_units_says_how_far_it_is(monkeypatch):
    seen, stream = [], io.StringIO()
    monkeypatch.setattr(progress.sys, "stderr", stream)
    monkeypatch.setattr(progress.Phases, "detail", lambda self, note, part=0.0: seen.append((note, part)))
    one = {"x": tolerances.Tolerance.symmetric(1.0)}
    with progress.shown({"drawing": 1.0}):
        progress.begin("drawing")
        tolerances.monte_carlo(lambda e: e["x"], one, samples=200, seed=0, chunk=100)
    whole = ("Monte Carlo 100 %", 1.0)
    assert seen == [("compiling", 0.0), ("Monte Carlo 50 %", 0.5), whole, whole]


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
                    gc.collect()

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


def test_quiet_shows_nothing(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(progress.sys, "stderr", stream)
    with progress.shown(EXPECTED, quiet=True):
        progress.begin("reading")
    assert stream.getvalue() == ""


@pytest.mark.parametrize(("seconds", "said"), [(0.4, "0 s"), (99, "99 s"), (150, "2 min"), (7200, "2.0 h")])
def test_times_are_spelled_as_a_person_says_them(seconds, said):
    assert progress.spelled(seconds) == said
