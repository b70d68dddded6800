"""A wrong word: its error names the nearest words first, then the whole list, however long the list is."""

import re

import pytest

from rvjax import RVErrors, dynamics, four_bar, levels, models, mounting, study, units
from rvjax.catalogue import RV_40E, RV_320E

STUDY = """
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 8
[tolerances.{field}]
half_width = "6.5 um"
[requirement.{output}]
upper = "0.25 arcmin"
"""

SPIN = dict(sun_speed=1.0, output_torque=1.0)


def refused(tmp_path, **words):
    words = {"field": "crank_eccentricity", "output": "transmission_error", **words}
    (tmp_path / "my.toml").write_text(STUDY.format(**words))
    with pytest.raises(study.StudyError) as error:
        study.load(tmp_path / "my.toml")
    return str(error.value)


def test_an_unknown_response_is_answered_with_the_nearest_and_with_all(tmp_path):
    message = refused(tmp_path, output="pin_presure")
    nearest, _, listed = message.partition("must be one of ")
    assert "(did you mean pin_pressure" in nearest
    assert listed.split(", ") == list(models.kind(RV_40E).outputs)
    assert "..." not in message and "\n" not in message and len(message) > 400


def test_an_unknown_error_is_answered_with_the_nearest_and_with_all(tmp_path):
    message = refused(tmp_path, field="crank_excentricity")
    assert "(did you mean crank_eccentricity" in message and " ... " not in message
    listed = message.partition("known here: ")[2].split(", ")
    assert len(message) > 400 and {"base_tangent_lower", "disc_bore", "support_clearance"} < set(listed)


def test_a_long_wrong_word_is_not_repeated(tmp_path):
    assert len(refused(tmp_path, output="x" * 20_000)) < 2_000


@pytest.mark.parametrize(
    ("call", "near", "listed"),
    [
        (lambda: RV_40E.replace(cranck=1), "cranks", "it has bearings, contact"),
        (
            lambda: dynamics.response(RV_320E, **SPIN, stage="planetry"),
            "planetary",
            "must be",
        ),
        (
            lambda: dynamics.response(RV_320E, **SPIN, outputs=["disc1.rotatio"]),
            "disc1",
            "sun.x",
        ),
        (lambda: four_bar.figures(RV_40E, RVErrors(), only="erorr"), "error", "None for both, or one of"),
        (lambda: RVErrors.for_design(RV_40E, disc_bores=0.0), "disc_bore", "it has "),
    ],
)
def test_a_wrong_word_in_python(call, near, listed):
    with pytest.raises(ValueError, match=rf"\(did you mean {re.escape(near)}.*{re.escape(listed)}"):
        call()


def _close(**words):
    return lambda: four_bar.transmission_error(RV_40E, RVErrors(), crank_angle=0.1, **words)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: units.parse("3 arcmn", "rad"), "'3 arcmn': unit 'arcmn' (did you mean arcmin"),
        (
            _close(cranks="phase_loked"),
            "cranks = 'phase_loked' (did you mean phase_locked?): must be one of",
        ),
        (_close(branch="opn"), "branch = 'opn' (did you mean open?): must be one of open, crossed"),
        (_close(closure="newtn"), "branch = 'open': cranks = 'phase_locked' (did you mean newton?) has the closures"),
        (
            lambda: mounting.mounted_disc(RV_40E, {"disc_bor": 0.0}, 0, index=0),
            "disc_0: disc_bor is no error of one disc (did you mean disc_bore",
        ),
        (
            lambda: levels.choose(RV_40E, ("lost_motion",), None, tolerances=None, accuracy={"lost_moton": 1.0}),
            "accuracy of 'lost_moton': it is not required (did you mean lost_motion?); required are lost_motion",
        ),
    ],
)
def test_wrong_words_of_every_kind(call, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        call()
