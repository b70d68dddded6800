"""Assembly: plans against brute force over all of them, closed forms, bounds.

Oracles: independent optima (tests/reference/assembly.json), all permutations tried here.
"""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from assembly_cases import cases, kind, measured, square

from rvjax import RVErrors, Status
from rvjax.assembly import Kind, Part, costs as costs_module, plan
from rvjax.assembly.choice import least_largest, least_sum, weigh
from rvjax.assembly.costs import best_turn, costs, good
from rvjax.assembly.supply import Supply
from rvjax.tolerances import Outcome, Requirement


def of_case(given):
    """Response of a reference case: |sum a x|, of vectors turned by their index."""
    signs = dict(zip(sorted(given["stock"]), given["a"]))

    def response(parts, index):
        if given["response"] == "sum":
            return jnp.abs(sum(a * parts[slot]["x"][0] for slot, a in signs.items()))
        x = y = 0.0
        for slot, a in signs.items():
            turn = 2 * math.pi * index[slot] / given["turns"][slot]
            u, v = parts[slot]["x"]
            x, y = x + a * (u * jnp.cos(turn) - v * jnp.sin(turn)), y + a * (u * jnp.sin(turn) + v * jnp.cos(turn))
        return jnp.hypot(x, y)

    return response


def kinds_of(given):
    return {
        slot: Kind(
            [Part(f"{slot}-{i}", {"x": np.array(x)}) for i, x in enumerate(values)],
            indices=given["turns"][slot],
            stock=given["pins_stock"] if slot == "pins" else None,
        )
        for slot, values in given["stock"].items()
    }


@pytest.mark.parametrize("case", [c for k in ("two", "three", "stock") for c in cases(k)], ids=lambda c: c["id"])
def test_plans_of_the_reference(case):
    given, expected = case["given"], case["expected"]
    response, kinds = of_case(given), kinds_of(given)
    wanted = {name: expected[name] for name in ("mean", "bottleneck")}
    requirement = Requirement(upper=given["limit"]) if "limit" in given else None
    if requirement:
        wanted["yield"] = expected["good"] / expected["units"]
    for objective, value in wanted.items():
        found = plan(response, kinds, objective=objective, requirement=requirement)
        assert found.objective == pytest.approx(value, rel=1e-9), objective
        assert found.status == "OPTIMAL" and found.gap == 0
        assert found.lower_bound == pytest.approx(value, rel=1e-9)
        assert len(found.build) == len(found.values) == expected["units"]
        assert found.random.value == pytest.approx(expected["random"], rel=1e-9)
        assert (found.random_yield is None) == (requirement is None)
        for unit, index, expected_value in zip(found.build, found.index, found.values):  # the list gives what it says
            parts = {slot: next(p.errors for p in kinds[slot].parts if p.id == id_) for slot, id_ in unit.items()}
            assert float(response(parts, index)) == pytest.approx(expected_value, rel=1e-12, abs=1e-18)


@pytest.mark.parametrize("case", [c for k in ("two", "stock") for c in cases(k)], ids=lambda c: c["id"])
def test_no_piece_is_built_twice_and_the_rest_is_left_over(case):
    kinds = kinds_of(case["given"])
    found = plan(of_case(case["given"]), kinds)
    for slot, own in kinds.items():
        used = sorted([unit[slot] for unit in found.build] + list(found.left_over[slot]))
        assert used == sorted(part.id for part, pieces in zip(own.parts, own.pieces) for _ in range(pieces))


def shared_plans(ids):
    """All ways to build ordered pairs from one stock."""
    if len(ids) < 2:
        yield []
        return
    for i, j in itertools.permutations(ids, 2):
        if i == min(ids) or j == min(ids):
            rest = [k for k in ids if k not in (i, j)]
            yield from ([(i, j), *more] for more in shared_plans(rest))


@pytest.mark.parametrize("seed", range(3))
def test_two_slots_of_one_stock_against_all_pairings(seed):
    x = np.random.default_rng(seed).standard_normal(6)
    stock = kind(x)

    def response(parts, index):
        return (parts["a"]["x"] + 0.4 * parts["b"]["x"] - 0.2) ** 2

    cost = (x[:, None] + 0.4 * x[None] - 0.2) ** 2
    sums = [[cost[pair] for pair in pairs] for pairs in shared_plans(list(range(6)))]
    found = plan(response, {"a": stock, "b": stock})
    assert found.objective == pytest.approx(min(map(np.mean, sums)), rel=1e-9) and found.status == "OPTIMAL"
    assert len({unit[slot] for unit in found.build for slot in "ab"}) == 6
    worst = plan(response, {"a": stock, "b": stock}, objective="bottleneck")
    assert worst.objective == pytest.approx(min(map(max, sums)), rel=1e-9)
    assert found.random.value == pytest.approx(cost[~np.eye(6, dtype=bool)].mean(), rel=1e-12)


