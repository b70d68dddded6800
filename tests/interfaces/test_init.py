"""`rvjax init`: a study of the loaded reducer for every known size and for a drawing; what is assumed says so."""

import math
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from cli_study import DRAWING

from rvjax import catalogue, cli, study
from rvjax.commands.allocate import shortfalls
from rvjax.commands.init import written
from rvjax.geometry import figures
from rvjax.life import dynamic_rating, static_rating
from rvjax.study.kinds import changed, number_at
from rvjax.study.kinds.rv_facts import LAWS
from rvjax.units import arcmin, mm, rpm, um

BASES = ["rv-20e", "rv-40e", "rv-40e-whole", "rv-80e", "rv-320e"]
LOADED = {"loaded_transmission_error", "misfit", "bench_lost_motion", "life", "turn_pin_pressure", "arm_bearing_force"}


def read(text, name="mine"):
    return study.parse_study(text, name=name, solve=False)


@pytest.mark.parametrize("base", BASES)
def test_a_study_of_every_size_is_that_of_the_loaded_reducer(base):
    new = written(base)
    made, known = read(new.text), study.BASES[base]
    assert set(made.requirements) == LOADED and made.costly and made.doubts == [] and new.warnings == ()
    torque = {"rv-20e": 167.0, "rv-80e": 784.0, "rv-320e": 3136.0}.get(base, 412.0)
    assert made.conditions.output_torque == made.conditions.rated_torque == torque
    np.testing.assert_allclose(made.conditions.duty, [[torque, 15 * rpm, 3600.0]])
    assert made.requirements["life"].lower == 6000 * 3600.0
    for path, value, _ in catalogue.walk(known):
        part = path.split(".")[0]
        if np.any(value) and part in ("involute", "cycloid", "cranks", "stiffness", "contact", "bearings"):
            np.testing.assert_allclose(number_at(made.design, path), value, rtol=1e-3, err_msg=path)


@pytest.mark.parametrize("base", BASES)
def test_every_number_without_a_source_says_that_it_is_assumed(base):
    made, sources = read(written(base).text), catalogue.sources(base)
    paths = [
        path for path, _, _ in catalogue.walk(made.design) if path.split(".")[0] in ("stiffness", "contact", "bearings")
    ]
    unsaid = ("output_support", "output_torsion", "contact_angle", "rating_factor")  # defaults
    lacking = {path for path in paths if path not in sources and not path.endswith(unsaid)}
    assert lacking <= set(made.assumed) and (len(lacking) == 0) == (base == "rv-40e-whole")
    for line in written(base).text.splitlines():
        if "scaling law" in line and "=" in line:
            assert re.search(r'assumed: scaling law "[\w -]+", .* of the RV-\d+E \(holds for 0\.5 to 2\)', line), line


def test_the_study_of_the_whole_rv_40e_has_the_numbers_of_the_embedded_one():
    for base in ("rv-40e-whole", "rv-40e"):
        made, due = read(written(base).text), study.load("rv-40e-whole", solve=False)
        for name in ("conditions", "tolerances", "costs", "requirements", "seed", "samples", "certificate_samples"):
            assert repr(getattr(made, name)) == repr(getattr(due, name)), name
        for part in ("involute", "cycloid", "cranks", "stiffness", "contact", "bearings"):
            own = {path: value for path, value, _ in catalogue.walk(getattr(made.design, part))}
            for path, value, _ in catalogue.walk(getattr(due.design, part)):
                np.testing.assert_allclose(own[path], value, rtol=1e-11, err_msg=path)


