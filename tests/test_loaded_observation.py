"""Curves and loops of a bench: which equilibria they ask for, and slopes against differences.

The errors are told by a formula; a test compares those of equilibria with the whole results.
"""

import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, plain, solve

from rvjax.identify.elements import values_of
from rvjax.identify.identification import Problem
from rvjax.identify.posterior import contributions
from rvjax.loaded import observation, outputs
from rvjax.loaded.equilibrium import check_input
from rvjax.measured import Conditions
from rvjax.study import bench
from rvjax.tolerances import Tolerance
from rvjax.units import um
from tests.identify_models import Noise, unit

equilibrium = sys.modules["rvjax.loaded.equilibrium"]  # a function hides it
CASE = NAMED["rv40: all errors, rated, linear"]
DESIGN, ERRORS = plain((design_of(CASE), errors_of(CASE, design_of(CASE))))
GIVEN = outputs.LoadedConditions(output_torque=412.0, samples=8, pin_contact="linear", input_angle=0.3)
RUNS = [Conditions(torque=412.0, direction=way) for way in ("forward", "backward")]
PRIOR = {
    "ring_centre": Tolerance.symmetric(5 * um, shape=(2,)),
    "bearing_clearance": Tolerance(0.0, 3 * um),
    "offset": unit(3e-3),
}
ORDER = 8  # 32 angles of the output turn, in four parts


def told(layout, design, errors, angle, torque):
    """Error at one angle by a formula of two errors and two numbers of the design, with play and a kink."""
    wave = jnp.cos(ORDER * angle / design.ratio + 1e6 * errors.ring_centre[0]) * (1 + errors.ring_centre[1] / um)
    windup = torque / (2e6 * design.stiffness.sun_planet_mesh / 2e8)
    return 1e-6 * wave * (1 + 1e-3 * torque) - windup - 20 * errors.bearing_clearance * jnp.tanh(torque / 100.0)


def orders_of(values):
    """Mean and order of both runs by the errors of a turn, as one vector."""
    errors = errors_of({"errors": {}}, DESIGN, **{k: v for k, v in values.items() if k != "offset"})
    angles = 2 * np.pi * DESIGN.ratio * np.arange(32) / 32
    turns = np.array([[told(None, DESIGN, errors, a, torque) for a in angles] for torque in (412.0, -412.0)])
    order = 2 * np.mean(turns * np.exp(-2j * np.pi * ORDER * np.arange(32) / 32), axis=1)
    return np.concatenate([turns.mean(axis=1) + values["offset"], np.stack([order.real, order.imag], 1).ravel()])


def test_slopes_of_a_curve(monkeypatch):
    """Of all parts together, against differences of 1e-4 standard deviations to each side."""
    monkeypatch.setattr(observation, "error_alone", told)
    model = bench.curve_model("loaded", DESIGN, GIVEN, RUNS, (ORDER,), ("offset",), tuple(PRIOR))
    problem = Problem.of(model, PRIOR, noise=Noise(1.0), nuisance="offset")
    u, along = np.random.default_rng(1).standard_normal((2, problem.elements.count))
    found, slopes = problem.evaluate(u[None])
    assert len(model.split()[1]) == 4
    near = u + np.array([[-1e-4], [0], [1e-4]]) * along
    values = jax.device_get(jax.vmap(lambda u: values_of(problem.elements.population, u))(jnp.asarray(near)))
    below, here, above = (orders_of(jax.tree.map(lambda leaf, n=n: leaf[n], values)) for n in range(3))
    np.testing.assert_allclose(found[0], here, atol=1e-12 * np.abs(here).max())
    due = (above - below) / 2e-4
    np.testing.assert_allclose(slopes[0] @ along, due, atol=1e-6 * np.abs(due).max())
    parts = contributions(problem, np.zeros(problem.elements.count))
    assert parts.shape == (6, 3) and not parts.any()


def test_slopes_to_torques_and_angles(monkeypatch):
    """And to the design; what does not move has no share in them."""
    monkeypatch.setattr(observation, "error_alone", told)
    errors = errors_of({"errors": {}}, DESIGN, ring_centre=np.array([1e-6, -2e-6]), bearing_clearance=3e-6)
    torques, angles = np.array([-300.0, 20.0, 412.0]), np.array([0.3, 71.0])

    def turn(size, design, torques, angles):
        springs = design.stiffness.replace(sun_planet_mesh=2e8 * (1 + size))
        return observation._errors(None, design.replace(stiffness=springs), errors, torques, angles)

    along = (0.1, jax.tree.map(np.zeros_like, DESIGN), np.array([3.0, -1.0, 2.0]), np.array([0.05, -0.02]))
    at = (0.0, DESIGN, torques, angles)
    value, slope = jax.jit(lambda at, along: jax.jvp(turn, at, along))(plain(at), plain(along))
    due = np.array([[told(None, DESIGN, errors, a, t) for a in angles] for t in torques])
    np.testing.assert_allclose(value, due, rtol=1e-12)

    def moved(step):
        springs = DESIGN.stiffness.replace(sun_planet_mesh=2e8 * (1 + 0.1 * step))
        design = DESIGN.replace(stiffness=springs)
        where = [(t, a) for t in torques + step * along[2] for a in angles + step * along[3]]
        return np.array([told(None, design, errors, a, t) for t, a in where]).reshape(3, 2)

    np.testing.assert_allclose(slope, (moved(1e-4) - moved(-1e-4)) / 2e-4, rtol=1e-6, atol=1e-12)


def test_the_error_alone_is_that_of_the_equilibrium():
    """And NaN where there is none."""
    layout = check_input(DESIGN, ERRORS, "linear", "fixed", "fixed")._replace(interior=False)
    alone = jax.jit(partial(equilibrium.error_alone, layout))
    for angle, torque in ((3.7, 412.0), (576.0, -200.0)):
        due = solve(DESIGN, ERRORS, angle, torque, contact="linear").error
        np.testing.assert_allclose(alone(*plain((DESIGN, ERRORS, angle, torque))), due, rtol=1e-12)
    assert np.isnan(alone(*plain((DESIGN, ERRORS.replace(pin_radius=np.nan), 3.7, 412.0))))


def test_a_loop_holds_the_input(monkeypatch):
    """One angle, that of the conditions, and the torques as they are given."""
    seen = []

    def told(layout, design, errors, torques, angles):
        seen.append((layout.law, np.asarray(angles)))
        return -2e-6 * torques[:, None] + angles[None]

    monkeypatch.setattr(observation, "_errors", told)
    torques = np.array([-100.0, 0.0, 300.0])
    found = observation.LOOP.predict(DESIGN, errors_of({"errors": {}}, DESIGN), GIVEN, torques)
    np.testing.assert_allclose(found, 0.3 - 2e-6 * torques, rtol=1e-12)
    assert seen[0][0] == "linear" and seen[0][1] == pytest.approx([0.3])
