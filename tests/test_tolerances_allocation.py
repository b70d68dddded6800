"""Allocation: closed-form optima, refusals, certificates, grades.

Oracle: for a linear response y = sum a_j e_j of normal errors and costs 1/t the optimum is
t_j ~ (1/a_j^2)^(1/3), with sqrt(sum a_j^2 t_j^2) = 3 cp L / z(target). Of the half-widths that were found the share of
good units is known without sampling: a certificate wants it 2.7 of its standard errors above the target, by luck up to
5. The cost is compared with the least cost of that share; a sample of 4096 units knows the ratio of half-widths to 2 %,
which costs 0.1 %.
"""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scale_study import bits
from scipy import stats

from benchmarks.optima_problems import Costly
from rvjax.population.population import Population
from rvjax.tolerances import (
    Exponential,
    Requirement,
    Table,
    Tolerance,
    allocate,
    it_width,
    monte_carlo,
)
from rvjax.tolerances.allocation import certificate
from rvjax.tolerances.allocation.problem import problem_of
from rvjax.tolerances.batch.statistics import shares_alone
from rvjax.units import mm, um
from tests.oracles.linear_pair import (
    COSTS,
    LIMIT,
    PAIR,
    WIDE,
    above,
    closed_cost,
    closed_form,
    linear,
    radius,
    share,
    two,
)
from tests.oracles.responses import Failing, Linear

UNITS = 20_000  # of a certificate
SIZES = dict(samples=4096, certificate_samples=UNITS)
CERTIFIED = dict(costs=COSTS) | SIZES
MANY = 80_000  # show a target of 99.73 % without a probability of failure, whose draws take longer
BOTH = Requirement(lower=-LIMIT, upper=LIMIT)


def cost_of_two(limit_y, limit_b):
    """Cost where both |y| <= limit_y and |b| <= limit_b bind."""
    b = radius(0.9973, limit_b)
    return 10 * um / math.sqrt(radius(0.9973, limit_y) ** 2 - 4 * b**2) + 10 * um / b


@pytest.fixture(scope="module")
def optimum():
    return allocate(linear, PAIR, BOTH, **CERTIFIED)


def test_closed_form_of_two_fields(optimum):
    reached = share(optimum.half_widths)
    assert (optimum.feasible, optimum.status) == (True, "OPTIMAL")
    assert 0 < above(reached, 0.9973, UNITS) < 5  # active, from the safe side
    assert closed_cost(reached) <= optimum.cost < 1.001 * closed_cost(reached)
    assert optimum.half_widths["a"] / optimum.half_widths["b"] == pytest.approx(1.5874, rel=0.03)
    verdict = optimum.certificate.verdicts  # with 54 rejects a probability of failure is known better than a share
    assert verdict.met and verdict.estimate.lower >= 0.9973 and "importance sampling" in verdict.wanted
    assert optimum.certificate.seed > 0  # not the units that were learned from
    assert optimum.start_cost == pytest.approx(2.0)
    assert optimum.costs == pytest.approx({n: 10 * um / t for n, t in optimum.half_widths.items()})
    assert optimum.tolerances["a"].upper == pytest.approx(optimum.half_widths["a"])
    assert optimum.shortfall == 0.0
    assert optimum.graded is None
    assert len(optimum.history) < 30
    assert optimum.history[0]["cost"] == pytest.approx(2.0)


def test_multiplier_is_the_shadow_price(optimum):
    """The optimal cost is C ~ 1/L, so dC/dL = -C/L; the sample puts the limit elsewhere by up to 4 %."""
    assert optimum.multipliers == pytest.approx(-optimum.cost / LIMIT, rel=0.01)
    assert optimum.learned == pytest.approx(closed_cost(0.9973), rel=0.04)


def test_the_same_study_gives_the_same_bits(optimum):
    again = allocate(linear, PAIR, BOTH, **CERTIFIED)
    assert again.half_widths == optimum.half_widths
    assert bits(again.certificate) == bits(optimum.certificate)


def test_progress_names_its_phases(capsys):
    allocate(linear, PAIR, BOTH, progress=True, max_steps=1, **CERTIFIED)
    said = capsys.readouterr().err
    assert said.index("compiling") < said.index("searching") < said.index("certifying: 100%")


