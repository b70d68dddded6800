"""The measured line on the whole reducer: its interval covers the truth, and it is narrower by a good control."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

from rvjax import models
from rvjax.commands.allocate import full_model_check
from rvjax.commands.allocate.full_model_check import unlimited_tables, unlimited_texts, whole_text
from rvjax.population import wilson
from rvjax.study import load, parse_study

UNITS, MANY = 256, 1024
LOADED = """[design]
base = "rv-320e"
[design.contact]
young_modulus = "206 GPa"
poisson_ratio = 0.3
face_width = "12 mm"
[conditions]
output_torque = "3136 N m"
[tolerances.crank_eccentricity]
half_width = "10 um"
[tolerances.disc_bore]
half_width = "10 um"
[tolerances.disc_runout]
upper = "10 um"
lower = "0 um"
[requirement.transmission_error]
upper = "1 arcmin"
[requirement.misfit]
upper = "30 um"
"""


def replicates(truth, limit, count, control):
    """Estimates of the share of units within a limit, from `count` samples of units with 8 errors each."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(count):
        errors = rng.standard_normal((8, MANY))
        values = truth(errors, rng)[:UNITS]
        given = values if control else rng.standard_normal(UNITS)
        one = full_model_check.Limited(lambda row: row - limit, given)
        scores = full_model_check.crossed(errors, [one], np.ones(UNITS, bool))
        found.append(full_model_check.stratified(values <= limit, *scores, confidence=0.95))
    return found


@pytest.mark.parametrize(("limit", "control"), [(0.5, True), (2.0, True), (3.0, True), (2.0, False)])
def test_the_interval_covers_the_truth(limit, control):
    """A nearly linear value, and a control that knows it or is noise; 150 samples of units.

    The number of misses is binomial: a coverage of 94 % or more would give more misses than the bound once in 1000.
    """

    def truth(errors, rng):
        return errors[0] + 0.8 * errors[1] + 0.2 * errors[2] ** 2 + 0.2 * rng.standard_normal(errors.shape[1])

    rng = np.random.default_rng(9)
    share = np.mean(truth(rng.standard_normal((8, 1_000_000)), rng) <= limit)
    found = replicates(truth, limit, 150, control)
    misses = sum(not one.lower <= share <= one.upper for one in found)
    assert misses <= binom.ppf(0.999, 150, 0.06)
    values = np.array([one.value for one in found])
    assert abs(values.mean() - share) < 5 * values.std() / np.sqrt(150)  # no bias
    width = np.mean([one.upper - one.lower for one in found])
    plain = wilson(round(share * UNITS), UNITS, 0.95)
    assert width < (0.8 if control and limit < 3 else 1.3) * (plain.upper - plain.lower)


def test_failed_units_count_as_rejects_and_strata_without_units_join():
    good = np.array([True] * 90 + [False] * 10)
    own = np.where(good, -3.0, 3.0)
    every = np.concatenate([np.full(60, -3.0), np.full(20, -1.0), np.full(20, 3.0)])[None]
    found = full_model_check.stratified(good, own, every, confidence=0.95)
    assert found.value == pytest.approx(0.8)  # -1 joins -3: no unit is solved there
    assert found.lower < 0.8 < found.upper
    nothing = full_model_check.stratified(
        np.zeros(8, bool), np.full(8, -np.inf), np.full((4, 50), -np.inf), confidence=0.95
    )
    assert nothing.value == 0 and nothing.upper > 0.2


def test_a_curve_predicts_its_peak_to_peak():
    """A wave whose two amplitudes are linear in the errors: its length is not, its curve is."""
    rng = np.random.default_rng(1)
    errors, angle = rng.standard_normal((3, MANY)), np.arange(48) / 48 * 2 * np.pi
    curves = np.outer(errors[0], np.cos(angle)) + np.outer(errors[1], np.sin(angle))
    values = np.ptp(curves, axis=1)
    own = {"values": values[:UNITS], "margin": lambda row: row - 3.0}
    right = [  # of the units on the side that is predicted
        np.mean((full_model_check.crossed(errors, [one], np.ones(UNITS, bool))[1][0] > 0) == (values > 3.0))
        for one in (full_model_check.Limited(**own, curves=curves[:UNITS]), full_model_check.Limited(**own))
    ]
    assert right[0] > 0.99 > 0.8 > right[1]


@pytest.fixture
def study():
    return parse_study(LOADED, name="small", solve=False)


def faked(limit):
    def response(errors):
        size = jnp.sum(errors.crank_eccentricity**2)
        return {"loaded_transmission_error": 1e6 * size, "misfit": jnp.abs(errors.disc_bore[0, 0, 0])}

    response.costly = True
    return SimpleNamespace(of=lambda design, names, conditions: response)


