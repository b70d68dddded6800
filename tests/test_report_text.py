"""The figures of a report as text: every number in the unit that stands beside it.

Oracle: the same numbers converted by hand.
"""

import math
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Status
from rvjax.commands import allocate
from rvjax.commands.allocate.report import _Price
from rvjax.commands.cells import evaluated, failures_text, share
from rvjax.commands.montecarlo import report_on
from rvjax.population.estimates import Estimate
from rvjax.study import load
from rvjax.study.study import About
from rvjax.tolerances import Outcome, Requirement, monte_carlo
from rvjax.units import arcmin, um


def allocation(**changes):
    found = dict(status="OPTIMAL", feasible=True, start_cost=10.0, cost=8.0, graded=None, shortfall={})
    certificate = SimpleNamespace(joint_yield=changes.pop("joint", None))
    return SimpleNamespace(certificate=certificate, **found | changes)


def headline(**changes):
    target = changes.pop("target", None)
    study = SimpleNamespace(
        name="s", about=About(), joint_target=target, output=lambda name: SimpleNamespace(shown=("arcmin", arcmin)),
        requirements=dict.fromkeys(("error", "lost"), Requirement(upper=1 * arcmin)), assumed=[], assumed_limits=set(),
    )  # fmt: skip
    return allocate.headline(SimpleNamespace(study=study, allocation=allocation(**changes))).split("\n")


def test_a_price_that_no_search_found_is_unknown():
    error = SimpleNamespace(shown=("arcmin", arcmin))
    said = [_Price("shadow price").text((price, error)) for price in (math.nan, 0.0, -2 / arcmin)]
    assert said == ["unknown", "not binding", "-2 /arcmin"]


def test_a_yield_has_both_ends_of_its_interval():
    assert share(Estimate(0.99, 0.002, 0.985, 0.9951)).text() == "99.000 % [98.500, 99.510]"


def test_a_batch_says_how_many_units_failed_why_and_how_they_count():
    """Every unit below a bore error of 0 fails, those far below for another reason: half of all, and all rejects."""
    question = load("rv-40e", solve=False)

    def response(errors):
        x = errors.disc_bore[0, 0, 0]
        status = jnp.where(x < 0, Status.MAX_STEPS, Status.CONVERGED)
        return Outcome({"misfit": x}, jnp.where(x < -3 * um, Status.CONTACT_OVERLOAD, status))

    found = monte_carlo(
        response, question.tolerances, samples=512, seed=0, requirements={"misfit": Requirement(upper=1.0)}
    )
    counts = found.failures
    assert sum(counts.values()) == found.failed and set(counts) == {"MAX_STEPS", "CONTACT_OVERLOAD"}
    assert abs(found.failed - 256) < 5 * np.sqrt(128) and found.yield_["misfit"].value == 1 - found.failed / 512
    line = report_on(found, question).text().split("\n")[1]
    assert line.startswith(f"{found.failed} failed, each a reject in every yield: ") and "; standard errors" in line
    for status, count in counts.items():
        assert f"{count} {status} (unit {found.examples[status]})" in line
    told = report_on(found, question).json()
    assert (told["failed"], told["failures"], told["examples"]) == (found.failed, counts, found.examples)
    assert failures_text(SimpleNamespace(failed=0)) == "0 failed"


def test_a_saving_is_a_negative_change():
    assert headline()[2] == "cost 10.000 -> 8.000 (-20.0 %)"
    graded = SimpleNamespace(cost=9.0, status="NOT_CERTIFIED")
    assert headline(graded=graded)[3].endswith("cost 9.000 (NOT_CERTIFIED)") and len(headline(graded=graded)) == 4


def test_the_verdict_says_the_yield_of_all_requirements_at_once():
    joint = Estimate(0.99, 0.002, 0.985, 0.9951)
    words = "joint yield: 99.000 % [98.500, 99.510] "
    assert headline(joint=joint)[:2] == ["Study s: OPTIMAL", words + "(no joint_target set)"]
    assert headline(joint=joint, target=0.9973)[1] == words + "(joint_target 99.73 %)"


def test_a_shortfall_is_told_in_the_unit_of_its_limit():
    missing = {"error": 0.3 * arcmin, "met": 0.0, "lost": np.inf}
    lines = headline(feasible=False, status="INFEASIBLE", shortfall=missing)
    assert lines[0] == "Study s: INFEASIBLE" and len(lines) == 5
    assert lines[3] == "  the limit of error would have to move by 0.3 arcmin: <= 1.3 arcmin can be met"
    assert "limit of lost cannot be met" in lines[4]


@pytest.mark.parametrize(
    ("kind", "shown"),
    [("share", "90.000 % [80.000, 95.000]"), ("response", "3094 arcmin [2750, 3266]"), ("number", "0.9 [0.8, 0.95]")],
)
def test_a_figure_is_told_in_its_own_unit(kind, shown):
    verdict = SimpleNamespace(kind=kind, estimate=Estimate(0.9, 0.05, 0.8, 0.95))
    output = SimpleNamespace(unit="rad", read_in="arcmin")
    assert evaluated(verdict, output).text() == shown
