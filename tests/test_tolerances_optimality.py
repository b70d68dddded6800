"""An optimum that is called one: units that fail, responses in steps, starts far away.

Oracles: closed forms and scans of the normal law. Of the half-widths that were found the share of good units is known
without sampling. A certificate wants it 2.7 of its standard errors above the target, and by luck up to 5; with any
number of units that is the bound. The cost is compared with the least cost of that share: what slopes of 4096 units
cost, a few parts in ten thousand.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from rvjax.population.population import Population
from rvjax.tolerances import (
    CpkAtLeast,
    Requirement,
    SdAtMost,
    Tolerance,
    WorstCaseWithin,
    allocate,
    monte_carlo,
)
from rvjax.tolerances.worst_case import extremes
from rvjax.units import um
from tests.oracles.known_optima import CASES, THREE_SIGMA, many_fields, pin_hinge, shaft_and_housing
from tests.oracles.linear_pair import COSTS, LIMIT, PAIR, above, closed_cost, linear, share
from tests.oracles.responses import Failing, Linear

EDGE = 15 * um  # units with a larger b fail
UNITS = 20_000  # of a certificate
OPTIONS = dict(costs=COSTS, samples=4096, certificate_samples=UNITS)
FRAGILE = Failing({"a": 1.0, "b": 0.0}, {"a": 1.0, "b": EDGE})


def cheapest_of_shares(limit, target):
    """Cost and half-widths where P(|a| <= limit) P(|b| <= EDGE) = target, by a fine scan of the share left to a."""
    share = target + (1 - target) * np.linspace(0.001, 0.999, 100_000)
    a = 3 * limit / stats.norm.ppf((1 + share) / 2)
    b = 3 * EDGE / stats.norm.ppf((1 + target / share) / 2)
    k = np.argmin(1 / a + 1 / b)
    return 10 * um * (1 / a[k] + 1 / b[k]), {"a": a[k], "b": b[k]}


def stepped(size):
    """|a + 2 b| rounded up to whole steps."""
    return lambda e: jnp.ceil(jnp.abs(linear(e)) / size) * size


@pytest.mark.long  # as rejects in test_tolerances_allocation.py they run by default
def test_units_that_fail_bind_a_field():
    found = allocate(FRAGILE, PAIR, Requirement(lower=-LIMIT, upper=LIMIT, target=0.99), **OPTIONS)
    a, b = (2 * stats.norm.cdf(3 * edge / found.half_widths[n]) - 1 for n, edge in (("a", LIMIT), ("b", EDGE)))
    assert found.status == "OPTIMAL" and 0 < above(a * b, 0.99, UNITS) < 5
    assert found.cost == pytest.approx(cheapest_of_shares(LIMIT, a * b)[0], rel=0.01)
    assert found.residual < 0.2


@pytest.mark.parametrize("size", [5.0, pytest.param(2.0, marks=pytest.mark.long)])
def test_a_response_in_steps_whose_limit_has_a_price(size):
    """The limit stands within a step: the last whole step below it counts, and the cost falls step by step."""
    limit = 20 * um + size / 20 * um
    found = allocate(stepped(size * um), PAIR, Requirement(upper=limit, target=0.99), **OPTIONS)
    reached = share(found.half_widths, 20 * um)
    assert found.evaluations["sample"] >= 16_384  # twice those of a search by slopes: along rays
    assert found.status == "OPTIMAL" and 0 < above(reached, 0.99, UNITS) < 5
    assert found.cost < 1.005 * closed_cost(reached, 20 * um)
    tried = {look["cost"]: look["margins"]["response"] for look in found.history}
    assert tried[found.learned] <= 0.0 and min(tried) < found.learned  # others were cheaper, and refused
    step = (closed_cost(0.99, (20 + size) * um) - closed_cost(0.99, 20 * um)) / (size * um)
    assert 3 * step < found.multipliers < step / 3 < 0


@pytest.mark.parametrize("start", [0.01, pytest.param(1e4, marks=pytest.mark.long)])
def test_wide_and_narrow_starts(start):
    """Far beyond its limits the response saturates: no slope leads back."""
    response = lambda e: 50 * um * jnp.tanh(linear(e) / (50 * um))  # noqa: E731
    limit = 50 * um * math.tanh(20 / 50)
    tolerances = {name: Tolerance.symmetric(10 * um * start) for name in PAIR}
    wide = {name: cost.replace(finest=0.1 * um, coarsest=1.0) for name, cost in COSTS.items()}
    required = Requirement(lower=-limit, upper=limit, target=0.99)
    found = allocate(response, tolerances, required, **(OPTIONS | {"costs": wide}))
    reached = share(found.half_widths)
    assert found.status == "OPTIMAL" and 0 < above(reached, 0.99, UNITS) < 5
    assert found.cost < 1.002 * closed_cost(reached)


@pytest.mark.long  # failed units: a row in test_tolerances_constraints.py, a rule in test_tolerances_requirements.py
def test_failures_beside_a_capability():
    """Cpk of the valid units binds a, known to 1/sqrt(2 n); fewer than 0.27 % may fail, and that alone binds b."""
    found = allocate(FRAGILE, PAIR, CpkAtLeast(lower=-LIMIT, upper=LIMIT, cpk=1.0), **OPTIONS)
    assert found.status == "OPTIMAL"
    assert 0 < (LIMIT / found.half_widths["a"] - 1) * math.sqrt(2 * UNITS) < 5
    assert 0 < above(2 * stats.norm.cdf(3 * EDGE / found.half_widths["b"]) - 1, 0.9973, UNITS) < 5


def test_a_bound_on_the_standard_deviation():
    """t_j ~ (1/a_j^2)^(1/3), with sd = sqrt(t_a^2 + 4 t_b^2)/3 at the bound; the mean may be anywhere."""
    required = SdAtMost(upper=LIMIT / 3)
    moved = {"a": Tolerance(90 * um, 110 * um), "b": PAIR["b"]}
    found = allocate(linear, moved, required, **OPTIONS)
    reach = math.hypot(found.half_widths["a"], 2 * found.half_widths["b"])
    assert found.status == "OPTIMAL"
    assert found.certificate.verdicts.estimate.upper <= LIMIT / 3
    assert 0 < (LIMIT / reach - 1) * math.sqrt(2 * UNITS) < 5
    assert found.cost < 1.002 * closed_cost(THREE_SIGMA, reach)
    assert found.multipliers == pytest.approx(-found.cost / (LIMIT / 3), rel=0.02)


def test_arithmetic_limits():
    """t_a + 2 t_b = limit about a middle of 5 um, costs 1/t: t_b = t_a/sqrt 2, exactly; no sample plays a part."""
    moved = {"a": Tolerance(-5 * um, 15 * um), "b": PAIR["b"]}
    required = WorstCaseWithin(lower=-LIMIT, upper=LIMIT + 5 * um)
    found = allocate(linear, moved, required, **OPTIONS)
    a = LIMIT / (1 + math.sqrt(2))
    assert found.status == "OPTIMAL"
    assert found.half_widths == pytest.approx({"a": a, "b": a / math.sqrt(2)}, rel=0.02)
    assert found.half_widths["a"] + 2 * found.half_widths["b"] == pytest.approx(LIMIT, rel=2e-3)
    assert found.cost == pytest.approx(10 * um / a * (1 + math.sqrt(2)), rel=2e-3)
    assert found.multipliers == pytest.approx(-found.cost / LIMIT, rel=0.02)
    assert found.certificate.verdicts.estimate.value <= LIMIT + 5 * um


def test_a_worst_case_is_judged_by_limits_not_by_units():
    """Units of a wide normal law lie beyond +-60 um now and then; limits of 3 sd do not."""
    wide = {name: tolerance.replace(cp=0.5) for name, tolerance in PAIR.items()}
    seen = monte_carlo(linear, wide, samples=2000, seed=0, requirements=WorstCaseWithin(upper=30 * um), keep=True)
    assert seen.maximum > 30 * um
    assert seen.verdicts.met and seen.verdicts.estimate.value == pytest.approx(30 * um)
    failing = lambda e: jnp.where(e["a"] > 9 * um, jnp.nan, linear(e))  # noqa: E731
    assert not monte_carlo(failing, wide, samples=16, seed=0, requirements=WorstCaseWithin(upper=1.0)).verdicts.met


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("shaft and housing, worst case", marks=pytest.mark.long),  # as arithmetic limits, above
        "shaft and housing, root sum squares",
    ],
)
def test_an_optimum_in_print(name):
    """Printed to a cent, from tolerances rounded to 1e-5 in."""
    case = CASES[name]()
    assert case.optimum == pytest.approx(case.published, rel=1.5e-3)
    if "worst" in name:
        found = allocate(case.response, case.tolerances, case.requirements, **(OPTIONS | {"costs": case.costs}))
        assert found.status == "OPTIMAL"
        assert 1.0 <= found.cost / case.optimum < 1.003
    else:
        certified(case, lambda share: shaft_and_housing(arithmetic=False, target=share))


def certified(case, at, near=1.001):
    """The least cost for the share that the found half-widths really have: what the certificate keeps is no loss."""
    found = allocate(case.response, case.tolerances, case.requirements, **(OPTIONS | {"costs": case.costs}))
    reached = case.share(np.array([found.half_widths[name] for name in case.costs]))
    assert found.status == "OPTIMAL" and 0 < above(reached, case.requirements.target, UNITS) < 5
    assert 1 - 1e-9 <= found.cost / at(reached).optimum < near


@pytest.mark.long  # responses that are not linear: test_tolerances_optima.py
def test_a_hinge_pin_enters_both_leaves():
    """A gap that is not linear."""
    certified(CASES["hinge of two leaves"](), pin_hinge, 1.002)


@pytest.mark.parametrize("count", [12, pytest.param(32, marks=pytest.mark.long)])
def test_many_fields_of_unlike_cost(count):
    """A slope by the 512 units near the limit errs by sqrt(fields/units)/1.75 = 14 % with 32 fields, a half-width by a
    third of that, and the cost by 1.5 squares: 0.35 %. The model of the slopes leaves nearly nothing of it.
    """
    certified(many_fields(count), lambda share: many_fields(count, target=share))


def test_the_ends_of_a_range_grow_with_the_half_widths():
    """Against differences of the ends, which are linear in every half-width; also where a law has one side."""
    response = Linear({"a": 1.0, "b": -2.0})
    skew = Tolerance(2 * um, 10 * um, distribution="lognormal", log_sd=0.3)
    population = Population.of({"a": skew, "b": PAIR["b"]})
    found = extremes(response, population, ("",), "")
    assert found.values == pytest.approx([-18 * um, 30 * um])
    for j, (name, tolerance) in enumerate(population.active.items()):
        wider = population.with_half_widths({name: 1.5 * tolerance.half_width})
        grown = extremes(response, wider, ("",), "").values - found.values
        np.testing.assert_allclose(found.slopes[:, j], grown / 0.5, atol=1e-12)
