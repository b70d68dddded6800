"""The page that `rvjax report` writes of a small study; it is looked at in a real browser where one is installed."""

import dataclasses
import html.parser
import json
import math
import os
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cli_study import PICTURES, SMALL, UNITS

import rvjax
import rvjax.commands.allocate.answer
from rvjax import cli, study
from rvjax.commands import forecast, report as command
from rvjax.commands.allocate import report_on, requirement_table
from rvjax.commands.cells import met_text
from rvjax.commands.forecast import targets
from rvjax.commands.report import ReportInputs, Shown, page_of, sliders
from rvjax.commands.report.page import WorstUnit, rows_of, worst_units
from rvjax.population.sample_statistics import CentralMoments, Sampled
from rvjax.render import write_files
from rvjax.study.study import About
from rvjax.tolerances import Estimate, Verdict, influences

pytestmark = pytest.mark.usefixtures("answers")


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
    sections = [
        "Result",
        "Limits of this result",
        "Requirements in detail",
        "Cost",
        "What if",
        "The reducer",
        "Which error matters",
    ]
    sections += ["Error budget", "Worst units", "Accuracy of the computation", "How to get this page again"]
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
    shown = [f"{result['cost']['after']:.3f}", "✔ met", "IT6", "±6.50 µm", f"{UNITS:,}", "seed", rvjax.__version__]
    shown += [
        "no level with these conditions was measured",
        "first order, float64",
        "rvjax report ",
        "Sizes for the drawing",
        "nominal [mm]",
        "certificate_samples = 20_000",
        "No maker publishes these values",
    ]
    for words in shown:
        assert words in text, words
    assert re.search(r"<dt>computed</dt><dd>20\d\d-\d\d-\d\d</dd>", text) and "<dt>author</dt>" not in text
    certificate = result["certificate"]
    for found in (certificate["cp_estimate"]["lost_motion"], certificate["cpk_estimate"]["misfit"]):
        if found["value"] is not None:
            assert f"{found['value']:.4g}</span><small>[{found['lower']:.4g}, {found['upper']:.4g}]" in text


