"""`rvjax init` of single-stage drives: the study follows size, process and material; the share that jams.

The table of milled drives gives the embedded study cycloidal-17, which is older than the table.
"""

import dataclasses
import itertools
import re
from types import SimpleNamespace

import numpy as np
import pytest
from crank_turn import crank_turn
from cycloidal_cases import NAMED, design_of, errors_of, fits
from test_init import read, unit

from rvjax import Status, catalogue, cli, study
from rvjax.commands import check
from rvjax.commands.cells import rejects_texts
from rvjax.commands.init import written
from rvjax.study.kinds import changed, cycloidal, drive_starts, number_at
from rvjax.tolerances import Requirement
from rvjax.units import arcmin, mm, um

BASES, PROCESSES = ("cycloidal-15", "cycloidal-17", "cycloidal-29"), ("milled", "wire-cut", "printed", "ground")
ALL = list(itertools.product(BASES, PROCESSES))
DRAWING = """[design]
kind = "cycloidal"
cycloid.disc_teeth = 19
cycloid.eccentricity = "1.5 mm"
cycloid.pin_circle_radius = "40 mm"
cycloid.pin_radius = "2.5 mm"
output.count = 6
output.circle_radius = "25 mm"
output.pin_radius = "3 mm"
"""


def test_a_milled_drive_of_17_lobes_is_the_embedded_study():
    for made in (read(written("cycloidal-17").text), read(written("cycloidal-17", process="milled").text)):
        due = study.load("cycloidal-17", solve=False)
        for name in ("conditions", "tolerances", "costs", "requirements", "seed", "samples", "certificate_samples"):
            assert repr(getattr(made, name)) == repr(getattr(due, name)), name
        for path, value, _ in catalogue.walk(due.design):
            np.testing.assert_allclose(number_at(made.design, path), value, rtol=1e-11, err_msg=path) if (
                path != "member"
            ) else None
        assert {"cycloid.equidistant_modification", "output.hole_clearance"} <= set(made.assumed)
        assert made.assumed_limits == {"backlash", "turn_pin_pressure", "hole_pressure"}


@pytest.mark.parametrize(("base", "process"), ALL)
def test_tolerances_costs_and_clearances_follow_the_process(base, process):
    """All in the same ratio to the embedded study; grown ones by i = 0.45 D^(1/3) + 0.001 D of the pin circle."""
    made, due = read(written(base, process=process).text), study.load("cycloidal-17", solve=False)
    flank, holes = {"milled": (20, 10), "wire-cut": (5, 5), "printed": (50, 40), "ground": (3, 2.5)}[process]
    clearance = {"milled": 60, "wire-cut": 20, "printed": 140, "ground": 12}[process]
    size = 2e3 * made.design.cycloid.pin_circle_radius
    grown = unit(size) / unit(85) if process in ("milled", "ground") else 1.0
    assert made.tolerances.equidistant_modification.half_width == pytest.approx(flank * um * grown, rel=6e-3)
    assert made.design.cycloid.equidistant_modification == pytest.approx(clearance * um * grown, rel=6e-3)
    pin = 2e3 * made.design.output.pin_radius
    own = unit(pin) / unit(5) if process in ("milled", "ground") else 1.0
    assert made.tolerances.hole_radius.half_width == pytest.approx(holes * um * own, rel=6e-3)
    for name, cost in made.costs.items():
        ratio = made.tolerances.__dict__[name].half_width / due.tolerances.__dict__[name].half_width
        for key in ("reference", "finest", "coarsest"):
            assert getattr(cost, key) == pytest.approx(getattr(due.costs[name], key) * ratio, rel=1e-5), (name, key)
    assert all(line.startswith("design.bearings.arm") for line in made.doubts)  # an assumed bearing of 29 lobes


