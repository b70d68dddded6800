"""`rvjax.identify`: closed forms and verdicts of one unit."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from rvjax import identify
from rvjax.identify.elements import Elements, values_of
from rvjax.identify.identification import Problem, slopes
from rvjax.identify.posterior import contributions
from rvjax.population.population import Population
from rvjax.tolerances import Requirement, Tolerance
from tests.identify_models import THREE, G, Noise, line, solved, unit


def test_errors_with_equal_slopes_are_identified_by_their_sum_only():
    """lambda = 2 g'g, correlation -g'g/(1 + g'g), the sum known to 1/sqrt(1 + lambda)."""
    found = solved(np.array([1.0, 0.4, 0.3, -0.6]))
    square = (G[:, 0] @ G[:, 0]) / 0.5**2
    assert found.verdict == {"a": "combination", "b": "combination", "c": "unseen"}
    ((first, second, correlation),) = found.inseparable
    assert {first, second} == {"a", "b"} and correlation == pytest.approx(-square / (1 + square), rel=1e-12)
    (direction,) = found.directions
    assert direction.information == pytest.approx(2 * square, rel=1e-12)
    assert direction.loadings == pytest.approx({"a": math.sqrt(0.5), "b": math.sqrt(0.5), "c": 0}, abs=1e-12)
    sum_variance = found.u_covariance[:2, :2].sum()
    assert sum_variance == pytest.approx(2 / (1 + 2 * square), rel=1e-10)
    assert found.resolution["c"] == pytest.approx(0, abs=1e-15) and found.value["c"] == 0
    assert found.information == pytest.approx(math.log1p(2 * square) / 2)
    checked = identify.identifiability(line, THREE, noise=Noise(0.5))
    assert checked.verdict == found.verdict and checked.information == pytest.approx(found.information)
    np.testing.assert_allclose(checked.u_sd, found.u_sd, rtol=1e-12)


def test_prior_numbers_are_those_of_a_population():
    """d(M z) with batches, vectors, constants and correlation equals what a population draws."""
    fields = {
        "bore": unit(2.0, shape=(2, 2), batch=0.3),
        "run": Tolerance(0.0, 3.0, distribution="rayleigh", shape=(3, 2), batch=0.4),
        "play": Tolerance(1.0, 2.0, distribution="uniform"),
        "fixed": 0.7,
        "nested": {"pin": unit(1.0), "none": None},
    }
    for correlation in (None, {("bore[0,1]", "play"): 0.5}):
        elements = Elements.of(fields, correlation)
        population = Population.of(fields, correlation)
        z = np.random.default_rng(0).standard_normal(population.numbers)
        assert np.linalg.norm(elements.mixing, axis=1) == pytest.approx(1.0)
        expected = population.errors(jnp.asarray(z))
        found = values_of(elements.population, jnp.asarray(elements.mixing @ z))
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12), found, expected)
    assert elements.names[:2] == ("bore[0,0]", "bore[0,1]") and "nested.pin" in elements.names


def test_wide_nuisance_keeps_the_digits_of_the_rest():
    """lambda 1e12 for the offset: the other sds to 1e-10 of a closed form where the offset is removed exactly."""

    def model(values):
        return values["offset"] + jnp.asarray(SLOPES) * values["x"]

    SLOPES, noise = np.array([1.0, -0.5, 0.25, 2.0, -1.0]), 1e-2
    prior = {"offset": unit(3 * noise * 1e6 / math.sqrt(5)), "x": unit(3.0)}
    y = 0.7 * SLOPES + 3.0
    found = identify.solve(model, prior, y, noise=Noise(noise), nuisance="offset", starts=2, draws=128)
    assert found.directions[0].information == pytest.approx(1e12, rel=1e-3)
    # Dense form in exact proportions: eliminate the offset by hand (Schur complement).
    scale = noise * 1e6 / math.sqrt(5)
    a, b, c = 5 / noise**2 + scale**-2, SLOPES.sum() / noise**2, SLOPES @ SLOPES / noise**2 + 1
    assert found.u_sd[1] == pytest.approx(1 / math.sqrt(c - b * b / a), rel=1e-10)
    mean = (SLOPES @ y - b * y.sum() / a) / noise**2 / (c - b * b / a)
    assert found.value["x"] == pytest.approx(mean, rel=1e-10)
    assert found.fit.dof_model + found.fit.dof_prior == 4  # one component less: what the offset can do judges nothing
    shifted = identify.solve(model, prior, y + 5.0, noise=Noise(noise), nuisance="offset", starts=2, draws=128)
    assert shifted.fit.p_total == pytest.approx(found.fit.p_total, rel=1e-6) and found.fit.p_total > 0.5


