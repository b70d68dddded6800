"""Costly units that a search does without: verdicts alone, slopes of another target, a curve from the learned optimum.

Oracles: every unit solved; the normal law, whose quantiles and slopes are known; the search that goes on.
"""

import numpy as np
import pytest
from scipy import stats

from rvjax.population import Population, wilson
from rvjax.tolerances import Requirement, cost_of_yields
from rvjax.tolerances.allocating import allocated
from rvjax.tolerances.batch.monte_carlo import Run
from rvjax.tolerances.optimum.certificate import Certifier, reach
from rvjax.tolerances.optimum.followed import Followed
from rvjax.tolerances.optimum.sample_average import Training
from rvjax.tolerances.optimum.search import Search
from tests.test_tolerances_followed import COSTS, PAIR, UNITS, WANTED, Costly, InParts, both, pair, population


@pytest.mark.parametrize(("joint", "solved"), [(None, False), (0.9, True)])
def test_verdicts_alone_need_no_unit_of_an_output_far_from_its_limit(joint, solved):
    """Their sides are those of a complete certificate, which counts units beyond the far limit too."""
    need = {"near": Requirement(upper=0.8, target=0.98), "far": Requirement(upper=0.1, target=0.9)}
    run = Run(InParts(both), population(1.0), ("near", "far"), need, UNITS, 3, UNITS, keep=True)
    certifier = Certifier(run, joint, follows=True)
    certifier.draw(population(1.0), alone=True)
    before = certifier.units.parts[1].solved
    there = population(1.1)
    drawn = certifier.draw(there, alone=True)
    assert (certifier.units.parts[1].solved > before) is solved
    exact, _ = Followed(InParts(both), there, UNITS, certifier.run.seed).all_at(there)
    whole, count = certifier.completed(there, drawn), certifier.drawn
    for name, item in need.items():
        good = (exact[name] <= item.upper).mean()
        assert whole.yield_[name].value == good
        assert (
            whole.verdicts[name].met == drawn.verdicts[name].met == item.holds(wilson(int(good * UNITS), UNITS, 0.95))
        )
    assert whole.joint_yield.value == ((exact["near"] <= 0.8) & (exact["far"] <= 0.1)).mean()
    assert certifier.drawn == count == 2 and 0 < 1 - whole.yield_["far"].value < 0.02
    if not solved:  # a larger change may take the far output to its limit
        before = certifier.units.parts[1].solved
        certifier.draw(population(2.1), alone=True)
        assert certifier.units.parts[1].solved > before


def test_the_way_to_the_unit_that_proves_a_share():
    """1001 units spread evenly over 0 .. 2, median 1, limit 3: of a target of 92 % the unit at 93.8 % proves it."""
    item, values = Requirement(upper=3.0, target=0.92), np.linspace(0.0, 2.0, 1001)
    enough = next(k for k in range(921, 1002) if wilson(k, 1001, 0.95).lower >= 0.92)
    z = stats.norm.ppf(0.975)
    assert reach(item, values, z) == pytest.approx((values[enough - 1] - 1) / 2, rel=1e-12)
    assert reach(Requirement(upper=0.9, target=0.92), values, z) == np.inf  # half of the units are beyond


def learning():
    return Training(Costly(pair), Population.of(PAIR), tuple(PAIR), {"": WANTED}, None, UNITS, 0)


def test_slopes_count_on_for_another_target():
    """Of a normal response they are in proportion to its quantile: those of units at 95 % serve 99 % to 3 %."""
    training, t = learning(), np.array([0.8, 0.6])
    training.point(t)
    required = {"": WANTED.aimed(0.99)}
    before, other = training.followed.solved, training.aimed(required, t, 2.0)
    found = other.point(t)
    assert training.followed.solved - before < 400 and other.wrong == 2.0
    fresh = Training(Costly(pair), Population.of(PAIR), tuple(PAIR), required, None, UNITS, 0).point(t)
    np.testing.assert_allclose(found.margins, fresh.margins, rtol=1e-3)
    np.testing.assert_allclose(found.slopes, fresh.slopes, rtol=0.03)
    assert (found.slopes > 0.1).all()


def test_a_search_looks_no_further_where_its_model_promises_little():
    """2.5 % off the optimum along the limit a cost is 0.03 % dearer, less than the search ends for; 20 % off, more."""
    search = Search(learning(), COSTS, 50)
    point, settled = search.run(search.look(np.array([0.9, 0.9])))
    assert settled and len(search.history) > 2

    def at_limit(factor):
        t = point.half_widths * np.array([factor, 1.0])
        return search.look(t / (1 + search.training.margins(t)[0]))  # a linear response moves with its half-widths

    least = search.cost(at_limit(1.0).half_widths)
    for factor, near, looks in ((1.025, search.near, 0), (1.025, 0.0, 1), (1.2, search.near, 1)):
        off, search.near = at_limit(factor), near
        count = len(search.history)
        again, still = search.run(off)
        assert still and (len(search.history) > count) is (looks > 0)
        assert search.cost(again.half_widths) == pytest.approx(least, rel=2e-3)


def test_a_curve_begins_where_the_search_ended():
    """The point at the target of the study is the learned optimum, and needs no units."""
    options = dict(costs=COSTS, samples=1024, seed=0)
    names = dict(joint_target=None, certificate_samples=1024, grades=False)
    found, solved = allocated(Costly(pair), PAIR, {"": WANTED}, **options, **names)
    units = lambda: (solved.training.followed.solved, solved.certifier.units.solved)  # noqa: E731
    before = units()
    curve = lambda targets: cost_of_yields(  # noqa: E731
        Costly(pair), PAIR, {"": WANTED}, targets=targets, units=1024, solved=solved, **options
    )
    ((_, cost),) = curve([0.95])
    assert cost == pytest.approx(found.learned, rel=1e-12) and units() == before
    (low, _), (high, _) = curve([0.9, 0.95])
    assert abs(low - 0.9) < 4 * np.sqrt(0.9 * 0.1 / 512) and high > low
