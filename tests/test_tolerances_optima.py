"""Searches end at known optima: kinds of problems, with quick and with costly units, and what a result tells of them.

Of a result the share of good units is known without sampling. A certificate wants it 2.3 of its standard errors above
the target (1.96 of its interval and a cushion), and by luck up to 5. The cost is compared with the least cost for that
share: what is left is the error of the shape, that slopes of a sample give.
"""

import contextlib
import math

import numpy as np
import pytest
from codesign_cases import one_start
from optima_cases import CASES

from benchmarks.optima_problems import PROBLEMS
from rvjax.tolerances import allocate

NEAR = {False: 1.0015, True: 1.004}
"""Cost over the least one for the share that was reached, of quick and of costly units."""
PRICES = {False: 0.03, True: 0.1}
"""Error of a price, of slopes of a thousand and of some dozen units."""
SLOPELESS = ("failing", "steps")
"""Of units whose slopes mislead only quick ones are searched along rays, where a price is known by few units.

`test_tolerances_optimality.py` has steps, and `test_tolerances_allocation.py` failed units, by default.
"""


def solved(case, costly, **changes):
    given = case.arguments(costly, **changes)
    return allocate(given.pop("response"), given.pop("tolerances"), given.pop("requirements"), **given)


def reached(case, found):
    """Share of good units of a result, and its standard errors above the target."""
    widths = np.array(list(found.half_widths.values()))
    share = case.share(widths, float(found.tolerances["b"].middle), found.values.get("d", 1.0))
    return share, (share - case.target) / math.sqrt(case.target * (1 - case.target) / found.certificate.samples)


USUAL = [
    *(("line", True), ("line, number", False), ("square, mid-point", False), ("corner", False)),
    *(("corner, mid-point", True), ("failing", True)),
]
"""One of each kind of response, of numbers and of mid-points, with either kind of units."""
ROWS = [
    pytest.param(name, costly, marks=[pytest.mark.long] * ((name, costly) not in USUAL))
    for name in CASES
    for costly in (False, True)
]


@pytest.mark.parametrize(("name", "costly"), ROWS)
def test_the_end_is_the_known_optimum(name, costly, thorough):
    """From one start by default; the others are in test_codesign_starts.py."""
    case = CASES[name]
    with contextlib.nullcontext() if thorough else one_start():
        # Some dozen units next to a corner scatter.
        found = solved(case, costly, seed=2 if name == "corner, number" else 0)
    if costly and name in SLOPELESS:
        assert found.status in ("MAX_STEPS", "NOT_CERTIFIED") and found.residual > 0.1
        return
    share, errors = reached(case, found)
    assert found.status == "OPTIMAL" and found.residual < (0.2 if costly else 0.1)
    assert 0 < errors < 5
    assert found.certificate.verdicts["y"].met and found.certificate.verdicts["y"].estimate.lower >= case.target
    least, best = case.least(share)
    assert (1 - 1e-5) * least <= found.cost < NEAR[costly] * least
    assert found.learned <= found.cost < 1.06 * found.learned and found.start_cost > found.cost
    price = case.price(share, best)
    assert found.multipliers["y"] == pytest.approx(price, rel=0.5 if name in SLOPELESS else PRICES[costly])
    if costly:
        low, high = found.multiplier_intervals["y"]
        assert low < found.multipliers["y"] < high and abs(found.multipliers["y"] - price) < high - low  # 4 errors
        assert found.evaluations["sample"] == (16_384 if case.target > 0.99 else 4096)
    assert found.evaluations["certificates"] >= found.certificate.samples


@pytest.mark.long  # test_tolerances_requirements.py, test_tolerances_allocation.py and test_tolerances_search.py
@pytest.mark.parametrize("name", ["mean of a number", "rare pair", "flank and diameter", "joint target"])
def test_a_small_problem_of_the_benchmark(name):
    """Within 1 %, and its prices by differences; those with a number or a mid-point inside are like the rows above."""
    due = PROBLEMS[name].make()
    given = dict(due.arguments)
    with one_start():
        found = allocate(given.pop("response"), given.pop("tolerances"), given.pop("requirements"), **given)
    assert found.status == PROBLEMS[name].right == "OPTIMAL"
    assert 0.999 * due.optimum < found.cost < 1.01 * due.optimum
    for output, price in due.prices.items():
        seen = found.multipliers[output] if output else found.multipliers
        assert seen == pytest.approx(price, rel=0.05)


def test_a_constant_that_misses_its_limit():
    given = dict(PROBLEMS["constant miss"].make().arguments)
    found = allocate(given.pop("response"), given.pop("tolerances"), given.pop("requirements"), **given)
    assert (found.status, found.feasible) == ("INFEASIBLE", False) and found.shortfall == pytest.approx(0.2)
