"""Reference cases of friction as designs, errors and frictions of one shape and type each: few programs compile."""

import json
from pathlib import Path

import cycloidal_cases
import jax
import loaded_cases
import numpy as np

import rvjax
from rvjax import Bearings, CycloidalErrors, Friction, Inertia, RollerBearing, running

CASES = json.loads((Path(__file__).parent / "reference" / "running.json").read_text())["cases"]
NAMED = {case["name"]: case for case in CASES}
FUNCTIONS = {
    "losses": running.losses,
    "single": running.losses,
    "back_driving": running.back_driving,
    "hysteresis": running.hysteresis,
    "joint": running.joint,
}


def unit_of(case):
    """Design and errors of a case."""
    given, single = case["design"], case["kind"] == "single"
    parts = {}
    if "bearings" in given:
        numbers = dict(given["bearings"])
        rollers = {name: RollerBearing(**numbers.pop(name)) for name in ("arm", "support") if numbers.get(name)}
        rest = {name: loaded_cases.number(value) for name, value in numbers.items() if value is not None}
        parts["bearings"] = Bearings(**rollers, **rest)
    if "inertia" in given:
        parts["inertia"] = Inertia(**{name: loaded_cases.number(value) for name, value in given["inertia"].items()})
    if single:
        design = cycloidal_cases.design_of(given).replace(**parts)
        errors = CycloidalErrors(
            **{name: np.asarray(v, float) if np.ndim(v) else v for name, v in case["errors"].items()}
        )
        return loaded_cases.plain((design, CycloidalErrors.for_design(design, **vars(errors))))
    design = loaded_cases.design_of({"design": given}, **parts)
    return loaded_cases.plain((design, loaded_cases.errors_of(case, design)))


def friction_of(case):
    return loaded_cases.plain(Friction(**case["friction"]))


def solved(case, **changes):
    """The function of a case with its options, or others."""
    design, errors = unit_of(case)
    options = {name: float(v) if type(v) is int and name != "samples" else v for name, v in case["options"].items()}
    return FUNCTIONS[case["kind"]](design, errors, friction_of(case), **(options | changes))


def assert_agrees(found, expect, rtol):
    """Every field of a case; NaN where it failed."""
    status = rvjax.Status(int(found.info.status)).name
    assert status == expect["status"], status
    if len(expect) == 1:
        values = {name: x for name, x in vars(found).items() if name not in ("info", "self_locking", "ratio")}
        assert all(np.isnan(x) for x in jax.tree.leaves(values))
    for name, value in expect.items():
        if name == "status":
            continue
        if value is None:
            assert getattr(found, name) is None, name
        else:
            size = max(abs(expect.get("loss_torque", 0.0)), abs(value)) if np.isfinite(value) else 0.0
            np.testing.assert_allclose(getattr(found, name), value, rtol=rtol, atol=1e-9 * size, err_msg=name)
