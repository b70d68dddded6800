"""Studies of single-stage drives: facts, impossible numbers, warnings, and the outputs under load.

Oracles: the table of an independent solution with finite steps of the same drives (`docs/models/single_stage.md`),
closed forms with pencil and paper, and the congruence of discs by exact fractions.
"""

import json
import math
from fractions import Fraction
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from cycloidal_cases import dictionaries, placed
from loaded_cases import newton_alone
from scipy import stats

from rvjax import cli, levels, models, study
from rvjax.catalogue import CYCLOIDAL_17, CYCLOIDAL_29
from rvjax.commands import allocate, design, init, montecarlo
from rvjax.commands.budget import budgets, report_on_scalar
from rvjax.study.kinds import cycloidal, facts_of
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, monte_carlo
from rvjax.units import arcmin, um
from tests.oracles import cycloidal as oracle

HEAD = '[design]\nbase = "cycloidal-17"\n'
TAIL = """
[conditions]
output_torque = "8.8 N m"
{conditions}
[tolerances.throw]
half_width = "10 um"
[requirement.{response}]
upper = "1 {unit}"
"""


def text(design="", conditions="", response="hole_force", unit="N"):
    """Text of a study of the milled drive."""
    return HEAD + design + TAIL.format(conditions=conditions, response=response, unit=unit)


def test_facts_of_the_known_drives():
    found = dict(facts_of(CYCLOIDAL_17))
    assert found.pop("largest pin without undercut").endswith("the pins have 2.5 mm: no undercut")
    assert found == {
        "ratio": "17:1, output opposite to the input",
        "hole diameter": "8.27 mm = pin 5 mm + 2 x 1.6 mm + clearance 70 um",
        "discs": "2, equal parts",
        "K1": "0.6776",  # 1.6 * 18 / 42.5
        "gap between pins": "9.76 mm",  # 2 (42.5 sin 10 deg - 2.5)
        "gap between holes": "24.03 mm",  # 2 (32.3 sin 30 deg - 4.135)
        "wall outside the holes": "1.965 mm",  # 42.5 - 2.5 - 1.6 - 32.3 - 4.135
    }
    assert dict(facts_of(CYCLOIDAL_17.replace(member="ring")))["ratio"] == "18:1, output with the input"
    one = CYCLOIDAL_17.replace(cycloid=CYCLOIDAL_17.cycloid.replace(disc_count=1))
    assert dict(facts_of(one))["discs"] == "1"


def test_discs_that_are_different_parts():
    cycloid = CYCLOIDAL_17.cycloid.replace(disc_teeth=20, pin_count=21, eccentricity=1.2e-3)
    design = CYCLOIDAL_17.replace(cycloid=cycloid, output=CYCLOIDAL_17.output.replace(count=4))
    due = "2, different parts: holes turned by 9 deg against the lobes (equal parts with 8 output pins)"
    assert dict(facts_of(design))["discs"] == due


def test_equal_discs_are_congruent():
    """Lobes of disc k are turned by k/nd of a pitch; some turn that keeps the holes has to do the same."""
    for teeth in range(6, 40):
        for pins in range(3, 14):
            for discs in (2, 3):
                alike = all(
                    any((teeth * Fraction(turn, pins) - Fraction(k, discs)).denominator == 1 for turn in range(pins))
                    for k in range(discs)
                )
                assert cycloidal._alike(pins, teeth, discs) == alike, (teeth, pins, discs)


