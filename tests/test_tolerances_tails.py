"""Units in the tails: their weights make a standard normal sample. Quantiles of weighted units, their derivatives."""

import math

import numpy as np
import pytest
from scipy import stats

from rvjax.tolerances.allocation.tails import Centres, TailSample, centres_of, quantile

TWO = [Centres(np.array([[3.0, 0.0]]), np.array([1.0])), Centres(np.array([[0.0, -2.5]]), np.array([1.0]))]


def sampled(numbers, samples, seed, centres=None):
    return TailSample(np.random.default_rng(seed + 100).standard_normal((numbers, samples)), seed, centres)


def test_weighted_units_are_standard_normal():
    """40,000 units about two centres; shares beyond and between them to four standard errors of the weighted units."""
    sample = sampled(2, 40_000, 1, Centres.joined(TWO))
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


def test_without_centres_a_sample_is_the_plain_one():
    z = np.random.default_rng(0).standard_normal((2, 50))
    for centres in (None, Centres(np.zeros((0, 2)), np.zeros(0))):
        sample = TailSample(z, 0, centres)
        assert sample.z is z and (sample.weights == 1).all()


def test_a_centre_lies_where_a_margin_is_zero():
    """y = z0 + z1: units at 2.5 and 3.5 along the diagonal, one with three times the weight."""
    along = np.array([[1.0], [1.0]]) / np.sqrt(2)
    z = np.concatenate([2.5 * along, 3.5 * along], axis=1)
    found = centres_of(z, np.ones((2, 2)), np.array([3.0, 1.0]), 1.0)
    np.testing.assert_allclose(found.places, 2.75 * along.T)
    np.testing.assert_allclose(found.shares, [1.0])
    farther = centres_of(z, np.ones((2, 2)), np.array([3.0, 1.0]), 3.0)
    np.testing.assert_allclose(farther.places, 3.0 * along.T)


def test_both_sides_of_a_limit_have_their_centres():
    """Gradients of opposite directions: two centres, their shares by the weights; a unit without a slope has none."""
    z = np.array([[2.0, -2.4, 0.0], [0.1, 0.0, 0.0]])
    found = centres_of(z, np.array([[1.0, -1.0, 0.0], [0.0, 0.0, 0.0]]), np.array([1.0, 3.0, 5.0]), 0.5)
    order = np.argsort(found.places[:, 0])
    np.testing.assert_allclose(found.places[order], [[-2.4, 0.0], [2.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(found.shares[order], [0.75, 0.25])


def level(margins, rejects, weights=None, near=10_000, way=1.0):
    weights = np.ones(len(margins)) if weights is None else weights
    return quantile(margins, weights, rejects, way, near)


@pytest.mark.parametrize("rejects", [0.1, 0.02, 0.005, 0.001])
@pytest.mark.parametrize("sides", [1, 2])
def test_a_quantile_of_plain_units_is_that_of_the_normal_law(rejects, sides):
    """Also where few units or none lie beyond, and a line over the logarithm of rank extends the tail.

    The error of a quantile is sqrt(p (1 - p)/n)/density; beyond the eighth unit the error of a line grows.
    """
    z = stats.norm.ppf((np.random.default_rng(3).permutation(4000) + 0.5) / 4000)
    margins = z if sides == 1 else np.abs(z)
    due = stats.norm.isf(rejects / sides)
    assert level(margins, rejects).level == pytest.approx(due, rel=0.02)
    known = max(rejects, 8 / 500)
    at = stats.norm.isf(known / sides)
    off = math.sqrt(known / 500) / (sides * stats.norm.pdf(at)) * (1 + math.log(known / rejects))
    for seed in range(5):
        few = np.random.default_rng(seed).standard_normal(500)
        assert level(few if sides == 1 else np.abs(few), rejects).level == pytest.approx(due, abs=4 * off)


@pytest.mark.parametrize("rejects", [0.01, 0.0027])
def test_a_quantile_of_heavy_tails(rejects):
    """A lognormal law and an exponential one, as forces of pins and lives are; 16,384 units without noise."""
    shares = (np.arange(16_384) + 0.5) / 16_384
    for law in (stats.lognorm(0.5), stats.expon(), stats.uniform()):
        found = level(law.ppf(shares), rejects)
        assert found.level == pytest.approx(law.isf(rejects), rel=0.01)
        assert found.weights.sum() == pytest.approx(1.0)


def test_a_quantile_of_weighted_units_is_that_of_the_normal_law():
    sample = sampled(1, 40_000, 2, Centres(np.array([[2.5]]), np.array([1.0])))
    for share in (0.02, 0.005, 0.001):
        found = level(sample.z[0], share, sample.weights)
        assert found.level == pytest.approx(stats.norm.isf(share), abs=0.02)


def test_weights_are_the_derivative_of_a_quantile():
    """Units that stay in their order: the level is the sum of their margins with these weights."""
    rng = np.random.default_rng(0)
    margins, weights = np.sort(rng.standard_normal(41))[rng.permutation(41)], rng.uniform(0.2, 3.0, 41)
    found = level(margins, 0.1, weights, near=20)
    assert found.weights.sum() == pytest.approx(1.0) and len(found.units) <= 20
    assert found.level == pytest.approx(found.weights @ margins[found.units])
    for k in range(41):
        step = 1e-7 * np.eye(41)[k]
        ends = (level(margins + way * step, 0.1, weights, near=20).level for way in (1, -1))
        slope = np.subtract(*ends) / 2e-7
        assert float(found.weights[found.units == k].sum()) == pytest.approx(slope, abs=1e-6)


def test_failed_units_are_rejects_of_a_quantile():
    """5 % may be rejects. With 2 % failed, 3 % of all units lie beyond; with 5 % failed no limit is left."""
    margins = np.arange(1000) / 1000.0
    assert level(margins, 0.05).level == pytest.approx(0.9495, abs=0.01)
    margins[:20] = np.inf  # the best of them
    found = level(margins, 0.05)
    assert found.level == pytest.approx(0.9695, abs=0.01) and (found.units >= 20).all()
    margins[:50] = np.inf
    found = level(margins, 0.05)
    assert found.level == np.inf and not len(found.units)


def test_units_infinitely_far_inside_count_as_the_way():
    """An infinite life is no margin to search by: it counts as one that lies `way` inside."""
    lives = np.r_[np.full(60, -np.inf), np.linspace(-0.5, 0.5, 40)]
    far = level(np.r_[np.full(990, -np.inf), np.linspace(-0.5, 0.5, 10)], 0.5, way=2.0)
    assert far.level == pytest.approx(-2.0, abs=1e-6) and not far.weights.any()
    found = level(lives, 0.1, way=2.0)
    assert found.level == pytest.approx(0.25, abs=0.1) and (found.units >= 60).all()
    nothing = level(np.full(50, -np.inf), 0.1)
    assert nothing.level == -np.inf and not len(nothing.units)
