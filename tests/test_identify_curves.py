"""`rvjax.identify` on curves: orders, what to measure next, a measured reducer and a computed one."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import identify
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec
from tests.identify_models import Noise, unit


def test_orders_of_an_uneven_curve():
    rng = np.random.default_rng(4)
    angle = np.sort(rng.uniform(0, 4 * np.pi, 200))
    curve = 0.3 + np.real((2 - 1j) * np.exp(40j * angle)) + 0.02 * angle
    found = identify.orders(angle, curve, [40, 39], drift=True)
    assert found.value[0] == pytest.approx(2 - 1j, rel=1e-10) and abs(found.value[1]) < 1e-10
    assert found.residual_sd < 1e-12
    with pytest.raises(ValueError, match="samples cannot determine"):
        identify.orders(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.ones(40), [3, 37])  # aliases
    with pytest.raises(ValueError, match="samples cannot determine"):
        identify.orders(angle[:5], curve[:5], [1, 2])
    for bad in ([0], [1, 1], [-2], [np.inf]):
        with pytest.raises(ValueError, match="orders"):
            identify.orders(angle, curve, bad)


def test_ranking_beats_the_greedy_choice_with_a_nuisance():
    """One torque cannot tell an offset from the error it hides; two opposed ones cancel it."""
    offset = lambda slope: lambda v: jnp.stack([v["offset"] + slope * v["a"]])  # noqa: E731
    prior = {"a": unit(3.0), "b": unit(3.0), "offset": unit(3e4)}
    candidates = {
        "up": offset(20.0),
        "down": offset(-20.0),
        "b": lambda v: jnp.stack([3.0 * v["b"]]),
        "rough b": lambda v: jnp.stack([2.0 * v["b"]]),
    }
    asked = dict(noise=Noise(1.0), nuisance="offset", count=2)
    best = identify.rank_measurements(prior, candidates, **asked)
    assert set(best.chosen) == {"up", "down"} and best.proved
    # (up - down)/2 has noise sqrt(1/2) and slope 20.
    assert best.total == pytest.approx(math.log1p(800) / 2, rel=1e-6)
    assert best.gains["up"] == pytest.approx(0, abs=1e-4) and best.gains["b"] == pytest.approx(math.log(10) / 2)
    greedy = identify.rank_measurements(prior, candidates, exhaustive=1, **asked)
    assert not greedy.proved and greedy.total <= best.total
    cheap = identify.rank_measurements(
        prior, candidates, noise=Noise(1.0), nuisance="offset", costs={"up": 1, "down": 1, "b": 5, "rough b": 1}
    )
    assert cheap.chosen == ("rough b",)
    budget = identify.rank_measurements(
        prior,
        candidates,
        noise=Noise(1.0),
        nuisance="offset",
        count=3.5,
        costs={"up": 1, "down": 1, "b": 5, "rough b": 1},
    )
    assert set(budget.chosen) == {"up", "down", "rough b"}
    data = np.array([0.3])
    given = identify.solve(candidates["up"], prior, data, noise=Noise(1.0), nuisance="offset", starts=1, draws=64)
    after = identify.rank_measurements(prior, candidates, noise=Noise(1.0), nuisance="offset", given=given)
    assert after.chosen == ("down",) and after.total == pytest.approx(best.total, rel=1e-4)


@pytest.mark.long  # test_end_of_line.py predicts half of a measured reducer too
def test_a_torque_angle_row_predicts_its_other_half():
    """Half of the mean of backward less forward TE, 100 rpm, 25 C (XiLab-Robotics/Physics-Informed-Neural-Networks).

    Least squares without a prior on every second point miss the rest by 0.0571 arcmin at most; the prior costs little.
    """
    torque = np.array([0, 100, 200, 300, 400, 500, 700, 900, 1000, 1200, 1300, 1400.0])
    angle = np.array([0.182, 0.599, 0.879, 1.132, 1.368, 1.513, 1.990, 2.436, 2.688, 3.143, 3.371, 3.560])

    def row(values):
        bent = 1 - jnp.exp(-jnp.asarray(torque) / values["bend"])
        return values["start"] + values["slope"] * jnp.asarray(torque) + values["step"] * bent

    prior = {
        "start": Tolerance(0.0, 0.6),
        "slope": Tolerance(0.0, 5e-3),
        "step": Tolerance(0.0, 2.0),
        "bend": Tolerance(10.0, 1000.0, distribution="lognormal", log_sd=1.0),
    }
    odd = np.arange(12) % 2 == 1
    found = identify.solve(row, prior, np.where(odd, np.nan, angle), noise=Noise(0.02))
    assert found.adequate and np.abs(found.prediction - angle)[odd].max() < 0.06


@pytest.mark.long  # test_cli_identify.py finds the same combination
def test_rv40e_shows_one_combination_of_its_cranks():
    """lambda = 4 (sigma/(4R))^2/noise^2 of e00 - e01 - e10 + e11, beside the offset of the mounting."""
    design, sigma, noise = rvjax.catalogue.RV_40E, 7e-6 / 3, 1.0 * arcsec
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)

    def curve(values):
        errors = rvjax.RVErrors.for_design(design, crank_eccentricity=values["ecc"])
        solve = partial(rvjax.four_bar.transmission_error, design, errors, closure="first_order")
        error = jax.vmap(lambda angle: solve(crank_angle=angle).error)(jnp.asarray(angles))
        first = 2 * jnp.mean(error.astype(complex) * jnp.asarray(np.exp(-1j * angles)))
        return {"mean": values["offset"] + jnp.mean(error), "first": first}

    prior = {"ecc": unit(7e-6, shape=(2, 2)), "offset": unit(3000 * arcsec)}
    found = identify.identifiability(curve, prior, noise=Noise(noise), nuisance="offset")
    offset, cranks = found.directions
    assert offset.loadings["offset"] == pytest.approx(1.0)
    ratio = sigma / (4 * design.cranks.circle_radius) / noise
    assert cranks.information == pytest.approx(4 * ratio**2, rel=0.01)
    loadings = [cranks.loadings[f"ecc[{d},{c}]"] for d in range(2) for c in range(2)]
    assert np.abs(loadings) == pytest.approx(0.5, rel=0.01) and np.sign(loadings) @ [1, -1, -1, 1] in (-4, 4)
    assert set(found.verdict.values()) == {"identified", "combination"}
