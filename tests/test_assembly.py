"""Assembly: brute force over all plans, closed forms, promises that come true, bounds, bad input.

Oracles: independent optima (tests/reference/assembly.json), all permutations tried here, quadrature for what is known
of a part, drawn truth behind measured sets.
"""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from assembly_cases import cases
from scipy import integrate, stats

from rvjax import RVErrors, Status
from rvjax.assembly import Kind, Part, believed, opening, plan
from rvjax.assembly import choice as choosing
from rvjax.tolerances import Outcome, Requirement, Tolerance


def kind(values, **options):
    return Kind([Part(f"p{i}", {"x": value}) for i, value in enumerate(values)], **options)


def square(parts, index):
    return (parts["a"]["x"] + parts["b"]["x"]) ** 2


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


UNIT = Tolerance(-3.0, 3.0)  # N(0, 1)


def measured(truth, noise, sd, population=UNIT):
    population = None if population is None else {"x": population}
    parts = [Part(i, {"x": float(x + e)}, sd) for i, (x, e) in enumerate(zip(truth, noise))]
    return Kind(parts, population=population)


def test_unmeasured_parts_gain_nothing():
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 20))
    unseen = {"a": measured(a, 0 * a, math.inf), "b": measured(b, 0 * b, math.inf)}
    found = plan(square, unseen, certificate_draws=64)
    assert [unit["b"] for unit in found.build] == list(range(20))
    assert found.gain.lower < 0 < found.gain.upper
    # 64 draws of a mean over 20 units (each 2 chi2): sd of the mean 2 sqrt(2)/sqrt(20 * 64) = 0.08; five of these
    assert abs(found.objective - 2.0) < 0.4 and abs(found.random.value - 2.0) < 0.4


def test_many_parts_leave_what_the_gauge_does_not_see():
    """Spread left as a share of random: sqrt(s^2/(s0^2 + s^2)); a hundred parts miss their match by little.

    The promise is an expectation; what is left by chance is the unequal mean of both lots, (4/100)/2 of the square.
    """
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((2, 100))
    for sd in (0.5, 1.0):
        noise = sd * rng.standard_normal((2, 100))
        kinds = {"a": measured(a, noise[0], sd), "b": measured(b, noise[1], sd)}
        found = plan(square, kinds, draws=16, certificate_draws=48)
        share = math.sqrt(found.objective / found.random.value)
        assert share == pytest.approx(math.sqrt(sd**2 / (1 + sd**2)), rel=0.12)


def test_no_gain_is_promised_that_does_not_come_true():
    """30 measured sets, gauge as wide as the population: true - promised is 0 within its error; unshrunk it is not.

    Pairs of the true parts against the plan's own expectation; 4 standard errors.
    """
    rng = np.random.default_rng(6)
    off = {True: [], False: []}
    for _ in range(30):
        truth, noise = rng.standard_normal((2, 2, 24))
        for shrunk in (True, False):
            kinds = {
                slot: measured(x, e, 1.0 if shrunk else 0.0, UNIT if shrunk else None)
                for slot, x, e in zip("ab", truth, noise)
            }
            found = plan(square, kinds, draws=16, certificate_draws=32)
            true = [(truth[0][unit["a"]] + truth[1][unit["b"]]) ** 2 for unit in found.build]
            off[shrunk].append(np.mean(true) - found.objective)
    error = {shrunk: np.std(values, ddof=1) / math.sqrt(30) for shrunk, values in off.items()}
    assert abs(np.mean(off[True])) < 4 * error[True]
    assert np.mean(off[False]) > 5 * error[False]


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
def test_beyond_the_exact_size_the_bound_holds(monkeypatch, objective):
    """Six units from 6, 8 and 8 parts: bound <= optimum (HiGHS) <= plan, and the gap is what lies between."""
    rng = np.random.default_rng(8)
    kinds = {slot: kind(rng.standard_normal(count)) for slot, count in zip("abc", (6, 8, 8))}

    def response(parts, index):
        return (parts["a"]["x"] + parts["b"]["x"] - 1.3 * parts["c"]["x"]) ** 2

    options = dict(objective=objective, requirement=Requirement(upper=0.05))
    best = plan(response, kinds, **options)
    monkeypatch.setattr(choosing, "EXACT", 0)
    found = plan(response, kinds, **options)
    sign = -1 if objective == "yield" else 1
    assert best.status == "OPTIMAL" and sign * found.objective >= sign * best.objective - 1e-12
    assert sign * found.lower_bound <= sign * best.objective + 1e-12
    distance = abs(found.objective - found.lower_bound) / abs(found.objective)
    assert found.gap == pytest.approx(distance if found.status == "BOUNDED" else 0, abs=1e-6)
    assert found.objective == pytest.approx(best.objective, rel=0.25)
    if objective == "mean":
        assert found.lower_bound > 0.3 * best.objective


