"""`rvjax.identify` for many units: each as alone, whatever becomes of its neighbours; what the process is."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from benchmarks import identify_coverage
from rvjax import identify
from tests.identify_models import THREE, Noise, many, solved, unit


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


def test_units_of_unequal_count():
    def model(values):
        return {"x": values["a"], "y": values["b"]}

    with pytest.raises(ValueError, match="unequal counts of units"):
        identify.solve_many(model, THREE, {"x": np.zeros(2), "y": np.zeros(3)}, noise=Noise(0.5))


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

        np.testing.assert_allclose(jax.jit(jax.grad(phi))(x), 0.0, atol=1e-5)


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


def test_virtual_units_are_covered(thorough):
    """150 units: coverage within four binomial deviations, ranks and p-values uniform; the bars of the kept 1000."""
    kept, bounds = json.loads(identify_coverage.KEPT.read_text()), []
    assert kept["units"] == 1000 and 0.93 < kept["coverage"] < 0.97
    bounds.append((kept, 0.97))
    if thorough:  # test_identify_head.py has the coverage of intervals
        found = identify_coverage.figures(150, seed=11)
        assert found["coverage"] == pytest.approx(0.95, abs=4 * math.sqrt(0.05 * 0.95 / 150))
        bounds.append((found, 0.97 - 4 * math.sqrt(0.03 * 0.97 / 150)))
    for name in kept:
        if name.startswith("coverage of"):
            assert 0.92 < kept[name] < 0.98, name
        if name.startswith("uniform"):
            assert min(figures[name] for figures, _ in bounds) > 1e-4, name
    for figures, least in bounds:
        assert figures["wrong reducer: p_model < 0.001"] >= least
        assert figures["tripled spread: p_prior < 0.001"] >= least
        assert figures["tripled spread: p_model < 0.001"] < 0.03
