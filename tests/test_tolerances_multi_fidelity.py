"""Several fidelities. Oracles: closed forms of normal numbers, plain Monte Carlo, and binomial bounds on coverage.

Small versions of `python -m benchmarks.multi_fidelity`. A coverage of 95 % over `runs` independent runs shows as
0.95 - 4 sqrt(0.95 0.05/runs) or more but in one case of 30 000; gains have a closed form where the regression is exact.
"""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from rvjax.records import Record, field, record
from rvjax.status import Status
from rvjax.tolerances import (
    MeanWithin,
    Outcome,
    Requirement,
    Tolerance,
    linearised,
    monte_carlo,
    multi_fidelity,
    sample,
)
from rvjax.tolerances.fidelity.control_variates import Basis, regressed
from rvjax.tolerances.fidelity.multi_fidelity import _Study
from rvjax.tolerances.fidelity.targeting import Prediction, chosen, inclusion, targeted
from rvjax.tolerances.requirements.limits import Limits

COMPILED = "/jax/core/compile/backend_compile_duration"
NUMBERS = {name: Tolerance.symmetric(3.0) for name in "abc"}  # standard normal
NEED = Requirement(upper=2.5)
LAW = stats.norm(0, math.sqrt(1.01))


def dear(e):
    return (e["a"] + e["b"]) / math.sqrt(2) + 0.1 * e["c"]


def rough(e):
    return e["a"] + 0.9 * e["b"]


def other(e):
    return 0.8 * e["a"] + e["b"]


def ask(of=dear, cheap=None, seed=0, **more):
    options = dict(samples=200, cheap_samples=4000, seed=seed, requirements=NEED) | more
    return multi_fidelity(of, {"rough": rough, "other": other} if cheap is None else cheap, NUMBERS, **options)


def least(runs):
    return 0.95 - 4 * math.sqrt(0.95 * 0.05 / runs)


@pytest.fixture(scope="module")
def runs():
    return [ask(seed=seed) for seed in range(40)]


def test_intervals_of_all_three_figures_hold_and_none_is_biased(runs):
    exact = {"mean": 0.0, "sd": LAW.std(), "yield_": LAW.cdf(2.5)}
    for figure, value in exact.items():
        found = [getattr(run, figure) for run in runs]
        assert np.mean([item.lower <= value <= item.upper for item in found]) >= least(len(runs)), figure
        off = np.array([item.value - value for item in found])
        assert abs(off.mean()) < 4 * off.std(ddof=1) / math.sqrt(len(off)), figure
        # Errors as said: a variance of 40 runs is known to a factor of 2.5 (chi-square, 4 sd).
        said = np.median([item.error**2 for item in found])
        assert 1 / 2.5 < said / off.var(ddof=1) < 2.5, figure
    assert sum(run.status != "OK" for run in runs) <= 2  # 4 of 1000 were in doubt without need


def test_a_tenth_of_the_evaluations(runs):
    """Side by side: plain Monte Carlo of ten times as many units has a wider interval of the yield."""
    ours = np.median([run.yield_.upper - run.yield_.lower for run in runs])
    plain = [monte_carlo(dear, NUMBERS, samples=2000, seed=seed, requirements=NEED).yield_ for seed in range(20)]
    assert ours < np.median([item.upper - item.lower for item in plain])
    assert np.median([run.gain["yield"] for run in runs]) > 10


def test_the_gain_of_the_mean_is_that_of_theory(runs):
    """100 of 200 units are plain; 1 % of the variance is left, and 1/4000 of the rest is sampled."""
    theory = (1.01 / 200) / (0.01 / 100 + 1.0 / 4100)  # the plain units know a part of the cheap mean too
    found = np.median([run.gain["mean"] for run in runs])
    assert found == pytest.approx(theory, rel=0.15)  # 5 slopes of 90 units, and the median of 40 runs: 3 + 6 %
    run = runs[0]
    assert run.correlation == pytest.approx(math.sqrt(1 / 1.01), abs=0.01)
    # corr((a + b)/sqrt 2 + c/10, a + 0.9 b), known from 100 units to (1 - r^2)/10 = 0.0013 (a standard error)
    exact = 1.9 / math.sqrt(2 * 1.01 * 1.81)
    assert run.correlations["rough"] == pytest.approx(exact, abs=5 * (1 - exact**2) / 10)
    assert run.ppm.value == pytest.approx(1e6 * (1 - run.yield_.value))
    assert run.cheap_per_dear > 0 and run.seconds["dear"] > 0


def test_without_correlation_it_is_plain_monte_carlo():
    run = ask(of=lambda e: e["a"], cheap=lambda e: e["b"] + e["c"])
    plain = monte_carlo(lambda e: e["a"], NUMBERS, samples=200, seed=0, requirements=NEED)
    assert run.status == "POOR_CORRELATION" and abs(run.correlation) < 0.3
    for ours, theirs in ((run.mean, plain.mean), (run.sd, plain.sd), (run.yield_, plain.yield_)):
        assert (ours.value, ours.lower, ours.upper) == pytest.approx((theirs.value, theirs.lower, theirs.upper))
    assert run.gain == {"mean": 1.0, "sd": 1.0, "yield": 1.0} and math.isnan(run.cheap_per_dear)


