"""Allocation that searches on a cheap response and certifies on the one that counts.

Oracle: the closed-form optimum of `tests/test_tolerances_allocation.py` with its tolerances, whatever the cheap
response says; and the search on the response alone, whose sample is the same.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from oracles.linear_pair import COSTS, LIMIT, PAIR, WIDE, linear, radius
from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance, allocate
from rvjax.units import um

NEED = Requirement(lower=-LIMIT, upper=LIMIT)
FEW = dict(samples=4096, certificate_samples=100_000)


def bent(e):
    """Half of the response's own weight of b, an offset, and a bend."""
    return e["a"] + e["b"] + 1 * um + 1e4 * e["a"] ** 2


@pytest.fixture(scope="module")
def alone():
    return allocate(linear, PAIR, NEED, costs=COSTS, **FEW)


def test_the_optimum_is_that_of_the_response(alone):
    found = allocate(linear, PAIR, NEED, costs=COSTS, cheap=bent, **FEW)
    assert (found.status, found.cheap_refused) == ("OPTIMAL", None)
    assert found.half_widths["a"] / found.half_widths["b"] == pytest.approx(4 ** (1 / 3), rel=0.03)
    assert found.cost == pytest.approx(alone.cost, rel=2e-3)  # the same sample, to where both searches settle
    assert math.hypot(found.half_widths["a"], 2 * found.half_widths["b"]) < radius(0.9973)
    assert found.certificate.yield_.lower >= 0.9973
    assert found.evaluations["cheap"] > 0 == alone.evaluations["cheap"]


def test_an_accurate_low_fidelity_response_gets_most_evaluations():
    """A length of two sums of eight errors: no root sum of squares, and eight fields to loosen in an audit. What is
    left to the response is to say where it stands: nominal, finest, start, and after two or three mapped searches."""
    weights = np.random.default_rng(0).normal(size=(2, 8))
    fields = [f"e{k}" for k in range(8)]
    length = lambda e: jnp.sqrt(sum(sum(w * e[n] for w, n in zip(row, fields)) ** 2 for row in weights) + 1e-18)  # noqa: E731
    asked = dict(costs=dict.fromkeys(fields, WIDE), samples=2048, certificate_samples=20_000)
    tolerances, need = dict.fromkeys(fields, Tolerance.symmetric(10 * um)), Requirement(upper=LIMIT, target=0.99)
    alone, found = (
        allocate(length, tolerances, need, cheap=cheap, **asked)
        for cheap in (None, lambda e: 0.8 * length(e) + 0.5 * um)
    )
    assert (found.status, found.cheap_refused) == ("OPTIMAL", None)
    assert found.learned == pytest.approx(alone.learned, rel=2e-3)
    assert found.evaluations["search"] < 0.6 * alone.evaluations["search"]


def test_a_useless_cheap_response_is_given_up(alone):
    found = allocate(linear, PAIR, NEED, costs=COSTS, cheap=lambda e: jnp.abs(e["b"]), **FEW)
    assert "correlate" in found.cheap_refused
    assert (found.status, found.cost) == ("OPTIMAL", alone.cost)  # the search of the response alone, bit by bit


def test_one_that_goes_the_other_way_is_given_up(alone):
    above = Requirement(upper=LIMIT, target=0.99)
    found = allocate(linear, PAIR, above, costs=COSTS, cheap=lambda e: -linear(e), **FEW)
    assert "correlate by -1.00" in found.cheap_refused
    assert found.cost == allocate(linear, PAIR, above, costs=COSTS, **FEW).cost


def test_a_low_fidelity_slope_of_the_wrong_sign_still_gives_the_optimum():
    """With errors that go together the cheap response correlates, and yet it says that a wider b does good."""
    together = {("a", "b"): 0.9}
    cheap = lambda e: 4 * e["a"] - 0.5 * e["b"]  # noqa: E731
    alone, found = (
        allocate(linear, PAIR, NEED, costs=COSTS, correlation=together, cheap=given, **FEW) for given in (None, cheap)
    )
    assert (found.status, found.cheap_refused) == ("OPTIMAL", None)
    assert found.cost == pytest.approx(alone.cost, rel=2e-3)
    for name, t in alone.half_widths.items():
        assert found.half_widths[name] == pytest.approx(t, rel=0.03)


def test_a_low_fidelity_response_whose_units_fail_is_dropped(alone):
    found = allocate(linear, PAIR, NEED, costs=COSTS, cheap=lambda e: linear(e) * jnp.sqrt(e["a"] - 1.0), **FEW)
    assert found.cheap_refused is not None and found.cost == alone.cost


def test_a_cheap_response_has_what_is_required():
    with pytest.raises(ValueError, match="cheap: has no 'y', which a requirement names; it has x"):
        allocate(lambda e: {"y": linear(e)}, PAIR, {"y": NEED}, costs=COSTS, cheap=lambda e: {"x": linear(e)}, **FEW)


def test_finer_need_not_be_better():
    """Error b takes up the play of another part: |b| >= 0.1 in 90 % of the units, so t_b >= 3 * 0.1 / q, q the 10 %
    quantile of |z|; |a + b| within 3 cp R/z leaves t_a = sqrt(R^2 - t_b^2). The finest tolerances meet the first by no
    means. The certificate's 10 % quantile of |b| is known to sqrt(0.09/n)/(f(q) q) = 1 % at n = 90,000: two of these
    inside the limit, to which one for the luck of the draw and the step of the search are added."""
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
    assert found.half_widths["a"] == pytest.approx(np.sqrt(reach**2 - found.half_widths["b"] ** 2), rel=0.02)
