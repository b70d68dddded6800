"""Certificates, lists, grades and mid-points of an allocation with variables: closed forms and brute force."""

import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from codesign_cases import COST, levered, one_start
from scipy import optimize, stats

from rvjax import Status
from rvjax.population import Population
from rvjax.records import Record, field, record
from rvjax.tolerances import (
    Middle,
    Nominal,
    Outcome,
    ReciprocalPower,
    Requirement,
    Tolerance,
    Variable,
    allocate,
    it_width,
)
from rvjax.tolerances.allocation.decisions import Decisions, Lists
from rvjax.tolerances.allocation.sample import Units
from rvjax.units import mm, um
from tests.oracles.responses import Linear

TARGET, UNITS = 0.999, 50_000
RARE = 2 * stats.norm.sf(3.0)  # share of the units with |c| > 3


@record
class Rare(Record):
    """A lever with another slope to a in rare units."""

    slope: Any = field("-", "in units with |c| > 3")

    def __call__(self, e, v):
        """Its best length is 1."""
        lever = (v["arm"] + 1 / v["arm"]) / 2
        return {"y": lever * (jnp.where(jnp.abs(e["c"]) > 3.0, self.slope, 1.0) * e["a"] + e["b"])}


@pytest.fixture(scope="module")
def few_units():
    """Allocations with another slope to a in rare units, of which a sample has a dozen."""

    @one_start()
    def found(slope):
        parts = {"a": Tolerance.symmetric(0.1), "b": Tolerance.symmetric(0.1), "c": Tolerance.symmetric(3.0)}
        return allocate(
            Rare(slope), parts, {"y": Requirement(lower=-1.0, upper=1.0, target=TARGET)}, samples=128, seed=1,
            costs=dict.fromkeys("ab", COST), variables={"arm": Variable(0.4, 3.0, 2.0)}, certificate_samples=UNITS,
        )  # fmt: skip

    return {slope: found(slope) for slope in (1.0, 10.0)}


@pytest.mark.long  # test_tolerances_search.py has certificates that correct, and one that makes a result dearer
def test_a_certified_cost_far_above_the_learned_one_is_not_optimal(few_units):
    for found in few_units.values():
        assert (found.status == "SUBOPTIMAL") == (found.cost > 1.2 * found.learned)
    assert few_units[1.0].status == "OPTIMAL"


def beyond(a, b, slope, lever=1.0):
    """Share of the units beyond the limit of 1."""
    usual, rare = (2 * stats.norm.sf(3 / lever / math.hypot(s * a, b)) for s in (1.0, slope))
    return (1 - RARE) * usual + RARE * rare


def least_cost(share, slope):
    """Least 1/a + 1/b with this share of good units, at the best length of the lever."""
    met = {"type": "ineq", "fun": lambda x: math.log((1 - share) / beyond(*np.exp(x), slope))}
    return optimize.minimize(
        lambda x: np.exp(-x).sum(), np.log([0.2, 0.4]), bounds=[(-2.0, 0.5)] * 2, constraints=[met]
    ).fun


@pytest.mark.long
@pytest.mark.parametrize("slope", [1.0, 10.0])
def test_certificates_correct_what_few_units_taught(few_units, slope):
    """The true share keeps the target, at a cost within 10 % of the least that a certificate shows for certain."""
    found = few_units[slope]
    a, b, arm = *found.half_widths.values(), found.values["arm"]
    assert beyond(a, b, slope, (arm + 1 / arm) / 2) <= 1 - TARGET
    certain = TARGET + 5 * math.sqrt(TARGET * (1 - TARGET) / UNITS)
    assert least_cost(TARGET, slope) < found.cost < 1.1 * least_cost(certain, slope)


@pytest.mark.long  # test_tolerances_allocation.py has them without a number of the design
def test_units_too_few_for_any_certificate_certify_nothing():
    """1000 units without a reject show a share of 1000/1003.84 = 99.62 %, not 99.73 %."""
    found = levered(samples=256, certificate_samples=1000, joint_target=0.9973)
    assert found.feasible and found.status == "NOT_CERTIFIED"


FIVE = (1.3, 0.4, 2.1, 0.9, 1.7)  # in no order