def test_saddle_between_two_modes_is_left():
    """At the middle of a0 x^2 all slopes vanish: a stationary point that is no mode."""
    found = identify.solve(square, {"x": unit(3.0)}, np.array([1.0]), noise=Noise(0.3), starts=1)
    assert [mode.weight for mode in found.modes] == pytest.approx([0.5, 0.5], abs=1e-6)
    assert found.status == "MULTIMODAL" and not found.laplace.trusted and found.info.status == 0
    # d/dx of x^2/2 + (x^2 - 1)^2/(2 0.09): x^2 = 1 - 0.09/2
    assert sorted(mode.value["x"] for mode in found.modes) == pytest.approx([-math.sqrt(0.955), math.sqrt(0.955)])
    alone = identify.solve_many(square, {"x": unit(3.0)}, np.ones((1, 1)), noise=Noise(0.3), starts=4)
    assert alone.status[0] == "MULTIMODAL" and abs(alone.value["x"][0]) == pytest.approx(math.sqrt(0.955))
    # Both modes count: the response x is spread over them, its square is not.
    both = identify.predict(found, lambda values: {"x": values["x"], "square": values["x"] ** 2})
    assert both["x"].lower < -0.7 < 0.7 < both["x"].upper and both["square"].error < 0.4
    kept = identify.predict(found, lambda values: values["x"], requirement=Requirement(lower=0.0))
    assert kept.lower < 0.5 < kept.upper and kept.upper - kept.lower < 0.06


def square(values):
    """Slope 0 in the middle."""
    return jnp.stack([values["x"] ** 2])


def test_steps_that_go_too_far_are_damped():
    """A residual of 2 sd on a model that bends: the true curvature is five times that of Gauss and Newton."""
    found = identify.solve(bent, {"x": unit(3.0)}, np.array([-2.0]), noise=Noise(1.0), starts=1, draws=64)
    phi = lambda x: x**2 / 2 + (0.3 * x + x**2 + 2.0) ** 2 / 2  # noqa: E731
    exact = optimize.minimize_scalar(phi, bounds=(-1, 1), method="bounded", options={"xatol": 1e-12}).x
    assert found.info.status == 0
    assert found.u[0] == pytest.approx(exact, abs=1e-7)  # the oracle sees phi to 1e-16, its place to the root of that


def bent(values):
    """Slope 0.3 in the middle, and a bend."""
    return jnp.stack([0.3 * values["x"] + values["x"] ** 2])


def test_one_number_measured():
    found = solved(np.array([np.nan, np.nan, 0.6, np.nan]))
    assert found.status == "CONVERGED" and found.fit.dof_prior + found.fit.dof_model == 1
    # u = g y/(sd^2 + 2 g^2) for each of the two
    assert found.u[:2] == pytest.approx(0.5 * 0.6 / (0.25 + 2 * 0.25))
    assert np.isnan(found.residual[[0, 1, 3]]).all() and np.isfinite(found.prediction).all()
    assert list(found.fit.weights) == [0, 0, 1, 0]


def test_more_elements_than_numbers_takes_the_cheaper_derivative():
    """p = 200, m = 1: a single cotangent; lambda = |g|^2/sd^2 and the prior elsewhere."""
    seen = []

    def model(values):
        return jnp.stack([jnp.sum(watched(values["x"]) * 0.5)])

    @jax.custom_vjp
    def watched(x):
        return x

    watched.defvjp(lambda x: (x, seen.append("reverse")), lambda _, g: (g,))
    found = identify.identifiability(model, {"x": unit(3.0, shape=(200,))}, noise=Noise(0.5))
    assert found.directions[0].information == pytest.approx(200) and len(found.directions) == 1 and seen
    assert set(found.verdict.values()) == {"unseen"}  # each has loading^2 = 1/200
    _, jacobian = slopes(lambda u: jnp.tile(watched(u)[:1] * 2, 3), jnp.ones(1), 3)
    np.testing.assert_allclose(jacobian, [[2.0]] * 3)  # tangents would be cheaper, but the model has none


def test_nearly_equal_parts():
    """A prior correlation of 0.999: two parts of one set-up are known together from one of them."""
    prior = {"a": unit(3.0), "b": unit(3.0), "c": unit(3.0)}
    found = solved(np.array([1.0, 0.4, 0.3, -0.6]), prior, correlation={("a", "c"): 0.999})
    square, rho = (G[:, 0] @ G[:, 0]) / 0.25, 0.999
    covariance = np.array([[1, 0, rho], [0, 1, 0], [rho, 0, 1]])
    g = np.array([1.0, 1.0, 0.0])
    dense = covariance - np.outer(covariance @ g, covariance @ g) * square / (1 + square * (g @ covariance @ g))
    np.testing.assert_allclose(found.u_covariance, dense, rtol=1e-9, atol=1e-12)
    assert found.verdict["c"] == found.verdict["a"]


