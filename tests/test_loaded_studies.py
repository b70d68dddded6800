"""What a study of the whole reducer refuses, in one line that names the key; nothing is compiled for it."""

import pytest

from rvjax._jax.programs import QUICK
from rvjax.study import StudyError, load, parse_study

WHOLE = load("rv-40e-whole", solve=False).text
HEAD = WHOLE[: WHOLE.index("[requirement.")]
TURN, BENCH = "loaded_transmission_error", "bench_lost_motion"
CONTACT = 'young_modulus = "206 GPa"\npoisson_ratio = 0.3\nface_width = "12 mm"\n'


def study(requirement, conditions, changes=()):
    """The whole RV-40E with one requirement and these conditions."""
    head, _, tail = HEAD.partition("[conditions]")
    text = f"{head}[conditions]\n{conditions}\n{tail[tail.index('# First stage') :]}"
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return f'{text}\n[requirement.{requirement}]\nupper = "1 arcmin"\n'


@pytest.mark.parametrize(
    ("requirement", "conditions", "words"),
    [
        (
            "order_amplitude",
            "order = 480\nsamples = 24",
            "conditions.order = 480: beyond half of conditions.samples = 24",
        ),
        ("order_amplitude", "order = 41", "conditions.order = 41: a crank turn shows multiples of 40 only"),
        ("order_amplitude", "order = 0", "conditions.order = 0: must be an integer of at least 1"),
        ("order_amplitude", "", "conditions.order is missing: order_amplitude needs it"),
        (BENCH, 'rated_torque = "0 N m"', "conditions.rated_torque = 0 N m: must be positive"),
        ("backlash", 'rated_torque = "-412 N m"', "conditions.rated_torque = -412 N m: must be positive"),
        (BENCH, "", "conditions.rated_torque is missing: bench_lost_motion needs it"),
        (
            BENCH,
            'rated_torque = "412 N m"\nprobe_angles = 0',
            "conditions.probe_angles = 0: must be an integer of at lea",
        ),
        (TURN, "output_torque = []", r"conditions.output_torque = \[\]: needs one number in quotes"),
        (
            TURN,
            'output_torque = ["412 N m", "12 N m"]',
            r"conditions.output_torque = \['412 N m', .*: needs one number",
        ),
        (TURN, 'output_torque = "412"', "conditions.output_torque = '412': unit '' is not one of N m"),
        (TURN, 'output_torque = "inf N m"', "conditions.output_torque = 'inf N m': must be finite"),
        ("second_transmission_error", "", "conditions.second_torque is missing"),
        (
            "mean_shift",
            'output_torque = "412 N m"\nsecond_torque = "412 N m"',
            "conditions.second_torque = 412 N m: must differ from conditions.output_torque",
        ),
        (TURN, "span = 0", "conditions.span = 0: must be one of crank_turn, output_turn"),
        (TURN, 'span = "0 deg"', "conditions.span = '0 deg': must be one of crank_turn, output_turn"),
        (TURN, "samples = 1", "conditions.samples = 1: must be an integer of at least 4"),
        (TURN, 'pin_contact = "soft"', "conditions.pin_contact = 'soft': must be one of hertz, linear, palmgren"),
        (TURN, 'carrier = "loose"', "conditions.carrier = 'loose': must be one of fixed, floating"),
    ],
)
def test_conditions_are_refused(requirement, conditions, words):
    refused(study(requirement, conditions), words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            f"[design.contact] # steel; width of a disc assumed\n{CONTACT}",
            "",
            "design.contact is missing: .* face_width",
        ),
        ('face_width = "12 mm"\n', "", "design.contact: face_width in m missing"),
        ('face_width = "12 mm"', 'face_width = "0 mm"', "face_width = 0 m: must be positive"),
        ('disc_pin_mesh = "600 N/um"\n', "", "design.stiffness: disc_pin_mesh in N/m missing"),
    ],
)
def test_parts_that_carry_load_are_needed(old, new, words):
    refused(study(TURN, "", [(old, new)]), words)


def test_a_reducer_without_stiffnesses_carries_no_load():
    text = '[design]\nbase = "rv-40e"\n[tolerances.crank_eccentricity]\nhalf_width = "5 um"\n[requirement.pin_force]\n'
    refused(text + 'upper = "5 kN"', "design.stiffness is missing: a reducer under load needs it, with sun_support, ")


@pytest.mark.parametrize(
    ("entry", "field"),
    [
        ('pin_ring]\nposition = "diametral 10 um"', "pin_offset"),
        ('sun_runout]\nrunout = "10 um"', "sun_runout"),
        ('support_clearance]\nlower = "0 um"\nupper = "2 um"', "support_clearance"),
    ],
)
def test_a_placed_tolerance_needs_a_model_that_places_it(entry, field):
    text = f'[design]\nbase = "rv-40e"\n[tolerances.{entry}\n[requirement.misfit]\nupper = "30 um"'
    refused(text, f"tolerances.{field}: required responses do not use it, only .*loaded_transmission_error")


def refused(text, words):
    """By the reader that compiles and by the one that does not, alike."""
    messages = []
    for solve in (False, True):
        with pytest.raises(StudyError, match=words) as caught:
            parse_study(text, name="x", solve=solve)
        messages.append(str(caught.value))
    assert messages[0] == messages[1] and "\n" not in messages[0] and messages[0].startswith("x: ")


def test_studies_of_the_loaded_reducer_are_compiled_quickly():
    options = {name: load(name, solve=False).response().compiler_options for name in ("rv-40e", "rv-40e-whole")}
    assert options == {"rv-40e": (), "rv-40e-whole": QUICK}
