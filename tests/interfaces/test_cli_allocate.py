"""`rvjax allocate` from end to end on a small study: answer, tables, pictures, refusal; nothing half-written."""

import csv
import dataclasses
import json
import math
import re
import types
from pathlib import Path

import matplotlib.image
import pytest
from cli_study import PICTURES, SMALL, TARGET, UNITS

import rvjax
import rvjax.commands.allocate.answer
from rvjax import cli, render
from rvjax.commands import forecast
from rvjax.commands.allocate import answer, report_on
from rvjax.commands.budget.budgets import scalar_budget
from rvjax.commands.forecast import (
    CERTIFICATES,
    CERTIFYING,
    PASSES,
    PRICING,
    SAMPLING,
    SEARCHING,
    solved_units,
)
from rvjax.render import Report, numbered_folders, results_folder, write_files
from rvjax.tolerances import QUICK, units_of
from rvjax.units import arcmin, um

pytestmark = pytest.mark.usefixtures("answers")

# A mid-point at nearly no cost and certificates of rare units: five times the time.
FLAT = SMALL.replace("angles = 8", "angles = 12").replace("cost = 0.1\n", "cost = 0.01\n").replace("20_000", "8_000")


def test_allocate_answers(answered):
    code, out = answered
    assert code == 0
    result = json.loads((out / "result.json").read_text())
    assert result["status"] == "OPTIMAL"
    assert result["cost"]["after"] < 0.8 * result["cost"]["before"]
    certificate = result["certificate"]
    assert certificate["samples"] == UNITS and certificate["failed"] == 0
    assert certificate["values"] is result["certificate_before"]["values"] is None  # single units are in answer.npz
    assert result["certificate_before"]["seed"] == certificate["seed"] > result["seed"]
    for estimate in certificate["yield_"].values():
        assert TARGET <= estimate["lower"] <= estimate["value"] <= estimate["upper"] < 0.996
    assert all(price < 0 for price in result["multipliers"].values())  # both requirements bind
    assert result["seed"] == 0 and result["versions"]["rvjax"] == rvjax.__version__
    for shares in result["shares"]["after"].values():
        assert sum(shares.values()) == pytest.approx(1.0)


