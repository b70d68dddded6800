"""The separable model of the allocation: prices by Newton's method.

Oracle: duality. At the optimum the cost is that of the dual function, a lower bound of every feasible cost; half-widths
within their bounds and the constraints then are the cheapest.
"""

import numpy as np
import pytest

from rvjax.tolerances import ReciprocalPower
from rvjax.tolerances.optimum import conlin
from rvjax.tolerances.optimum.sample_average import Point
from rvjax.units import um


def problem(seed, held):
    """Four fields and three constraints, of which some are idle; `held` fields have no room."""
    rng = np.random.default_rng(seed)
    t, distance = 10 * um * np.exp(rng.normal(0, 0.5, 4)), rng.uniform(1, 3, 3) * 100 * um
    slopes = rng.uniform(0, 1, (3, 4)) ** 3
    slopes *= (distance * rng.uniform(0.3, 1, 3) / slopes.sum(axis=1))[:, None]
    point = Point(t, distance * rng.normal(0, 0.2, 3), slopes, np.eye(3))
    costs = tuple(ReciprocalPower(scale=s, finest=1e-8, coarsest=1e-3) for s in rng.uniform(0.3, 6, 4))
    low, high = t * np.exp(-1.5), t * np.exp(1.5)
    low[:held] = high[:held] = t[:held]
    return costs, point, distance, np.full(3, 2.0), low, high


@pytest.mark.parametrize("held", [0, 2])
def test_the_cost_is_that_of_the_dual_function(held, monkeypatch):
    steps = []
    plain = conlin._Model.minima
    monkeypatch.setattr(conlin._Model, "minima", lambda model, prices: steps.append(1) or plain(model, prices))
    met = 0
    for seed in range(12):
        costs, point, distance, powers, low, high = problem(seed, held)
        t, multipliers = conlin.cheapest(costs, point, distance, powers, low, high)
        way = conlin.predicted(point, distance, powers, t[None])[0]
        if way.max() > 1 + 1e-5:  # the held fields alone are too wide
            continue
        met += 1
        cost = float(conlin.total_cost(costs, t))
        total = float(conlin.total_cost(costs, point.half_widths))
        prices = multipliers * distance / (powers * total)
        assert np.all(prices >= 0)
        assert np.all(prices * (1 - way) < 1e-6)
        model = conlin._Model(
            costs, *map(np.log, (point.half_widths, low, high)), *conlin._model(*problem(seed, held)[1:4]), powers
        )
        assert model.minima(prices)[0] * total == pytest.approx(cost, rel=1e-6)
    assert met >= 6
    assert len(steps) < 12 * 40  # a quasi-Newton method alone takes 150 for each