def test_one_stock_beyond_the_exact_size(monkeypatch):
    x = np.random.default_rng(9).standard_normal(12)
    stock = kind(x)
    best = plan(square, {"a": stock, "b": stock})
    monkeypatch.setattr(choosing, "EXACT", 0)
    found = plan(square, {"a": stock, "b": stock}, starts=8)
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


LAWS = [
    Tolerance(-1.0, 2.0, distribution="uniform"),
    Tolerance(-1.0, 2.0, distribution="triangular", shift=0.3),
    Tolerance(0.0, 2.0, distribution="rayleigh"),
    Tolerance(0.0, 2.0, distribution="lognormal", log_sd=0.4),
]


@pytest.mark.parametrize("tolerance", LAWS, ids=lambda t: t.distribution)
@pytest.mark.parametrize(("value", "sd"), [(0.7, 0.3), (0.7, 0.003), (1.9, 0.5)])
def test_what_is_known_of_a_part_against_quadrature(tolerance, value, sd):
    """Oracle: 400 points of Gauss over z, where the posterior lives. A kink of a law (triangular) costs the 129 nodes
    of spacing h an error of order h^2, 1e-3 of the spread."""

    def weight(z, power):
        errors = np.asarray(tolerance.deviate(jnp.asarray(z)))
        return stats.norm.pdf(z) * np.exp(-(((value - errors) / sd) ** 2) / 2) * errors**power

    grid = np.linspace(-8, 8, 3001)
    errors = np.asarray(tolerance.deviate(jnp.asarray(grid)))
    most = np.argmax(stats.norm.logpdf(grid) - ((value - errors) / sd) ** 2 / 2)
    centre, slope = grid[most], np.gradient(errors, grid)[most]
    ends = centre + np.array([-1, 1]) * min(8.0, 10 * sd / max(slope, 1e-3))
    moments = [integrate.fixed_quad(weight, *ends, args=(power,), n=400)[0] for power in range(3)]
    mean = moments[1] / moments[0]
    spread = math.sqrt(max(moments[2] / moments[0] - mean**2, 0))
    found = believed(value, sd, tolerance)
    assert found[0] == pytest.approx(mean, abs=2e-3 * sd)
    assert found[1] == pytest.approx(spread, rel=2e-2)


@pytest.mark.parametrize("case", cases("shrink"), ids=lambda case: case["id"])
def test_shrinkage_of_the_reference(case):
    given, expected = case["given"], case["expected"]
    found = believed(given["value"], given["sd"], Tolerance(**given["tolerance"]))
    assert found == pytest.approx((expected["mean"], expected["sd"]), rel=1e-12, abs=1e-22)


def test_the_ends_of_knowledge():
    for tolerance in (UNIT, *LAWS):
        assert believed(0.5, 0.0, tolerance) == (0.5, 0.0)
        mean, variance = tolerance.moments()[:2]
        assert believed(0.5, math.inf, tolerance) == pytest.approx((mean, math.sqrt(variance)), rel=2e-3)
    assert believed(0.5, 0.2, None) == (0.5, 0.2)
    mean, spread = believed(9.0, 0.1, LAWS[0])  # far beyond the limits: at the end
    assert 1.99 < mean <= 2 and spread < 0.01
    vector = Tolerance(0.0, 3e-6, distribution="rayleigh", shape=(2,))
    mean, spread = believed([1e-6, -1e-6], 1e-6, vector)  # two normal components of sd 1e-6
    np.testing.assert_allclose((mean, spread), ([0.5e-6, -0.5e-6], [math.sqrt(0.5) * 1e-6] * 2), rtol=1e-12)


