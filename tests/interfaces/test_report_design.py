"""Whose study it is, and where each number of its design comes from. Oracle: the files themselves, by eye."""

import pytest

from rvjax import catalogue, study
from rvjax.commands.cells import assumed_text
from rvjax.commands.report.page import design_section
from rvjax.render import Figure, Report
from rvjax.study.study import About

HEAD = """
[requirement.lost_motion]
upper = "1 arcmin"
[tolerances.pin_radius]
half_width = "4 um"
"""


def asked(lines):
    return study.parse_study(f"{lines}\n{HEAD}", name="x", solve=False)


CHANGED = """[design]
base = "rv-40e"
involute.module = "2.5 mm"
cycloid.eccentricity = "1.2 mm" # assumed, as in the older one
[design.damping] # assumed: nobody measured it
loss_factor = 0.04
modal_ratio = 0.01 # of a tap test"""


def test_a_number_comes_from_the_study_the_base_or_others():
    found = {number.path: (number.origin, number.assumed) for number in asked(CHANGED).numbers}
    assert found["involute.module"] == ("this study", False)
    assert found["involute.sun_radius"] == ("derived: 2.5 mm * 10/2", False)
    assert found["cranks.circle_radius"] == ("derived: the centre distance", False)
    assert found["cycloid.pin_count"] == ("rv-40e: Table 1", False)
    assert found["cycloid.disc_count"] == ("rv-40e: assumed: usual layout, opposed discs", True)
    assert found["cycloid.eccentricity"] == ("this study", True)
    assert found["cycloid.force_angle"] == ("default", False)
    assert found["damping.loss_factor"] == found["damping.modal_ratio"] == ("this study", True)
    assert found["damping.rayleigh_mass"] == ("default", False)


def test_a_derived_number_names_the_numbers_of_this_study():
    """The centre distance is 42 mm with the gears of the base too; its derivation is that of this study."""
    own = '[design]\nbase = "rv-80e"\ninvolute.sun_teeth = 14\ninvolute.planet_teeth = 42\ninvolute.module = "1.5 mm"'
    found = {number.path: number.origin for number in asked(own).numbers}
    assert found["involute.centre_distance"] == "derived: 1.5 mm (14 + 42)/2"
    assert found["involute.planet_base_radius"] == "derived: 1.5 mm * 42/2 * cos 20 deg"
    assert found["cranks.circle_radius"] == "derived: the centre distance"
    off = asked('[design]\nbase = "rv-320e"\ninvolute.module = "1.5 mm"').numbers  # whose cranks are 0.5 mm further out
    assert next(number.origin for number in off if number.path == "cranks.circle_radius").startswith("rv-320e: Table 1")
    base = {number.path: number.origin for number in asked('[design]\nbase = "rv-80e"').numbers}
    assert base["involute.centre_distance"] == "rv-80e: derived: 1.75 mm (10 + 38) / 2"


def test_a_part_of_which_all_is_assumed_is_named_as_one():
    said = assumed_text(study.load("rv-40e-joint", solve=False))
    assert said.split(", ")[-3:] == ["inertia", "stiffness", "damping"]
    assert "involute.pressure_angle, " in said


def test_sources_are_whole_sentences():
    shortening = catalogue.sources("rv-20e")["cycloid.shortening"]
    assert shortening.endswith("the published lost motion needs 0.72")  # goes on in a second line
    assert catalogue.sources("rv-320e")["inertia.sun_mass"] == "Table 1"  # of the whole part
    assert catalogue.citation("rv-320e").startswith("RV-320E: Yang, Chen, Wang") and catalogue.citation("x") == ""


RV = ("64 mm", "ratio", "105", "K1", "0.8125", "anonymous web article", "1.3 mm", "from")
RV += ("2 cranks on a circle of 72 mm", "40 pins of 6 mm")
DRIVE = ("85 mm", "17:1, output opposite to the input", "in holes of 8.3 mm", "an open robot arm", "member", "carrier")


@pytest.mark.parametrize(("base", "told"), [("rv-40e", RV), ("cycloidal-17", DRIVE)])
def test_the_section_shows_numbers_drawing_and_what_follows(base, told):
    question = study.load(base, solve=False)
    page = Report("x", (design_section(question),)).html()
    for words in told:
        assert words in page, words
    assert page.count("<img") == 1 and page.count("<strong>assumed</strong>") == len(question.assumed)
    corr = Report("x", (design_section(study.load("corr", solve=False)),))
    assert not any(isinstance(part, Figure) for part in corr.parts())  # nothing draws it


def test_about_is_read_and_optional():
    base = '[design]\nbase = "rv-40e"'
    assert asked(base).about == About() and About().line() == ""
    said = asked(f'[about]\ntitle = "Joint 3"\nauthor = " Ä. Muster "\nrevision = 4\n{base}').about
    assert said == About("Joint 3", "Ä. Muster", "4")
    assert said.line() == "Joint 3; Ä. Muster; revision 4"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('autor = "A"', "unknown key about.autor .did you mean author"),
        ("revision = 1.2", "about.revision = 1.2: must be a text of one line"),
        ("revision = true", "about.revision = True: must be a text"),
        ('author = ""', "about.author = '': must be a text"),
        (r'title = "a\nb"', "about.title = .*: must be a text of one line"),
        (f'title = "{201 * "x"}"', "about.title = .*at most 200 characters"),
    ],
)
def test_about_refuses_what_no_head_could_show(line, words):
    with pytest.raises(study.StudyError, match=words):
        asked(f'[about]\n{line}\n[design]\nbase = "rv-40e"')


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('involute.sun_teeth = "10"', "design.involute.sun_teeth = '10': must be an integer"),
        ("involute.sun_teeth = 10.0", "design.involute.sun_teeth = 10.0: must be an integer"),
        ("cranks.count = true", "design.cranks.count = True: must be an integer"),
        ("cycloid.pin_count = 39", "design.cycloid.pin_count = 39: must exceed disc_teeth = 39"),
        ('involute.pressure_angle = "20 rad"', "pressure_angle = 20 rad: must lie below 45 deg"),
    ],
)
def test_natural_slips_in_a_design_name_their_key(line, words):
    with pytest.raises(study.StudyError, match=words):
        asked(f'[design]\nbase = "rv-40e"\n{line}')


def test_other_natural_slips(tmp_path, monkeypatch):
    two = asked('[design]\nbase = "rv-40e"\ncycloid.pin_count = 41')
    (doubt,) = two.doubts
    assert doubt.startswith("design.cycloid.pin_count: 2 more")
    with pytest.raises(study.StudyError, match=r"design.base or design.kind is missing"):
        asked('[design]\ncycloid.eccentricity = "1 mm"')
    uniform = HEAD.replace('half_width = "4 um"', 'half_width = "4 um"\ndistribution = "uniform"\ncp = 1.33')
    with pytest.raises(study.StudyError, match=r"tolerances.pin_radius.cp = 1.33: uniform ends at the limits"):
        study.parse_study(f'[design]\nbase = "rv-40e"\n{uniform}', name="x", solve=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text("", "utf-8")
    for name, near in (("rv40e", "rv-40e"), ("mine", "mine.toml")):
        with pytest.raises(FileNotFoundError, match=rf"{name} \(did you mean {near}\?\): neither"):
            study.load(name)
