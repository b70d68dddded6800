"""Slopes of many fields from few units. Oracle: the true slopes from which the parts of units are drawn."""

import numpy as np
import pytest

from rvjax.tolerances.optimum.shrinkage import total_of_many

FIELDS, UNITS, DRAWS = 200, 400, 30


@pytest.fixture(scope="module")
def cases():
    """(sums over the units, parts of units, true sums, variances of the sums) of several samples."""
    rng = np.random.default_rng(3)
    true = UNITS * rng.lognormal(0, 1, FIELDS)
    spread = 10 * np.sqrt(true)  # of a sum; a large slope errs by more, in parts by less
    parts = true / UNITS + rng.standard_normal((DRAWS, UNITS, FIELDS)) * spread / np.sqrt(UNITS)
    return parts, true, spread**2


def loss(found, true, variance):
    """What errors of slopes cost an optimum, to second order: squares in parts of their variances."""
    return float(np.mean([np.mean((one - true) ** 2 / variance) for one in found]))


def test_a_model_that_is_right_takes_most_of_the_noise(cases):
    parts, true, variance = cases
    assert loss(parts.sum(axis=1), true, variance) == pytest.approx(1.0, abs=0.1)
    found = [total_of_many(one, 0.3 * true) for one in parts]  # its factor is fitted
    assert loss(found, true, variance) < 0.05


@pytest.mark.parametrize("wrong", [1.0, 0.1, 1e-3])
def test_a_model_that_is_wrong_does_no_harm(cases, wrong):
    """James and Stein: the loss is below that of the sums alone, whatever the model; and here far below it."""
    parts, true, variance = cases
    model = true * (1 + wrong * np.random.default_rng(1).standard_normal(FIELDS))
    found = [total_of_many(one, model) for one in parts]
    assert loss(found, true, variance) < loss(parts.sum(axis=1), true, variance)


def test_fields_without_scatter_or_without_a_model_keep_their_sums(cases):
    parts, true, _ = cases
    still = np.concatenate([parts[0], np.ones((UNITS, 1))], axis=1)
    assert total_of_many(still, np.append(true, 5.0))[-1] == pytest.approx(UNITS)
    assert np.isfinite(total_of_many(parts[0], np.zeros(FIELDS))).all()
    np.testing.assert_array_equal(total_of_many(np.ones((UNITS, 3)), np.ones(3)), np.full(3, float(UNITS)))
