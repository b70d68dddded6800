"""Before anything is computed: what cannot be is refused, what is far from known reducers is said, the rest told."""

import dataclasses
import io
import json
import math
import os
import re
import sys
import tomllib
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest
from crank_turn import crank_turn

from rvjax import RVErrors, catalogue, cli, designs, lost_motion, study
from rvjax.commands import check
from rvjax.commands.forecast import doubts_of_unit, expected, forewarn
from rvjax.commands.init import written
from rvjax.status import Status
from rvjax.study.design import doubts
from rvjax.tolerances import Tolerance
from rvjax.units import mm, um

GOOD = (resources.files("rvjax.study") / "embedded" / "rv-40e.toml").read_text("utf-8")
DESIGN = 'base = "rv-40e"'


def template(base):
    """The text of a four-bar study, or that of the oscillatory roller stage."""
    return written(base, "four-bar").text


def asked(old, new, text=GOOD):
    assert old in text
    return study.parse_study(text.replace(old, new, 1), name="x", solve=False)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('lower = "4 um"', 'lower = "-4 um"', "tolerances.bearing_clearance: limits of -4 um and 12 um"),
        ('coarsest = "7.9 um"', 'coarsest = "20 um"', "cost.bearing_clearance.coarsest = 20 um: limits of -12 um"),
        (DESIGN, DESIGN + '\ncycloid.pin_radius = "6 mm"', "pin_radius = 6 mm: the pins overlap from 5.021 mm on"),
        (DESIGN, DESIGN + "\ninvolute.planet_teeth = 50", "circle_radius = 60 mm: the cranks lie outside the discs"),
        ('half_width = "5 um"', 'half_width = "70 mm"', "as large as the part itself, 64 mm"),
    ],
)
def test_what_cannot_be_is_refused(old, new, words):
    with pytest.raises(study.StudyError, match=words):
        asked(old, new)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'half_width = "5 um"',
            'half_width = "4 mm"',
            "pin_circle_radius: half-width = 4 mm: known reducers have 0.5 um",
        ),
        (DESIGN, DESIGN + '\ncycloid.pin_radius = "4.8 mm"', "pin_radius = 4.8 mm: pins from 4.629 mm on cut into the"),
        ('"412 N m"', '"784 kN m"', "output_torque = 784 kN m: known reducers have up to 3.136 kN m"),
        (DESIGN, DESIGN + '\ncranks.bearing_stiffness = "6e8 N/mm"', "bearing_stiffness = 6e+05 N/um: known reducers"),
        (DESIGN, DESIGN + "\ninvolute.planet_teeth = 46", "the planets overlap: tip radius 48 mm"),
    ],
)
def test_what_is_far_from_every_known_reducer_is_said(old, new, words):
    changed = asked(old, new)
    if "planet_teeth" in new:
        changed = asked(new, new + "\ncranks.count = 4", GOOD.replace(old, new, 1))
    assert len(changed.doubts) == 1 and words in changed.doubts[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"15 rpm"', '"15000 rpm"', "duty[0].output_speed = 1.5e+04 r/min: known reducers have up to 75 r/min"),
        (
            'runout = "15 um" # drives', 'runout = "10 mm" # drives',
            "tolerances.disc_centre: runout = 10 mm: known reducers have 2 um to 160 um; check the unit",
        ),
        ('= "412 N m"\noutput_speed', '= "-412 kN m"\noutput_speed', "duty[0].output_torque = 412 kN m"),
        (
            "[conditions]", '[design.bearings.arm]\ncapacity = "31000 kN"\n[conditions]',
            "design.bearings.arm.capacity = 3.1e+04 kN: its rollers have a rating of 3",
        ),
        (
            "[conditions]", '[design.bearings.support]\nstatic_capacity = "40 N"\n[conditions]',
            "support.static_capacity = 40 N: its rollers have a rating of 52.77 kN",  # 44 (1 - 7/38) 15 14 7 N
        ),
    ],
)  # fmt: skip
def test_a_life_far_from_every_known_reducer_is_said(old, new, words):
    found = asked(old, new, study.load("rv-40e-whole", solve=False).text).doubts
    assert len(found) == 1 and words in found[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'upper = "1 arcmin"', 'upper = "0.01 arcmin"',
            "requirement.loaded_transmission_error.upper = 0.01 arcmin: no known reducer has less than 0.1667 arcmin",
        ),
        (
            'face_width = "12 mm"', 'face_width = "12 um"',
            "design.contact.face_width = 12 um: known reducers have 12 mm to 12 mm",
        ),
        (
            'output_torque = "412 N m"\noutput_speed', 'output_torque = "784 N m"\noutput_speed',
            "duty[0].output_torque = 784 N m: rated torque of the rv-80e; with this pin circle known reducers have "
            "235.9 N m to 720.9 N m",  # 0.9e6 and 2.75e6 times 0.064^3
        ),
        ('rated_torque = "412 N m"', 'rated_torque = "3136 N m"', "conditions.rated_torque = 3.136 kN m: rated torque"),
        (
            'reference = "10 um"\nfinest = "2 um"', 'reference = "10 um"\nfinest = "0.002 um"',
            "cost.crank_eccentricity.finest = 0.002 um: known reducers have 0.5 um to 40 um",
        ),
        (
            'coarsest = "6 um"', 'coarsest = "2 um"',
            "cost.shift_modification: the process holds half-widths of 1 um to 2 um; the initial one is 3 um",
        ),
    ],
)  # fmt: skip
def test_a_limit_a_process_or_a_torque_far_from_every_known_reducer_is_said(old, new, words):
    found = asked(old, new, study.load("rv-40e-whole", solve=False).text).doubts
    assert len(found) == 1 and words in found[0]


