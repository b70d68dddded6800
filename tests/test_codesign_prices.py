"""Prices against exact ones of random problems, small prices next to large ones too; quantiles by line sampling."""

import math

import numpy as np
import pytest
from codesign_cases import one_start
from codesign_random import problem
from scipy import stats

from rvjax.tolerances import allocate
from rvjax.tolerances.optimum.lines import Lines
from rvjax.tolerances.optimum.tail_sample import Centres


@one_start()
@pytest.mark.parametrize("seed", [9, *(pytest.param(k, marks=pytest.mark.long) for k in (10, 12))])
def test_all_prices_of_a_random_problem(seed):
    """Within 5 %, of which the certificate takes up to 2 %. Slopes of a few hundred units missed these by 7 to 17 %."""
    given = problem(seed)
    cost, prices, _ = given.exact()
    arguments = given.arguments()
    first = [arguments.pop(key) for key in ("response", "tolerances", "requirements")]
    found = allocate(*first, **arguments)
    assert found.status == "OPTIMAL" and cost < found.cost < 1.01 * cost
    assert min(map(abs, prices.values())) > 0
    for name, price in prices.items():
        assert found.multipliers[name] == pytest.approx(price, rel=0.05)


def measure_of(margin):
    """Margins and derivatives along directions by small differences."""

    def measure(z, along):
        return margin(z), (margin(z + 1e-6 * along) - margin(z - 1e-6 * along)) / 2e-6

    return measure


SLOPE = np.array([0.5, -1.0, 2.0])
ROOT = float(np.linalg.norm(SLOPE))
ONE = Centres(2.5 * SLOPE[None] / ROOT, np.array([1.0]))


def test_lines_have_the_quantile_of_a_linear_margin_without_noise():
    """64 lines; the mean unit at the quantile lies on the gradient, at 2.782 deviations for 0.0027."""
    lines, seen = Lines(ONE, 64, 0), []

    def margin(z):
        seen.append(z)
        return SLOPE @ z - 1.0

    found = lines.cross(measure_of(margin), 0.0027)
    assert found.level == pytest.approx(ROOT * stats.norm.isf(0.0027) - 1.0, rel=1e-7)
    assert found.weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(seen[-3] @ found.weights, stats.norm.isf(0.0027) * SLOPE / ROOT, atol=1e-3)


def test_lines_of_two_centres_share_the_rejects_of_two_limits():
    """|z0| beyond -2.9 and 3.1 with 10 % of two tails that meet at a right angle: exact shares of the normal law."""
    places = np.array([[3.1, 0.0], [-2.9, 0.0], [0.0, 3.0]])
    lines = Lines(Centres(places, np.array([0.2, 0.4, 0.4])), 256, 1)
    inside = (stats.norm.cdf(3.1) - stats.norm.cdf(-2.9)) * stats.norm.cdf(3.0)

    def margin(z):
        return np.max([z[0] - 3.1, -2.9 - z[0], z[1] - 3.0], axis=0)

    found = lines.cross(measure_of(margin), 1 - inside)
    assert found.level == pytest.approx(0.0, abs=2e-3)
    each = np.add.reduceat(found.weights, [0, 256, 512])
    due = stats.norm.pdf([3.1, 2.9, 3.0])
    np.testing.assert_allclose(each, due / due.sum(), atol=0.01)


def test_lines_of_a_margin_that_curves():
    """z0 + z1^2/12: its quantile by quadrature over z1."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    lines = Lines(Centres(np.array([[2.8, 0.0]]), np.array([1.0])), 512, 0)
    found = lines.cross(measure_of(lambda z: z[0] + z[1] ** 2 / 12), 0.0027)
    share = float(weights @ stats.norm.sf(found.level - nodes**2 / 12)) / math.sqrt(2 * math.pi)
    assert share == pytest.approx(0.0027, rel=0.02)


def test_lines_that_do_not_meet_a_limit_are_none():
    lines = Lines(ONE, 64, 0)
    assert lines.cross(measure_of(lambda z: np.zeros(z.shape[1])), 0.0027) is None
    assert lines.cross(measure_of(lambda z: np.full(z.shape[1], np.nan)), 0.0027) is None
