"""Numbers of a posterior against closed forms: normal models, noncentral chi-square, weights of two modes, one step."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from rvjax import identify
from rvjax.tolerances import Requirement, Tolerance
from tests.identify_models import Noise, unit

ONE = {"x": unit(3.0)}


def double(values):
    return jnp.stack([2.0 * values["x"]])


@pytest.fixture(scope="module")
def normal():
    """Measured 1.0 with slope 2 and noise 1: N(0.4, 0.2)."""
    return identify.solve(double, ONE, np.array([1.0]), noise=Noise(1.0), starts=1, draws=64)


def test_a_normal_posterior_weighs_all_draws_alike(normal):
    assert normal.laplace.pareto_k == 0 and normal.laplace.ess == pytest.approx(64, rel=1e-9)


def test_effective_draws_of_unequal_weights():
    """Kish: (sum w)^2/sum w^2; of weights 1 and 3 in equal numbers 16/20 of all, whatever their scale."""
    found = identify.goodness_of_fit.reliability(np.log(np.tile([1.0, 3.0], 50)) + 7, 1)
    assert found.ess == pytest.approx(80.0)


def test_a_requirement_has_two_sides(normal):
    sd = math.sqrt(0.2)
    limits = Requirement(lower=0.4 - 0.3 * sd, upper=0.4 + sd)
    found = identify.predict(normal, lambda values: values["x"], requirement=limits)
    assert found.lower < stats.norm.cdf(1) - stats.norm.cdf(-0.3) < found.upper and found.upper - found.lower < 0.05


def test_two_modes_are_sampled_by_their_weights():
    """A second number of slope 1 prefers one side; 2048 draws of spread 0.9, four standard errors."""
    model = lambda values: jnp.stack([values["x"] ** 2, values["x"]])  # noqa: E731
    found = identify.solve(model, ONE, np.array([1.0, 0.5]), noise=Noise(np.array([0.3, 1.0])), starts=4, draws=64)
    assert len(found.modes) == 2 and 0.6 < found.modes[0].weight < 0.8
    due = sum(mode.weight * mode.value["x"] for mode in found.modes)
    assert identify.predict(found, lambda values: values["x"]).value == pytest.approx(
        due, abs=4 * 0.9 / math.sqrt(2048)
    )


def test_a_batch_returns_the_heavier_of_two_modes():
    model = lambda values: jnp.stack([values["x"] ** 2, values["x"]])  # noqa: E731
    data = np.array([[1.0, 0.5], [1.0, -0.5]])
    found = identify.solve_many(model, ONE, data, noise=Noise(np.array([0.3, 1.0])), starts=6)
    assert found.value["x"][0] > 0.9 and found.value["x"][1] == pytest.approx(-found.value["x"][0], rel=1e-6)


def test_a_process_below_its_mid_point_and_what_is_shared():
    """80 units, mean -0.8 and spread 0.5 of their own, 2 of the bench. Noise 0.1 and spread give the mean its error."""
    model = lambda values: jnp.stack([values["own"] + values["bench"], 100 * values["bench"]])  # noqa: E731
    prior, rng = {"own": unit(3.0), "bench": unit(3.0)}, np.random.default_rng(1)
    own = -0.8 + 0.5 * rng.standard_normal(80)
    data = np.stack([own + 2.0, np.full(80, 200.0)], axis=1) + 0.1 * rng.standard_normal((80, 2))
    found = identify.solve_many(model, prior, data, noise=Noise(0.1), shared="bench").population()
    assert found.mean["own"] == pytest.approx(np.mean(own), abs=0.1)
    assert found.u_mean_sd[0] == pytest.approx(math.sqrt((found.u_sd[0] ** 2 + 0.1**2) / 80), rel=1e-3)
    assert found.cpk["own"] == pytest.approx((found.u_mean[0] + 3) / (3 * found.u_sd[0])) and found.u_mean[0] < -0.6


@pytest.mark.parametrize("count", [20, 40])
def test_few_weights_have_a_shape_near_one_half(count):
    """Quantiles of an exponential (shape 0); the prior counts as ten draws at 0.5."""
    share = (np.arange(count) + 0.5) / count
    found = identify.goodness_of_fit._generalised_pareto(-np.log1p(-share))
    assert found == pytest.approx(5 / (count + 10), abs=0.1)


def test_a_vector_off_centre_breaks_its_limit_by_length():
    """Components N(1.5, 1/2) and N(0.25, 1/2): twice the squared length is noncentral chi-square with two degrees."""
    prior = {"run": Tolerance(0.0, 3.0, distribution="rayleigh", shape=(1, 2))}
    model = lambda values: values["run"].reshape(-1)  # noqa: E731
    found = identify.solve(model, prior, np.array([3.0, 0.5]), noise=Noise(1.0), starts=1, draws=64)
    due = stats.ncx2.sf(2 * 3.0**2, 2, 2 * (1.5**2 + 0.25**2))
    assert found.broken["run[0,0]"] == pytest.approx(due, rel=1e-9)


def test_an_exchange_leaves_the_best_single_measurement():
    """The sum tells most alone, but two single errors tell more together: ln det(1 + J'J)/2."""
    prior = {"a": unit(3.0), "b": unit(3.0)}
    candidates = {
        "sum": lambda v: jnp.stack([3 * (v["a"] + v["b"]) / math.sqrt(2)]),
        "a": lambda v: jnp.stack([2.8 * v["a"]]),
        "b": lambda v: jnp.stack([2.8 * v["b"]]),
    }
    found = identify.rank_measurements(prior, candidates, noise=Noise(1.0), count=2, exhaustive=1)
    assert max(found.gains, key=found.gains.get) == "sum" and set(found.chosen) == {"a", "b"} and not found.proved
    assert found.total == pytest.approx(math.log(1 + 2.8**2))


def test_shared_and_separate_elements_of_a_linear_model_need_one_step():
    """Gauss-Newton is exact there; a second step finds that nothing is left."""
    model = lambda values: jnp.stack([values["a"] + values["b"], values["b"]])  # noqa: E731
    prior, rng = {"a": unit(3.0), "b": unit(3.0)}, np.random.default_rng(0)
    data = 0.3 * rng.standard_normal((5, 2))
    found = identify.solve_many(model, prior, data, noise=Noise(0.5), shared="b")
    assert set(found.status) == {"CONVERGED"} and np.asarray(found.info.steps).max() <= 1
