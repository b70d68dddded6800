"""A new command is one module and one line: its table of study files, output table, plot, page, help and options."""

import csv
import json

import pytest

from rvjax import cli, commands, study

MODULE = """
from dataclasses import dataclass
from rvjax import study
from rvjax.commands import READING, WRITING
from rvjax.commands import Inputs, results_option, study_argument
from rvjax.render import Figure, Interval, Note, Number, Quantity, Report, Table, Text, results_folder

@dataclass(kw_only=True)
class PartsInputs(Inputs):
    '''Count parts.'''
    source: str = study_argument()
    results: str | None = results_option("STUDY-parts")

    def __post_init__(self):
        self.study = study.load(self.source, solve=False)
        self.folder = results_folder(self.results, self.study.name + "-parts")
        self.phases = (READING, WRITING)

def section(table, question):
    unknown = set(table) - {"spare"}
    if unknown:
        raise ValueError(f"unknown key parts.{min(unknown)}")
    return study.quantity(table["spare"], "m", "parts.spare")

def compute(inputs):
    design = inputs.study.design
    spare = inputs.study.sections["parts"]
    return {"pins < 50 & more": (design.cycloid.pin_count, spare), "cranks": (design.cranks.count, None)}

def report(inputs, found):
    rows = [[name, n, size, None if size is None else Quantity(size, "m", 0.5 * size, 2 * size)]
            for name, (n, size) in found.items()]
    columns = [Text("part"), Text("count"), Number("spare [um]", unit="m"), Interval("range", form=".1f")]

    def draw():
        from rvjax import plotting
        axes = plotting.new_axes()
        axes.bar(list(found), [n for n, _ in found.values()])
        return axes

    return Report("parts", (Note("Parts of " + inputs.study.name), Table("parts", columns, rows),
                            Figure("bars", "Parts", draw)),
                  data={"count": {name: n for name, (n, _) in found.items()}}, page="")
"""
STUDY = """
[design]
base = "rv-40e"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[requirement.transmission_error]
upper = "1 arcmin"
[parts]
spare = "3.5 um"
"""


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """The fake command, added as a new one is: a module, a line in COMMANDS, and one in TABLES for its table."""
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "parts.py").write_text(MODULE)
    monkeypatch.setattr(commands, "__path__", [*commands.__path__, str(tmp_path / "more")])
    monkeypatch.setitem(commands.COMMANDS, "parts", "how many parts a reducer has")
    monkeypatch.setitem(commands.TABLES, "parts", "parts")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(STUDY)
    return tmp_path


def test_a_new_command_is_one_module_and_one_line(parts, capsys):
    assert cli.main(["--help"]) == 0
    assert "how many parts a reducer has" in capsys.readouterr().out
    assert cli.main(["parts", "my.toml"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said == [
        "Parts of my",
        "",
        f"{'part':16}  count  {'spare [um]':>10}  {'range':>17}",
        54 * "-",
        f"{'pins < 50 & more':16}  {40:5}  {3.5:10}  3.5 um [1.8, 7.0]",
        f"{'cranks':16}  {2:5}  {'-':>10}  {'-':>17}",
        "",
        "Results: results/my-parts",
    ]
    folder = parts / "results" / "my-parts"
    assert {path.name for path in folder.iterdir()} == {
        "summary.txt",
        "result.json",
        "parts.csv",
        "bars.png",
        "report.html",
    }
    with (folder / "parts.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    assert [float(first[key]) for key in ("count", "spare [um]", "range, lower end", "range, upper end")] == [
        40,
        3.5,
        1.75,
        7,
    ]
    assert second["range"] == second["spare [um]"] == ""
    page = (folder / "report.html").read_text()
    assert "pins &lt; 50 &amp; more" in page and "3.5 µm" in page and "data:image/svg+xml;base64," in page
    assert cli.main(["parts", "my.toml", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"count": {"pins < 50 & more": 40, "cranks": 2}, "results": "results/my-parts-2"}


def test_the_table_of_a_command_is_read_with_the_study(parts, capsys):
    assert study.load("my.toml", solve=False).sections == {"parts": 3.5e-6}
    for change, message in (
        (('spare = "3.5 um"', 'spare = "3.5 kg"'), "parts.spare = '3.5 kg'"),
        (("spare =", "spear ="), "unknown key parts.spear"),
        (("[parts]", "[prats]"), "unknown key [prats]"),
    ):
        (parts / "bad.toml").write_text(STUDY.replace(*change))
        assert cli.main(["parts", "bad.toml"]) == 2
        assert message in capsys.readouterr().err
