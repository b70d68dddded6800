"""Middles that may move: closed forms of a normal error between two limits, and what must not move.

Bounds: 16384 units leave 44 outside, 22 a side. That is 15 % and 21 % of a tail, 1.5 % of a half-width (3 sd of slope
3.3) and 0.023 of the middle, one standard deviation each; certifying with 200,000 units costs another 0.9 %.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

from rvjax.tolerances import Middle, ReciprocalPower, Requirement, Tolerance, allocate
from rvjax.tolerances.allocation.search import Search

TARGET, LOWER, UPPER = 0.9973, -1.0, 2.0
COST = ReciprocalPower(reference=1.0, finest=0.05, coarsest=20.0)


def widest(mean):
    """Half-width, three standard deviations, at which TARGET of N(mean, sd) lies between the limits."""

    def inside(sd):
        return stats.norm.cdf((UPPER - mean) / sd) - stats.norm.cdf((LOWER - mean) / sd) - TARGET

    return 3 * optimize.brentq(inside, 1e-3, 50.0)


def found(middles, *, tolerance=None, second=None, **options):
    tolerances = {"a": tolerance or Tolerance.symmetric(0.5)} | ({"b": second} if second is not None else {})
    response = (lambda e: e["a"] + e["b"]) if second is not None else (lambda e: e["a"])
    return allocate(
        response, tolerances, Requirement(lower=LOWER, upper=UPPER, target=TARGET), costs={"a": COST},
        middles=middles, certificate_samples=200_000, **options,
    )  # fmt: skip


def test_a_free_middle_moves_between_the_limits():
    result = found({"a": Middle(-3.0, 3.0)})
    assert result.status == "OPTIMAL" and float(result.tolerances["a"].middle) == pytest.approx(0.5, abs=0.07)
    assert result.half_widths["a"] == pytest.approx(widest(0.5), rel=0.04)
    still = found(None)
    assert still.half_widths["a"] == pytest.approx(widest(0.0), rel=0.04)
    assert result.cost < 0.75 * still.cost  # 0.72 by the closed form


def test_the_price_of_moving_is_weighed():
    scale = 0.4
    least = optimize.minimize_scalar(lambda m: 1 / widest(m) + scale * m, bounds=(0.0, 0.5), method="bounded")
    result = found({"a": Middle(-3.0, 3.0, scale=scale)})
    assert result.cost == pytest.approx(least.fun, rel=0.03)
    assert float(result.tolerances["a"].middle) == pytest.approx(least.x, abs=0.07)
    moved = scale * float(result.tolerances["a"].middle)
    assert result.cost == pytest.approx(result.costs["a"] + moved, rel=1e-9)


def test_an_error_without_a_cost_moves_too_and_ranges_hold():
    result = found({"b": Middle(-0.2, 0.2)}, second=Tolerance(-0.3, 0.3))
    assert float(result.tolerances["b"].middle) == pytest.approx(0.2, abs=1e-3)
    assert float(result.tolerances["b"].half_width) == pytest.approx(0.3)
    assert float(result.tolerances["a"].middle) == 0.0


def test_a_moved_middle_can_meet_what_no_half_width_meets():
    far = Tolerance(3.5, 4.5)
    assert found(None, tolerance=far).status == "INFEASIBLE"
    result = found({"a": Middle(-3.0, 5.0)}, tolerance=far)
    assert result.status == "OPTIMAL" and float(result.tolerances["a"].middle) == pytest.approx(0.5, abs=0.07)
    assert found({"a": Middle(3.0, 5.0)}, tolerance=far).status == "INFEASIBLE"


def test_nothing_is_searched_where_no_middle_makes_it_feasible(monkeypatch):
    def searched(*_):
        raise AssertionError("searched")

    monkeypatch.setattr(Search, "find", searched)
    assert found({"a": Middle(3.0, 5.0)}, tolerance=Tolerance(3.5, 4.5)).status == "INFEASIBLE"


@pytest.mark.parametrize(
    ("middles", "words"),
    [
        ({"c": Middle(0.0, 1.0)}, "'c' has no tolerance; these have: a"),
        ({"a": (0.0, 1.0)}, "must be a Middle"),
    ],
)
def test_bad_middles(middles, words):
    with pytest.raises(ValueError, match=words):
        found(middles)


def test_bad_ranges_and_laws_that_do_not_move():
    for lower, upper, scale in ((1.0, 0.0, 0.0), (0.0, np.inf, 0.0), (0.0, 1.0, -1.0)):
        with pytest.raises(ValueError, match="Middle"):
            Middle(lower, upper, scale)
    measured = Tolerance(-1.0, 1.0, distribution="empirical", values=[-0.5, 0.1, 0.4])
    with pytest.raises(ValueError, match="the distribution empirical does not move with its limits"):
        found({"a": Middle(0.0, 1.0)}, tolerance=measured)


def test_a_middle_moves_where_finer_is_not_better():
    """Error b takes up play as in `test_finer_need_not_be_better`; the limits of the sum lie about 0.3, where a free
    middle of a puts it: the half-widths, and their bounds, are those of the symmetric case."""
    taken, limit, middle = 3 * 0.1 / 0.1256613, 1.6448536, 0.3
    need = {
        "play": Requirement(upper=0.9, target=0.9),
        "sum": Requirement(lower=middle - limit, upper=middle + limit, target=0.9),
    }
    cost = ReciprocalPower(reference=1.0, finest=0.5, coarsest=10.0)
    result = allocate(
        lambda e: {"play": 1 - jnp.abs(e["b"]), "sum": e["a"] + e["b"]},
        dict.fromkeys("ab", Tolerance.symmetric(1.0)),
        need,
        costs=dict.fromkeys("ab", cost),
        certificate_samples=90_000,
        middles={"a": Middle(-1.0, 1.0)},
    )
    assert result.status == "OPTIMAL" and taken < result.half_widths["b"] < 1.06 * taken
    assert float(result.tolerances["a"].middle) == pytest.approx(middle, abs=0.05)
    assert result.half_widths["a"] == pytest.approx(np.sqrt(9 - result.half_widths["b"] ** 2), rel=0.03)