def test_the_page_of_a_stored_answer_computes_no_answer_and_makes_no_folder(
    answered, undrawn, here, capsys, monkeypatch
):
    def no_answer(*_, **__):
        raise ValueError("computed again")

    (here / "small.toml").write_text(SMALL)
    shutil.copytree(answered[1], here / "results" / "small")
    monkeypatch.setattr(rvjax.commands.allocate.answer, "answer", no_answer)
    assert cli.main(["report", "small.toml", "--quiet"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "Report: results/small/report.html"
    assert [path.name for path in (here / "results").iterdir()] == ["small"]
    result = json.loads((here / "results" / "small" / "result.json").read_text())
    page = (here / "results" / "small" / "report.html").read_text("utf-8")
    assert f"{result['cost']['after']:.3f}" in page and "What if" in page and "Worst units" in page
    place = here / "results" / "small" / "report.html"
    before = place.read_bytes()
    assert cli.main(["report", "small.toml", "--quiet"]) == 0
    assert "Unchanged: results/small/report.html" in capsys.readouterr().out
    place.write_bytes(before.replace(b"Worst units", b"Worst Units"))  # a mark that a person would not see
    assert cli.main(["report", "small.toml", "--quiet", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["cost"] == result["cost"] and b"Worst Units" in place.read_bytes()
    assert cli.main(["report", "small.toml", "--quiet", "--fresh"]) == 0 and b"Worst units" in place.read_bytes()
    place.write_bytes(before[:-100])  # not to its end
    assert cli.main(["report", "small.toml", "--quiet"]) == 0 and place.read_bytes() == before
    dear = dataclasses.replace(forecast.OF_QUICK, sliders=False)
    monkeypatch.setattr(forecast, "OF_QUICK", dear)  # as if units took long
    assert cli.main(["report", "small.toml", "--quiet", "--output", "plain.html"]) == 0
    assert "rvjax report small.toml --sliders adds sliders" in Path("plain.html").read_text("utf-8")
    (here / "results" / "small" / "answer.npz").write_bytes(b"damaged")
    assert cli.main(["report", "small.toml", "--quiet"]) == 2
    assert "computed again" in capsys.readouterr().err


def test_a_costly_study_has_sliders_on_demand(here, answers, monkeypatch):
    """They take minutes, and their estimate is poor: the page is there at once without them."""
    asked = {
        (name, sliders): ReportInputs(source=name, sliders=sliders, output=Path("page.html"), quiet=True)
        for name, sliders in (("rv-40e-whole", False), ("rv-40e-whole", True), ("corr", False))
    }
    assert [each.sliders for each in asked.values()] == [False, True, True]
    monkeypatch.setattr(command.response_surface, "surrogate", lambda _: pytest.fail("sliders are computed"))
    one = asked["corr", False]
    one.study, one.answer, one.sliders = answers[SMALL].study, answers[SMALL], False
    found = command.compute(one)
    assert found.surrogate is None and asked["rv-40e-whole", False].phases[-2:] == ("sections of the page", "the page")
    assert "rvjax report x.toml --sliders adds" in sliders.without("x.toml").content[0].text
    for written in (True, False):  # a page with sliders shows what one without them does
        (here / "page.html").write_bytes(b"<html>" + command.mark(b"result", "x.toml", written))
        (here / command.FILE).write_bytes(b"result")
        assert [command.shows(here / "page.html", here, "x.toml", own) for own in (True, False)] == [written, True]


@pytest.mark.long  # test_cli_allocate.py writes the page of a stored result
def test_a_new_answer_and_its_page_share_a_folder(answers, undrawn, here, capsys):
    (here / "small.toml").write_text(SMALL)
    assert cli.main(["report", "small.toml", "--quiet", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["report"] == "results/small/report.html" and (here / told["report"]).is_file()
    assert cli.main(["allocate", "small.toml", "--quiet"]) == 0
    assert "Unchanged since results/small was written" in capsys.readouterr().out


def test_the_worst_units_are_the_worst_and_can_be_replayed(answers, answered, undrawn):
    answer = answers[SMALL]
    found = worst_units(answer)
    assert [unit.requirement for unit in found] == [n for n in answer.study.requirements for _ in range(2)]
    side = answer.after
    for name, requirement in answer.study.requirements.items():
        worst = found[[u.requirement for u in found].index(name)].values[name]
        distances = requirement.margin(side.values[name])  # beyond either limit
        assert requirement.margin(worst) == np.nanmax(distances)
    unit = found[0]
    errors = rvjax.tolerances.sample(side.tolerances, unit.index, seed=side.seed)
    np.testing.assert_allclose(unit.errors["crank_phase"], errors.crank_phase, rtol=1e-12)
    assert {f: values.size for f, values in unit.errors.items()}["disc_bore"] == 8
    failed = dataclasses.replace(side, failed={"NOT_ASSEMBLABLE": 7})
    text = page_of(Shown(dataclasses.replace(answer, after=failed)), "x.toml")
    assert "Unit 7 failed" in text and "cannot be put together" in text


def test_a_vector_is_shown_by_its_length():
    """A place of 5 um diametral: [1.5, 2] um is 2.5 um long, in the middle of 0 .. 5 um, and its mirror image too."""
    asked = study.load("rv-40e-whole", solve=False)
    errors = {f: np.zeros(2) for f in asked.fields} | {"pin_offset": np.array([1.5, 2.0, -1.5, -2.0, 3.0, 4.0]) * 1e-6}
    unit = WorstUnit(0, "", "MAX_STEPS", {}, errors)
    shown = rows_of(SimpleNamespace(study=asked, after=SimpleNamespace(tolerances=asked.tolerances)), unit)
    row = next(row for row in shown["rows"] if row["name"] == "pin_offset")
    assert row["places"] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9) and row["value"] == "+5.00 um"


def test_an_answer_whose_units_all_fail_is_written_and_says_so(answers, answered, here, request):
    """The small study, with no valid unit at the finest tolerances."""
    old = answers[SMALL]
    refused = dict(feasible=False, status="INFEASIBLE", shortfall=dict.fromkeys(old.allocation.shortfall, math.inf))
    allocation = dataclasses.replace(old.allocation, **refused, graded=None)
    failed = {name: np.full_like(values, np.nan) for name, values in old.after.values.items()}
    response = lambda errors: dict.fromkeys(old.after.influence, errors.pin_radius * math.nan)  # noqa: E731
    unknown = influences(response, old.after.tolerances, units=16, chunk=16)
    after = dataclasses.replace(old.after, values=failed, influence=unknown)
    new = dataclasses.replace(old, allocation=allocation, after=after, cost_curve=[])
    write_files(report_on(new).folder(), here / "failed")
    result = json.loads((here / "failed" / "result.json").read_text())
    assert set(result["shortfall"].values()) == {None} == set(result["shares"]["after"]["misfit"].values())
    assert "misfit cannot be met" in (here / "failed" / "summary.txt").read_text()
    request.getfixturevalue("undrawn")
    assert "misfit cannot be met" in page_of(Shown(new), "small.toml")


@pytest.mark.long
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
        .replace("target = 0.99\n", "")
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
    before = judged(old.certificate_before, old.before.values)
    new = dataclasses.replace(old, study=question, allocation=allocation, certificate_before=before, cost_curve=[])
    found = page_of(Shown(new), "elsewhere/able.toml")
    assert targets(question) == [] and "Cheapest cost for each yield" not in found and "✔ met" in found
    assert found.count("mean, &lt; 0.27 % failed") == 3 == report_on(new).text().count("mean, < 0.27 % failed")


def test_an_answer_says_how_many_units_failed_why_and_how_they_count(answers, answered, undrawn):
    found = answers[SMALL]
    failures = dict(
        failed=5, failures={"CONTACT_OVERLOAD": 2, "MAX_STEPS": 3}, examples={"CONTACT_OVERLOAD": 4, "MAX_STEPS": 612}
    )
    certificate = dataclasses.replace(found.allocation.certificate, **failures)
    found = dataclasses.replace(found, allocation=dataclasses.replace(found.allocation, certificate=certificate))
    kinds = "2 CONTACT_OVERLOAD (unit 4), 3 MAX_STEPS (unit 612)"
    line = next(line for line in report_on(found).text().splitlines() if f"{UNITS:,} independent units" in line)
    assert "5 failed" in line and kinds in line
    assert {key: report_on(found).json()["certificate"][key] for key in failures} == failures
    html = page_of(Shown(found), "x.toml")
    assert "2 CONTACT_OVERLOAD (" in html and "the first is unit 612)" in html


def test_a_result_says_of_its_requirements_what_a_comparison_says(answers, answered):
    """The interval of a yield is above the target of 99 %, about it, or below it."""
    found = answers[SMALL]
    name, certificate = next(iter(found.study.requirements)), found.allocation.certificate
    unsure = f"✘ not shown with {certificate.samples:,} units"
    for value, lower, said in ((0.999, 0.995, "✔ met"), (0.995, 0.985, unsure), (0.9, 0.8, "✘ not met")):
        one = Verdict("", "share", Estimate(value, 1e-3, lower, 1.0), said == "✔ met")
        judged = dataclasses.replace(certificate, verdicts=dict(certificate.verdicts) | {name: one})
        allocation = dataclasses.replace(found.allocation, certificate=judged, graded=None)
        table = requirement_table(dataclasses.replace(found, allocation=allocation))
        assert table.texts("page")[1][0][-1] == said
        assert said[2:] == met_text(found.study.requirements[name], one, certificate.samples)
        headers, rows = table.values()
        assert rows[0][headers.index("met after")] == (said == "✔ met")


def test_text_of_the_user_is_escaped(answers, answered, undrawn):
    answer, hostile = answers[SMALL], """</pre><script>alert("1")</script>&amp;'"""
    about = About(title=hostile, author=hostile, revision=hostile)
    question = dataclasses.replace(answer.study, name=hostile, text=f"# {hostile}\n{SMALL}", about=about)
    text = page_of(Shown(dataclasses.replace(answer, study=question)), f"{hostile}.toml")
    tags = Tags(text)
    assert "script" not in {tag for tag, _ in tags.seen}
    assert tags.headings[0] == hostile
    assert text.count(html.escape(hostile).replace("&quot;", "&#34;").replace("&#x27;", "&#39;")) >= 7


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