def test_allocate_writes_tables_and_pictures(answered):
    _, out = answered
    assert (out / "study.toml").read_text() == SMALL
    result = json.loads((out / "result.json").read_text())

    def table(name, *keys):
        rows = list(csv.DictReader((out / f"{name}.csv").read_text().splitlines()))
        return {tuple(row[key] for key in keys): row for row in rows}

    rows = table("tolerances", "error")
    moved = rows.pop(("middles moved",))
    assert float(moved["cost after"]) == pytest.approx(result["cost"]["middles"]) and moved["unit"] == ""
    middle = sum(result["tolerances"]["equidistant_modification"]["after"][end] for end in ("lower", "upper")) / 2
    assert float(moved["cost after"]) == pytest.approx(0.1 * abs(middle) / 1e-6) and abs(middle) > 1e-6
    assert [row["unit"] for row in rows.values()] == [
        {"m": "um", "rad": "arcmin"}[item["unit"]] for item in result["tolerances"].values()
    ]
    row = rows["bearing_clearance",]
    assert [float(row[key]) for key in ("lower before", "upper before")] == [4, 12]
    for key in ("lower", "upper"):
        assert float(row[f"{key} after"]) == pytest.approx(
            1e6 * result["tolerances"]["bearing_clearance"]["after"][key]
        )
    costs = [float(row["cost after"]) for row in rows.values() if row["cost after"]]
    total = sum(costs) + float(moved["cost after"])
    assert total == pytest.approx(result["cost"]["after"]) and row["grade"] == ""
    graded = sum(float(row["cost graded"] or 0) for row in (*rows.values(), moved))
    assert graded == pytest.approx(result["graded"]["cost"])
    sizes = table("sizes", "error")
    assert {error for (error,) in sizes} == {row["error"] for row in result["sizes"]} == set(result["tolerances"])
    clearance = result["tolerances"]["bearing_clearance"]["after"]
    assert float(sizes["bearing_clearance",]["upper [um]"]) == pytest.approx(2e6 * clearance["upper"])  # diametral
    assert float(sizes["equidistant_modification",]["nominal [mm]"]) == round(-0.02 + 1e3 * middle, 3)  # from -20 um
    influence = table("influence", "error", "response")
    assert influence["disc_runout", "transmission_error"]["slope"] == ""  # no slope, which is not zero
    assert float(influence["disc_runout", "lost_motion"]["slope"]) > 0
    assert influence["crank_phase", "transmission_error"]["unit of the slope"] == "arcmin/arcmin"
    row = influence["bearing_clearance", "transmission_error"]
    found = result["influence"]["transmission_error"]
    assert float(row["slope"]) == pytest.approx(found["slopes"]["bearing_clearance"] * um / arcmin)
    row, part = influence["crank_eccentricity", "transmission_error"], found["shares"]["crank_eccentricity"]
    assert row["slope"] == "" and float(row["slope of a unit, rms"]) > 0  # peak to peak: both ways alike
    assert [float(row[f"share{end}"]) for end in (" of variance", ", lower end", ", upper end")] == pytest.approx(
        [part[end] for end in ("value", "lower", "upper")]
    )
    assert 0 < part["lower"] < result["shares"]["after"]["transmission_error"]["crank_eccentricity"] < part["upper"]
    assert sum(float(influence[e, "misfit"]["share of variance"] or 0) for (e,) in rows) == pytest.approx(1)
    row = table("requirements", "requirement")["lost_motion",]
    assert [float(row[key]) for key in ("lower limit", "upper limit")] == [-1, 1] and row["unit"] == "arcmin"
    assert TARGET <= float(row["after, lower end"]) < float(row["after"]) < 1 and row["met after"] == "1"
    price = result["multipliers"]["lost_motion"]
    assert float(row["shadow price per unit"]) == pytest.approx(price * 2.908882086657216e-4)
    text = (out / "summary.txt").read_text()
    for words in (
        "OPTIMAL",
        "+-6.50 um",
        "8.00 +-4.00 um",
        "shadow price",
        f"{UNITS:,} independent units, 0 failed",
        "joint yield: 97.",
        "no joint_target set",
        "no slope: raising and lowering the error act alike",
        "Negative lost_motion in",
        "Not modelled: pins, flanks",
    ):
        assert words in text
    assert "Doubtful" not in text
    own = text.partition("Influence on misfit:\n")[2].partition("\n\n")[0].split("\n")
    listed = [float(line.split("%")[0].split()[-1]) for line in own[2:-1]]
    assert listed == sorted(listed, reverse=True) and 3 <= len(listed) <= 6 and listed[-1] > 0
    assert sum(listed) == pytest.approx(100, abs=1) and re.fullmatch(r"\d+ without .*influence.csv\)", own[-1])
    assert max(map(len, own)) < 80  # of a drive 386 characters, when one table had all responses
    for name in PICTURES:
        picture = matplotlib.image.imread(out / f"{name}.png")
        assert picture.shape[1] > 800 and picture.std() > 0.02  # something is drawn
    assert sorted(p.name for p in out.parent.iterdir()) == ["out", "small.toml"]  # no scratch folder is left


def test_the_influences_are_those_of_the_error_budget(answers, answered):
    """Of the same tolerances, from other units: apart by at most four of both standard errors."""
    found = answers[SMALL]
    asked = dataclasses.replace(found.study, tolerances=found.allocation.tolerances)
    budget = scalar_budget(asked, "misfit", samples=256).influence
    for field, share in found.after.influence["misfit"].shares.items():
        other = budget.shares[field]
        assert abs(share.value - other.value) <= 4 * math.hypot(share.error, other.error), field
    assert sum(share.value > 0.01 for share in budget.shares.values()) == 4