def test_torque_and_pressures_follow_the_material():
    """p ~ (T E*)^(1/2) of a line contact: a drive of another material has the same share of its yield strength."""
    printed, milled = (read(written("cycloidal-17", process=process).text) for process in ("printed", "milled"))
    elastic = [1 / ((1 - nu**2) / e + (1 - 0.3**2) / 206e9) for e, nu in ((3e9, 0.35), (69e9, 0.33))]
    due = 8.8 * (100 / 503) ** 2 * elastic[1] / elastic[0]
    assert printed.conditions.rated_torque == printed.conditions.output_torque == pytest.approx(due, rel=0.02)
    assert printed.design.contact.young_modulus == 3e9 and printed.design.contact.poisson_ratio == 0.35
    assert printed.design.stiffness.eccentric_bearing == pytest.approx(0.33 * 30e6)
    for made, strength in ((printed, 100e6), (milled, 503e6)):
        assert made.requirements["turn_pin_pressure"].upper == pytest.approx(1.79 * strength, rel=0.01)
        assert made.requirements["hole_pressure"].upper == pytest.approx(1.79 / 2 * strength, rel=0.01)
    assert read(written("cycloidal-29").text).conditions.rated_torque == 116.0
    cut = read(written("cycloidal-29", process="wire-cut").text)  # steel that is not hardened
    assert cut.conditions.rated_torque == pytest.approx(116 * (900 / 1700) ** 2, rel=0.02)


def test_a_drawing_gives_what_it_has_and_the_rest_is_assumed(drawing):
    made = read(written(drawing(), process="wire-cut").text)
    assert made.design.cycloid.pin_count == 20 and made.design.cycloid.disc_count == 2
    near = catalogue.CYCLOIDAL_17  # 42.5 mm is nearest to 40 mm
    assert made.design.contact.face_width == pytest.approx(near.contact.face_width * 40 / 42.5, rel=1e-3)
    assert made.design.stiffness.eccentric_bearing == pytest.approx(30e6 * (40 / 42.5) ** 0.8, rel=1e-3)
    assert made.design.contact.young_modulus == 206e9 and made.design.output.hole_clearance == 30 * um
    steel = [1 / ((1 - nu**2) / e + (1 - 0.3**2) / 206e9) for e, nu in ((206e9, 0.3), (69e9, 0.33))]
    due = 8.8 * (40 / 42.5) ** 3 * (900 / 503) ** 2 * steel[1] / steel[0]
    assert made.conditions.rated_torque == pytest.approx(due, rel=0.05)
    assert not {path for path in made.assumed if path in drive_starts.NEEDED}
    assert {"stiffness.eccentric_bearing", "cycloid.disc_count", "contact.young_modulus"} <= set(made.assumed)


def test_numbers_of_a_drawing_stand(drawing):
    """Also a clearance, a modulus and a torque, and one that the user calls assumed."""
    text = DRAWING + 'cycloid.equidistant_modification = "33 um"\noutput.hole_clearance = "44 um" # assumed\n'
    text += 'cycloid.disc_count = 1\nmember = "ring"\ncontact.young_modulus = "69 GPa"\ncontact.poisson_ratio = 0.3\n'
    made = read(written(drawing(text + '[conditions]\nrated_torque = "7 N m"\n'), process="printed").text)
    assert made.design.cycloid.equidistant_modification == 33 * um and made.design.output.hole_clearance == 44 * um
    assert made.design.cycloid.disc_count == 1 and made.design.member == "ring"
    assert made.conditions.rated_torque == 7.0 and made.design.contact.young_modulus == 69e9
    assert made.requirements["turn_pin_pressure"].upper == pytest.approx(900e6)  # aluminium, by its modulus
    assert "cycloid.equidistant_modification" not in made.assumed and "output.hole_clearance" in made.assumed
    for base, modulus, torque, flank in (("cycloidal-15", 3e9, 5.0, 140), ("cycloidal-29", 206e9, 116.0, 12 * 1.08)):
        based = read(written(drawing(f'[design]\nbase = "{base}"\ncycloid.eccentricity = "1.2 mm"\n')).text)
        assert based.design.contact.young_modulus == modulus and based.conditions.rated_torque == torque
        assert based.design.cycloid.equidistant_modification == pytest.approx(flank * um, rel=0.01)
        assert based.design.cycloid.eccentricity == 1.2 * mm
    smaller = '[design]\nbase = "cycloidal-29"\ncycloid.pin_circle_radius = "45 mm"\noutput.circle_radius = "28 mm"\n'
    made = read(written(drawing(smaller)).text)  # nearer in size to that of 17 lobes, but not that drive
    assert made.design.stiffness.eccentric_bearing == pytest.approx(300e6 * (45 / 52.5) ** 0.8, rel=1e-3)
    more = DRAWING + "friction.ring_pins = 0.05\nfriction.output_pins = 0.04\n"
    assert read(written(drawing(more)).text).design.friction.output_pins == 0.04


