"""Statistics of given values: intervals of quantiles, merged moments, quantiles from a histogram.

Oracles: SciPy's binomial distribution and moments, NumPy's sorted values.
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


def test_tails_beyond_the_histogram_are_counted_apart():
    order = Order()
    order.add(np.random.default_rng(0).uniform(size=4096))
    order.add(np.array([-100.0, 50.0, 60.0]))
    assert order.at(1) == -100.0
    assert order.at(4099) == 60.0
    assert order.at(2050) == pytest.approx(0.5, abs=0.03)
