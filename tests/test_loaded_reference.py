"""The loaded equilibrium against an independent evaluation in NumPy (tests/reference/loaded.json).

Tolerances are those of the file, which its author derived from two implementations and from rounding: error 1e-9
relative + 1e-15 rad (free play: + 1e-11 rad), forces 1e-8 of the largest force of the case + 1e-8 N, stiffness 1e-6.
"""

import numpy as np
import pytest
from loaded_cases import CASES, design_of, errors_of, plain, solve

import rvjax
from rvjax import Status, loaded

# Programs of their own; test_loaded_oracle.py has another law, floating supports and other counts.
LONG = ("rv20", "rv320", "three", "rv40: all errors, rated, palmgren", "rv40: carrier floating")
EQUILIBRIA = [
    pytest.param(case["name"], marks=[pytest.mark.long] if case["name"].startswith(LONG) else [])
    for case in CASES
    if case["kind"] == "equilibrium"
]
BY_NAME = {case["name"]: case for case in CASES}


@pytest.mark.parametrize("name", EQUILIBRIA)
def test_equilibrium_agrees_with_the_independent_one(name):
    case = BY_NAME[name]
    design, expect = design_of(case), case["expect"]
    angle, torque, *methods = case["options"].values()
    found = solve(design, errors_of(case, design), angle, torque, **dict(zip(("contact", "carrier", "sun"), methods)))
    assert Status(int(found.info.status)).name == expect["status"]
    if "error" not in expect:
        for value in (found.error, found.pins, found.gear, found.disc_bearing, found.stiffness):
            assert np.isnan(value).all()
        return
    unloaded = expect["status"] == "UNLOADED"
    np.testing.assert_allclose(found.error, expect["error"], rtol=1e-9, atol=1e-15 + 1e-11 * unloaded)
    if unloaded:
        return
    largest = max(np.max(expect["pins"]), np.max(np.abs(expect["gear"])))
    for field in ("pins", "disc_bearing", "support_bearing", "gear"):
        np.testing.assert_allclose(getattr(found, field), expect[field], rtol=0, atol=1e-8 * largest + 1e-8)
    lever = np.max(np.abs(expect["disc_torque"])) + largest * design.cycloid.eccentricity * design.cycloid.disc_teeth
    np.testing.assert_allclose(found.disc_torque, expect["disc_torque"], rtol=0, atol=1e-8 * lever + 1e-8)
    np.testing.assert_allclose(
        found.input_torque, expect["input_torque"], rtol=0, atol=1e-8 * largest * design.involute.sun_base_radius + 1e-8
    )
    np.testing.assert_allclose(found.stiffness, expect["stiffness"], rtol=1e-6)
    np.testing.assert_allclose(np.max(found.pressure), expect["largest_pressure"], rtol=1e-6)
    # Unbalanced force: 450 roundings of the largest, or that of a gap or displacement (a tenth of a millimetre at most)
    # times the stiffest spring, which decides where forces are small beside the play.
    stiffest = max(
        np.max(np.asarray(k)) for k in (design.stiffness.turning_arm_bearing, design.stiffness.support_bearing)
    )
    assert found.info.residual * largest < 1e-11 * largest + 4 * np.finfo(float).eps * stiffest * 1e-4


@pytest.mark.parametrize("name", ["rv20: torsion, equidistant play only, linear", "rv40: torsion"])
@pytest.mark.long  # test_cycloidal_loaded.py has the torsion of a drive; its equilibria are above
def test_torsion_agrees_with_the_independent_one(name):
    """Backlash and lost motion are differences of angles: they inherit 1e-9 of the largest angle."""
    case = BY_NAME[name]
    design, expect = design_of(case), case["expect"]
    found = rvjax.check(loaded.torsion(*plain((design, errors_of(case, design))), **case["options"]))
    largest = np.max(np.abs(expect["angle"]))
    np.testing.assert_allclose(found.torque, expect["torque"], rtol=1e-14)
    np.testing.assert_allclose(found.angle, expect["angle"], rtol=1e-9, atol=1e-9 * largest)
    np.testing.assert_allclose(found.backlash, expect["backlash"], rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(found.lost_motion, expect["lost_motion"], rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(found.stiffness, expect["stiffness"], rtol=1e-6)


@pytest.mark.long  # test_loaded_properties.py has a turn against its equilibria, which are those of this file
@pytest.mark.parametrize("name", [case["name"] for case in CASES if case["kind"] == "revolution"])
def test_revolution_agrees_with_the_independent_one(name):
    """Harmonics are sums of the errors: 1e-9 of the largest error."""
    case = BY_NAME[name]
    design, expect = design_of(case), case["expect"]
    found = rvjax.check(loaded.revolution(*plain((design, errors_of(case, design))), **case["options"]))
    largest = np.max(np.abs(expect["error"]))
    np.testing.assert_allclose(found.error, expect["error"], rtol=1e-9)
    np.testing.assert_allclose(found.peak_to_peak, expect["peak_to_peak"], rtol=0, atol=2e-9 * largest)
    np.testing.assert_allclose(found.mean, expect["mean"], rtol=1e-9)
    real, imaginary = np.asarray(expect["harmonics"]).T
    np.testing.assert_allclose(found.harmonics, real + 1j * imaginary, rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(found.largest_pin, expect["largest_pin"], rtol=1e-8)
