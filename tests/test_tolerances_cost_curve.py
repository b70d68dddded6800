"""Allocation seen from its requirements: shadow prices, requirement curves, grades beside free fields, many fields.

Oracles: the closed form of a linear response with costs 1/t (sqrt(sum a_j^2 t_j^2) = 3 L / z(target), hence a cost
~ z/L), and finite differences of the allocated cost itself. A sample of 16384 units knows the quantiles of these
targets to 1 %. Prices are judged to 4 %.
"""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from codesign_cases import one_start

from rvjax.response.derivatives import pulled
from rvjax.response.response import respond
from rvjax.tolerances import (
    Exponential,
    Middle,
    ReciprocalPower,
    Requirement,
    Tolerance,
    allocate,
    cost_curve,
    it_width,
    monte_carlo,
    rss,
    worst_case,
)
from rvjax.tolerances.allocation import cost as costs_module
from rvjax.tolerances.allocation.grades import Grades
from rvjax.tolerances.allocation.problem import problem_of
from rvjax.tolerances.allocation.programme import COARSE
from rvjax.tolerances.allocation.search import Search
from rvjax.units import mm, um
from tests.oracles.linear_pair import COSTS, LIMIT, PAIR, WIDE, above, closed_cost, linear, radius, share, two
from tests.oracles.programs import programs
from tests.oracles.responses import Largest, Linear, Made


def bent(e):
    """No closed form: a root sum of squares beside a linear part."""
    return jnp.sqrt((10 * um) ** 2 + e["a"] ** 2 + 3 * e["b"] ** 2) - 10 * um + 0.3 * e["a"]


@pytest.mark.long  # the optima in print of test_tolerances_optimality.py run by default
def test_closed_form_within_one_percent():
    found = allocate(
        linear,
        PAIR,
        Requirement(lower=-LIMIT, upper=LIMIT),
        costs=COSTS,
        samples=65536,
        certificate_samples=4_000_000,
    )
    assert found.status == "OPTIMAL"
    assert found.cost == pytest.approx(closed_cost(0.9973), rel=0.01)


@pytest.mark.long  # 12 fields of test_tolerances_optimality.py run by default
@pytest.mark.parametrize("count", [20, 60, 200])
def test_many_fields(count):
    """Costs c_j/t and slopes a_j: t_j ~ (c_j/a_j^2)^(1/3)."""
    names = [f"e{k:03d}" for k in range(count)]
    slope = dict(zip(names, np.linspace(0.2, 3.0, count)))
    scale = dict(zip(names, 1 + np.arange(count) % 7))
    tolerances = {n: Tolerance.symmetric(5 * um) for n in names}
    response = Linear({n: float(a) for n, a in slope.items()})
    row = {"e": Tolerance.symmetric(5 * um, shape=(count,))}
    summed = lambda e: jnp.sum(np.array(list(slope.values())) * e["e"])  # noqa: E731
    assert rss(summed, row).sd == pytest.approx(5 / 3 * um * math.sqrt(sum(a**2 for a in slope.values())), rel=1e-12)
    assert worst_case(summed, row).upper == pytest.approx(5 * um * sum(slope.values()), rel=1e-12)
    costs = {n: ReciprocalPower(finest=0.1 * um, coarsest=1000 * um, scale=float(scale[n])) for n in names}
    found = allocate(
        response,
        tolerances,
        Requirement(lower=-LIMIT, upper=LIMIT),
        costs=costs,
        samples=4096,
        certificate_samples=49_152,
    )
    shape = np.array([(scale[n] / slope[n] ** 2) ** (1 / 3) for n in names])
    t = shape * radius(0.9973) / math.sqrt(sum((slope[n] * s) ** 2 for n, s in zip(names, shape)))
    best = sum(scale[n] * 10 * um / tj for n, tj in zip(names, t))
    assert found.status == "OPTIMAL"
    assert best * 0.99 < found.cost < best * 1.08  # the certificate of 49 152 units costs 4 %
    reached = math.sqrt(sum((slope[n] * found.half_widths[n]) ** 2 for n in names)) / radius(0.9973)
    assert found.cost * reached < best * 1.01  # scaled to the limit: what the shape alone costs


