"""Plans where estimates lead and few combinations are evaluated, against those that evaluate all of them."""

import itertools
import math
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from assembly_cases import kind

from rvjax import Status
from rvjax.assembly import Kind, Part, costs, on_demand, plan
from rvjax.assembly.belief import draw, known
from rvjax.assembly.costs import Machine
from rvjax.tolerances import Outcome, Requirement

LIMIT = Requirement(upper=0.6)


def turned(parts, index):
    """Length of three vectors, the second in one of two positions; lengths above 4 fail."""
    sign = 1 - 2 * index["b"]
    x = parts["a"]["x"] + sign * parts["b"]["x"] - 1.3 * parts["c"]["x"]
    failed = jnp.where(jnp.abs(x) > 4, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
    return Outcome(jnp.abs(x), failed)


def kinds_of(seed, counts=(5, 6, 7), **options):
    rng = np.random.default_rng(seed)
    return {
        slot: kind(rng.standard_normal(count), indices=2 if slot == "b" else 1, **options)
        for slot, count in zip("abc", counts)
    }


few = partial(plan, most_valued=1)
"""Any number of combinations counts as too many."""


def fewer(*given, **options):
    """As few combinations as possible are evaluated to fit the estimates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(on_demand, "PILOTS", 12)
        return few(*given, **options)


@pytest.mark.parametrize("objective", ["mean", "bottleneck", "yield"])
def test_the_plan_on_demand_and_its_bound_against_the_plan_of_all_combinations(objective):
    """A part of the combinations is evaluated; the bound lies below the proved optimum."""
    for seed in range(4):
        kinds, options = kinds_of(seed), dict(objective=objective, requirement=LIMIT)
        best, found = plan(turned, kinds, **options), fewer(turned, kinds, **options)
        assert best.status == "OPTIMAL" and best.valued == best.combinations == 210
        if objective == "yield":
            assert best.objective - 0.21 < found.objective <= best.objective
            assert found.lower_bound == 1 and found.gap == pytest.approx((1 - found.objective) / found.objective)
        else:
            assert best.objective - 1e-12 <= found.objective <= 2 * best.objective
            assert found.lower_bound <= best.objective + 1e-12 and found.checks >= 10
            assert found.gap == pytest.approx((found.objective - found.lower_bound) / found.objective)
        assert found.valued < 0.5 * found.combinations
        assert found.status == "BOUNDED"
        for unit, index, value in zip(found.build, found.index, found.values):
            x = {slot: own.parts[int(unit[slot][1:])].errors for slot, own in kinds.items()}
            assert float(turned(x, index).value) == pytest.approx(value, rel=1e-12)
            other = float(turned(x, index | {"b": 1 - index["b"]}).value)
            assert value <= other * (1 + 1e-12)  # the better position
        for slot in kinds:
            assert len({unit[slot] for unit in found.build}) == 5


def test_the_bound_of_rough_estimates_needs_their_margin(monkeypatch):
    """A response that no regression follows: the estimates alone promise more than the proved optimum."""

    def wavy(parts, index):
        x = parts["a"]["x"] + parts["b"]["x"] - 1.3 * parts["c"]["x"]
        return x**2 + 2 * jnp.sin(5 * x + parts["b"]["x"])

    promised = []
    for seed in range(4):
        kinds = {slot: Kind(own.parts) for slot, own in kinds_of(seed).items()}
        best, found = plan(wavy, kinds), fewer(wavy, kinds)
        assert best.status == "OPTIMAL" and found.lower_bound <= best.objective <= found.objective + 1e-12
        with monkeypatch.context() as patch:
            patch.setattr(on_demand.OnDemand, "margin", property(lambda self: 0.0, lambda self, value: None), False)
            promised.append(fewer(wavy, kinds).lower_bound - best.objective)
    assert max(promised) > 0


def test_each_combination_is_valued_once_and_few_of_them(monkeypatch):
    lanes, real = [], costs.valued

    def counted(machine, drawn, draws, requirement, cells):
        lanes.extend(cells)
        return real(machine, drawn, draws, requirement, cells)

    monkeypatch.setattr(on_demand, "valued", counted)  # a Plan counts them; this lists them
    found = fewer(turned, kinds_of(1, (12, 13, 14)), starts=2)
    assert found.valued == len(lanes) == len(set(lanes))
    assert found.combinations == 12 * 13 * 14 and 53 <= found.valued < 0.2 * found.combinations


def test_one_stock_for_two_slots_on_demand():
    rng = np.random.default_rng(3)
    stock, third = kind(rng.standard_normal(8)), kind(rng.standard_normal(4))
    kinds = {"a": stock, "b": stock, "c": third}

    def response(parts, index):
        return jnp.abs(parts["a"]["x"] + 0.5 * parts["b"]["x"] - parts["c"]["x"])

    found, best = few(response, kinds), plan(response, kinds)
    assert best.objective - 1e-12 <= found.objective <= 1.1 * best.objective + 1e-9
    assert len({unit[slot] for unit in found.build for slot in "ab"}) == 8


@pytest.mark.parametrize("objective", ["mean", "bottleneck", "yield"])
def test_failing_units_are_avoided_or_named(objective):
    x = {"a": [3.5, 0.0], "b": [3.6, 0.1], "c": [0.0, 9.0]}  # a unit with 9.0 always fails
    options = dict(objective=objective, requirement=Requirement(upper=3.9))
    kinds = {slot: kind(values, indices=2 if slot == "b" else 1) for slot, values in x.items()}
    found = few(turned, kinds, **options)
    assert found.status == "INFEASIBLE" and len(found.failing) == 1
    kinds["c"] = kind([0.0, 0.1])
    found = few(turned, kinds, **options)
    assert found.status in ("BOUNDED", "SEARCHED", "OPTIMAL") and not found.failing and np.isfinite(found.values).all()

    # With 4.5 and 0 one unit fails; 3 and 1.5 have the larger sum.
    kinds = {slot: kind(values) for slot, values in {"a": [3.0, 0.0], "b": [1.5, 0.0], "c": [0.0, 0.0]}.items()}
    assert sorted(few(turned, kinds, **options).values) == [1.5, 3.0]


def test_good_units_come_before_the_mean():
    """3 and 3 have the least sum of squares, 0 and 6 the one good unit."""
    kinds = {"a": kind([0.0, 3.0]), "b": kind([0.0, 3.0]), "c": kind([0.0, 0.0])}

    def response(parts, index):
        return (parts["a"]["x"] + parts["b"]["x"] + parts["c"]["x"]) ** 2

    options = dict(requirement=Requirement(upper=1.0))
    assert sorted(few(response, kinds, **options).values) == [9.0, 9.0]
    found = few(response, kinds, objective="yield", **options)
    assert sorted(found.values) == [0.0, 36.0] and found.objective == 0.5 and found.gap == 1.0


def test_random_assembly_is_drawn_where_all_parts_are_known():
    kinds = kinds_of(2)
    every = [
        float(turned(dict(zip("abc", parts)), {"a": 0, "b": k, "c": 0}).value)
        for *parts, k in itertools.product(*([p.errors for p in own.parts] for own in kinds.values()), (0, 1))
    ]
    kept = [value for value in every if value <= 4]
    assert few(turned, kinds).random.value == pytest.approx(np.mean(kept), rel=1e-9)


def test_the_number_decides():
    class Few:
        shape, indices = (10, 10), np.zeros((3, 2))

    assert not on_demand.too_many(Few, 7, 300 * 7) and on_demand.too_many(Few, 8, 300 * 7)


def interrupting(monkeypatch, name, after):
    """Ctrl-C at this call of a method."""
    calls, real = itertools.count(), getattr(on_demand.OnDemand, name)

    def method(self, at):
        if next(calls) == after:
            raise KeyboardInterrupt
        return real(self, at)

    monkeypatch.setattr(on_demand.OnDemand, name, method)


@pytest.mark.parametrize(("name", "after", "left", "off"), [("led", 1, 32, 0), ("led", 60, 30, 1), ("look", 0, 1, 0)])
def test_an_interrupted_search_keeps_its_best_plan(monkeypatch, name, after, left, off):
    """Of equal estimates rounding decides which is led first: after 60 steps one branch more or less may be left."""
    kinds = kinds_of(2, (12, 13, 14))
    interrupting(monkeypatch, name, after)
    found = few(turned, kinds, keep_best=True)
    assert (
        found.status == "SEARCHED"
        and found.unsearched
        and abs(found.unsearched - left) <= off
        and found.lower_bound == -math.inf
    )
    assert len(found.build) == 12 and all(len({unit[slot] for unit in found.build}) == 12 for slot in kinds)
    whole = few(turned, kinds, keep_best=True)
    assert whole.unsearched == 0 and whole.status == "BOUNDED" and whole.objective <= found.objective


def test_an_interruption_passes_where_no_plan_is_kept(monkeypatch):
    interrupting(monkeypatch, "led", 5)
    with pytest.raises(KeyboardInterrupt):
        few(turned, kinds_of(2, (12, 13, 14)))


def uncertain(sd):
    """Parts of three slots with measurement errors."""
    rng = np.random.default_rng(5)
    values = {slot: rng.standard_normal(count) for slot, count in zip("abc", (6, 7, 5))}
    parts = {slot: [Part(f"p{k}", {"x": x}, sd=sd) for k, x in enumerate(own)] for slot, own in values.items()}
    return {slot: Kind(own, indices=2 if slot == "b" else 1) for slot, own in parts.items()}


def screened(response, kinds, most, draws=8):
    """All exact costs, and their estimates from 40 of them; combinations x positions."""
    slots = {slot: known(one, slot) for slot, one in kinds.items()}
    machine, drawn = Machine(response, slots), draw(slots, 0, 0, draws, alike=True)
    every = np.arange(math.prod(machine.shape))
    exact = costs.valued(machine, drawn, draws, None, every)[0]
    pilots = np.random.default_rng(0).choice(every, 40, replace=False)
    return exact, on_demand.screen(machine, drawn, draws, most, pilots, exact[pilots])


def test_a_quadratic_response_and_the_root_of_one_are_estimated_exactly():
    """Also with draws of what is not known, over which the mean of a quadratic response is one too."""
    kinds = uncertain(0.3)

    def square(parts, index):
        return (parts["a"]["x"] + (1 - 2 * index["b"]) * parts["b"]["x"] - parts["c"]["x"] + 0.2) ** 2 + 1

    exact, found = screened(square, kinds, 1)
    np.testing.assert_allclose(found.mean, exact.min(axis=1), rtol=1e-9)
    assert found.margin < 1e-9 and found.checks == 10
    exact, found = screened(lambda parts, index: jnp.sqrt(square(parts, index)), kinds_of(5, (6, 7, 5)), 1, 1)
    np.testing.assert_allclose(found.mean, exact.min(axis=1), rtol=1e-9)


def test_few_draws_estimate_what_no_regression_does():
    """Of a folded response of two slots; antithetic draws. The margin covers every error."""
    kinds = uncertain(0.01)

    def folded(parts, index):
        return jnp.abs(jnp.sin(9 * parts["a"]["x"]) + parts["b"]["x"]) + index["b"]

    by_draws, by_regression = (screened(folded, kinds, most) for most in (6 * 7 * 5 * 2 * 2, 1))
    errors = [found.mean - exact.min(axis=1) for exact, found in (by_draws, by_regression)]
    assert np.std(errors[0]) < 0.05 * np.std(errors[1])
    assert errors[0].max() <= by_draws[1].margin < 3 * errors[0].max()


def test_positions_that_make_no_difference_are_estimated_once():
    same, other = np.array([[1.0, 1.0, 2.0], [3.0, 3.0, 1.0], [2.0, 2.0, 5.0]]), np.eye(3)
    assert on_demand._distinct(same).tolist() == [0, 2] and on_demand._distinct(other).tolist() == [0, 1, 2]