@pytest.mark.long  # test_tolerances_optimality.py starts far away
def test_the_start_does_not_matter(optimum):
    start = {"a": Tolerance.symmetric(400 * um), "b": Tolerance.symmetric(1 * um)}
    found = allocate(linear, start, BOTH, **CERTIFIED)
    assert found.history[-1]["half_widths"] == pytest.approx(optimum.history[-1]["half_widths"], rel=0.02)


@pytest.mark.long  # test_tolerances_allocation_bounds.py has four fields
def test_a_bound_holds_one_field():
    """The rest of the spread is left to a; its half-width is 3.6 times as sensitive to the yield as the sum."""
    assert closed_form(0.9973)["b"] < 8.5 * um
    bounded = {"a": WIDE, "b": WIDE.replace(finest=8.5 * um)}
    found = allocate(linear, PAIR, BOTH, costs=bounded, **SIZES)
    assert found.half_widths["b"] == 8.5 * um
    assert 0 < above(share(found.half_widths), 0.9973, UNITS) < 5


def test_infeasible_says_by_how_much():
    """The 90 % quantile of |y| of 200,000 units, too many to keep, errs by 0.2 %."""
    required = Requirement(lower=0.0, upper=0.0, target=0.9)
    found = allocate(linear, PAIR, required, **(CERTIFIED | {"certificate_samples": 200_000}))
    assert (found.feasible, found.status) == (False, "INFEASIBLE")
    assert found.half_widths == {"a": 1 * um, "b": 1 * um}
    sd = math.sqrt(5) / 3 * um
    assert found.shortfall == pytest.approx(stats.norm.ppf(0.95) * sd, rel=0.01)
    assert found.certificate.yield_.value == 0.0
    assert found.certificate.values is None
    assert found.multipliers == 0.0


def test_two_requirements_and_an_idle_one(thorough):
    """The idle one runs by default in test_tolerances_cost_curve.py, too."""
    requirements = {"y": Requirement(lower=-LIMIT, upper=LIMIT), "b": Requirement(upper=1.0)}
    if thorough:
        found = allocate(two, PAIR, requirements, **CERTIFIED)
        assert found.multipliers["b"] == 0.0
        assert found.multipliers["y"] < 0.0
        assert found.shortfall == {"y": 0.0, "b": 0.0}
    # Now |b| <= 10 um binds as well: b is fixed by it, a by the other.
    tight = {"y": requirements["y"], "b": Requirement(upper=6 * um)}
    found = allocate(two, PAIR, tight, **(CERTIFIED | dict(certificate_samples=MANY)))
    assert 0 < above(share(found.half_widths), 0.9973, MANY) < 5
    assert 0 < above(2 * stats.norm.cdf(18 * um / found.half_widths["b"]) - 1, 0.9973, MANY) < 5
    # Shadow prices by finite differences of the closed form's cost.
    step = 1e-3 * um
    slopes = {
        "y": (cost_of_two(LIMIT + step, 6 * um) - cost_of_two(LIMIT - step, 6 * um)) / (2 * step),
        "b": (cost_of_two(LIMIT, 6 * um + step) - cost_of_two(LIMIT, 6 * um - step)) / (2 * step),
    }
    assert found.multipliers == pytest.approx(slopes, rel=0.1)


@pytest.mark.long  # test_tolerances_search.py has the optimum of a joint target
def test_joint_target_costs_more():
    requirements = {
        "y": Requirement(lower=-LIMIT, upper=LIMIT, target=0.99),
        "b": Requirement(upper=6 * um, target=0.99),
    }
    alone, joint = (allocate(two, PAIR, requirements, joint_target=j, **CERTIFIED) for j in (None, 0.99))
    assert alone.certificate.joint_yield.value < 0.99
    assert joint.certificate.joint_yield.lower >= 0.99
    assert joint.cost > alone.cost * 1.005
    assert all(price <= 0 for price in joint.multipliers.values())


