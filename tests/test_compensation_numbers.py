"""Chances, intervals and loads of a correction: pure noise, the distribution of Rayleigh, sums over drawn zeros."""

import json
import math

import numpy as np
import pytest

from rvjax.compensation import correction, predicted, read, residual, schedule
from rvjax.units import arcsec

RATIO = 121.0


def test_the_interval_of_noise_has_both_tails_of_rayleigh():
    """The rms of one order is |v|/sqrt(2) with a Rayleigh distribution; 20,000 draws know its quantiles to 2 %."""
    found = predicted(correction([3], [0.0], ratio=RATIO, sd=2 * arcsec), draws=20_000, confidence=0.9).rms
    due = [2 * arcsec * math.sqrt(-math.log(1 - share)) for share in (0.05, 0.95)]
    assert (found.lower, found.upper) == pytest.approx(due, rel=0.03)


def test_an_order_that_the_curve_lacks_is_left_by_its_table():
    found = residual(correction([3, 40], [3e-6, 4e-6], ratio=RATIO), [40, 81], [4e-6, 1e-6])
    assert found.order.tolist() == [3, 40, 81]
    np.testing.assert_allclose(found.value, [-3e-6, 0, 1e-6], atol=1e-20)
    assert found.rms == pytest.approx(math.sqrt((9 + 1) / 2) * 1e-6)


TORQUES = {
    (100.0, 1): correction([3, 40], np.array([8, 6j]) * arcsec, ratio=RATIO, angle_sd=0.01),
    (0.0, 1): correction([3, 40], np.array([8j, 5]) * arcsec, ratio=RATIO, angle_sd=0.03, count=1),
    (50.0, 1): correction([3], [2 * arcsec], ratio=RATIO),
}


def test_loads_may_be_given_in_any_order():
    found, sorted_ = schedule(TORQUES), schedule(dict(sorted(TORQUES.items(), key=lambda item: item[0][0])))
    for torque in (-1.0, 25.0, 75.0, 200.0):
        np.testing.assert_array_equal(found.at(torque, 1).stored, sorted_.at(torque, 1).stored)


def test_between_two_loads_a_zero_is_known_as_badly_as_at_the_worse():
    """Both tables' orders are stored; savings are those over drawn zeros, although value and table differ in phase.

    E |v - w exp(i k eps)|^2/2 by 200,000 draws, to 1 %.
    """
    ends = {load: TORQUES[load] for load in ((0.0, 1), (100.0, 1))}
    found = schedule(ends).at(40.0, 1)
    assert found.angle_sd == 0.03 and found.order.tolist() == [3, 40]
    eps = 0.03 * np.random.default_rng(0).standard_normal(200_000)
    for k, order in enumerate((3, 40)):
        value, stored = found.given_value[k], found.stored[k]
        left = np.mean(np.abs(value - stored * np.exp(1j * order * eps)) ** 2) / 2
        assert found.saved[k] == pytest.approx(np.abs(value) ** 2 / 2 - left, abs=0.01 * np.abs(value) ** 2 / 2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"correction": [0.0, 1e-6]}, "3 angles and 2 corrections"),
        ({"correction": [0.0, math.nan, 0.0]}, "a number that is not finite"),
    ],
)
def test_a_file_with_a_cut_or_broken_column_names_it(tmp_path, change, words):
    content = {"unit": "rad", "name": "x", "ratio": 1.0, "orders": [], "error_bound": 0.0}
    path = tmp_path / "t.json"
    path.write_text(json.dumps(content | {"angle": [0.0, 3.0, 6.0], "correction": [0.0, 1e-6, 0.0]} | change))
    with pytest.raises(ValueError, match=words):
        read(path)
