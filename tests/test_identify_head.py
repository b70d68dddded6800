"""One head from the six numbers of a reading: closed forms, another optimiser, several heads, coverage."""

import dataclasses

import numpy as np
import pytest
from scipy import optimize

from rvjax import identify
from rvjax.commands.identify.words import CONSISTENT, head_lines, head_of, one_head
from rvjax.study.identification import WIDE, nuisance
from rvjax.units import arcsec

GAINS, PERIODS = np.array([4.0, 2.0, -1.0]), np.array([2, 1, 3])
DRAWN = np.random.default_rng(4)
MIXED = 0.1 * DRAWN.normal(size=(6, 6))
COVARIANCE = MIXED @ MIXED.T


def numbers(angle, gains=GAINS):
    waves = np.asarray(gains) * np.exp(1j * PERIODS * angle)
    return np.stack([waves.real, waves.imag], axis=1).ravel()


def test_a_head_is_found_and_turns_with_its_numbers():
    """Exact numbers return the head; the interval of a small covariance is that of first order: 1.96 / sum (m g)^2."""
    for angle in (0.3, 2.9, 5.0):
        found = one_head(numbers(angle), 1e-4 * np.eye(6), 1000.0)
        assert found.angle[0] == pytest.approx(angle, abs=1e-6) and found.p > 0.999
        half = 1.96 * 0.01 / np.sqrt(np.sum((PERIODS * GAINS) ** 2))
        assert found.angle[0] - found.angle[1] == pytest.approx(half, rel=0.01)
        assert [g for g, *_ in found.amplitudes.values()] == pytest.approx(GAINS.tolist(), abs=1e-5)
        low, high = np.array(list(found.amplitudes.values()))[:, 1:].T
        np.testing.assert_allclose(high - low, 2 * 1.96 * 0.01, rtol=1e-3)


def test_another_optimiser_finds_no_better_head():
    """Least squares over direction and gains from many starts; numbers of no head at all."""
    seen, white = np.array([3.0, 1.0, 1.0, 2.0, -2.0, 0.5]), np.linalg.inv(np.linalg.cholesky(COVARIANCE))
    found = one_head(seen, COVARIANCE, 1000.0)
    chosen = numbers(found.angle[0], [g for g, *_ in found.amplitudes.values()])
    away = lambda x: white @ (seen - numbers(x[0], x[1:]))  # noqa: E731
    starts = [np.array([angle, *GAINS]) for angle in np.linspace(0, 2 * np.pi, 12)]
    best = [optimize.least_squares(away, start, bounds=([-10, 0, -50, -50], [10, 50, 50, 50])) for start in starts]
    assert np.sum((white @ (seen - chosen)) ** 2) == pytest.approx(2 * min(x.cost for x in best), rel=1e-6)


def test_several_heads():
    """Two heads are one in their middle, with gains times cos(m d / 2) at a distance d; three are not."""
    two = one_head((numbers(0.4) + numbers(1.0)) / 2, 0.01 * np.eye(6), 1000.0)
    assert two.angle[0] == pytest.approx(0.7, abs=1e-6) and two.p > 0.999
    assert [g for g, *_ in two.amplitudes.values()] == pytest.approx((GAINS * np.cos(0.3 * PERIODS)).tolist(), abs=1e-5)
    three = one_head(sum(numbers(angle) for angle in (0.4, 1.0, 2.7)) / 3, 0.01 * np.eye(6), 1000.0)
    assert three.p < CONSISTENT and "No single head" in head_lines(three)[-1]


def test_what_the_data_do_not_see_is_left_out():
    """Ring alone: the direction, without a check; a dent alone repeats after 60 deg: no direction; nothing: no head."""
    unseen = np.diag(np.where(np.arange(6) < 2, 0.01, 1e6))
    ring = one_head(numbers(0.7), unseen, 1000.0)
    assert list(ring.amplitudes) == ["ring"] and np.isnan(ring.p) and ring.angle[0] == pytest.approx(0.7, abs=1e-6)
    dent = one_head(numbers(0.7), unseen[::-1, ::-1], 1000.0)
    assert list(dent.amplitudes) == ["dent"] and np.isnan(dent.angle).all()
    assert "not determined" in head_lines(dent)[0]
    assert one_head(numbers(0.7), 1e6 * np.eye(6), 1000.0) is None


def test_intervals_cover_and_p_is_uniform():
    """60 noisy heads: their direction is in 95 % of the intervals; binomial limits of one in a thousand."""
    lower, inside, chances = np.linalg.cholesky(COVARIANCE), 0, []
    for angle in DRAWN.uniform(0, 2 * np.pi, 60):
        found = one_head(numbers(angle) + lower @ DRAWN.normal(size=6), COVARIANCE, 1000.0)
        off = (angle - found.angle[0] + np.pi) % (2 * np.pi) - np.pi + found.angle[0]
        inside += found.angle[1] <= off <= found.angle[2]
        chances.append(found.p)
    assert inside >= 50 and 0.3 < np.mean(chances) < 0.7


def test_the_posterior_of_a_reading_gives_its_head():
    """A linear curve of the six numbers with known noise: the covariance is that of the noise."""
    prior = {"reading": nuisance("reading", (3, 39, 78))}
    data = {"order": numbers(0.7, GAINS * arcsec)}
    found = identify.solve(
        lambda x: {"order": x["reading"]}, prior, data, noise=identify.Noise(0.1 * arcsec), nuisance="reading", starts=1
    )
    head = head_of(found)
    direct = one_head(data["order"], (0.1 * arcsec) ** 2 * np.eye(6), WIDE / 3)
    assert head.angle == pytest.approx(direct.angle, abs=1e-5)
    assert head.amplitudes["tilt"] == pytest.approx(direct.amplitudes["tilt"], rel=1e-4)
    assert head_of(dataclasses.replace(found, names=("offset",))) is None
