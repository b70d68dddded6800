"""Statistics of given values: intervals of quantiles, merged moments, quantiles from a histogram.

Oracles: SciPy's binomial distribution and moments, NumPy's sorted values, the interval of values that are all kept.
"""

import dataclasses
import math

import numpy as np
import pytest
from scipy import stats

from rvjax.population.sample_statistics import CentralMoments
from rvjax.tolerances.batch.quantiles import ExactOrder, Order, quantile_estimate


def test_quantile_interval_is_the_binomial_one():
    values = np.random.default_rng(0).normal(size=1000)
    for p in (0.01, 0.5, 0.98):
        found = quantile_estimate(ExactOrder(values), p, 0.9)
        first, last = stats.binom.ppf([0.05, 0.95], 1000, p).astype(int)
        assert (found.lower, found.upper) == (np.sort(values)[first - 1], np.sort(values)[last])
    hits = 0
    for seed in range(400):
        found = quantile_estimate(ExactOrder(np.random.default_rng(seed).exponential(size=300)), 0.9, 0.95)
        hits += found.lower <= math.log(10) <= found.upper
    assert hits / 400 > 0.93


def test_moments_merge_like_one_block():
    values = np.random.default_rng(0).gamma(2.0, size=5000) + 1e3
    merged = CentralMoments()
    for block in np.split(values, [1, 17, 3000, 3000]):
        merged = merged.merge(CentralMoments.of(block))
    whole = CentralMoments.of(values)
    for f in dataclasses.fields(CentralMoments):
        assert getattr(merged, f.name) == pytest.approx(getattr(whole, f.name), rel=1e-9)
    assert whole.s4 / 5000 == pytest.approx(stats.moment(values, 4))
    assert whole.s3 / 5000 == pytest.approx(stats.moment(values, 3))


@pytest.mark.parametrize("size", [1e60, 1e100, 1e150])
def test_powers_that_no_number_holds_end_no_statistic(size):
    """The sixth power of 1e60 is infinite; interval and error are then those of a normal distribution."""
    x = np.random.default_rng(0).standard_normal(4000)
    due, found = (CentralMoments.of(s * x[:9]).merge(CentralMoments.of(s * x[9:])) for s in (1.0, size))
    for one, other in (
        (due.sd_estimate(0.95), found.sd_estimate(0.95)),
        (due.mean_estimate(0.95), found.mean_estimate(0.95)),
    ):
        np.testing.assert_allclose([other.value / size, other.error / size], [one.value, one.error], rtol=0.05)
        np.testing.assert_allclose(
            [other.lower / size, other.upper / size], [one.lower, one.upper], rtol=0.05, atol=1e-3
        )


def test_tails_beyond_the_histogram_are_counted_apart():
    order = Order()
    order.add(np.random.default_rng(0).uniform(size=4096))
    order.add(np.array([-100.0, 50.0, 60.0]))
    assert order.at(1) == -100.0
    assert order.at(4099) == 60.0
    assert order.at(2050) == pytest.approx(0.5, abs=0.03)


def life(normal):
    """Values whose mean does not exist: the median is near 1000, the largest of 4096 near 1e16."""
    return 1e4 * np.abs(2 + normal) ** (-10 / 3)


def clusters(random, n):
    """Three groups of values, each a millionth as wide as its distance from the others."""
    return random.choice([0.0, 1.0, 1e6], n, p=[0.5, 0.3, 0.2]) * (1 + 1e-6 * random.normal(size=n))


LAWS = {
    "normal": lambda random, n: random.normal(size=n),
    "life": lambda random, n: life(random.normal(size=n)),
    "loss": lambda random, n: -life(random.normal(size=n)),
    "life on an offset": lambda random, n: 1e6 + life(random.normal(size=n)),
    "Cauchy": lambda random, n: random.standard_cauchy(n),
    "seven decades": lambda random, n: 10 ** (2.3 * random.normal(size=n)),
    "clusters": clusters,
    "half zeros": lambda random, n: np.maximum(0.0, random.standard_cauchy(n)),
    "whole numbers": lambda random, n: random.integers(0, 8, n).astype(float),
    "narrow": lambda random, n: 1e6 + 1e-9 * random.integers(0, 40, n),
}


