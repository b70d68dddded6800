"""Numbers behind a plan: draws of what is not known, exchanges of one stock, random assembly, margins of estimates."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from assembly_cases import UNIT, kind, measured, square
from scipy import special, stats

from rvjax.assembly import plan
from rvjax.assembly.belief import belief, draw, known
from rvjax.assembly.costs import Machine
from rvjax.assembly.on_demand import OnDemand
from rvjax.assembly.supply import Supply, alternated_by, beyond
from rvjax.tolerances import Requirement, Tolerance


@pytest.mark.parametrize("draws", [6, 7])
def test_draws_to_choose_by_leave_a_linear_response_its_mean(draws):
    """Antithetic draws have a mean of zero: the mean of a linear response is that of the shrunk values, to rounding."""
    kinds = {"a": measured([0.3, -1.2], [0, 0], 0.8), "b": measured([0.9, 0.4], [0, 0], 0.5)}
    found = plan(lambda parts, index: 2 * parts["a"]["x"] + parts["b"]["x"], kinds, draws=draws, certificate_draws=4)
    share = [1 / (1 + 0.8**2), 1 / (1 + 0.5**2)]
    assert found.lower_bound == pytest.approx(2 * share[0] * (0.3 - 1.2) / 2 + share[1] * (0.9 + 0.4) / 2, rel=1e-12)


@pytest.mark.parametrize("law", ["uniform", "triangular"])
def test_drawn_errors_have_the_mean_and_spread_that_are_known(law):
    """4000 equal shares of the posterior. Half a node of the 129 would move the mean by 5 % of the spread."""
    known_of = belief(np.array([[0.7]]), np.array([[0.6]]), Tolerance(-1.0, 2.0, distribution=law))
    z = special.ndtri((np.arange(4000) + 0.5) / 4000)
    found = known_of.drawn(z[None, :, None])
    assert found.mean() == pytest.approx(known_of.mean.item(), abs=5e-3 * known_of.sd.item())
    assert found.std() == pytest.approx(known_of.sd.item(), rel=1e-2)


@pytest.mark.parametrize("seed", range(4))
def test_no_exchange_of_two_pieces_of_one_stock_improves_a_plan(seed):
    """From one random plan; all exchanges between any places of two units by brute force."""
    rng = np.random.default_rng(seed)
    cost, units = rng.random((10, 10)), 5
    supply = Supply((np.ones(10, int),) * 2, (0, 0), units)
    build = np.array(alternated_by(cost.__getitem__, supply, 1, rng))
    least = cost[tuple(build.T)].sum()
    for first, second in itertools.combinations(np.ndindex(units, 2), 2):
        other = build.copy()
        other[first], other[second] = build[second], build[first]
        assert cost[tuple(other.T)].sum() >= least - 1e-12


def test_positions_that_change_nothing_leave_random_assembly_its_yield():
    """Eight fresh draws of parts that the gauge knows to half their spread; the share is one of units."""
    requirement, options = Requirement(upper=0.5), dict(draws=4, certificate_draws=32)
    values = np.random.default_rng(2).standard_normal((2, 5))
    kinds = {slot: measured(x, 0 * x, 0.5) for slot, x in zip("ab", values)}
    turned = {slot: type(own)(own.parts, indices=3, population=own.population) for slot, own in kinds.items()}
    found, due = (plan(square, own, requirement=requirement, **options) for own in (turned, kinds))
    assert found.random_yield.value == pytest.approx(due.random_yield.value, rel=1e-12)
    assert 0 < due.random_yield.value < 1


@pytest.mark.parametrize("size", [1.0, 1e6])
def test_units_that_fail_cost_more_than_any_others(size):
    """With 4.5 and 0 one unit fails; 3 and 1.5 have the larger sum, whatever the measurement unit."""
    from rvjax import Status
    from rvjax.tolerances import Outcome

    def response(parts, index):
        x = parts["a"]["x"] + parts["b"]["x"] + parts["c"]["x"]
        return Outcome(size * x, jnp.where(x > 4, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED)))

    kinds = {slot: kind(values) for slot, values in {"a": [3.0, 0.0], "b": [1.5, 0.0], "c": [0.0, 0.0]}.items()}
    assert sorted(plan(response, kinds, most_valued=1).values) == [1.5 * size, 3.0 * size]


@pytest.mark.parametrize("units", [1, 2, 30])
def test_one_forbidden_unit_costs_more_than_any_plan_without(units):
    """With the cheapest others, against the dearest everywhere; equal costs and failed combinations included."""
    rng = np.random.default_rng(units)
    for cost in (rng.normal(size=20), 1e-9 * rng.normal(size=5), np.full(3, 7.0), np.array([2.0, np.inf, -5.0])):
        cheapest, dearest = cost.min(), cost[np.isfinite(cost)].max()
        assert beyond(cost, units) + (units - 1) * cheapest > units * dearest


def test_the_margin_grows_with_estimates_that_turn_out_too_high():
    """No estimate exceeds its exact value by more than the margin: an estimate 5 too high makes it 5."""
    kinds = {slot: known(kind([0.0, 1.0, 2.0]), slot) for slot in "ab"}
    found = OnDemand(Machine(square, kinds), draw(kinds, 0, 0, 1, alike=True), 1, None, False)
    found.margin, found.checks = 0.5, 3
    found.mean[:] = [5.0, 0, 0, 0, 0, 0, 0, 0, 0]  # the values are 0, 1, 4, 1, 4, 9, 4, 9, 16
    found.look((np.array([0, 2]), np.array([0, 2])))
    assert (found.margin, found.checks) == (5.0, 5)


def test_quantiles_of_a_normal_belief():
    """A part of a normal population, measured as well as it is known: half of both variances is left."""
    one = belief(np.array([[1.0]]), np.array([[1.0]]), UNIT)
    z = stats.norm.ppf([0.025, 0.5, 0.975])
    np.testing.assert_allclose(one.drawn(z[None, :, None])[0, :, 0], 0.5 + np.sqrt(0.5) * z, rtol=1e-12)