SCALED = (
    'contact.face_width = "20 mm"\n',
    'stiffness.eccentric_bearing = "300 N/um"\n',
    '[conditions]\nrated_torque = "900 N m"\n',
)
"""Numbers of a drawing that `init` scales by the size."""


def test_torque_follows_discs_and_width_of_a_drawing(drawing):
    """In proportion to both; the ring as output turns less than the carrier by zc/zp (Eq. 4), and so does backlash."""
    usual = read(written(drawing()).text)
    for text, ratio in (("cycloid.disc_count = 1", 0.5), ('contact.face_width = "11.952 mm"', 2.0)):
        made = read(written(drawing(DRAWING + text + "\n")).text)
        assert made.conditions.rated_torque == pytest.approx(ratio * usual.conditions.rated_torque, rel=0.03)
    assert 'rated_torque = "7.3 N m" # assumed: from 8.8 N m of the cycloidal-17' in written(drawing()).text
    numbers = {path: value for path, value, _ in catalogue.walk(usual.design)}
    ring = drive_starts.free_play(numbers | {"member": "ring"}, 5 * um)
    assert ring == pytest.approx(19 / 20 * drive_starts.free_play(numbers, 5 * um), rel=1e-12)
    far = DRAWING.replace('"40 mm"', '"120 mm"')
    width, seat, torque = SCALED
    for given in ((), (width, seat), (width, torque), (seat, torque)):  # then the third alone is scaled
        (line,) = written(drawing(far + "".join(given))).warnings
        assert line.startswith("cycloid.pin_circle_radius: 2.29 times that of the cycloidal-29")


@pytest.mark.parametrize(
    ("base", "process", "words"),
    [
        ("cycloidal-17", "laser", "--process = 'laser': must be one of milled, wire-cut, printed, ground"),
        ("rv-40e", "milled", "--process milled: tolerances of an RV reducer follow its size alone"),
        ("drawing.toml", "milled", r"\[design\] lacks output.count \(output pins, n\)"),
        ("negative.toml", "", "design.cycloid.pin_circle_radius = -40 mm: must be positive"),
        ("sharp.toml", "", r"design.cycloid.pin_radius = 3.5 mm: pins from .* cut into the flank .*undercut"),
    ],
)
def test_a_wrong_process_or_drawing_is_one_line(drawing, tmp_path, monkeypatch, capsys, base, process, words):
    monkeypatch.chdir(tmp_path)
    drawing(DRAWING.replace("output.count = 6\n", ""))
    (tmp_path / "negative.toml").write_text(DRAWING.replace('"40 mm"', '"-40 mm"'))
    (tmp_path / "sharp.toml").write_text(DRAWING.replace('"2.5 mm"', '"3.5 mm"').replace('"1.5 mm"', '"1.9 mm"'))
    assert cli.main(["init", "mine.toml", "--base", base, "--process", process]) == 2
    said = capsys.readouterr().err
    assert re.search(words, said) and len(said.splitlines()) == 1 and not (tmp_path / "mine.toml").exists()


def test_clearances_alone_give_the_backlash_of_the_solved_drive():
    """Catalogue drives at input angle 0, where six pins hold at their worst angle: 103.348 and 23.916 arcmin.

    Then a scan of all positions of one disc at crank angle 0.12 (docs/models/single_stage.md, Eq. 19), arcmin.
    """
    for name, due in (("cycloidal-15", 103.348), ("cycloidal-17", 23.916)):
        numbers = {path: value for path, value, _ in catalogue.walk(study.BASES[name])}
        assert drive_starts.free_play(numbers, 0.0) == pytest.approx(due * arcmin, rel=0.01)
    numbers = {path: value for path, value, _ in catalogue.walk(catalogue.CYCLOIDAL_17)}
    small = {"cycloid.eccentricity": 1.3 * mm, "output.circle_radius": 32.9 * mm}
    scan = {(10, 0, 0): 3.1368, (0, 0, 25): 5.6641, (10, 10, 25): 12.3116, (20, 10, 25): 15.5348}
    for (flank, bearing, hole), due in scan.items():
        numbers |= small | {"cycloid.equidistant_modification": flank * um, "output.hole_clearance": 2 * hole * um}
        found = drive_starts.free_play(numbers, bearing * um) / arcmin
        assert 0.99 * due < found < 1.07 * due, (flank, bearing, hole)  # its angle is the worst, the scan has one
    numbers |= {"cycloid.equidistant_modification": 10 * um, "output.hole_clearance": 0.0}
    straight, aside = 2 * 10e-3 / (1.3 * 17), 10e-3 / (32.9 * np.sqrt(3) / 2)  # flank = bearing: A cos x + B sin x
    assert drive_starts.free_play(numbers, 10 * um) == pytest.approx(2 * np.hypot(straight, aside), rel=1e-4)


