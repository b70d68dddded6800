"""The minimum of the model of a step, beside SLSQP on random convex models, and the conditions of an optimum."""

import jax
import numpy as np
import pytest
from scipy import optimize

from rvjax.tolerances.allocation.model import Model, minimum


def problem(seed, n=8, m=4):
    """Sum of a_j exp(-v_j) + a quadratic; rows b_k - sum c_kj exp(2 v_j) - g.v >= 0; bounds on most variables."""
    rng = np.random.default_rng(seed)
    a, q = rng.uniform(0.2, 3, n), rng.normal(size=(n, 2)) / 3
    c, g = rng.uniform(0, 1, (m, n)) ** 3, rng.normal(size=(m, n)) / 10
    b = c.sum(axis=1) * rng.uniform(0.4, 1.5, m)
    low, high = rng.uniform(-1.5, -0.4, n), rng.uniform(-0.2, 1.0, n)
    low[0], high[1] = -np.inf, np.inf

    def value(v):
        return float(a @ np.exp(-v) + ((q.T @ v) ** 2).sum() / 2)

    def slopes(v):
        return -a * np.exp(-v) + q @ (q.T @ v)

    def rows(v):
        return b - c @ np.exp(2 * v) - g @ v

    def jacobian(v):
        return -2 * c * np.exp(2 * v) - g

    def model(v, prices):
        bends = np.diag(a * np.exp(-v)) + q @ q.T
        if len(prices):
            bends = bends + np.diag(4 * (prices @ c) * np.exp(2 * v))
        return Model(slopes(v), bends, rows(v), jacobian(v))

    return value, model, low, high


@pytest.mark.parametrize("seed", range(12))
def test_the_minimum_is_that_of_slsqp(seed):
    value, model, low, high = problem(seed)
    start = np.random.default_rng(seed).uniform(-0.5, 0.4, len(low))
    v, prices = minimum(model, start, low, high)
    met = dict(type="ineq", fun=lambda v: model(v, np.zeros(0)).rows, jac=lambda v: model(v, np.zeros(0)).jacobian)
    other = optimize.minimize(value, start, jac=lambda v: model(v, np.zeros(0)).slopes, bounds=list(zip(low, high)),
                              constraints=[met], method="SLSQP", options=dict(ftol=1e-13, maxiter=500))  # fmt: skip
    assert other.success
    assert value(v) == pytest.approx(other.fun, rel=1e-7)
    np.testing.assert_allclose(v, other.x, atol=2e-4)
    here = model(v, prices)
    assert here.rows.min() > -1e-8 and prices.min() >= 0
    assert np.abs(prices * here.rows).max() < 1e-6
    left = here.slopes - here.jacobian.T @ prices  # what is left pushes against a bound
    at_low, at_high = v < low + 1e-5, v > high - 1e-5
    assert (left[at_low] > -1e-6).all() and (left[at_high] < 1e-6).all()
    assert np.abs(left[~at_low & ~at_high]).max() < 1e-5


def test_no_rows_and_a_start_out_of_bounds():
    """Bounds alone: (v - 3)^2 ends at the upper one, whatever the start."""
    model = lambda v, prices: Model(2 * (v - 3), 2 * np.eye(1), np.zeros(0), np.zeros((0, 1)))  # noqa: E731
    for start in (-50.0, 0.0, 50.0):
        v, prices = minimum(model, np.array([start]), np.array([-1.0]), np.array([2.0]))
        assert v == pytest.approx([2.0], abs=1e-6) and not len(prices)


def test_many_variables_with_slopes_of_unlike_size():
    """200 variables, costs over five decades: closed form v_j = log(a_j/(2 p c_j))/3 of a_j exp(-v_j) and one row."""
    rng = np.random.default_rng(0)
    a, c = 10 ** rng.uniform(-3, 2, 200), 10 ** rng.uniform(-2, 1, 200)
    root = lambda p: (c * np.exp(2 * np.log(a / (2 * p * c)) / 3)).sum() - 1  # noqa: E731
    a /= optimize.brentq(root, 1e-6, 1e9)  # a price of 1: the model is in parts of the cost

    def model(v, prices):
        rates = c * np.exp(2 * v)
        bends = a * np.exp(-v) + (4 * prices[0] * rates if len(prices) else 0.0)
        return Model(-a * np.exp(-v), np.diag(bends), np.array([1 - rates.sum()]), -2 * rates[None])

    v, prices = minimum(model, np.full(200, -4.0), np.full(200, -12.0), np.full(200, 12.0))
    assert prices == pytest.approx([1.0], rel=1e-4)
    np.testing.assert_allclose(v, np.log(a / (2 * c)) / 3, atol=1e-4)


def evaluated(slopes):
    """Places at which the model of 0 <= x <= 3, s >= 0, x <= 1 + s was looked at, its end and its price."""
    places = []

    def model(v, prices):
        places.append(v)
        return Model(slopes(v), np.zeros((2, 2)), np.array([1 - v[0] + v[1]]), np.array([[-1.0, 1.0]]))

    end, prices = minimum(model, np.array([0.5, 0.1]), np.zeros(2), np.array([3.0, np.inf]))
    return len(places), end, prices


@pytest.mark.parametrize("price", [10.0, 1e4])
def test_an_excess_of_any_price_ends_in_few_steps(price):
    """80 steps are the most: at its bound an excess times its price must be no gap."""
    steps, end, prices = evaluated(lambda v: np.array([-1.0, price]))
    assert steps < 30
    np.testing.assert_allclose(end, [1.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(prices, [1.0], rtol=1e-6)


def test_rounding_of_costs_in_single_precision_ends_the_steps():
    def slopes(v):
        noise = 1e-7 * np.sin(1e9 * v.sum())
        return np.array([-1.0 + noise, 10.0])

    jax.config.update("jax_enable_x64", False)
    try:
        steps, end, _ = evaluated(slopes)
    finally:
        jax.config.update("jax_enable_x64", True)
    assert steps < 30
    np.testing.assert_allclose(end, [1.0, 0.0], atol=1e-4)