def test_the_worst_unit_first_and_then_the_mean():
    """Several plans share the least largest cost; the one with the least mean is taken."""
    rng = np.random.default_rng(5)
    cost = np.round(rng.uniform(0, 1, (5, 5)), 1)
    table = jnp.asarray(cost)

    def response(parts, index):
        return table[parts["a"]["x"].astype(int), parts["b"]["x"].astype(int)]

    found = plan(response, {"a": kind(range(5)), "b": kind(range(5))}, objective="bottleneck")
    every = [
        (max(c), np.mean(c)) for c in ([cost[i, p[i]] for i in range(5)] for p in itertools.permutations(range(5)))
    ]
    assert (found.objective, found.values.mean()) == pytest.approx(min(every), rel=1e-12)


def test_squares_of_sums_are_sorted_against_each_other():
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, 60))
    found = plan(square, {"a": kind(a), "b": kind(b)})
    assert found.objective == pytest.approx(np.mean((np.sort(a) - np.sort(-b)) ** 2), rel=1e-12)
    assert found.random.value == pytest.approx(np.mean((a[:, None] + b) ** 2), rel=1e-12)
    assert found.gain.value == pytest.approx(found.random.value - found.objective, rel=1e-12)


def test_equal_parts_gain_nothing_and_keep_their_order():
    found = plan(square, {"a": kind([0.3] * 5), "b": kind([0.2] * 5, stock=[1, 2, 0, 1, 1])})
    assert found.gain.value == pytest.approx(0, abs=1e-15)
    assert [unit["a"] for unit in found.build] == [f"p{i}" for i in range(5)]
    assert [unit["b"] for unit in found.build] == ["p0", "p1", "p1", "p3", "p4"]
    stock = kind([0.3] * 6)
    assert [(u["a"], u["b"]) for u in plan(square, {"a": stock, "b": stock}).build][:2] == [("p0", "p1"), ("p2", "p3")]


def test_names_and_order_do_not_matter():
    rng = np.random.default_rng(7)
    a, b = rng.standard_normal((2, 9))
    kinds = {"a": measured(a, 0 * a, 0.5), "b": measured(b, 0 * b, 0.5)}
    shuffled = {}
    for slot, own in reversed(kinds.items()):
        parts = [Part(f"new-{part.id}", part.errors, part.sd) for part in own.parts]
        shuffled[slot] = Kind([parts[i] for i in rng.permutation(9)], population=own.population)
    first, second = (plan(square, given, certificate_draws=64) for given in (kinds, shuffled))
    assert first.objective == pytest.approx(second.objective, rel=1e-12)
    assert first.random.value == pytest.approx(second.random.value, rel=1e-12)
    pairs = {(f"new-{unit['a']}", f"new-{unit['b']}") for unit in first.build}
    assert pairs == {(unit["a"], unit["b"]) for unit in second.build}