def test_allocate_tells_machines_what_it_wrote(answered, here, monkeypatch, capsys):
    monkeypatch.setattr(rvjax.render, "write_files", lambda files, folder, **_: folder)  # as written by the test above
    (here / "small.toml").write_text(SMALL)
    assert cli.main(["allocate", "small.toml", "--quiet", "--results", "new", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told.pop("results") == "new"
    written = json.loads((answered[1] / "result.json").read_text())
    assert told == written


def test_an_answer_is_read_in_the_unit_that_was_asked(answers, answered, here):
    asked = SMALL.replace('upper = "1 arcmin"', 'upper = "60 arcsec"', 1)
    old = answers[SMALL]
    found = dataclasses.replace(old, study=rvjax.study.parse_study(asked, name="x", solve=False))
    before, after = report_on(old).text(), report_on(found).text()
    assert "<= 60 arcsec" in after and "/arcsec" in after and "<= 60 arcsec" not in before
    own = r"Influence on transmission_error:\n.*\n-+\ncrank_eccentricity .* no slope \[rms ([\d.]+) arc"
    slopes = [float(re.search(own, words).group(1)) for words in (before, after)]
    assert slopes[1] == pytest.approx(60 * slopes[0], abs=0.006)


def test_an_unchanged_study_is_answered_from_its_folder(answered, undrawn, here, capsys, monkeypatch):
    def no_answer(*_, **__):
        raise ValueError("computed anew")

    (here / "small.toml").write_text(SMALL)
    assert cli.main(["allocate", "small.toml", "--quiet", "--results", "results/small-2"]) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(rvjax.commands.allocate.answer, "answer", no_answer)
    assert cli.main(["allocate", "small.toml", "--results", "results/small-2"]) == 0
    (here / "results" / "small").mkdir()
    (here / "results" / "small" / "study.toml").write_text(SMALL)  # half a folder is none
    assert cli.main(["allocate", "small.toml"]) == 0
    found = capsys.readouterr()
    assert "Unchanged since results/small-2 was written" in found.out and "--fresh" in found.out
    assert found.out.count(first.split("Results: ")[0].strip()) == 2 and found.err == ""
    result = here / "results" / "small-2" / "result.json"
    stale = json.loads(result.read_text())
    for arguments, change in (
        (["small.toml", "--fresh"], stale),
        (["other.toml"], stale),
        (["small.toml"], stale | {"versions": stale["versions"] | {"rvjax": "0.0"}}),
        (["small.toml"], ["damaged"]),
    ):
        (here / "other.toml").write_text(SMALL + "\n")
        result.write_text(json.dumps(change))
        assert cli.main(["allocate", *arguments, "--quiet"]) == 2
        assert "computed anew" in capsys.readouterr().err
    assert answer._names_files({"tolerances": {"x": {"values": [{"file": "a.csv"}]}}})
    assert not answer._names_files({"tolerances": {"x": {"values": [1, "file"]}}})


def test_a_fresh_result_takes_the_place_of_the_stored_one(answers, undrawn, here, capsys, monkeypatch):
    """Of the same study only; files of the user stay, the page of the old result does not; nothing on failure."""
    (here / "small.toml").write_text(SMALL)
    command = ["allocate", "small.toml", "--quiet"]
    assert cli.main(command) == 0
    place = here / "results" / "small"
    written = sorted(path.name for path in place.iterdir())
    (place / "notes.txt").write_text("of the user")
    (place / "report.html").write_text("of the old result")

    def stale():
        (place / "summary.txt").write_text("old")

    def fails(*_, **__):
        raise OSError("disk full")

    swap = types.SimpleNamespace(replace=fails)  # of the folders; that of files is another one
    for owner, name, bad in (
        (rvjax.commands.allocate.answer, "answer", fails),
        (Report, "json", fails),
        (render, "os", swap),
    ):
        stale()
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, bad)
            assert cli.main([*command, "--fresh"]) == 2 and "disk full" in capsys.readouterr().err
        assert (place / "summary.txt").read_text() == "old" and (place / "notes.txt").exists(), name
        assert [path.name for path in place.parent.iterdir() if "part" not in path.name] == ["small"], name
    for more in ([], ["--results", "results/small"]):
        stale()
        assert cli.main([*command, "--fresh", *more]) == 0
        assert "Results: results/small\n" in capsys.readouterr().out
        assert "OPTIMAL" in (place / "summary.txt").read_text()
        assert sorted(path.name for path in place.iterdir()) == sorted([*written, "notes.txt"])
        assert [path.name for path in place.parent.iterdir()] == ["small"]
    (here / "small.toml").write_text(SMALL + "\n")  # another study of that name
    answers[SMALL + "\n"] = answers[SMALL]
    assert cli.main([*command, "--fresh", "--results", "results/small"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert cli.main([*command, "--fresh"]) == 0 and "Results: results/small-2\n" in capsys.readouterr().out


@pytest.mark.parametrize(("text", "factor"), [(SMALL, 4), pytest.param(FLAT, 2, marks=pytest.mark.long)])
def test_an_answer_solves_about_as_many_units_as_check_tells(answers, text, factor):
    """Passes and certificates are those of rv-40e, with a mid-point at no cost; the small study has its own."""
    if text not in answers:
        rvjax.commands.allocate.answer.answer(rvjax.study.parse_study(text, name="x"))
    study, allocation = answers[text].study, answers[text].allocation
    counted = (allocation.graded or allocation).evaluations
    told, middles = solved_units(study), bool(study.middles)
    assert list(told) == [SEARCHING, CERTIFYING, SAMPLING, PRICING]  # the order in which they run
    passes, certificates = counted["search"] / QUICK, counted["certificates"]
    certificates /= units_of(study.requirements, study.certificate_samples)
    assert PASSES / factor < passes < factor * PASSES
    assert CERTIFICATES[middles] / factor <= certificates <= factor * CERTIFICATES[middles]
    assert told[SEARCHING] / factor < counted["search"] + counted["certificates"] < factor * told[SEARCHING]
    assert told[CERTIFYING] == answers[text].certificate_before.samples
    fresh = [len(side.values["misfit"]) for side in (answers[text].before, answers[text].after)]
    assert told[SAMPLING] == sum(count for count in fresh if count != study.certificate_samples)
    assert told[PRICING] > (len(answers[text].cost_curve) - 1) * study.samples


def test_the_curve_of_costs_passes_through_the_study(answers, answered):
    """Certified yields and costs of cheapest tolerances, this study's among them, which two targets would set apart."""
    found = answers[SMALL]
    star = (min(e.value for e in found.allocation.certificate.yield_.values()), found.allocation.cost)
    assert star in found.cost_curve and len(found.cost_curve) >= 4
    yields, costs = zip(*found.cost_curve)
    assert list(yields) == sorted(yields) and list(costs) == sorted(costs)


PLAY = """
[design]
base = "rv-20e"
[tolerances.disc_runout]
lower = "0 um"
upper = "15 um"
[tolerances.pin_radius]
half_width = "4 um"
[cost.pin_radius]
scale = 1
reference = "4 um"
finest = "1 um"
coarsest = "20 um"
[requirement.lost_motion]
upper = "2 arcmin"
[run]
samples = 1024
certificate_samples = 16000
"""


def test_infeasible_requirements_are_refused_with_the_shortfall(undrawn, here, capsys, monkeypatch):
    monkeypatch.setattr(forecast, "OF_QUICK", dataclasses.replace(forecast.OF_QUICK, before=1000))
    text = PLAY.replace('upper = "2 arcmin"', 'upper = "0.1 arcmin"')
    (here / "hard.toml").write_text(text)
    assert cli.main(["allocate", "hard.toml", "--quiet"]) == 1
    printed = capsys.readouterr().out
    assert "INFEASIBLE" in printed and "limit of lost_motion would have to move by" in printed
    result = json.loads((here / "results" / "hard" / "result.json").read_text())
    assert not result["feasible"] and 0 < result["shortfall"]["lost_motion"] < 3e-4
    assert result["certificate_before"]["samples"] == 1000 < result["certificate"]["samples"]
    assert cli.main(["allocate", "hard.toml", "--quiet"]) == 1
    assert "Unchanged since results/hard" in capsys.readouterr().out
    assert cli.main(["report", "hard.toml", "--quiet", "--output", "hard.html"]) == 1
    text = Path("hard.html").read_text("utf-8")
    assert "✘ No tolerances within the process ranges" in text and "✘ not met" in text
    assert re.search(r"lost motion would .* by 0\.\d+ arcmin", text)
    assert Path("results/hard").is_dir() and not Path("results/hard-2").exists()


def test_what_no_tolerance_can_meet_is_told_before_the_search(monkeypatch):
    """A line for the caller, and no search yet; in Python nobody prints it."""
    text, told = PLAY.replace('upper = "2 arcmin"', 'upper = "-1 arcmin"'), []

    def searching(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(rvjax.commands.allocate.answer, "allocate", searching)
    with pytest.raises(KeyboardInterrupt):
        rvjax.commands.allocate.answer.answer(rvjax.study.parse_study(text, name="x"), tell=told.append)
    assert len(told) == 1
    assert re.fullmatch(r"lost_motion: .*, above -1 arcmin, at the mid-points: no tolerance can meet this", told[0])


@pytest.mark.long
def test_a_model_that_is_not_asked_draws_nothing(here, capsys):
    """The RV-20E has no bearing stiffness, which the transmission error under a torque needs."""
    (here / "play.toml").write_text(PLAY)
    assert cli.main(["allocate", "play.toml", "--results", "out", "--quiet"]) == 0, capsys.readouterr()
    assert sorted(p.stem for p in Path("out").glob("*.png")) == [
        "cost_against_yield", "histogram_lost_motion", "variance_shares",
    ]  # fmt: skip
    assert cli.main(["report", "play.toml", "--output", "page.html", "--quiet"]) == 0


def test_a_failure_while_writing_leaves_nothing(answered, here, monkeypatch):
    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(Report, "json", fail)
    with pytest.raises(OSError, match="disk full"):
        write_files(Report("x", ()).folder(), here / "results" / "x")
    assert list((here / "results").iterdir()) == []


def test_results_folders_are_never_overwritten(here):
    assert str(results_folder(None, "x")) == "results/x"
    (here / "results" / "x").mkdir(parents=True)
    (here / "results" / "x-2").mkdir()
    assert str(results_folder(None, "x")) == "results/x-3"
    (here / "results" / "x-7").write_text("a file")
    (here / "results" / "x-10").mkdir()
    assert [folder.name for folder in numbered_folders("x")] == ["x", "x-2", "x-10"]
