"""Curves and loops of a bench: their equilibria, one by one, and slopes against the differences of these."""

import jax
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, solve

from rvjax.identify.elements import mapped
from rvjax.identify.problem import Problem
from rvjax.identify.shares import contributions
from rvjax.loaded import observation, outputs
from rvjax.study import bench
from rvjax.study.measured import Conditions
from rvjax.tolerances import Tolerance
from rvjax.units import um
from tests.identify_models import Noise, unit

DESIGN = design_of(NAMED["rv40: all errors, rated, linear"])
GIVEN = outputs.Conditions(output_torque=412.0, samples=8, pin_contact="linear", input_angle=0.3)
RUNS = [Conditions(torque=412.0, direction=way) for way in ("forward", "backward")]
PRIOR = {
    "ring_centre": Tolerance.symmetric(5 * um, shape=(2,)),
    "bearing_clearance": Tolerance(0.0, 3 * um),
    "offset": unit(3e-3),
}
ORDER = 8  # 32 angles of the output turn, in four parts


def errors_at(angle, torque, values):
    """The error of a unit at one angle."""
    errors = errors_of({"errors": {}}, DESIGN, **{k: v for k, v in values.items() if k != "offset"})
    return float(solve(DESIGN, errors, angle, torque, contact="linear").error)


def orders_of(values):
    """Mean and order of both runs by the equilibria of a turn, as one vector."""
    angles = 2 * np.pi * DESIGN.ratio * np.arange(32) / 32
    turns = np.array([[errors_at(angle, torque, values) for angle in angles] for torque in (412.0, -412.0)])
    order = 2 * np.mean(turns * np.exp(-2j * np.pi * ORDER * np.arange(32) / 32), axis=1)
    return np.concatenate([turns.mean(axis=1) + values["offset"], np.stack([order.real, order.imag], 1).ravel()])


def test_slopes_of_a_curve():
    """Of all parts together; differences of 1e-4 standard deviations to each side: contacts that open between leave
    1e-4 of the largest."""
    model = bench.curve_model("loaded", DESIGN, GIVEN, RUNS, (ORDER,), ("offset",), tuple(PRIOR))
    problem = Problem.of(model, PRIOR, noise=Noise(1.0), nuisance="offset")
    u, along = np.random.default_rng(1).standard_normal((2, problem.elements.count))
    found, slopes = problem.evaluate(u[None])
    assert len(model.split()[1]) == 4
    near = u + np.array([[-1e-4], [0], [1e-4]]) * along
    values = jax.device_get(mapped(problem.elements.population, near)[1])
    below, here, above = (orders_of(jax.tree.map(lambda leaf, n=n: leaf[n], values)) for n in range(3))
    np.testing.assert_allclose(found[0], here, atol=1e-9 * np.abs(here).max())
    due = (above - below) / 2e-4
    np.testing.assert_allclose(slopes[0] @ along, due, atol=1e-4 * np.abs(due).max())
    parts = contributions(problem, np.zeros(problem.elements.count))
    assert parts.shape == (6, 3) and not parts.any()


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