@pytest.mark.long  # test_cycloidal_fit.py has the fit and its closed forms
def test_the_recommended_clearances_shift_every_fit_by_the_same():
    """Flanks s more, holes 2 s more in diameter: the least clearance of each unit grows by s exactly."""
    case = NAMED["c17: fit, errors"]
    design, errors = design_of(case["design"]), errors_of(case["errors"])
    more = {"cycloid.equidistant_modification": 7 * um, "output.hole_clearance": 14 * um}
    wider = changed(design, {path: number_at(design, path) + size for path, size in more.items()})
    before, after = fits((design, errors), (wider, errors))
    np.testing.assert_allclose(after.at, before.at + 7 * um, rtol=0, atol=1e-12)


def test_the_share_that_jams_and_the_clearances_with_which_99_percent_turn():
    """5 of 1,000 units at -1 um, 895 at 9 um, 100 at 20 um: 1 % of 1,000 begins at 9 um, so that 9 um may go."""
    base, tolerances = catalogue.CYCLOIDAL_17, study.load("cycloidal-17", solve=False).tolerances
    fitting = np.concatenate([np.full(5, -1.0), np.full(895, 9.0), np.full(100, 20.0)]) * um
    (line,) = cycloidal.turning(base, tolerances, fitting)
    assert line.startswith("0.5 % of 1,000 units jam with these tolerances; 99 % turn, flanks and holes changed alike")
    assert "equidistant_modification 51 um and hole_clearance 52 um" in line
    lever = 32.3 * np.sqrt(3) / 2
    less = 2 * (9 / 27.2 + 9 / lever) * 1e-3 / arcmin
    assert float(re.search(r"have ([\d.]+) arcmin less", line)[1]) == pytest.approx(less, rel=0.05)
    (line,) = cycloidal.turning(base, tolerances, fitting - 12 * um)
    assert "90 % of 1,000 units jam" in line and "equidistant_modification 63 um" in line and "arcmin more" in line


def test_the_assumed_number_that_would_meet_a_limit(monkeypatch):
    """A line contact: pressure ~ width^(-1/2), so that 1.2 times the limit takes 1.44 times the width, and some more.

    A modulus, a number that the study gives, one too far, and one that breaks a limit which is met are no remedies.
    """
    made = read(written("cycloidal-17").text)
    width = next(number for number in made.numbers if number.path == "contact.face_width")
    numbers = [
        dataclasses.replace(width, assumed=True),
        *(n for n in made.numbers if n.path == "contact.young_modulus"),
    ]
    monkeypatch.setattr(study.Study, "numbers", numbers)

    class Fake(SimpleNamespace):
        replace = staticmethod(lambda design: Fake(design=design))

    def solved(response, errors):
        contact = response.design.contact
        pressure = 1.2e8 * (6.35e-3 / contact.face_width * contact.young_modulus / 69e9) ** 0.5
        return SimpleNamespace(value={"p": pressure, "w": contact.face_width}, status=0)

    monkeypatch.setattr(study.Study, "response_of", lambda self, name: Fake())
    monkeypatch.setattr(study.Study, "response", lambda self, *, solve: Fake())
    monkeypatch.setattr(check, "outcome_of", solved)
    values = {"p": 1.2e8, "w": 6.35e-3}

    def remedy(pressure, widest):
        limits = {"p": Requirement(upper=pressure), "w": Requirement(upper=widest)}
        return check._remedy(dataclasses.replace(made, requirements=limits), "p", values)

    due = 6.35 * 1.44**check.FURTHER
    assert remedy(1e8, 1.0) == f"contact.face_width = {due:.4g} mm would meet it; 6.35 mm is assumed"
    assert remedy(1e8, 9e-3) == "" == remedy(0.5e8, 1.0)
    assert remedy(1e8, 6e-3).startswith("contact.face_width")  # the other limit is missed before
    numbers[0] = width
    assert remedy(1e8, 1.0) == ""