def test_units_that_fail_are_rejects_and_no_part_of_the_moments():
    def of(e):
        return Outcome(dear(e), jnp.where(e["c"] > 1.0, int(Status.MAX_STEPS), int(Status.CONVERGED)))

    lost = stats.norm.sf(1.0)
    left = stats.truncnorm(-np.inf, 1.0)
    exact = 0.1 * left.mean(), math.sqrt(1 + 0.01 * left.var()), stats.norm.cdf(2.5) * (1 - lost)
    for seed in range(3):  # 5 standard errors: one case in a million
        run = ask(of=of, seed=seed, samples=1000)
        assert run.status in ("OK", "PARTLY_PLAIN")
        for item, value in zip((run.mean, run.sd, run.yield_), (*exact[:2], exact[2])):
            assert abs(item.value - value) < 5 * item.error + 3e-4  # P(y > 2.5 | c) bends the yield by 2e-4
        assert abs(run.failed - 1000 * lost) < 5 * math.sqrt(1000 * lost)


def test_cheap_values_that_are_missing():
    gaps = lambda e: jnp.where(e["a"] > 1.5, jnp.nan, rough(e))  # noqa: E731
    run = ask(cheap={"gaps": gaps, "other": other}, samples=1000)
    assert run.status == "OK" and abs(run.mean.value) < 5 * run.mean.error
    assert abs(run.yield_.value - LAW.cdf(2.5)) < 5 * run.yield_.error


def test_several_responses_by_name_each_with_what_helps_it():
    both = lambda e: {"y": dear(e), "noise": e["c"]}  # noqa: E731
    run = ask(of=both, cheap={"rough": lambda e: {"y": rough(e)}, "other": other}, requirements={"y": NEED})
    assert run.status == {"y": "PARTLY_PLAIN", "noise": "POOR_CORRELATION"} or run.status["y"] == "OK"
    assert run.status["noise"] == "POOR_CORRELATION" and run.gain["noise"] == {"mean": 0.5, "sd": 0.5}
    assert run.yield_["y"].error < 0.003 and run.yield_["noise"] is None and run.samples == 200
    alone = ask(of=both, cheap=rough, requirements=None)
    assert alone.yield_ is None and alone.gain["y"]["mean"] > 12  # 1.01/(0.013 + 200/4200)


def test_a_figure_that_leaves_the_plain_interval_says_so():
    """Further units that are not of the same law as the dear ones, by a whole standard deviation."""
    random = np.random.default_rng(0)
    few, many = random.normal(size=(200, 1)), random.normal(1.0, 1.0, (4000, 1))
    units = SimpleNamespace(first_of=lambda name: {"x": 0}, taken={"dear": math.nan, "cheap": math.nan})
    found = _Study(units, {}, 200, 0, 4000, 0, 0.95)._figures("", few[:, 0], few, many, Basis.of(few, many), None)
    assert found["status"] == "ESTIMATES_DISAGREE"
    assert found["mean"].value == pytest.approx(1.0, abs=0.1) and found["mean"].lower == found["plain"]["mean"].lower


def test_a_second_call_compiles_nothing():
    names = []
    ask(seed=1)
    jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__: names.append(name))
    ask(seed=2)
    assert COMPILED not in names


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (dict(samples=19), "samples = 19: must be at least 20"),
        (dict(cheap_samples=199), "cheap_samples = 199: must be at least samples = 200"),
        (dict(chosen_share=0.95), "chosen_share = 0.95: must lie between 0 and 0.9"),
        (dict(confidence=1.0), "confidence = 1.0: must lie between 0 and 1"),
        (dict(requirements=MeanWithin(upper=1.0)), "says nothing of one unit"),
        (dict(cheap={}), "cheap: needs at least one response"),
    ],
)
def test_what_cannot_be_is_refused(more, message):
    with pytest.raises(ValueError, match=message):
        ask(**more)


def test_too_few_units_for_a_regression_are_plain():
    run = ask(samples=25, chosen_share=0.0)  # two columns and a constant need 30
    assert run.status == "TOO_FEW_UNITS" and run.mean == run.plain["mean"]


def test_regression_is_unbiased_however_few_units():
    """E over 600 samples of 20 units of a cubic figure, which no line fits: the mean of all its errors is 0."""
    random, off = np.random.default_rng(3), []
    for _ in range(600):
        x = random.standard_normal((220, 1))
        off.append(regressed(x[:20, 0] ** 3 + x[:20, 0] ** 2, x[:20], x[20:]).value - 1.0)
    assert abs(np.mean(off)) < 4 * np.std(off) / math.sqrt(600)


def test_the_basis_grows_with_the_units():
    values = np.random.default_rng(0).normal(size=(200, 2))
    orders = {n: Basis.of(values[:n], values) for n in (29, 30, 50, 60)}
    assert orders[29] is None and [orders[n].order for n in (30, 50, 60)] == ["linear", "squares", "products"]
    assert orders[60].columns(values).shape == (200, 5)