def test_numbers_of_another_size_by_hand():
    """RV-80E from the RV-40E: pin circle 78/64, crank circle 42/36, sun 8.75/10."""
    made = read(written("rv-80e").text).design
    ring, crank, sun = 78 / 64, 42 / 36, 8.75 / 10
    for path, due in {
        "contact.face_width": 12e-3 * ring,
        "stiffness.turning_arm_bearing": 600e6 * ring**0.8,
        "stiffness.support_bearing": 900e6 * crank**0.8,
        "stiffness.planet_crank_bending": 200e6 * crank,
        "stiffness.planet_crank_torsion": 50e3 * crank**3,
        "stiffness.disc_pin_mesh": 600e6 * ring,
        "stiffness.sun_planet_mesh": 200e6 * ring,
        "stiffness.sun_support": 40e6 * sun,
        "stiffness.sun_torsion": 10e3 * sun**3,
        "bearings.support_span": 40e-3 * ring,
    }.items():
        assert number_at(made, path) == pytest.approx(due, rel=1e-3), path
    np.testing.assert_allclose(made.bearings.disc_position, np.array([14e-3, 26e-3]) * ring, rtol=1e-3)


def unit(diameter):
    return 0.45 * diameter ** (1 / 3) + 0.001 * diameter


def test_tolerances_follow_the_size_that_each_belongs_to():
    made, whole = read(written("rv-320e").text), study.load("rv-40e-whole", solve=False)
    ring, pin = unit(228) / unit(128), unit(10) / unit(6)
    arm, planet = unit(48) / unit(32), unit(2 * 48.63) / unit(2 * 24.432)
    for name, ratio in {
        "disc_centre": ring, "disc_pitch": ring, "pin_offset": ring, "ring_centre": ring, "pin_circle_radius": ring,
        "shift_modification": ring, "pin_radius": pin, "pin_radii": pin, "pin_hole_clearance": pin,
        "bearing_clearance": arm, "planet_runout": planet, "base_tangent_upper": planet, "crank_phase": 1.0,
    }.items():  # fmt: skip
        own, due = (float(getattr(one.tolerances, name).half_width) for one in (made, whole))
        assert own == pytest.approx(due * ratio, rel=0.005 / min(ratio, 1)), name
        if name in whole.costs:
            for key in ("finest", "coarsest", "reference"):
                assert getattr(made.costs[name], key) == pytest.approx(
                    getattr(whole.costs[name], key) * ratio, rel=6e-3
                )
            assert made.costs[name].scale == whole.costs[name].scale
    tolerance = made.tolerances.disc_bore
    assert tolerance.size == pytest.approx(25 * 48 / 32 * mm) and float(tolerance.half_width) == pytest.approx(
        8 * um
    )  # IT6
    assert made.requirements["misfit"].upper == pytest.approx(30 * um * arm, rel=5e-3)


@pytest.mark.parametrize("base", BASES)
def test_the_force_of_an_arm_bearing_has_the_static_safety_of_its_own_bearing(base):
    made = read(written(base).text)
    limit, own = made.requirements["arm_bearing_force"].upper, float(static_rating(made.design.bearings.arm))
    assert own / 1.5 / 2.5 - 100 <= limit <= own / 1.5 / 2.5


def test_further_discs_are_side_by_side():
    """Three discs of the RV-320E: the spacing of the RV-40E in proportion to the width, the span longer by one."""
    bearings, width = read(written("rv-320e").text).design.bearings, 114 / 64
    np.testing.assert_allclose(bearings.disc_position, np.array([14e-3, 26e-3, 38e-3]) * width, rtol=1e-3)
    assert bearings.support_span == pytest.approx(52e-3 * width, rel=1e-3)


def test_contradictions_of_a_published_reducer_are_said():
    text = written("rv-20e").text
    assert 'base = "rv-20e" # its published values contradict each other' in text
    assert "K1 = e zp / rp = 0.6923" in text and read(text).design.cycloid.shortening == 0.72


def test_a_drawing_alone_gives_the_loaded_study(drawing):
    new = written(drawing())
    made = read(new.text)
    given = tomllib.loads(DRAWING)["design"]
    assert made.design.involute.planet_teeth == given["involute"]["planet_teeth"] and made.design.cranks.count == 3
    assert made.design.cranks.circle_radius == pytest.approx(1.5 * mm * (14 + 42) / 2)
    assert made.design.ratio == 1 + 42 / 14 * 40 and set(made.requirements) == LOADED and made.doubts == []
    assert made.design.bearings.arm.roller_diameter == pytest.approx(7 * mm)  # of the RV-80E, the nearest in size
    assert made.conditions.rated_torque == 784.0 and "assumed: as the RV-80E" in new.text
    assert {"contact.face_width", "cycloid.disc_count", "stiffness.disc_pin_mesh"} <= set(made.assumed)
    assert "cycloid.eccentricity" not in made.assumed