@pytest.mark.parametrize("law", LAWS)
def test_an_interval_from_bins_holds_the_one_of_kept_values(law):
    """For any law: no narrower, and wider only by the two bins that its ends are read from.

    An eighth of the distance of neighbours among 4096 values at each end adds a tenth to an interval of 200,000.
    """
    values, order = LAWS[law](np.random.default_rng(0), 200_000), Order()
    for block in np.split(values, 10):
        order.add(block)
    for p in (0.00135, 0.1, 0.5, 0.9, 0.99865):
        exact, found = (quantile_estimate(each, p, 0.95) for each in (ExactOrder(values), order))
        assert found.lower <= exact.lower <= exact.upper <= found.upper
        assert found.lower <= found.value <= found.upper
        body = 2e-6 * np.ptp(np.quantile(values, [0.1, 0.9])) + 8 * np.spacing(abs(exact.value))
        assert found.upper - found.lower <= 1.35 * (exact.upper - exact.lower) + body
        assert abs(found.value - exact.value) <= 0.1 * (exact.upper - exact.lower) + body
        if law in ("life", "seven decades"):  # small values beside large ones
            assert exact.lower / 1.1 <= found.lower <= found.upper <= 1.1 * exact.upper


def test_an_interval_is_no_narrower_than_a_bin():
    """A later value beyond all the first ones: its bin is as wide as the gap, and the interval says so."""
    order, first = Order(), np.random.default_rng(0).normal(size=4096)
    order.add(first)
    order.add(np.full(4096, 1e9))
    for p in (0.6, 0.9):
        found = quantile_estimate(order, p, 0.95)
        assert found.lower <= 1e9 == found.upper and found.error > 0


def test_numbers_at_the_ends_of_the_range_of_floats():
    """Neither overflow nor a warning where differences of values are no numbers any more."""
    random = np.random.default_rng(0)
    huge = np.concatenate([random.choice([-1.7e308, 1.7e308], 5000), random.normal(size=5000) * 1e-300])
    random.shuffle(huge)
    order = Order()
    order.add(huge)
    for p in (0.1, 0.5, 0.9):
        exact, found = (quantile_estimate(each, p, 0.95) for each in (ExactOrder(huge), order))
        assert found.lower <= exact.lower <= exact.upper <= found.upper
        assert math.isfinite(found.value)


@pytest.mark.parametrize("streams", [1, 16])
def test_infinite_values_have_ranks(streams):
    """A tenth of the values is -inf, a third inf: quantiles and intervals are those of kept values, none is NaN."""
    random = np.random.default_rng(0)
    values = random.normal(size=100_000)
    values[random.random(values.size) < 0.1] = -math.inf
    values[random.random(values.size) < 1 / 3] = math.inf
    number = np.arange(values.size) % streams
    order, kept = Order(streams), ExactOrder(values, number, count=streams)
    for block, which in zip(np.split(values, 10), np.split(number, 10)):
        order.add(block, which if streams > 1 else None)
    few = Order()
    few.add(values[:100])
    for p in (0.01, 0.05, 0.3, 0.5, 0.6, 0.7, 0.99):
        exact, found = (quantile_estimate(each, p, 0.95) for each in (kept, order))
        for end in ("value", "lower", "upper"):
            assert getattr(found, end) == pytest.approx(getattr(exact, end), abs=0.01)
        assert math.isnan(found.value) is math.isnan(found.error) is False
    assert quantile_estimate(few, 0.99, 0.95).value == math.inf
    ends = [quantile_estimate(order, p, 0.95) for p in (0.05, 0.9)]
    assert [(e.value, e.lower, e.upper, e.error) for e in ends] == [(v, v, v, 0.0) for v in (-math.inf, math.inf)]
