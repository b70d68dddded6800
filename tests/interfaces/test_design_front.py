"""Front, prices and limits of a design as tables and plots show them, of results made by hand."""

import math
from types import SimpleNamespace

import pytest

from rvjax import study
from rvjax.commands.cells import binding
from rvjax.commands.design import figures, optimum as command
from rvjax.commands.design.optimum import Designed, Point
from rvjax.commands.design.prices import limit_price, multiplier, nominal_limit
from rvjax.commands.design.tables import numbers, others, saved_part, starts_text
from rvjax.outputs import Output
from rvjax.tolerances import Nominal
from rvjax.units import mm, um

PRICED = SimpleNamespace(
    design=None, costs={}, tolerances=None, variables={}, objective={"mass": lambda kg: 2.0 * kg},
)  # fmt: skip


def optimum(cost, *, status="OPTIMAL", start=20.0, feasible=True, factor=1.0):
    ended = SimpleNamespace(cost=cost, status=status, start_cost=start, feasible=feasible, values={}, starts=[])
    return Point(ended, None, {"mass": 2.0}, factor)


def trade(front, joint, two_step=None):
    return Designed(joint, {"mass": 2.0}, two_step, {}, None, [], front)


def test_a_study_without_prices_saves_no_part():
    assert saved_part(0.0, 0.0) == "-" and saved_part(3.0, 4.0) == "25.0 %"


@pytest.mark.parametrize(
    ("limit", "price", "due"), [(0.0, 2e6, 2e6), (1e-3, 2e3, 2e3), (0.0, 1e-3, 0.0), (1e-3, 1e-6, 0.0)]
)
def test_a_limit_of_nothing_binds_as_any_other(limit, price, due):
    """At a cost of 10: 2 /um at 0 um, 2 /mm at 1 mm; next to nothing is rounding."""
    asked = SimpleNamespace(
        requirements={"gap": Nominal(lower=limit)}, nominal={}, output=lambda _: SimpleNamespace(shown=("um", um))
    )
    point = SimpleNamespace(found=SimpleNamespace(multipliers={"gap": -price}, multiplier_intervals={}, cost=10.0))
    assert multiplier(asked, point, "gap") == due


@pytest.mark.parametrize(
    ("start", "feasible", "missing"), [(20.0, True, 0), (9.0, True, 1), (20.0, False, 1), (9.0, False, 2)]
)
def test_points_of_the_front_say_what_misses_limits(start, feasible, missing):
    """The study before costs less than an optimum only where it misses a limit."""

    found = trade([optimum(11.0)], optimum(10.0, start=start), optimum(12.0, feasible=feasible))
    (front,) = figures(PRICED, found)
    words = [text.get_text() for text in front.draw().get_legend().get_texts()]
    assert sum("misses limits" in word for word in words) == missing and len(words) == 4


@pytest.mark.parametrize("status", ["NOT_CERTIFIED", "INFEASIBLE"])
def test_points_that_are_not_certified_are_hollow_and_named(status):
    """They are no optima: the line of the front leaves them out, and a warning names their prices."""
    front = [optimum(11.0, factor=0.125), optimum(30.0, status=status, factor=8.0)]
    found = trade(front, optimum(10.0))
    (figure,) = figures(PRICED, found)
    drawn = {line.get_label(): line for line in figure.draw().get_lines()}
    hollow = drawn["at other prices, not certified"]
    assert hollow.get_markerfacecolor() == "white"
    assert list(zip(hollow.get_xdata(), hollow.get_ydata())) == [(4.0, 30.0 - 8 * 4.0)]
    assert len(drawn["optima at other prices"].get_xdata()) == 2
    *_, note = others(PRICED, found)
    assert note.text.startswith("warning: not certified at prices times 8:")
    (figure,) = figures(PRICED, trade(front[:1], optimum(10.0)))
    assert "at other prices, not certified" not in [line.get_label() for line in figure.draw().get_lines()]


