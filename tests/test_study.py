"""Study files: what a good one means, and one clear line for every kind of bad one."""

import dataclasses
import types
from importlib import resources

import jax
import numpy as np
import pytest

from rvjax import catalogue, study
from rvjax.catalogue import RV_20E, RV_40E
from rvjax.designs import InvoluteStage
from rvjax.study import StudyError, parse_study
from rvjax.tolerances import Exponential, ReciprocalPower
from rvjax.units import arcmin, um

GOOD = (resources.files("rvjax.study") / "embedded" / "rv-40e.toml").read_text("utf-8")


def test_the_embedded_study_says_what_its_file_says():
    s = study.load("rv-40e", solve=False)
    assert "rv-40e" in study.embedded_names() and s.text == GOOD
    assert list(s.costs) == ["crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance"]
    assert set(s.costs) < set(s.fields) and "disc_runout" in s.fields
    assert s.design.cranks is catalogue.RV_40E.cranks
    assert s.design.cycloid.equidistant_modification == pytest.approx(-20 * um)
    assert s.conditions.output_torque == 412.0 and s.conditions.angles == 64
    assert float(s.tolerances.crank_eccentricity.half_width) == pytest.approx(6.5 * um)
    assert s.tolerances.disc_bore.shape == (2, 2, 2)
    assert s.tolerances.bearing_clearance.middle == pytest.approx(8 * um)
    assert s.tolerances.pin_position is None
    assert isinstance(s.costs["crank_phase"], ReciprocalPower)
    assert float(s.costs["crank_phase"](5 * arcmin)) == pytest.approx(1.0)
    assert s.requirements["transmission_error"].upper == pytest.approx(arcmin)
    assert s.requirements["misfit"].upper == pytest.approx(30 * um)
    assert s.requirements["lost_motion"].upper == pytest.approx(arcmin)
    assert sum(float(cost(getattr(s.tolerances, f).half_width)) for f, cost in s.costs.items()) == pytest.approx(
        21.96, abs=5e-3
    )


def test_the_response_gives_what_the_requirements_name_and_nothing_else():
    head, _, rest = GOOD.partition("[requirement.misfit]")
    s = parse_study(head + "[run]" + rest.partition("[run]")[2], name="x", solve=False)
    assert set(jax.eval_shape(s.response(), s.design.error_record()).value) == {"transmission_error"}


def test_a_file_with_a_byte_order_mark_is_read(tmp_path):
    (tmp_path / "windows.toml").write_text("\ufeff" + GOOD, "utf-8")
    assert study.load(str(tmp_path / "windows.toml"), solve=False).text == GOOD


def test_a_response_is_reported_in_the_unit_of_its_limit():
    one, two = 'upper = "1 arcmin"', 'lower = "-1 arcmin"'
    assert GOOD.count(one) == 2 and GOOD.count(two) == 1 and GOOD.index(two) < GOOD.rindex(one)
    asked = GOOD.replace(one, 'upper = "60 arcsec"').replace(two, 'lower = "-1 deg"').replace('"30 um"', '"30 µm"')
    found = parse_study(asked, name="x", solve=False)
    assert found.output("transmission_error").shown == ("arcsec", arcmin / 60)
    assert found.output("lost_motion").shown == ("deg", 60 * arcmin)  # of two limits the first
    assert found.output("misfit").shown == ("um", um)  # as rvjax spells it


def test_a_target_for_all_requirements_at_once():
    joint = GOOD.replace("seed = 0", "joint_target = 0.9973")
    assert [parse_study(text, name="x", solve=False).joint_target for text in (GOOD, joint)] == [None, 0.9973]


def test_overrides_units_and_cost_models():
    changes = 'cycloid.eccentricity = "1.25 mm"\ncranks.bearing_stiffness = "500 N/um"'
    text = GOOD.replace('base = "rv-40e"', f'base = "rv-40e"\n{changes}')
    old = '[cost.crank_phase]\nscale = 1\nreference = "5 arcmin"'
    text = text.replace(old, '[cost.crank_phase]\nmodel = "exponential"\nscale = 2\ndecay = "300 arcsec"')
    s = parse_study(text, name="x", solve=False)
    assert s.design.cycloid.eccentricity == pytest.approx(1.25e-3)
    assert s.design.cranks.bearing_stiffness == pytest.approx(5e8)
    assert isinstance(s.costs["crank_phase"], Exponential)
    assert float(s.costs["crank_phase"](5 * arcmin)) == pytest.approx(2 / np.e)


