"""What a search promises besides its optimum: samples, certificates, bounds on its steps, the same bits again.

Oracles: the normal law of a line of errors, by which the share of half-widths is known; `tests/optima_cases.py`.
"""

import math
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from codesign_cases import one_start
from optima_cases import CASES
from scipy import stats

from benchmarks import optima_problems
from rvjax.population import Estimate
from rvjax.response import Part
from rvjax.tolerances import Memo, Requirement, allocate
from rvjax.tolerances.allocation import search
from rvjax.tolerances.allocation.certificate import TESTS, Certifier
from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.batch.run import Run
from tests.oracles.linear_pair import COSTS, LIMIT, PAIR, closed_cost, linear, share, two

LINE = CASES["line"]
SOON = dict(requirements={"y": Requirement(lower=-1.0, upper=1.0, target=0.9)}, samples=512, certificate_samples=4096)
"""A target for which 512 units are enough: for tests of certificates."""


def solved(case=LINE, costly=True, **changes):
    given = case.arguments(costly, **changes)
    return allocate(given.pop("response"), given.pop("tolerances"), given.pop("requirements"), **given)


def reached(found, case=LINE):
    return case.share(np.array(list(found.half_widths.values())))


@pytest.mark.parametrize(
    ("target", "last"), [(0.9, 512), (0.98, 2048), pytest.param(0.998, 16_384, marks=pytest.mark.long)]
)
def test_a_sample_of_costly_units_grows_until_enough_lie_beyond_each_limit(target, last, monkeypatch, thorough):
    """At least 40 of the last one, whatever the least that is asked for; every larger one holds those before."""
    counts, take = [], Constraints.sample

    def sample(self, count):
        before = getattr(self, "plain", None)
        take(self, count)
        counts.append(count)
        assert before is None or np.array_equal(before, self.plain[:, : before.shape[1]])

    monkeypatch.setattr(Constraints, "sample", sample)
    need = {"y": Requirement(lower=-1.0, upper=1.0, target=target)}
    found = solved(requirements=need, samples=100, certificate_samples=4096)
    assert counts[0] == 512 and counts == sorted(counts) and counts[-1] == found.evaluations["sample"] == last
    assert last * (1 - target) >= 32
    if last == 512 and not thorough:
        return
    most = solved(requirements=need, samples=4096, certificate_samples=4096)
    assert most.evaluations["sample"] == max(last, 4096)


def test_certificates_are_of_one_sample_that_no_search_has_seen(monkeypatch):
    seeds, made = [], Run.statistics
    monkeypatch.setattr(Run, "statistics", lambda self: seeds.append((self.seed, self.samples)) or made(self))
    found = solved(seed=5, **SOON)
    assert len(seeds) > 1 and len(set(seeds)) == 1 and seeds[0][0] == found.certificate.seed == 6


@pytest.mark.parametrize(("drawn", "times"), [(0, 4), (1, 1)])
def test_certificate_units_are_not_added_once_a_certificate_was_drawn(drawn, times, monkeypatch):
    made, full = [], search.Search.certified
    monkeypatch.setattr(search.Search, "certified", lambda self, end: made.append((self, end)) or full(self, end))
    found = solved(**SOON)
    own, end = made[0]
    own.certifier.drawn, before = drawn, own.problem.run.samples
    own.certifier.run = own.problem.run
    monkeypatch.setattr(search.Search, "_gain", lambda *given: 1e9)
    own._enough(end)
    assert found.status == "OPTIMAL" and own.certifier.run.samples == times * before


def test_after_a_miss_the_wanted_rejects_are_those_of_the_result(monkeypatch):
    """Grades and prices go on from them; a looser vector is tried, and misses."""
    seen, ends, test, certified = [], [], Certifier.test, search.Search.certified

    def tested(self, constraints, x):
        seen.append((x, constraints.rejects))
        return test(self, constraints, x)

    def end(self, given):
        ends.append((self.constraints, *certified(self, given)))
        return ends[-1][1:]

    monkeypatch.setattr(Certifier, "test", tested)
    monkeypatch.setattr(Certifier, "holds", lambda self, statistics: len(seen) == 1)
    looser = lambda self, constraints, *_: (1.2 * constraints.rejects, constraints.moved)  # noqa: E731
    monkeypatch.setattr(Certifier, "corrected", looser)
    monkeypatch.setattr(search.Search, "certified", end)
    solved(**SOON)
    (constraints, _, best), (x, rejects) = ends[0], seen[0]
    assert len(seen) > 1 and (best.look.x == x).all()
    assert (constraints.rejects == rejects).all() and (seen[-1][1] != rejects).any()


def recorded(monkeypatch):
    """Wanted rejects of the first limit at each certificate of the searches to come."""
    shares, test = [], Certifier.test

    def tested(self, constraints, x):
        shares.append(float(constraints.rejects[0]))
        return test(self, constraints, x)

    monkeypatch.setattr(Certifier, "test", tested)
    return shares