@pytest.mark.parametrize(
    ("design", "words"),
    [
        ('output.pin_radius = "15 mm"', r"design.output.pin_radius = 15 mm: .* overlap from 16.15 mm on"),
        ('output.circle_radius = "35 mm"', r"design.output.circle_radius = 35 mm: the holes break out of the discs"),
        ('cycloid.pin_radius = "8 mm"', r"design.cycloid.pin_radius = 8 mm: the pins overlap from 7.38 mm on"),
        ('output.hole_clearance = "-1.6 mm"', r"holes must have pin diameter \+ 2 eccentricity = 8.2 mm, .* 6.6 mm"),
        ('output.hole_clearance = "-0.161 mm"', "design.output.hole_clearance = -161 um: holes must have"),
        ('output.hole_clearance = "-4 mm"', "hole_clearance = -0.004 m: must be larger than -2 eccentricity"),
        ('member = "disc"', "design.member = 'disc': must be one of carrier, ring"),
        ("member = 1", "design.member = 1: must be one of carrier, ring"),
        ("cycloid.pin_count = 19", "pin_count = 19: must be disc_teeth"),
        ('cranks.count = "2"', "unknown key design.cranks"),
    ],
)
def test_numbers_that_no_drive_can_have(design, words):
    with pytest.raises(study.StudyError, match=words) as raised:
        study.parse_study(text(f"{design}\n"), name="x", solve=False)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (dict(conditions='sun = "floating"'), "conditions.sun"),
        (dict(response="crank_sharing"), "crank_sharing"),
        (dict(response="flank_clearance"), "flank_clearance"),
        (dict(response="transmission_error"), "transmission_error"),
        (dict(response="backlash", unit="arcmin"), "conditions.rated_torque is missing: backlash needs it"),
    ],
)
def test_responses_and_conditions_that_this_kind_lacks(changes, words):
    with pytest.raises(study.StudyError, match=words):
        study.parse_study(text(**changes), name="x", solve=False)
    with pytest.raises(study.StudyError, match="crank_eccentricity"):
        study.parse_study(text().replace("tolerances.throw", "tolerances.crank_eccentricity"), name="x", solve=False)


def test_a_drive_without_what_a_load_needs_names_the_keys_of_its_own_kind():
    bare = 'kind = "cycloidal"\ncycloid = {disc_teeth = 17, pin_count = 18, disc_count = 1, eccentricity = "1.6 mm", '
    bare += 'pin_circle_radius = "42.5 mm", pin_radius = "2.5 mm"}\n'
    bare += 'output = {count = 6, circle_radius = "32.3 mm", pin_radius = "2.5 mm"}\n'
    with pytest.raises(study.StudyError, match=r"design.stiffness is missing: .*, with eccentric_bearing"):
        study.parse_study(text().replace('base = "cycloidal-17"\n', bare), name="x", solve=False)
    made = study.parse_study(text('member = "ring"\n'), name="x", solve=False)
    assert made.design.member == "ring" and made.design.ratio == 18
    assert 'member = "carrier"' in init.written("cycloidal-17").text


def test_warnings():
    def doubts(design):
        return study.parse_study(text(design), name="x", solve=False).doubts

    tight, thick = (
        doubts(f"{line}\n")
        for line in (
            'output.hole_clearance = "-20 um"',
            'output.pin_radius = "5 mm"\noutput.circle_radius = "29 mm"\ncycloid.eccentricity = "0.49 mm"',
        )
    )
    assert len(tight) == 1 and tight[0].startswith("design.output.hole_clearance = -20 um: interference")
    assert doubts("") == []
    assert any(line.startswith("design.output.pin_radius = 5 mm: more than ten times the ecc") for line in thick)


@pytest.mark.parametrize(
    (
        "samples",
        "response",
        "words",
        "due",
    ),  # 6 holes, 17 lobes: orders 6, 12, 18, 17, 34 and 51 of a turn of the shaft
    [
        (12, "loaded_transmission_error", "order 12 of the holes over the span looks like the mean", 13),
        (6, "loaded_transmission_error", "order 6 of the holes, order 12 of the holes, order 18 of the holes over", 7),
        (17, "mean_shift", "order 17 of the pins, order 34 of the pins, order 51 of the pins over the span", 19),
        (13, "loaded_transmission_error", "", 0),
        (12, "hole_force", "", 0),
    ],
)
def test_angles_that_see_the_passing_holes_at_equal_phases(samples, response, words, due):
    given = f"samples = {samples}\n" + ('second_torque = "2 N m"' if response == "mean_shift" else "")
    unit = "N" if response == "hole_force" else "arcmin"
    found = study.parse_study(text("", given, response, unit), name="x", solve=False).doubts
    assert len(found) == bool(words) and all(words in line for line in found)
    assert all(line.endswith(f"set {due} or more, no divisor of such an order") for line in found)


