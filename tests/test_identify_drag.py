"""Drag of a bench is no lost motion of a reducer. Data: equilibria at the torque that the discs transmit."""

import dataclasses

import jax
import numpy as np
import pytest

from rvjax import RVErrors, identify, loaded, models, study
from rvjax.published.rv160 import READ
from rvjax.study import bench, problem
from rvjax.study.measured import Conditions, Loop, Measured
from rvjax.study.nuisances import nuisance
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec, rpm, um

GIVEN = models.kind(READ).conditions(rated_torque=1600.0, samples=4)
TORQUE = np.array([-1600.0, -800.0, -200.0, 0.0, 200.0, 800.0, 1600.0])  # of the bench
DRAG, CLEARANCE, STIFFNESS = 40.0, 6 * um, 0.9
PRIOR = {
    "bearing_clearance": Tolerance(0.0, 12 * um),
    "stiffness": Tolerance(0.5, 1.5),
    "offset": nuisance("offset", ()),
}


@jax.vmap
def angle(torque):
    """Of a unit, input held: the torque on its discs is against that of the bench. As many as a midline: one program"""
    errors = RVErrors.for_design(READ, bearing_clearance=CLEARANCE)
    return loaded.equilibrium(READ.stiffer(STIFFNESS), errors, input_angle=0.0, output_torque=-torque).error


@pytest.fixture(scope="module")
def branches():
    """Rising and falling branch: friction holds the output back on either."""
    return np.split(np.asarray(angle(np.concatenate([TORQUE - DRAG, TORQUE + DRAG]))), 2)


def midline(nuisances):
    observation = models.kind(READ).observations("loaded")["loop"]
    return bench.Midline(READ, -TORQUE, observation, GIVEN, nuisances)


@pytest.fixture(scope="module")
def data(branches):
    rising, falling = branches
    return {"angle": (rising + falling) / 2, "width": falling - rising}


def test_a_loop_is_as_wide_as_its_drag(data):
    """The width is drag times compliance, from the branches; the midline has the clearance."""
    known = dict(bearing_clearance=CLEARANCE, stiffness=STIFFNESS, offset=0.0, drag=DRAG)
    seen = jax.jit(midline(("offset", "drag")).__call__)(known)
    np.testing.assert_allclose(seen["angle"], data["angle"], atol=1e-12)
    np.testing.assert_allclose(seen["width"], data["width"], atol=1e-12)


STUDY = """
[design]
base = "rv-40e-whole"
[conditions]
rated_torque = "412 N m"
[tolerances.bearing_clearance]
lower = "0 um"
upper = "12 um"
[identify]
model = "loaded"
noise = "0.2 arcsec"
nuisance = ["offset", "drag"]
"""


def test_a_measured_loop_is_that_of_its_unit(data):
    """The model of a study predicts the loop of a unit where the bench measured it, at the torque of the bench."""
    asked = dataclasses.replace(study.parse_study(STUDY, name="loop", solve=False), design=READ, conditions=GIVEN)
    seen = {"midline": np.asarray(data["angle"]), "width": np.asarray(data["width"]), "sd": np.full(7, arcsec)}
    loop = Loop("loop.csv", Conditions(), TORQUE, **seen, clipped=False)
    made = problem.problem(asked, Measured("loop", (loop,)))
    (measured,) = made.data
    known = dict(bearing_clearance=CLEARANCE, stiffness=STIFFNESS, offset=0.0, drag=DRAG)
    predicted = jax.jit(made.model.__call__)(known)
    for name in ("angle", "width"):
        np.testing.assert_allclose(predicted[name], measured[name], atol=1e-12)


@pytest.mark.long  # compiles the derivatives to every number; the model of the loop is tested above
def test_a_loop_tells_drag_from_clearance(data):
    prior = PRIOR | {"drag": nuisance("drag", ())}
    noise = identify.Noise({"angle": 0.2 * arcsec, "width": 0.4 * arcsec})
    found = identify.solve(midline(("offset", "drag")), prior, data, noise=noise, nuisance=("offset", "drag"), starts=1)
    assert found.adequate
    assert found.value["drag"] == pytest.approx(DRAG, rel=0.02)
    assert found.value["bearing_clearance"] == pytest.approx(CLEARANCE, rel=0.02)
    assert found.value["stiffness"] == pytest.approx(STIFFNESS, rel=0.002)


def test_a_curve_runs_under_load_and_drag():
    """The torque of a run is that of the bench plus drag, on either side; without drag it is today's."""
    ways = [(t, way, n) for t in (0.0, 500.0) for way in ("forward", "backward") for n in (100.0, 1000.0)]
    runs = [Conditions(torque=t, direction=way, speed=n * rpm) for t, way, n in ways]
    made = bench.curve_model("loaded", READ, GIVEN, runs, (40,), ("offset", "drag", "viscous_drag"), ())
    seen = jax.jit(made.__call__)({"offset": 0.0, "drag": 15.0, "viscous_drag": 0.1})["mean"]
    sign = np.array([run.sign for run in runs])
    load = sign * [t + 15.0 + 0.1 * n * rpm for t, _, n in ways]
    some = np.array([0, 3, 4, 5, 6, 7])  # with those at standstill as many as above: one program
    due = [Conditions(torque=abs(t), direction="forward" if t > 0 else "backward") for t in load[some]]
    still = [Conditions(torque=0.0, direction=way) for way in ("forward", "backward")]
    bare = bench.curve_model("loaded", READ, GIVEN, [*due, *still], (40,), ("offset",), ())
    plain = jax.jit(bare.__call__)({"offset": 0.0})["mean"]
    np.testing.assert_allclose(seen[some], plain[:6], rtol=1e-9)
    windup = np.asarray((seen[2:4] - seen[:2]) / 2)
    assert 0 < windup[0] < windup[1]  # no load: the faster run winds up more
    assert windup[0] > abs(plain[7] - plain[6]) / 2 + 0.5 * arcsec  # drag looks like lost motion


def test_a_drag_never_reverses_the_motion():
    """Prior draws may be negative: the torque keeps the sense of the run and stays above the probe."""
    made = bench.curve_model("loaded", READ, GIVEN, [Conditions(torque=100.0)], (40,), ("drag",), ())
    assert np.asarray(made._transmitted({"drag": -500.0})) == pytest.approx([bench.PROBE * 1600.0])


def test_viscous_drag_needs_a_speed():
    with pytest.raises(ValueError, match=r'viscous_drag": needs a column "speed \[rpm\]"'):
        bench.curve_model("loaded", READ, GIVEN, [Conditions(torque=1.0)], (40,), ("viscous_drag",), ())