@pytest.mark.parametrize(
    ("front", "again", "due"),
    [
        (optimum(10.5, factor=0.5), optimum(9.0), 10.0),  # 12.5 at the prices of the study
        (optimum(7.5, factor=0.5), optimum(9.0), 9.0),
        (optimum(7.5, factor=0.5), optimum(10.2), 10.0),
        (optimum(7.5, factor=0.5), optimum(9.0, status="NOT_CERTIFIED"), 10.0),
        (optimum(7.5, factor=0.5, status="NOT_CERTIFIED"), optimum(9.0), 10.0),
    ],
)
def test_a_cheaper_point_of_the_front_is_another_start(monkeypatch, front, again, due):
    """The least cost is at most that of any certified point, at the prices of the study (4 for 2 kg)."""
    monkeypatch.setattr(command, "_optimum", lambda *given, **named: again)
    assert command._cheaper(PRICED, optimum(10.0), [front], None, True).found.cost == due


def test_a_price_that_no_search_found_is_unknown():
    """It is not the price of a limit that does not bind."""
    asked = SimpleNamespace(
        requirements={}, nominal={"gap": Nominal(lower=1e-3)},
        output=lambda _: SimpleNamespace(unit="m", read_in=None, shown=("mm", mm)),
    )  # fmt: skip
    over, below = {"gap": (-2500.0, 100.0)}, {"gap": (-2500.0, -1500.0)}
    cases = [(math.nan, {}), (0.0, {}), (-2e3, {}), (-2e3, over), (-2e3, below)]
    found = [SimpleNamespace(multipliers={"gap": price}, cost=10.0, multiplier_intervals=i) for price, i in cases]
    prices = [limit_price(asked, SimpleNamespace(found=each), "gap") for each in found]
    assert prices == ["unknown", "not binding", "2 /mm", "not binding", "2 [1.5, 2.5] /mm"]


@pytest.mark.parametrize(
    ("unit", "read_in", "due"),
    [("m", "um", "0.002 /um"), ("m", "mm", "2 /mm"), ("s", "h", "7.2e+09 /1000 h"), ("-", None, "2e+03")],
)
def test_a_price_is_in_the_unit_of_the_limit(unit, read_in, due):
    output = Output(unit, "gap", None, read_in=read_in)
    asked = SimpleNamespace(requirements={}, nominal={"gap": Nominal(lower=1e-3)}, output=lambda _: output)
    point = SimpleNamespace(found=SimpleNamespace(multipliers={"gap": -2e3}, cost=10.0, multiplier_intervals={}))
    assert limit_price(asked, point, "gap") == due


def test_a_shadow_price_whose_interval_contains_zero_binds_nothing():
    """Of an allocation: in the table of requirements, and in the sentence below it."""
    found = SimpleNamespace(
        multipliers={"a": -8e-6, "b": -2.0, "c": 0.0}, multiplier_intervals={"a": (-3e-5, 1e-5), "b": (-3.0, -1.0)}
    )
    assert [binding(found, name) for name in "abc"] == [0.0, -2.0, 0.0]


def test_costs_of_other_starts_are_one_line():
    ends = [dict(cost=cost, met=met, units=256) for cost, met in ((66.05, True), (69.98, True), (9.0, False))]
    said = "Searches from 3 starts on 256 units ended at costs of 66.050 to 69.980; 1 missed a limit."
    assert starts_text(ends) == said and starts_text(ends[:1]) == starts_text(ends[2:]) == ""


def test_limits_without_a_unit_end_with_their_number():
    """A ratio has no unit: no dash follows its limit."""
    asked = SimpleNamespace(
        nominal={"ratio": Nominal(lower=1.3, upper=2.0)}, output=lambda name: Output("-", name, None)
    )
    assert nominal_limit(asked, "ratio") == ">= 1.3 and <= 2" and nominal_limit(asked, "mass") == "-"


def test_the_price_of_a_bound_is_what_one_unit_of_room_saves():
    """An upper bound of 2 mm with d cost / d bound = -2330 per metre: 2.33 per mm, as in the list of prices."""
    path = "involute.module"
    asked = study.load("rv-40e-design-four-bar", solve=False)
    item = asked.variables[path]
    asked = SimpleNamespace(design=asked.design, variables={path: item})
    ended = SimpleNamespace(ranges={}, values={path: item.upper}, value_prices={path: -2330.0})
    ended.bounds_active = {path: "upper"}
    found = trade([], Point(ended, None, {}))
    ((*_, bound, price),) = numbers(asked, found).rows
    assert (bound, price) == ("upper", "2.33 /mm")