@pytest.mark.parametrize(
    ("design", "tolerances", "words"),  # 1.6 mm / 25 = 64 um
    [
        ('output.hole_clearance = "127 um"\n', "", ""),
        ('output.hole_clearance = "129 um"\n', "", "64.5 um of the holes (radial): above eccentricity/25 = 64 um"),
        ('cycloid.equidistant_modification = "65 um"\n', "", "65 um of the flanks: above eccentricity/25 = 64 um"),
        ("", '[tolerances.equidistant_modification]\nlower = "-9 um"\nupper = "5 um"', "65 um of the flanks: above"),
        ("", '[tolerances.output_pin_radius]\nlower = "-30 um"\nupper = "0 um"', "65 um of the holes (radial): above"),
        (
            'cycloid.equidistant_modification = "65 um"\noutput.hole_clearance = "140 um"\n',
            '[tolerances.hole_radius]\nhalf_width = "3 um"',
            "65 um of the flanks and 73 um of the holes (radial): above",
        ),
    ],
)
def test_results_say_where_the_linear_gaps_end(design, tolerances, words):
    """The limits of the tolerances count."""
    made = study.parse_study(text(design) + tolerances, name="x", solve=False)
    found = made.inaccurate()
    assert len(found) == bool(words) and all(line.startswith(f"clearance up to {words}") for line in found)
    assert made.doubts == []


def test_every_result_has_the_line_on_its_clearances(monkeypatch):
    """A sample and a budget with those of the study, an allocation and a design with those that they found."""
    made = study.parse_study(text('cycloid.equidistant_modification = "65 um"\n'), name="x", solve=False)

    def response(errors):
        return {"hole_force": jnp.sum(errors.throw)}

    monkeypatch.setattr(type(made), "response", lambda self, *, solve=True: response)
    monkeypatch.setattr(type(made), "units", property(lambda self: response))
    sampled = monte_carlo(response, made.tolerances, samples=16, seed=0, requirements=made.requirements)
    assert "Inaccurate: clearance up to 65 um of the flanks: above" in montecarlo.report_on(sampled, made).text()
    budget = budgets.scalar_budget(made, "hole_force", samples=16)
    assert "Inaccurate: clearance up to 65 um of the flanks: above" in report_on_scalar(budget, made).text()
    looser = made.tolerances.replace(equidistant_modification=Tolerance.symmetric(3 * um))
    found = SimpleNamespace(tolerances=looser, certificate=SimpleNamespace(verdicts={}))
    answer = SimpleNamespace(study=made, allocation=found, after=SimpleNamespace(values={}), whole=None)
    lines = [line for line in allocate.limits_of_the_answer(answer) if line.startswith("Inaccurate")]
    assert len(lines) == 1 and lines[0].startswith("Inaccurate: clearance up to 68 um of the flanks")
    wider = made.design_with({"cycloid.equidistant_modification": 70 * um})
    optimum = SimpleNamespace(design=wider, found=SimpleNamespace(tolerances=looser, feasible=False))
    lines = design._notes(made, SimpleNamespace(laws=(), joint=optimum))
    (line,) = (line for line in lines if line.startswith("Inaccurate"))
    assert line.startswith("Inaccurate: clearance up to 73 um of the flanks")


TURN = {  # largest of a crank turn by the independent model, 8.8 N m, hertz, no errors
    "pin_force": lambda each: each["pins"].max(),
    "hole_force": lambda each: each["output_pins"].max(),
    "turn_pin_pressure": lambda each: each["pressure"].max(),
    "hole_pressure": lambda each: each["output_pressure"].max(),
    "arm_bearing_force": lambda each: np.linalg.norm(each["disc_bearing"], axis=-1).max(),
}


def test_outputs_are_those_of_the_table_and_of_the_independent_model(thorough):
    """The long profile has the backlash, too, that of the table, arcmin; by default torsion is in
    `test_cycloidal_loaded.py`, and what a study makes of it in `test_loaded_outputs.py`."""
    given = models.kind(CYCLOIDAL_17).conditions(output_torque=8.8, rated_torque=8.8, samples=8)
    unread = dict(contact=CYCLOIDAL_17.contact.replace(pin_stiffness=1.0), bearings=None)
    unread |= dict(output=CYCLOIDAL_17.output.replace(pin_stiffness=1.0))  # as in the cases of that file
    design, errors = placed(CYCLOIDAL_17.replace(**unread))
    with newton_alone():
        asked = Response.of(CYCLOIDAL_17, (*(["backlash"] if thorough else []), *TURN), given)
        value = asked.replace(design=design)(errors).value
    if thorough:
        assert float(value["backlash"]) / arcmin == pytest.approx(23.916, rel=2e-3)
    angles = -17 * 2 * np.pi / 18 * np.arange(8) / 8
    options = {"output_torque": 8.8, "contact": "hertz"}
    turn = [oracle.equilibrium(dictionaries(CYCLOIDAL_17), {}, input_angle=a, **options) for a in angles]
    for name, largest in TURN.items():
        assert float(value[name]) == pytest.approx(max(map(largest, turn)), rel=1e-6), name


