"""Sliders of the page: the numbers it carries, its arithmetic in JavaScript, a browser.

JavaScript runs where node is installed, the page where a browser is.
"""

import dataclasses
import html
import json
import os
import re
import shutil
import subprocess
import tomllib

import numpy as np
import pytest
from live_study import PLAY, in_node, played

import rvjax
from rvjax import study, tolerances
from rvjax.commands.allocate import full_model_check, report_on
from rvjax.commands.allocate.answer import FILE, stored
from rvjax.commands.report import Shown, page_of, response_surface, sliders
from rvjax.render import Report
from rvjax.study import reader


@pytest.fixture(scope="module")
def answered():
    return played()


def test_the_page_carries_numbers_of_its_own(answered):
    found, made = answered
    numbers = sliders.data(made, found)
    assert len(json.dumps(numbers)) < 1.5e6
    columns = sum(len(response["columns"]) for response in numbers["responses"])
    assert columns * response_surface.UNITS < 1e6  # products for one move of a slider: a millisecond or two
    fields = {field["name"]: field for field in numbers["fields"]}
    assert fields["bearing_clearance"]["nonnegative"] and not fields["pin_radius"]["nonnegative"]
    assert fields["pin_hole_clearance"]["grows"] and fields["pin_hole_clearance"]["stands"] == 0
    assert fields["shift_modification"]["moving"] == {"given": 0.0, "scale": pytest.approx(0.01)}
    for p in numbers["parameters"]:
        assert p["low"] <= min(p["centre"], p["own"]) <= max(p["centre"], p["own"]) <= p["high"]
    (response,) = numbers["responses"]
    assert response["floor"] is None and made.base["lost_motion"].min() < 0
    raised = dataclasses.replace(made, base={"lost_motion": np.abs(made.base["lost_motion"])})
    assert sliders.data(raised, found)["responses"][0]["floor"] is None  # its lower limit is below zero
    above = dataclasses.replace(found.study, requirements={"lost_motion": rvjax.tolerances.Requirement(upper=1.0)})
    (response,) = sliders.data(raised, dataclasses.replace(found, study=above))["responses"]
    assert response["floor"] == 0.0
    name = "shift_modification"
    where = numbers["parameters"][fields[name]["place"]]
    assert (where["low"], where["high"]) == pytest.approx((-6, 6))
    assert f"{100 * made.error('yield'):.2g} %" in numbers["error"]
    hostile = dataclasses.replace(found, study=dataclasses.replace(found.study, name="</script><script>alert(1)"))
    assert sliders.script(made, hostile).count("<") == sliders.script(made, found).count("<")


def test_a_change_that_rounds_to_nothing_has_no_sign():
    told = in_node("return input.map((change) => Live.signed(change, 1));", -0.04, 0.04, -1.26, 1250)
    assert told == ["0.0", "0.0", "-1.3", "+1250.0"]


def test_a_histogram_of_a_heavy_tail_has_the_span_of_its_body():
    """As `plotting.style.readable_bins` cuts the axis: four widths of the middle 90 % where that is a 20th of all."""
    body = np.linspace(100, 200, 999)
    spans = in_node("return input.map((values) => Live.ends(values));", list(body), [*body, 1e9], [-1e9, *body], [3, 3])
    width = 0.9 * 100
    assert spans[0] == [100, 200] and spans[3] == [3, 3]
    assert spans[1] == pytest.approx([100, 195 + 2 * width], abs=0.3)  # by ranks, 0.1 apart
    assert spans[2] == pytest.approx([105 - 2 * width, 200], abs=0.3)
    shares = in_node(
        "return Array.from(Live.counted(...input));", [0, 1, 5, 9.99, 10, 11], [1, 2, 4, 8, 16, 32], [0, 10], 2
    )
    assert shares == [3, 28]  # what lies outside is in no bin


def test_a_number_that_a_slider_does_not_take_is_said():
    told = in_node("return input.map((wanted) => Live.taken(wanted, 1, 20, (x) => `${x} µm`));", 5, 25, 0.5, None)
    assert told == [
        {"value": 5, "said": ""},
        {"value": 20, "said": "25 µm is outside 1 µm to 20 µm: set to 20 µm"},
        {"value": 1, "said": "0.5 µm is outside 1 µm to 20 µm: set to 1 µm"},
        {"value": None, "said": "no number: not changed"},
    ]


