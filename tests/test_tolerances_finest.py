"""Allocation where the finest tolerances are not the best.

Oracle: the closed form of normal errors, one or many of which take up the clearance of another part.
"""

import jax.numpy as jnp
import numpy as np
from scipy import optimize, stats

from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance, allocate


def test_finer_need_not_be_better():
    """Error b takes up the clearance of another part: |b| >= 0.1 in 90 % of the units, so t_b >= 3 * 0.1 / q, q the
    10 % quantile of |z|; |a + b| within 3 cp R/z leaves t_a = sqrt(R^2 - t_b^2). The finest tolerances miss the first.
    The certificate's 10 % quantile of |b| is known to sqrt(0.09/n)/(f(q) q) = 1 % at n = 90,000: two of these inside
    the limit, to which one for the luck of the draw and the step of the search are added. The 90 % quantile of the sum
    is known to 0.3 %."""
    q = 0.1256613  # of |z| at 10 %; at 90 % it is 1.6448536
    reach = 3.0
    response = lambda e: {"play": 1 - jnp.abs(e["b"]), "sum": e["a"] + e["b"]}  # noqa: E731
    limit = reach / 3 * 1.6448536
    need = {"play": Requirement(upper=0.9, target=0.9), "sum": Requirement(lower=-limit, upper=limit, target=0.9)}
    cost = ReciprocalPower(reference=1.0, finest=0.5, coarsest=10.0)
    found = allocate(
        response,
        dict.fromkeys("ab", Tolerance.symmetric(1.0)),
        need,
        costs=dict.fromkeys("ab", cost),
        samples=16384,
        seed=1,
        certificate_samples=90_000,
    )
    assert found.status == "OPTIMAL"
    taken = 3 * 0.1 / q
    assert taken < found.half_widths["b"] < 1.06 * taken
    assert 0.99 * reach < np.hypot(*found.half_widths.values()) < reach


class Taken:
    """Play of a flank, of which the largest of twelve errors of places takes off its part, with costly units."""

    costly = True

    def __call__(self, e):
        largest = jnp.max(e["places"])
        return {"play": e["flank"] - largest, "fit": 3.5 - largest}


def test_a_limit_next_to_the_nominal_response_is_met_by_errors_that_take_up_the_play():
    """Without errors the play is 0.05 from its limit, the median of the units 2. The fit limits the places, P(largest <
    3.5) = F(3.5/s)^12 = 0.99, and the play the flank, by quadrature over it. A certificate of 8192 units keeps 99.2 %
    for 99 %: 8 % of the cost. Seen from the nominal response slopes are a third, and it costs twice as much."""
    limit, places = 0.05, 3.5 / stats.norm.ppf(0.99 ** (1 / 12))
    x = np.linspace(-8, 8, 4001)

    def missed(flank, places):
        density = stats.norm.pdf(x) * stats.norm.cdf((x * flank - limit) / places) ** 12
        return np.trapezoid(density, x)

    flank = optimize.brentq(lambda sd: missed(sd, places) - 0.01, 0.05, 5)
    cost = ReciprocalPower(reference=1.0, finest=0.2, coarsest=9.0)
    found = allocate(
        Taken(),
        {"flank": Tolerance.symmetric(2.0), "places": Tolerance.symmetric(2.0, shape=(12,))},
        {"play": Requirement(upper=limit, target=0.99), "fit": Requirement(lower=0.0, target=0.99)},
        costs={"flank": cost, "places": cost},
        samples=2048,
        certificate_samples=8192,
        max_steps=30,
    )
    assert found.status == "OPTIMAL"
    least = (1 / flank + 1 / places) / 3
    assert least < found.cost < 1.1 * least
    sds = {name: half / 3 for name, half in found.half_widths.items()}
    assert missed(**sds) < 0.01 and stats.norm.cdf(3.5 / sds["places"]) ** 12 > 0.99
    assert found.evaluations["search"] < 60_000
