"""`rvjax design` and its tables: numbers of the design and tolerances in one study, from the file to the page."""

import json
import re
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cli_study import one_start
from codesign_cases import CASES, reference_study

from rvjax import cli, study
from rvjax.commands.allocate import answer
from rvjax.commands.design.optimum import geometry_first
from rvjax.tolerances import Memo, Nominal, Variable, allocate
from rvjax.units import mm, um

SMALL = """
[design]
base = "rv-40e-whole"
[variable."cycloid.eccentricity"]
lower = "1.1 mm"
upper = "1.5 mm"
[variable."cycloid.pin_circle_radius"]
lower = "62 mm"
upper = "68 mm"
[variable."cycloid.equidistant_modification"]
lower = "-1 um"
upper = "1 um"
[objective]
mass = {price = 2.0, per = "1 kg"}
[tolerances.pin_circle_radius]
half_width = "5 um"
[tolerances.pin_radius]
half_width = "2 um"
[cost.pin_circle_radius]
scale = 2
reference = "5 um"
finest = "1 um"
coarsest = "40 um"
[cost.pin_radius]
scale = 1
reference = "2 um"
finest = "0.5 um"
coarsest = "20 um"
[requirement.lost_motion]
upper = "0.6 arcmin"
target = 0.99
[requirement.convex_radius]
nominal_lower = "1 mm"
[requirement.crank_room]
nominal_lower = "23.5 mm"
[run]
samples = 2048
certificate_samples = 20480
"""  # of which 205 may fail, so that counts certify and no rare units are sought
# Both limits bind, and slopes do not lead the search to its optimum.
TWO_LIMITS = SMALL.replace("-1 um", "-20 um").replace('"1 um"\n[objective', '"20 um"\n[objective')
TWO_LIMITS = TWO_LIMITS.replace("[requirement.lost_motion]", '[requirement.lost_motion]\nlower = "-0.6 arcmin"')


def parsed(text=SMALL):
    return study.parse_study(text, name="x", solve=False)


def replaced(old, new):
    assert old in SMALL
    return SMALL.replace(old, new, 1)


