"""Tolerances in the words of drawings, from the study to every table, file and slider, and back.

Oracle: the arithmetic of drawings. A runout is twice the largest eccentricity, a position zone has this diameter, a
cumulative pitch error reaches from the highest to the lowest tooth: 4, 4 and 2 half-widths.
"""

import csv
import dataclasses
import io
import json
import re
from types import SimpleNamespace

import pytest
from cli_study import Straight
from live_study import in_node

from rvjax import study
from rvjax.commands import compare
from rvjax.commands.allocate import answer as computed, report_on
from rvjax.commands.cells import limits_of
from rvjax.commands.design import prices as design_prices
from rvjax.commands.report import response_surface, sliders as page_sliders
from rvjax.render import Limits
from rvjax.study import reader
from rvjax.study.tolerances import FORMS, forms
from rvjax.tolerances import Tolerance
from rvjax.units import um

PLACED = """
[design]
base = "rv-40e-whole"
[tolerances.disc_centre]
runout = "15 um" # of the bore against the teeth
[tolerances.pin_ring]
position = "diametral 20 um"
radius = "1 um" # of every pin
batch = 0.4
[tolerances.disc_pitch]
cumulative = "19 um"
spectrum = [1, 0.5]
[tolerances.pin_radius]
half_width = "2 um"
[tolerances.carrier_bore]
lower = "0 um"
upper = "4 um"
distribution = "rayleigh"
[cost.disc_centre]
scale = 2
reference = "5 um"
finest = "1 um"
coarsest = "20 um"
[cost.pin_offset]
scale = 3
reference = "5 um"
finest = "1 um"
coarsest = "15 um"
[cost.disc_pitch]
scale = 3
reference = "10 um"
finest = "2 um"
coarsest = "20 um"
[requirement.lost_motion]
upper = "3 arcmin"
target = 0.99
[requirement.turn_pin_pressure]
upper = "2800 MPa"
[run]
samples = 1024
certificate_samples = 20000
"""
HALF = {"disc_centre": 3.75, "pin_offset": 5.0, "disc_pitch": 9.5, "pin_radii": 1.0}  # um
NUMBER = {"disc_centre": 15.0, "pin_offset": 20.0, "disc_pitch": 19.0}
STATED = {"disc_centre": "runout", "pin_offset": "position diametral", "disc_pitch": "cumulative"}


@pytest.fixture(scope="module")
def asked():
    return study.parse_study(PLACED, name="placed", solve=False)


def test_the_number_of_a_drawing_follows_from_the_half_width_and_back(asked):
    for field, number in NUMBER.items():
        form, tolerance = asked.forms[field], getattr(asked.tolerances, field)
        assert float(tolerance.half_width) == pytest.approx(HALF[field] * um)
        assert form.number(tolerance) == pytest.approx(number * um)
        changed = tolerance.with_half_width(0.7 * um)
        assert form.number(changed) == pytest.approx(0.7 * um * number / HALF[field])
        limits = form.limits(form.number(changed))
        again = {key: study.quantity(limits[key], "m", "") for key in {"lower", "upper", "half_width"} & set(limits)}
        half = again.get("half_width", again.get("upper", 0.0) / 2)
        assert half == pytest.approx(0.7 * um) and again.get("lower", 0.0) == 0.0
    assert set(asked.forms) == {*NUMBER, "pin_radii"} and asked.forms["pin_radii"].stated == ""
    assert forms({"pin_ring": {"position": "diametral 3 um"}}) == {"pin_offset": FORMS["position"]}


def limits(form, lower, upper, field="error"):
    """Cell of limits in um, stated in a form."""
    given = SimpleNamespace(unit=lambda _: "m", forms={} if form is None else {field: form})
    return limits_of(given, field, Tolerance(lower * um, upper * um))


@pytest.mark.parametrize(("word", "lower", "upper"), [("cumulative", -3, 5), ("runout", 1, 5)])
def test_limits_that_no_drawing_states_so_stay_limits(word, lower, upper):
    """A moved zone is more than its width; the same words would promise another part."""
    said = limits(FORMS[word], lower, upper).text()
    assert said == f"{(lower + upper) / 2:.2f} +-{(upper - lower) / 2:.2f} um"