def test_derived_numbers_follow_changed_teeth():
    """An RV-80E on the base of an RV-40E: every radius of its gears, and its cranks on the axes of the planets."""
    changes = """
involute.sun_teeth = 10
involute.planet_teeth = 38
involute.module = "1.75 mm"
cycloid.eccentricity = "1.5 mm"
cycloid.pin_circle_radius = "76 mm"
cranks.count = 3
"""
    design = parse_study(GOOD.replace('base = "rv-40e"', f'base = "rv-40e"{changes}'), name="x", solve=False).design
    due = InvoluteStage.from_teeth(10, 38, module=1.75e-3, pressure_angle=RV_40E.involute.pressure_angle)
    for field in dataclasses.fields(InvoluteStage):
        assert getattr(design.involute, field.name) == pytest.approx(getattr(due, field.name)), field.name
    assert design.cranks.circle_radius == pytest.approx(42e-3)  # 1.75 mm * 48 / 2
    assert design.cycloid.shortening_coefficient == pytest.approx(1.5 * 40 / 76)


def test_a_published_design_keeps_its_numbers_until_they_are_changed():
    """The printed K1 of the RV-20E is not e zp / rp, nor are its radii those of its teeth."""
    study = GOOD.replace('base = "rv-40e"', 'base = "rv-20e"\ncranks.bearing_stiffness = "600 N/um"')
    as_printed = parse_study(study, name="x", solve=False).design
    assert as_printed.involute == RV_20E.involute and as_printed.cycloid.shortening == 0.72
    other = study.replace('"rv-20e"', '"rv-20e"\ncycloid.eccentricity = "1 mm"')
    changed = parse_study(other, name="x", solve=False).design
    assert changed.involute == RV_20E.involute
    assert changed.cycloid.shortening_coefficient == pytest.approx(
        1e-3 * RV_20E.cycloid.pin_count / RV_20E.cycloid.pin_circle_radius
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'base = "rv-40e"',
            'base = "rv-40e"\ncranks.circle_radius = "42 mm"',
            ["cranks.circle_radius = 42 mm", "centre_distance", "36 mm", "planet"],
        ),
        (
            'base = "rv-40e"',
            'base = "rv-40e"\ninvolute = {module = "1.75 mm", sun_base_radius = "9.4 mm"}',
            ["involute.sun_base_radius = 9.4 mm", "teeth and module make it"],
        ),
        ("[tolerances.crank_phase]", "[tolerances.crank_phases]", ["tolerances.crank_phases", "crank_phase"]),
        ('"5 arcmin"\n\n[tolerances.disc', '"5 um"\n\n[tolerances.disc', ["crank_phase.half_width", "5 um", "arcmin"]),
        (
            'half_width = "5 arcmin"',
            'half_width = "5 arcmin"\nsize = "25 mm"',
            ["tolerances.crank_phase.size = '25 mm'", "for lengths", "in rad"],
        ),
        ('half_width = "5 arcmin"', "half_width = 5", ["crank_phase.half_width", "5", "needs a unit"]),
        ('half_width = "5 arcmin"', 'half_width = "-5 arcmin"', ["crank_phase.half_width = '-5 arcmin'", "negative"]),
        ('lower = "4 um"', 'lower = "14 um"', ["bearing_clearance", "lower", "upper"]),
        ('grade = "IT6" # +-6.5 um', 'grade = "IT66"', ["crank_eccentricity", "IT66"]),
        (
            'size = "25 mm"\n\n[tolerances.crank_phase]',
            'size = "25 m"\n\n[tolerances.crank_phase]',
            ["crank_eccentricity", "size", "25 m"],
        ),
        (
            'size = "25 mm"\n\n[tolerances.crank_phase]',
            "\n[tolerances.crank_phase]",
            ["crank_eccentricity", "grade and size"],
        ),
        ('base = "rv-40e"', 'base = "rv-41e"', ["design.base", "rv-41e", "rv-40e"]),
        (
            'base = "rv-40e"',
            'base = "rv-40e"\ncycloid.eccentricity = "-1 mm"',
            ["eccentricity", "-0.001 m", "positive"],
        ),
        ('base = "rv-40e"', 'base = "rv-40e"\ncycloid.eccentricity = "2 mm"', ["shortening coefficient K1", "0.002 m"]),
        ('base = "rv-40e"', 'base = "rv-40e"\ncycloid.excentricity = "1 mm"', ["design.cycloid.excentricity"]),
        ('base = "rv-40e"', 'base = "rv-40e"\ncycloid.disc_teeth = 3.5', ["disc_teeth", "3.5", "integer"]),
        ("angles = 64", "angles = 6", ["conditions.angles", "6", "8"]),
        ("angles = 64", "samples = 256", ["conditions.samples = 256", "loaded_transmission_error"]),
        ("angles = 64", 'sun_speed = "150 rpm"', ["conditions.sun_speed = '150 rpm'", "vibration"]),
        ("angles = 64", "angels = 64", ["conditions.angels", "angles"]),
        ('output_torque = "412 N m"', 'output_torque = "412 N/m"', ["output_torque", "N/m", "N m"]),
        ("scale = 6", "scale = -6", ["cost.crank_eccentricity", "scale"]),
        ("scale = 6", 'scale = 6\nmodel = "linear"', ["cost.crank_eccentricity.model", "linear"]),
        ('finest = "2 um"\ncoarsest = "40 um"\n\n[cost.crank_phase]', "\n[cost.crank_phase]", ["finest", "missing"]),
        ("[cost.crank_phase]", "[cost.pin_position]", ["cost.pin_position", "tolerances.pin_position"]),
        ('response = "misfit"', 'response = "noise"', ["requirement.misfit.response", "noise", "transmission_error"]),
        ('response = "misfit"', 'response = "transmission_error"', ["requirement.misfit", "already"]),
        ('upper = "30 um"', 'upper = "30 arcmin"', ["requirement.misfit.upper", "30 arcmin", "um"]),
        ('upper = "30 um"\n', "", ["requirement.misfit", "upper or lower"]),
        ('upper = "30 um"\ntarget = 0.9973', 'upper = "30 um"\ntarget = 99.73', ["target", "99.73"]),
        ("seed = 0", "seed = -1", ["run.seed", "-1"]),
        ("seed = 0", "joint_target = 99.73", ["run.joint_target = 99.73", "between 0 and 1"]),
        ("samples = 16384", "samples = 64", ["run.samples = 64", "at least 100"]),
        (
            'half_width = "5 arcmin"',
            'lower = "0 deg"\nupper = "5 arcmin"\ndistribution = "von_mises"\nconcentration = 2',
            ["crank_phase: von_mises is for vectors"],
        ),
        ("seed = 0", "sead = 0", ["run.sead"]),
        ("[run]", "[runs]", ["[runs]"]),
        ("seed = 0", "seed = 6,5", ["TOML", "line", "decimals are written with a point: 6.5"]),
        ("target = 0.9973", 'target = "0,99"', ["target = '0,99'", "with a point: 0.99"]),
        ('half_width = "5 arcmin"', "half_width = 5,5 arcmin", ["TOML", "decimals are written with a point: 5.5"]),
        ("[design]", "[design", ["TOML", "line"]),
        ("[design]", "[design]\nbase = 3 #", ["TOML"]),
    ],
)
def test_bad_input_is_one_clear_line(old, new, words):
    assert old in GOOD
    with pytest.raises(StudyError, match=r"^bad\.toml: ") as caught:
        parse_study(GOOD.replace(old, new, 1), name="bad.toml")
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_unit_without_errors_that_cannot_be_solved_is_refused():
    """Free cranks of a parallelogram: at its change points the coupler may go either way."""
    text = """
[design]
base = "rv-40e"
[conditions]
angles = 8
cranks = "free"
[tolerances.disc_bore]
half_width = "1 um"
[requirement.transmission_error]
upper = "1 arcmin"
"""
    with pytest.raises(StudyError, match=r"^x: the unit without errors cannot be solved: CHANGE_POINT$"):
        parse_study(text, name="x")