def test_numbers_of_a_drawing_stand_and_others_follow_them(drawing):
    text = (
        DRAWING
        + 'contact.face_width = "16 mm" # measured\ncycloid.disc_count = 3\ninvolute.centre_distance = "43 mm"\n'
        + '[conditions]\nrated_torque = "900 N m"\n'
    )
    new = written(drawing(text))
    made = read(new.text)
    assert made.design.contact.face_width == 16 * mm and made.conditions.duty[0][0] == 900.0
    assert "contact.face_width" not in made.assumed and "; measured" in new.text
    assert made.design.involute.centre_distance == made.design.cranks.circle_radius == 43 * mm  # shifted: 42 mm without
    assert made.design.stiffness.disc_pin_mesh == pytest.approx(600e6 * 16 / 12, rel=1e-3)
    np.testing.assert_allclose(np.diff(made.design.bearings.disc_position), [16 * mm] * 2, rtol=1e-3)


def test_a_torque_follows_the_size_and_an_interval_is_warned_of(drawing):
    """94 mm is nearest to 78 mm; 25 mm is below half of the smallest known pin circle."""
    large = DRAWING.replace('"78 mm"', '"94 mm"').replace('"1.5 mm"\ncycloid.pin', '"1.8 mm"\ncycloid.pin')
    assert read(written(drawing(large)).text).conditions.rated_torque == pytest.approx(784 * (94 / 78) ** 3, rel=3e-3)
    small = (
        DRAWING.replace("78 mm", "25 mm")
        .replace('"3.5 mm"', '"1.2 mm"')
        .replace('module = "1.5 mm"', 'module = "0.5 mm"')
    )
    small = small.replace('eccentricity = "1.5 mm"', 'eccentricity = "0.45 mm"')
    new = written(drawing(small))
    assert any(line.startswith("cycloid.pin_circle_radius: 0.391 times that of the RV-40E") for line in new.warnings)
    assert "(holds for 0.5 to 2); warning: outside of it" in new.text
    assert len(new.warnings) == len(set(new.warnings))


def test_a_bearing_that_does_not_fit_into_the_disc_is_warned_of(drawing):
    """Cranks at 1.5 mm 76/2 = 57 mm: 2 (78 - 3.5 - 3 - 57) = 29 mm are left; the scaled rollers need more."""
    new = written(drawing(DRAWING.replace("planet_teeth = 42", "planet_teeth = 62")))
    across = (36 + 7) * 57 / 42
    assert f"bearings.arm: {across:.4g} mm across the rollers, but the disc has 29 mm there (assumed)" in new.warnings
    small = DRAWING.replace("planet_teeth = 42", "planet_teeth = 62")
    small += 'bearings.arm.pitch_diameter = "22 mm"\nbearings.arm.roller_diameter = "4.5 mm"\n'
    assert written(drawing(small)).warnings == ()