def test_between_a_certificate_that_holds_and_one_that_misses_all_limits_move_half_way(monkeypatch):
    """The edge of one limit moves with the others. Here 1.15 times the first rejects hold."""
    shares = recorded(monkeypatch)
    monkeypatch.setattr(Certifier, "holds", lambda self, statistics: shares[-1] <= 1.15 * shares[0])
    looser = lambda self, constraints, *_: (1.5 * constraints.rejects, constraints.moved)  # noqa: E731
    monkeypatch.setattr(Certifier, "corrected", looser)
    solved(**SOON)
    assert np.array(shares[:4]) / shares[0] == pytest.approx([1, 1.5, 1.5**0.5, 1.5**0.25])


def test_a_certificate_that_holds_after_one_that_missed_stays_below_it(monkeypatch):
    """Half of the first rejects hold. Three times these are half way to those that missed."""
    shares = recorded(monkeypatch)
    monkeypatch.setattr(Certifier, "holds", lambda self, statistics: shares[-1] <= 0.6 * shares[0])

    def corrected(self, constraints, *_):
        return (0.5 if len(shares) == 1 else 3.0) * constraints.rejects, constraints.moved

    monkeypatch.setattr(Certifier, "corrected", corrected)
    solved(**SOON)
    assert np.array(shares[:3]) / shares[0] == pytest.approx([1, 0.5, 0.5**0.5])


def test_each_certificate_that_misses_aims_one_unit_farther_inside(monkeypatch):
    """Else limits that fail in turn, by a unit each, would use up all certificates."""
    shares = recorded(monkeypatch)
    monkeypatch.setattr(Certifier, "holds", lambda self, statistics: False)
    count = solved(**SOON).certificate.samples
    farther = (shares[1] - shares[-1]) * count  # the first correction is that of the sample
    assert len(shares) == TESTS and 0.5 < farther / (TESTS - 2) < 2


def test_certificate_units_are_chosen_before_the_largest_sample(monkeypatch):
    """And again at its end, where the prices are those of the result."""
    counts, enough = [], search.Search._enough

    def counted(self, end):
        counts.append(self.constraints.count)
        return enough(self, end)

    monkeypatch.setattr(search.Search, "_enough", counted)
    solved(requirements={"y": Requirement(lower=-1.0, upper=1.0, target=0.998)}, samples=100, certificate_samples=4096)
    assert counts == [4096, 16_384]


def test_more_certificate_units_are_drawn_where_they_save_more_than_they_cost(thorough):
    """1000 units want a share of 99.7 %, which costs 15 %; each doubling saves a third of it. 50,000 are enough."""
    few = solved(certificate_samples=1000)
    assert 2000 <= few.certificate.samples <= 4000
    if not thorough:
        return
    many = solved(certificate_samples=50_000)
    assert many.certificate.samples == 50_000
    assert many.cost < few.cost and many.learned == pytest.approx(few.learned, rel=0.02)


def test_a_certificate_of_few_units_makes_a_result_dearer_than_what_was_learned(monkeypatch):
    """400 units, where no more are drawn, want 99.9 % for 99 %: 1.25 times the cost."""
    monkeypatch.setattr(search, "_TIMES", 1)
    found = solved(certificate_samples=400)
    assert found.status == "SUBOPTIMAL" and found.cost > 1.2 * found.learned
    assert found.certificate.samples == 400 and found.certificate.verdicts["y"].met and reached(found) > 0.99


@pytest.mark.parametrize(
    ("most", "costly"),
    [(1, False), (1, True), *(pytest.param(3, costly, marks=pytest.mark.long) for costly in (False, True))],
)
def test_few_steps_are_no_optimum(costly, most):
    """Each run of the search ends after so many looks. What is returned holds its certificate."""
    found = solved(costly=costly, max_steps=most)
    assert found.certificate.verdicts["y"].met and reached(found) > 0.99
    if most == 1 or found.status != "OPTIMAL":  # the last run may settle
        assert found.status == "MAX_STEPS"
    else:
        assert found.cost < 1.004 * LINE.least(reached(found))[0]


@pytest.mark.long
def test_certificates_of_costly_units_hold():
    """Of 95 % intervals one end in 40 may miss. More would miss than the bound once in 500 trials."""
    runs = 100
    need = {"y": Requirement(lower=-1.0, upper=1.0, target=0.9)}
    found = [solved(requirements=need, samples=512, certificate_samples=1024, seed=7 * k) for k in range(runs)]
    assert all(item.status in ("OPTIMAL", "SUBOPTIMAL") for item in found)
    assert sum(reached(item) < 0.9 for item in found) <= stats.binom.ppf(0.998, runs, 0.025)


