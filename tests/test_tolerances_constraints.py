"""Constraints of an allocation at a vector: used ways by the normal law, and derivatives by differences of used ways.

A response of three errors with a mid-point that may move either way at a price, and a number. A quantile is
that of the normal law up to the noise of its units; over a step in which hundreds of them change their places its
differences are the derivatives to a few percent of the largest.
"""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from rvjax.tolerances import (
    CpkAtLeast,
    MeanWithin,
    Middle,
    Nominal,
    QuadraticLoss,
    ReciprocalPower,
    Requirement,
    SdAtMost,
    Tolerance,
    Variable,
    WorstCaseWithin,
)
from rvjax.tolerances.allocation.certificate import rejects_at_limits
from rvjax.tolerances.allocation.constraints import constraints_of
from rvjax.tolerances.allocation.problem import FEW, problem_of
from rvjax.tolerances.allocation.rays import Rays
from rvjax.tolerances.allocation.result import _without_groups, margins_of
from rvjax.tolerances.allocation.sample import Units
from tests.oracles.responses import Made

PARTS = {name: Tolerance.symmetric(0.3) for name in "abc"}
COST = ReciprocalPower(reference=0.3, finest=0.02, coarsest=3.0)
BENT = Made((1.0, 0.6, -0.5), (1.0, -1.0, 0.0), bend=0.4, shift=0.3)
X = np.array([*np.log([0.3, 0.25, 0.4]), 0.10, 0.04, 0.45])  # half-widths, mid-point up and down, number
AT_99 = Requirement(lower=-0.5, upper=0.6, target=0.99)


def constraints(required, *, response=BENT, costly=False, samples=4096, begun=X, **more):
    """Constraints with a way that moves the mid-point of b up, one that moves it down, and the number d.

    Certificates are so large that a statistic needs no distance for their error, which has no derivative here.
    """
    response = response.replace(costly=costly) if isinstance(response, Made) else response
    problem = problem_of(
        response, PARTS, required, costs=dict.fromkeys("abc", COST), correlation=None, confidence=0.95,
        certificate_samples=10**10, middles={"b": Middle(-0.6, 0.6, scale=0.5)},
        variables={"d": Variable(0.5, 1.5, 1.0)}, objective=more.get("objective"), losses=more.get("losses"),
        progress=False, memo=None, samples=samples, seed=3, joint_target=more.get("joint_target"), max_steps=100,
    )  # fmt: skip
    made = constraints_of(problem)
    made.sample(samples)
    made.begin(begun)
    return made


def test_all_quick_units_are_looked_at_where_no_limit_decides():
    """Their sample has weights; few of them would be another sample. Of costly units few are enough."""
    far = {name: Requirement(lower=-9.0, upper=9.0, target=0.99) for name in "ybd"}
    for costly in (False, True):
        made = constraints(far, costly=costly)
        made.spare(made.look(X, sloped=False))
        assert len(made.values(X)["y"]) == (FEW if costly else 4096)


def differences(of, x=X, step=1e-4):
    """Central differences (n,) of a function (c,) of the vector, as (c, n)."""
    rows = [(np.asarray(of(x + e)) - np.asarray(of(x - e))) / (2 * step) for e in step * np.eye(len(x))]
    return np.stack(rows, axis=-1)


KINDS = {
    "share": (dict(y=AT_99), {}, 0.05),
    "share of one side": (dict(y=Requirement(lower=-0.5, target=0.95)), {}, 0.05),
    "joint share": (dict(y=AT_99, b=Requirement(upper=0.3, target=0.95)), dict(joint_target=0.97), 0.05),
    "mean": (dict(y=MeanWithin(lower=-0.2, upper=0.3)), {}, 1e-4),
    "spread": (dict(y=SdAtMost(upper=0.4)), {}, 1e-4),
    "Cpk": (dict(y=CpkAtLeast(lower=-0.8, upper=1.0, cpk=1.2)), {}, 1e-4),
    "worst case": (dict(y=WorstCaseWithin(lower=-1.0, upper=0.9)), {}, 1e-4),
    "without errors": (dict(y=AT_99, d=Nominal(lower=0.8, upper=2.0)), {}, 0.05),
}


BOTH_WAYS = [
    *(pytest.param(kind, costly, marks=[pytest.mark.long] * (kind == "worst case" and costly))  # the same ends
      for kind in KINDS for costly in (False, True)),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "costly"), BOTH_WAYS)
def test_derivatives_are_differences_of_used_ways(kind, costly):
    required, more, near = KINDS[kind]
    made = constraints(required, costly=costly, samples=1024 if costly else 4096, **more)
    made.place(X)
    made.place(X)
    found = made.look(X)
    step = 1e-4 if near < 0.01 else 1e-5 if costly else 1e-2

    def used(x):
        made._near = None  # all units, also those of limits that do not decide
        return made.look(x, sloped=False).used

    due = differences(used, step=step)
    for row, own, seen in zip(made.rows, due, found.jacobian):
        if np.isfinite(found.used[made.rows.index(row)]) and row.name != "failed":
            np.testing.assert_allclose(seen, own, atol=near * np.abs(own).max(), err_msg=row.name)
    assert np.abs(due).max() > 0.1 and (found.powers[[row.nominal for row in made.rows]] == 1).all()