def test_check_shows_requirements_and_costs(unsolved, capsys):
    """All that the study asks for, with the words and numbers of its file."""
    assert cli.main(["check", "rv-40e-whole"]) == 0
    lines = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line.strip()}
    assert lines["life"][1:7] == [">=", "6000", "h", "none", "99", "%"] and lines["misfit"][1:4] == ["<=", "30", "um"]
    assert lines["disc_pitch"][1:] == ["3.158", "2", "um", "9.5", "um", "20", "um"]  # 3 (10/9.5)
    assert lines["conditions.duty"][1:4] == ["412", "N", "m,"]
    assert lines["conditions.output_torque"][1:] == ["412", "N", "m", "up", "to", "3.136", "kN", "m"]


def test_known_reducers_and_the_studies_raise_no_doubt():
    for name in study.embedded_names():
        assert study.load(name, solve=False).doubts == []
    question = study.load("rv-40e", solve=False)
    for design in study.KINDS[designs.RVReducer].bases.values():
        assert doubts(design, question.conditions, question.tolerances) == []


@pytest.mark.parametrize("base", sorted(study.BASES))
def test_a_written_study_is_the_known_reducer(base):
    text = template(base)
    made = study.parse_study(text, name=base, solve=False)
    due, given = dict(catalogue.numbers(study.BASES[base])), dict(catalogue.numbers(made.design))
    for name, (value, _) in due.items():
        if (
            name.split(".")[0] in ("involute", "cycloid", "cranks", "cam_radius", "eccentricity")
            and "modification" not in name
        ):
            assert given[name][0] == pytest.approx(value, rel=1e-3), name
    stiff = next((line for line in text.splitlines() if line.startswith("cranks.bearing_stiffness")), "")
    assert ("; assumed; initially " in stiff) == base.startswith("rv")  # nobody printed it
    wide = ["bearings.arm.pitch_diameter"] if base == "cycloidal-29" else []  # assumed rollers reach the holes
    assert [line.removeprefix("design.").split()[0] for line in made.doubts] == wide
    where = {"cycloidal-15": " of the flanks and ", "cycloidal-17": "80 um of the flanks: above"}.get(base, "")
    known = made.inaccurate(angles=False)
    assert all(where in line for line in known) and len(known) == bool(where)
    assert ("kind" in tomllib.loads(text)["design"]) == (base != "rv-20e")