AT = {"pin_radius": (5e-6, 1e-6), "shift_modification": (2e-6, 3e-6), "pin_hole_clearance": (2e-6, 1e-6)}
MOVE = """
const [raw, moved, limits] = input, data = Live.opened(raw), at = Live.begin(data, "centre");
for (const [name, [half, place]] of Object.entries(moved)) {
  const field = data.fields.find((f) => f.name === name);
  at.parameters[field.half] = half; at.parameters[field.place] = place;
}
Object.assign(at.limits[0], limits);
const found = Live.all(data, at);
"""


def test_javascript_computes_what_python_does(answered):
    """16-bit columns: each value within 1/65534 of the largest of its column; weights in 32 bits."""
    found, made = answered
    numbers = sliders.data(made, found)
    shown = {name: (1e6 * half, 1e6 * place) for name, (half, place) in AT.items()}
    tell = "return {y: Array.from(found.y[0]), x: found.x, figures: found.figures[0], cost: found.cost, "
    tell += "shares: found.shares[0], joint: found.joint, outside: found.outside.map((p) => p.label)};"
    seen = in_node(MOVE + tell, numbers, shown, {"upper": 0.8})
    x = made.place(found.after.tolerances)
    for k, p in enumerate(made.parameters):
        if p.field in AT:
            x[k] = (AT[p.field][p.place] - p.centre) / p.reach
    np.testing.assert_allclose(seen["x"], x, atol=1e-9)
    name, arcmin = "lost_motion", rvjax.units.arcmin
    rounding = sum(abs(np.prod(x[list(key)])) * np.abs(c).max() / 65534 for key, c in made.columns[name].items())
    rounding += 6e-8 * np.abs(made.base[name]).max()
    y = made.values(name, x)
    np.testing.assert_allclose(np.array(seen["y"]) * arcmin, y, atol=1.01 * rounding)
    limits = dataclasses.replace(found.study.requirements[name], upper=0.8 * arcmin)
    expected = made.figures(name, x, limits)
    near = made.weights[np.abs(limits.margin(y)) <= 2 * rounding].sum()
    assert abs(seen["figures"]["yield"] - expected["yield"]) <= near + 1e-5
    assert seen["joint"] == pytest.approx(seen["figures"]["yield"])
    assert seen["figures"]["mean"] * arcmin == pytest.approx(expected["mean"], abs=2 * rounding)
    assert seen["figures"]["sd"] * arcmin == pytest.approx(expected["sd"], rel=1e-3)
    capability = limits.capability(expected["mean"], expected["sd"])[1]
    assert seen["figures"]["cpk"] == pytest.approx(capability, rel=1e-3)
    costs = {name: float(cost(AT[name][0])) for name, cost in found.study.costs.items()}
    assert seen["cost"] == pytest.approx(sum(costs.values()) + 0.01 * 3, rel=1e-9)
    assert seen["figures"]["met"] == (expected["yield"] >= 0.99)
    shares = {f: s * (AT[f][0] / float(getattr(found.after.tolerances, f).half_width) if f in AT else 1.0) ** 2
              for f, s in found.after.shares[name].items()}  # fmt: skip
    expected_shares = [shares[field["name"]] / sum(shares.values()) for field in numbers["fields"]]
    np.testing.assert_allclose(seen["shares"], expected_shares, rtol=1e-9)
    far = [p for p, step in zip(made.parameters, x) if abs(step) > 1]
    assert len(seen["outside"]) == len(far) > 0


def test_as_allocated_the_page_says_what_the_certificate_says(answered):
    found, made = answered
    seen = in_node(
        "const data = Live.opened(input[0]), all = Live.all(data, Live.begin(data, 'centre'));"
        "return {figures: all.figures[0], cost: all.cost, far: all.outside.length};",
        sliders.data(made, found),
    )
    allocation = found.allocation
    assert seen["figures"]["yield"] == pytest.approx(allocation.certificate.yield_["lost_motion"].value, abs=1e-6)
    assert seen["figures"]["met"] is True
    assert seen["cost"] == pytest.approx(allocation.cost, rel=1e-6)
    assert seen["far"] == 0