SUPPORT = (
    'bearings.support = {rollers = 9, roller_diameter = "2 mm", roller_length = "3 mm", pitch_diameter = "20 mm"}\n'
)


@pytest.mark.parametrize(
    ("design", "words"),
    [("", r"\[\[duty\]\] is missing"), (SUPPORT, "design.bearings.support: must be None for a CycloidalReducer")],
)
def test_lives_that_no_study_of_a_drive_can_have(design, words):
    asked = text(design, response="life", unit="h").replace("upper", "lower").replace('output_torque = "8.8 N m"', "")
    if design:
        asked += '[[duty]]\noutput_torque = "8.8 N m"\noutput_speed = "15 rpm"\ntime = "1 h"\n'
    with pytest.raises(study.StudyError, match=words):
        study.parse_study(asked, name="x", solve=False)
    if design:  # levels of an RV reducer are none of a drive, whose conditions have no sun
        made = study.parse_study(asked.replace(design, ""), name="x", solve=False)
        given = levels.as_given(made.design, ("life",), made.conditions, tolerances=made.tolerances)
        assert given["life"].level == "as in the conditions"


def test_figures_of_the_geometry():
    kind = models.kind(CYCLOIDAL_29)
    given = kind.conditions(output_torque=116.0)
    names = ("hole_gap", "hole_wall", "nominal_hole_pressure", "eccentric_force")
    gap, wall, pressure, force = (
        float(kind.outputs[n].evaluate(CYCLOIDAL_29, CYCLOIDAL_29.error_record(), given)[0]) for n in names
    )
    assert gap == pytest.approx(2 * (33.875e-3 * math.sin(math.pi / 4) - 7.26e-3))
    assert wall == pytest.approx(52.5e-3 - 3.5e-3 - 1.25e-3 - 33.875e-3 - 7.26e-3)
    across = 58 / (1.25e-3 * 29)  # half of the torque on each disc
    k1 = 1.25 * 30 / 52.5
    ring = 2 / math.pi * across * (1 - (1 - k1**2) / (2 * k1) * math.log((1 + k1) / (1 - k1))) / k1
    assert force == pytest.approx(math.hypot(across, ring - 4 * 58 / (math.pi * 33.875e-3)))
    share = 2 * (1 - 0.3**2) / 206e9  # of both bodies
    load = 58 / 33.875e-3 / 13.5e-3  # four pins: one of them alone, at most
    assert pressure == pytest.approx(math.sqrt(load / (math.pi * share) * (1 / 6e-3 - 1 / 7.26e-3)), rel=1e-6)


@pytest.mark.long  # test_cycloidal_fit.py has the fit, test_init_drives.py the share that a study tells
def test_the_share_of_units_that_jam(tmp_path, capsys):
    """Flanks alone vary, about 10 um with 3 sigma = 30 um, in holes that are wider: a share of Phi(-1) jams."""
    vary = text(
        'cycloid.equidistant_modification = "10 um"\n', "samples = 4", response="fit_clearance", unit="um"
    ).replace('throw]\nhalf_width = "10 um"', 'equidistant_modification]\nhalf_width = "30 um"')
    (tmp_path / "flank.toml").write_text(vary.replace('upper = "1 um"', 'lower = "0 um"\ntarget = 0.99'))
    command = ["montecarlo", str(tmp_path / "flank.toml"), "--samples", "4096", "--quiet", "--format", "json"]
    assert cli.main(command) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["failed"] == 0
    assert 1 - found["yield_"]["fit_clearance"]["value"] == pytest.approx(stats.norm.cdf(-1), abs=0.02)
    assert found["mean"]["fit_clearance"]["value"] == pytest.approx(10 * um, abs=0.6 * um)
