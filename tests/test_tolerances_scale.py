"""Monte Carlo at full scale: Sobol points. Devices and processes: `interfaces/test_processes.py`.

Oracles: closed forms and SciPy. The share of seeds whose interval holds the true value may miss 95 % by three standard
errors of that share.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scale_study import STACK, first, response, run, same_to_roundoff, smooth
from scipy import special
from scipy.stats import qmc

from rvjax.population import Population
from rvjax.population.sampling import SCRAMBLES, SobolPoints
from rvjax.response import Evaluator
from rvjax.status import Status
from rvjax.tolerances import Requirement, sample

# Sobol points


def test_sobol_units_are_the_points_of_sixteen_scrambles():
    points = SobolPoints(3, 7)
    whole = points.z(0, 100)
    for scramble in (0, 5, 15):
        rng = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(scramble,)))
        expected = qmc.Sobol(3, scramble=True, bits=32, rng=rng).random(8)
        found = whole[:, scramble::SCRAMBLES][:, :6].T
        np.testing.assert_allclose(special.ndtr(found), expected[:6] + 2.0**-33, rtol=1e-12)
    for start, count in ((37, 50), (0, 1), (99, 1), (16, 16)):  # forwards, backwards, ragged
        np.testing.assert_array_equal(points.z(start, count), whole[:, start : start + count])
    assert np.isfinite(SobolPoints(40, 0).z(10**7, 64)).all()
    assert SobolPoints(0, 0).z(5, 3).shape == (0, 3)


def test_a_sobol_unit_is_the_same_alone_and_in_any_chunk():
    whole = run(5000, method="sobol", keep=True, chunk=65536)
    parts = run(5000, method="sobol", keep=True, chunk=999)
    for name in ("y", "z"):
        np.testing.assert_allclose(parts.values[name], whole.values[name], rtol=1e-12, atol=1e-15)
    compared = 0
    for index in (0, 17, 998, 999, 4999):
        alone = response(sample(STACK, index, seed=3, method="sobol"))
        if alone.status == Status.CONVERGED and jnp.isfinite(alone.value["y"]):
            np.testing.assert_allclose(whole.values["z"][index], alone.value["z"], rtol=1e-12)
            compared += 1
    assert compared > 2
    with pytest.raises(ValueError, match="index: must be a number for method 'sobol'"):
        jax.vmap(lambda i: sample(STACK, i, seed=3, method="sobol")["a"])(jnp.arange(3))
    same_to_roundoff(run(9000, method="sobol"), run(9000, method="sobol", chunk=1234))


@pytest.fixture(scope="module")
def over_seeds(thorough):
    """Figures of 30 or 60 studies of 4096 units by each method, and the true mean."""
    seeds = range(60 if thorough else 30)
    runs = {m: [run(4096, respond=smooth, seed=s, method=m, chunk=4096) for s in seeds] for m in ("random", "sobol")}
    return runs, 0.3 * (2 / 3) ** 2


def test_sobol_points_bring_the_mean_nearer(over_seeds):
    runs, mean = over_seeds
    rms = {m: math.sqrt(np.mean([(s.mean.value - mean) ** 2 for s in found])) for m, found in runs.items()}
    assert rms["random"] > 5 * rms["sobol"]
    assert {s.standard_errors for s in runs["sobol"]} == {"16 independent scrambles"}
    assert runs["random"][0].standard_errors == "independent units"


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_stated_errors_are_honest(over_seeds, method):
    runs, mean = over_seeds
    found = runs[method]
    truth = {"mean": mean, "sd": None, "q": None}
    truth["sd"] = math.sqrt(1 + 2 * 0.09 * (2 / 3) ** 4 + 0.01 / 9)  # of a + 0.3 b^2 - 0.1 a c, sd 1, 2/3, 1/3
    truth["q"] = np.mean([s.quantiles[0.5].value for m in runs.values() for s in m])
    figures = {"mean": [s.mean for s in found], "sd": [s.sd for s in found], "q": [s.quantiles[0.5] for s in found]}
    for name, estimates in figures.items():
        hits = np.mean([e.lower <= truth[name] <= e.upper for e in estimates])
        assert hits >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / len(found)), name
        stated = math.sqrt(np.mean([e.error**2 for e in estimates]))
        seen = math.sqrt(np.mean([(e.value - truth[name]) ** 2 for e in estimates]))
        assert 0.7 < stated / seen < 1.5, name


def test_shares_of_sobol_units_have_honest_intervals():
    true = 0.5 * special.erfc(1.0 / math.sqrt(2))  # of the share of a > 1
    found = [
        run(4096, respond=first, seed=s, chunk=4096, method="sobol", requirements=Requirement(upper=1.0))
        for s in range(30)
    ]
    hits = np.mean([f.yield_.lower <= 1 - true <= f.yield_.upper for f in found])
    assert hits >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / 30)
    assert np.mean([f.yield_.error for f in found]) < 0.5 * math.sqrt(true * (1 - true) / 4096)
    none = run(2000, method="sobol", requirements={"y": Requirement(upper=1e3), "z": Requirement(upper=1e3)})
    assert none.failed > 0 and none.yield_["y"].lower < 1 - none.failed / 2000 < none.yield_["y"].upper


@pytest.mark.parametrize("samples", [1, 5, 16, 17])
def test_fewer_sobol_units_than_scrambles(samples):
    found = run(samples, respond=smooth, method="sobol", requirements=Requirement(upper=0.0))
    assert found.samples == samples and found.yield_.lower <= found.yield_.value <= found.yield_.upper
    assert math.isnan(found.mean.error) == (samples == 1)


@pytest.mark.parametrize("first", [2**32 - 300, 3 * 2**32 - 1000, 10**10])
def test_units_beyond_32_bits_are_others(first):
    """In a chunk across the end of the 32 bits too; each is the one that `sample` gives."""
    study = Evaluator(smooth, Population.of(STACK), 3, "random", 1000, ("y",))
    drawn = study.errors(first)["a"]
    for unit in (0, 299, 300, 999):
        assert sample(STACK, first + unit, seed=3)["a"] == drawn[unit], unit
    assert not np.isin(drawn[300:], study.errors((first + 300) % 2**32)["a"][:700]).any()