@pytest.mark.parametrize(
    ("word", "half", "said"),
    [
        ("runout", 1.875, "runout 7.5 um"),
        ("position", 2.8, "position diametral 11.2 um"),
        ("cumulative", 8.5, "cumulative 17.0 um"),
        ("cumulative", 0.043, "cumulative 0.086 um"),
    ],
)
def test_a_table_states_what_a_drawing_does(word, half, said):
    ends = (-half, half) if word == "cumulative" else (0.0, 2 * half)
    column = Limits("after")
    assert column.text(limits(FORMS[word], *ends)) == said
    assert column.headers() == ["lower after", "upper after", "drawing after"]
    due = [*ends, {"cumulative": 2, "runout": 4, "position": 4}[word] * half]
    assert column.values(limits(FORMS[word], *ends)) == pytest.approx(due, abs=1e-12)
    plain = column.values(limits(None, *ends))
    assert plain[:2] == pytest.approx(due[:2], abs=1e-12) and plain[2] is None


CHEAP = PLACED.replace("rv-40e-whole", "rv-40e").replace('radius = "1 um" # of every pin\n', "")
CHEAP = CHEAP.partition("[requirement.turn")[0] + "[run]" + CHEAP.partition("[run]")[2]


@pytest.fixture(scope="module")
def answer():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(computed, "targets", lambda _: [])  # no curve of costs, a third of the time
        found = computed.answer(study.parse_study(CHEAP, name="placed"), measure=False)
    assert found.allocation.feasible
    return found


def test_every_table_of_a_result_states_what_the_study_does(answer):
    """The half-width stays in the files of data, next to the number of the drawing."""
    report, found = report_on(answer), answer.allocation.tolerances
    rows = dict(re.findall(r"^(\w+) .*? um +(.*? um) ", report.text(), re.M))
    for field, words in STATED.items():
        due = NUMBER[field] / HALF[field] * float(getattr(found, field).half_width) / um
        assert rows[field] == f"{words} {due:.1f} um"
    assert rows["pin_radius"] == "+-2.00 um" and rows["carrier_bore"] == "2.00 +-2.00 um"
    table = next(part for part in report.parts() if getattr(part, "name", "") == "tolerances" and "csv" in part.on)
    written = {row["error"]: row for row in csv.DictReader(io.StringIO(table.csv().decode()))}
    data = report.json()["tolerances"]
    for field, words in STATED.items():
        half = float(getattr(found, field).half_width)
        row, after = written[field], data[field]["after"]
        number = float(row["drawing after"]) * um
        assert row["stated as"] == words and number == pytest.approx(NUMBER[field] / HALF[field] * half)
        assert (float(row["upper after"]) - float(row["lower after"])) / 2 * um == pytest.approx(half)
        assert (after["upper"] - after["lower"]) / 2 == pytest.approx(half)
        assert after["form"] == words and after["drawing"] == pytest.approx(number)
        assert data[field]["before"]["drawing"] == pytest.approx(NUMBER[field] * um)
    assert written["pin_radius"]["stated as"] == "limits" and written["pin_radius"]["drawing after"] == ""
    assert "drawing" not in data["pin_radius"]["after"]


def test_two_results_are_compared_in_the_words_of_the_drawing(answer, tmp_path):
    paths, results = {}, {}
    for letter, factor in (("A", 1.0), ("B", 0.5)):
        data = json.loads(json.dumps(report_on(answer).json()))
        for end in ("lower", "upper", "drawing"):
            data["tolerances"]["disc_centre"]["after"][end] *= factor
        paths[letter], results[letter] = letter, data
    inputs = SimpleNamespace(paths=paths, results=results, study=None, answers={})
    found = compare.compute(inputs)
    text = compare.report(inputs, found).text()
    runout = 4 * float(answer.allocation.tolerances.disc_centre.half_width) / um
    assert re.search(rf"^disc_centre, runout +{runout:.4g} um +{runout / 2:.4g} um +-50.0 %$", text, re.M)
    assert "disc_centre, half-width" not in text and "disc_centre, middle" not in text
    row = found.topics["tolerances after"]["disc_centre, half-width"]
    assert row["a"] * 4 == pytest.approx(runout * um) and row["b"] == pytest.approx(row["a"] / 2)


