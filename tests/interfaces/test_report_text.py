"""The figures of a report as text: every number in the unit that stands beside it.

Oracle: the same numbers converted by hand.
"""

import dataclasses
import io
import math
from types import SimpleNamespace

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes

from rvjax import Status
from rvjax.commands import allocate
from rvjax.commands.allocate import losses_of
from rvjax.commands.allocate.tables import _price
from rvjax.commands.cells import against_limit, condition_text, evaluated, failures_text, price_text, share
from rvjax.commands.montecarlo import report_on
from rvjax.outputs import Output
from rvjax.population.estimates import Estimate
from rvjax.render import Figure, saved
from rvjax.study import load
from rvjax.study.study import About
from rvjax.tolerances import Outcome, QuadraticLoss, Requirement, WorstCaseWithin, expected_losses, monte_carlo
from rvjax.units import arcmin, rpm, um


def allocation(**changes):
    found = dict(status="OPTIMAL", feasible=True, start_cost=10.0, cost=8.0, graded=None, shortfall={})
    certificate = SimpleNamespace(joint_yield=changes.pop("joint", None))
    return SimpleNamespace(certificate=certificate, **found | changes)


def headline(**changes):
    target = changes.pop("target", None)
    study = SimpleNamespace(
        name="s", about=About(), joint_target=target, losses={},
        output=lambda name: Output("rad", name, None, read_in="arcmin"),
        requirements=dict.fromkeys(("error", "met", "lost"), Requirement(upper=1 * arcmin)),
        assumed_limits=(), assumed=[],
    )  # fmt: skip
    found = SimpleNamespace(study=study, allocation=allocation(**changes), unlimited={})
    return allocate.headline(found).split("\n")


def test_losses_are_stated_before_and_after_with_the_cost():
    """2 for 1 arcmin: a mean of 0.5 and a deviation of 0.5 arcmin cost 1; afterwards 0.25 and 0.25 cost 0.25."""

    def units(size):
        about = {"error": Estimate.about(size * arcmin, 0.0, 2.0)}
        return SimpleNamespace(confidence=0.95, infinite={"error": 0}, mean=about, sd=about)

    losses = {"error": QuadraticLoss(2.0, 1 * arcmin)}
    study = SimpleNamespace(losses=losses, output=lambda name: Output("rad", name, None, read_in="arcmin"))
    after = expected_losses(losses, units(0.25))
    whole = Estimate(8.25, 0.0, 8.25, 8.25)
    answer = SimpleNamespace(
        study=study, certificate_before=units(0.5),
        allocation=SimpleNamespace(start_cost=9.0, losses=after, objective=whole),
    )  # fmt: skip
    assert losses_of(answer) == [
        "mean loss of error (2 for 1 arcmin off 0 arcmin): 1.000 -> 0.250, 0.250 to 0.250",
        "cost with losses 10.000 -> 8.250, 8.250 to 8.250",
    ]
    endless = units(0.5)
    endless.infinite = {"error": 3}
    assert expected_losses(losses, endless)["error"].value == math.inf


def test_a_price_that_no_search_found_is_unknown():
    error = SimpleNamespace(shown=("arcmin", arcmin))
    cells = [(price, error, None) for price in (math.nan, 0.0, -2 / arcmin)]
    cells.append((-2 / arcmin, error, (-2.5 / arcmin, -1 / arcmin)))
    said = [_price(*cell) for cell in cells]
    assert said == ["unknown", "not binding", "-2 /arcmin", "-2 [-2.5, -1] /arcmin"]


def test_a_price_says_what_it_means():
    """0.0098 an hour is 0.98 for 100 h; a limit on both sides moves on both; one that does not bind has no price."""
    study = load("rv-40e-whole", solve=False)
    prices = dict.fromkeys(study.requirements, 0.0)
    assert price_text(study, prices) == ""
    prices |= {"life": -0.0098 / 3600, "turn_pin_pressure": -0.0074e-6, "misfit": math.nan}
    saved = "100 h less life saves 0.98; 100 MPa more turn_pin_pressure saves 0.74"
    assert price_text(study, prices) == f"shadow price: {saved}."
    two = Requirement(lower=-1 * arcmin, upper=1 * arcmin)
    both = SimpleNamespace(
        requirements={"lost_motion": two}, output=lambda name: SimpleNamespace(shown=("arcmin", arcmin))
    )
    said = price_text(both, {"lost_motion": -15.6 / arcmin})
    assert said == "shadow price: 0.1 arcmin wider limits of lost_motion save 1.56."