def test_correlation_tightens():
    """y = a + 2 b with corr 0.6: t_a^2 + 4 t_b^2 + 2.4 t_a t_b = radius^2, scanned for the optimum."""
    sizes = CERTIFIED | dict(certificate_samples=MANY)
    found = allocate(linear, PAIR, BOTH, correlation={("a", "b"): 0.6}, **sizes)
    a, b = found.half_widths.values()
    reached = 2 * stats.norm.cdf(3 * LIMIT / math.sqrt(a**2 + 4 * b**2 + 2.4 * a * b)) - 1
    ratio = np.linspace(0.5, 5, 10_000)
    b = radius(reached) / np.sqrt(ratio**2 + 4 + 2.4 * ratio)
    assert 0 < above(reached, 0.9973, MANY) < 5
    assert found.cost == pytest.approx((10 * um / (ratio * b) + 10 * um / b).min(), rel=0.002)
    assert isinstance(found.tolerances, dict)


def test_extreme_targets(thorough):
    # A certificate of 30 ppm allows 20 rejects in a million: luck counts for more than the normal law says.
    for target, units in ((0.5, UNITS), *([(0.99997, 1_000_000)] if thorough else [])):
        required = Requirement(lower=-LIMIT, upper=LIMIT, target=target)
        found = allocate(linear, PAIR, required, costs=COSTS, certificate_samples=units)
        assert found.status == "OPTIMAL" and above(share(found.half_widths), target, units) > 0
        assert found.cost == pytest.approx(closed_cost(target), rel=0.05)


@pytest.mark.parametrize("target", [1 - 1e-6, pytest.param(1 - 1e-9, marks=pytest.mark.long)])
def test_a_target_that_no_sample_can_show(target):
    """A probability of failure certifies it: known to 1.6 %, that is 1.6 % / z^2 of a half-width; the shape is to 1 %.

    The shape costs 0.3 % of the half-widths in the tail of a sample of 4096 units.
    """
    found = allocate(linear, PAIR, Requirement(lower=-LIMIT, upper=LIMIT, target=target), **CERTIFIED)
    assert found.status == "OPTIMAL"
    assert 1.0 <= found.cost / closed_cost(target) < 1.01
    verdict = found.certificate.verdicts
    assert verdict.met and verdict.estimate.lower >= target
    reached = 2 * stats.norm.sf(3 * LIMIT / math.hypot(found.half_widths["a"], 2 * found.half_widths["b"]))
    assert 1 - verdict.estimate.value == pytest.approx(reached, rel=0.05)
    assert "importance sampling" in verdict.wanted


def certifier_of(response, parts, required, **more):
    """Of an allocation with these requirements."""
    given = dict(
        costs=dict.fromkeys(parts, WIDE), correlation=None, confidence=0.95, certificate_samples=UNITS, middles={},
        variables={}, objective={}, losses=None, progress=False, memo=None, samples=4096, seed=0, joint_target=None,
        max_steps=9,
    )  # fmt: skip
    return certificate.Certifier(problem_of(response, parts, required, **(given | more)))


def test_a_doubtful_probability_certifies_nothing(monkeypatch):
    """The same probability of failure, said with doubts."""
    sure = certificate.failure_probability
    doubt = lambda *args, **options: dataclasses.replace(sure(*args, **options), status="FEW_EFFECTIVE_SAMPLES")  # noqa: E731
    required = Requirement(lower=-LIMIT, upper=LIMIT, target=1 - 1e-6)
    narrow = Population.of({name: Tolerance.symmetric(5 * um) for name in PAIR})
    certifier = certifier_of(linear, PAIR, required)
    assert certifier.holds(certifier.draw(narrow))
    monkeypatch.setattr(certificate, "failure_probability", doubt)
    refused = certifier.draw(narrow)
    assert not certifier.holds(refused) and "not to be trusted" in refused.verdicts[""].wanted
    plain = certifier_of(linear, PAIR, Requirement(lower=-LIMIT, upper=LIMIT)).draw(narrow).verdicts[""]
    assert plain.met and "sampling" not in plain.wanted  # what a share of units can show, it shows


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_no_yield_exceeds_one(seed):
    """Units fail where all five errors are small: by points about the nominal unit their share was below 0."""
    few = lambda e: jnp.sqrt(jnp.sum(e["v"] ** 2))  # noqa: E731
    spread = {"v": Tolerance.symmetric(3.0, shape=(5,))}
    certifier = certifier_of(few, spread, Requirement(lower=0.2, target=1 - 1e-6), seed=seed)
    verdict = certifier.draw(Population.of(spread)).verdicts[""]
    assert 1 - 2e-5 < verdict.estimate.lower <= 1 - stats.chi2.cdf(0.04, 5) <= verdict.estimate.upper <= 1
    assert not verdict.met