def test_chosen_units_keep_their_probabilities_and_the_yield_is_unbiased():
    """Even where the prediction is wrong: the probabilities of a shifted limit, the draw many times over."""
    random = np.random.default_rng(0)
    x = random.standard_normal((400, 1))
    y = x[:, 0] + 0.3 * random.standard_normal(400)
    fitted = Prediction.fitted(Basis.of(x[:100], x), x[:100], y[:100])
    right, wrong = (fitted.passes(x, Requirement(upper=u)) for u in (1.0, 0.3))
    share = inclusion([wrong], 60)
    assert share.sum() == pytest.approx(60) and share.min() > 0 and share.max() <= 1
    assert abs(right.mean() - (y <= 1.0).mean()) < 0.05
    counts, values = np.zeros(400), []
    for _ in range(2000):
        drawn = chosen(share, 60, random)
        assert len(set(drawn)) == 60
        counts[drawn] += 1
        values.append(targeted(wrong, share, drawn, y[drawn] <= 1.0).value)
    assert (np.abs(counts / 2000 - share) < 5 * np.sqrt(share * (1 - share) / 2000) + 1e-12).all()
    exact = (y <= 1.0).mean()
    assert abs(np.mean(values) - exact) < 4 * np.std(values) / math.sqrt(2000)


def test_linearised_is_the_series_at_the_mean_errors():
    shifted = {"x": Tolerance(0.0, 4.0), "v": Tolerance.symmetric(1.0, shape=(2,)), "still": None}
    of = lambda e: {"y": e["x"] ** 2 + e["v"][0] * e["v"][1] + jnp.sin(e["v"][0]) + e["still"], "k": 3.0}  # noqa: E731
    at = {"x": 2.5, "v": jnp.array([0.1, 0.2]), "still": 0.0}
    first, second = (linearised(of, shifted, curvature=c)(at) for c in (False, True))
    assert (first["y"], first["k"]) == pytest.approx((4 + 4 * 0.5 + 0.1, 3.0))
    assert second["y"] == pytest.approx(4 + 2 + 0.25 + 0.1)  # no mixed terms; sin has no curvature at 0
    assert linearised(of, shifted)(sample(shifted, 0, seed=0))["y"].shape == ()


def test_a_linearised_response_keeps_the_order_of_a_record():
    """Fields of a record do not stand in alphabetical order, also not after they went into a program."""

    @record
    class Pair(Record):
        z: float = field("m", "first")
        a: float = field("m", "second")

    of = linearised(lambda e: 3 * e.z - e.a, Pair(Tolerance.symmetric(1.0), Tolerance.symmetric(1.0)))
    assert float(jax.jit(lambda of, e: of(e))(of, Pair(2.0, 1.0))) == pytest.approx(5.0)


def test_the_peak_of_a_linearised_curve_keeps_its_kink():
    """A linear curve: its peak to peak is the response itself, whose own derivative at 0 says nothing."""
    angle = jnp.linspace(0, 2 * math.pi, 16, endpoint=False)
    curve = lambda e: e["a"] * jnp.cos(angle) + e["b"] * jnp.sin(2 * angle)  # noqa: E731
    whole = linearised(curve, NUMBERS, then=jnp.ptp)
    unit = sample(NUMBERS, 3, seed=0)
    assert whole(unit) == pytest.approx(float(jnp.ptp(curve(unit))), rel=1e-12)
    run = ask(of=lambda e: jnp.ptp(curve(e)) + 0.01 * e["c"], cheap=whole, requirements=Requirement(upper=6.0))
    assert run.gain["yield"] > 5 and run.gain["mean"] > 5


@pytest.mark.parametrize(
    ("of", "message"),
    [
        (lambda e: jnp.sqrt(e["a"]), "derivative at the mean errors is not finite"),
        (lambda e: jnp.log(e["a"]), "value at the mean errors is not finite"),
        (lambda e: Outcome(e["a"], int(Status.MAX_STEPS)), "status MAX_STEPS at the mean errors"),
    ],
)
def test_no_place_to_linearise(of, message):
    with pytest.raises(ValueError, match=message):
        linearised(of, NUMBERS)


def test_every_kind_of_limit_has_a_prediction():
    """P(lower <= y <= upper) of a normal residual, known from 2000 of them to 5 sqrt(p q/2000) and the smoothing."""
    random = np.random.default_rng(0)
    x = random.standard_normal((2000, 1))
    fitted = Prediction.fitted(Basis.of(x, x), x, x[:, 0] + 0.2 * random.standard_normal(2000))
    limits: list[tuple[Limits, float]] = [
        (Requirement(upper=0.1), stats.norm.cdf(0.5)),
        (Requirement(lower=0.1), stats.norm.sf(0.5)),
        (Requirement(lower=-0.1, upper=0.1), stats.norm.cdf(0.5) - stats.norm.cdf(-0.5)),
    ]
    for item, exact in limits:
        assert fitted.passes(np.zeros((1, 1)), item)[0] == pytest.approx(exact, abs=0.05)