@pytest.fixture(scope="module")
def sliders(answer):
    straight = dataclasses.replace(answer, study=Straight(answer))  # words and costs, not the response, are compared
    made = response_surface.surrogate(straight, points=1, fresh=1024, chunk=1024)
    assert made is not None
    return made, page_sliders.data(made, answer)


def test_sliders_have_the_numbers_of_the_drawing(answer, sliders):
    _, data = sliders
    fields = {field["name"]: field for field in data["fields"]}
    for field, words in STATED.items():
        slider = data["parameters"][fields[field]["half"]]
        half = float(getattr(answer.allocation.tolerances, field).half_width) / um
        assert slider["label"].endswith(words) and fields[field]["sign"] == words
        assert slider["centre"] == pytest.approx(NUMBER[field] / HALF[field] * half)
        assert slider["own"] == pytest.approx(NUMBER[field])
        assert fields[field]["place"] is None  # a drawing states no middle
    assert data["parameters"][fields["pin_radius"]["half"]]["label"].endswith("half-width")
    assert fields["pin_radius"]["place"] is not None


def test_the_study_that_a_slider_saves_has_the_words_of_the_drawing(answer, sliders):
    _, data = sliders
    program = """
    const [raw, key, factor] = input, data = Live.opened(raw), at = Live.begin(data, key);
    for (const field of data.fields) at.parameters[field.half] *= factor;
    return { text: Live.study(data, at), cost: Live.cost(data, at) };
    """
    assert in_node(program, data, "own", 1)["text"] == CHEAP  # with all comments
    seen = in_node(program, data, "own", 0.5)
    for line in ('runout = "7.5 um"', 'position = "diametral 10 um"', 'cumulative = "9.5 um"', "batch = 0.4"):
        assert f"\n{line}\n" in seen["text"]
    again = study.parse_study(seen["text"], name="again", solve=False)
    costs = 0.0
    for field in again.fields:
        half = float(getattr(answer.study.tolerances, field).half_width) / 2
        assert float(getattr(again.tolerances, field).half_width) == pytest.approx(half)
        costs += float(answer.study.costs[field](half)) if field in answer.study.costs else 0.0
    assert seen["cost"] == pytest.approx(costs)
    assert again.forms == answer.study.forms
    centre = in_node(program, data, "centre", 1)
    assert centre["cost"] == pytest.approx(answer.allocation.cost, rel=1e-6)


def test_the_radius_of_a_ring_is_written_in_its_table(asked):
    fields = [name for name in asked.fields if name != "carrier_bore"]
    parts = reader.template(PLACED, asked.requirements, fields)
    assert "".join(part if isinstance(part, str) else part["own"] for part in parts) == PLACED
    gaps = {fields[part["field"]]: part["own"] for part in parts if not isinstance(part, str) and "field" in part}
    assert gaps["pin_radii"] == 'radius = "1 um" # of every pin\n'
    assert gaps["pin_offset"] == 'position = "diametral 20 um"\n'


def test_sliders_and_prices_of_a_design_are_those_of_the_drawing(asked):
    """Cost 2 (5 um / half-width): at 2 um a micron of half-width saves 2.5, one of the runout a quarter of that."""
    half = {"disc_centre": 2 * um}
    at = asked.tolerances.replace(disc_centre=asked.tolerances.disc_centre.with_half_width(2 * um))
    joint = SimpleNamespace(
        values={}, half_widths=half, margins={}, cost=5.0, tolerances=at, costs={"disc_centre": 5.0}
    )
    joint.multipliers = joint.value_prices = {}
    found = SimpleNamespace(joint=SimpleNamespace(found=joint))
    (slider,) = design_prices.data(asked, found)["sliders"]
    shown = {key: slider[key] for key in ("label", "centre", "before", "low", "high")}
    assert shown == {"label": "disc centre runout"} | {
        key: pytest.approx(4 * size) for key, size in dict(centre=2.0, before=3.75, low=1.0, high=20.0).items()
    }
    (field,) = design_prices.data(asked, found)["fields"]
    assert field["cost"] == {"fixed": 0.0, "scale": 2.0, "reference": pytest.approx(20.0), "power": 1.0}
    assert "1 um of the runout of disc_centre: 0.625" in design_prices.price_note(asked, found).text