def test_other_costs_and_kept_fields():
    """Exponential and tabulated costs against a fine scan of the one free direction; c keeps its tolerance."""
    costs = {
        "a": Exponential(decay=20 * um, finest=1 * um, coarsest=200 * um, scale=3.0),
        "b": Table((2 * um, 10 * um, 60 * um), (9.0, 2.0, 0.5)),
        "c": None,
    }
    tolerances = {**PAIR, "c": Tolerance.symmetric(12 * um)}
    required = Requirement(lower=-LIMIT, upper=LIMIT, target=0.99)
    found = allocate(Linear(dict(a=1.0, b=2.0, c=1.0)), tolerances, required, costs=costs, **SIZES)
    reach = math.hypot(found.half_widths["a"], 2 * found.half_widths["b"], 12 * um)
    reached = 2 * stats.norm.cdf(3 * LIMIT / reach) - 1
    assert 0 < above(reached, 0.99, UNITS) < 5
    free = radius(reached) ** 2 - (12 * um) ** 2
    b = np.linspace(2 * um, math.sqrt(free) / 2 * 0.999, 20_000)
    b = b[b <= 60 * um]
    a = np.sqrt(free - 4 * b**2)
    total = 3 * np.exp(-a / (20 * um)) + np.exp(
        np.interp(np.log(b), np.log(costs["b"].half_widths), np.log(costs["b"].costs))
    )
    assert found.cost == pytest.approx(total[a >= 1 * um].min(), rel=0.005)
    assert found.tolerances["c"].upper == 12 * um
    assert "c" not in found.half_widths


def test_asymmetric_shifted_field_scales_about_its_middle():
    tolerances = {"a": Tolerance(-2 * um, 8 * um, cp=1.2, shift=0.3), "b": Tolerance.symmetric(1 * um)}
    required = Requirement(upper=30 * um, target=0.99)
    found = allocate(Linear({"a": 1.0, "b": 1.0}), tolerances, required, costs={"a": WIDE}, **SIZES)
    t = found.half_widths["a"]
    assert (found.tolerances["a"].lower, found.tolerances["a"].upper) == pytest.approx((3 * um - t, 3 * um + t))
    assert found.tolerances["a"].shift == 0.3
    sd = math.hypot(t / 3.6, um / 3)
    assert 0 < above(stats.norm.cdf((27 * um - 0.3 * t) / sd), 0.99, UNITS) < 5


def test_failed_units_count_as_rejects():
    """Units with |b| > 15 um fail: 0.5 % of those of a wider b, which leave a that much less of the share."""
    response, edge = Failing({"a": 1.0, "b": 0.0}, {"a": 1.0, "b": 15 * um}), stats.norm.isf(0.0025)
    wide = PAIR | {"b": Tolerance.symmetric(45 * um / edge)}
    required = Requirement(lower=-LIMIT, upper=LIMIT, target=0.99)
    found = allocate(response, wide, required, costs={"a": WIDE}, **SIZES)
    assert found.status == "OPTIMAL"
    failed = found.certificate.failed / found.certificate.samples
    assert abs(above(failed, 0.005, UNITS)) < 4
    reached = 0.995 * (2 * stats.norm.cdf(3 * LIMIT / found.half_widths["a"]) - 1)
    assert 0 < above(reached, 0.99, UNITS) < 5
    hopeless = allocate(
        response, PAIR | {"b": Tolerance.symmetric(60 * um)}, Requirement(upper=LIMIT), costs={"a": WIDE}, **SIZES
    )
    assert hopeless.status == "INFEASIBLE"
    assert hopeless.shortfall == math.inf  # no limit is wide enough for units that do not exist


