"""The command line from end to end on a small study: answer, refusal, bad input; nothing half-written."""

import csv
import json
import subprocess
import sys
from importlib import resources

import matplotlib.image
import pytest

import rvjax
from rvjax import cli, report

GOOD = (resources.files("rvjax.study") / "embedded" / "rv-40e.toml").read_text("utf-8")
SMALL = GOOD.replace("angles = 64 ", "angles = 12 ").replace("samples = 16384", "samples = 1024")
SMALL = SMALL.replace("certificate_samples = 1_000_000", "certificate_samples = 60_000")
HISTOGRAMS = ["histogram_transmission_error", "histogram_misfit", "histogram_lost_motion"]
PICTURES = ["curves", *HISTOGRAMS, "variance_shares", "cost_against_yield"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


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
    assert result["cost"]["after"] < 0.7 * result["cost"]["before"]
    certificate = result["certificate"]
    assert certificate["samples"] == 60_000 and certificate["failed"] == 0
    for estimate in certificate["yield_"].values():
        assert 0.9973 <= estimate["lower"] <= estimate["value"] <= estimate["upper"] < 0.9999
    assert all(price < 0 for price in result["multipliers"].values())  # both requirements bind
    assert result["seed"] == 0 and result["versions"]["rvjax"] == rvjax.__version__
    for shares in result["shares"]["after"].values():
        assert sum(shares.values()) == pytest.approx(1.0)


def test_allocate_writes_tables_and_pictures(answered):
    _, out = answered
    assert (out / "study.toml").read_text() == SMALL
    rows = list(csv.reader((out / "tolerances.csv").read_text().splitlines()))
    assert rows[1][:2] == ["crank_eccentricity", "+-6.50 um"] and rows[-1][0] == "sum"
    influence = {row["error"]: row for row in csv.DictReader((out / "influence.csv").read_text().splitlines())}
    assert influence["disc_runout"]["d transmission_error / d error"] == "0.0000 arcmin/um"
    assert float(influence["disc_runout"]["d lost_motion / d error"].split()[0]) > 0
    text = (out / "summary.txt").read_text()
    for words in (
        "OPTIMAL",
        "+-6.50 um",
        "8.00 +-4.00 um",
        "shadow price",
        "60,000 fresh units, 0 failed",
    ):
        assert words in text
    for name in PICTURES:
        picture = matplotlib.image.imread(out / f"{name}.png")
        assert picture.shape[1] > 800 and picture.std() > 0.02  # something is drawn
    assert sorted(p.name for p in out.parent.iterdir()) == ["out", "small.toml"]  # no scratch folder is left


def test_infeasible_requirements_are_refused_with_the_shortfall(here, capsys):
    text = SMALL.replace('upper = "1 arcmin"', 'upper = "0.2 arcmin"')
    (here / "hard.toml").write_text(text)
    assert cli.main(["allocate", "hard.toml", "--quiet"]) == 1
    printed = capsys.readouterr().out
    assert "INFEASIBLE" in printed and "limit of transmission_error would have to move by" in printed
    result = json.loads((here / "results" / "hard" / "result.json").read_text())
    assert not result["feasible"] and 0 < result["shortfall"]["transmission_error"] < 1e-4
    assert result["shortfall"]["misfit"] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["allocate", "absent.toml"], ["absent.toml", "no such study file"]),
        (["allocate", "rv-41e"], ["rv-41e", "rv-40e"]),
        (["allocate", "bad.toml"], ["bad", "tolerances.crank_phase.half_width", "5 kg", "arcmin"]),
        (["allocate", "good.toml", "--results", "taken"], ["taken", "exists"]),
        (["allocate", "folder.toml"], ["folder.toml"]),
        (["allocate", "good.toml", "--colour"], ["--colour"]),
        (["alocate"], ["alocate"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(here, capsys, arguments, words):
    (here / "bad.toml").write_text(SMALL.replace('"5 arcmin"\n\n[tolerances.disc', '"5 kg"\n\n[tolerances.disc'))
    (here / "good.toml").write_text(SMALL)
    (here / "taken").mkdir()
    (here / "folder.toml").mkdir()
    before = sorted(here.rglob("*"))
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    message = captured.err.strip().splitlines()[-1]  # argparse prints its usage first
    for word in words:
        assert word in message
    assert "Traceback" not in captured.err and captured.out == ""
    assert sorted(here.rglob("*")) == before


def test_a_failure_while_writing_leaves_nothing(answered, here, monkeypatch):
    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(report, "summary", lambda answer: "text")
    monkeypatch.setattr(report, "as_json", fail)

    class Study:
        text = "x"

    class Answer:
        study = Study

    with pytest.raises(OSError, match="disk full"):
        report.write(Answer, here / "results" / "x")
    assert list((here / "results").iterdir()) == []


def test_results_folders_are_never_overwritten(here):
    assert str(report.results_folder(None, "x")) == "results/x"
    (here / "results" / "x").mkdir(parents=True)
    (here / "results" / "x-2").mkdir()
    assert str(report.results_folder(None, "x")) == "results/x-3"


def test_version_and_module_entry():
    command = [sys.executable, "-m", "rvjax", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"rvjax {rvjax.__version__}"


def test_help_names_every_command(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    assert "allocate" in text and "reproduce" in text and "Exit codes" in text