def test_an_interrupted_search_of_costly_units_goes_on_to_the_same_bits(monkeypatch, tmp_path):
    """Everything is worth keeping; half way through the calls of the whole run it is stopped."""
    calls, stop, solve = [0], [10**9], Part.solve

    def counted(*arguments):
        calls[0] += 1
        if calls[0] >= stop[0]:
            raise KeyboardInterrupt
        return solve(*arguments)

    monkeypatch.setattr(Part, "solve", counted)
    own = dict(samples=512, certificate_samples=1024, max_steps=3)
    found = one_start()(lambda memo: solved(CASES["line, number"], memo=memo, **own))
    whole, total = found(None), calls[0]
    calls[0], stop[0] = 0, total // 2
    with pytest.raises(KeyboardInterrupt):
        found(Memo(tmp_path, {"study": "one"}, worth=0))
    calls[0], stop[0] = 0, 10**9
    again = found(Memo(tmp_path, {"study": "one"}, worth=0))
    assert 2 < calls[0] <= total - (total // 2 - 1)
    assert (again.cost, again.half_widths, again.history) == (whole.cost, whole.half_widths, whole.history)
    assert again.certificate.yield_ == whole.certificate.yield_


@pytest.mark.long  # quick ones: test_tolerances_allocation.py; those of an interrupted run, above
@pytest.mark.parametrize("costly", [False, True])
def test_the_same_seed_gives_the_same_bits_and_another_one_the_same_optimum(costly):
    case = CASES["line, number"]
    with one_start():
        one, same, other = (solved(case, costly, seed=seed, certificate_samples=4096) for seed in (0, 0, 1))
    assert (one.cost, one.history, one.values) == (same.cost, same.history, same.values)
    assert one.certificate.yield_ == same.certificate.yield_ and one.ranges == same.ranges
    assert other.history != one.history and other.learned == pytest.approx(one.learned, rel=0.06 if costly else 0.02)


def test_single_precision_finds_the_same_optimum(thorough):
    """Numbers of units in float32, as without `rvjax.enable_x64`."""
    jax.config.update("jax_enable_x64", False)
    try:
        found = [solved(costly=costly) for costly in ((False, True) if thorough else (False,))]
        with one_start():
            numbers = solved(CASES["line, number"], False) if thorough else None
    finally:
        jax.config.update("jax_enable_x64", True)
    for item in found:
        assert item.status == "OPTIMAL" and reached(item) > 0.99
        assert item.cost < 1.004 * LINE.least(reached(item))[0]
    assert numbers is None or (numbers.status == "OPTIMAL" and numbers.values["d"] == pytest.approx(1.0, abs=0.05))


@pytest.mark.parametrize(("lower", "holds"), [(0.9899, False), (0.99, True)])
def test_a_certificate_counts_a_joint_yield_by_its_worse_end(lower, holds):
    made = lambda joint: Certifier(SimpleNamespace(joint_target=joint, run=SimpleNamespace(names=())))  # noqa: E731
    met = {"y": SimpleNamespace(met=True)}
    statistics = SimpleNamespace(verdicts=met, joint_yield=Estimate(0.992, 0.001, lower, 0.994))
    assert made(0.99).holds(statistics) is holds
    assert made(None).holds(statistics)
    assert not made(None).holds(SimpleNamespace(verdicts={"y": SimpleNamespace(met=False)}, joint_yield=None))


def test_a_joint_target_is_an_optimum_of_its_own():
    """|a + 2 b| and |b| at once, by quadrature over b; both limits bind, and their prices are those of differences."""
    due = optima_problems.joint()
    need = {"y": Requirement(lower=-LIMIT, upper=LIMIT, target=0.9), "b": Requirement(upper=0.3 * LIMIT, target=0.9)}
    found = allocate(two, PAIR, need, costs=COSTS, joint_target=0.99, certificate_samples=20_000)
    assert found.status == "OPTIMAL" and found.certificate.joint_yield.lower >= 0.99
    assert due.optimum < found.cost < 1.03 * due.optimum
    for name, price in due.prices.items():
        assert found.multipliers[name] == pytest.approx(price, rel=0.1)


def test_history_tells_each_look():
    found = allocate(linear, PAIR, Requirement(lower=-LIMIT, upper=LIMIT, target=0.99), costs=COSTS,
                     certificate_samples=20_000)  # fmt: skip
    first, last = found.history[0], found.history[-1]
    assert first["half_widths"] == pytest.approx({"a": 10e-6, "b": 10e-6}) and first["cost"] == pytest.approx(2.0)
    due = 10e-6 * math.sqrt(5) / 3 * stats.norm.isf(0.005) - LIMIT  # of the quantile that the certificate needs
    assert first["margins"]["response"] == pytest.approx(due, abs=0.06 * LIMIT) and last["values"] == {}
    assert closed_cost(share(last["half_widths"])) == pytest.approx(last["cost"], rel=1e-3)