def test_commands(tmp_path, monkeypatch, unsolved, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", "mine.toml", "--base", "rv-80e", "--model", "four-bar"]) == 0
    assert cli.main(["init", "mine.toml"]) == 2 and "exists already" in capsys.readouterr().err
    assert (
        cli.main(["init", "other.toml", "--base", "rv-81e"]) == 2 and "did you mean rv-80e" in capsys.readouterr().err
    )
    assert cli.main(["check", "mine.toml", "--picture", "mine.png"]) == 0
    said = capsys.readouterr().out
    for words in ("ratio                            153", "gap between pins                 5.24 mm", "No warnings",
                  "no undercut", "closed form, 64 angles", "Ignored by the required models", "784 N m"):  # fmt: skip
        assert words in said
    assert (tmp_path / "mine.png").stat().st_size > 10_000
    assert cli.main(["check", "corr", "--picture", "mine.png"]) == 2
    capsys.readouterr()
    assert cli.main(["check", "mine.toml", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["facts"]["ratio"] == "153" and told["numbers"]["cycloid.eccentricity"]["unit"] == "m"
    assert told["conditions"]["output_torque"] == 784.0 and told["doubts"] == []
    assert told["tolerances"]["crank_phase"]["unit"] == "rad"
    assert told["levels"]["transmission_error"]["level"].startswith("closed form, 64 angles")


def test_a_doubt_and_the_levels_are_said_before_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (
        GOOD.replace('half_width = "5 um"', 'half_width = "2 mm"') + '\n[accuracy]\ntransmission_error = "2 arcsec"\n'
    )
    (tmp_path / "mine.toml").write_text(text)
    asked = study.load("mine.toml", solve=False)
    forewarn(asked, expected(asked))
    said = capsys.readouterr().err
    warning = next(line for line in said.splitlines() if "warning" in line)
    assert "tolerances.pin_circle_radius" in warning and "2 mm" in warning
    assert "rvjax: transmission_error: closed form" in said and "rvjax: time: about" in said


QUICK = """[about]
author = "Müller"
[design]
base = "rv-20e"
[requirement.lost_motion]
upper = "1 arcmin"
[tolerances.pin_radius]
half_width = "2 um"
"""


def test_a_terminal_without_umlauts_gets_the_rest(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "größe.toml").write_text(QUICK, "utf-8")
    terminal = io.TextIOWrapper(io.BytesIO(), "ascii")  # as Python opens it in the locale C
    monkeypatch.setattr(sys, "stdout", terminal)
    assert cli.main(["check", "größe.toml"]) == 0 and not capsys.readouterr().err
    said = terminal.buffer.getvalue()
    assert rb"Study gr\xf6\xdfe: RVReducer" in said and rb"M\xfcller" in said


def test_what_is_assumed_is_named_until_it_is_given(unsolved):
    assert "cranks.bearing_stiffness" in asked(DESIGN, DESIGN).assumed
    assert "cycloid.disc_count" in asked(DESIGN, DESIGN).assumed
    given = asked(DESIGN, DESIGN + '\ncranks.bearing_stiffness = "5e8 N/m"').assumed
    assert "cranks.bearing_stiffness" not in given and "cycloid.disc_count" in given
    marked = study.parse_study(template("rv-80e"), name="x", solve=False).assumed
    modified = ["cycloid.equidistant_modification", "cycloid.shift_modification"]
    kinematic = study.KINDS[designs.RVReducer].starts["four-bar"].parts
    due = [name for name in catalogue.assumed("rv-80e") if name.split(".")[0] in kinematic]
    assert sorted(marked) == sorted(due + modified)  # the file marks them
    inputs = SimpleNamespace(study=asked(DESIGN, DESIGN), picture=None, turn=False, source="")
    text = check.report(inputs, check.compute(inputs)).text()
    assumed = next(line for line in text.splitlines() if line.startswith("Assumed"))
    assert all(f" {name}" in assumed for name in ("involute.pressure_angle", "cycloid.disc_count"))


def test_the_rv_80e_is_sound():
    stage = catalogue.RV_80E.involute
    due = designs.InvoluteStage.from_teeth(10, 38, module=1.75 * mm)
    assert all(
        getattr(stage, n) == pytest.approx(getattr(due, n), rel=1e-12) for n in ("sun_base_radius", "centre_distance")
    )


def test_a_reader_that_has_enough_ends_a_command_quietly(tmp_path, monkeypatch, capsys):
    (tmp_path / "quick.toml").write_text(QUICK, "utf-8")
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert cli.main(["check", str(tmp_path / "quick.toml")]) == 0 and capsys.readouterr().err == ""
    # It was closed without an error: what was left in it went nowhere.


def test_the_unit_at_the_mid_points_stands_beside_its_limits(tmp_path, capsys):
    """Lost motion of the errors that the file states, by the function of the model; no tolerance moves a mid-point."""
    file = tmp_path / "strict.toml"
    file.write_text(GOOD.replace('upper = "1 arcmin"', 'upper = "0.1 arcmin"', 1))
    assert cli.main(["check", str(file), "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    errors = dict(bearing_clearance=8, pin_hole_clearance=2.5, base_tangent_upper=-14, base_tangent_lower=-14)
    errors |= dict(disc_runout=7.5, disc_cumulative_pitch=9.5)
    design = study.load("rv-40e", solve=False).design
    due = lost_motion.geometric(design, RVErrors(**{name: size * um for name, size in errors.items()}))
    values = {name: one["at_mid_points"] for name, one in found["requirements"].items()}
    assert values["lost_motion"] == pytest.approx(float(due.total), rel=1e-12) and values["misfit"] == 0
    (line,) = found["doubts"]
    said = "transmission_error: 0.1601 arcmin, above 0.1 arcmin, at the mid-points: no tolerance can meet this"
    assert line == f"{said} unless mid-points move"
    text = (resources.files("rvjax.study") / "embedded" / "corr.toml").read_text("utf-8")
    file.write_text(text.replace('upper = "3500 N"', 'upper = "2400 N"'))
    assert cli.main(["check", str(file)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(r"cam_force: 2,489 N, above 2400 N, at the mid-points: no tolerance can meet this", said)


def test_a_unit_at_the_mid_points_that_cannot_be_solved_is_a_warning(monkeypatch, capsys):
    failed = lambda self, _: (dict.fromkeys(self.requirements, math.nan), Status.CONTACT_OVERLOAD)  # noqa: E731
    monkeypatch.setattr(study.Study, "at_mid_points", failed)
    assert cli.main(["check", "corr", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert all(one["at_mid_points"] is None for one in found["requirements"].values())
    assert found["doubts"][-1].startswith("the unit at the mid-points cannot be solved: CONTACT_OVERLOAD")


def test_what_may_move_and_what_half_of_the_units_may_miss():
    """Numbers of a design, the start of a lognormal error; a target of one half has units on both sides."""
    values = {"transmission_error": math.inf, "misfit": 0.0, "lost_motion": 0.0}
    plain = dataclasses.replace(study.load("rv-40e", solve=False), middles={})

    def lines(changed, status=Status.CONVERGED):
        return doubts_of_unit(changed, values, status)

    (line,) = lines(plain)
    assert line.startswith("transmission_error: ") and line.endswith("no tolerance can meet this")
    designed = dataclasses.replace(plain, variables={"cycloid.eccentricity": None})
    assert lines(designed)[0].endswith("no tolerance can meet this unless numbers of the design move")
    skewed = Tolerance(0.0, 5e-6, distribution="lognormal", log_sd=0.4)
    starting = dataclasses.replace(plain, tolerances=plain.tolerances.replace(pin_radius=skewed))
    assert lines(starting)[0].endswith("unless mid-points move")
    need = plain.requirements | {
        "transmission_error": dataclasses.replace(plain.requirements["transmission_error"], target=0.4)
    }
    assert lines(dataclasses.replace(plain, requirements=need)) == []
    assert lines(plain, Status.UNDERCUT)[0].startswith("the unit at the mid-points cannot be solved: UNDERCUT")


def test_turn_measures_units_over_a_whole_turn_of_the_output(monkeypatch):
    """Ratios of both pressures by the conditions; not of a lower limit, nor of a unit that fails or has none."""
    units, asked_for = check.TURNED, []
    found = {12: [0.0] + [1.0] * (units - 1), 4 * 12 * 18 + 1: [1.5] * (units - 2) + [3.0, math.nan]}

    def measured(response, population, key, start, *, count):
        asked_for.append((response.outputs, response.conditions.span, response.conditions.samples, count))
        return {name: np.asarray(found[response.conditions.samples]) for name in response.outputs}, None

    study_of = crank_turn("cycloidal-17", 12)
    monkeypatch.setattr(check, "respond_units", measured)
    larger = check._over_a_turn(study_of)
    names = ("turn_pin_pressure", "hole_pressure")
    assert asked_for == [(names, "crank_turn", 12, units), (names, "output_turn", 865, units)]
    assert larger == {name: [1.5] * (units - 3) + [3.0] for name in names}
    text = check._larger_text(study_of, larger)
    assert text.startswith(
        "Over a turn of the output, at 865 angles, 8 units have on average turn_pin_pressure 1.75 times"
    )
    assert "hole_pressure 1.75 times (largest 3) the value." in text
    assert check._over_a_turn(study.load("rv-40e", solve=False)) == {} and check._larger_text(study_of, {}) == ""
