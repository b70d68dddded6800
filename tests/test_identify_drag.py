"""Drag of a bench is no lost motion of a reducer. Data: equilibria at the torque that the discs transmit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import RVErrors, identify, loaded, models, study
from rvjax.loaded import observation
from rvjax.measured import Conditions, Loop, Measured
from rvjax.published.rv160 import READ
from rvjax.study import bench, problem
from rvjax.study.identification import nuisance
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec, rpm, um

GIVEN = models.kind(READ).conditions(rated_torque=1600.0, samples=4)
TOLD = dataclasses.replace(GIVEN, samples=5)  # programs are kept by their conditions: one of a law serves no equilibria
TORQUE = np.array([-1600.0, -800.0, -200.0, 0.0, 200.0, 800.0, 1600.0])  # of the bench
DRAG, CLEARANCE, STIFFNESS = 40.0, 6 * um, 0.9
PRIOR = {
    "bearing_clearance": Tolerance(0.0, 12 * um),
    "stiffness": Tolerance(0.5, 1.5),
    "offset": nuisance("offset", ()),
}


def told(layout, design, errors, torques, angles):
    """Errors (t, n) by a law with the sense of a reducer: play, springs that stiffen, a wave along the turn."""
    springs = 1e6 * design.stiffness.support_bearing / READ.stiffness.support_bearing
    load, gone = jnp.asarray(torques)[:, None], jnp.asarray(errors.bearing_clearance) / 0.05
    windup = load / springs + 1e-4 * jnp.tanh(load / 900.0) + gone * jnp.tanh(load / 50.0)
    return jnp.where(load == 0, 0.0, -windup) + 1e-6 * (1 + windup / 1e-3) * jnp.cos(jnp.asarray(angles)[None] / 3)


@pytest.fixture(params=["told", pytest.param("equilibria", marks=pytest.mark.long)])
def given(request, monkeypatch):
    """Conditions under which the loaded model answers by the law, or by its equilibria."""
    if request.param == "equilibria":
        return GIVEN
    monkeypatch.setattr(observation, "_errors", told)
    return TOLD


@jax.vmap
def solved(torque):
    """As many as a midline: one program."""
    errors = RVErrors.for_design(READ, bearing_clearance=CLEARANCE)
    return loaded.equilibrium(READ.stiffer(STIFFNESS), errors, input_angle=0.0, output_torque=torque).error


@pytest.fixture
def data(given):
    """Of a unit, input held: the torque on its discs is against that of the bench. Friction holds it back on either
    branch, the rising and the falling one."""
    torques = -np.concatenate([TORQUE - DRAG, TORQUE + DRAG])
    errors = RVErrors.for_design(READ, bearing_clearance=CLEARANCE)
    angle = (
        solved(torques) if given is GIVEN else told(None, READ.stiffer(STIFFNESS), errors, torques, np.zeros(1))[:, 0]
    )
    rising, falling = np.split(np.asarray(angle), 2)
    return {"angle": (rising + falling) / 2, "width": falling - rising}


def midline(nuisances, given):
    loop = models.kind(READ).observations("loaded")["loop"]
    return bench.Midline(READ, -TORQUE, loop, given, nuisances)


def seen_by(model, known):
    """The measurement that a model predicts, by a program of its own."""
    return jax.jit(lambda values: model(values))(known)


def test_a_loop_is_as_wide_as_its_drag(given, data):
    """The width is drag times compliance, from the branches; the midline has the clearance."""
    known = dict(bearing_clearance=CLEARANCE, stiffness=STIFFNESS, offset=0.0, drag=DRAG)
    seen = seen_by(midline(("offset", "drag"), given), known)
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


def test_a_measured_loop_is_that_of_its_unit(given, data):
    """The model of a study predicts the loop of a unit where the bench measured it, at the torque of the bench."""
    asked = dataclasses.replace(study.parse_study(STUDY, name="loop", solve=False), design=READ, conditions=given)
    seen = {"midline": np.asarray(data["angle"]), "width": np.asarray(data["width"]), "sd": np.full(7, arcsec)}
    loop = Loop("loop.csv", Conditions(), TORQUE, **seen, clipped=False)
    made = problem.problem(asked, Measured("loop", (loop,)))
    (measured,) = made.data
    known = dict(bearing_clearance=CLEARANCE, stiffness=STIFFNESS, offset=0.0, drag=DRAG)
    predicted = seen_by(made.model, known)
    for name in ("angle", "width"):
        np.testing.assert_allclose(predicted[name], measured[name], atol=1e-12)


def test_a_loop_tells_drag_from_clearance(given, data):
    prior = PRIOR | {"drag": nuisance("drag", ())}
    noise = identify.Noise({"angle": 0.2 * arcsec, "width": 0.4 * arcsec})
    model = midline(("offset", "drag"), given)
    found = identify.solve(model, prior, data, noise=noise, nuisance=("offset", "drag"), starts=1)
    assert found.adequate
    assert found.value["drag"] == pytest.approx(DRAG, rel=0.02)
    assert found.value["bearing_clearance"] == pytest.approx(CLEARANCE, rel=0.02)
    assert found.value["stiffness"] == pytest.approx(STIFFNESS, rel=0.002)


def test_a_curve_runs_under_load_and_drag(given):
    """The torque of a run is that of the bench plus drag, on either side; without drag it is today's."""
    ways = [(t, way, n) for t in (0.0, 500.0) for way in ("forward", "backward") for n in (100.0, 1000.0)]
    runs = [Conditions(torque=t, direction=way, speed=n * rpm) for t, way, n in ways]
    made = bench.curve_model("loaded", READ, given, runs, (40,), ("offset", "drag", "viscous_drag"), ())
    seen = seen_by(made, {"offset": 0.0, "drag": 15.0, "viscous_drag": 0.1})["mean"]
    sign = np.array([run.sign for run in runs])
    load = sign * [t + 15.0 + 0.1 * n * rpm for t, _, n in ways]
    some = np.array([0, 3, 4, 5, 6, 7])  # with those at standstill as many as above: one program
    due = [Conditions(torque=abs(t), direction="forward" if t > 0 else "backward") for t in load[some]]
    still = [Conditions(torque=0.0, direction=way) for way in ("forward", "backward")]
    bare = bench.curve_model("loaded", READ, given, [*due, *still], (40,), ("offset",), ())
    plain = seen_by(bare, {"offset": 0.0})["mean"]
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