def test_opening():
    """One part has no choice: factor 1 but for the chance of 20 sets. More parts open the tolerances, none beyond."""
    requirement = Requirement(upper=1.0)
    alone = opening(square, {"a": kind([0.0]), "b": kind([0.0])}, {"x": UNIT}, requirement=requirement, sets=20)
    assert alone.factor < 1.3 and (alone.curve[:, 1] == alone.curve[:, 2]).all()
    kinds = {"a": kind([0.0] * 8), "b": kind([0.0] * 8)}
    found = opening(square, kinds, {"a": {"x": UNIT}, "b": {"x": UNIT}}, requirement=requirement, sets=8)
    factors, matched, random = found.curve.T
    assert found.factor > 1.5 and factors[0] == 1 and found.target == random[0]
    assert (matched >= random - 1e-12).all() and (np.diff(random) < 0.02).all()
    assert all((y >= found.target) == (k <= found.factor) for k, y in zip(factors, matched))
    # N(0, 2): P(|sum| <= 1) = erf(1/2); 8 sets of 8 x 8 dependent pairs
    assert found.target == pytest.approx(math.erf(0.5), abs=0.12)
    blind = opening(lambda parts, index: 0.0 * parts["a"]["x"], kinds, {"x": UNIT}, requirement=requirement, sets=2)
    assert blind.factor == 64
    assert found.opened({"x": UNIT})["x"].half_width == pytest.approx(3.0 * found.factor)


def test_opening_with_a_gauge_opens_less():
    requirement = Requirement(upper=1.0)
    kinds = {slot: measured([0.0] * 8, np.zeros(8), 2.0, None) for slot in "ab"}
    exact = {slot: measured([0.0] * 8, np.zeros(8), 0.0, None) for slot in "ab"}
    rough, fine = (opening(square, k, {"x": UNIT}, requirement=requirement, sets=5).factor for k in (kinds, exact))
    assert 1 <= rough < fine


def test_a_second_plan_compiles_nothing(compiled):
    rng = np.random.default_rng(10)
    for number in range(2):
        compiled.clear()
        a, b = rng.standard_normal((2, 6))
        kinds = {"a": measured(a, 0 * a, 0.5), "b": measured(b, 0 * b, 0.5)}
        plan(square, kinds, certificate_draws=32)
        assert bool(compiled) == (number == 0) or number == 0
    assert not compiled


ONE = kind([1.0, 2.0])
BAD = [
    (lambda: Kind([Part("a", 1.0), Part("a", 2.0)]), "part 'a': this id stands there twice"),
    (lambda: Kind([]), "parts: there are none"),
    (lambda: kind([1.0], indices=0), "indices = 0: must be a whole number of at least 1"),
    (lambda: kind([1.0], indices=1.5), "indices = 1.5: must be a whole number of at least 1"),
    (lambda: kind([1.0], stock=[1, 2]), "stock: 2 numbers for 1 parts"),
    (lambda: kind([1.0], stock=[-1]), "stock = -1 of part 'p0': must be a whole number, 0 or more"),
    (lambda: kind([1.0], stock=[0]), "stock: there are no pieces"),
    (lambda: Part("a", {"x": math.nan}), "part 'a': x = nan: must be finite"),
    (lambda: Part("a", {"x": 1.0}, -1e-6), "part 'a': sd of x = -1e-06: must be zero or positive"),
    (lambda: Part("a", {"x": 1.0}, {"x": math.nan}), "part 'a': sd of x = nan: must be zero or positive"),
    (lambda: Part("a", {}), "part 'a': errors = {}: holds no number"),
    (lambda: plan(square, {"a": ONE}), "kinds: 1 slots, must be at least 2"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, objective="best"), "objective = 'best': must be one of mean, bott"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, objective="yield"), "requirement = None: objective 'yield' needs"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, draws=0), "draws = 0: must be a whole number of at least 1"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, confidence=1.0), "confidence = 1.0: must lie between 0 and 1"),
    (
        lambda: plan(square, {s: kind([1.0] * 300) for s in "abc"}),
        "300 x 300 x 300 combinations are more than 16777216",
    ),
    (
        lambda: plan(square, {"a": Kind([Part(0, 1.0), Part(1, {"x": 1.0})]), "b": ONE}),
        "a: the errors of part 1 have another structure",
    ),
    (lambda: believed(math.nan, 0.1, UNIT), "value = nan: must be finite"),
    (lambda: believed(1.0, -0.1, UNIT), "sd = -0.1: must be zero or positive"),
    (
        lambda: opening(square, {"a": ONE, "b": ONE}, {"y": UNIT}, requirement=Requirement(upper=1.0)),
        "tolerances: none of the parts' errors has one",
    ),
]


@pytest.mark.parametrize(("call", "message"), BAD, ids=lambda item: item if isinstance(item, str) else "")
def test_bad_input_is_one_line(call, message):
    with pytest.raises(ValueError, match=r".*") as error:
        call()
    assert message in str(error.value) and "\n" not in str(error.value)
