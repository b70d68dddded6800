"""The command line from end to end on a small study: answer, page, refusal, bad input; nothing half-written.

The page is looked at in a real browser where one is installed.
"""

import csv
import dataclasses
import html.parser
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import resources
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import rvjax
import rvjax.report.surrogate
import rvjax.report.worst_units
import rvjax.study.answer
from rvjax import cli, published
from rvjax.report import again, folders, page, text
from rvjax.study.about import About
from rvjax.study.answer import CERTIFICATES, CERTIFYING, PASSES, PRICING, SAMPLING, SEARCHING, solved_units
from rvjax.tolerances.propagation.moments import CentralMoments
from rvjax.tolerances.propagation.sampled import Sampled

GOOD = (resources.files("rvjax.study") / "embedded" / "rv-40e.toml").read_text("utf-8")
SMALL = GOOD.replace("angles = 64 ", "angles = 12 ").replace("samples = 16384", "samples = 1024")
SMALL = SMALL.replace("certificate_samples = 1_000_000", "certificate_samples = 60_000")
MIDDLE = 'lower = "-20 um"\nupper = "20 um"\n'
SMALL = SMALL.replace(MIDDLE, MIDDLE + 'cost = 0.01\nper = "1 um"\n')  # so that the answer pays for a middle
HISTOGRAMS = ["histogram_transmission_error", "histogram_misfit", "histogram_lost_motion"]
PICTURES = ["curves", *HISTOGRAMS, "variance_shares", "cost_against_yield"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module", autouse=True)
def answers():
    """Every study is answered once, whichever command asks."""
    found, real = {}, rvjax.study.answer.answer

    def once(question, *, progress=False, journal=None):
        key = question.text
        if key not in found:
            found[key] = real(question, progress=progress, journal=journal)
        return dataclasses.replace(found[key], study=question)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rvjax.study.answer, "answer", once)
        patch.setattr(rvjax.report.surrogate, "_POINTS", 2)  # sooner
        yield found


@pytest.fixture(scope="module")
def answered(tmp_path_factory):
    """One allocation through the command line, shared by the tests that look at what it wrote."""
    folder = tmp_path_factory.mktemp("allocate")
    (folder / "small.toml").write_text(SMALL)
    code = cli.main(["allocate", str(folder / "small.toml"), "--results", str(folder / "out"), "--quiet"])
    return code, folder / "out"


def test_allocate_answers(answered):
    code, out = answered
    assert code == 0
    result = json.loads((out / "result.json").read_text())
    assert result["status"] == "OPTIMAL"
    assert result["cost"]["after"] < 0.8 * result["cost"]["before"]
    certificate = result["certificate"]
    assert certificate["samples"] == 60_000 and certificate["failed"] == 0
    assert result["certificate_before"]["seed"] == certificate["seed"] > 1
    for estimate in certificate["yield_"].values():
        assert 0.9973 <= estimate["lower"] <= estimate["value"] <= estimate["upper"] < 0.9999
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
    assert float(moved["cost after"]) == pytest.approx(0.01 * abs(middle) / 1e-6) and abs(middle) > 1e-6
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
    influence = table("influence", "error", "response")
    assert influence["disc_runout", "transmission_error"]["slope"] == ""  # not seen, which is not zero
    assert float(influence["disc_runout", "lost_motion"]["slope"]) > 0
    row = influence["crank_phase", "transmission_error"]
    assert row["unit of the slope"] == "arcmin/arcmin"
    assert float(row["slope"]) == pytest.approx(result["sensitivities"]["transmission_error"]["crank_phase"])
    assert sum(float(influence[e, "misfit"]["share of variance"] or 0) for (e,) in rows) == pytest.approx(1)
    row = table("requirements", "requirement")["lost_motion",]
    assert [float(row[key]) for key in ("lower limit", "upper limit")] == [-1, 1] and row["unit"] == "arcmin"
    assert 0.9973 <= float(row["after, lower end"]) < float(row["after"]) < 1 and row["met after"] == "yes"
    price = result["multipliers"]["lost_motion"]
    assert float(row["shadow price per unit"]) == pytest.approx(price * 2.908882086657216e-4)
    text = (out / "summary.txt").read_text()
    for words in (
        "OPTIMAL",
        "+-6.50 um",
        "8.00 +-4.00 um",
        "shadow price",
        "60,000 fresh units, 0 failed",
        "all requirements at once: 99.",
        "no joint_target asks for it",
        "not seen: the model asked does not read this error",
        "% of the units, interference: no play at all",
        "Left out: pins, flanks and the first stage",
    ):
        assert words in text
    assert "Doubtful" not in text
    for name in PICTURES:
        picture = matplotlib.image.imread(out / f"{name}.png")
        assert picture.shape[1] > 800 and picture.std() > 0.02  # something is drawn
    assert sorted(p.name for p in out.parent.iterdir()) == ["out", "small.toml"]  # no scratch folder is left