@pytest.fixture(scope="module")
def of_bent():
    options = dict(samples=16384, certificate_samples=20_000)
    costs = {"a": WIDE, "b": Exponential(decay=8 * um, finest=1 * um, coarsest=100 * um, scale=4.0)}
    return cost_curve(
        bent, PAIR, Requirement(upper=12 * um), costs=costs, values=np.array([11, 12, 13]) * um, **options
    )


def test_shadow_prices_are_the_slope_of_the_curve(of_bent):
    low, middle, high = of_bent.learned
    slope = (high - low) / (2 * um)
    assert of_bent.multipliers[1] == pytest.approx(slope, rel=0.04)
    assert of_bent.multipliers[0] < of_bent.multipliers[1] < of_bent.multipliers[2] < 0
    assert low > middle > high
    assert all(cost >= learned for cost, learned in zip(of_bent.costs, of_bent.learned))
    assert {a.status for a in of_bent.allocations} == {"OPTIMAL"}


def test_each_point_starts_from_the_last(of_bent):
    assert of_bent.values == pytest.approx((11 * um, 12 * um, 13 * um))
    for before, after in zip(of_bent.allocations, of_bent.allocations[1:]):
        assert after.history[0]["half_widths"] == pytest.approx(before.half_widths)
    assert sum(of_bent.evaluations[1:]) < 2 * of_bent.evaluations[0]


