"""A design in millimetres as if in metres: one warning per design from every model, in Python too."""

import dataclasses
import warnings

import jax
import pytest

from rvjax import CamRollerErrors, RVErrors, dynamics, four_bar, loaded, lost_motion, mesh_force, study
from rvjax.catalogue import (
    CORR,
    KNOWN_DESIGNS,
    RV_20E,
    RV_40E,
    RV_40E_WHOLE,
    RV_80E,
    RV_320E,
    ImplausibleDesign,
    doubtful,
)
from rvjax.loaded.cases import MACHINE

MODELS = {
    "four_bar.transmission_error": (
        RV_40E, lambda d: four_bar.transmission_error(d, RVErrors(), crank_angle=0.3),
    ),
    "four_bar.revolution": (RV_40E, lambda d: four_bar.revolution(d, RVErrors(), angles=2)),
    "lost_motion.geometric": (RV_40E, lambda d: lost_motion.geometric(d, RVErrors())),
    "loaded.equilibrium": (MACHINE, lambda d: loaded.equilibrium(d, RVErrors(), input_angle=0.1, output_torque=9.0)),
    "dynamics.modes": (RV_320E, dynamics.modes),
    "mesh_force.solve": (CORR, lambda d: mesh_force.solve(d, CamRollerErrors(), input_torque=1.0, output_angle=0.3)),
}  # fmt: skip


def scaled(record, factor=1000.0):
    """A copy with every length times a factor."""
    values = {}
    for f in dataclasses.fields(record):
        value, about = getattr(record, f.name), f.metadata
        if value is not None and about["kind"] == "record":
            values[f.name] = scaled(value, factor)
        elif value is not None and about["unit"] == "m":
            values[f.name] = value * factor
    return dataclasses.replace(record, **values)


@pytest.mark.parametrize("name", MODELS)
def test_every_model_doubts_a_design_in_millimetres(name):
    design, call = MODELS[name]
    wrong = scaled(design)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # it ends the call before anything is traced
        with pytest.raises(ImplausibleDesign, match=rf"^{name}: design\..*check the unit \(and .* more"):
            call(wrong)


def test_a_design_is_doubted_once():
    wrong = scaled(RV_40E)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        lost_motion.geometric(wrong, RVErrors())
        lost_motion.geometric(wrong, RVErrors())
        jax.eval_shape(lambda: four_bar.transmission_error(wrong, RVErrors(), crank_angle=0.3))
    assert [(warning.category, warning.filename) for warning in said] == [(ImplausibleDesign, __file__)]


def test_every_length_that_known_reducers_have_is_doubted_and_no_other():
    lengths = {line.partition(" = ")[0] for line in doubtful(scaled(RV_40E))}
    assert {"cycloid.pin_radius", "cycloid.eccentricity", "cranks.circle_radius", "involute.module"} <= lengths
    assert not any("stiffness" in name for name in lengths)
    for design in KNOWN_DESIGNS:
        assert doubtful(design) == doubtful(scaled(design, 25.0)) == []


def test_tracers_and_studies_are_silent():
    wrong = scaled(RV_40E)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jax.eval_shape(lambda d: four_bar.transmission_error(d, RVErrors(), crank_angle=0.3), wrong)
        asked = dataclasses.replace(study.load("rv-40e", solve=False), design=wrong)  # prints its own lines
        jax.eval_shape(lambda: four_bar.transmission_error(asked.design, RVErrors(), crank_angle=0.3))
    assert any("check the unit" in line for line in asked.doubts)


def test_a_design_of_another_size_is_not_doubted():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        soft = RV_320E.replace(stiffness=RV_320E.stiffness.replace(turning_arm_bearing=1e6))  # a calibration moves it
        assert doubtful(soft)
        flat = RV_40E_WHOLE.replace(cycloid=RV_40E_WHOLE.cycloid.replace(equidistant_modification=1e-9))
        assert doubtful(flat) == []  # a modification passes through zero in a search
        for design in (RV_20E, RV_80E, soft, scaled(RV_40E, 3.0)):
            lost_motion.geometric(scaled(design, 1.0), RVErrors())


@pytest.mark.parametrize(
    ("part", "name", "value"), [("stiffness", "turning_arm_bearing", 600.0), ("contact", "face_width", 12.0)]
)
def test_stiffness_and_face_width_in_a_wrong_unit_are_doubted(part, name, value):
    """600 N/um without its micro, and 12 mm without its milli."""
    wrong = RV_40E_WHOLE.replace(**{part: getattr(RV_40E_WHOLE, part).replace(**{name: value})})
    with pytest.warns(ImplausibleDesign, match=rf"design\.{part}\.{name} = .*check the unit"):
        lost_motion.geometric(wrong, RVErrors())
