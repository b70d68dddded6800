"""Any objective with any optimiser of optax.

Oracles: the half-widths that minimise a quadratic loss of a linear response and costs c/h, in closed form; central
differences of the sampled J, from `sample` and the plain response; the sampled J itself, unit by unit. Statistical
bounds are 4 of the stated standard errors.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import rvjax
from oracles.responses import Failing, Linear
from rvjax.status import Status
from rvjax.tolerances import QuadraticLoss, ReciprocalPower, Tolerance, minimise, sample
from rvjax.units import um

A, C = np.array([1.0, 2.0, 0.5]), np.array([1.0, 0.3, 2.0])
LOSS = QuadraticLoss(2.0, 5 * um)
K = 2.0 / (5 * um) ** 2
NAMES = ("u", "v", "w")
linear = Linear({"y": dict(zip(NAMES, map(float, A)))})


def costs(finest=0.1 * um, coarsest=1000 * um):
    return {n: ReciprocalPower(scale=float(c), finest=finest, coarsest=coarsest) for n, c in zip(NAMES, C)}


def tolerances(half_width=20 * um, **options):
    return {n: Tolerance.symmetric(half_width, **options) for n in NAMES}


def mean_loss(values, half_widths):
    return jnp.mean(LOSS(values["y"]))


def vector(found):
    return np.array([found.half_widths[n] for n in NAMES])


def exact(h, spread=9.0):
    """J of normal errors with half-widths of 3 sigma; with 3 in the place of 9, of uniform errors."""
    return float(np.sum(C * 10 * um / h) + K * np.sum(A**2 * h**2) / spread)


def optimum(spread=9.0):
    return np.cbrt(spread * C * 10 * um / (2 * K * A**2))


def sampled(objective, response, given, price, units, seed):
    """J of the units of these numbers, from the plain response."""
    errors = jax.vmap(lambda i: sample(given, i, seed=seed))(jnp.asarray(units))
    half_widths = {n: t.half_width for n, t in given.items()}
    total = sum(float(cost(half_widths[n])) for n, cost in price.items())
    return float(objective(jax.vmap(response)(errors), half_widths)) + total


def slope_of(objective, response, given, price, n, rate=1e-3, **options):
    """dJ/d log h by field, from one step of steepest descent on units 0 .. n - 1."""
    found = minimise(
        objective, response, given, costs=price, optimizer=optax.sgd(rate), samples=n, steps=1, seed=5, **options
    )
    return {name: math.log(float(given[name].half_width) / t) / rate for name, t in found.half_widths.items()}


def differences(objective, response, given, price, n, width=1e-4):
    found = {}
    for name, tolerance in given.items():
        ends = [
            sampled(
                objective, response, given | {name: tolerance.scaled(tolerance.half_width * math.exp(way))},
                price, range(n), seed=5,
            )
            for way in (-width, width)
        ]  # fmt: skip
        found[name] = (ends[1] - ends[0]) / (2 * width)
    return found


@pytest.fixture(scope="module")
def of_normal():
    return minimise(mean_loss, linear, tolerances(), costs=costs(), steps=200)


def check_closed_form(found, spread):
    np.testing.assert_allclose(vector(found), optimum(spread), rtol=0.01)
    assert exact(vector(found), spread) == pytest.approx(exact(optimum(spread), spread), rel=0.002)
    assert found.objective.value == pytest.approx(exact(vector(found), spread), abs=4 * found.objective.error)
    assert found.cost == pytest.approx(float(np.sum(C * 10 * um / vector(found))), rel=1e-12)
    assert rvjax.check(found) is found and found.info.steps == 200 and found.history.shape == (200,)
    for name, tolerance in found.tolerances.items():
        assert tolerance.half_width == pytest.approx(found.half_widths[name], rel=1e-15)


def test_the_half_widths_of_a_quadratic_loss_are_those_of_the_closed_form(of_normal):
    check_closed_form(of_normal, 9.0)
    # The mean square of n normal numbers has a standard error of sqrt(2/n); 16 samples show it to 18 %.
    loss = of_normal.objective.value - of_normal.cost
    assert of_normal.objective.error == pytest.approx(loss * math.sqrt(2 / (16 * 4096)), rel=0.6)
    assert of_normal.objective.lower < of_normal.objective.value < of_normal.objective.upper


def test_the_half_widths_of_uniform_errors_are_those_of_the_closed_form():
    """From a start 30 times too coarse, which slopes of its size must not be remembered for."""
    given = tolerances(100 * um, distribution="uniform")
    check_closed_form(minimise(mean_loss, linear, given, costs=costs(), steps=200 * 2), 3.0)


def test_any_optimiser_finds_the_minimum_of_one_sample():
    options = dict(costs=costs(), samples=500, fresh=False)
    by_adam = minimise(mean_loss, linear, tolerances(), steps=300, **options)
    by_sgd = minimise(mean_loss, linear, tolerances(), optimizer=optax.sgd(0.05), steps=200, **options)
    by_lbfgs = minimise(mean_loss, linear, tolerances(), optimizer=optax.lbfgs(), steps=15, **options)
    np.testing.assert_allclose(vector(by_adam), vector(by_lbfgs), rtol=1e-3)
    np.testing.assert_allclose(vector(by_sgd), vector(by_lbfgs), rtol=1e-3)
    assert by_sgd.history[-1] == pytest.approx(by_lbfgs.history[-1], rel=1e-6)