@pytest.mark.parametrize("costly", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_curve_of_yields_is_that_of_the_closed_form(costly, thorough):
    """Costs of targets on either side of the required one, in any order; one that no half-width meets is left out.

    A point costs what the sample says, and tells the share of independent units.
    """
    parts = {name: one.replace(size=None) for name, one in PAIR.items()} | {"c": Tolerance.symmetric(1 * um)}
    need = {"y": Requirement(lower=-LIMIT, upper=LIMIT, target=0.95)}
    response = Made((1.0, 2.0, 0.0), costly=costly)
    options = dict(costs=COSTS, samples=4096, certificate_samples=20_000, yields=[0.8, 0.99, 0.95, 0.9])
    found = allocate(response, parts, need, **options)
    assert found.status == "OPTIMAL" and len(found.curve) == 4
    targets, count = (0.8, 0.9, 0.95, 0.99), 4096 if costly else 65_536
    for (seen, cost), target in zip(found.curve, targets):
        assert abs(above(seen, target, min(count, 20_000))) < (8 if costly else 4)  # of both samples
        assert cost == pytest.approx(closed_cost(target), rel=0.05 if costly else 0.01)
    assert [seen for seen, _ in found.curve] == sorted(seen for seen, _ in found.curve)
    if costly:  # of the first units of the certificate, of which only those near a limit were solved
        widths = {look["cost"]: look["half_widths"] for look in found.history}
        for seen, cost in found.curve:
            own = parts | {name: parts[name].with_half_width(width) for name, width in widths[cost].items()}
            whole = monte_carlo(response, own, samples=4096, seed=found.certificate.seed, requirements=need)
            assert seen == whole.yield_["y"].value
        assert found.evaluations["certificates"] % found.certificate.samples  # not only whole certificates
    if not thorough:
        return
    again = allocate(response, parts, need, **(options | dict(yields=())))
    assert again.curve == [] and (again.cost, again.history) == (found.cost, found.history[: len(again.history)])


def test_a_curve_of_yields_pays_for_moved_mid_points():
    """+-L about 10 um: the mid-point of b would move 5 um, and moves less where 1 um costs 0.05."""
    moved = {"b": Middle(-5 * um, 5 * um, scale=0.05 / um)}
    need = {"": Requirement(lower=-LIMIT + 10 * um, upper=LIMIT + 10 * um, target=0.95)}
    with one_start():
        found = allocate(linear, PAIR, need, costs=COSTS, middles=moved, yields=[0.95], certificate_samples=20_000)
    middle = float(found.tolerances["b"].middle)
    assert 3 * um < middle < 5 * um
    assert found.cost - sum(found.costs.values()) == pytest.approx(0.05 / um * middle)
    ((_, cost),) = found.curve
    assert cost == pytest.approx(found.learned, rel=5e-3)  # the target is that of the allocation


@pytest.mark.long  # test_tolerances_responses.py counts the programs of an allocation
def test_a_cost_curve_compiles_no_further_program(of_bent):
    count = lambda: [programs(respond, bent), programs(pulled, bent), costs_module._along._cache_size()]  # noqa: E731
    before = count()
    first = of_bent.allocations[0]
    costs = {"a": WIDE, "b": Exponential(decay=9 * um, finest=1 * um, coarsest=90 * um, scale=3.0)}
    options = dict(samples=16384, certificate_samples=20_000)
    curve = cost_curve(bent, first.tolerances, Requirement(upper=1.0), costs=costs, values=(11.5 * um,), **options)
    assert curve.costs[0] > 0
    assert count() == before


@pytest.mark.long  # the curves against limits run by default
def test_curve_against_the_target():
    """The cost grows like z(target); of two requirements only the named one moves."""
    targets = (0.9, 0.99, 0.999)
    curve = cost_curve(
        linear,
        PAIR,
        Requirement(lower=-LIMIT, upper=LIMIT),
        costs=COSTS,
        values=targets,
        against="target",
        samples=65536,
        certificate_samples=1_000_000,
    )
    assert curve.costs == pytest.approx([closed_cost(target) for target in targets], rel=0.02)
    assert curve.allocations[0].certificate.yield_.lower >= 0.9
    assert all(math.isnan(price) for price in curve.multipliers)


def test_curve_against_one_of_two_limits(thorough):
    required = {"y": Requirement(lower=-LIMIT, upper=LIMIT, target=0.99), "b": Requirement(upper=1.0)}
    wide = (40 * um, 20 * um) if thorough else (20 * um,)
    curve = cost_curve(two, PAIR, required, of="y", costs=COSTS, values=(*wide, 1 * um), certificate_samples=20_000)
    assert curve.learned[:-1] == pytest.approx([closed_cost(0.99, limit) for limit in wide], rel=0.03)
    assert curve.multipliers[-2] == pytest.approx(-curve.learned[-2] / (20 * um), rel=0.04)
    assert math.isnan(curve.costs[-1]) and not curve.allocations[-1].feasible
    idle = curve.allocations[0]
    assert idle.multipliers["b"] == 0.0 > idle.multipliers["y"] and idle.shortfall == {"y": 0.0, "b": 0.0}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (dict(against="cost"), "against = 'cost': must be one of limit, target"),
        (dict(of="y"), "there is only one requirement"),
        (dict(values=()), "values: needs at least one"),
    ],
)
def test_bad_curves_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        cost_curve(linear, PAIR, Requirement(upper=LIMIT), costs=COSTS, **{"values": (LIMIT,), **options})
    both = {"y": Requirement(upper=LIMIT), "z": Requirement(upper=LIMIT)}
    with pytest.raises(ValueError, match="name the requirement whose limit moves, one of y, z"):
        cost_curve(linear, PAIR, both, costs=COSTS, values=(LIMIT,))


def test_free_fields_take_up_what_the_grades_leave():
    """a is snapped to a grade; b is what the closed-form limit then allows."""
    sized = PAIR | {"b": PAIR["b"].replace(size=None)}
    requirement = Requirement(lower=-LIMIT, upper=LIMIT)
    units = 80_000
    found = allocate(linear, sized, requirement, costs=COSTS, samples=4096, certificate_samples=units, grades=True)
    graded = found.graded
    assert list(graded.grades) == ["a"]
    a = it_width(graded.grades["a"], 25 * mm) / 2
    assert graded.half_widths["a"] == pytest.approx(a)
    assert 0 < above(share(graded.half_widths), 0.9973, units) < 5
    assert graded.half_widths["b"] != found.half_widths["b"]
    assert graded.certificate.verdicts.estimate.lower >= 0.9973
    # The cheapest of all grades, each with the b that the closed form leaves.
    reach = radius(share(graded.half_widths))
    halves = [it_width(f"IT{k}", 25 * mm) / 2 for k in range(1, 12)]
    halves = [t for t in halves if 1 * um <= t and t < reach]
    total = [10 * um / t + 20 * um / math.sqrt(reach**2 - t**2) for t in halves]
    assert graded.cost == pytest.approx(min(total), rel=1e-6)


