"""Middles that may move: closed forms of a normal error between two limits, and what must not move.

The share of what was found is known without sampling; a certificate wants it 2.7 of its standard errors above the
target, and by luck up to 5. The middle of least cost for that share is known from the closed form, too.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from codesign_cases import one_start
from scipy import optimize, stats

from rvjax.tolerances import Middle, ReciprocalPower, Requirement, Tolerance, allocate
from tests.oracles.linear_pair import above
from tests.oracles.responses import Linear

TARGET, LOWER, UPPER = 0.9973, -1.0, 2.0
COST = ReciprocalPower(reference=1.0, finest=0.05, coarsest=20.0)
UNITS = 80_000  # of a certificate: they show the target without a probability of failure, whose draws take longer
SIZES = dict(samples=4096, certificate_samples=UNITS)


def inside(mean, half_width):
    """Share of a normal error, three standard deviations wide, between the limits."""
    return stats.norm.cdf(3 * (UPPER - mean) / half_width) - stats.norm.cdf(3 * (LOWER - mean) / half_width)


def widest(mean, share):
    """Half-width with this share between the limits."""
    return optimize.brentq(lambda half_width: inside(mean, half_width) - share, 3e-3, 150.0)


@one_start()
def found(middles, *, tolerance=None, second=None):
    tolerances = {"a": tolerance or Tolerance.symmetric(0.5)} | ({"b": second} if second is not None else {})
    required = Requirement(lower=LOWER, upper=UPPER, target=TARGET)
    return allocate(
        Linear(dict.fromkeys(tolerances, 1.0)), tolerances, required, costs={"a": COST}, middles=middles, **SIZES
    )


def reached(result):
    """Mid-point, and the share between the limits, as a certificate needs it."""
    mean = float(result.tolerances["a"].middle)
    share = inside(mean, result.half_widths["a"])
    assert result.status == "OPTIMAL" and 0 < above(share, TARGET, UNITS) < 5
    return mean, share


def test_a_free_middle_moves_between_the_limits():
    result, still = found({"a": Middle(-3.0, 3.0)}), found(None)
    assert reached(result)[0] == pytest.approx(0.5, abs=0.01)
    assert reached(still)[0] == 0.0
    assert result.cost < 0.75 * still.cost  # 0.72 by the closed form


def test_the_price_of_moving_is_weighed():
    scale = 0.4
    result = found({"a": Middle(-3.0, 3.0, scale=scale)})
    mean, share = reached(result)
    least = optimize.minimize_scalar(lambda m: 1 / widest(m, share) + scale * m, bounds=(0.0, 0.5), method="bounded")
    assert result.cost == pytest.approx(least.fun, rel=1e-3)
    assert mean == pytest.approx(least.x, abs=0.03)
    moved = scale * float(result.tolerances["a"].middle)
    assert result.cost == pytest.approx(result.costs["a"] + moved, rel=1e-9)


@pytest.mark.long  # test_codesign_choices.py has mid-points that end at the bounds of their ranges
def test_an_error_without_a_cost_moves_too_and_ranges_hold():
    result = found({"b": Middle(-0.2, 0.2)}, second=Tolerance(-0.3, 0.3))
    assert float(result.tolerances["b"].middle) == pytest.approx(0.2, abs=1e-3)
    assert float(result.tolerances["b"].half_width) == pytest.approx(0.3)
    assert float(result.tolerances["a"].middle) == 0.0


def test_a_moved_middle_can_meet_what_no_half_width_meets(thorough):
    far = Tolerance(3.5, 4.5)
    assert found(None, tolerance=far).status == "INFEASIBLE"
    result = found({"a": Middle(-3.0, 5.0)}, tolerance=far)
    assert reached(result)[0] == pytest.approx(0.5, abs=0.01)
    assert not thorough or found({"a": Middle(3.0, 5.0)}, tolerance=far).status == "INFEASIBLE"


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


@pytest.mark.long  # test_tolerances_finest.py has the half-widths, and the first test the mid-point
def test_a_middle_moves_where_finer_is_not_better():
    """Error b takes up play as in `test_finer_need_not_be_better`; the limits of the sum lie about 0.3, where a free
    middle of a puts it: the half-widths, and their bounds, are those of the symmetric case."""
    taken, limit, middle = 3 * 0.1 / 0.1256613, 1.6448536, 0.3
    need = {
        "play": Requirement(upper=0.9, target=0.9),
        "sum": Requirement(lower=middle - limit, upper=middle + limit, target=0.9),
    }
    cost = ReciprocalPower(reference=1.0, finest=0.5, coarsest=10.0)
    with one_start():
        result = allocate(
            lambda e: {"play": 1 - jnp.abs(e["b"]), "sum": e["a"] + e["b"]},
            dict.fromkeys("ab", Tolerance.symmetric(1.0)),
            need,
            costs=dict.fromkeys("ab", cost),
            seed=1,
            certificate_samples=90_000,
            middles={"a": Middle(-1.0, 1.0)},
        )
    assert result.status == "OPTIMAL" and taken < result.half_widths["b"] < 1.06 * taken
    assert float(result.tolerances["a"].middle) == pytest.approx(middle, abs=0.05)
    assert result.half_widths["a"] == pytest.approx(np.sqrt(9 - result.half_widths["b"] ** 2), rel=0.03)
