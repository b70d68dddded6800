"""`rvjax compare` of two results, and of what is no result."""

import csv
import json
import re

import pytest
from cli_study import SMALL

import rvjax
from rvjax import cli


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
    said = capsys.readouterr().out
    cost = other["cost"]["after"]
    assert said.splitlines()[:5] == [
        f"A: {out}",
        "B: b.json",
        "",
        f"A: OPTIMAL, cost {cost:.3f}",
        f"B: NOT_CERTIFIED, cost {cost:.3f}",
    ]
    lines = [re.split(r"\s{2,}", line.strip()) for line in said.splitlines()]
    rows = {line[0]: line[1:] for line in lines}
    assert rows["verdict"] == ["OPTIMAL", "NOT_CERTIFIED", "differs"]
    assert rows["seed"] == ["0", "7", "differs"] and "study" not in rows
    assert rows["crank_phase, half-width"][2] == "+25.0 %"
    assert "\nErrors only in A: pin_radius\n" in said and "pin_radius, half-width" not in rows
    assert rows["misfit, Cpk"][1:] == ["-", "differs"]
    same = said.partition("The same in both:\n")[2].splitlines()
    assert "  tolerances before: all" in same and "  variance of misfit, after: all" in same
    assert any(line.startswith("  requirements: ") for line in same) and "misfit, limits" not in rows
    assert cli.main(["compare", str(out), "b.json", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    half = answers[SMALL].allocation.tolerances.crank_phase.half_width
    phase = found["tolerances after"]["crank_phase, half-width"]
    assert phase == {"unit": "rad", "a": pytest.approx(half), "b": pytest.approx(1.25 * half), "same": False}
    seen = found["variance of misfit, after"]["crank_phase"]
    assert seen == {"unit": "share", "a": share, "b": share, "same": True}
    assert found["cost"]["after"]["same"] is True and found["requirements"]["misfit, limits"]["a"] == "<= 30 um"
    assert found["tolerances after"]["pin_radius, half-width"]["b"] is None
    assert found["run"]["version of rvjax"]["a"] == rvjax.__version__
    written = csv.DictReader((out / "tolerances.csv").read_text().splitlines())
    total = sum(float(row["cost after"] or 0) for row in written)
    assert found["cost"]["after"]["a"] == pytest.approx(total, rel=1e-12)
    assert 0 < found["cost"]["moved middles, after"]["a"] < total


def test_requirements_of_one_side_are_a_line(answered, here, capsys):
    """The other side names its requirement and has its own shares of variance; nothing else differs."""
    _, out = answered
    other = json.loads((out / "result.json").read_text())
    for table in (other["certificate"]["verdicts"], other["limits"], other["shares"]["after"]):
        table["life"] = table.pop("misfit")
    other["limits"]["life"] = ">= 6000 h"
    (here / "b.json").write_text(json.dumps(other))
    assert cli.main(["compare", str(out), "b.json"]) == 0
    said = capsys.readouterr().out
    assert "\nRequirements only in A: misfit (<= 30 um)\nRequirements only in B: life (>= 6000 h)\n" in said
    assert len(re.findall(r"\b(?:misfit|life)\b", said)) == 2 and "differs" not in said
    other = json.loads((out / "result.json").read_text())
    other["tolerances"]["pin_radius"]["after"]["upper"] *= 1 + 1e-14  # of another computer
    (here / "b.json").write_text(json.dumps(other))
    assert cli.main(["compare", str(out), "b.json"]) == 0
    topics = ["run", "cost", "tolerances before", "tolerances after", "requirements"]
    topics += [f"variance of {name}, after" for name in other["shares"]["after"]]
    same = capsys.readouterr().out.partition("The same in both:\n")[2].splitlines()
    assert same == [f"  {topic}: all" for topic in topics]


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