def test_the_study_that_the_page_writes_is_the_one_it_shows(answered):
    found, made = answered
    shown = {name: (1e6 * half, 1e6 * place) for name, (half, place) in AT.items()}
    numbers = sliders.data(made, found)
    text = in_node(MOVE + "return Live.study(data, at);", numbers, shown, {"upper": 0.8})
    again = study.parse_study(text, name="again", solve=False)
    for name, (half, place) in AT.items():
        t = getattr(again.tolerances, name)
        assert float(t.half_width) == pytest.approx(half)
        assert response_surface.placed(t) == pytest.approx(place)
    requirement = again.requirements["lost_motion"]
    assert (requirement.lower, requirement.upper) == pytest.approx(
        (-1.5 * rvjax.units.arcmin, 0.8 * rvjax.units.arcmin)
    )
    assert 'lower = "0 um"   # a magnitude\n' in text  # what has not moved keeps its words
    own = in_node("const data = Live.opened(input[0]); return Live.study(data, Live.begin(data, 'own'));", numbers)
    assert own == PLAY


SAID_OTHERWISE = """
design = {base = "rv-20e", cycloid.pin_radius = "2.1 mm"}
tolerances.pin_radius.half_width = "4 um"
tolerances.pin_radius.distribution = "empirical"
tolerances.pin_radius.values = [
  "1 um",
  "-1 um", # measured
]
run = {samples = 1024}
[requirement."a \\u2028 \\u007f name"]
response = "lost_motion"
upper = '1 arcmin'
"""


@pytest.mark.parametrize(
    "text",
    [
        PLAY,
        PLAY.replace("\n", "\r\n"),
        SAID_OTHERWISE,
        PLAY.replace('half_width = "3 um"', '"half_width" = "3 um"'),
        *((study.reader.EMBEDDED / f"{name}.toml").read_text("utf-8") for name in study.embedded_names()),
    ],
)
def test_any_way_to_say_a_study_can_be_written_again(text):
    question = study.parse_study(text, name="x", solve=False)
    parts = reader.template(text, question.requirements, question.fields)
    own = "".join(part if isinstance(part, str) else part["own"] for part in parts)
    assert tomllib.loads(own) == tomllib.loads(text) == tomllib.loads(reader.canonical(tomllib.loads(text)))
    gaps = [part for part in parts if not isinstance(part, str)]
    assert len(gaps) == len(question.fields) + len(question.requirements)
    if text is not SAID_OTHERWISE and '"half_width"' not in text:
        assert own.splitlines() == text.splitlines()  # comments and all


def browser():
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on PATH: the page is not looked at")
    return found


LOOK = """
const told = {}, section = document.querySelector("#live");
const figure = () => section.querySelector("[data-label=value]").textContent;
const range = section.querySelector("[aria-label^=pin], #live-0");
const settled = async () => {
  const was = section.dataset.computed;
  for (let k = 0; k < 40 && section.dataset.computed === was; k++) await new Promise((done) => setTimeout(done, 50));
};
addEventListener("load", async () => {
  const ranges = [...section.querySelectorAll("input[type=range]")];
  told.hidden = section.hidden;
  told.labels = ranges.every((r) => section.querySelector(`label[for=${r.id}]`).textContent.length > 4);
  told.spoken = ranges.every((r) => /\\d (µm|arcmin)$/.test(r.getAttribute("aria-valuetext")));
  told.before = figure();
  const coarse = section.querySelector("[data-live=half-widths] input[type=range]");
  coarse.focus();
  told.focus = document.activeElement === coarse;
  for (const each of section.querySelectorAll("[data-live=half-widths] input[type=number]")) {
    each.value = 3 * each.valueAsNumber;
    each.dispatchEvent(new Event("change"));
  }
  await settled();
  told.after = figure();
  told.region = section.querySelector("[data-live=region]").textContent;
  told.computed = Number(section.dataset.computed);
  told.study = section.querySelector("textarea").value;
  told.bars = section.querySelectorAll("svg .bars[d^=M]").length;
  const first = section.querySelector("[data-live=half-widths] .live-row");
  const exact = first.querySelector("[type=number]");
  exact.value = 1e6;
  exact.dispatchEvent(new Event("change"));
  await settled();
  told.refused = first.querySelector(".far").textContent;
  told.clamped = exact.valueAsNumber === Number(first.querySelector("[type=range]").max);
  section.querySelector("[data-begin=centre]").click();
  await settled();
  told.back = figure();
  told.forgotten = first.querySelector(".far").textContent;
  told.wide = document.documentElement.scrollWidth - innerWidth;
  told.outside = performance.getEntriesByType("resource").map((r) => r.name).filter((n) => !n.startsWith("data:"));
  await new Promise((done) => setTimeout(done, 700));
  told.status = section.querySelector("[role=status]").textContent;
  document.title = JSON.stringify(told);
});
addEventListener("error", (event) => { document.title = JSON.stringify({ error: event.message }); });
"""