def test_missing_files_and_names(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such study file"):
        study.load(str(tmp_path / "absent.toml"))
    with pytest.raises(FileNotFoundError, match="rv-40e"):
        study.load("rv-41e")
    with pytest.raises(FileNotFoundError, match=r"is a folder; it contains no study.toml$"):
        study.load(str(tmp_path))
    (tmp_path / "study.toml").write_text(GOOD)
    with pytest.raises(FileNotFoundError, match=rf"^{tmp_path}: is a folder; its study is {tmp_path}/study.toml$"):
        study.load(str(tmp_path))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(StudyError, match="cannot be read"):
        study.load(str(tmp_path / "binary.toml"))
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(StudyError, match="design"):
        study.load(str(tmp_path / "empty.toml"))


def test_a_costly_nominal_unit_is_solved_at_the_first_response(monkeypatch):
    """Compiling it takes seconds; who only reads the study does not wait, who computes is told."""
    from rvjax.commands.montecarlo import batch
    from rvjax.study import study as definition

    solved = []

    def refused(response, errors):
        solved.append(type(errors).__name__)
        raise ValueError("the unit without errors cannot be solved: CONTACT_OVERLOAD")

    monkeypatch.setattr(definition, "outcome_of", refused)
    whole = study.load("rv-40e-whole")
    assert not solved and whole.fields
    with pytest.raises(study.StudyError, match=r"rv-40e-whole: the unit without errors .* CONTACT_OVERLOAD"):
        whole.response()
    assert solved == ["RVErrors"]
    whole.response(solve=False), study.load("rv-40e-whole", solve=False).response()
    assert len(solved) == 1
    monkeypatch.setattr(definition, "outcome_of", lambda *_: solved.append("good") or types.SimpleNamespace(status=0))
    whole.response(), whole.response()
    assert solved == ["RVErrors", "good"]
    # A run of units compiles nothing for that one, but asks where all have failed.
    cheap = dataclasses.replace(study.load("corr", solve=False), to_solve=True)
    for failed, count in ((0, 0), (9, 0), (10, 1)):
        solved.clear()
        found = types.SimpleNamespace(samples=10, failed=failed)
        monkeypatch.setattr(batch.tolerances, "monte_carlo", lambda *_, found=found, **__: found)
        assert batch.run(dataclasses.replace(cheap), samples=10) is found
        assert len(solved) == count
