"""The history of benchmarks: what is kept, which figures are speeds, and that a planted slowdown is found.

Oracle: entries made here, whose changes are known exactly; ratios of two doubles agree to a rounding, 1e-15.
"""

import copy

import pytest

from benchmarks import history, run

MACHINE = {"processor": "Some CPU", "cores": 2, "backend": "cpu", "xla_flags": ""}
FIGURES = {
    "rvjax, ns per case": 100.0,
    "numpy, ns per case": 400.0,
    "numpy / rvjax": 4.0,
    "compile_s": 1.5,
    "peak_MB": 30.0,
    "largest error / accuracy": 0.3,
    "cases": 1000,
    "never": float("inf"),
}


def script(**changes):
    versions = {"rvjax": "0.1.0", "jax": "0.9.2", "python": "3.11.7"}
    whole = {"seconds": 1.0, "small": False, "machine": MACHINE, "versions": versions, "figures": dict(FIGURES)}
    return copy.deepcopy(whole | changes)


def entry(**changes):
    return {"date": "2026-01-01", "machine": "Some CPU", "scripts": {"one": script(**changes)}}


def slowed(figure, factor):
    return entry(figures=FIGURES | {figure: FIGURES[figure] * factor})


@pytest.mark.parametrize(
    ("figure", "factor", "slower"),
    [
        ("rvjax, ns per case", 1.5, 1.5),
        ("numpy / rvjax", 0.5, 2.0),  # the lead over NumPy has halved
        ("numpy / rvjax", 1.6, 1 / 1.6),
        ("compile_s", 0.5, 0.5),
        ("peak_MB", 1.2, 1.2),
    ],
)
def test_a_planted_change_is_found_and_nothing_else(figure, factor, slower):
    (found,) = (change for change in history.changes(entry(), slowed(figure, factor)) if change.beyond)
    assert (found.script, found.figure) == ("one", figure)
    assert found.slower == pytest.approx(slower, rel=1e-15)
    text = history.report(entry(), slowed(figure, factor))
    assert f"{max(slower, 1 / slower):.2f} x  one: {figure}" in text
    assert f"{'slower' if slower > 1 else 'faster'}: 1\n" in text


@pytest.mark.parametrize("figure", ["numpy, ns per case", "largest error / accuracy", "cases", "never"])
def test_what_is_no_speed_of_ours_is_not_judged(figure):
    assert figure not in {change.figure for change in history.changes(entry(), slowed(figure, 3.0))}


def test_noise_is_the_scatter_where_it_was_measured():
    runs = [script(figures=FIGURES | {"compile_s": seconds}) for seconds in (1.0, 1.5, 2.5)]
    whole = history.together(runs)
    assert whole["figures"]["compile_s"] == 1.5 and whole["scatter"]["compile_s"] == 2.5
    assert "cases" not in whole["scatter"] and "scatter" not in history.together(runs[:1])
    busy, quiet = entry(scatter={"compile_s": 2.5}), entry(scatter={"compile_s": 1.01})
    for before, beyond in ((busy, False), (quiet, True)):
        after = copy.deepcopy(before)
        after["scripts"]["one"]["figures"]["compile_s"] *= 2
        found = {change.figure: change.beyond for change in history.changes(before, after)}
        assert found["compile_s"] is beyond


def test_only_ratios_are_compared_between_machines_and_sizes_never():
    elsewhere = slowed("numpy / rvjax", 0.5)
    elsewhere["scripts"]["one"]["machine"]["processor"] = "Another CPU"
    assert {change.figure for change in history.changes(entry(), elsewhere)} == {"numpy / rvjax"}
    assert list(history.changes(entry(), entry(small=True))) == []


def test_entries_are_kept_by_day_machine_and_label(tmp_path):
    first = history.keep("one", script(), "before", tmp_path)
    assert history.keep("two", script(), "before", tmp_path) == first
    second = history.keep("one", script(seconds=2.0), "", tmp_path)
    assert first.stem == f"{second.stem}-before" and "some-cpu" in second.stem
    assert set(history.entries(tmp_path)[first.stem]["scripts"]) == {"one", "two"}
    quick = history.keep("two", script(small=True), "again", tmp_path)
    quick.write_text(quick.read_text().replace('"date": "2', '"date": "9'))  # the last of all, whatever its name
    assert list(history.entries(tmp_path))[-1] == quick.stem
    newest = history.newest(tmp_path)
    assert set(newest) == {"one", "two"} and not newest["two"]["small"]  # a quick run never stands in the README


def test_the_command_compares_two_entries(tmp_path, capsys):
    assert run.compare([], tmp_path) == 2
    before = history.keep("one", script(), "before", tmp_path).stem
    after = history.keep("one", slowed("compile_s", 2.0)["scripts"]["one"], "after", tmp_path).stem
    assert run.compare([before, "absent"], tmp_path) == 2
    assert run.compare([before, before], tmp_path) == 0
    capsys.readouterr()
    assert run.compare([before, after], tmp_path) == 1
    assert "2.00 x  one: compile_s" in capsys.readouterr().out
    assert run.compare([after, before], tmp_path) == 0  # faster is no failure


def test_every_stored_entry_is_whole():
    for name, kept in history.entries().items():
        assert name.startswith(kept["date"][:10]) and kept["scripts"]
        assert {change.figure for change in history.changes(kept, kept)}
        assert not [change for change in history.changes(kept, kept) if change.slower != 1]
        for figures in kept["scripts"].values():
            assert set(figures) - {"scatter"} == {"seconds", "small", "machine", "versions", "figures"}
            assert set(figures["versions"]) >= {"rvjax", "jax", "python"}