@pytest.mark.parametrize("costly", [False, True])
def test_derivatives_of_costs_losses_and_priced_outputs(costly):
    losses = {"y": QuadraticLoss(price=2.0, at=0.5, target=0.1)}
    made = constraints({}, costly=costly, samples=1024, losses=losses, objective={"d": 0.7})
    found = made.look(X)
    of = lambda name: differences(lambda x: [getattr(made.look(x, sloped=False), name)])[0]  # noqa: E731
    one_way = np.arange(len(X)) != 4  # both ways cost, and here the one down takes back what the other cost
    np.testing.assert_allclose(found.slopes[one_way], of("cost")[one_way], atol=1e-6)
    assert found.slopes[3] == found.slopes[4] == pytest.approx(0.5 * 1.2)
    np.testing.assert_allclose(found.priced_slopes, of("priced"), atol=1e-6)
    loss = differences(lambda x: [made.look(x).loss])[0]
    np.testing.assert_allclose(found.loss_slopes, loss, atol=1e-5 * np.abs(loss).max())


def test_used_ways_are_those_of_the_normal_law():
    """y = a + 0.6 b - 0.5 c at d = 1: both tails beyond +-L for a share of 1 %; the way is that of the median."""
    line, x = BENT.replace(bend=0.0), np.array([*np.log([0.3, 0.25, 0.4]), 0.0, 0.0, 0.5])
    sd = math.hypot(0.3, 0.6 * 0.25, 0.5 * 0.4) / 3
    for costly in (False, True):
        made = constraints(
            dict(y=Requirement(lower=-0.3, upper=0.3, target=0.99)), response=line, costly=costly, begun=x
        )
        assert made.ways == pytest.approx([0.3], rel=0.01)
        assert made.look(x).used == pytest.approx([sd * stats.norm.isf(0.005) / 0.3], rel=0.02)
        assert Rays(made)._beyond(x, 1.0) == pytest.approx([2 * stats.norm.sf(0.3 / sd)], abs=0.002)
        assert made.quantiles(x, np.array([0.1])) == pytest.approx([sd * stats.norm.isf(0.05) / 0.3], rel=0.02)


def test_units_in_the_tails_have_a_hundredth_of_the_error():
    """Of a line: placed units know the quantile at 0.1 % to 0.1 % where plain ones know it to 2 %."""
    line, x = BENT.replace(bend=0.0), np.array([*np.log([0.3, 0.25, 0.4]), 0.0, 0.0, 0.5])
    sd = math.hypot(0.3, 0.6 * 0.25, 0.5 * 0.4) / 3
    made = constraints(dict(y=Requirement(upper=0.3, target=0.999)), response=line, begun=x)
    for _ in range(2):
        made.place(x)
    assert made.tails.z is not made.plain
    assert made.look(x).used == pytest.approx([sd * stats.norm.isf(0.001) / 0.3], rel=3e-3)


def test_failed_units_are_beyond_every_limit():
    """6.7 % fail: beyond a target of 95 % there is no quantile; of 90 % they are the last units of all."""
    failing = Made((1.0, 0.0, 0.0), edge=0.15)
    x = np.array([math.log(0.3), math.log(0.3), math.log(0.3), 0.0, 0.0, 0.5])
    lost = 2 * stats.norm.sf(1.5)
    own = constraints(dict(y=Requirement(upper=0.3, target=0.87 - 0.05), b=Requirement(upper=0.9, target=0.6)),
                      response=failing, joint_target=0.8)  # fmt: skip
    share = (1 - 0.82 - lost) / (1 - lost)
    assert own.look(x).used[0] == pytest.approx(0.1 * stats.norm.isf(share) / 0.3, rel=0.08)
    none = constraints(dict(y=Requirement(upper=0.3, target=0.95)), response=failing).look(x)
    assert none.used == [math.inf] and not none.jacobian.any() and none.excess == math.inf


def test_a_statistic_of_valid_units_limits_the_failed_ones():
    """Another row: the share of failed units over 0.27 %."""
    made = constraints(dict(y=MeanWithin(upper=0.3)), response=Made((1.0, 0.0, 0.0), edge=0.32))
    x = np.array([math.log(0.3), math.log(0.32), math.log(0.3), 0.0, 0.0, 0.5])
    assert [row.name for row in made.rows] == ["y", "failed"]
    assert made.look(x).used[1] == pytest.approx(2 * stats.norm.sf(3) / 0.0027, abs=0.5)


def test_two_sides_of_a_statistic_are_two_rows():
    both = MeanWithin(lower=-1.0, upper=2.0)
    made = constraints(dict(y=both))
    values = np.linspace(-3.0, 4.0, 15)
    sides = [np.array([float(row.item.margin(v)) for v in values]) for row in made.rows if row.item is not None]
    np.testing.assert_allclose(np.max(sides, axis=0), [float(both.margin(v)) for v in values])
    for side in sides:
        np.testing.assert_allclose(np.diff(side, 2), 0.0, atol=1e-12)