def test_few_steps_and_few_certificate_units(thorough):
    """Few steps run by default in test_tolerances_search.py."""
    if thorough:
        found = allocate(linear, PAIR, BOTH, max_steps=1, **CERTIFIED)
        assert found.status == "MAX_STEPS"
        assert found.certificate.yield_.lower >= 0.9973
    joint = dict(joint_target=0.9973, certificate_samples=1000)  # 1000/1003.84 < 0.9973
    found = allocate(linear, PAIR, BOTH, **(CERTIFIED | joint))
    assert found.status == "NOT_CERTIFIED"
    assert found.feasible


def test_grades():
    found = allocate(linear, PAIR, BOTH, grades=True, **CERTIFIED)
    graded = found.graded
    assert graded.status == "OPTIMAL"
    for name, grade in graded.grades.items():
        assert graded.half_widths[name] == pytest.approx(it_width(grade, 25 * mm) / 2)
    # The cheapest grades by enumeration of the closed-form yield (none of them stands near the limit).
    widths = {f"IT{k}": it_width(f"IT{k}", 25 * mm) / 2 for k in range(1, 12)}
    sets = [
        (10 * um / a + 10 * um / b, {"a": ga, "b": gb})
        for ga, a in widths.items()
        for gb, b in widths.items()
        if 1 * um <= min(a, b) and math.hypot(a, 2 * b) <= radius(0.9973) * 0.99
    ]
    assert graded.grades == min(sets, key=lambda item: item[0])[1]
    assert graded.certificate.yield_.lower >= 0.9973


def test_shares_alone_have_no_other_figure():
    """Failed units are rejects; which ones failed, and why, is not known where not all units were solved."""
    response = lambda e: {"y": jnp.where(e["a"] > 5 * um, jnp.nan, e["a"])}  # noqa: E731
    seen = monte_carlo(response, PAIR, samples=2000, seed=1, requirements={"y": BOTH}, keep=True)
    found = shares_alone(seen)
    assert seen.failures and seen.examples and seen.worst_index is not None
    assert (found.yield_, found.ppm, found.verdicts, found.failed) == (
        seen.yield_,
        seen.ppm,
        seen.verdicts,
        seen.failed,
    )
    assert (found.failures, found.examples, found.worst_index, found.values) == ({}, {}, None, None)


def test_a_certificate_of_costly_grades_has_the_shares_of_all_units_and_nothing_else():
    goal = Requirement(lower=-LIMIT, upper=LIMIT, target=0.99)
    found = allocate(Costly(linear), PAIR, goal, costs=COSTS, grades=True, samples=2048, certificate_samples=8192)
    seen, options = found.graded.certificate, dict(samples=8192, seed=found.certificate.seed, requirements=goal)
    due = monte_carlo(linear, found.graded.tolerances, **options)
    assert (seen.yield_, seen.ppm, seen.verdicts) == (due.yield_, due.ppm, due.verdicts)
    assert found.graded.status == "OPTIMAL" and found.graded.grades
    assert all(math.isnan(figure) for figure in (seen.mean.value, seen.sd.value, seen.minimum, seen.cpk))
    assert seen.values is None and all(math.isnan(one.value) for one in seen.quantiles.values())
    whole = monte_carlo(linear, found.tolerances, **options)
    for name in ("mean", "sd"):
        assert getattr(found.certificate, name).value == pytest.approx(getattr(whole, name).value, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(requirements=None), "requirements: needs at least one"),
        (dict(costs={}), "costs: no field has a cost"),
        (dict(costs=WIDE), "costs: must be a record or a dict"),
        (dict(costs={"d": WIDE}), "costs: 'd' has no tolerance; these have: a, b"),
        (dict(costs={"a": 3.0}), "costs: a = 3.0: must be one of ReciprocalPower, Exponential, Table"),
        (dict(joint_target=1.0), "joint_target = 1.0: must lie between 0 and 1"),
        (dict(samples=10), "samples = 10: must be at least 100"),
        (dict(max_steps=0), "max_steps = 0: must be at least 1"),
    ],
)
def test_bad_input_is_named(changes, message):
    arguments = dict(requirements=Requirement(upper=LIMIT), costs=COSTS) | changes
    with pytest.raises(ValueError, match=message):
        allocate(linear, PAIR, **arguments)
