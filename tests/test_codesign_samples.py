"""Units in the tails: their weights make a standard normal sample; derivatives of their quantiles by differences."""

import numpy as np
import pytest
from scipy import stats

from rvjax.tolerances import MeanWithin
from rvjax.tolerances.optimum.sides import sides
from rvjax.tolerances.optimum.tail_sample import Centres, TailSample, centres_of, kernel, smooth_quantile

TWO = [Centres(np.array([[3.0, 0.0]]), np.array([1.0])), Centres(np.array([[0.0, -2.5]]), np.array([1.0]))]


def test_weighted_units_are_standard_normal():
    """40,000 units about two centres; shares beyond and between them to four standard errors of the weighted units."""
    sample = TailSample(2, 40_000, 1, Centres.joined(TWO))
    z, w = sample.z, sample.weights
    assert w.max() <= 4 + 1e-9  # a quarter of the units is plain
    events = {
        stats.norm.sf(3.2): z[0] > 3.2,
        stats.norm.cdf(-2.8): z[1] < -2.8,
        stats.norm.sf(1.5) ** 2: (z[0] > 1.5) & (z[1] > 1.5),
        1.0: z[0] == z[0],
    }
    for due, inside in events.items():
        error = np.std(w * inside) / np.sqrt(w.size)
        assert np.mean(w * inside) == pytest.approx(due, abs=4 * error)
    assert np.mean(z[0] > 3.2) > 0.1 and np.mean(z[1] < -2.8) > 0.1  # where the decisive units are


def test_a_centre_lies_where_a_margin_is_zero():
    """y = z0 + z1: units at 2.5 and 3.5 along the diagonal, one with three times the weight."""
    along = np.array([[1.0], [1.0]]) / np.sqrt(2)
    z = np.concatenate([2.5 * along, 3.5 * along], axis=1)
    found = centres_of(z, np.ones((2, 2)), np.array([3.0, 1.0]), 1.0)
    np.testing.assert_allclose(found.places, 2.75 * along.T)
    np.testing.assert_allclose(found.shares, [1.0])


def test_a_quantile_of_weighted_units_is_that_of_the_normal_law():
    sample = TailSample(1, 40_000, 2, Centres(np.array([[2.5]]), np.array([1.0])))
    for share in (0.02, 0.005, 0.001):
        found = smooth_quantile(sample.z[0], sample.weights, share, 0.01)
        assert found == pytest.approx(stats.norm.isf(share), abs=0.03)


def test_the_kernel_is_the_derivative_of_the_quantile():
    rng = np.random.default_rng(0)
    margins, weights = rng.standard_normal(40), rng.uniform(0.2, 3.0, 40)
    level = smooth_quantile(margins, weights, 0.2, 0.3)
    found = kernel(margins, weights, level, 0.3)
    for k in range(40):
        step = 1e-5 * np.eye(40)[k]
        ends = (smooth_quantile(margins + way * step, weights, 0.2, 0.3) for way in (1, -1))
        slope = np.subtract(*ends) / 2e-5
        assert found[k] == pytest.approx(slope, abs=2e-3)  # beyond 3.5 widths it is cut off


def test_two_sides_of_a_limit_have_no_corner_and_decide_as_one():
    both = MeanWithin(lower=-1.0, upper=2.0)
    values = np.linspace(-3.0, 4.0, 15)
    rows = [np.array([float(side.margin(v)) for v in values]) for side in sides(both)]
    np.testing.assert_allclose(np.max(rows, axis=0), [float(both.margin(v)) for v in values])
    for side in rows:
        np.testing.assert_allclose(np.diff(side, 2), 0.0, atol=1e-12)