def test_modifications_that_a_four_bar_study_assumes_are_not_taken_over(tmp_path):
    (tmp_path / "old.toml").write_text(written("rv-80e", "four-bar").text)
    new = written(str(tmp_path / "old.toml"))
    assert read(new.text).design.cycloid.equidistant_modification == pytest.approx(-2.16 * um)
    assert any("not taken over: [cost], [middle], [requirement], [run], [tolerances]" in line for line in new.warnings)
    text = (tmp_path / "old.toml").read_text()
    assert "; assumed; initially -20 um" in text
    text = text.replace('"-20 um" # profile', '"-4 um" # profile')  # the value decides, not the comment
    (tmp_path / "old.toml").write_text(text)
    assert read(written(str(tmp_path / "old.toml")).text).design.cycloid.equidistant_modification == pytest.approx(
        -4 * um
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'cycloid.eccentricity = "1.5 mm"\n',
            "",
            r"\[design\] lacks cycloid.eccentricity \(nominal eccentricity .*, in m\)",
        ),
        ("cranks.count = 3\n", "", r"lacks cranks.count \(crankshafts, each with its planet\)"),
        ('"78 mm"', '"78 kg"', "design.cycloid.pin_circle_radius = '78 kg': unit 'kg' is not one of m, mm, um"),
        ('"78 mm"', '"50 mm"', "shortening coefficient K1 must lie between 0 and 1"),
        ("cycloid.pin_count = 40", "cycloid.pins = 40", "unknown key design.cycloid.pins"),
        ("cycloid.pin_count = 40", "cycloid.pin_count = 4.5", "design.cycloid.pin_count = 4.5: must be an integer"),
        ('kind = "rv"', 'kind = "oscillatory-roller"', "design.kind = 'oscillatory-roller': must be one of rv"),
        (DRAWING, "", r"\[design\] is missing or empty"),
        (DRAWING, "[design", "not valid TOML"),
        (
            "cranks.count = 3\n",
            'cranks.count = 3\n[conditions]\nrated_torque = "-3 N m"\n',
            "rated_torque = '-3 N m': must be positive",
        ),
    ],
)
def test_what_a_drawing_lacks_is_one_line(drawing, tmp_path, monkeypatch, capsys, old, new, words):
    monkeypatch.chdir(tmp_path)
    assert old in DRAWING
    drawing(DRAWING.replace(old, new))
    assert cli.main(["init", "mine.toml", "--base", "drawing.toml"]) == 2
    said = capsys.readouterr().err
    assert re.search(words, said) and len(said.splitlines()) == 1 and not (tmp_path / "mine.toml").exists()


SIZES = [pytest.param(base, marks=pytest.mark.long) for base in ("rv-40e-whole", "rv-80e", "rv-320e")]


@pytest.mark.parametrize("base", ["rv-20e", *SIZES, "corr"])
def test_a_study_with_variables_of_every_kind_begins_at_its_design(base):
    """Bounds contain the number at the start; the limits without errors hold there; the space, or the cam, costs 10."""
    made, plain = read(written(base, variables=True).text), read(written(base).text)
    assert set(made.variables) >= {"cam_radius" if base == "corr" else "cycloid.pin_circle_radius"}
    for path, variable in made.variables.items():
        assert variable.lower < number_at(made.design, path) == variable.start < variable.upper, path
    assert set(made.requirements) == set(plain.requirements) and made.conditions == plain.conditions
    if base == "corr":
        assert made.variables["cam_radius"].cost(135 * mm) == pytest.approx(10) and not made.nominal
        return
    found = figures(made.design)
    assert float(made.objective["envelope_volume"](found.envelope_volume)) == pytest.approx(10, rel=0.03)
    assert set(made.nominal) == {"convex_radius", "pin_gap", "crank_room", "envelope_diameter"}
    for name, limits in made.nominal.items():
        assert limits.lower < getattr(found, name) < limits.upper, name
    assert made.nominal["envelope_diameter"].upper / found.envelope_diameter == pytest.approx(1.03, rel=5e-3)


