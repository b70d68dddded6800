"""Numbers of the design, mid-points and half-widths in one programme: exact optima, invariants, refusals."""

import sys

import numpy as np
import pytest
from codesign_cases import CASES, LENGTH, LEVER, NEED, OPTIONS, PARTS, arguments, levered, one_start

from rvjax.tolerances import Memo, Middle, Nominal, ReciprocalPower, Requirement, Tolerance, Variable, allocate
from rvjax.tolerances.allocation import constraints
from rvjax.tolerances.allocation.problem import problem_of
from tests.oracles.responses import Lever, Linear

UNITS = 200_000  # of a certificate: their error of the 99.73 % quantile costs about 1 %


def solved(name, **changes):
    given = arguments(CASES[name]["given"]) | {"certificate_samples": UNITS} | changes
    return allocate(given.pop("response"), given.pop("tolerances"), given.pop("requirements"), **given)


LATER = ("middle-0", "capability-0")  # by default: test_tolerances_optima.py, test_tolerances_requirements.py


@pytest.mark.parametrize("name", ["bound-0", *(pytest.param(name, marks=pytest.mark.long) for name in LATER)])
def test_reference_problems(name):
    """Cost, values, active bounds and prices of exact optima; the rest of the table is in the benchmark."""
    with one_start():
        found, expected = solved(name), CASES[name]["expected"]
    assert found.status == "OPTIMAL"
    assert 0.999 * expected["cost"] < found.cost < 1.02 * expected["cost"]
    assert found.bounds_active == expected["bounds_active"]
    for value, (least, most) in expected["ranges"].items():
        assert least * (1 - 1e-6) <= found.values[value] <= most * (1 + 1e-6)
    for output, price in expected["prices"].items():
        assert found.multipliers[output] == pytest.approx(price, rel=0.05)
    for value, price in expected["value_prices"].items():
        assert found.value_prices[value] == pytest.approx(price, rel=0.05)
    for value, (least, most) in expected["ranges"].items():  # a part of their widths
        assert found.ranges[value] == pytest.approx((least, most), abs=0.2 * (most - least))
    for field, middle in expected["middles"].items():
        assert float(found.tolerances[field].middle) == pytest.approx(middle, abs=0.03)


@pytest.mark.long  # test_codesign_choices.py has three lists without errors
@one_start()
def test_a_list_takes_the_cheapest_of_its_values():
    found, expected = solved("listed-0"), CASES["listed-0"]["expected"]
    assert found.values == expected["values"]
    assert found.cost < 1.02 * expected["cost"] and found.learned < expected["nearest"]


@one_start()
def test_an_infeasible_problem_names_what_fails_and_what_would_help():
    found, expected = solved("refused-0"), CASES["refused-0"]["expected"]
    assert (found.feasible, found.status) == (False, "INFEASIBLE")
    assert found.shortfall == pytest.approx(expected["shortfall"], rel=0.01, abs=1e-3)
    assert found.values["arm"] == pytest.approx(expected["values"]["arm"])
    assert found.half_widths == {"a": 0.05, "b": 0.05}
    assert "y misses its limit by 0.36" in found.reason and "upper bound of arm" in found.reason


def constraints_of(response=LEVER, variables=None):
    """Of the lever, begun at its start."""
    problem = problem_of(
        response, PARTS, NEED, costs=OPTIONS["costs"], correlation=None, confidence=0.95, certificate_samples=1000,
        middles={}, variables=variables or {"length": LENGTH}, objective={}, losses=None, progress=False, memo=None,
        samples=2048, seed=0, joint_target=None, max_steps=9,
    )  # fmt: skip
    made = constraints.constraints_of(problem)
    made.begin(problem.decisions.start)
    return made


@pytest.fixture(scope="module")
def solved_lever():
    """The lever as it stands, beside which others are looked at."""
    return levered()


