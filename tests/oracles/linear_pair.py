"""Two fields of a linear response with a closed-form optimum, for the tests of the allocation.

y = a + 2 b of centred normal errors and costs 1/t: t_j ~ (1/a_j^2)^(1/3), with sqrt(sum a_j^2 t_j^2) = 3 L/z(target).
"""

import math

from scipy import stats

from rvjax.tolerances import ReciprocalPower, Tolerance
from rvjax.units import mm, um
from tests.oracles.responses import Largest, Linear

WIDE = ReciprocalPower(finest=1 * um, coarsest=500 * um)
PAIR = {name: Tolerance.symmetric(10 * um, size=25 * mm) for name in "ab"}
COSTS = {"a": WIDE, "b": WIDE}
LIMIT = 20 * um
BOTH_SIDES = ({"a": 0.0, "b": 1.0}, {"a": 0.0, "b": -1.0})  # of |b|

linear = Linear({"a": 1.0, "b": 2.0})
two = Largest({"y": ({"a": 1.0, "b": 2.0},), "b": BOTH_SIDES})


def radius(target, limit=LIMIT):
    """sqrt(sum a_j^2 t_j^2) that gives this yield of a two-sided requirement, cp = 1."""
    return 3 * limit / stats.norm.ppf((1 + target) / 2)


def closed_form(target, limit=LIMIT):
    """Half-widths of least cost."""
    b = radius(target, limit) / math.sqrt(4 ** (2 / 3) + 4)
    return {"a": 4 ** (1 / 3) * b, "b": b}


def cost(half_widths):
    """Of a pair."""
    return sum(10 * um / t for t in half_widths.values())


def closed_cost(target, limit=LIMIT):
    """Least cost."""
    return cost(closed_form(target, limit))


def above(share, target, units):
    """Standard errors of so many units by which a share lies above its target.

    A certificate needs 1.96 of them for its interval and keeps 0.7 in hand; by luck it may need fewer or more.
    """
    return (share - target) / math.sqrt(target * (1 - target) / units)


def share(half_widths, limit=LIMIT):
    """Of all units within the limit."""
    reach = math.hypot(half_widths["a"], 2 * half_widths["b"])
    return 2 * stats.norm.cdf(3 * limit / reach) - 1