def test_allocate_tells_machines_what_it_wrote(answered, here, monkeypatch, capsys):
    monkeypatch.setattr(folders, "write", lambda answer, folder: folder)  # as written by the test above
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
    before, after = text.summary(old), text.summary(found)
    assert "<= 60 arcsec" in after and "/arcsec" in after and "<= 60 arcsec" not in before
    slopes = [float(re.search(r"crank_phase +([\d.]+) arc", words).group(1)) for words in (before, after)]
    assert slopes[1] == pytest.approx(60 * slopes[0], abs=0.006)


def test_an_unchanged_study_is_answered_from_its_folder(answered, here, capsys, monkeypatch):
    def no_answer(*_, **__):
        raise ValueError("computed anew")

    (here / "small.toml").write_text(SMALL)
    assert cli.main(["allocate", "small.toml", "--quiet", "--results", "results/small-2"]) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(rvjax.study.answer, "answer", no_answer)
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
    assert again._names_files({"tolerances": {"x": {"values": [{"file": "a.csv"}]}}})
    assert not again._names_files({"tolerances": {"x": {"values": [1, "file"]}}})


def test_two_answers_side_by_side(answered, answers, here, capsys):
    _, out = answered
    other = json.loads((out / "result.json").read_text())
    tolerance, share = other["tolerances"]["crank_phase"]["after"], other["shares"]["after"]["misfit"]["crank_phase"]
    tolerance["upper"] *= 1.25
    tolerance["lower"] *= 1.25
    del other["tolerances"]["pin_radius"], other["certificate"]["cpk"]
    other |= {"seed": 7, "status": "NOT_CERTIFIED"}
    (here / "b.json").write_text(json.dumps(other))
    assert cli.main(["compare", str(out), "b.json"]) == 0
    lines = [re.split(r"\s{2,}", line.strip()) for line in capsys.readouterr().out.splitlines()]
    rows = {line[0]: line[1:] for line in lines}
    assert rows["verdict"] == ["OPTIMAL", "NOT_CERTIFIED", "differs"]
    assert rows["seed"] == ["0", "7", "differs"] and rows["study"] == ["small", "small"]
    assert rows["version of rvjax"] == [rvjax.__version__] * 2
    assert rows["crank_phase, half-width"][2] == "+25.0 %"
    assert rows["pin_radius, half-width"] == ["2 um", "-", "differs"]
    assert rows["bearing_clearance, middle"] == ["8 um", "8 um"]
    assert rows["misfit, limits"] == ["<= 30 um"] * 2
    assert rows["misfit, Cpk"][1:] == ["-", "differs"]
    assert cli.main(["compare", str(out), "b.json", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    half = answers[SMALL].allocation.tolerances.crank_phase.half_width
    phase = found["tolerances after"]["crank_phase, half-width"]
    assert phase == {"unit": "rad", "a": pytest.approx(half), "b": pytest.approx(1.25 * half), "same": False}
    seen = found["variance of misfit, after"]["crank_phase"]
    assert seen == {"unit": "share", "a": share, "b": share, "same": True}
    assert found["cost"]["after"]["same"] is True
    written = csv.DictReader((out / "tolerances.csv").read_text().splitlines())
    total = sum(float(row["cost after"] or 0) for row in written)
    assert found["cost"]["after"]["a"] == pytest.approx(total, rel=1e-12)
    assert 0 < found["cost"]["after, of it middles moved"]["a"] < total


@pytest.mark.parametrize("content", [None, "{", "[]", '{"study": 1}', "\0"])
def test_what_is_no_result_is_not_compared(answered, here, capsys, content):
    if content is not None:
        (here / "result.json").write_text(content)
    assert cli.main(["compare", str(answered[1]), "."]) == 2
    message = capsys.readouterr().err.strip()
    assert message.startswith("rvjax: error: .: ") and "\n" not in message


def test_a_result_that_lacks_a_part_is_not_compared(answered, here, capsys):
    broken = json.loads((answered[1] / "result.json").read_text())
    broken["tolerances"]["pin_radius"] = "2 um"
    (here / "b.json").write_text(json.dumps(broken))
    for form in ("text", "json"):
        assert cli.main(["compare", "b.json", str(answered[1]), "--format", form]) == 2
        assert "results of rvjax allocate" in capsys.readouterr().err


def test_an_answer_solves_about_as_many_units_as_check_tells(answers, answered):
    """Within a factor of two: passes and certificates are those of the searches before, this one has its own."""
    study, allocation = answers[SMALL].study, answers[SMALL].allocation
    counted = (allocation.graded or allocation).evaluations
    told, middles = solved_units(study), bool(study.middles)
    passes, certificates = counted["search"] / study.samples, counted["certificates"] / study.certificate_samples
    assert PASSES[middles] / 2 < passes < 2 * PASSES[middles]
    assert CERTIFICATES[middles] / 2 <= certificates <= 2 * CERTIFICATES[middles]
    assert told[SEARCHING] / 2 < counted["search"] + counted["certificates"] < 2 * told[SEARCHING]
    assert told[CERTIFYING] == answers[SMALL].certificate_before.samples
    fresh = [len(side.values["misfit"]) for side in (answers[SMALL].before, answers[SMALL].after)]
    assert told[SAMPLING] == sum(count for count in fresh if count != study.certificate_samples)
    assert told[PRICING] > (len(answers[SMALL].cost_curve) - 1) * study.samples


def test_the_curve_of_costs_passes_through_the_study(answers, answered):
    """Certified yields and costs of cheapest tolerances, this study's among them, which two targets would set apart."""
    found = answers[SMALL]
    star = (min(e.value for e in found.allocation.certificate.yield_.values()), found.allocation.cost)
    assert star in found.cost_curve and len(found.cost_curve) >= 4
    yields, costs = zip(*found.cost_curve)
    assert list(yields) == sorted(yields) and list(costs) == sorted(costs)


def test_infeasible_requirements_are_refused_with_the_shortfall(here, capsys):
    text = SMALL.replace('upper = "1 arcmin"', 'upper = "0.2 arcmin"')
    (here / "hard.toml").write_text(text)
    assert cli.main(["allocate", "hard.toml", "--quiet"]) == 1
    printed = capsys.readouterr().out
    assert "INFEASIBLE" in printed and "limit of transmission_error would have to move by" in printed
    result = json.loads((here / "results" / "hard" / "result.json").read_text())
    assert not result["feasible"] and 0 < result["shortfall"]["transmission_error"] < 1e-4
    assert result["shortfall"]["misfit"] == 0
    assert cli.main(["allocate", "hard.toml", "--quiet"]) == 1
    assert "Unchanged since results/hard" in capsys.readouterr().out
    assert cli.main(["report", "hard.toml", "--quiet", "--output", "hard.html"]) == 1
    text = Path("hard.html").read_text("utf-8")
    assert "✘ No tolerances within the process ranges" in text and "✘ not met" in text
    assert re.search(r"limit of transmission error would have to move by 0\.\d+ arcmin", text)
    assert Path("results/hard").is_dir() and not Path("results/hard-2").exists()


def test_an_answer_whose_units_all_fail_is_written_and_says_so(answers, answered, here):
    """The small study, with no valid unit at the finest tolerances."""
    old = answers[SMALL]
    refused = dict(feasible=False, status="INFEASIBLE", shortfall=dict.fromkeys(old.allocation.shortfall, math.inf))
    allocation = dataclasses.replace(old.allocation, **refused, graded=None)
    failed = {name: np.full_like(values, np.nan) for name, values in old.after.values.items()}
    unknown = {name: dict.fromkeys(of_field, math.nan) for name, of_field in old.after.shares.items()}
    after = dataclasses.replace(old.after, values=failed, shares=unknown, sensitivities=unknown)
    new = dataclasses.replace(old, allocation=allocation, after=after, cost_curve=[])
    folders.write(new, here / "failed")
    result = json.loads((here / "failed" / "result.json").read_text())
    assert set(result["shortfall"].values()) == {None} == set(result["shares"]["after"]["misfit"].values())
    assert "limit of misfit would do at no value: too many units fail" in (here / "failed" / "summary.txt").read_text()
    assert "The limit of misfit would do at no value: too many units fail." in page.page(new, "small.toml")


def test_a_study_that_asks_for_no_share_of_units_has_a_page(answers, answered, here):
    """The small study with the means of its sample units in place of its yields; `pins.csv` lies beside the study."""
    folder, key = here / "elsewhere", "[tolerances.pin_radius]\n"
    folder.mkdir()
    (folder / "pins.csv").write_text("deviation\n-1.5\n0.5\n1\n")
    measured = 'distribution = "empirical"\nvalues = {file = "pins.csv", column = "deviation", unit = "um"}\n'
    start = SMALL.index("[requirement.")
    asked = (
        SMALL[start:]
        .replace("\nupper", "\nmean_upper")
        .replace("\nlower", "\nmean_lower")
        .replace("target = 0.9973\n", "")
    )
    (folder / "able.toml").write_text(SMALL[:start].replace(key, key + measured) + asked)
    question, old = rvjax.study.load("elsewhere/able.toml"), answers[SMALL]
    np.testing.assert_allclose(question.tolerances.pin_radius.law.values, [-1.5e-6, 0.5e-6, 1e-6])

    def judged(statistics, values):
        seen = {
            n: Sampled([CentralMoments.of(v[~np.isnan(v)])], None, np.array([v.size]), 0.95) for n, v in values.items()
        }
        verdicts = {name: item.verdict(seen[name]) for name, item in question.requirements.items()}
        nothing = dict.fromkeys(("yield_", "ppm", "cp", "cpk", "joint_yield"))
        return dataclasses.replace(statistics, verdicts=verdicts, **nothing)

    certificate = judged(old.allocation.certificate, old.after.values)
    allocation = dataclasses.replace(old.allocation, certificate=certificate, graded=None)
    curve = rvjax.study.answer._cost_curve(question, question.response(), allocation, None)
    before = judged(old.certificate_before, old.before.values)
    new = dataclasses.replace(old, study=question, allocation=allocation, certificate_before=before, cost_curve=curve)
    found = page.page(new, "elsewhere/able.toml")
    assert curve == [] and "Cheapest cost for each yield" not in found and "✔ met" in found
    assert found.count("mean, &lt; 0.27 % failed") == 3 == text.summary(new).count("mean, < 0.27 % failed")


def test_a_model_that_is_not_asked_draws_nothing(here, capsys):
    """The RV-20E has no bearing stiffness, which the transmission error under a torque needs."""
    text = """
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
certificate_samples = 16384
"""
    (here / "play.toml").write_text(text)
    assert cli.main(["allocate", "play.toml", "--results", "out", "--quiet"]) == 0, capsys.readouterr()
    assert sorted(p.stem for p in Path("out").glob("*.png")) == [
        "cost_against_yield", "histogram_lost_motion", "variance_shares",
    ]  # fmt: skip
    assert cli.main(["report", "play.toml", "--output", "page.html", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["allocate", "absent.toml"], ["absent.toml", "no such study file"]),
        (["allocate", "rv-41e"], ["rv-41e", "rv-40e"]),
        (["allocate", "bad.toml"], ["bad", "tolerances.crank_phase.half_width", "5 kg", "arcmin"]),
        (["allocate", "good.toml", "--results", "taken"], ["taken", "exists"]),
        (["allocate", "folder.toml"], ["folder.toml"]),
        (["allocate", "good.toml", "--results", "good.toml/out"], ["good.toml", "not a folder"]),
        (["report", "good.toml", "--output", "page.pdf"], ["page.pdf", ".html"]),
        (["report", "good.toml", "--output", "absent/page.html"], ["absent/page.html", "no such folder"]),
        (["report", "good.toml", "--output", "taken.html"], ["taken.html", "is a folder"]),
        (["report", "good.toml", "--output", f"{'x' * 250}.html"], ["xxx", "too long"]),
        (["report", "absent.toml"], ["absent.toml", "no such study file"]),
        (["allocate", "good.toml", "--colour"], ["--colour"]),
        (["alocate"], ["alocate"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(here, capsys, arguments, words):
    (here / "bad.toml").write_text(SMALL.replace('"5 arcmin"\n\n[tolerances.disc', '"5 kg"\n\n[tolerances.disc'))
    (here / "good.toml").write_text(SMALL)
    (here / "taken").mkdir()
    (here / "taken.html").mkdir()
    (here / "folder.toml").mkdir()
    before = sorted(here.rglob("*"))
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    message = captured.err.strip().splitlines()[-1]  # argparse prints its usage first
    for word in words:
        assert word in message
    assert "Traceback" not in captured.err and captured.out == ""
    assert sorted(here.rglob("*")) == before


class Tags(html.parser.HTMLParser):
    """Counts elements and refuses one that is closed in the wrong order."""

    VOID = ("br", "meta", "img", "rect", "path", "circle")

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.headings = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert tag in self.VOID or self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("h1", "h2"):
            self.headings.append(data)


@pytest.fixture(scope="module")
def written(answered, tmp_path_factory):
    """The page of the small study."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "small.toml").write_text(SMALL)
    code = cli.main(["report", str(folder / "small.toml"), "--output", str(folder / "page.html"), "--quiet"])
    assert code == 0 and sorted(p.name for p in folder.iterdir()) == ["page.html", "small.toml"]
    return folder / "page.html"


def test_the_page_holds_the_answer_and_needs_nothing_else(written, answered):
    text = written.read_text("utf-8")
    tags = Tags(text)
    sections = ["Requirements", "Tolerances and cost", "What if", "The reducer", "Which error matters"]
    sections += ["Who owns the error", "Worst units", "How exactly it was computed", "How to get this page again"]
    assert tags.headings == ["small", *sections]
    images = [attrs for tag, attrs in tags.seen if tag == "img"]
    assert len(images) == len(PICTURES) + 2  # that of the error budget, and the drawing of the reducer
    assert all(image["src"].startswith("data:image/svg+xml;base64,") and image["alt"] for image in images)
    assert not {tag for tag, _ in tags.seen} & {"link", "iframe", "base", "object"}
    assert [attrs.get("type") for tag, attrs in tags.seen if tag == "script"] == ["application/json", None]
    assert len({image["alt"] for image in images}) == len(images)
    assert not re.search(r"\b(?:fetch|XMLHttpRequest|WebSocket|import)\b", text[text.index("<script") :])
    assert not re.search(r"(?:src|href)=['\"](?!data:)|url\(|@import", text)
    result = json.loads((answered[1] / "result.json").read_text())
    shown = [f"{result['cost']['after']:.3f}", "✔ met", "IT6", "±6.50 µm", "60,000", "seed", rvjax.__version__]
    shown += [
        "no level of it like this was measured",
        "first order, float64",
        "rvjax report ",
        "certificate_samples = 60_000",
        "No maker publishes these values",
    ]
    for words in shown:
        assert words in text, words
    assert re.search(r"<dt>computed</dt><dd>20\d\d-\d\d-\d\d</dd>", text) and "<dt>author</dt>" not in text
    certificate = result["certificate"]
    for found in (certificate["cp_estimate"]["lost_motion"], certificate["cpk_estimate"]["misfit"]):
        if found["value"] is not None:
            assert f"{found['value']:.4g}</span><small>[{found['lower']:.4g}, {found['upper']:.4g}]" in text


def test_the_worst_units_are_the_worst_and_can_be_replayed(answers, answered):
    answer = answers[SMALL]
    found = rvjax.report.worst_units.worst_units(answer)
    assert [unit.requirement for unit in found] == [n for n in answer.study.requirements for _ in range(2)]
    side = answer.after
    for name in answer.study.requirements:
        assert found[[u.requirement for u in found].index(name)].values[name] == np.nanmax(side.values[name])
    unit = found[0]
    errors = rvjax.tolerances.sample(side.tolerances, unit.index, seed=side.seed)
    np.testing.assert_allclose(unit.errors["crank_phase"], errors.crank_phase, rtol=1e-12)
    assert {f: values.size for f, values in unit.errors.items()}["disc_bore"] == 8
    failed = dataclasses.replace(side, failed={"NOT_ASSEMBLABLE": 7})
    text = page.page(dataclasses.replace(answer, after=failed), "x.toml")
    assert "Unit 7 failed" in text and "cannot be put together" in text


def test_an_answer_says_how_many_units_failed_why_and_how_they_count(answers, answered):
    found = answers[SMALL]
    failures = dict(
        failed=5, failures={"CONTACT_OVERLOAD": 2, "MAX_STEPS": 3}, examples={"CONTACT_OVERLOAD": 4, "MAX_STEPS": 612}
    )
    certificate = dataclasses.replace(found.allocation.certificate, **failures)
    found = dataclasses.replace(found, allocation=dataclasses.replace(found.allocation, certificate=certificate))
    kinds = "2 CONTACT_OVERLOAD (unit 4), 3 MAX_STEPS (unit 612)"
    assert f"60,000 fresh units, 5 failed, each a reject in every yield: {kinds}" in text.summary(found)
    assert {key: text.as_json(found)["certificate"][key] for key in failures} == failures
    html = page.page(found, "x.toml")
    assert "5 failed, each a reject in every yield: 2 CONTACT_OVERLOAD (" in html and "the first is unit 612)" in html


def test_text_of_the_user_is_escaped(answers, answered):
    answer, hostile = answers[SMALL], """</pre><script>alert("1")</script>&amp;'"""
    about = About(title=hostile, author=hostile, revision=hostile)
    question = dataclasses.replace(answer.study, name=hostile, text=f"# {hostile}\n{SMALL}", about=about)
    text = page.page(dataclasses.replace(answer, study=question), f"{hostile}.toml")
    tags = Tags(text)
    assert "script" not in {tag for tag, _ in tags.seen}
    assert tags.headings[0] == hostile
    assert text.count("&lt;/pre&gt;&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&amp;amp;&#x27;") >= 7


def test_the_page_in_a_browser(written, tmp_path):
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on PATH")
    look = "onload = () => document.title = JSON.stringify({images: [...document.images].map(i => i.naturalWidth), "
    look += (
        "wide: document.documentElement.scrollWidth - innerWidth, tables: document.querySelectorAll('table').length})"
    )
    copy = tmp_path / "page.html"
    copy.write_text(written.read_text("utf-8").replace("</body>", f"<script>{look}</script></body>"), "utf-8")
    quiet = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    quiet += "--disable-component-update --disable-sync --window-size=500,900 --dump-dom"
    command = [browser, *quiet.split(), f"--user-data-dir={tmp_path}/profile", copy.as_uri()]
    environment = os.environ | {"HOME": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=True)
    seen = json.loads(re.search(r"<title>(.*?)</title>", done.stdout).group(1))
    assert len(seen["images"]) == len(PICTURES) + 2 and min(seen["images"]) > 300  # every picture was decoded
    assert seen["wide"] <= 0  # nothing sticks out of a narrow window
    assert seen["tables"] >= 5
    assert "the cheapest tolerances" in done.stdout and "±6.50" in done.stdout


def test_a_failure_while_writing_leaves_nothing(answered, here, monkeypatch):
    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(text, "summary", lambda answer: "text")
    monkeypatch.setattr(text, "as_json", fail)

    class Study:
        text = "x"

    class Answer:
        study = Study

    with pytest.raises(OSError, match="disk full"):
        folders.write(Answer, here / "results" / "x")
    assert list((here / "results").iterdir()) == []


def test_results_folders_are_never_overwritten(here):
    assert str(folders.results_folder(None, "x")) == "results/x"
    (here / "results" / "x").mkdir(parents=True)
    (here / "results" / "x-2").mkdir()
    assert str(folders.results_folder(None, "x")) == "results/x-3"


def test_version_and_module_entry():
    command = [sys.executable, "-m", "rvjax", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"rvjax {rvjax.__version__}"


def test_every_command_answers_machines(here, capsys, monkeypatch):
    """`--format json` everywhere; the older `--json` of two commands says the same."""
    about = tomllib.loads((resources.files("rvjax.cli") / "cli.toml").read_text())["command"]
    for name, command in about.items():
        assert command["options"]["--format"]["choices"] == ["text", "json"], name
    assert cli.main(["init", "new.toml", "--base", "rv-80e", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"study": "new.toml", "base": "rv-80e"}
    row = published.Comparison("a.b", "", 2.0, 2.0, "mm", "reproduced", "")
    monkeypatch.setattr(published, "reproduce", lambda say: [row])
    for option in (["--json"], ["--format", "json"]):
        assert cli.main(["reproduce", *option]) == 0
        assert json.loads(capsys.readouterr().out) == [row.as_json()]


def test_help_names_every_command(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for words in ("allocate", "report", "compare", "montecarlo", "reproduce", "tradeoff", "exit codes", "examples"):
        assert words in text