class One:
    """An output of a costly response, as a part of it."""

    costly = True

    def __init__(self, name):
        self.name = name

    def __call__(self, errors, values):
        return {self.name: errors["a"] + values["d"] * errors["b"]}


class Two(One):
    """Costly units of two parts with equal values."""

    def parts(self):
        return PARTS_OF_TWO

    def __call__(self, errors, values):
        return One("y")(errors, values) | One("w")(errors, values)


PARTS_OF_TWO = [One("y"), One("w")]
FAR = dict(y=Requirement(upper=0.4, target=0.99), w=Requirement(upper=2.0, target=0.99))
"""Limits of the two parts, of which the second one does not decide."""


def test_a_part_that_does_not_decide_has_few_units():
    """It is solved for 512."""
    made = constraints(FAR, response=Two("both"), samples=2048)
    made.spare(made.look(X))
    assert made.aside == {"w"} and made.units.decisive(("y", "w", "d"), made.aside) == ("y", "d")
    before, moved = made.units.solved, X + 0.01
    values = made.values(moved)
    assert [len(values[name]) for name in "yw"] == [2048, 512] and made.units.solved - before == (2048 + 512) // 2
    np.testing.assert_allclose(values["w"], values["y"][:512], rtol=1e-12)
    made.spare(None)
    assert made.aside == set() and len(made.values(moved)["w"]) == 2048
    joint = constraints(FAR, response=Two("both"), samples=2048, joint_target=0.99)
    joint.spare(joint.look(X))
    assert joint.aside == set()  # each unit counts as a whole
    priced = constraints(FAR, response=Two("both"), samples=2048, losses={"w": QuadraticLoss(price=2.0, at=0.5)})
    assert priced.far(priced.look(X)) == set()  # its mean counts all units
    beyond = float((joint.values(X)["y"] > 0.4).mean())
    assert beyond > 0 and rejects_at_limits(joint, joint.look(X))[-1] == pytest.approx(beyond, rel=0.1)


def test_the_margin_of_a_limit_that_does_not_decide_is_that_of_the_certificate():
    """A look knows only that it does not decide, because it solves units near the limit alone."""
    made = constraints(FAR, response=Two("both"), samples=4096)
    look = made.look(X)
    due, false = margins_of(made, look, SimpleNamespace(values=None))[0], look.used.copy()
    false[1] = 0.8
    assert due["w"] == pytest.approx(due["y"] + 0.4 - 2.0)
    seen = SimpleNamespace(values=made.values(X))
    found, _ = margins_of(made, dataclasses.replace(look, used=false), seen)
    assert found == pytest.approx(due, rel=1e-9) and look.used[0] > 0.85


def test_a_part_with_one_limit_that_decides_is_decisive():
    parts = SimpleNamespace(parts=[SimpleNamespace(names=("y", "v")), SimpleNamespace(names=("w",))])
    assert Units.decisive(parts, ("y", "v", "w"), frozenset("vw")) == ("y", "v")


def test_derivatives_of_a_part_that_does_not_decide_are_taken_where_it_begins_to():
    made = constraints(FAR, response=Two("both"), samples=2048)
    made.spare(made.look(X))
    found, every = made.look(X), made.look(X, every=True)
    assert not found.jacobian[1].any() and every.jacobian[1].any()
    np.testing.assert_array_equal(found.jacobian[0], every.jacobian[0])
    np.testing.assert_array_equal(found.used, every.used)
    wide = X + np.array([4.0, 4.0, 0, 0, 0, 0])
    assert made.look(wide).used[1] > 0.85 and made.look(wide).jacobian[1].any()


def test_groups_left_out_have_the_error_of_the_quantile():
    """Of 20 groups each left out in turn: the standard error of the used way is that of repeated samples."""
    need = dict(y=Requirement(upper=0.6, target=0.95))
    errors = []
    for costly in (False, True):
        made = constraints(need, costly=costly, samples=2048)
        look = made.look(X)
        groups = [used for used, _ in _without_groups(made, look)]
        assert look.used[0] == pytest.approx(np.mean(groups), rel=0.02)
        errors.append(np.std(groups) * math.sqrt(19))
    rng = np.random.default_rng(0)  # the density at the quantile from many units
    e = rng.standard_normal((3, 400_000)) * np.array([0.3, 0.25, 0.4])[:, None] / 3
    e[1] += 1.2 * (0.10 - 0.04)
    y = 0.95 * e[0] + 0.6 / 0.95 * e[1] - 0.5 * e[2] + 0.4 * e[1] ** 2 + 0.3 * (0.95 - 1)
    q = np.quantile(y, 0.95)
    density = np.mean(np.abs(y - q) < 0.01) / 0.02
    due = math.sqrt(0.05 * 0.95 / 2048) / density / made.ways[0]
    assert all(0.5 * due < error < 1.6 * due for error in errors)