@pytest.mark.long
def test_a_remedy_meets_its_limit_in_the_solved_drive(drawing):
    """Pins at 1.2 times the allowed pressure; the width that is named gives less than it, by its own solution.

    Pressure falls more slowly than width^(-1/2), because stiffer pins share less: the first step does not meet it.
    """
    made = read(written(drawing(), process="wire-cut").text)
    values, _ = made.at_mid_points()
    limits = dict(made.requirements) | {"turn_pin_pressure": Requirement(upper=values["turn_pin_pressure"] / 1.2)}
    made = dataclasses.replace(made, requirements=limits)
    found = re.match(r"contact.face_width = ([\d.]+) mm", check._remedy(made, "turn_pin_pressure", values))
    wider = dataclasses.replace(made, design=made.design_with({"contact.face_width": float(found[1]) * mm}))
    assert 0.95 < wider.at_mid_points()[0]["turn_pin_pressure"] / limits["turn_pin_pressure"].upper < 1
    assert float(found[1]) > 5.976 * 1.44


def test_units_without_clearance_jam_in_words():
    """Of 1,000 units 12 below zero; a limit other than zero has no such line, nor a response without the word."""
    made = study.load("cycloidal-17", solve=False)
    verdict = SimpleNamespace(kind="share", estimate=SimpleNamespace(value=0.988))
    sample = SimpleNamespace(verdicts=dict.fromkeys(made.requirements, verdict), failed=0, samples=1000)
    assert rejects_texts(made, sample) == {"fit_clearance": "1.2 % of the units jam (fit_clearance below 0)"}
    sample.failed = 2  # no result: rejects that do not jam
    assert rejects_texts(made, sample)["fit_clearance"].startswith("1 % of the units jam")
    both = made.text.replace('lower = "0 um"\ntarget', 'lower = "0 um"\nupper = "60 um"\ntarget')
    assert both != made.text and rejects_texts(read(both), sample) == {}
    text = made.text.replace('lower = "0 um"\ntarget', 'lower = "3 um"\ntarget')
    assert text != made.text and rejects_texts(read(text), sample) == {}


def test_what_is_read_over_a_part_of_a_turn_says_so():
    """18 pins: a crank turn against the carrier is 20 deg of the output; over a whole turn nothing is left."""
    made = crank_turn("cycloidal-17", 12)
    names = "fit_clearance, turn_pin_pressure, hole_pressure"
    assert f"more than 20 deg of the output (for {names})" in made.left_out
    assert made.output("turn_pin_pressure").meaning == "largest contact pressure of a pin over 20 deg of the output"
    assert made.curve.title == "Transmission error of the loaded reducer over 20 deg of the output"
    whole = read(made.text.replace("[conditions]", '[conditions]\nspan = "output_turn"'))
    assert not any("more than" in line for line in whole.left_out)
    assert whole.output("turn_pin_pressure").meaning == "largest contact pressure of a pin over a turn of the output"
    assert study.load("rv-40e", solve=False).output("misfit").meaning.endswith("(assembly)")


def test_an_output_without_a_limit_that_fails_leaves_the_others(monkeypatch):
    """A status of a value that nobody limits is none of the study."""
    made = study.load("cycloidal-17", solve=False)
    values = dict.fromkeys(made.requirements, 1.0)

    def solved(self, further=()):
        return values | dict.fromkeys(further, np.nan), Status.CONTACT_OVERLOAD if further else Status.CONVERGED

    monkeypatch.setattr(study.Study, "at_mid_points", solved)
    monkeypatch.setattr(check, "_turning", lambda _: [])
    monkeypatch.setattr(check, "_remedy", lambda *_: "")
    found = check.compute(SimpleNamespace(study=made, turn=False))
    assert made.further and (found.values, found.status) == (values, Status.CONVERGED)