def test_the_sliders_in_a_browser(answered, tmp_path):
    """At 390 pixels, in a frame, for no window of the browser is that narrow."""
    program, (found, made) = browser(), answered
    text = page_of(Shown(found, made), "play.toml")
    assert "<script>" in text and 'id="live-data"' in text
    (tmp_path / "page.html").write_text(text.replace("</body>", f"<script>{LOOK}</script></body>"), "utf-8")
    frame = '<iframe src="page.html" width="390" height="800"></iframe><script>setInterval(() => '
    frame += "{ document.title = frames[0].document.title; }, 50)</script>"
    (tmp_path / "frame.html").write_text(frame, "utf-8")
    quiet = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    quiet += "--disable-component-update --disable-sync --allow-file-access-from-files --virtual-time-budget=8000 "
    quiet += "--window-size=700,900 --dump-dom"
    command = [program, *quiet.split(), f"--user-data-dir={tmp_path}/profile", (tmp_path / "frame.html").as_uri()]
    environment = os.environ | {"HOME": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=True)
    seen = json.loads(html.unescape(re.search(r"<title>(.*?)</title>", done.stdout).group(1)))
    assert "error" not in seen, seen
    assert seen["hidden"] is False and seen["labels"] and seen["spoken"] and seen["focus"]
    certified = found.allocation.certificate.yield_["lost_motion"].value
    assert seen["before"] == seen["back"] == f"{100 * certified:.3f} %"
    assert float(seen["after"].split()[0]) < 100 * certified - 1
    assert seen["region"].startswith("Outside the region")
    assert "shift modification half-width" in seen["region"] and "disc runout half-width" in seen["region"]
    assert "bearing clearance: below zero" in seen["region"]
    assert seen["refused"].startswith("1000000 µm is outside ") and "set to" in seen["refused"]
    assert seen["clamped"] and seen["forgotten"] == ""
    assert seen["computed"] > 0 and seen["bars"] == 1
    assert tomllib.loads(seen["study"])["tolerances"]["pin_radius"] != tomllib.loads(PLAY)["tolerances"]["pin_radius"]
    assert seen["wide"] <= 0 and seen["outside"] == []
    assert seen["status"].startswith("Cost ") and "lost motion: 9" in seen["status"]


def test_without_scripts_nothing_of_it_is_seen(answered, undrawn):
    found, made = answered
    without = page_of(Shown(found), "play.toml")
    assert "<script" not in without and "What if" not in without
    with_sliders = Report("x", (sliders.block(made, found),)).html()
    assert re.search(r'<section id="live"[^>]* hidden>', with_sliders)


def test_the_line_on_the_whole_reducer_is_stored_with_its_result(answered, undrawn, tmp_path):
    answer, _ = answered
    share = tolerances.Estimate(0.91, 0.015, 0.88, 0.94)
    line = full_model_check.Whole(
        share, 512, {"lost_motion": 0.91}, {"lost_motion": 1e-4}, {"lost_motion": "bench_lost_motion"}, 2, ()
    )
    beyond = full_model_check.Unlimited(1455e6, share, -np.inf, 2800e6, share, "static safety 2", 512, 0)
    told = dataclasses.replace(answer, whole=line, unlimited={"turn_pin_pressure": beyond})
    (tmp_path / FILE).write_bytes(stored(told))
    loaded = tolerances.load(tmp_path / FILE)
    assert full_model_check.Whole(**loaded["whole"]) == line
    assert full_model_check.Unlimited(**loaded["unlimited"]["turn_pin_pressure"]) == beyond
    report = report_on(told)
    assert "9 % of the units miss a usual limit, <= 2800 MPa (static safety 2)" in report.text()
    page = page_of(Shown(told), "play.toml")
    assert "9 % of the units miss a usual limit" in page and "1455 MPa" in page
    assert report.data["unlimited"] == told.unlimited and "unlimited" not in report_on(answer).data
    assert "whole reducer 91.000 % [88.000, 94.000]" in report.text() and report.data["whole"] == line
    assert "2 failed" in report.text() and "On the whole" not in report_on(answer).text()
