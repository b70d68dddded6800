"""`rvjax.identify`: closed forms, verdicts, extremes and bad input."""

import json
import math
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from benchmarks import identify_coverage
from rvjax import identify
from rvjax.identify.elements import Elements
from rvjax.identify.laplace import pareto_shape
from rvjax.identify.problem import slopes
from rvjax.identify.sampler import diagnosed
from rvjax.tolerances import Requirement, Tolerance
from rvjax.tolerances.population.population import Population
from rvjax.units import arcsec

Noise, unit = identify.Noise, Tolerance.symmetric
THREE = {"a": unit(3.0), "b": unit(3.0), "c": unit(3.0)}
"""Three errors of spread 1."""

G = np.array([[2.0, 2.0, 0.0], [1.0, 1.0, 0.0], [0.5, 0.5, 0.0], [-1.0, -1.0, 0.0]])
"""Slopes of which the first two are equal and the third vanishes."""


def line(values):
    """Four rows, linear."""
    return jnp.asarray(G) @ jnp.stack([values["a"], values["b"], values["c"]])


def solved(data, prior=THREE, **options):
    """A unit of the linear model; few draws, for the same program serves every test."""
    return identify.solve(line, prior, data, **(dict(noise=Noise(0.5), starts=2, draws=128) | options))


def test_equal_slopes_show_their_sum_alone():
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


def test_second_call_compiles_nothing(compiled):
    """Every door, with other numbers of the same shapes, and with values missing."""
    noise = Noise(np.full(4, 0.5))
    prior = {name: unit(3.0) for name in "abc"}

    def call(scale, data):
        other = {name: unit(3.0 * scale) for name in "abc"}
        found = identify.solve(line, other, data, noise=Noise(0.5 * scale), starts=2, draws=128)
        identify.identifiability(line, other, noise=noise, at={"a": 0.1, "b": scale - 1, "c": 0.0})
        batch = identify.solve_many(line, other, np.stack([data, data]), noise=noise)
        joint = identify.solve_many(line, other, np.stack([data, data]), noise=noise, shared="a")
        identify.predict(found, total, draws=64)
        identify.rank_measurements(prior, {"line": line}, noise=noise, given=found)
        batch.population(), joint.population()

    def total(values):
        return values["a"] + values["b"]

    call(1.0, np.array([1.0, 0.4, 0.3, -0.6]))
    compiled.clear()
    call(1.1, np.array([0.5, np.nan, 0.2, -0.1]))
    assert not [event for event in compiled if "compile" in event or "trace" in event]


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
        from rvjax.identify.elements import mapped

        found = jax.tree.map(
            lambda leaf: leaf[0], mapped(elements.population, jnp.asarray(elements.mixing @ z)[None])[1]
        )
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


def test_status_names_the_first_that_holds():
    off = solved(np.array([40.0, -40.0, 0.0, 0.0]))  # 80 sigma that no part can do
    assert off.status == "REJECTED" and off.fit.p_model < 1e-12 and off.fit.worst[0] in ("data[0]", "data[1]")
    assert np.isfinite(off.u).all() and np.isfinite(off.fit.p_prior) and not off.adequate
    assert rvjax.check(off) is off  # the solver itself went well
    far = solved(20.0 * np.sqrt(2) * G[:, 0])  # parts 20 spreads away
    assert far.status == "CONVERGED" and far.fit.p_prior < 1e-12 and far.fit.p_model > 0.5
    short = solved(20.0 * np.sqrt(2) * G[:, 0], max_steps=2)
    assert short.status == "MAX_STEPS" and math.isnan(short.value["a"]) and math.isnan(short.fit.p_model)
    with pytest.raises(rvjax.SolveError, match="MAX_STEPS"):
        rvjax.check(short)