def test_the_line_names_what_was_measured_and_what_was_not(study, monkeypatch):
    monkeypatch.setattr(full_model_check, "Response", faked(1.0))
    found = full_model_check.whole(study, study.tolerances)
    assert found.output == {"transmission_error": "loaded_transmission_error", "misfit": "misfit"}
    assert found.unread == ("disc_runout",) and found.units == full_model_check.UNITS and found.failed == 0
    assert found.share.lower <= found.share.value <= found.share.upper
    text = whole_text(found, study)
    assert text.startswith("On the whole reducer ") and "disc_runout (it has no place)" in text
    assert "loaded_transmission_error" in text and "arcmin" in text


DUTY = '[[duty]]\noutput_torque = "3136 N m"\noutput_speed = "15 rpm"\ntime = "1 h"\n'


def loaded_study(*changes):
    text = LOADED.replace("requirement.transmission_error", "requirement.loaded_transmission_error")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_study(text, name="loaded", solve=False)


def test_what_a_loaded_study_does_not_limit_is_what_its_design_and_conditions_can_give():
    start = "[requirement.misfit]"
    pressure = (start, '[requirement.turn_pin_pressure]\nupper = "3000 MPa"\n' + start)
    assert set(full_model_check.not_limited(loaded_study()).outputs) == {"turn_pin_pressure", "arm_bearing_force"}
    assert full_model_check.not_limited(loaded_study(pressure)).outputs == ("arm_bearing_force",)
    with_duty = loaded_study((start, DUTY + start))
    assert set(full_model_check.not_limited(with_duty).outputs) == {"turn_pin_pressure", "arm_bearing_force", "life"}
    bare = with_duty.design.replace(bearings=None)
    assert full_model_check.not_limited(dataclasses.replace(with_duty, design=bare)).outputs == ("turn_pin_pressure",)
    assert (
        full_model_check.not_limited(study_of("rv-40e-whole")) is None
        and full_model_check.not_limited(study_of("rv-40e")) is None
    )


def study_of(name):
    return load(name, solve=False)


def test_usual_limits_are_those_of_the_embedded_study():
    """Its force of an arm bearing is C0 = 33,033 N / 1.5 / 2.5, rounded to 0.1 kN."""
    asked = study_of("rv-40e-whole")
    usual = models.kind(asked.design).usual
    assert set(usual) == {"turn_pin_pressure", "arm_bearing_force", "life"}
    for name, limit in usual.items():
        requirement = asked.requirements[name]
        assert limit.limits(asked.design) == pytest.approx((requirement.lower, requirement.upper), rel=2e-3)


def test_units_beyond_a_usual_limit_are_said(monkeypatch):
    """Pressure 2650 MPa and 100 MPa of standard deviation: 93.32 % within 2800 MPa, 99 % within 2883 MPa."""

    def response(errors):
        unit = errors.crank_eccentricity[0, 0] / (10e-6 / 3)
        return {"turn_pin_pressure": (2650 + 100 * unit) * 1e6}

    response.costly, response.outputs = True, ("turn_pin_pressure",)
    asked = loaded_study(("[conditions]", "[run]\nseed = 1\n[conditions]"))
    monkeypatch.setattr(full_model_check, "Response", SimpleNamespace(of=lambda design, names, conditions: response))
    (found,) = full_model_check.unlimited(asked, asked.tolerances).values()
    assert found.nominal == pytest.approx(2650e6) and found.units == full_model_check.UNITS and found.failed == 0
    assert found.reached.lower < 2882.6e6 < found.reached.upper
    assert found.share.lower < 0.93319 < found.share.upper and found.missed
    seen = {"turn_pin_pressure": found}
    (line,) = unlimited_texts(seen, asked)
    beyond = f"{100 * (1 - found.share.value):.3g} % of the units miss a usual limit, <= 2800 MPa"
    assert line.startswith(f"Not limited: turn_pin_pressure. {beyond} (static safety 2")
    (table,) = unlimited_tables(seen, asked)
    (row,) = table.texts()[1]
    assert row[0] == "turn_pin_pressure" and row[1] == "2650 MPa" and row[3] == "<= 2800 MPa"
    kept = dataclasses.replace(found, share=wilson(512, 512, 0.95))
    assert unlimited_texts({"turn_pin_pressure": kept}, asked) == [] and not kept.missed
    assert unlimited_tables({}, asked) == []


def test_studies_that_are_not_measured(study):
    assert full_model_check.counterparts(study)
    lacks = LOADED.replace('base = "rv-320e"', 'base = "rv-40e"')
    for text in (
        lacks,
        LOADED.replace("3136 N m", "0 N m"),
        LOADED.replace("requirement.transmission_error", "requirement.loaded_transmission_error"),
        LOADED.replace('[requirement.transmission_error]\nupper = "1 arcmin"\n', ""),
    ):
        assert full_model_check.counterparts(parse_study(text, name="other", solve=False)) == {}