def test_another_unit_of_a_number_changes_nothing(request, thorough):
    """Millimetres for metres: the numbers are parts of their ranges, so that a look sees the same to rounding.

    Ends differ by what rounding does to the places of units in the tails: 0.3 % of the cost.
    """
    other = {"response": Lever(1e-3), "variables": {"length": Variable(400.0, 3000.0, 2000.0)}}
    looks = [constraints_of(**given).look(np.array([-0.5, -0.6, 0.3])) for given in ({}, other)]
    np.testing.assert_allclose(looks[1].used, looks[0].used, rtol=1e-9)
    np.testing.assert_allclose(looks[1].jacobian, looks[0].jacobian, rtol=1e-7, atol=1e-9)
    if not thorough:
        return
    found, solved_lever = levered(**other), request.getfixturevalue("solved_lever")
    assert found.values["length"] == pytest.approx(1000 * solved_lever.values["length"], rel=0.02)
    assert found.cost == pytest.approx(solved_lever.cost, rel=0.01)


def test_a_variable_without_room_is_a_constant(solved_lever):
    """Costs 1/t of errors with slopes s go like (the sum of s^(2/3))^(3/2): 2 sqrt(2) at the best length of 1."""
    found = levered(variables={"length": Variable(1.5, 1.5)})
    assert found.values == {"length": 1.5} and found.bounds_active == {"length": None}
    dearer = (1.5 ** (2 / 3) + 1.5 ** (-2 / 3)) ** 1.5 / 2**1.5
    assert found.learned / solved_lever.learned == pytest.approx(dearer, rel=2e-3)
    assert found.cost / solved_lever.cost == pytest.approx(dearer, rel=0.02)


@pytest.mark.long  # a mid-point between these limits: test_tolerances_design_centring.py
@one_start()
def test_a_variable_that_shifts_an_error_is_a_middle():
    limits = {"y": Requirement(lower=-1.0, upper=2.0)}
    moved = allocate(
        Linear({"y": dict(a=1.0, b=1.0, length=1.0)}), PARTS, limits,
        variables={"length": Variable(-1.0, 1.0, 0.0)}, **OPTIONS,
    )  # fmt: skip
    assert moved.values["length"] == pytest.approx(0.5, abs=0.03)
    middle = allocate(Linear({"y": dict(a=1.0, b=1.0)}), PARTS, limits, middles={"a": Middle(-1.0, 1.0)}, **OPTIONS)
    assert float(middle.tolerances["a"].middle) == pytest.approx(moved.values["length"], abs=0.01)
    assert middle.cost == pytest.approx(moved.cost, rel=0.01)


@one_start()
def test_an_objective_and_nominal_limits_without_units():
    """Least 10 length with length^2 >= 2 and no tolerances at all: a nominal programme, exact."""
    found = allocate(
        lambda e, v: {"square": v["length"] ** 2 + 0.0 * e["a"], "size": 10.0 * v["length"]},
        {"a": Tolerance(0.0, 0.0)},
        {"square": Nominal(lower=2.0)}, costs={}, variables={"length": LENGTH}, objective={"size": 1.5},
    )  # fmt: skip
    assert (found.status, found.values["length"]) == ("OPTIMAL", pytest.approx(np.sqrt(2.0), rel=1e-4))
    assert found.cost == pytest.approx(15 * np.sqrt(2.0), rel=1e-4) and found.start_cost == pytest.approx(30.0)
    assert found.multipliers["square"] == pytest.approx(-15 / (2 * np.sqrt(2.0)), rel=1e-3)  # 15 d length/d limit


