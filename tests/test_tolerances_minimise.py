"""Any objective with any optimiser of optax.

Oracles: the half-widths that minimise a quadratic loss of a linear response and costs c/h, in closed form; central
differences of the sampled J, from `sample` and the plain response; the sampled J itself, unit by unit.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import rvjax
from rvjax.status import Status
from rvjax.tolerances import QuadraticLoss, ReciprocalPower, Tolerance, load, minimise, sample, save
from rvjax.units import um
from tests.oracles.responses import Failing, Linear

A, C = np.array([1.0, 2.0, 0.5]), np.array([1.0, 0.3, 2.0])
LOSS = QuadraticLoss(2.0, 5 * um)
K = 2.0 / (5 * um) ** 2
NAMES = ("u", "v", "w")
linear = Linear({"y": dict(zip(NAMES, map(float, A)))})


def costs(finest=0.1 * um, coarsest=1000 * um):
    return {n: ReciprocalPower(scale=float(c), finest=finest, coarsest=coarsest) for n, c in zip(NAMES, C)}


def tolerances(half_width=20 * um, **options):
    return {n: Tolerance.symmetric(half_width, **options) for n in NAMES}


def mean_loss(values, half_widths):
    return jnp.mean(LOSS(values["y"]))


def vector(found):
    return np.array([found.half_widths[n] for n in NAMES])


def exact(h, spread=9.0):
    """J of normal errors with half-widths of 3 sigma; with 3 in the place of 9, of uniform errors."""
    return float(np.sum(C * 10 * um / h) + K * np.sum(A**2 * h**2) / spread)


def optimum(spread=9.0):
    return np.cbrt(spread * C * 10 * um / (2 * K * A**2))


@functools.partial(jax.jit, static_argnames=("objective", "response", "seed"))
def sampled(objective, response, given, price, units, seed):
    """J of the units of these numbers, from the plain response."""
    errors = jax.vmap(lambda i: sample(given, i, seed=seed))(units)
    half_widths = {n: t.half_width for n, t in given.items()}
    total = sum(cost(half_widths[n]) for n, cost in price.items())
    return objective(jax.vmap(response)(errors), half_widths) + total


def slope_of(objective, response, given, price, n, rate=1e-3, **options):
    """dJ/d log h by field, from one step of steepest descent on units 0 .. n - 1."""
    found = minimise(
        objective, response, given, costs=price, optimizer=optax.sgd(rate), samples=n, steps=1, seed=5, **options
    )
    return {name: math.log(float(given[name].half_width) / t) / rate for name, t in found.half_widths.items()}


def differences(objective, response, given, price, n, width=1e-4):
    found = {}
    for name, tolerance in given.items():
        ends = [
            sampled(
                objective, response, given | {name: tolerance.scaled(tolerance.half_width * math.exp(way))},
                price, np.arange(n), seed=5,
            )
            for way in (-width, width)
        ]  # fmt: skip
        found[name] = float(ends[1] - ends[0]) / (2 * width)
    return found


@pytest.fixture(scope="module")
def of_normal():
    return minimise(mean_loss, linear, tolerances(), costs=costs(), steps=200)


def check_closed_form(found, spread, fourth):
    """With the fourth moment of a standardised error less 3: 0 of normal errors, -1.2 of uniform ones."""
    h = vector(found)
    np.testing.assert_allclose(h, optimum(spread), rtol=0.01)
    assert exact(h, spread) == pytest.approx(exact(optimum(spread), spread), rel=0.002)
    cost, parts = float(np.sum(C * 10 * um / h)), A**2 * h**2
    assert found.cost == pytest.approx(cost, rel=1e-12)
    excess = fourth * np.sum(parts**2) / np.sum(parts) ** 2
    error = (exact(h, spread) - cost) * math.sqrt((2 + excess) / (16 * 4096))  # of the mean of so many squares
    assert found.objective.value == pytest.approx(exact(h, spread), abs=4 * error)
    assert found.objective.error == pytest.approx(error, rel=0.6)  # 16 samples show it to 18 %
    assert found.objective.lower < found.objective.value < found.objective.upper
    assert rvjax.check(found) is found and found.gradient.value == float(found.info.residual) < 0.02
    for name, tolerance in found.tolerances.items():
        assert tolerance.half_width == pytest.approx(found.half_widths[name], rel=1e-15)


def test_the_half_widths_of_a_quadratic_loss_are_those_of_the_closed_form(of_normal):
    check_closed_form(of_normal, 9.0, 0.0)
    assert of_normal.info.steps == 200 and of_normal.history.shape == (200,)


@pytest.mark.long
def test_the_half_widths_of_uniform_errors_are_those_of_the_closed_form():
    """From starts up to 40 times too coarse: steep slopes there must not slow down all later steps."""
    given = tolerances(100 * um, distribution="uniform")
    check_closed_form(minimise(mean_loss, linear, given, costs=costs()), 3.0, -1.2)


def test_any_optimiser_finds_the_minimum_of_one_sample(thorough):
    options = dict(costs=costs(), samples=500, fresh=False)
    by_adam = minimise(mean_loss, linear, tolerances(), steps=300, **options)
    by_lbfgs = minimise(mean_loss, linear, tolerances(), optimizer=optax.lbfgs(), steps=15, **options)
    np.testing.assert_allclose(vector(by_adam), vector(by_lbfgs), rtol=1e-3)
    if not thorough:
        return
    by_sgd = minimise(mean_loss, linear, tolerances(), optimizer=optax.sgd(0.05), steps=200, **options)
    np.testing.assert_allclose(vector(by_sgd), vector(by_lbfgs), rtol=1e-3)
    assert by_sgd.history[-1] == pytest.approx(by_lbfgs.history[-1], rel=1e-6)


def test_half_widths_stay_between_finest_and_coarsest(thorough):
    """u may not be so coarse as it should, v not so fine: both end at their bounds, w where it does without these."""
    best = optimum()
    price = costs() | {
        "u": ReciprocalPower(scale=1.0, finest=0.1 * um, coarsest=0.7 * best[0]),
        "v": ReciprocalPower(scale=0.3, finest=1.5 * best[1], coarsest=1000 * um),
    }
    given = tolerances() | {"v": Tolerance.symmetric(1 * um)}  # begins outside
    for optimizer, fresh, steps in ((None, True, 200), *([(optax.lbfgs(), False, 15)] if thorough else ())):
        found = minimise(mean_loss, linear, given, costs=price, optimizer=optimizer, fresh=fresh, steps=steps)
        assert found.half_widths["u"] == 0.7 * best[0] and found.half_widths["v"] == 1.5 * best[1]
        assert found.half_widths["w"] == pytest.approx(best[2], rel=0.01 if fresh else 0.03)
        assert found.info.status == Status.CONVERGED and found.gradient.value < 0.03  # w alone is free
    # Both bounds hold against slopes that are no small ones.
    slopes = -C * 10 * um / vector(found) + 2 * K * (A * vector(found)) ** 2 / 9
    assert slopes[0] < -0.1 * found.cost and slopes[1] > 0.1 * found.cost


def spread_of(values, half_widths):
    """Neither a mean over units nor a function of values alone; of a response without names."""
    return jnp.std(values / um) + jnp.max(values / um) + 3.0 * (half_widths["b"] / (10 * um)) ** 2


def bent(errors):
    return errors["a"] + jnp.tanh(errors["b"] / (20 * um)) * errors["a"] - 0.5 * errors["b"]


def test_the_gradient_is_that_of_the_sampled_value():
    given = {"a": Tolerance(-5 * um, 15 * um, distribution="triangular"), "b": Tolerance.symmetric(8 * um, cp=1.3)}
    price = {n: ReciprocalPower(finest=1 * um, coarsest=100 * um, power=0.7) for n in given}
    found = slope_of(spread_of, bent, given, price, 300)
    assert found == pytest.approx(differences(spread_of, bent, given, price, 300), rel=1e-6)


def test_the_gradient_at_the_end_has_its_length_and_error():
    """dJ/d log h of independent normal errors is 2 K a^2 h^2/9 m - c/h, m a mean of 16 n squares."""
    stay = dict(costs=costs(), optimizer=optax.set_to_zero(), samples=1000, steps=1)
    found = minimise(mean_loss, linear, tolerances(6 * um), **stay)
    h = vector(found)
    losses, price = 2 * K * A**2 * h**2 / 9, C * 10 * um / h
    length = float(np.linalg.norm(losses - price)) / float(price.sum())
    assert found.gradient.value == pytest.approx(length, abs=4 * found.gradient.error)
    # y dy/d log h_i = y e_i a_i has the variance (s^2 + s_i^2) s_i^2, s_i^2 = a_i^2 h_i^2/9, times 4 K^2.
    parts = A**2 * h**2 / 9
    error = 2 * K * math.sqrt(float(np.sum((parts.sum() + parts) * parts)) / 16_000) / float(price.sum())
    assert found.gradient.error == pytest.approx(error, rel=0.6)
    assert found.info.status == Status.MAX_STEPS and found.gradient.lower > 0.1
    with pytest.raises(rvjax.SolveError, match="MAX_STEPS"):
        rvjax.check(found)


def test_units_are_fresh_or_one_sample():
    """The units of a step follow those of the step before; those of the end belong to the next seed."""
    stay = dict(costs=costs(), optimizer=optax.set_to_zero(), samples=200, steps=3, seed=7)
    fresh, one = (minimise(mean_loss, linear, tolerances(), fresh=way, **stay) for way in (True, False))

    def j(units, seed):
        return float(sampled(mean_loss, linear, tolerances(), costs(), np.array(units), seed))

    np.testing.assert_allclose(fresh.history, [j(range(200 * k, 200 * k + 200), 7) for k in range(3)], rtol=1e-12)
    np.testing.assert_allclose(one.history, 3 * [fresh.history[0]], rtol=1e-12)
    assert fresh.objective == one.objective
    assert one.objective.value == pytest.approx(j(range(16 * 200), 8), rel=1e-12)


def test_a_step_is_compiled_once(compiled):
    """Other numbers, bounds and seeds need no further program."""
    first = dict(samples=200, steps=2)
    minimise(mean_loss, linear, tolerances(), costs=costs(), **first)
    compiled.clear()
    minimise(mean_loss, linear, tolerances(9 * um), costs=costs(0.2 * um), seed=3, **first)
    assert [event for event in compiled if "backend_compile" in event or "trace" in event] == []


def test_a_minimum_is_saved(of_normal, tmp_path):
    save(of_normal, tmp_path / "minimum.json")
    again = load(tmp_path / "minimum.json")
    assert again.half_widths == of_normal.half_widths and again.objective == of_normal.objective
    np.testing.assert_array_equal(again.history, of_normal.history)
    assert rvjax.check(again).info.steps == 200


def test_a_field_without_price_keeps_its_half_width():
    free = {"u": costs()["u"], "v": None, "w": None}
    found = minimise(mean_loss, linear, tolerances(3 * um), costs=free, steps=100)
    assert list(found.half_widths) == ["u"] and found.tolerances["v"].half_width == 3 * um
    assert found.half_widths["u"] == pytest.approx(optimum()[0], rel=0.01)


def arc(errors):
    """No number where the error is larger than 1, and there no derivative either."""
    return {"y": jnp.sqrt(1 - errors["a"] ** 2) + errors["b"]}


FAILS = {"a": Tolerance.symmetric(1.5), "b": Tolerance.symmetric(0.5)}
ROUGH = {n: ReciprocalPower(reference=1.0, finest=0.1, coarsest=3.0) for n in FAILS}


def rejects(values, half_widths):
    y = values["y"]
    return 3.0 * jnp.nanvar(y) + 10.0 * jnp.mean(jnp.isnan(y).astype(y.dtype))


OF_STATUS = pytest.param(Failing({"a": 2.0, "b": 1.0}, {"a": 1.0}), marks=pytest.mark.long)


@pytest.mark.parametrize("response", [arc, OF_STATUS])
def test_failed_units_are_nan_and_without_a_slope(response):
    """The differences leave the same units failing."""

    def objective(values, half_widths):
        return rejects(values if isinstance(values, dict) else {"y": values}, half_widths)

    found = slope_of(objective, response, FAILS, ROUGH, 400)
    errors = jax.vmap(lambda i: sample(FAILS, i, seed=5))(jnp.arange(400))
    lost = np.abs(errors["a"]) > 1.0
    assert 10 < lost.sum() < 40

    def plain(errors):
        value = response(errors)
        return {"y": value["y"] if response is arc else jnp.where(jnp.abs(errors["a"]) > 1.0, jnp.nan, value.value)}

    assert found == pytest.approx(differences(rejects, plain, FAILS, ROUGH, 400, width=1e-6), rel=1e-5)
    done = minimise(objective, response, FAILS, costs=ROUGH, samples=400, steps=60)
    assert done.info.status != Status.NONFINITE and done.objective.value < done.history[0]


def test_an_objective_that_fails_on_its_way_ends_there():
    """Descent widens a cheap field until its logarithm has no number."""

    def objective(values, half_widths):
        return jnp.log(12 * um - half_widths["u"]) + 0.0 * jnp.mean(values["y"])

    given, start = dict(costs=costs(), optimizer=optax.sgd(0.05), samples=200), tolerances(10 * um)
    found = minimise(objective, linear, start, steps=50, **given)
    last = int(found.info.steps)
    assert found.info.status == Status.NONFINITE and 0 < last < 50
    assert len(found.history) == last + 1 and np.isnan(found.history[-1]) and np.isfinite(found.history[:-1]).all()
    assert found.half_widths["u"] > 12 * um and found.tolerances["u"].half_width > 12 * um
    assert np.isnan([found.objective.value, found.gradient.value, found.gradient.lower]).all()
    with pytest.raises(rvjax.SolveError, match="NONFINITE"):
        rvjax.check(found)
    before = minimise(objective, linear, start, steps=last, **given)  # its independent units find out
    assert (before.info.status, before.info.steps, len(before.history)) == (Status.NONFINITE, last, last)
    assert np.isfinite(before.history).all() and before.half_widths == found.half_widths


def test_a_slope_that_is_not_finite_ends_it():
    def objective(values, half_widths):
        return jnp.sqrt(jnp.maximum(half_widths["u"] / um - 50.0, 0.0))

    found = minimise(objective, linear, tolerances(), costs=costs(), samples=200, steps=5)
    assert (found.info.status, found.info.steps) == (Status.NONFINITE, 0) and np.isfinite(found.history).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(objective=lambda v, h: v["y"]), r"objective: must return one real number, got shape \(200,\) float64"),
        (dict(objective=lambda v, h: jnp.mean(v["y"]).astype(complex)), r"real number, got shape \(\) complex128"),
        (dict(objective=lambda v, h: None), "objective: must return one real number, got None"),
        (dict(objective=lambda v, h: jnp.mean(jnp.log(v["y"]))), "objective = nan at the start: must be finite"),
        (dict(objective=lambda v, h: v["x"]), "objective: 'x' .* no name of the response or of a field.* y, u, v, w"),
        (dict(objective=lambda v, h: h["uu"]), r"objective: 'uu' \(did you mean u\?\) is no name"),
        (dict(objective=3.0), "objective = 3.0: must be a function"),
        (dict(costs={"u": costs()["u"]}), "costs: 'v' has a tolerance and no cost; give None to keep its half-width"),
        (dict(costs={"v": None}), "costs: no field has a cost"),
        (dict(costs=costs() | {"uv": None, "ww": costs()["w"]}), r"costs: 'ww' \(did you mean w\?\) has no tolerance"),
        (dict(samples=99), "samples = 99: must be at least 100"),
        (dict(steps=0), "steps = 0: must be at least 1"),
        (dict(seed=-1), "seed = -1: must be a whole number"),
        (dict(fresh="no"), "fresh = 'no': must be True or False"),
        (dict(optimizer=0.1), "optimizer = 0.1: must be an optax.GradientTransformation"),
    ],
)
def test_bad_input_is_named(changes, message):
    given = dict(objective=mean_loss, response=linear, tolerances=tolerances(), costs=costs(), samples=200, steps=2)
    with pytest.raises(ValueError, match=message) as error:
        minimise(**(given | changes))
    assert "\n" not in str(error.value)


def test_an_objective_of_failed_units_is_refused_at_the_start():
    with pytest.raises(ValueError, match=r"objective = nan at the start: must be finite; \d+ of 400 units fail"):
        minimise(lambda v, h: jnp.var(v["y"]), arc, FAILS, costs=ROUGH, samples=400, steps=2)


def test_a_quadratic_loss():
    """Twice the deviation costs four times as much, on both sides of the target; the price belongs to `at`."""
    loss = QuadraticLoss(12.0, 2.0, target=1.0)
    np.testing.assert_allclose(loss(jnp.asarray([1.0, 3.0, -1.0, 5.0])), [0.0, 12.0, 12.0, 48.0])
    assert float(jax.grad(loss)(3.0)) == pytest.approx(12.0) and QuadraticLoss(1.0, 1.0).target == 0.0
    assert QuadraticLoss(0.0, 1.0)(5.0) == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(price=-1.0, at=1.0), "QuadraticLoss.price = -1: must be zero or positive"),
        (dict(price=math.nan, at=1.0), "QuadraticLoss.price = nan: must be finite"),
        (dict(price=math.inf, at=1.0), "QuadraticLoss.price = inf: must be finite"),
        (dict(price=1.0, at=0.0), "QuadraticLoss.at = 0: must be positive"),
        (dict(price=1.0, at=-2.0), "QuadraticLoss.at = -2: must be positive"),
        (dict(price=1.0, at=math.inf), "QuadraticLoss.at = inf: must be finite"),
        (dict(price=1.0, at=1.0, target=math.nan), "QuadraticLoss.target = nan: must be finite"),
        (dict(price="12", at=1.0), "QuadraticLoss.price = '12': must be a number"),
    ],
)
def test_a_bad_loss_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        QuadraticLoss(**arguments)
