"""Run time of a loaded study: measured times of equilibria, in proportion to angles, pins and discs."""

import pytest
from crank_turn import crank_turn

from rvjax import levels, study
from rvjax.commands import forecast
from rvjax.commands.allocate import answer
from rvjax.commands.forecast import (
    ALLOCATING,
    CERTIFYING,
    PRICING,
    SAMPLING,
    SEARCHING,
    expected,
    solved_units,
    unit_seconds,
)
from rvjax.levels.choice import equilibrium_times

WHOLE = study.load("rv-40e-whole", solve=False).text
CONDITIONS = 'output_torque = "412 N m"\nrated_torque = "412 N m"\n'
DUTY = '[[duty]]\noutput_torque = "412 N m"\noutput_speed = "15 rpm"\ntime = "1 h"\n'
LIMITS = {"life": 'lower = "6000 h"', "turn_pin_pressure": 'upper = "3 GPa"'}
LIMITS |= dict.fromkeys(("loaded_transmission_error", "bench_lost_motion", "backlash"), 'upper = "1 arcmin"')


def seconds(*outputs, old="", new="", **conditions):
    """Time of a unit of the RV-40E with these outputs."""
    head = WHOLE[: WHOLE.index("[conditions]")].replace(old, new)
    tolerances = WHOLE[WHOLE.index("# First stage") : WHOLE.index("[cost.crank")]
    torques = CONDITIONS if {"backlash", "bench_lost_motion"} & set(outputs) else CONDITIONS.splitlines(True)[0]
    given = "".join(f"{key} = {value}\n" for key, value in conditions.items())
    required = "".join(f"[requirement.{name}]\n{LIMITS[name]}\n" for name in outputs)
    duty = DUTY if "life" in outputs else ""
    text = f"{head}[conditions]\n{torques}{given}{tolerances}{duty}{required}"
    return unit_seconds(study.parse_study(text, name="mine", solve=False))


TURN, BENCH = "loaded_transmission_error", "bench_lost_motion"


def test_time_is_in_proportion_to_angles_pins_and_discs():
    table = equilibrium_times()["rv"]
    per_core = 1e-6 / equilibrium_times()["measured_on"]["cores"]
    assert seconds(TURN, samples=24) == pytest.approx(24 * table["turn"]["hertz"] * per_core)
    assert seconds(TURN, samples=48) == pytest.approx(2 * seconds(TURN, samples=24))
    assert seconds(BENCH, probe_angles=4) == pytest.approx(8 * table["bench"]["hertz"] * per_core)
    three = seconds(TURN, samples=24, old='base = "rv-40e"\n', new='base = "rv-40e"\ncycloid.disc_count = 3\n')
    assert three == pytest.approx(1.5 * seconds(TURN, samples=24))
    linear = seconds(TURN, samples=24, pin_contact='"linear"')
    assert linear / seconds(TURN, samples=24) == pytest.approx(table["turn"]["linear"] / table["turn"]["hertz"])


def test_outputs_of_one_revolution_take_its_time_once():
    both = seconds(TURN, "turn_pin_pressure", samples=24)
    assert both == seconds(TURN, samples=24)
    life = seconds(TURN, "life", samples=24, life_samples=12) - both
    assert life == pytest.approx(
        12e-6 * equilibrium_times()["rv"]["life"]["hertz"] / equilibrium_times()["measured_on"]["cores"]
    )
    assert seconds(TURN, BENCH, samples=24, probe_angles=4) == pytest.approx(both + seconds(BENCH, probe_angles=4))


def test_the_time_of_the_default_study_is_known_and_an_unmeasured_one_is_not():
    whole = study.load("rv-40e-whole", solve=False)
    assert expected(whole).startswith("time: about ") and unit_seconds(whole) > seconds(
        TURN, BENCH, samples=24, probe_angles=4
    )
    assert seconds("backlash", probe_angles=4) is None
    assert levels.seconds(whole.design, []) == 0


def test_a_drive_has_times_of_its_own():
    """Twelve angles of a turn and of the fit, two probe angles with two torques; contacts of 4 holes."""
    drive = crank_turn("cycloidal-17", 12)
    own, count = equilibrium_times()["cycloidal"], {"turn": 12, "probe": 4, "fit": 12}
    due = sum(1e-6 * own[use]["hertz"] * n for use, n in count.items()) / equilibrium_times()["measured_on"]["cores"]
    assert own["contacts"] == 2 * (18 + 6) and unit_seconds(drive) == pytest.approx(due)
    fewer = drive.text.replace('base = "cycloidal-17"\n', 'base = "cycloidal-17"\noutput.count = 4\n')
    assert unit_seconds(study.parse_study(fewer, name="x", solve=False)) == pytest.approx(due * 44 / 48)
    assert expected(drive).startswith("time: about ")


@pytest.mark.long  # test_cli_allocate.py has the order of the phases that were forecast
def test_phases_are_named_in_the_order_of_a_run(monkeypatch):
    begun = []
    monkeypatch.setattr(answer, "begin", begun.append)
    text = """[design]
base = "rv-20e"
[tolerances.pin_radius]
half_width = "2 um"
[cost.pin_radius]
finest = "0.5 um"
coarsest = "5 um"
[requirement.lost_motion]
upper = "3 arcmin"
[run]
samples = 256
certificate_samples = 4096
"""
    small = study.parse_study(text, name="small")
    answer.answer(small, measure=False)
    assert begun == [SEARCHING, CERTIFYING, SAMPLING, PRICING]
    assert list(ALLOCATING) == begun


def test_units_of_a_moved_middle_and_of_a_certificate():
    whole = study.load("rv-40e-whole", solve=False)
    middle = '[middle.pin_circle_radius]\nlower = "-5 um"\nupper = "5 um"\n'
    moving = study.parse_study(WHOLE + middle, name="mine", solve=False)
    assert 1.2 < solved_units(moving)[SEARCHING] / solved_units(whole)[SEARCHING] < 2
    assert solved_units(whole)[SAMPLING] == 128 * 21  # each of 20 errors of 128 units is sampled again
    assert solved_units(whole)[CERTIFYING] == forecast.OF_COSTLY.before  # which a run solves of the given tolerances