def listed(among, costs, need):
    """Numbers from lists at the least cost with sqrt(x y z) large enough; no errors."""
    names = "xyz"[: len(costs)]
    given = {n: Variable(0.3, 3.0, cost=cost, among=among) for n, cost in zip(names, costs)}
    with one_start():
        found = allocate(
        lambda e, v: {"size": jnp.sqrt(math.prod(v[n] for n in names)) + 0.0 * e["a"]}, {"a": Tolerance(0.0, 0.0)},
        {"size": Nominal(lower=need)}, costs={}, variables=given,
    )  # fmt: skip
    price, best = min(
        (sum(cost(v) for cost, v in zip(costs, values)), values)
        for values in itertools.product(among, repeat=len(costs))
        if math.sqrt(math.prod(values)) >= need
    )
    return found, price, dict(zip(names, best))


@pytest.mark.parametrize("count", [pytest.param(2, marks=pytest.mark.long), 3])
def test_numbers_of_lists_are_the_cheapest_that_meet_the_limit(count):
    """All 25 or 125 combinations, of which the search tries a part; the cheapest of all breaks the limit."""
    found, price, best = listed(FIVE, [lambda v: v**2, lambda v: 2.3 * v, lambda v: 1.1 * v**3][:count], 1.2)
    assert (found.status, found.values) == ("OPTIMAL", best) and found.cost == pytest.approx(price)


@pytest.mark.parametrize("seed", range(6))
def test_lists_too_long_for_all_combinations_end_where_no_exchange_is_cheaper(seed):
    """A random table of costs of 5 x 5 x 5 combinations about the end of a search without lists.

    The result costs no more than any rounding of that end, nor than any combination with one or two numbers one
    place up or down.
    """
    rng = np.random.default_rng(seed)
    variables = {n: Variable(0.0, 1.0, among=(0.0, 0.2, 0.5, 0.7, 1.0)) for n in "xyz"}
    lists = Lists(Decisions(Population.of({"a": Tolerance.symmetric(1.0)}), {}, {}, variables))
    end, table = rng.uniform(size=3), rng.uniform(1, 2, (5, 5, 5))
    best = lists.cheapest(end, lambda places: places, lambda places: (False, table[places]))
    above = np.searchsorted(variables["x"].among, end)
    rounded = list(itertools.product(*((k - 1, k) for k in above)))
    near = [best, *rounded]
    for which in itertools.product((-1, 0, 1), repeat=3):
        if 0 in which:
            near.append(tuple(np.clip(np.add(best, which), 0, 4)))
    assert table[best] == min(table[place] for place in near)


@pytest.mark.long  # test_codesign_starts.py has three valleys
def test_the_deeper_of_two_valleys():
    """Own cost with valleys at 0.7 and 2.3, the second 2 % deeper; the search begins in the first."""
    own = lambda v: 10 + 8 * ((v - 0.7) * (v - 2.3)) ** 2 - 0.125 * v  # noqa: E731
    found = allocate(
        lambda e, v: {"size": v["arm"] + 0.0 * e["a"]}, {"a": Tolerance(0.0, 0.0)}, {"size": Nominal(lower=0.1)},
        costs={}, variables={"arm": Variable(0.3, 2.7, 0.7, cost=own)},
    )  # fmt: skip
    grid = np.linspace(0.3, 2.7, 100_001)
    assert found.status == "OPTIMAL"
    assert found.values["arm"] == pytest.approx(grid[own(grid).argmin()], abs=0.01)
    assert found.cost == pytest.approx(own(grid).min(), rel=1e-5)


@one_start()
def test_two_bounds_with_their_prices_and_ranges():
    """Two numbers that get cheaper beyond opposite bounds: nothing is left of the savings (Karush, Kuhn, Tucker).

    The cost is 10 + 1.8 (x - 1) + 300 (x - 1)^2 - 2 y = 6. 0.5 % of it are 0.00744 of x and 0.015 of y.
    """
    own = {"x": lambda v: 10 + 1.8 * (v - 1) + 300 * (v - 1) ** 2, "y": lambda v: -2 * v}
    found = allocate(
        lambda e, v: {"size": v["x"] * v["y"] + 0.0 * e["a"]}, {"a": Tolerance(0.0, 0.0)}, {"size": Nominal(lower=0.1)},
        costs={}, variables={n: Variable(1.0, 2.0, 1.5, cost=cost) for n, cost in own.items()},
    )  # fmt: skip
    assert found.bounds_active == {"x": "lower", "y": "upper"}
    assert found.value_prices == {"x": pytest.approx(1.8, rel=0.02), "y": pytest.approx(-2.0, rel=1e-4)}
    assert found.residual == pytest.approx(0.0, abs=1e-4)
    for name, ends in {"x": (1.0, 1.00744), "y": (1.985, 2.0)}.items():
        assert found.ranges[name] == pytest.approx(ends, abs=0.15 * (ends[1] - ends[0]))