def test_a_worst_unit_says_its_value_and_the_limit():
    output = Output("s", "life", lambda *_: (0.0, 0), read_in="h")
    life = Requirement(lower=6000 * 3600.0)
    assert against_limit(4780 * 3600.0, life, output) == "4,780 h, below 6000 h"
    assert against_limit(6020 * 3600.0, life, output) == "6,020 h, limit 6000 h"
    both = Requirement(lower=-1 * arcmin, upper=1 * arcmin)
    error = Output("rad", "error", lambda *_: (0.0, 0))
    assert against_limit(1.02 * arcmin, both, error) == "1.02 arcmin, above 1 arcmin"
    assert against_limit(-0.9 * arcmin, both, error) == "-0.9 arcmin, limit -1 arcmin"


def test_conditions_are_read_in_units():
    given = load("rv-40e-whole", solve=False).conditions
    about = {f.name: f.metadata for f in dataclasses.fields(given)}
    rows = ((784.0, 15 * rpm, 3600.0), (0.0, 0.0, 60.0))
    assert condition_text(rows, about["duty"]) == "784 N m, 15 rpm, 1 h; 0 N m, 0 rpm, 60 s"
    assert condition_text(given.output_torque, about["output_torque"]) == "412 N m"
    assert condition_text(24, about["samples"]) == "24" and condition_text("basic", about["life_method"]) == "basic"


def test_plots_spell_units_as_the_page():
    def draw():
        axes = plt.subplots()[1]
        axes.set(xlabel="error (um)", ylabel="humus (arcmin/um)", title="0.3 um of 1 us")
        drawn.append(axes)
        return axes

    drawn = []
    Figure("x", "a plot", draw).content("svg")
    (axes,) = drawn
    assert axes.get_xlabel() == "error (µm)" and axes.get_title() == "0.3 µm of 1 µs"
    assert axes.get_ylabel() == "humus (arcmin/µm)"


@pytest.mark.parametrize("form", ["png", "svg"])
def test_a_plot_with_a_layout_is_drawn_once_and_has_the_bytes_of_savefig(form, monkeypatch):
    """`savefig` draws such a figure twice, unseen for its layout."""
    drawn, draw = [], Axes.draw

    def made():
        axes = plt.subplots(layout="constrained")[1]
        axes.plot([0, 1], [0, 1e-3], label="a line")
        axes.set(xlabel="x (um)", ylabel="y\nin two lines", title="a title")
        axes.legend()
        return axes.figure

    file = io.BytesIO()
    with plt.rc_context({"svg.hashsalt": "rvjax"}):
        made().savefig(file, format=form, dpi=150, metadata={"Date": None} if form == "svg" else None)
    monkeypatch.setattr(Axes, "draw", lambda self, renderer: drawn.append(self) or draw(self, renderer))
    assert saved(made(), form) == file.getvalue() and len(drawn) == 1
    plt.close("all")


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
    assert failures_text(SimpleNamespace(failed=0, infinite={"life": 0})) == "0 failed"
    endless = failures_text(SimpleNamespace(failed=0, infinite={"play": 0, "life": 1200}))
    assert endless == "0 failed; infinite: life of 1,200 units (mean, sd and Cpk exclude them)"


def test_a_worst_case_says_that_it_is_searched(monkeypatch):
    """A size, whose slopes change sign where no error lies, and a sum; in the text of both commands and on the page."""
    limits = {"misfit": WorstCaseWithin(upper=50 * um), "lost_motion": WorstCaseWithin(upper=5 * arcmin)}
    question = dataclasses.replace(load("rv-40e", solve=False), requirements=limits)

    def response(errors):
        total = jnp.sum(errors.disc_bore) + jnp.sum(errors.carrier_bore)
        return {"misfit": jnp.abs(total), "lost_motion": total}

    monkeypatch.setattr(type(question), "response", lambda self, *, solve=True: response)
    found = monte_carlo(response, question.tolerances, samples=16, seed=0, requirements=limits)
    answer = SimpleNamespace(
        study=question,
        allocation=SimpleNamespace(tolerances=question.tolerances, certificate=SimpleNamespace(verdicts={})),
        after=SimpleNamespace(values={}),
        whole=None,
    )
    for text in (report_on(found, question).text(), "\n".join(allocate.limits_of_the_answer(answer))):
        assert "Worst case of misfit: slopes change sign within the limits" in text
        assert "Worst case of lost_motion" not in text


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