def failing(parts, index):
    """Units whose sum exceeds a limit cannot be solved."""
    total = parts["a"]["x"] + parts["b"]["x"]
    status = jnp.where(total > 1.0, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
    return Outcome(total**2, status)


@pytest.mark.parametrize("objective", ["mean", "bottleneck", "yield"])
def test_a_unit_that_fails_is_avoided_and_what_cannot_be_is_named(objective):
    options = dict(objective=objective, requirement=Requirement(upper=100.0))
    good = plan(failing, {"a": kind([0.9, -3.0]), "b": kind([-0.5, 0.9])}, **options)
    assert good.status == "OPTIMAL" and np.isfinite(good.values).all() and not good.failing
    assert [unit["b"] for unit in good.build] == ["p0", "p1"]
    bad = plan(failing, {"a": kind([0.9, 0.8, -3.0]), "b": kind([0.9, 0.8, 0.7])}, **options)
    assert bad.status == "INFEASIBLE" and len(bad.failing) == 2 and np.isinf(bad.values).sum() == 2
    assert not np.isnan(bad.values).any() and bad.gap == 0
    assert not math.isnan(bad.objective)


@pytest.mark.parametrize("objective", ["mean", "yield", "bottleneck"])
def test_beyond_the_exact_size_the_bound_holds(objective):
    """Six units from 6, 8 and 8 parts: bound <= optimum (HiGHS) <= plan, and the gap is what lies between."""
    rng = np.random.default_rng(8)
    kinds = {slot: kind(rng.standard_normal(count)) for slot, count in zip("abc", (6, 8, 8))}

    def response(parts, index):
        return (parts["a"]["x"] + parts["b"]["x"] - 1.3 * parts["c"]["x"]) ** 2

    options = dict(objective=objective, requirement=Requirement(upper=0.05))
    best = plan(response, kinds, **options)
    found = plan(response, kinds, **options, exact_up_to=1)
    sign = -1 if objective == "yield" else 1
    assert best.status == "OPTIMAL" and sign * found.objective >= sign * best.objective - 1e-12
    assert sign * found.lower_bound <= sign * best.objective + 1e-12
    distance = abs(found.objective - found.lower_bound) / abs(found.objective)
    assert found.gap == pytest.approx(distance if found.status == "BOUNDED" else 0, abs=1e-6)
    assert found.objective == pytest.approx(best.objective, rel=0.25)
    if objective == "mean":
        assert found.lower_bound > 0.3 * best.objective


def test_a_plan_beyond_the_exact_size_is_not_called_optimal():
    """Random costs, whose Lagrangian bound lies below the optimum."""
    table = jnp.asarray(np.random.default_rng(1).uniform(0, 1, (6, 6, 6)))

    def response(parts, index):
        return table[tuple(parts[slot]["x"].astype(int) for slot in "abc")]

    kinds = {slot: kind(range(6)) for slot in "abc"}
    proved, bounded = plan(response, kinds), plan(response, kinds, exact_up_to=100)
    assert (proved.status, proved.gap) == ("OPTIMAL", 0)
    assert bounded.status == "BOUNDED" and bounded.gap > 0.1
    assert bounded.lower_bound < proved.objective <= bounded.objective


def test_one_stock_beyond_the_exact_size():
    x = np.random.default_rng(9).standard_normal(12)
    stock = kind(x)
    best = plan(square, {"a": stock, "b": stock})
    found = plan(square, {"a": stock, "b": stock}, starts=8, exact_up_to=1)
    assert found.objective == pytest.approx(best.objective, rel=1e-9)
    assert found.lower_bound <= best.objective * (1 + 1e-12)
    assert len({unit[slot] for unit in found.build for slot in "ab"}) == 12


def test_an_index_may_be_a_plain_integer():
    def response(parts, index):
        return (parts["a"]["x"] * float(np.cos(np.pi * index["a"])) - parts["b"]["x"]) ** 2

    kinds = {"a": kind([1.0, -2.0, 0.5], indices=2), "b": kind([-0.4, 1.1, 1.9])}
    found = plan(response, kinds)
    sign = [1.0, -1.0]
    every = [
        np.mean([min((s * a - b) ** 2 for s in sign) for a, b in zip([1.0, -2.0, 0.5], order)])
        for order in itertools.permutations([-0.4, 1.1, 1.9])
    ]
    assert found.objective == pytest.approx(min(every), rel=1e-12)
    assert {unit["a"]: index["a"] for unit, index in zip(found.build, found.index)}["p1"] == 1


def test_records_and_numbers_are_parts():
    """A field of a record that nobody measured stays 0.0 and gets no draws of its own."""
    clearance = [1e-6, 5e-6]
    pins = Kind([Part(i, RVErrors(bearing_clearance=c), 1e-7) for i, c in enumerate(clearance)])
    shims = Kind([Part(i, c) for i, c in enumerate([5e-6, 1e-6])])

    def response(parts, index):
        assert parts["pins"].pin_radius == 0.0  # plain, not traced
        return jnp.abs(parts["pins"].bearing_clearance - parts["shims"])

    found = plan(response, {"pins": pins, "shims": shims})
    assert [unit["shims"] for unit in found.build] == [1, 0]
    # |N(0, s^2)| has the mean s sqrt(2/pi); 1024 draws of two units
    assert found.objective == pytest.approx(1e-7 * math.sqrt(2 / math.pi), rel=0.1)


def test_a_second_plan_compiles_nothing(compiled):
    rng = np.random.default_rng(10)
    for _ in range(2):
        compiled.clear()
        a, b = rng.standard_normal((2, 6))
        kinds = {"a": measured(a, 0 * a, 0.5), "b": measured(b, 0 * b, 0.5)}
        plan(square, kinds, certificate_draws=32)
    assert not compiled


def test_a_good_unit_lies_between_both_limits():
    values = np.array([-2.0, -1.0, 0.0, 1.0, 2.0, np.nan])
    assert good(values, Requirement(lower=-1.0, upper=1.0)).tolist() == [False, True, True, True, False, False]
    assert good(values, None).tolist() == [True] * 5 + [False]


def test_positions_of_equal_yield_are_chosen_by_the_least_mean():
    mean = np.array([[3.0, 1.0, 2.0], [3.0, 1.0, 2.0]])
    outside = np.array([[0.0, 0.5, 0.0], [0.1, 0.1, 0.1]])
    assert best_turn(mean, outside, by_yield=True).tolist() == [2, 1]
    assert best_turn(mean, outside, by_yield=False).tolist() == [1, 1]


def test_sums_of_weighed_layers_order_like_the_layers():
    """Ten units: one bad unit less counts more than whatever the second layer saves on all of them."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, 3, 60).astype(float), rng.uniform(-5.0, 100.0, 60)
    cost = weigh([first, second], 10)
    plans = [rng.choice(60, 10) for _ in range(2000)]
    ranks = np.array([[first[p].sum(), second[p].sum(), cost[p].sum()] for p in plans])
    by_layers, by_cost = np.lexsort((ranks[:, 1], ranks[:, 0])), np.argsort(ranks[:, 2])
    np.testing.assert_allclose(ranks[by_layers, 2], ranks[by_cost, 2], rtol=1e-12)


class _Given:
    """A machine of two parts, one slot, with the responses of its positions and draws."""

    def __init__(self, responses):
        self.responses = np.asarray(responses, float)  # (parts, positions, draws)
        self.shape, self.indices = (len(self.responses),), np.arange(self.responses.shape[1])[:, None]

    def values(self, _, place, index, draw):
        return self.responses[place[:, 0], index[:, 0], draw]


def test_a_combination_that_fails_in_one_draw_has_no_mean():
    """Its position is not chosen, and the mean of a random assembly is that of the positions that work."""
    machine = _Given([[[1.0, np.nan], [4.0, 6.0]], [[1.0, 3.0], [7.0, 9.0]]])
    found = costs(machine, {}, 2, Requirement(upper=8.0), by_yield=False)
    assert found.index.tolist() == [1, 0] and found.mean.tolist() == [5.0, 2.0]
    assert found.every_mean.tolist() == [5.0, 5.0]
    assert found.outside.tolist() == [0.0, 0.0] and found.every_good.tolist() == [0.75, 0.75]


def test_the_bound_of_three_slots_is_that_of_the_pair_which_binds():
    """The cost depends on the first two slots alone: their matching is exact, and a pair with the third bounds less."""
    cost = np.array([[1.0, 5.0], [1.5, 4.0]])[:, :, None] + np.zeros((2, 2, 2))
    supply = Supply((np.ones(2, int), np.ones(2, int), np.ones(2, int)), (0, 1, 2), 2)
    found = least_largest(cost, supply, 2, np.random.default_rng(0), exact_up_to=0)
    assert found.bound == 4.0 and max(cost[unit] for unit in found.build) == 4.0 and found.exact


def test_a_class_of_several_pieces_may_be_used_several_times():
    """Two pieces of each first class fit best together: both units are of them, which HiGHS proves."""
    cost = np.ones((2, 2, 2))
    cost[0, 0, 0] = 0.0
    supply = Supply((np.array([2, 2]),) * 3, (0, 1, 2), 2)
    found = least_sum([cost], supply, 1, np.random.default_rng(0))
    assert found.exact and sorted(found.build) == [(0, 0, 0), (0, 0, 0)]


def test_positions_that_a_response_traces_share_one_program(monkeypatch):
    """A program for each of the four would be right too, and take four times as long to compile."""
    places, respond = [], costs_module.respond

    def counted(*given, at=None, **named):
        places.append(at)
        return respond(*given, **named) if at is None else respond(*given, at=at, **named)

    monkeypatch.setattr(costs_module, "respond", counted)
    kinds = {slot: kind(values, indices=2) for slot, values in {"a": [1.0, -2.0, 0.5], "b": [-0.4, 1.1, 1.9]}.items()}
    plan(lambda parts, index: jnp.abs(sum(x["x"] * (1 - 2 * index[slot]) for slot, x in parts.items())), kinds)
    assert places and set(places) == {None}
