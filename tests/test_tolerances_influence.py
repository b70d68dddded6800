"""Influence of errors on a response: total effects with intervals, and mean slopes.

Oracles: closed forms. With normal numbers of standard deviation s, b^2 has the variance 2 s^4, a product of two has
s_a^2 s_b^2, and the square of the length of a vector of two has 4 s^4. Intervals of 95 % miss at most 12 of 100 seeds
(binomial, one case in 400); an exact one misses 5.
"""

import math
import re

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax.commands.budget.effects import influence_share, slope_text, together_text
from rvjax.outputs import Output
from rvjax.status import Status
from rvjax.tolerances import Outcome, Tolerance, influence, influences, rss

ONE = Tolerance.symmetric(3.0)  # standard deviation 1
SEEDS, MISSED = 100, 12


def vector(sd):
    return Tolerance(0.0, 3.0 * sd, distribution="rayleigh", shape=(2,))


def square(e):
    return e["a"] + e["b"] ** 2


def product(e):
    return e["a"] * e["b"]


def around_a_centre(e):
    """A life as of a loaded reducer: linear in `pin`, and less the farther ring and disc lie apart."""
    return 3 * e["pin"] - jnp.sum((e["ring"] + e["disc"]) ** 2)


def costly(e):
    return around_a_centre(e)


costly.costly = True
PAIR = {"a": ONE, "b": ONE}
CENTRES = {"pin": ONE, "ring": vector(1.0), "disc": vector(0.5)}
EFFECTS = {"pin": 9.0, "ring": 4.0 + 8 * 0.25, "disc": 4 / 16 + 8 * 0.25}  # 4 s^4 alone, 8 s^2 t^2 together
VARIANCE = 9.0 + 4.0 + 4 / 16 + 8 * 0.25


def parts_of(effects):
    return {name: value / sum(effects.values()) for name, value in effects.items()}


CASES = {
    "square": (square, PAIR, parts_of({"a": 1.0, "b": 2.0})),
    "square of a uniform number": (  # on -3 .. 3: 4 h^4 / 45
        square, {"a": ONE, "b": Tolerance.symmetric(3.0, distribution="uniform")}, parts_of({"a": 1.0, "b": 7.2}),
    ),
    "product": (product, PAIR, parts_of({"a": 1.0, "b": 1.0})),
    "product about a mean": (product, {"a": ONE, "b": Tolerance(-1.0, 5.0)}, parts_of({"a": 5.0, "b": 1.0})),
    "vectors": (around_a_centre, CENTRES, parts_of(EFFECTS)),
}  # fmt: skip


LATER = ("square of a uniform number", "product", "product about a mean")


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name in LATER)) for name in CASES])
def test_intervals_of_a_hundred_units_contain_the_share(name):
    function, tolerances, exact = CASES[name]
    found = [influences(function, tolerances, seed=seed, units=influence.COSTLY_UNITS)[""] for seed in range(SEEDS)]
    for field, share in exact.items():
        ends = np.array([(one.shares[field].lower, one.shares[field].upper) for one in found])
        assert np.sum((ends[:, 0] > share) | (ends[:, 1] < share)) <= MISSED, field
        assert 0 < np.mean(ends[:, 1] - ends[:, 0]) < 0.4  # 4 standard deviations of at most 0.065, and for skewness
    values = np.array([[one.shares[field].value for field in exact] for one in found])
    np.testing.assert_allclose(values.sum(axis=1), 1.0)
    assert (abs(values.mean(axis=0) - list(exact.values())) < 0.012).all()  # 4 of sd 0.07/sqrt(100), and the bias


def test_an_error_that_acts_alike_both_ways_has_a_share_and_no_slope():
    """Its slope at the nominal unit is 0, and so is its share by root sum squares."""
    assert rss(square, PAIR).contributions == {"a": 1.0, "b": 0.0}
    found = influences(square, PAIR)[""]
    assert found.shares["b"].value == pytest.approx(2 / 3, abs=4 * found.shares["b"].error)
    assert found.slopes == {"a": pytest.approx(1.0, abs=1e-12), "b": 0.0}
    assert found.scatter["b"] == pytest.approx(2.0, rel=0.2)  # mean square of 2 b, of 256 units
    assert found.sd == pytest.approx(np.sqrt(3.0), rel=0.1) and found.mean == pytest.approx(1.0, abs=0.1)
    assert found.total.lower < 1.0 < found.total.upper and found.failed == 0


def test_errors_that_act_together_count_for_each_of_them():
    found = influences(product, PAIR)[""]
    assert found.total.lower < 2.0 < found.total.upper and found.total.lower > 1.8
    assert found.variance == {name: pytest.approx(1.0, abs=4 * found.error[name]) for name in "ab"}
    apart = influences(lambda e: e["a"] + 2 * e["b"] + e["a"] * e["b"] / 10, PAIR)[""]
    assert apart.total.value == pytest.approx(1 + 0.01 / 5.01, abs=2e-3)


def test_a_linear_response_has_the_closed_form_without_more_units(monkeypatch):
    """Of errors of any distribution, with what a lot has in common: as root sum squares, to round-off."""
    monkeypatch.setattr(influence._Solver, "changed", None)
    tolerances = {
        "a": Tolerance(-1.0, 5.0, shape=(3,), batch=0.4), "r": vector(2.0), "idle": ONE,
        "u": Tolerance(0.0, 3.0, distribution="uniform"),
    }  # fmt: skip
    function = lambda e: 5 + e["a"][0] - 2 * e["a"][2] + 3 * e["r"][1] - 0.5 * e["u"]  # noqa: E731
    found, due = influences(function, tolerances)[""], rss(function, tolerances)
    for name, share in due.contributions.items():
        one = found.shares[name]
        assert (one.value, one.lower, one.upper) == pytest.approx((share,) * 3, abs=1e-12)
        assert found.slopes[name] == pytest.approx(np.sqrt(np.mean(np.square(due.sensitivities[name]))), abs=1e-12)
    assert (found.mean, found.sd, found.total.value) == pytest.approx((float(due.mean), float(due.sd), 1.0))
    assert found.shares["idle"].value == found.slopes["idle"] == found.scatter["idle"] == 0.0


