"""Several starts, ranges, prices and their intervals, against closed forms and solved problems."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from codesign_cases import CASES, LENGTH, OPTIONS, PARTS, arguments, one_start
from codesign_random import problem

from rvjax.records import Record, record
from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance, Variable, allocate
from rvjax.tolerances.allocation import constraints, search
from rvjax.tolerances.allocation.problem import OF_COSTLY
from rvjax.tolerances.allocation.result import ranges
from tests.oracles.responses import Lever

CERTIFICATE = 20_000
OFF = pytest.mark.xfail(reason="one price of each is off by 8 and 9 %: 3 and 0.5 % of the largest")


def valleys():
    """The reference problem with three valleys of its number, the start in a wrong one, as costly units."""
    given = arguments(CASES["valleys-0"]["given"])
    plain = given.pop("response")

    def costly(errors, values):
        return plain(errors, values)

    costly.costly = True
    return allocate(
        costly, given.pop("tolerances"), given.pop("requirements"), certificate_samples=CERTIFICATE, **given
    )


@pytest.fixture(scope="module")
def several():
    return valleys()


def test_other_starts_find_the_valley_that_is_cheapest(several):
    """One start ends at 1.3 times the optimum. The certificate costs 3 %: 20,000 units for 99.73 %."""
    expected = CASES["valleys-0"]["expected"]
    assert several.status == "OPTIMAL" and expected["cost"] < several.cost < 1.04 * expected["cost"]
    assert several.values["arm"] == pytest.approx(expected["values"]["arm"], abs=0.06)
    assert several.ranges["arm"][0] <= several.values["arm"] <= several.ranges["arm"][1]


def test_starts_are_told_and_their_units_are_limited(several, thorough):
    if thorough:
        with one_start():
            alone = valleys()
        assert alone.starts == [] and alone.cost > 0.99 * several.cost
        extra = several.evaluations["search"] - alone.evaluations["search"]
        assert extra < alone.evaluations["search"] + CERTIFICATE
    begun = [start["begun"]["arm"] for start in several.starts]
    assert begun[0] == pytest.approx(2.75) and len(set(begun)) == len(begun) >= 4
    met = [start for start in several.starts if start["met"]]
    best = min(met, key=lambda start: start["cost"])
    assert best["values"]["arm"] == pytest.approx(several.values["arm"], abs=0.1)
    assert max(start["cost"] for start in met) > 1.02 * best["cost"]
    assert {start["units"] for start in several.starts} == {512}


def lever_within(limit):
    """All starts, which ends at costs within 0.6 % of their proportion to 1/limit; one start within 3 %."""
    need = {"y": Requirement(lower=-limit, upper=limit, target=0.99)}
    options = OPTIONS | {"variables": {"length": LENGTH}}
    return allocate(Lever(costly=True), PARTS, need, **options)


@pytest.fixture(scope="module")
def lever():
    return lever_within(1.0)


def test_the_range_of_a_number_of_costly_units(lever):
    """The least cost with length l is in proportion to (l^(2/3) + l^(-2/3))^1.5: 0.5 % more at exp(+-0.1224)."""
    due = np.exp(1.5 * np.arccosh(1.005 ** (2 / 3)))
    least, most = lever.ranges["length"]
    assert (least, most) == pytest.approx((1 / due, due), abs=0.2 * (due - 1 / due))


def test_a_range_holds_the_value_of_its_search():
    """The optimum of fewer units, 2.8, is not that of the search, 1.4; a parabola costs 0.5 % more at 2.8 +-0.0632."""

    def run(x, *_, **__):
        x = np.clip([0.9], programme.low, programme.high)
        look = SimpleNamespace(x=x, total=1 + 5 * float(x[0] - 0.9) ** 2, excess=-1.0)
        return SimpleNamespace(look=look, at_low=[0.0], at_high=[0.0])

    item = Variable(lower=1.0, upper=3.0)
    programme = SimpleNamespace(low=np.zeros(1), high=np.ones(1), run=run)
    decisions = SimpleNamespace(
        fields=[], moves=[], free=["length"], variables={"length": item}, values=lambda x: {"length": 1 + 2 * x[0]}
    )
    effort = dataclasses.replace(OF_COSTLY, of_ranges=None, trials=9)
    constraints = SimpleNamespace(decisions=decisions, problem=SimpleNamespace(effort=effort))
    for searched, due in ((0.2, (1.4, 2.8632)), (0.95, (2.7368, 2.9)), (0.9, (2.7368, 2.8632))):
        end = SimpleNamespace(look=SimpleNamespace(x=np.array([searched])))
        assert ranges(constraints, programme, end)["length"] == pytest.approx(due, abs=0.02)


def test_the_interval_of_a_price_holds_that_of_the_closed_form(lever, thorough):
    """The cost is in proportion to 1/limit. Limits 10 % nearer and farther: a solved cost is known to 0.5 %, as 2 %."""
    least, most = lever.multiplier_intervals["y"]
    assert least < -lever.cost < most and least < lever.multipliers["y"] < most
    assert most - least < 0.1 * lever.cost
    if thorough:
        nearer, farther = lever_within(0.9), lever_within(1.1)
        assert least < (farther.cost - nearer.cost) / 0.2 * (1 - 0.1**2) < most


@record
class Paired(Record):
    """Two responses of three errors, of which one limit decides."""

    costly = True

    def __call__(self, errors):
        a, b, c = (errors[name] for name in "abc")
        return {"y": a + 2 * b + c / 2, "w": a - b + 1.5 * c}


def paired(limit):
    """Half-widths alone: no number of the design."""
    need = {"y": Requirement(lower=-1.0, upper=1.0, target=0.99), "w": Requirement(upper=limit, target=0.99)}
    costs = dict.fromkeys("abc", ReciprocalPower(reference=1.0, finest=0.01, coarsest=20.0))
    return allocate(
        Paired(), {n: Tolerance.symmetric(0.3) for n in "abc"}, need, costs=costs, samples=16384,
        certificate_samples=4000, seed=1,
    )  # fmt: skip


def test_the_interval_of_a_price_of_half_widths_alone(monkeypatch, thorough):
    """The cost is in proportion to 1/limit. The price is that of the learned half-widths, certified ones cost 7 % more.

    Prices of so many units scatter by 1 to 2 %, so no interval is narrower than 2 %. No further values of units are
    solved for an interval.
    """
    found = paired(0.6)
    least, most = found.multiplier_intervals["w"]
    assert not thorough or least < (paired(0.612).cost - paired(0.588).cost) / 0.024 < most
    assert least < -found.cost / 0.6 < most and least < found.multipliers["w"] < most
    assert 0.02 < (most - least) / (found.cost / 0.6) < 0.2
    assert found.multiplier_intervals["y"] == pytest.approx((0.0, 0.0), abs=1e-6)
    if not thorough:
        return
    monkeypatch.setattr(search, "intervals", lambda *given: {})
    without = paired(0.6)
    assert without.cost == found.cost
    assert 0 <= found.evaluations["search"] - without.evaluations["search"] <= 512  # gradients


@one_start()  # prices of exact optima run by default in test_codesign.py
@pytest.mark.parametrize(
    "seed",
    [pytest.param(9, marks=pytest.mark.long), *(pytest.param(k, marks=[pytest.mark.long, OFF]) for k in (10, 12))],
)
def test_all_prices_of_a_random_problem(seed, monkeypatch):
    """Within 5 %, of which the certificate takes up to 2 %. Prices of 8192 units scatter by 4 %, of these by 2 %."""
    monkeypatch.setattr(constraints, "QUICK", 32_768)
    given = problem(seed)
    cost, prices, _ = given.exact()
    arguments = given.arguments()
    first = [arguments.pop(key) for key in ("response", "tolerances", "requirements")]
    found = allocate(*first, **arguments)
    assert found.status == "OPTIMAL" and cost < found.cost < 1.01 * cost
    assert min(map(abs, prices.values())) > 0
    for name, price in prices.items():
        assert found.multipliers[name] == pytest.approx(price, rel=0.05)
