"""Quality loss in an allocation: the mean of price ((y - target)/at)^2 adds to the cost.

Oracles: closed forms of a linear response with costs c/h, h = (9 c/(2 K a^2))^(1/3) of normal errors, 3 in the place of
9 of uniform ones, K = price/at^2; a dense scan where a requirement binds as well; `minimise`, another way there.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

from rvjax.tolerances import Middle, Nominal, QuadraticLoss, ReciprocalPower, Requirement, Tolerance, allocate, minimise
from rvjax.units import um
from tests.oracles.responses import Linear

A, C = {"u": 1.0, "v": 2.0, "w": 0.5}, {"u": 1.0, "v": 0.3, "w": 2.0}
LOSS = QuadraticLoss(2.0, 5 * um)
K = 2.0 / (5 * um) ** 2
linear = Linear({"y": A})
COSTS = {n: ReciprocalPower(scale=c, finest=0.1 * um, coarsest=1000 * um) for n, c in C.items()}
FEW = dict(costs=COSTS, seed=1, certificate_samples=100_000)


def parts(**options):
    return {n: Tolerance.symmetric(20 * um, **options) for n in A}


def best(spread=9.0):
    """Half-widths, and J there."""
    h = {n: math.cbrt(spread * C[n] * 10 * um / (2 * K * A[n] ** 2)) for n in A}
    return h, sum(C[n] * 10 * um / h[n] + K * A[n] ** 2 * h[n] ** 2 / spread for n in A)


@pytest.mark.parametrize(("law", "spread"), [("normal", 9.0), pytest.param("uniform", 3.0, marks=pytest.mark.long)])
def test_closed_forms(law, spread):
    found = allocate(linear, parts(distribution=law), {}, losses={"y": LOSS}, **FEW)
    h, j = best(spread)
    assert found.status == "OPTIMAL" and found.residual < 0.02
    assert found.half_widths == pytest.approx(h, rel=0.01)
    cost = sum(C[n] * 10 * um / found.half_widths[n] for n in A)
    assert found.cost == pytest.approx(cost)
    true = K * sum((A[n] * found.half_widths[n]) ** 2 for n in A) / spread
    assert cost + true == pytest.approx(j, rel=2e-4)
    loss, whole = found.losses["y"], found.objective
    assert loss.lower < true < loss.upper and 0.005 * true < loss.upper - loss.lower < 0.05 * true
    assert whole.value == pytest.approx(cost + loss.value) and whole.lower < cost + true < whole.upper


@pytest.mark.long  # both have the closed forms
def test_minimise_agrees():
    one = allocate(linear, parts(), {}, losses={"y": LOSS}, **FEW)
    other = minimise(lambda values, h: LOSS(values["y"]).mean(), linear, parts(), costs=COSTS)
    assert one.half_widths == pytest.approx(other.half_widths, rel=0.01)


def test_a_mid_point_that_moves_for_the_loss():
    """E = (m - target)^2 + ... with m of u alone: a free move of 4 of the 6 um takes two thirds of the way."""
    loss = QuadraticLoss(2.0, 5 * um, 6 * um)
    found = allocate(linear, parts(), {}, losses={"y": loss}, middles={"u": Middle(-4 * um, 4 * um)}, **FEW)
    h, j = best()
    assert found.status == "OPTIMAL" and found.half_widths == pytest.approx(h, rel=0.01)
    assert float(found.tolerances["u"].middle) == pytest.approx(4 * um, rel=1e-6)
    assert found.objective.value == pytest.approx(j + K * (2 * um) ** 2, rel=5e-3)


def test_a_requirement_that_binds_beside_the_loss():
    """The conditions of Karush, Kuhn and Tucker by a scan: the sum of squares is cut at what the share allows."""
    limit = 5 * um
    found = allocate(
        linear, parts(), {"y": Requirement(lower=-limit, upper=limit, target=0.99)}, losses={"y": LOSS}, **FEW
    )
    reach = math.sqrt(sum((A[n] * found.half_widths[n]) ** 2 for n in A))
    assert found.status == "OPTIMAL" and reach < 3 * limit / stats.norm.ppf(0.995)
    assert found.certificate.yield_["y"].lower >= 0.99

    def widths(price):  # of the loss with the price of the limit added
        return {n: math.cbrt(9 * C[n] * 10 * um / (2 * (K + price) * A[n] ** 2)) for n in A}

    def beyond(price):
        return math.sqrt(sum((A[n] * t) ** 2 for n, t in widths(price).items())) - reach

    price = optimize.brentq(beyond, 0.0, 1e4 * K)
    assert price > 0.1 * K and found.half_widths == pytest.approx(widths(price), rel=0.01)
    # J at the limit scales: dJ/dL = -(savings of all half-widths)/L.
    saved = sum(C[n] * 10 * um / t - 2 * K * (A[n] * t) ** 2 / 9 for n, t in found.half_widths.items())
    assert found.multipliers["y"] == pytest.approx(-saved / limit, rel=0.03)


def test_grades_by_the_objective():
    """All sets of grades of two fields, by the closed form of J."""
    sized = {n: Tolerance.symmetric(20 * um, size=25e-3) for n in ("u", "v")}
    costs = {n: COSTS[n] for n in sized}
    found = allocate(
        Linear({"y": {n: A[n] for n in sized}}), sized, {}, losses={"y": LOSS}, grades=True, **(FEW | dict(costs=costs))
    )
    from rvjax.population import GRADES, it_width

    def j(grades):
        h = {n: it_width(g, 25e-3) / 2 for n, g in grades.items()}
        return sum(C[n] * 10 * um / t + K * (A[n] * t) ** 2 / 9 for n, t in h.items())

    least = min(({"u": a, "v": b} for a in GRADES[4:] for b in GRADES[4:]), key=j)
    assert found.graded.status == "OPTIMAL" and found.graded.grades == least
    assert found.graded.objective.value == pytest.approx(j(least), rel=5e-3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(losses={"z": LOSS}), "losses: 'z' is no name of the response"),
        (dict(losses={"y": 3.0}), "must be a QuadraticLoss"),
        (dict(losses={}), "requirements: needs at least one, or a loss"),
        (dict(costs={}), "costs: no field has a cost"),
    ],
)
def test_bad_input_is_named(changes, message):
    with pytest.raises(ValueError, match=message):
        allocate(linear, parts(), {}, **(FEW | dict(losses={"y": LOSS}) | changes))


def test_a_loss_whose_slopes_mislead_is_no_optimum():
    """In steps of 5 um no unit has a slope, and without a requirement there is nothing to search by values."""
    steps = lambda e: {"y": jnp.ceil(linear(e)["y"] / (5 * um)) * 5 * um}  # noqa: E731
    found = allocate(steps, parts(), {}, losses={"y": LOSS}, **FEW)
    assert found.status == "MAX_STEPS" and found.residual > 0.1


class Costly:
    """A response that says its units are costly."""

    costly = True

    def __call__(self, errors):
        return linear(errors)


def test_costly_units_are_few():
    """Slopes of 1024 units know a half-width to 3 %, which costs 0.1 %."""
    found = allocate(Costly(), parts(), {}, losses={"y": LOSS}, **(FEW | dict(certificate_samples=4096)))
    assert found.status == "OPTIMAL" and found.evaluations["search"] < 32_768
    assert found.half_widths == pytest.approx(best()[0], rel=0.05)
    assert found.cost + K * sum((A[n] * t) ** 2 for n, t in found.half_widths.items()) / 9 < 1.001 * best()[1]
    assert found.objective.lower < best()[1] < found.objective.upper


def test_grades_of_costly_units_have_the_loss_of_all_units():
    """Units near a limit alone would not tell it."""
    sized = {name: item.replace(size=25e-3) for name, item in parts().items()}
    goal = {"y": Requirement(lower=-40 * um, upper=40 * um, target=0.99)}
    costs = {name: cost.replace(finest=1 * um) for name, cost in COSTS.items()}
    options = FEW | dict(costs=costs, certificate_samples=4096, grades=True)
    graded = allocate(Costly(), sized, goal, losses={"y": LOSS}, **options).graded
    due = K * sum((A[n] * t) ** 2 for n, t in graded.half_widths.items()) / 9
    assert graded.losses["y"].value == pytest.approx(due, rel=0.15)  # 4096 units: 2.2 % in one standard error


@pytest.mark.long
def test_a_limit_of_an_output_without_errors_stays_exact_beside_a_loss():
    from rvjax.tolerances import Variable

    found = allocate(
        lambda e, v: {"y": v["arm"] * e["u"], "size": v["arm"]}, {"u": Tolerance.symmetric(20 * um)},
        {"size": Nominal(lower=2.0)}, costs={"u": COSTS["u"]}, losses={"y": LOSS},
        variables={"arm": Variable(1.0, 3.0, 2.5)}, certificate_samples=20_000,
    )  # fmt: skip
    assert found.status == "OPTIMAL" and 2.0 <= found.values["arm"] < 2.0 * (1 + 1e-4)
    assert found.half_widths["u"] == pytest.approx(math.cbrt(9 * 10 * um / (2 * K * 4)), rel=0.01)
    assert np.isfinite(found.objective.value)
