"""Sliders of a design on its page: a linear prediction about the optimum, held against the models and the costs.

JavaScript runs where node is installed.
"""

import json
import shutil
import subprocess
import sys
from functools import cache
from importlib import resources

import numpy as np
import pytest
from cli_study import one_start

from rvjax import study
from rvjax.commands.design import prices
from rvjax.commands.design.optimum import Designed, Point
from rvjax.tolerances import allocate

STUDY = """
[design]
base = "rv-40e-whole"
[variable."cycloid.eccentricity"]
lower = "1.1 mm"
upper = "1.5 mm"
cost = {price = 3.0, per = "1 mm"}
[variable."contact.face_width"]
lower = "8 mm"
upper = "16 mm"
[objective]
mass = {price = 2.0, per = "1 kg"}
[tolerances.pin_radius]
half_width = "2 um"
[cost.pin_radius]
scale = 1
reference = "2 um"
finest = "0.5 um"
coarsest = "20 um"
[requirement.lost_motion]
lower = "-1.6 arcmin"
upper = "0.6 arcmin"
target = 0.99
[requirement.convex_radius]
nominal_lower = "1 mm"
[run]
samples = 2048
certificate_samples = 20480
"""  # of which 205 may fail: no rare units are sought


@cache
def page():
    made = study.parse_study(STUDY, name="x", solve=False)
    with one_start(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules["rvjax.tolerances.allocation.allocate"], "ranges", lambda *_: {})  # not on the page
        found = allocate(
            made.design_response(), made.tolerances, made.requirements | made.nominal, costs=made.costs,
            variables=made.variables, objective={name: price(1.0) for name, price in made.objective.items()},
            samples=made.samples, certificate_samples=made.certificate_samples,
        )  # fmt: skip
    outputs = {n: float(v) for n, v in made.nominal_response()(made.design.error_record(), found.values).value.items()}
    point = Point(found, made.design_with(found.values), outputs)
    return made, found, prices.data(made, Designed(point, outputs, None, {}, None, [], []))


def predicted(at):
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node on PATH: the arithmetic of the page is not run")
    code = "".join(
        (resources.files(f"rvjax.commands.{folder}") / "live.js").read_text("utf-8") for folder in ("report", "design")
    )
    call = f"console.log(JSON.stringify(LiveDesign.predicted({json.dumps(page()[2])}, {json.dumps(at)})));"
    return json.loads(subprocess.run([node, "-e", code + call], capture_output=True, check=True, text=True).stdout)


def moved(step):
    """Places of the sliders, by parts of their reach away from the optimum."""
    return [slider["centre"] + part * slider["reach"] for slider, part in zip(page()[2]["sliders"], step)]


def test_at_the_optimum_it_is_the_result():
    _, found, data = page()
    seen = predicted(moved([0, 0, 0]))
    assert seen["cost"] == pytest.approx(found.cost) and seen["far"] == []
    assert all(row["met"] for row in seen["units"] + seen["nominal"])
    assert [slider["unit"] for slider in data["sliders"]] == ["mm", "mm", "um"]


def test_a_moved_slider_predicts_cost_and_outputs():
    made, _, data = page()
    step = np.array([0.5, 0.5, -0.5])
    at = moved(step)
    seen, sizes = predicted(at), [slider["size"] for slider in data["sliders"]]
    values = {slider["name"]: x * size for slider, x, size in zip(data["sliders"][:2], at, sizes)}
    exact = made.nominal_response()(made.design.error_record(), values).value
    for row, name in zip(seen["nominal"], made.without_errors):
        assert row["value"] * made.output(name).shown[1] == pytest.approx(float(exact[name]), rel=0.01)
    own = sum(made.variables[path].own_cost(value) for path, value in values.items())
    half = at[2] * sizes[2]
    cost = float(made.costs["pin_radius"](half)) + own + made.objective["mass"](float(exact["mass"]))
    assert seen["cost"] == pytest.approx(cost, rel=1e-3)


def test_the_price_of_a_limit_is_the_slope_of_its_margin():
    """At a fixed optimum a finer half-width costs what the room that it makes is worth."""
    made, found, _ = page()
    here, there = predicted(moved([0, 0, 0])), predicted(moved([0, 0, -0.1]))
    room = (there["units"][0]["distance"] - here["units"][0]["distance"]) * made.output("lost_motion").shown[1]
    assert there["cost"] - here["cost"] == pytest.approx(-found.multipliers["lost_motion"] * room, rel=0.05)
    wide = predicted(moved([0, 0, 2.0]))
    assert [slider["name"] for slider in wide["far"]] == ["pin_radius"] and not wide["units"][0]["met"]