@pytest.mark.long  # the words of the share follow from given clearances above
def test_check_of_a_drive_has_usual_values_without_limits_and_the_share_that_jams(tmp_path, capsys):
    """The embedded study without its limits of pressure; the clearance of the unit is that of `loaded.clearance`."""
    text = (study.EMBEDDED / "cycloidal-17.toml").read_text("utf-8")
    cut = text[: text.index("[requirement.turn_pin_pressure]")] + text[text.index("[run]") :]
    (tmp_path / "mine.toml").write_text(cut.replace('"100 um"', '"40 um"'))
    made = study.load(str(tmp_path / "mine.toml"), solve=False)
    usual = ("torsional_stiffness", "turn_pin_pressure", "loaded_pins", "hole_pressure")  # no friction: no efficiency
    assert made.further == usual
    lines = check._turning(made)
    assert re.match(r"\d", lines[0]) and "of 1,024 units jam" in lines[0]


def test_a_number_that_the_user_replaces_is_not_assumed(drawing):
    """The comment stays as it was written; the value decides. Lengths, moduli, counts and plain numbers."""
    text = written(drawing(), process="wire-cut").text
    changes = {
        '"20 um" # profile': '"25 um" # profile',
        "disc_count = 2 #": "disc_count = 1 #",
        '"206 GPa" # Young': '"210 GPa" # Young',
    }
    paths = {"cycloid.equidistant_modification", "cycloid.disc_count", "contact.young_modulus"}
    assert paths <= set(read(text).assumed)
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    noted = text.replace("initially 20 um", "initially 20 um; measured")
    assert noted != text and "cycloid.equidistant_modification" not in read(noted).assumed
    stricter = text.replace('upper = "13 arcmin"', 'upper = "12 arcmin"')
    assert stricter != text and "backlash" not in read(stricter).assumed_limits
    assert not paths & set(read(text).assumed) and "output.hole_clearance" in read(text).assumed
    same = text.replace("poisson_ratio = 0.3 # Pois", "poisson_ratio = 0.30 # Pois").replace(
        '"28.58 N/um" #', '"28580 N/mm" #'
    )
    assert {"contact.poisson_ratio", "stiffness.eccentric_bearing"} <= set(read(same).assumed)


def test_a_study_with_variables_begins_at_its_design(drawing):
    """Bounds contain the number at the start; the space costs 5 there; limits without errors are 3/4 of it, by hand."""
    made = read(written(drawing(), process="wire-cut", variables=True).text)
    assert set(made.variables) == set(drive_starts.CHOICES.bounds) and set(made.objective) == {"envelope_volume"}
    for path, variable in made.variables.items():
        assert variable.lower < number_at(made.design, path) < variable.upper
    volume = np.pi * (42.5 * mm) ** 2 * 2 * made.design.contact.face_width
    assert made.objective["envelope_volume"](volume) == pytest.approx(5, rel=0.01)
    hole = 3 + 1.5 + 0.03 / 2
    gaps = {"pin_gap": 2 * (40 * np.sin(np.pi / 20) - 2.5), "hole_gap": 2 * (25 * np.sin(np.pi / 6) - hole)}
    gaps["hole_wall"] = 40 - 2.5 - 1.5 - 25 - hole
    assert set(made.nominal) == set(gaps)
    for name, limits in made.nominal.items():
        assert limits.lower == pytest.approx(0.75 * gaps[name] * mm, rel=5e-3), name
    plain = drawing(DRAWING + 'cycloid.equidistant_modification = "0 um"\noutput.hole_clearance = "-10 um"\n')
    made = read(written(plain, variables=True).text)
    assert "cycloid.equidistant_modification" not in made.variables
    assert [made.variables["output.hole_clearance"].lower, made.variables["output.hole_clearance"].upper] == [
        -20 * um,
        -5 * um,
    ]
    assert set(made.requirements) == set(study.load("cycloidal-17", solve=False).requirements)


@pytest.mark.long
@pytest.mark.parametrize(("base", "process"), ALL)
def test_at_most_one_percent_jams_at_the_initial_tolerances(base, process):
    (line,) = check._turning(read(written(base, process=process).text))
    assert float(line.partition(" %")[0]) <= 1.0


@pytest.mark.long
@pytest.mark.parametrize(("base", "process"), ALL)
def test_init_check_and_allocate_end_with_a_certificate(tmp_path, monkeypatch, capsys, base, process):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", "mine.toml", "--base", base, "--process", process]) == 0
    assert cli.main(["check", "mine.toml"]) == 0 and "no tolerance can meet" not in capsys.readouterr().out
    assert cli.main(["allocate", "mine.toml", "--quiet"]) == 0
    assert "Study mine: OPTIMAL" in capsys.readouterr().out