def test_a_unit_that_fails_inside_the_model_disturbs_no_other():
    def model(values):
        return jnp.stack([jnp.log(values["x"] + 2.0), values["x"]])  # no logarithm below -2

    prior, noise = {"x": unit(3.0)}, Noise(0.1)
    good = np.array([[np.log(2.5), 0.5], [np.log(1.0), -1.0], [np.nan, 0.4]])
    batch = identify.solve_many(model, prior, good, noise=noise)
    assert set(batch.status) == {"CONVERGED"} and (np.abs(batch.value["x"] - [0.5, -1.0, 0.4]) < 0.05).all()

    def broken(values):
        return jnp.where(values["x"] < 100.0, jnp.nan, 1.0) * jnp.ones(2)

    none = identify.solve(broken, prior, good[0], noise=noise)
    assert none.status == "NONFINITE" and math.isnan(none.value["x"]) and none.modes == () and none.broken["x"] != 0
    with pytest.raises(rvjax.SolveError, match="NONFINITE"):
        rvjax.check(none)
    with pytest.raises(ValueError, match=r"model: .* not finite"):
        identify.identifiability(broken, prior, noise=noise)

    def sometimes(values):  # a unit is told by its own data: those that measured row 0 fail
        return jnp.stack([values["x"] / (1.0 - values["bad"]), values["x"], values["y"]])

    mixed = {"x": unit(3.0), "y": unit(3.0), "bad": 0.0}
    rows = np.array([[0.2, 0.2, 0.0], [0.5, 0.5, 0.1], [0.7, 0.7, 0.3]])
    for shared in ((), ("y",)):
        whole = identify.solve_many(sometimes, mixed, rows, noise=noise, shared=shared, chunk=2)
        assert set(whole.status) == {"CONVERGED"}
    with np.errstate(all="ignore"):
        lost = identify.solve_many(sometimes, mixed | {"bad": 1.0}, rows, noise=noise, shared=("y",))
    assert set(lost.status) == {"NONFINITE"} and np.isnan(lost.value["x"]).all() and np.isnan(lost.shared_u).all()


@pytest.mark.parametrize("sd", [1e-3, 1e3])
def test_noise_far_from_its_truth(sd):
    """Understated a thousandfold: refused. Overstated: everything unseen, p_model near 1, no NaN."""
    rng = np.random.default_rng(3)
    found = solved(G @ np.array([0.5, -0.2, 0.0]) + 0.5 * rng.standard_normal(4), noise=Noise(0.5 * sd))
    assert found.status == ("REJECTED" if sd < 1 else "CONVERGED")
    assert np.isfinite(found.u).all() and np.isfinite([found.evidence, found.fit.p_total]).all()
    if sd > 1:
        assert set(found.verdict.values()) == {"unseen"} and found.fit.p_model > 0.99


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
    _, jacobian, _ = slopes(lambda u: (jnp.tile(watched(u)[:1] * 2, 3), None), jnp.ones(1), 3)
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


def test_population_finds_the_process():
    """400 units whose mean is 0.8 and spread 0.5 of the drawing's; the units' own estimates lean to the drawing."""
    rng = np.random.default_rng(5)
    u = np.concatenate([0.8 + 0.5 * rng.standard_normal((400, 1)), rng.standard_normal((400, 2))], axis=1)

    def model(values):
        return jnp.stack([values["a"], values["b"], 0.0 * values["c"]])

    batch = identify.solve_many(
        model, THREE, u + np.array([1.0, 0.1, 0.1]) * rng.standard_normal((400, 3)), noise=Noise([1.0, 0.1, 0.1])
    )
    found = batch.population()
    # Sampling errors: of the mean sqrt((0.25 + 1)/400) = 0.056; of the spread about 1.25/(sqrt(800) 0.5) = 0.09.
    assert found.mean["a"] == pytest.approx(0.8, abs=4 * 0.056) and found.u_mean_sd[0] == pytest.approx(0.056, rel=0.15)
    assert found.sd["a"] == pytest.approx(0.5, abs=4 * 0.09)
    assert found.cp["a"] == pytest.approx(6 / (6 * found.u_sd[0])) and found.cpk["a"] < found.cp["a"]
    assert found.cpk["a"] == pytest.approx((3 - found.u_mean[0]) / (3 * found.u_sd[0]))
    assert (found.mean["c"], found.sd["c"]) == pytest.approx((0, 1)) and found.u_mean_sd[2] > 1e3  # nothing seen
    assert batch.u[:, 0].mean() == pytest.approx(0.4, abs=4 * 0.028)  # the units by themselves lean to the drawing


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


def test_pareto_shape_of_known_tails():
    """Tails of shape k: each estimate from 190 excesses has an error of (1 + k)/sqrt(190), and leans to 0.5 by 5 %."""
    rng = np.random.default_rng(8)
    for k in (0.2, 0.5, 1.0):
        found = [pareto_shape(-k * np.log(rng.uniform(size=4000))) for _ in range(20)]
        assert np.mean(found) == pytest.approx(0.95 * k + 0.025, abs=4 * (1 + k) / math.sqrt(190 * 20))
    assert pareto_shape(np.zeros(100)) == 0.0


def test_student_noise_shrugs_off_an_outlier():
    data = G @ np.array([0.5, 0.5, 0.0]) + np.array([0.0, 0.0, 0.0, 30.0])
    normal, student = solved(data), solved(data, noise=Noise(0.5, dof=4.0))
    assert abs(student.u[:2].sum() - 1.0) < 0.2 < abs(normal.u[:2].sum() - 1.0)
    assert student.fit.weights[3] < 0.01 and student.fit.worst[0] == "data[3]"


