"""Margins of an allocation with mid-points: closed form of a linear response of normal errors, and sums one by one."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from codesign_cases import one_start
from scipy import stats

from oracles.responses import Linear
from rvjax.population import Population
from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance, allocate
from rvjax.tolerances.optimum.correction import WORTH, Correction
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.designer import Designer
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.variable import Middle

PARTS = {name: Tolerance.symmetric(0.3) for name in "abc"}
COSTS = dict.fromkeys("abc", ReciprocalPower(reference=1.0, finest=0.05, coarsest=5.0))
NEED = {"y": Requirement(upper=1.0, target=0.9973), "v": Requirement(lower=-2.0, upper=2.0, target=0.99)}


RESPONSE = Linear({"y": dict(a=1.0, b=2.0, c=-1.0), "v": dict(a=1.0, b=-1.0)})


def margins(samples, limit=1.0):
    decisions = Decisions(Population.of(PARTS), COSTS, {}, {})
    need = NEED | {"y": Requirement(upper=limit, target=0.9973)}
    made = Margins(RESPONSE, decisions, need, {}, None, samples, 0)
    x = decisions.vector(np.full(3, 0.3), {})
    made.begin(x)
    return made, x


def test_other_units_see_the_quantile_of_the_normal_law():
    """Sixteen times 256 units: within 1 % of the way to the limit, nearer than the units of the search mostly are."""
    made, x = margins(256, limit=1.3)
    variance = float(PARTS["a"].moments()[1])
    true = stats.norm.ppf(0.9973) * math.sqrt(6 * variance) - 1.3
    seen = made.of_others(x, 16)
    assert sorted(seen) == [0, 1]
    assert seen[0] * made.ways[0] == pytest.approx(true, abs=0.01)
    made.offsets[0] = 0.5  # which the units do not know
    assert made.of_others(x, 16) == seen
    assert made.look(x).margins[0] - 0.5 / made.ways[0] != pytest.approx(seen[0], abs=1e-6)


def test_sums_of_several_groups_of_units_are_those_of_each_group():
    made, x = margins(256)
    units, population = made._units, made.decisions.population(x)
    rng = np.random.default_rng(0)
    several = [(rng.permutation(256)[:n], {name: rng.normal(size=n)}) for n, name in ((7, "y"), (250, "v"), (90, "y"))]
    found = units.slopes(x, population, made.tails.z, several)
    for slope, (own, pulled) in zip(found, several):
        np.testing.assert_allclose(slope, units.slope(x, population, made.tails.z[:, own], pulled), rtol=1e-12)
    assert not np.allclose(found[0], found[2])


@one_start()
def test_margins_are_corrected_before_the_first_certificate(monkeypatch):
    """A search on 128 units errs by more than a certificate sees by chance; corrected, one certificate does."""
    options = dict(costs=COSTS, samples=128, certificate_samples=100_000, middles={"c": Middle(-0.1, 0.1)}, seed=2)
    found = allocate(RESPONSE, PARTS, NEED, **options)
    monkeypatch.setattr(Designer, "_sharpened", lambda self, margins, end: end)
    without = allocate(RESPONSE, PARTS, NEED, **options)
    drawn = [one.evaluations["certificates"] // 100_000 for one in (found, without)]
    assert found.status == without.status == "OPTIMAL"
    assert drawn[0] == 1 < drawn[1]
    assert found.cost < 1.005 * without.cost


@pytest.mark.parametrize(
    ("factor", "held", "due"), [(0.8, False, 0.25), (1.21, True, 1 / 1.1 - 1), (1.0, False, WORTH)]
)
def test_a_limit_moves_to_where_the_certificate_sees_the_units(factor, held, due):
    """Units reach 1 / factor of the way to their limit; half of what lies within it may be chance.

    A miss moves the limit in any case.
    """
    certifier = SimpleNamespace(
        run=SimpleNamespace(requirements={"y": Requirement(upper=1.0)}), joint_target=None, follows=False,
        factors=lambda certificate, distance: np.array([factor]),
    )  # fmt: skip
    margins = SimpleNamespace(
        names=["y"], ways=np.ones(1), offsets=np.zeros(1), central_ways=lambda x: np.ones(1), exact=[], most_failed=None
    )
    end = SimpleNamespace(point=SimpleNamespace(x=None, margins=np.zeros(1)))
    certificate = SimpleNamespace(verdicts={"y": SimpleNamespace(met=held)})
    assert Correction(certifier).apply(margins, end, certificate, held)
    assert margins.offsets[0] == pytest.approx(due)
