"""Two fields of a linear response with a closed-form optimum, for the tests of the allocation."""

from scipy import stats

from rvjax.tolerances import ReciprocalPower, Tolerance
from rvjax.units import um

WIDE = ReciprocalPower(finest=1 * um, coarsest=500 * um)
PAIR = {"a": Tolerance.symmetric(10 * um), "b": Tolerance.symmetric(10 * um)}
COSTS = {"a": WIDE, "b": WIDE}
LIMIT = 20 * um


def linear(e):
    return e["a"] + 2 * e["b"]


def radius(target, limit=LIMIT):
    """sqrt(sum a_j^2 t_j^2) that gives this yield of a two-sided requirement, cp = 1."""
    return 3 * limit / stats.norm.ppf((1 + target) / 2)
