"""Answers judged by the question of another study: `rvjax compare A --on STUDY`."""

import json
import re

import jax
import numpy as np
import pytest

from rvjax import cli, tolerances
from rvjax.base import progress
from rvjax.commands.cells import met_text
from rvjax.commands.compare import cost_of, differences, put_into
from rvjax.study import load, parse_study
from rvjax.tolerances import MeanWithin, Requirement, Tolerance
from rvjax.units import um

ANSWER = """
[design]
base = "rv-40e"
[conditions]
angles = 8
[tolerances.disc_bore]
half_width = "6 um"
[tolerances.carrier_bore]
half_width = "6 um"
distribution = "uniform"
[tolerances.pin_radius]
half_width = "2 um"
[requirement.misfit]
upper = "30 um"
[requirement.lost_motion]
upper = "5 arcmin"
"""
JUDGE = """
[design]
base = "rv-40e"
cycloid.equidistant_modification = "-3 um"
[conditions]
angles = 8
[tolerances.disc_bore]
half_width = "1 um"
[tolerances.carrier_bore]
half_width = "1 um"
[tolerances.crank_eccentricity]
half_width = "7 um"
[cost.disc_bore]
scale = 3
reference = "10 um"
finest = "1 um"
coarsest = "40 um"
[requirement.misfit]
upper = "12 um"
target = 0.5
[run]
certificate_samples = 4096
"""
WHOLE = {"lower": -9e-6, "upper": 9e-6}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A results folder whose answer moved the limits, and a judging study, beside each other."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "judge.toml").write_text(JUDGE)
    place = tmp_path / "a"
    place.mkdir()
    (place / "study.toml").write_text(ANSWER)
    limits = {
        "disc_bore": WHOLE,
        "carrier_bore": {"lower": -5e-6, "upper": 5e-6},
        "pin_radius": {"lower": -1e-6, "upper": 1e-6},
    }
    result = {key: {} for key in ("status", "seed", "versions", "cost", "shares", "certificate")} | {"study": "answer"}
    result["tolerances"] = {name: {"unit": "m", "after": one} for name, one in limits.items()}
    (place / "result.json").write_text(json.dumps(result))
    return place


def test_an_answer_is_judged_by_another_study(folder, capsys, monkeypatch):
    """Oracle: the misfit of units that are drawn one by one from tolerances put together by hand."""
    question = parse_study(JUDGE, name="judge", solve=False)
    by_hand = question.tolerances.replace(
        disc_bore=Tolerance.symmetric(9 * um, shape=(2, 2, 2)),
        carrier_bore=Tolerance.symmetric(5 * um, distribution="uniform", shape=(2, 2)),
    )
    misfit = question.response_of("misfit")
    draw = jax.jit(jax.vmap(lambda unit: misfit(tolerances.sample(by_hand, unit, seed=1)).value["misfit"]))
    good = np.mean(np.asarray(draw(np.arange(4096))) <= 12 * um)
    seen = []
    monkeypatch.setattr(progress.Phases, "detail", lambda self, note, part=0.0: seen.append((self.name, note)))
    assert cli.main(["compare", "a", "--on", "judge.toml", "--format", "json"]) == 0
    assert ("units of A", "Monte Carlo, 4,096 of 4,096 units") in seen
    found = json.loads(capsys.readouterr().out)
    assert found["on"]["study"] == "judge" and list(found) == ["on"]
    one = found["on"]["answers"]["a"]
    joint = one["certificate"]["joint_yield"]
    assert 0.2 < good < 0.95 and joint["value"] == good == one["certificate"]["yield_"]["misfit"]["value"]
    assert joint["lower"] < good < joint["upper"]
    assert one["taken"] == ["disc_bore", "carrier_bore"] and one["own"] == ["crank_eccentricity"]
    assert one["left_out"] == ["pin_radius"] and one["cost"] == pytest.approx(3 * 10 / 9)
    assert one["tolerances"]["disc_bore"] == WHOLE | {"unit": "m", "distribution": "normal", "cp": 1.0, "shift": 0.0}
    assert one["tolerances"]["carrier_bore"]["distribution"] == "uniform"
    (line,) = one["design"]
    assert line.startswith("cycloid.equidistant_modification") and "0 um in answer" in line and "-3 um in judge" in line
    assert cli.main(["compare", "a", "--on", "judge.toml"]) == 0
    told = capsys.readouterr().out
    for words in (
        "\nA on judge: all requirements met\n",
        f"{100 * good:.3f} % [",
        "+-9.00 um",
        "A: answer has no tolerance for crank_eccentricity: the tolerances of judge are used",
        "A: judge has no tolerance for pin_radius: ignored",
        "A: the tolerances are applied to the design of judge: cycloid.equidistant_modification is",
        "A: 4,096 independent units, 0 failed",
        "all at once",
    ):
        assert words in told, words