def test_the_tables_are_read():
    made = parsed()
    item = made.variables["cycloid.eccentricity"]
    assert (item.lower, item.upper, item.first) == pytest.approx((1.1 * mm, 1.5 * mm, 1.3 * mm))
    assert made.objective["mass"](3.0) == 6.0 and set(made.nominal) == {"convex_radius", "crank_room"}
    assert set(made.requirements) == {"lost_motion"} and made.without_errors == ("convex_radius", "crank_room", "mass")
    more = 'among = ["1.2 mm", "1.3 mm"]\nstart = "1.2 mm"\ncost = {price = 3.0, per = "0.1 mm"}\n'
    after = '[variable."cycloid.pin_circle'
    listed = parsed(replaced(after, more + after)).variables["cycloid.eccentricity"]
    assert listed.among == pytest.approx((1.2 * mm, 1.3 * mm)) and listed.first == pytest.approx(1.2 * mm)
    assert listed.own_cost(1.2 * mm) == pytest.approx(36.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("cycloid.eccentricity", "cycloid.excentricity", "unknown number of the design.*did you mean"),
        ('lower = "1.1 mm"', 'lower = "1.6 mm"', "lower = '1.6 mm': must not exceed upper = '1.5 mm'"),
        ('lower = "1.1 mm"', 'start = "1.6 mm"\nlower = "1.1 mm"', "start = '1.6 mm': must lie between"),
        ('lower = "1.1 mm"', 'lower = "1.4 mm"', "start = 0.0013 m, that of .design., must lie|start = .*must lie"),
        ('lower = "1.1 mm"', 'lower = "-inf mm"', "must be finite"),
        ('lower = "1.1 mm"', 'among = []\nlower = "1.1 mm"', "must be a list of one or more values in m"),
        ('lower = "1.1 mm"', 'among = ["2 mm"]\nlower = "1.1 mm"', "among = '2 mm': must lie between"),
        ('lower = "1.1 mm"', "", "lower is missing"),
        ('lower = "1.1 mm"', 'lower = "1.1 mm"\nmost = 1', "unknown key variable"),
        ("cycloid.eccentricity", "cycloid.pin_count", "is an integer, 40"),
        ("cycloid.eccentricity", "cranks.circle_radius", "follows from involute.module"),
        ('whole"', 'whole"\ncycloid.shortening = 0.8', "shortening is given, but follows it"),
        ("mass =", "weight =", "objective.weight: output"),
        ("price = 2.0, per", "price = 2.0, pre", "unknown key objective.mass.pre"),
        ('per = "1 kg"', 'per = "0 kg"', "per = '0 kg': must be positive"),
        ('nominal_lower = "1 mm"', "", "requirement.convex_radius: give upper or lower"),
        (
            'nominal_lower = "1 mm"', 'nominal_lower = "2 mm"\nnominal_upper = "1 mm"',
            "requirement.convex_radius.nominal_lower = '2 mm': must not lie above nominal_upper = '1 mm'",
        ),
        (
            'nominal_lower = "1 mm"', 'nominal_lower = "1 mm"\ntarget = 0.99',
            "requirement.convex_radius.target = 0.99: must not be given with nominal_lower; remove it",
        ),
        ("[run]", '[middle.equidistant_modification]\nlower = "0 um"\nupper = "1 um"\n'
         '[tolerances.equidistant_modification]\nhalf_width = "1 um"\n[run]', "moves the same number; give only one"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(old, new, words):
    with pytest.raises(study.StudyError, match=words) as caught:
        parsed(replaced(old, new))
    assert "\n" not in str(caught.value)


def test_geometry_first_is_that_of_the_reference():
    due = CASES["rv-0"]["expected"]["two_step"]
    found = geometry_first(reference_study(1000))
    assert set(found) == set(due["fixed"])  # the modification does not change size or room
    for name, value in found.items():
        assert value == pytest.approx(due["values"][name], rel=1e-4), name


@pytest.mark.parametrize(("limits", "price", "due"), [({"upper": 2.0}, -1.0, 2.0), ({"lower": 3.0}, 1.0, 3.0)])
def test_geometry_first_ends_at_the_limit_that_its_price_leads_to(limits, price, due):
    """One output that is the number itself, between 0 and 4."""
    study = SimpleNamespace(
        variables={"x": Variable(0.0, 4.0, 1.0)},
        without_errors=("size",),
        nominal_response=lambda: lambda _, values: SimpleNamespace(value={"size": values["x"]}),
        design=SimpleNamespace(error_record=lambda: None),
        objective={"size": lambda value: price * value},
        nominal={"size": Nominal(**limits)},
    )
    assert geometry_first(study) == pytest.approx({"x": due}, rel=1e-6)


@pytest.mark.long  # the command below solves a smaller problem; tests/test_codesign.py has exact optima
def test_the_mechanical_problem_of_the_reference():
    """Four-bar and lost motion with what follows the variables: cost within 1 %, numbers within their ranges.

    A certificate of 200,000 units keeps 2.7 errors of 1.2e-4 beside a density of 0.0089, over 3: 1.2 % of half-widths,
    which are half of the cost.
    """
    made, due = reference_study(200_000), CASES["rv-0"]["expected"]
    found = allocate(
        made.design_response(),
        made.tolerances,
        made.requirements | made.nominal,
        costs=made.costs,
        variables=made.variables,
        objective={name: price(1.0) for name, price in made.objective.items()},
        samples=made.samples,
        certificate_samples=made.certificate_samples,
    )
    assert found.status == "OPTIMAL"
    assert found.cost == pytest.approx(due["cost"], rel=0.01)
    for name, (low, high) in due["ranges"].items():
        assert low - 1e-9 <= found.values[name] <= high + 1e-9, name
    assert found.bounds_active == due["bounds_active"]


def once(patch, module, name):
    """Let a function of a module return to all callers what it returned to the first."""
    found, real = [], getattr(module, name)
    patch.setattr(module, name, lambda *given: found[0] if found else found.append(real(*given)) or found[0])


@pytest.fixture(scope="module", params=["one limit", pytest.param("two limits", marks=pytest.mark.long)])
def designed(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("design")
    (folder / "small.toml").write_text(SMALL if request.param == "one limit" else TWO_LIMITS)
    command = ["design", str(folder / "small.toml"), "--front", "1", "--results", str(folder / "out"), "--quiet"]
    with one_start(), pytest.MonkeyPatch.context() as patch:
        once(patch, sys.modules["rvjax.tolerances.allocation.allocate"], "ranges")  # a fifth of the time
        code = cli.main(command)
    return code, folder / "out", json.loads((folder / "out" / "result.json").read_text())


def test_the_command_answers(designed):
    code, out, result = designed
    assert code == 0 and result["status"] == "OPTIMAL" and result["certificate"]["samples"] == 20_480
    for name in ("report.html", "summary.txt", "variables.csv", "tolerances.csv", "requirements.csv", "nominal.csv",
                 "optima.csv", "scaling.csv", "sizes.csv", "section.png", "front.png", "study.toml"):  # fmt: skip
        assert (out / name).stat().st_size > 0, name
    assert "Sizes for the drawing" in (out / "report.html").read_text("utf-8")
    (row,) = (row for row in result["sizes"] if row["error"] == "pin_circle_radius")  # of the design that was found
    limits = result["tolerances"]["pin_circle_radius"]["after"]
    due = 2 * result["values"]["cycloid.pin_circle_radius"] + limits["lower"] + limits["upper"]
    assert row["nominal"] == pytest.approx(due, abs=0.51e-6) != pytest.approx(0.128, abs=1e-6)
    assert row["upper"] - row["lower"] == pytest.approx(2 * (limits["upper"] - limits["lower"]))


def test_two_steps_never_beat_the_joint_optimum(designed):
    _, _, result = designed
    joint, steps = result["joint"], result["two_step"]
    assert joint["cost"] <= steps["cost"] * 1.01
    assert joint["cost"] == pytest.approx(joint["tolerance_cost"] + joint["priced_outputs"])
    assert joint["priced_outputs"] == pytest.approx(2 * joint["outputs_without_errors"]["mass"])
    assert set(result["fixed_in_the_first_step"]) == {"cycloid.eccentricity", "cycloid.pin_circle_radius"}


def test_the_study_of_the_documentation_is_the_embedded_one():
    page = (Path(__file__).parents[2] / "docs" / "design.md").read_text("utf-8")
    shown = next(block for block in re.findall(r"```toml\n(.*?)```", page, re.S) if "flank_clearance" in block)
    assert tomllib.loads(shown) == tomllib.loads(study.load("rv-40e-modified", solve=False).text)


def test_without_scaling_laws_the_mass_does_not_follow(designed):
    _, _, result = designed
    assert result["without_scaling_laws"]["outputs_without_errors"]["mass"] == pytest.approx(6.94)
    ratio = result["values"]["cycloid.pin_circle_radius"] / (64 * mm)
    due = 6.94 + (ratio**2 - 1) * (2 * 0.75 + 4.5)  # discs and output follow the pin circle
    assert result["joint"]["outputs_without_errors"]["mass"] == pytest.approx(due, rel=1e-9)
    assert "mass of discs and output" in {law["name"] for law in result["scaling_laws"]}


def test_dearer_mass_makes_a_lighter_reducer(designed):
    _, _, result = designed
    (dear,), joint = result["front"], result["joint"]
    assert dear["price_factor"] > 1
    assert dear["priced_outputs"] <= joint["priced_outputs"] * (1 + 1e-6)
    assert joint["tolerance_cost"] <= dear["tolerance_cost"] * 1.01


def test_prices_are_in_one_currency(designed):
    """A micron of a half-width is worth the slope of its cost: 2 (5 um / t) / t."""
    _, out, result = designed
    half = result["joint"]["half_widths"]["pin_circle_radius"]
    price = 2 * 5 * um / half**2
    assert result["tolerances"]["pin_circle_radius"]["price"] == pytest.approx(price, rel=1e-6)
    text = (out / "summary.txt").read_text()
    assert f"1 um of the half-width of pin_circle_radius: {price * um:.3g}" in text and "1 kg of mass: 2" in text
    assert "arcmin of the limit of lost_motion" in text and "together saves" in text


def test_values_keep_bounds_and_limits(designed):
    _, _, result = designed
    made = parsed()
    for path, item in made.variables.items():
        assert item.lower - 1e-12 <= result["values"][path] <= item.upper + 1e-12
    found = result["joint"]["outputs_without_errors"]
    assert found["convex_radius"] >= 1 * mm * (1 - 1e-3) and found["crank_room"] >= 23.5 * mm * (1 - 1e-3)
    assert np.isfinite(result["cost"]["after"]) and result["cost"]["after"] < result["cost"]["before"]


@pytest.mark.long  # test_tolerances_memo.py interrupts an allocation
def test_a_killed_command_continues_from_its_journal(designed, tmp_path, monkeypatch):
    """Killed at its tenth gradient, it computes none of the nine again, and ends as a run that was never killed."""
    study_file, out, journal = designed[1].with_name("small.toml"), tmp_path / "out", tmp_path / "out.part"
    call = ["design", str(study_file), "--alone", "--results", str(out), "--quiet"]
    monkeypatch.setattr(answer, "memo", lambda study, place: Memo(place.with_name("out.part"), {}, worth=0.0))
    parts, asked = sys.modules["rvjax.response.parts"], []
    plain = parts.gradients

    def killed(response, population, errors, cotangents):
        asked.append((errors.tobytes(), cotangents.tobytes(), repr(population.values)))
        if len(asked) == 10:
            raise KeyboardInterrupt
        return plain(response, population, errors, cotangents)

    monkeypatch.setattr(parts, "gradients", killed)
    with one_start():
        assert cli.main(call) == 130 and not out.exists() and len(list(journal.iterdir())) > 9
        assert cli.main(call) == 0 and not journal.exists()
    assert not set(asked[:9]) & set(asked[10:]) and asked[9] == asked[10]
    result = json.loads((out / "result.json").read_text())
    assert result["values"] == designed[2]["values"] and result["cost"] == designed[2]["cost"]


def test_what_the_command_refuses(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["design", "rv-40e"]) == 2 and "[variable] is missing" in capsys.readouterr().err
    assert cli.main(["design", "rv-40e-design", "--front", "99"]) == 2
    assert "--front 99: must lie between 0 and 16" in capsys.readouterr().err
    unread = '[variable."cycloid.force_angle"]\nlower = "20 deg"\nupper = "40 deg"\n'
    (tmp_path / "unread.toml").write_text(SMALL + unread)
    assert cli.main(["design", "unread.toml"]) == 2
    assert 'variable."cycloid.force_angle": no required output depends on it (' in capsys.readouterr().err


def test_init_writes_a_study_with_variables(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", "mine.toml", "--design"]) == 0
    made = study.load("mine.toml", solve=False)
    assert set(made.variables) == set(study.load("rv-40e-design", solve=False).variables)
    assert made.about.revision == "A" and "rvjax design" in (tmp_path / "mine.toml").read_text()
    assert cli.main(["init", "other.toml", "--design", "--base", "rv-80e", "--model", "four-bar"]) == 2
    assert "--model four-bar: needs --base rv-40e" in capsys.readouterr().err
