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
    assert 0 < found["cost"]["moved middles, after"]["a"] < total


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