def test_orders_of_an_uneven_curve():
    rng = np.random.default_rng(4)
    angle = np.sort(rng.uniform(0, 4 * np.pi, 200))
    curve = 0.3 + np.real((2 - 1j) * np.exp(40j * angle)) + 0.02 * angle
    found = identify.orders(angle, curve, [40, 39], drift=True)
    assert found.value[0] == pytest.approx(2 - 1j, rel=1e-10) and abs(found.value[1]) < 1e-10
    assert found.residual_sd < 1e-12
    with pytest.raises(ValueError, match="samples cannot tell"):
        identify.orders(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.ones(40), [3, 37])  # aliases
    with pytest.raises(ValueError, match="samples cannot tell"):
        identify.orders(angle[:5], curve[:5], [1, 2])
    for bad in ([0], [1, 1], [-2], [np.inf]):
        with pytest.raises(ValueError, match="orders"):
            identify.orders(angle, curve, bad)


DATA = np.zeros(4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Noise(0.0), "Noise.sd = 0"),
        (lambda: Noise({"te": [1.0, -2.0]}), "te.* = -2"),
        (lambda: Noise(1.0, dof=0), "dof = 0"),
        (lambda: solved(np.zeros(3)), r"data: shape \(3,\)"),
        (lambda: solved({"te": np.zeros(4)}), "data: "),
        (lambda: solved(np.array([0, 0, np.inf, 0])), r"data\[2\] = inf"),
        (lambda: solved(np.full(4, np.nan)), "data = NaN"),
        (lambda: solved(np.zeros(4, complex)), "data: must hold real"),
        (lambda: solved(DATA, {"a": None, "b": None, "c": 1.0}), "prior: no active field"),
        (lambda: solved(DATA, nuisance=("d",)), "nuisance = 'd'"),
        (lambda: solved(DATA, starts=0), "starts = 0"),
        (lambda: solved(DATA, draws=10), "draws = 10"),
        (lambda: solved(DATA, seed=0.5), "seed = 0.5"),
        (lambda: solved(DATA, confidence=1.0), "confidence = 1.0"),
        (lambda: solved(DATA, noise=Noise([1.0, 2.0])), r"noise.sd: shape \(2,\)"),
        (lambda: solved(DATA, noise=0.5), "noise = 0.5"),
        (lambda: solved(DATA, limits={"a": unit(1.0)}), "limits: "),
        (lambda: solved(DATA, limits={"a": 1.0, "b": unit(1.0), "c": unit(1.0)}), "limits.a = 1.0"),
        (lambda: many(np.zeros((2, 3))), r"data: shape \(2, 3\)"),
        (lambda: many(np.zeros((0, 4))), "data: 0 units"),
        (lambda: many(np.array([[0, 0, 0, 0], [np.nan] * 4])), r"data\[1\] = NaN"),
        (lambda: many(np.zeros((2, 4)), shared=("d",)), "shared = 'd'"),
        (lambda: many(np.zeros((2, 4)), shared="a", correlation={("a", "b"): 0.5}), "correlation: shared a and own b"),
        (lambda: identify.identifiability(line, THREE, noise=Noise(1.0), at={"a": 0.0}), "at: "),
        (lambda: ranked(nuisance=("a", "b", "c")), "nuisance"),
        (lambda: ranked(costs={"other": 1.0}), "costs: 'other'"),
        (lambda: ranked(costs={"line": -1.0}), r"costs\['line'\] = -1"),
        (lambda: ranked(count=2), "count = 2"),
        (lambda: ranked(noise={"other": Noise(1.0)}), "noise: 'other'"),
    ],
)
def test_bad_input_is_named(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


def many(data, **options):
    return identify.solve_many(line, THREE, data, noise=Noise(0.5), **options)


def ranked(**options):
    return identify.rank_measurements(THREE, {"line": line}, **(dict(noise=Noise(0.5)) | options))


def test_units_of_unequal_count():
    def model(values):
        return {"x": values["a"], "y": values["b"]}

    with pytest.raises(ValueError, match="unequal counts of units"):
        identify.solve_many(model, THREE, {"x": np.zeros(2), "y": np.zeros(3)}, noise=Noise(0.5))


def test_batch_equals_its_units():
    """Units solved together, alone, in chunks and one by one."""
    rng = np.random.default_rng(6)
    data = rng.standard_normal((5, 4))
    whole, parts = many(data), many(data, chunk=2)
    np.testing.assert_allclose(whole.u, parts.u, rtol=1e-12)
    one = many(data[2:3])
    assert one.u[0] == pytest.approx(whole.u[2]) and one.value["a"].shape == (1,)
    single = solved(data[2])
    assert single.u == pytest.approx(whole.u[2], abs=1e-12) and single.u_sd == pytest.approx(whole.u_sd[2])
    assert single.fit.p_model == pytest.approx(whole.fit.p_model[2])
    assert single.lower["a"] == pytest.approx(whole.lower["a"][2])
    assert rvjax.check(whole) is whole and whole.shared_names == ()


def test_diagnostics_of_chains():
    """Independent draws, chains with memory 0.9 whose effective number is (1 - 0.9)/(1 + 0.9), chains in two modes."""
    rng = np.random.default_rng(9)
    normal = rng.standard_normal((4, 2000, 1))
    slow = np.zeros_like(normal)
    for k in range(1, 2000):
        slow[:, k] = 0.9 * slow[:, k - 1] + normal[:, k]
    apart = normal + np.array([3.0, 3.0, -3.0, -3.0])[:, None, None]
    wide = normal * np.array([1.0, 1.0, 3.0, 3.0])[:, None, None]
    r_hat, ess = diagnosed(np.concatenate([normal, slow, apart, wide], axis=-1))
    assert r_hat[0] < 1.005 and r_hat[2] > 1.5 and r_hat[3] > 1.1
    assert ess[0] == pytest.approx(8000, rel=0.15) and ess[1] == pytest.approx(8000 / 19, rel=0.3) and ess[2] < 20


def test_sample_names_what_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(ImportError, match=r"rvjax\[sampler\]"):
        identify.sample(solved(np.array([1.0, 0.4, 0.3, -0.6])))


def test_virtual_units_are_covered():
    """150 units: coverage within four binomial deviations, ranks and p-values uniform; the bars of the kept 1000."""
    found = identify_coverage.figures(150, seed=11)
    assert found["coverage"] == pytest.approx(0.95, abs=4 * math.sqrt(0.05 * 0.95 / 150))
    kept = json.loads(identify_coverage.KEPT.read_text())
    assert kept["units"] == 1000 and 0.93 < kept["coverage"] < 0.97
    for name in kept:
        if name.startswith("coverage of"):
            assert 0.92 < kept[name] < 0.98, name
        if name.startswith("uniform"):
            assert min(kept[name], found[name]) > 1e-4, name
    for figures, least in ((kept, 0.97), (found, 0.97 - 4 * math.sqrt(0.03 * 0.97 / 150))):
        assert figures["wrong reducer: p_model < 0.001"] >= least
        assert figures["tripled spread: p_prior < 0.001"] >= least
        assert figures["tripled spread: p_model < 0.001"] < 0.03


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


def test_a_unit_at_the_end_of_its_model_stops_no_other():
    """One unit's data lie where the model has no value; another sits at a kink. The rest end at their own modes."""

    def model(values):
        x = values["x"] + values["common"]
        return jnp.stack([jnp.log(x + 2.0), x, 3.0 * jnp.maximum(x, 0.5), values["common"] * 0.1])

    prior = {"x": unit(3.0), "common": unit(1.0)}
    x = np.array([0.9, -1.0, -6.0, 0.5, 1.2])
    data = np.stack([np.log(np.maximum(x, -1.9) + 2.0), x, 3.0 * np.maximum(x, 0.5), 0.0 * x], axis=1)
    kink = data + np.outer(np.arange(5) == 3, [0.0, 0.2, -0.9, 0.0])  # pulled down by one row, up by the other
    noise = Noise(0.1)
    for shared in ((), "common"):
        whole = identify.solve_many(model, prior, data if shared else kink, noise=noise, shared=shared)
        assert [whole.status[k] for k in (0, 1, 4)] == ["CONVERGED"] * 3
        x, common = (jnp.asarray(whole.value[name][[0, 1, 4]]) for name in ("x", "common"))

        def phi(x, common=common):  # of the three; x is its own standard number
            found = jax.vmap(lambda x, c: model({"x": x, "common": c}))(x, common)
            return jnp.sum(x**2) / 2 + jnp.sum((found - data[[0, 1, 4]]) ** 2) / 2 / 0.1**2

        np.testing.assert_allclose(jax.grad(phi)(x), 0.0, atol=1e-5)


def test_rv40e_shows_one_combination_of_its_cranks():
    """lambda = 4 (sigma/(4R))^2/noise^2 of e00 - e01 - e10 + e11, beside the offset of the mounting."""
    design, sigma, noise = rvjax.catalogue.RV_40E, 7e-6 / 3, 1.0 * arcsec
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)

    def curve(values):
        errors = rvjax.RVErrors.for_design(design, crank_eccentricity=values["ecc"])
        solve = lambda angle: rvjax.four_bar.transmission_error(design, errors, crank_angle=angle).error  # noqa: E731
        error = jax.vmap(solve)(jnp.asarray(angles))
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