def test_limits_through_the_law():
    """Normal: both tails about the posterior. A bounded law never leaves its own limits, but may leave others."""
    found = solved(np.array([4.0, 2.0, 1.0, -2.0]), limits={"a": unit(1.0), "b": unit(3.0), "c": unit(2.0)})
    tail = lambda x: 0.5 * math.erfc(x / math.sqrt(2))  # noqa: E731
    mean, sd = found.u[0], found.u_sd[0]
    assert found.broken["a"] == pytest.approx(tail((1 - mean) / sd) + tail((1 + mean) / sd), rel=1e-9)
    assert found.broken["c"] == pytest.approx(2 * tail(2.0), rel=1e-9)
    uniform = {name: Tolerance(-3.0, 3.0, distribution="uniform") for name in "abc"}
    own = solved(np.array([4.0, 2.0, 1.0, -2.0]), uniform)
    assert set(own.broken.values()) == {0.0}
    wider = solved(np.array([4.0, 2.0, 1.0, -2.0]), uniform, limits={name: unit(1.5) for name in "abc"})
    assert wider.broken["c"] == pytest.approx(0.5)
    for name in "abc":
        assert -3 < own.lower[name] < own.value[name] < own.upper[name] < 3


def test_vectors_break_their_limit_by_length():
    def model(values):
        return values["run"].reshape(-1)

    prior = {"run": Tolerance(0.0, 3.0, distribution="rayleigh", shape=(1, 2))}
    found = identify.solve(model, prior, np.array([0.0, 0.0]), noise=Noise(1e3), starts=1, draws=64)
    # Nothing learned, but for a share of 5e-7: the length is Rayleigh with scale 1, beyond 3 with exp(-9/2).
    assert found.broken["run[0,0]"] == found.broken["run[0,1]"] == pytest.approx(math.exp(-4.5), rel=1e-5)


def test_shares_sum_to_one_and_follow_the_curve():
    """f = a + b c along (t a, t b, t c): c_a = a, c_b = c_c = b c/2."""

    def model(values):
        return {"te": jnp.stack([values["a"] + values["b"] * values["c"]]), "loop": jnp.stack([-values["c"]])}

    prior = {"a": unit(3.0), "b": Tolerance(1.0, 3.0), "c": unit(3.0)}
    found = identify.solve(model, prior, {"te": [2.0], "loop": [-1.0]}, noise=Noise({"te": 0.01, "loop": 0.01}))
    a, b, c = (found.value[name] for name in "abc")
    whole = a + b * c
    assert found.shares["te"] == pytest.approx({"a": a / whole, "b": b * c / 2 / whole, "c": b * c / 2 / whole})
    assert found.shares["loop"] == pytest.approx({"a": 0, "b": 0, "c": 1}, abs=1e-12)


def test_shares_weigh_each_measurement_by_its_noise():
    """f = (a, b): the share of a is a^2/s_a^2 over both. A reading ten times as noisy explains a hundredth."""
    sd = np.array([0.01, 0.1])
    model = lambda values: {"te": jnp.stack([values["a"], values["b"]])}  # noqa: E731
    prior = {"a": unit(3.0), "b": unit(3.0)}
    found = identify.solve(model, prior, {"te": [1.0, 2.0]}, noise=Noise({"te": sd}), draws=128)
    a, b = (found.value[name] / s for name, s in zip("ab", sd))
    assert found.shares["te"] == pytest.approx({"a": a**2 / (a**2 + b**2), "b": b**2 / (a**2 + b**2)})


def test_contributions_sum_to_the_whole_observation():
    """f(e) - f(0) of a polynomial of degree 3, which eight nodes integrate exactly."""
    model = lambda values: jnp.stack([values["a"] * values["b"] ** 2 + values["c"], values["c"] ** 3])  # noqa: E731
    values = {"a": 0.7, "b": -1.3, "c": 2.0}
    found = contributions(Problem.of(model, THREE, noise=Noise(1.0)), np.array(list(values.values())))
    np.testing.assert_allclose(found.sum(axis=1), model(values), rtol=1e-10)
    np.testing.assert_allclose(found[1], [0.0, 0.0, 8.0], atol=1e-10)


def test_complex_observations_count_twice():
    def model(values):
        return {"te": values["a"].astype(complex) * jnp.asarray(np.exp(1j * np.array([0.3, 1.2]))), "b": values["b"]}

    data = {"te": 0.5 * np.exp(1j * np.array([0.3, 1.2])), "b": 0.1}
    found = identify.solve(model, {"a": unit(3.0), "b": unit(3.0)}, data, noise=Noise({"te": [0.1, 0.2], "b": 1.0}))
    assert found.u_sd[0] == pytest.approx(1 / math.sqrt(1 + 1 / 0.1**2 + 1 / 0.2**2))
    assert found.prediction["te"].dtype == complex and found.residual["b"].shape == ()
    assert len(found.fit.weights) == 5 and set(found.fit.worst) <= {
        "te[0].real",
        "te[0].imag",
        "te[1].real",
        "te[1].imag",
        "b",
    }