def test_a_free_field_of_little_cost_is_fitted_to_the_grades_too(monkeypatch):
    """Its half-width begins at a third of the best one, which costs 0.4 % more; graded half-widths stay."""
    response = Largest({"y": ({"a": 1.0, "b": 2.0},), "c": ({"c": 1.0}, {"c": -1.0})})
    costs = COSTS | {"c": WIDE.replace(reference=0.1 * um)}
    tolerances = {"a": PAIR["a"]} | {name: PAIR["b"].replace(size=None) for name in "bc"}
    need = dict.fromkeys("yc", Requirement(upper=LIMIT, target=0.99))
    problem = problem_of(
        response, tolerances, need, costs=costs, samples=4096, seed=0, certificate_samples=20_000, confidence=0.95,
        correlation=None, joint_target=None, middles={}, variables={}, objective={}, losses=None, max_steps=100,
        memo=None, progress=False,
    )  # fmt: skip
    search = Search(problem)
    near = search.constraints.look(search.learned().look.x - np.array([0.0, 0.0, 1.0]))
    assert near.used[1] < 0.5
    places, look = Grades(search)._cheapest(near)
    assert list(places) == [0] and look.used == pytest.approx(1.0, abs=2e-3)
    fitted = Grades._fitted

    def missing(self, places, near, gain):
        look = fitted(self, places, near, gain)
        return look if gain == COARSE else dataclasses.replace(look, used=look.used + 0.01)

    monkeypatch.setattr(Grades, "_fitted", missing)
    assert Grades(search)._cheapest(near)[1].excess < 1e-3  # the rough set is kept where the accurate one misses


@pytest.mark.long  # a response in steps of test_tolerances_optimality.py has the same history
def test_the_learned_cost_is_that_of_an_accepted_set():
    half, scales = {k: Tolerance.symmetric(1.0) for k in "ab"}, dict(a=1.0, b=3.0)
    costs = {k: ReciprocalPower(finest=0.1, coarsest=3.0, reference=1.0, scale=scale) for k, scale in scales.items()}
    steps = lambda e: jnp.floor(8 * jnp.abs(e["a"] + e["b"])) / 8  # noqa: E731
    required = Requirement(upper=0.6, target=0.95)
    options = dict(costs=costs, samples=512, certificate_samples=512)
    curve = cost_curve(steps, half, required, values=(0.6,), **options)
    tried = {trial["cost"]: trial["margins"]["response"] for trial in curve.allocations[0].history}
    assert tried[curve.learned[0]] <= 0.0
    assert min(tried) < curve.learned[0]  # others were cheaper, and refused


@pytest.mark.long  # test_tolerances_allocation_bounds.py ends at the finest half-widths
def test_a_curve_at_the_finest_half_widths():
    """They just meet the target, each at a cost of 1/0.5."""
    half = {k: Tolerance.symmetric(1.0) for k in "ab"}
    costs = dict.fromkeys("ab", ReciprocalPower(finest=0.5, coarsest=2.0, reference=1.0))
    limit = 0.5 / 3 * math.sqrt(2) * 1.959964  # of 95 % at the finest
    required = Requirement(lower=-limit, upper=limit, target=0.95)
    options = dict(costs=costs, samples=1000, seed=1, certificate_samples=20_000)
    curve = cost_curve(Linear({"a": 1.0, "b": 1.0}), half, required, values=(0.95,), against="target", **options)
    assert curve.allocations[0].half_widths == {"a": 0.5, "b": 0.5} and curve.allocations[0].feasible
    assert curve.learned == pytest.approx((4.0,), rel=5e-3)
