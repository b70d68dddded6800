"""Bearing lives against an independent evaluation in NumPy (tests/reference/life.json), with the tolerances it states:
ratings 1e-12; histories basic 1e-12, raceway 1e-6, slices 1e-4; machines basic 1e-7, raceway 1e-6, slices 1e-4.
"""

import sys

import numpy as np
import pytest
from life_cases import BASIC, CASES, NAMED, PLAN, duty_of, rate_together, unit_of

from rvjax import RollerBearing, Status, life

HISTORY = {"basic": 1e-12, "raceway": 1e-6, "slices": 1e-4}
MACHINE = {"basic": 1e-7, "raceway": 1e-6, "slices": 1e-4}
LONG = ("three", "rv40: no errors, rated", "rv40: no errors, linear", "rv40: all errors, four phases, raceway")
LONG += ("rv40: torque for",)  # that torque has that life, below; test_life_machine.py has the search
LONG += ("basic: three phases", "raceway: three phases")  # the laminae have the same history, and all methods weights


def names(kind):
    found = [case["name"] for case in CASES if case["kind"] == kind]
    return [pytest.param(name, marks=[pytest.mark.long] if name.startswith(LONG) else []) for name in found]


@pytest.mark.parametrize("name", names("ratings"))
def test_ratings_agree_with_the_independent_ones(name):
    case = NAMED[name]
    made = [RollerBearing(**numbers) for numbers in case["bearings"]]
    np.testing.assert_allclose([life.dynamic_rating(b) for b in made], case["expect"]["dynamic"], rtol=1e-12)
    np.testing.assert_allclose([life.static_rating(b) for b in made], case["expect"]["static"], rtol=1e-12)


@pytest.mark.parametrize("name", names("history"))
def test_histories_agree_with_the_independent_ones(name):
    case = NAMED[name]
    found = life.bearing_life(
        RollerBearing(**case["bearing"]),
        case["force"],
        angle=case.get("angle"),
        weight=case.get("weight", np.ones(len(case["force"]))),
        **case["options"],
    )
    assert int(found.info.status) == Status.CONVERGED
    tolerance = HISTORY[case["options"]["method"]]
    np.testing.assert_allclose(found.life, case["expect"]["life"], rtol=tolerance)
    np.testing.assert_allclose(found.load, case["expect"]["load"], rtol=tolerance)


@pytest.mark.parametrize("name", names("rating"))
def test_machines_agree_with_the_independent_ones(name):
    case = NAMED[name]
    given, alike = (*unit_of(case), duty_of(case)), case["options"] == PLAN and name.startswith("rv40")
    found = rate_together(*given) if alike else life.rating(*given, **case["options"])
    expect = dict(case["expect"])
    assert Status(int(found.info.status)).name == expect.pop("status")
    if not expect:
        for field in ("life", "arm", "support", "arm_load", "support_load", "static_safety"):
            assert np.isnan(getattr(found, field)).all()
    for field, value in expect.items():
        if value is None:
            assert getattr(found, field) is None
        else:
            tolerance = MACHINE[case["options"]["method"]]
            np.testing.assert_allclose(getattr(found, field), value, rtol=tolerance, err_msg=field)


def test_methods_reach_the_equilibrium(monkeypatch):
    """Nothing is compiled: the equilibrium is tested for each method, most reference cases in the long profile."""
    design, errors = unit_of(NAMED[BASIC])
    methods = dict(contact="linear", carrier="floating", sun="floating")
    for module, name in (("rated", "_rated_torque"), ("rating", "_rating")):  # functions hide modules of their name
        monkeypatch.setattr(sys.modules[f"rvjax.life.{module}"], name, lambda plan, *_: plan)
    plans = (
        life.rating(design, errors, duty_of(NAMED[BASIC]), samples=24, method="raceway", **methods),
        life.rated_torque(design, errors, life=1e7, output_speed=1.0, samples=24, method="raceway", **methods),
    )
    for plan in plans:
        assert (plan.layout.law, plan.layout.common) == ("linear", (3, 3))  # both float
        assert (plan.samples, plan.method) == (24, "raceway")


def test_a_rated_torque_of_the_reference_has_its_life():
    """By the program of the ratings."""
    case = NAMED["rv40: torque for 6000 h, all errors"]
    torque, speed = case["expect"]["torque"], case["output_speed"]
    duty = life.Duty(np.full(4, torque), np.full(4, speed), np.ones(4))
    assert case["options"] == PLAN
    assert float(rate_together(*unit_of(case), duty).life) == pytest.approx(case["life"], rel=MACHINE["basic"])


@pytest.mark.parametrize("name", names("rated"))
def test_rated_torques_agree_with_the_independent_ones(name):
    case = NAMED[name]
    given = {key: case[key] for key in ("life", "output_speed")} | case["options"]
    found = life.rated_torque(*unit_of(case), **given)
    assert Status(int(found.info.status)).name == case["expect"]["status"]
    np.testing.assert_allclose(found.torque, case["expect"]["torque"], rtol=MACHINE[case["options"]["method"]])