@pytest.mark.long  # grades beside a number: test_codesign.py; the cheapest of all: test_tolerances_allocation.py
@one_start()
def test_grades_at_a_variable_are_half_widths_of_the_table():
    """The cheapest grades by enumeration at the best arm of 1: t_a^2 + t_b^2 within the share."""
    reach = 3 * 30 * um / stats.norm.ppf((1 + 0.99) / 2)
    parts = {n: Tolerance.symmetric(10 * um, size=size) for n, size in (("a", 25 * mm), ("b", 60 * mm))}
    costs = dict.fromkeys("ab", ReciprocalPower(reference=10 * um, finest=1 * um, coarsest=50 * um))
    found = allocate(
        lambda e, v: {"y": (v["arm"] + 1 / v["arm"]) / 2 * (e["a"] + e["b"])}, parts,
        {"y": Requirement(lower=-30 * um, upper=30 * um, target=0.99)}, costs=costs, grades=True, samples=2048,
        variables={"arm": Variable(0.5, 2.0)}, certificate_samples=100_000,
    ).graded  # fmt: skip
    widths = {n: {f"IT{k}": it_width(f"IT{k}", parts[n].size) / 2 for k in range(1, 12)} for n in "ab"}
    sets = [
        (10 * um / a + 10 * um / b, {"a": name_a, "b": name_b})
        for name_a, a in widths["a"].items()
        for name_b, b in widths["b"].items()
        if math.hypot(a, b) <= 0.99 * reach
    ]
    price, best = min(sets, key=lambda item: item[0])
    assert (found.status, found.grades, found.cost) == ("OPTIMAL", best, pytest.approx(price))
    assert found.half_widths == {name: pytest.approx(widths[name][grade]) for name, grade in best.items()}


@one_start()
@pytest.mark.parametrize("way", [1, -1])
def test_a_mid_point_ends_at_its_bound_on_either_side_at_its_price(way):
    """Limits of -1 and 2 pull the mid-point to 0.5, or to -0.5 where they are mirrored; it may move by 0.2 that way."""
    lower, upper = sorted((-1.0 * way, 2.0 * way))
    least, most = sorted((-0.9 * way, 0.2 * way))
    found = allocate(
        Linear({"y": {"a": 1.0}}), {"a": Tolerance.symmetric(0.1)},
        {"y": Requirement(lower=lower, upper=upper, target=0.99)}, costs={"a": COST}, samples=2048,
        middles={"a": Middle(least, most, scale=0.3)}, certificate_samples=100_000,
    )  # fmt: skip
    assert float(found.tolerances["a"].middle) == pytest.approx(0.2 * way)
    half_width = 3 * 1.2 / stats.norm.ppf(0.99)  # the other limit lies 4.5 standard deviations away
    cost = 1 / half_width + 0.3 * 0.2
    assert cost < found.cost < 1.02 * cost  # 1.2 % for the certificate


def test_measured_parts_do_not_move_with_a_mid_point():
    parts = {"a": Tolerance(-0.1, 0.2, distribution="empirical", values=[-0.1, 0.0, 0.2])}
    with pytest.raises(ValueError, match="a: the distribution empirical does not move"):
        allocate(lambda e: e["a"], parts, Requirement(upper=1.0), costs={"a": COST}, middles={"a": Middle(0.0, 1.0)})


def test_a_unit_whose_equations_were_not_solved_has_no_value():
    """The number that such a unit returns is finite, and counts for nothing."""

    def response(e):
        status = jnp.where(e["a"] > 0, int(Status.SINGULAR), int(Status.CONVERGED))
        return Outcome({"y": e["a"]}, status)

    decisions = Decisions(Population.of({"a": Tolerance.symmetric(3.0)}), {}, {}, {})
    z = np.linspace(-2.0, 2.0, 16)[None]
    found = Units(response, decisions, {"y"}, None).values(decisions.population(np.zeros(0)), z)["y"]
    np.testing.assert_allclose(found, np.where(z[0] > 0, np.nan, z[0]), rtol=1e-12)
