"""`rvjax export`: what it refuses, the units that it takes, the files that it writes.

Oracles: `running.joint` of the same unit; quantiles of given joint models.
"""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import CycloidalErrors, cli, geometry, loaded, measured, running, study
from rvjax.commands import export
from rvjax.commands.allocate import answer
from rvjax.status import SolveInfo, Status
from rvjax.units import arcmin, mm

STUDY = """
[design]
base = "cycloidal-17"
friction = {ring_pins = 0.05, output_pins = 0.05, input_drag = "0.01 N m"}
[conditions]
running_samples = 4
rated_torque = "8.8 N m"
[tolerances.throw]
half_width = "10 um"
[requirement.starting_torque]
upper = "1 N m"
[requirement.torsional_stiffness]
lower = "1 N m/arcmin"
"""
UNIT = '[errors]\npin_radius = "2 um"\nring_pin_friction = 0.4\nhole_position = {places}\n'
RESULT = dict.fromkeys(["seed", "versions", "cost", "shares", "certificate"], 0) | {"status": "OPTIMAL"}
RESULT |= {"tolerances": {"throw": {"after": {"lower": -1e-6, "upper": 5e-6}}}}
INERTIAS = ["--input-inertia", "1e-5 kg m2", "--output-inertia", "2e-3 kg m2"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.toml").write_text(STUDY)
    (tmp_path / "bare.toml").write_text(STUDY.replace("friction = ", "# "))
    (tmp_path / "unrated.toml").write_text(
        STUDY.replace('rated_torque = "8.8 N m"', "").partition("[requirement.torsional")[0]
    )
    (tmp_path / "other.toml").write_text('[design]\nbase = "corr"\n')
    (tmp_path / "empty.toml").write_text("")
    (tmp_path / "alone.toml").write_text('[design]\nbase = "cycloidal-17"\n')
    (tmp_path / "wrong.toml").write_text('[errors]\nthrow = "2 N"\n')
    (tmp_path / "ragged.toml").write_text(UNIT.format(places='[["1 um"], ["1 um", "2 um"]]'))
    (tmp_path / "there.json").write_text("mine")
    (tmp_path / "there.svg").write_text("mine")
    (tmp_path / "there.csv").write_text("mine")
    ringed = 'cycloidal-17"\nmember = "ring'  # no number differs
    for name, design in (("mine", "cycloidal-17"), ("other", "cycloidal-15"), ("ringed", ringed)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "study.toml").write_text(STUDY.replace("cycloidal-17", design))
        (tmp_path / name / "result.json").write_text(json.dumps(RESULT | {"study": name}))
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["drive.toml", "a.txt"],
            "must end with one of .xml, .mo, .urdf, .json, .dxf, .svg, .csv, or give --as",
        ),
        (["drive.toml", "there.json"], "there.json: exists already; name a new file"),
        (["drive.toml", "no/a.json"], "no/a.json: there is no such folder"),
        (["bare.toml", "a.json"], "bare: design.friction is missing"),
        (["other.toml", "a.json"], "other: an oscillatory roller reducer has no model of its friction"),
        (["unrated.toml", "a.json"], "conditions.rated_torque is missing; give it or --rated-torque"),
        (["drive.toml", "a.json", "--rated-torque", "0 N m"], "--rated-torque = '0 N m': must be positive"),
        (["drive.toml", "a.json", "--rated-torque", "8.8"], "--rated-torque = '8.8'"),
        (["drive.toml", "a.json", "--damping", "-1 N m s/rad"], "--damping = '-1 N m s/rad': must not be negative"),
        (["drive.toml", "a.xml"], "design.inertia is missing: mjcf needs both inertias; give --input-inertia"),
        (["drive.toml", "a.mo", *INERTIAS[:2]], "modelica needs both inertias; give --output-inertia"),
        (["drive.toml", "a.xml", *INERTIAS[:3], "0 kg m2"], "--output-inertia = '0 kg m2': must be positive"),
        (["drive.toml", "a.json", "--curve", "there.csv"], "there.csv: exists already; name a new file"),
        (["drive.toml", "a.json", "--curve", "no/a.csv"], "no/a.csv: there is no such folder"),
        (["drive.toml", "a.json", "--curve", "a.txt"], "--curve a.txt: must end with .csv"),
        (["drive.toml", "a.csv", "--as", "json", "--curve", "a.csv"], "--curve a.csv: must be another file"),
        (["drive.toml", "a.json", "--curve", "a.csv", "--unit", "p99"], "--curve a.csv: --unit p99 is no single unit"),
        (["drive.toml", "a.svg", "--curve", "a.csv"], "--curve: a.svg is an outline, which has no such option"),
        (["drive.toml", "a.json", "--samples", "9"], "--samples 9: needs --unit median or p99"),
        (["drive.toml", "a.json", "--unit", "mean"], "--unit mean: must be nominal, median, p99, or a .toml file"),
        (["drive.toml", "a.json", "--unit", "no.toml"], "--unit no.toml: no such file"),
        (["drive.toml", "a.json", "--unit", "empty.toml"], r"--unit empty.toml: [errors] is missing or empty"),
        (["drive.toml", "a.json", "--unit", "wrong.toml"], "errors.throw = '2 N': unit 'N'"),
        (["drive.toml", "a.json", "--unit", "ragged.toml"], "errors.hole_position: lists of different length"),
        (["drive.toml", "there.svg"], "there.svg: exists already; name a new file"),
        (["drive.toml", "a.svg", "--disc", "2"], "disc = 2: must lie between 0 and 1"),
        (["drive.toml", "a.svg", "--chord", "0 um"], "--chord = '0 um': must be positive"),
        (["drive.toml", "a.svg", "--result", "no"], "no: there is no results folder"),
        (["drive.toml", "a.svg", "--result", "other"], "other: is the result of another design than drive"),
        (["drive.toml", "a.svg", "--result", "ringed"], "ringed: is the result of another design than drive"),
        (["drive.toml", "a.svg", "--unit", "median"], "--unit: a.svg is an outline, which has no such option"),
        (["drive.toml", "a.json", "--part", "ring"], "--part: a.json is a joint model, which has no such option"),
        (["drive.toml", "a.txt", "--as", "sizes"], "a.txt: must end with .csv; --as sizes writes a table"),
        (["drive.toml", "there.csv", "--as", "sizes"], "there.csv: exists already; name a new file"),
        (["alone.toml", "a.csv", "--as", "sizes"], "[tolerances] is missing or empty"),
        (["drive.toml", "a.csv", "--as", "sizes", "--part", "ring"], "--part: a.csv is a table of sizes, which has no"),
        (["drive.toml", "a.csv", "--as", "sizes", "--damping", "1 N m s/rad"], "--damping: a.csv is a table of sizes"),
        (["drive.toml", "a.csv", "--as", "sizes", "--result", "no"], "no: there is no results folder"),
        (["drive.toml", "a.csv", "--as", "sizes", "--result", "other"], "other: is the result of another design"),
        (["other.toml", "a.svg", "--disc", "1"], "disc = 1: must lie between 0 and 0"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(folder, capsys, arguments, words):
    before = sorted(folder.iterdir())
    assert cli.main(["export", *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert sorted(folder.iterdir()) == before and (folder / "there.json").read_text() == "mine"


@pytest.mark.parametrize(("size", "warned"), [("0 um", True), ("1 um", False)])
def test_a_nominal_unit_without_clearance_is_warned_of(folder, monkeypatch, capsys, size, warned):
    monkeypatch.setattr(running, "joint", lambda design, errors, **_: tight(design))

    def tight(design):
        numbers = dict.fromkeys(running.units(running.Joint), jnp.ones(()))
        numbers |= dict(half_backlash=design.cycloid.equidistant_modification, ratio=jnp.float64(-17))
        return running.Joint(**numbers, info=SolveInfo(jnp.int32(0), jnp.int32(1), jnp.float64(0)))

    drive = (folder / "drive.toml").read_text()
    (folder / "tight.toml").write_text(
        drive.replace(
            'base = "cycloidal-17"',
            f'base = "cycloidal-17"\ncycloid = {{disc_count = 1, equidistant_modification = "{size}"}}',
            1,
        )
    )
    assert cli.main(["export", "tight.toml", "t.json", "--quiet"]) == 0
    assert ("warning: the nominal unit has no clearance" in capsys.readouterr().out) == warned


def test_sizes_of_a_study_and_of_its_result(folder, capsys):
    """Throw of 1.6 mm: +-10 um in the study, -1 to 5 um in the result, whose mid-point is +2 um."""
    assert cli.main(["export", "drive.toml", "a.csv", "--as", "sizes"]) == 0
    said = capsys.readouterr().out
    assert "Tolerances of drive." in said and "Sizes for the drawing:" in said and "a.csv: sizes" in said
    header = "part,feature,count,nominal [mm],upper [um],lower [um],grade,geometric,datum,error"
    written = (folder / "a.csv").read_text().splitlines()
    assert written[0] == header
    assert written[1] == 'shaft,"eccentric, eccentricity, each",2,1.6,10.0,-10.0,,,,throw'
    arguments = ["drive.toml", "b.csv", "--as", "sizes", "--result", "mine", "--format", "json"]
    assert cli.main(["export", *arguments]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["file"], told["tolerances"]) == ("b.csv", "mine, OPTIMAL")
    (row,) = told["sizes"]
    assert [row["nominal"], row["upper"], row["lower"]] == pytest.approx([1.602e-3, 3e-6, -3e-6], rel=1e-9)
    assert ",1.602,3" in (folder / "b.csv").read_text() and row["grade"] == ""  # no feature of size


def test_a_stored_result_that_no_option_names_is_said(folder, monkeypatch, capsys):
    """Sizes of a study are not those that were certified."""
    assert cli.main(["export", "drive.toml", "b.csv", "--as", "sizes"]) == 0
    assert "is a result of" not in capsys.readouterr().out
    line = "results/drive is a result of this study: --result results/drive takes "
    monkeypatch.setattr(answer, "folder", lambda study, option: Path("results", study.name))
    for name, form, taken in (("a.csv", ["--as", "sizes"], "its tolerances."), ("a.svg", [], "the mid-points of its")):
        for number, option in enumerate(([], ["--result", "mine"])):
            assert cli.main(["export", "drive.toml", f"{number}{name}", *form, *option]) == 0
            assert (line + taken in " ".join(capsys.readouterr().out.split())) == (not option)


def test_a_result_of_design_gives_its_numbers(folder, capsys):
    """Eccentricity 1.5 mm in place of 1.6, pins 2.5 mm: flank, holes, and the shaft at the mid-point of +2 um."""
    chosen = {"values": {"cycloid.eccentricity": 1.5e-3, "cycloid.pin_radius": 2.5e-3}, "study": "drive"}
    made = {key: value for key, value in (RESULT | chosen).items() if key != "shares"}
    (folder / "mine" / "result.json").write_text(json.dumps(made))
    assert cli.main(["export", "drive.toml", "b.csv", "--as", "sizes", "--result", "mine", "--format", "json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["sizes"]
    assert row["nominal"] == pytest.approx(1.502e-3, rel=1e-9)
    for number, wrong in enumerate(({"cycloid.nothing": 1.0}, {"cycloid.eccentricity": "wide"}, 5)):
        (folder / "other" / "result.json").write_text(json.dumps(made | {"values": wrong}))
        (folder / "other" / "study.toml").write_text(STUDY)
        assert cli.main(["export", "drive.toml", f"{number}.csv", "--as", "sizes", "--result", "other"]) == 2
        said = capsys.readouterr().err
        assert "--result other: no result of drive" in said and len(said.splitlines()) == 1
    design = study.load("drive.toml", solve=False).design
    cycloid = design.cycloid.replace(eccentricity=1.5e-3, pin_radius=2.5e-3)
    due = geometry.outline(design.replace(cycloid=cycloid), errors=CycloidalErrors(throw=2e-6))
    assert cli.main(["export", "drive.toml", "a.svg", "--result", "mine"]) == 0
    polygon, circle = (
        next(ElementTree.parse("a.svg").iter("{http://www.w3.org/2000/svg}" + name)) for name in ("polygon", "circle")
    )
    found = [tuple(map(float, point.split(","))) for point in polygon.get("points").split()]
    np.testing.assert_allclose(np.array(found) * mm, np.asarray(due.flank), atol=1e-10)
    assert float(circle.get("r")) * mm == pytest.approx(float(due.circles[0].radius), abs=1e-10)


def test_conditions_of_a_joint_model_count_as_read():
    """Of a design alone, and of one with friction whose required responses do not read them."""
    alone = STUDY.partition("[tolerances")[0]
    assert study.parse_study(alone, name="x", needs=("design",)).conditions.rated_torque == 8.8
    other = STUDY.replace("[requirement.torsional_stiffness]", "[requirement.hysteresis]").replace("lower =", "upper =")
    other = other.replace('"1 N m/arcmin"', '"9 arcmin"')
    assert study.parse_study(other, name="x", solve=False).conditions.rated_torque == 8.8
    with pytest.raises(study.StudyError, match=r"rated_torque = '8\.8 N m': no response required here reads it"):
        study.parse_study(other.replace("friction = ", "# "), name="x", solve=False)


@pytest.mark.long  # test_running.py has joint models, test_cycloidal_studies.py the backlash of the drive
def test_a_drive_without_errors(folder, capsys):
    """Backlash and stiffness of an independent solution (docs/models/single_stage.md); friction in the clearance."""
    assert cli.main(["export", "drive.toml", "a.json", "--format", "json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["file"] == "a.json"
    found = json.loads((folder / "a.json").read_text())
    assert (found["study"], found["unit"], found["rvjax"]) == ("drive", "nominal", rvjax.__version__)
    assert found["half_backlash"] == pytest.approx(23.916 / 2 * arcmin, rel=2e-3)
    assert found["stiffness"] == pytest.approx(6.4845 / arcmin, rel=2e-3)
    assert found["ratio"] == -17 and found["input_friction"] == pytest.approx(0.17) and found["output_friction"] == 0
    assert 0.05 < found["forward_loss"] == pytest.approx(found["backward_loss"], rel=1e-6)
    assert found["rotor_inertia"] is None and found["damping"] is None


def test_a_measured_unit_with_the_options(folder, monkeypatch, capsys):
    """The joint model is a function of what it is given."""

    def joint(design, errors, **ways):
        assert ways == dict(
            rated_torque=4.0, damping=3.0, input_angle=0.0, samples=4, contact="hertz", carrier="fixed", sun="fixed"
        )
        numbers = dict.fromkeys(running.units(running.Joint), jnp.ones(()))
        numbers |= dict(
            half_backlash=errors.pin_radius, stiffness=jnp.sum(errors.hole_position), ratio=jnp.float64(-17)
        )
        numbers |= dict(damping=jnp.float64(3), input_friction=errors.ring_pin_friction, rotor_inertia=None)
        return running.Joint(**numbers, info=SolveInfo(jnp.int32(0), jnp.int32(1), jnp.float64(0)))

    monkeypatch.setattr(running, "joint", joint)
    places = [[["1 um", "0 m"]] * 6, [["0 m", "2 um"]] * 6]
    (folder / "unit.toml").write_text(UNIT.format(places=places))
    command = ["--rated-torque", "4 N m", "--damping", "3 N m s/rad", "--unit", "unit.toml", "--quiet"]
    assert cli.main(["export", "drive.toml", "b.txt", "--as", "mjcf", *INERTIAS, *command]) == 0
    natural = np.sqrt(6 * 3e-6 * (1 / (1e-5 * 17**2) + 1 / 2e-3))  # of the train
    said = capsys.readouterr().out
    assert "b.txt: mjcf" in said and f"The timestep is {0.1 / natural:.2g} s" in said
    text = (folder / "b.txt").read_text()
    root = ElementTree.fromstring(text)
    train, rotor = root.find("tendon/fixed"), root.find("worldbody/body[@name='rotor']/joint")
    assert float(train.get("stiffness")) == pytest.approx(6 * 3e-6) and float(train.get("damping")) == 3
    assert float(train.get("springlength").split()[1]) == 2e-6 and float(rotor.get("frictionloss")) == 0.4
    assert float(rotor.get("armature")) == pytest.approx(1e-5 * 17**2)
    assert float(root.find("worldbody/body[@name='output']/joint").get("armature")) == 2e-3
    assert "unit: unit.toml" in text[: text.index("-->")]


def test_the_curve_is_that_of_the_unit_and_is_read_back(folder, monkeypatch, capsys):
    """Of a joint model and an error that are given: the arguments are those of the joint model, at 24 angles a turn."""
    seen, wave = [], 1e-4 * np.cos(2 * np.pi * 3 * np.arange(24 * 18) / (24 * 18))
    numbers = {name: np.float64(1) for name in running.units(running.Joint)}
    status = [0]

    def revolution(design, errors, **ways):
        seen.append((float(errors.pin_radius), float(errors.ring_pin_friction), ways))
        return SimpleNamespace(error=wave, info=SimpleNamespace(status=status[0]))

    monkeypatch.setattr(export, "_of_unit", lambda *_: running.Joint(**numbers, info=SolveInfo(0, 1, 0.0)))
    monkeypatch.setattr(loaded, "revolution", revolution)
    (folder / "unit.toml").write_text(UNIT.format(places=[[["1 um", "0 m"]] * 6] * 2))
    command = ["export", "drive.toml", "a.json", "--unit", "unit.toml", "--curve", "a.csv", "--rated-torque", "4 N m"]
    assert cli.main(command) == 0
    ways = dict(output_torque=4.0, turns=1.0, samples=24 * 18, contact="hertz", carrier="fixed", sun="fixed")
    assert seen == [(2e-6, 0.4, ways)] and "a.csv: transmission error over a turn of the output under 4 N m" in (
        capsys.readouterr().out
    )
    (run,) = measured.read([folder / "a.csv"]).runs
    np.testing.assert_allclose(run.error, wave, atol=1e-15)
    np.testing.assert_allclose(run.angle, 2 * np.pi * np.arange(24 * 18) / (24 * 18), atol=1e-12)
    assert run.at.torque == 4
    status[0] = int(Status.UNDERCUT)
    assert cli.main(["export", "drive.toml", "b.json", "--curve", "b.csv"]) == 2
    assert "--curve: cannot be solved: UNDERCUT" in capsys.readouterr().err and not (folder / "b.json").exists()


def test_the_curve_of_an_rv_reducer_has_the_stiffness_of_its_unit(monkeypatch):
    """And 24 angles for each of the 40 turns of a crank."""
    asked, seen = study.load("rv-40e-whole", solve=False), []

    def revolution(design, errors, **ways):
        seen.append((float(design.stiffness.disc_pin_mesh), ways["samples"], ways["sun"]))
        return SimpleNamespace(error=np.zeros(1), info=SimpleNamespace(status=0))

    monkeypatch.setattr(loaded, "revolution", revolution)
    inputs = SimpleNamespace(study=asked, curve=Path("a.csv"), torque=412.0)
    export._error(inputs, rvjax.RVErrors.for_design(asked.design, disc_pin_stiffness=0.1))
    assert seen == [(pytest.approx(1.1 * asked.design.stiffness.disc_pin_mesh), 960, "fixed")]


@pytest.fixture
def units(folder, monkeypatch):
    """A command whose hundred units are given: numbers 0 to 99, of which some cannot be solved."""

    def run(unit, failed):
        each = np.arange(100.0)
        info = jax.vmap(SolveInfo)(np.where(each < failed, 3, 0), np.ones(100, int), np.zeros(100))
        numbers = {name: np.where(each < failed, np.nan, each) for name in running.units(running.Joint)}
        numbers |= dict(damping=None, rotor_inertia=None, output_inertia=None)
        joint = jax.vmap(lambda numbers, info: running.Joint(**numbers, info=info))(numbers, info)
        monkeypatch.setattr(export, "_of_units", lambda *_: joint)
        return cli.main(["export", "drive.toml", "a.json", "--unit", unit, "--samples", "100", "--quiet"])

    return SimpleNamespace(run=run, file=folder / "a.json")


def test_a_statistic_takes_the_unfavourable_side_of_every_number(units, capsys):
    assert units.run("p99", 0) == 0
    found = json.loads(units.file.read_text())
    assert found["stiffness"] == pytest.approx(99 - 98.01) and found["half_backlash"] == pytest.approx(98.01)
    assert found["input_friction"] == found["backward_loss"] == pytest.approx(98.01)
    assert found["unit"].startswith("p99, no single unit") and "100 random units" in found["unit"]


def test_units_that_fail_count_as_unfavourable(units, capsys):
    assert units.run("median", 10) == 0
    found = json.loads(units.file.read_text())
    assert found["half_backlash"] == pytest.approx(10 + 49.5) and found["stiffness"] == pytest.approx(99 - 49.5)
    assert "10 of them cannot be solved" in found["unit"]
    units.file.unlink()
    capsys.readouterr()
    assert units.run("p99", 10) == 2
    assert capsys.readouterr().err == "rvjax: error: drive: unit p99: 10 of 100 units cannot be solved\n"
    assert not units.file.exists()


def test_outlines_need_no_friction_and_say_what_they_show(folder, capsys):
    assert cli.main(["export", "alone.toml", "parts.svg", "--part", "all", "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "Sizes of the design" in said and "carrier: bolts" in said and "parts.svg: disc 0, ring, carrier" in said
    root = ElementTree.fromstring((folder / "parts.svg").read_text())
    groups = [group.get("id") for group in root.iter("{http://www.w3.org/2000/svg}g") if group.get("id")]
    assert groups == ["DISC_0_FLANK", "DISC_0_HOLE", "DISC_0_BORE", "RING_PIN", "RING_PIN_CIRCLE", "CARRIER_OUTPUT_PIN"]
    assert cli.main(["export", "drive.toml", "a.csv", "--result", "mine", "--format", "json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["sizes"] == "the mid-points of mine, OPTIMAL" and found["file"] == "a.csv"
    (folder / "mine" / "result.json").write_text(json.dumps(RESULT | {"study": "mine", "status": "INFEASIBLE"}))
    assert cli.main(["export", "drive.toml", "b.csv", "--result", "mine", "--quiet"]) == 0
    assert "the mid-points of mine, INFEASIBLE: not certified" in " ".join(capsys.readouterr().out.split())
    assert (folder / "a.csv").read_text().startswith("# Outlines of drive (study ")


def test_mid_points_are_sizes_of_the_parts():
    """Those of a result: lower and upper limits, one number or one for each hole."""
    tolerances = study.parse_study(STUDY, name="x", solve=False).tolerances
    tolerances = tolerances.replace(throw=tolerances.throw.replace(lower=-1e-6, upper=5e-6))
    found = study.mid_points(tolerances, rvjax.CycloidalErrors)
    assert float(found.throw) == pytest.approx(2e-6) and float(found.hole_radius) == 0
    whole = study.mid_points(study.load("cycloidal-17", solve=False).tolerances, rvjax.CycloidalErrors)
    assert np.all(whole.hole_position == 0) and float(whole.bearing_clearance) == pytest.approx(10e-6)  # a vector