def test_commands(tmp_path, monkeypatch, unsolved, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", "mine.toml", "--base", "rv-80e"]) == 0
    assert "a study of the rv-80e to change. Next: rvjax check mine.toml" in capsys.readouterr().out
    assert cli.main(["check", "mine.toml"]) == 0
    said = capsys.readouterr().out
    assert "rvjax init NEW.toml" not in said and "No warnings" in said and "time: about" in said
    assert cli.main(["init", "other.toml", "--base", "none.toml"]) == 2
    assert "--base none.toml: cannot be read" in capsys.readouterr().err
    assert cli.main(["init", "four.toml", "--base", "rv-80e", "--model", "four-bar"]) == 0
    assert cli.main(["check", "four.toml"]) == 0
    said = capsys.readouterr().out
    assert "every pin, both stages" in said and "rvjax init NEW.toml --base four.toml writes its study" in said
    assert cli.main(["check", "corr"]) == 0 and "rvjax init" not in capsys.readouterr().out
    assert cli.main(["check", "rv-40e"]) == 0 and "--base rv-40e writes" in capsys.readouterr().out


def test_laws_of_a_size_leave_single_changes_alone():
    whole = catalogue.RV_40E_WHOLE
    values = {"cycloid.pin_circle_radius": 70 * mm}
    assert {law.name for law in LAWS if law.whole}.isdisjoint(law.name for law in LAWS if not law.whole)
    assert changed(whole, values).contact.face_width == whole.contact.face_width
    assert changed(whole, values, whole=True).contact.face_width == pytest.approx(12 * mm * 70 / 64)


def infeasible(missing):
    return SimpleNamespace(shortfall=missing, feasible=False, status="INFEASIBLE")


def test_a_limit_that_is_not_certified_says_which_one_would_be():
    """Of 1000 units 985 are well within 1 arcmin and 15 at 1.1 arcmin: 99 % are proved from 1.1 arcmin on."""
    made = read(written("rv-20e").text)
    values = np.where(np.arange(1000) < 985, 0.2, 1.1) * arcmin
    verdicts = {name: SimpleNamespace(met=name != "bench_lost_motion") for name in made.requirements}
    certificate = SimpleNamespace(values=dict.fromkeys(made.requirements, values), verdicts=verdicts)
    found = SimpleNamespace(shortfall={}, feasible=True, status="NOT_CERTIFIED", certificate=certificate)
    due = "would have to move by 0.1 arcmin: <= 1.1 arcmin can be met"
    assert shortfalls(made, found) == {"bench_lost_motion": due}
    assert shortfalls(made, SimpleNamespace(shortfall={}, feasible=True, status="OPTIMAL")) == {}


def test_what_prevents_a_limit_and_what_would_do_is_said():
    """4000 of 6000 h: the rating C times 1.5^0.3 = 1.129; the assumed limit of the pressure by its value."""
    made = read(written("rv-80e").text)
    missing = {"life": 2000 * 3600.0, "turn_pin_pressure": 300e6, "misfit": 0.0, "bench_lost_motion": 0.2 * arcmin}
    found = shortfalls(made, infeasible(missing | {"arm_bearing_force": math.inf}))
    assert list(found) == ["life", "turn_pin_pressure", "bench_lost_motion", "arm_bearing_force"]
    rating = float(dynamic_rating(made.design.bearings.arm)) / 1e3
    assert found["life"] == (
        "would have to move by 2000 h: >= 4000 h can be met; the assumed crank bearings prevent it: 1.13 times their "
        f"rating C would do (bearings.arm: {1.5**0.3 * rating:.3g} kN instead of {rating:.3g} kN)"
    )
    assert found["turn_pin_pressure"] == (
        "would have to move by 300 MPa: <= 3100 MPa can be met; the assumed limit prevents it: <= 3100 MPa would do"
    )
    assert found["bench_lost_motion"] == "would have to move by 0.2 arcmin: <= 1.2 arcmin can be met"
    assert found["arm_bearing_force"] == "cannot be met: too many units fail"
    certain = read(re.sub(r"(bearings.*?) # .*", r"\1 # measured", made.text))
    assert shortfalls(certain, infeasible(missing))["life"].endswith(": >= 4000 h can be met")


@pytest.mark.long
@pytest.mark.parametrize("base", ["rv-20e", "rv-80e", "rv-320e", "drawing.toml"])
def test_the_chain_of_every_size_ends_with_a_certificate(drawing, tmp_path, monkeypatch, capsys, base):
    """`init`, `check`, `allocate`: optimal tolerances, or the assumed value that prevents them."""
    monkeypatch.chdir(tmp_path)
    drawing()
    assert cli.main(["init", "mine.toml", "--base", base]) == 0
    assert cli.main(["check", "mine.toml"]) == 0 and "No warnings" in capsys.readouterr().out
    code = cli.main(["allocate", "mine.toml", "--quiet"])
    said = capsys.readouterr().out
    assert (code == 0 and "Study mine: OPTIMAL" in said) or re.search("the assumed .* prevents? it: .* would do", said)