def test_a_costly_response_needs_a_hundred_units_for_each_error():
    """The shares of a life whose slopes to ring and disc are 0 at the nominal unit, with a few hundred solved units."""
    solved = []
    part = influence.Part.solve

    def counted(self, population, z):
        solved.append(z.shape[1])
        return part(self, population, z)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(influence.Part, "solve", counted)
        found = influences(costly, CENTRES)[""]
    assert sum(solved) == (1 + 3) * influence.COSTLY_UNITS
    for name, share in parts_of(EFFECTS).items():
        assert found.shares[name].lower < share < found.shares[name].upper
    assert found.slopes == {"pin": pytest.approx(3.0), "ring": 0.0, "disc": 0.0}
    total = sum(EFFECTS.values()) / VARIANCE
    assert found.total.lower < total < found.total.upper
    assert rss(costly, CENTRES).contributions["ring"] == 0.0


def test_a_response_in_steps_has_shares():
    """Its slopes are 0 everywhere: the sign of a counts for all, but for a tenth of b."""
    found = influences(lambda e: jnp.sign(e["a"]) + 0.1 * jnp.sign(e["b"]), PAIR)[""]
    assert found.slopes == found.scatter == {"a": 0.0, "b": 0.0}
    assert found.shares["b"].lower < 1 / 101 < found.shares["b"].upper


def test_the_size_of_calls_changes_nothing():
    response_of = lambda e: {"one": e["a"] * e["b"], "two": e["a"] ** 3}  # noqa: E731
    whole = influences(response_of, PAIR, units=100, chunk=100)
    for options in (dict(chunk=37), dict(names=("two",))):
        each = influences(response_of, PAIR, units=100, **options)
        for name, found in each.items():
            assert found.variance == pytest.approx(whole[name].variance, rel=1e-12)
    assert set(each) == {"two"}


def test_failed_units_are_left_out():
    """Beyond |a| = 2, 4.55 % of the units fail; those that remain, and their neighbours, have |a| < 2."""

    def cut(e):
        lost = jnp.abs(e["a"]) > 2
        code = jnp.where(lost, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
        return Outcome({"y": jnp.where(lost, jnp.nan, e["a"] ** 2 + e["b"] ** 2)}, code)

    found = influences(cut, PAIR)["y"]
    assert found.failed / found.units == pytest.approx(1 - 0.9545**2, abs=0.02)
    a = np.random.default_rng(0).standard_normal(1_000_000)
    inside = np.var(a[abs(a) < 2] ** 2)
    assert found.shares["a"].lower < inside / (inside + 2) < found.shares["a"].upper
    nothing = influences(lambda e: e["a"] * jnp.nan, PAIR, units=64)[""]
    assert np.isnan(nothing.shares["a"].value) and nothing.failed == 64 and np.isnan(nothing.sd)
    assert influences(lambda e: e["a"], {"a": None})[""].shares == {}


class _Study:
    @staticmethod
    def unit(field):
        return "m"


def test_cells_of_the_tables():
    """A slope where there is one; else that there is none, with the size of the slopes of single units."""
    output = Output("rad", "error", lambda *_: (0.0, 0), read_in="arcmin")
    cases = {
        "a": ("0.3000 arcmin/um", r"\d\d\.\d % \[\d\d\.\d, \d\d\.\d\]"),
        "b": (r"no slope \[rms 0\.\d{4} arcmin/um\]", r"\d\d\.\d % \[\d\d\.\d, \d\d\.\d\]"),
        "idle": ("no slope", "-"),
    }
    um, arcmin = 1e-6, np.pi / 180 / 60
    tolerances = dict.fromkeys(cases, Tolerance.symmetric(3 * um))
    function = lambda e: 0.3 * arcmin * (e["a"] / um + (e["b"] / um) ** 2)  # noqa: E731
    found = influences(function, tolerances)[""]
    for field, (slope, share) in cases.items():
        cell = influence_share(found, field)
        assert re.fullmatch(slope, slope_text(found, field, _Study, output))
        assert re.fullmatch(share, "-" if cell is None else cell.text())
    assert together_text({"life": found}) == ""
    together = influences(product, PAIR)[""]
    said = f"errors act together; before scaling the shares sum to: y {100 * together.total.value:.0f} %."
    assert together_text({"life": found, "y": together}) == said


@pytest.mark.parametrize("units", [1024, 4096])
def test_a_variance_that_does_not_exist_has_no_narrow_share(units):
    """A life: one unit has most of the sampled variance. A linear response of the same units has its closed form."""
    pair = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0)}
    life = lambda e: {"life": jnp.abs(2 + e["a"]) ** (-10 / 3) * (1 + 0.3 * e["b"]), "sum": e["a"] + e["b"]}  # noqa: E731
    for seed in range(3):
        found = influences(life, pair, seed=seed, units=units)
        for share in found["life"].shares.values():
            assert share.lower <= 0 and share.upper >= 1
        assert (found["life"].total.lower, found["life"].total.upper) == (0.0, math.inf)
        for share in found["sum"].shares.values():
            assert (share.value, share.lower, share.upper) == pytest.approx((0.5, 0.5, 0.5))
