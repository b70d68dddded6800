"""Allocation where the finest tolerances are not the best.

Oracle: the closed form of two normal errors, one of which takes up the clearance of another part.
"""

import jax.numpy as jnp
import numpy as np

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
        certificate_samples=90_000,
    )
    assert found.status == "OPTIMAL"
    taken = 3 * 0.1 / q
    assert taken < found.half_widths["b"] < 1.06 * taken
    assert 0.99 * reach < np.hypot(*found.half_widths.values()) < reach