@pytest.mark.long  # bound-0 above, and the finest half-widths of test_tolerances_allocation_bounds.py
@one_start()
def test_where_all_half_widths_are_finest_a_number_makes_the_room():
    """Error b has no cost and takes nearly all of the limit; only a longer design leaves more room."""
    parts = PARTS | {"b": Tolerance.symmetric(0.8, size=0.02)}
    found = allocate(
        lambda e, v: {"y": (e["a"] + e["b"]) / v["length"]}, parts, NEED,
        costs={"a": ReciprocalPower(reference=1.0, finest=0.3, coarsest=0.3001)}, samples=2048,
        variables={"length": Variable(0.5, 3.0, 0.6, cost=lambda length: 10 * length)}, certificate_samples=200_000,
    )  # fmt: skip
    assert found.status == "OPTIMAL"
    assert found.values["length"] == pytest.approx(1.006 * np.hypot(0.3, 0.8), rel=0.012)  # 0.6 % for the certificate


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"variables": {"leg": LENGTH}, "response": lambda e, v: e["a"]}, "leg: the response does not read it"),
        ({"response": lambda e: {"y": e["a"]}}, "takes no values"),
        ({"objective": {"mass": 1.0}}, "'mass' is no output of the response; it has size, y"),
        ({"objective": {"size": np.inf}}, "the price of size = inf: must be finite"),
        ({"variables": {"length": (0.4, 3.0)}}, "must be a Variable"),
    ],
)
def test_bad_problems(changes, words):
    with pytest.raises(ValueError, match=words):
        levered(**changes)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Variable(2.0, 1.0), "Variable.lower = 2: lies above upper = 1"),
        (lambda: Variable(0.0, np.inf), "Variable.upper = inf: must be finite"),
        (lambda: Variable(0.0, 1.0, 2.0), "Variable.start = 2: lies outside the bounds 0 and 1"),
        (lambda: Variable(0.0, 1.0, among=[]), "Variable.among: the list is empty"),
        (lambda: Variable(0.0, 1.0, among=[0.5, 3.0]), "Variable.among = 3: lies outside"),
        (lambda: Variable(0.0, "long"), "Variable.upper = 'long': must be a number"),
        (lambda: Variable(0.0, 1.0, cost=3.0), "Variable.cost = 3.0: must be a function"),
        (lambda: Nominal(), "Nominal: needs a lower or an upper limit"),
        (lambda: Nominal(lower=2.0, upper=1.0), "Nominal.lower = 2: lies above upper = 1"),
    ],
)
def test_bad_variables(made, words):
    with pytest.raises(ValueError, match=words):
        made()


@pytest.mark.long  # test_tolerances_search.py interrupts a run with a number
def test_a_killed_run_continues_from_its_memo(tmp_path, monkeypatch):
    """The second run finds all values and gradients of units; the numbers of the design are part of their keys."""

    def gone(*_):
        raise AssertionError("computed again")

    options = dict(certificate_samples=4096, samples=512, memo=Memo(tmp_path, {}, worth=0.0))
    first = levered(**options)
    for name in ("respond", "gradients"):
        monkeypatch.setattr(sys.modules["rvjax.response.parts"], name, gone)
    again = levered(**options)
    assert (again.values, again.cost, again.history) == (first.values, first.cost, first.history)


def test_costly_units_have_the_same_optimum(solved_lever):
    """Units of a costly response: plain ones, more and more of them."""
    found, plain = levered(Lever(costly=True)), solved_lever
    assert found.status == "OPTIMAL" and found.cost == pytest.approx(plain.cost, rel=0.03)
    assert found.evaluations["search"] < 300_000
    assert found.ranges["length"] == pytest.approx(plain.ranges["length"], abs=0.1)
    assert plain.ranges["length"][0] < plain.values["length"] < plain.ranges["length"][1]


def test_half_widths_of_costly_units_are_rounded_to_grades():
    """Gradients of units have rows for the numbers of the design, which half-widths alone do not read."""
    widths = dict.fromkeys("ab", ReciprocalPower(reference=1e-5, finest=1e-6, coarsest=1e-3))
    found = levered(
        Lever(costly=True), requirements={"y": Requirement(lower=-3e-5, upper=3e-5)}, costs=widths,
        certificate_samples=8192, grades=True,
    )  # fmt: skip
    assert found.graded.status == "OPTIMAL" and found.graded.cost >= found.cost * 0.99
    assert set(found.graded.grades) == {"a", "b"}


def test_the_price_of_a_limit_is_exact(solved_lever, thorough):
    """The cost of the lever is 2 sqrt(2) z/(3 limit) for a share with deviate z, so that its price is cost/limit."""
    assert solved_lever.multipliers["y"] == pytest.approx(-solved_lever.cost, rel=2e-3)
    if not thorough:
        return
    wide = levered(requirements={"y": Requirement(lower=-2.0, upper=2.0)})
    assert wide.learned == pytest.approx(solved_lever.learned / 2, rel=2e-3)
