"""What `rvjax.identify` says of noise, outliers, draws and bad input."""

import math
import sys
import types

import numpy as np
import pytest

import rvjax
from rvjax import identify
from rvjax.identify.goodness_of_fit import pareto_shape, reliability
from rvjax.identify.sampler import Draws, diagnose
from tests.identify_models import THREE, G, Noise, line, many, solved, unit


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


@pytest.mark.parametrize("sd", [1e-3, 1e3])
def test_noise_far_from_its_truth(sd):
    """Understated a thousandfold: refused. Overstated: everything unseen, p_model near 1, no NaN."""
    rng = np.random.default_rng(3)
    found = solved(G @ np.array([0.5, -0.2, 0.0]) + 0.5 * rng.standard_normal(4), noise=Noise(0.5 * sd))
    assert found.status == ("REJECTED" if sd < 1 else "CONVERGED")
    assert np.isfinite(found.u).all() and np.isfinite([found.evidence, found.fit.p_total]).all()
    if sd > 1:
        assert set(found.verdict.values()) == {"unseen"} and found.fit.p_model > 0.99


def test_an_outlier_hardly_moves_a_fit_with_student_noise():
    data = G @ np.array([0.5, 0.5, 0.0]) + np.array([0.0, 0.0, 0.0, 30.0])
    normal, student = solved(data), solved(data, noise=Noise(0.5, dof=4.0))
    assert abs(student.u[:2].sum() - 1.0) < 0.2 < abs(normal.u[:2].sum() - 1.0)
    assert student.fit.weights[3] < 0.01 and student.fit.worst[0] == "data[3]"


def test_pareto_shape_of_known_tails():
    """Tails of shape k: each estimate from 190 excesses has an error of (1 + k)/sqrt(190), and leans to 0.5 by 5 %."""
    rng = np.random.default_rng(8)
    for k in (0.2, 0.5, 1.0):
        found = [pareto_shape(-k * np.log(rng.uniform(size=4000))) for _ in range(20)]
        assert np.mean(found) == pytest.approx(0.95 * k + 0.025, abs=4 * (1 + k) / math.sqrt(190 * 20))
    assert pareto_shape(np.zeros(100)) == 0.0


@pytest.mark.parametrize(("part", "trusted"), [(1e-4, True), (1.0, False)])
def test_weights_that_are_equal_have_no_tail(part, trusted):
    """Excesses of shape 1 on weights of 1, whatever their size: of a ten-thousandth they leave 99.9 % of the draws."""
    log_weights = np.log1p(part * np.random.default_rng(10).pareto(1.0, size=500))
    found = reliability(log_weights, 1)
    assert pareto_shape(log_weights) > 0.7 and found.trusted is trusted
    assert (found.pareto_k == 0, found.ess > 0.99 * 500) == (trusted, trusted)


def test_diagnostics_of_chains():
    """Independent draws, chains with memory 0.9 whose effective number is (1 - 0.9)/(1 + 0.9), chains in two modes."""
    rng = np.random.default_rng(9)
    normal = rng.standard_normal((4, 2000, 1))
    slow = np.zeros_like(normal)
    for k in range(1, 2000):
        slow[:, k] = 0.9 * slow[:, k - 1] + normal[:, k]
    apart = normal + np.array([3.0, 3.0, -3.0, -3.0])[:, None, None]
    wide = normal * np.array([1.0, 1.0, 3.0, 3.0])[:, None, None]
    r_hat, ess = diagnose(np.concatenate([normal, slow, apart, wide], axis=-1))
    assert r_hat[0] < 1.005 and r_hat[2] > 1.5 and r_hat[3] > 1.1
    assert ess[0] == pytest.approx(8000, rel=0.15) and ess[1] == pytest.approx(8000 / 19, rel=0.3) and ess[2] < 20


def test_sample_names_what_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(ImportError, match=r"rvjax\[sampler\]"):
        identify.sample(solved(np.array([1.0, 0.4, 0.3, -0.6])))


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


def ranked(**options):
    return identify.rank_measurements(THREE, {"line": line}, **(dict(noise=Noise(0.5)) | options))


def test_draws_go_to_arviz_by_field(monkeypatch):
    """Stand-in for the package: it keeps what it is given, in the form of its version."""
    found = solved(np.array([1.0, 0.4, 0.3, -0.6]))
    value = {name: np.full((2, 3), k) for k, name in enumerate(found.value)}
    drawn = Draws(value, np.ones(3), np.ones(3), 0, True, np.zeros((2, 3, 3)), found)
    for version in ("0.20.0", "1.0.0"):
        made = types.SimpleNamespace(__version__=version, from_dict=lambda *given, **named: (given, named))
        monkeypatch.setitem(sys.modules, "arviz", made)
        given, named = drawn.to_arviz()
        kept = given[0]["posterior"] if version > "1" else named["posterior"]
        assert list(kept) == list(value) and all((kept[name] == value[name]).all() for name in value)