@pytest.mark.long  # the words of every verdict are below
def test_too_few_units_show_nothing_rather_than_the_contrary(folder, capsys):
    """The target lies between the estimate of 200 units and the lower end of its interval; then above both."""
    for samples, target, due in ((200, "below", "not shown with 200 units"), (200, "above", "not met")):
        command = ["compare", "a", "--on", "judge.toml", "--samples", str(samples)]
        assert cli.main([*command, "--format", "json"]) == 0
        found = json.loads(capsys.readouterr().out)["on"]["answers"]["a"]["certificate"]["yield_"]["misfit"]
        goal = found["value"] + (-0.25 if target == "below" else 0.25) * (found["value"] - found["lower"])
        (folder.parent / "judge.toml").write_text(JUDGE.replace("target = 0.5", f"target = {goal}"))
        assert cli.main(command) == 0
        told = capsys.readouterr().out
        assert f"\nA on judge: {due}: misfit\n" in told and re.search(rf"\] +{due}$", told, re.M)
        (folder.parent / "judge.toml").write_text(JUDGE)


def test_what_is_met_is_said_of_every_kind_of_requirement():
    """The case of a user: 99.500 % [98.835, 99.786] for 99 %. Too many failed units are no matter of the interval."""
    share = tolerances.Estimate(0.995, 0.002, 0.98835, 0.99786)
    mean = tolerances.Estimate(9.0, 1.0, 7.0, 11.0)
    for need, estimate, met, due in (
        (Requirement(upper=1.0, target=0.99), share, False, "not shown with 1,000 units"),
        (Requirement(upper=1.0, target=0.98), share, True, "met"),
        (Requirement(upper=1.0, target=0.996), share, False, "not met"),
        (MeanWithin(upper=10.0), mean, False, "not shown with 1,000 units"),
        (MeanWithin(upper=8.0), mean, False, "not met"),
        (MeanWithin(upper=12.0), mean, False, "not met"),  # failed units
    ):
        assert met_text(need, tolerances.Verdict("", "", estimate, met), 1000) == due


def test_what_cannot_be_judged_is_one_line(folder, capsys):
    def refused(*arguments):
        assert cli.main(["compare", *arguments]) == 2
        message = capsys.readouterr().err.strip()
        assert "\n" not in message
        return message

    assert "B is missing: name two results folders" in refused("a")
    assert "--samples 20: only with --on STUDY" in refused("a", "a", "--samples", "20")
    message = refused("a", "--on", "corr")
    assert "study corr" in message and "CamRollerErrors" in message and "RVErrors" in message
    other = JUDGE.replace("tolerances.disc_bore", "tolerances.crank_phase").replace("1 um", "1 arcmin", 1)
    other = other.replace('[tolerances.carrier_bore]\nhalf_width = "1 um"\n', "")
    other = other[: other.index("[cost")] + other[other.index("[requirement") :]
    (folder.parent / "other.toml").write_text(other)
    assert "study other: has none of the errors" in refused("a", "--on", "other.toml")
    (folder / "study.toml").unlink()
    assert "a: there is no study.toml next to the result" in refused("a/result.json", "--on", "judge.toml")


def test_elements_must_agree():
    question = parse_study(JUDGE, name="judge", solve=False)
    with pytest.raises(ValueError, match=r"tolerances.disc_bore: .* elements in the result, .* in study judge"):
        put_into(question, question.tolerances.replace(disc_bore=Tolerance.symmetric(1 * um)))


def test_one_table_serves_both_studies_of_the_rv_40e():
    """What the picture and the machine both know has the same limits, laws and costs, but for the closer bearings."""
    picture, machine = (load(name, solve=False) for name in ("rv-40e", "rv-40e-whole"))
    both = [name for name in picture.fields if name in machine.fields]
    assert {*picture.fields} - {*both} == {"disc_runout", "disc_cumulative_pitch"}  # a place in the machine
    differ = [
        name
        for name in both
        if getattr(picture.tolerances, name).described() != getattr(machine.tolerances, name).described()
    ]
    assert differ == ["bearing_clearance"]
    assert [name for name in picture.costs if vars(picture.costs[name]) != vars(machine.costs[name])] == [
        "bearing_clearance"
    ]
    for study in (picture, machine):
        cost = study.costs["bearing_clearance"]
        assert float(cost(2 * um)) == pytest.approx(2 * 5 / 2)
    limits = [
        {study.requirements[n].upper for n in names}
        for study, names in (
            (picture, ("transmission_error", "lost_motion")),
            (machine, ("loaded_transmission_error", "bench_lost_motion")),
        )
    ]
    assert limits[0] == limits[1] and picture.requirements["misfit"].upper == machine.requirements["misfit"].upper
    first = differences(picture, machine)[0]
    assert first.startswith("cycloid.equidistant_modification") and "-20 um in rv-40e" in first and "-2 um" in first
    together = put_into(machine, picture.tolerances)
    assert cost_of(machine, together) > cost_of(picture, picture.tolerances)  # it also pays for pins, pitch and runout
