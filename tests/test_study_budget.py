"""Error budgets: the share of each error.

Oracle: the transmission error of the linkage is linear in small errors, so that total effects are sums of squared
derivatives times the differences of the very errors that were drawn.
"""

import csv
import dataclasses
import io
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from crank_turn import crank_turn

from rvjax import RVErrors, cli, four_bar, plotting, study
from rvjax.base import progress
from rvjax.commands.budget import budgets, effects, error_budget, report_on, report_on_scalar, section_on
from rvjax.errors import STAGES
from rvjax.population import Population, Tolerance, drawn, root_key
from rvjax.render import Note, Table, write_files
from rvjax.response import Part
from rvjax.study import parse_study
from rvjax.tolerances import Estimate, Influence
from rvjax.units import arcsec

TEXT = """
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 16
[tolerances.crank_eccentricity]
half_width = "0.06 um"
[tolerances.disc_bore]
position = "diametral 0.1 um"
[tolerances.carrier_bore]
half_width = "0.03 um"
[tolerances.pin_radius]
half_width = "2 um"
[requirement.misfit]
upper = "30 um"
[requirement.lost_motion]
upper = "1 arcmin"
"""
UNITS = 32


@pytest.fixture(scope="module")
def question():
    return parse_study(TEXT, name="x", solve=False)


@pytest.fixture(scope="module")
def found(question):
    return error_budget(question, samples=UNITS, seed=7)


def test_shares_are_those_of_the_linear_response(question, found):
    """Errors of 0.1 um leave 1e-4 of curvature in a linkage of 1.3 mm; a square doubles it, a margin of ten: 2e-3."""
    design = question.design

    def waves(errors, torque):
        ways = dict(angles=16, closure="first_order")  # the tangent of the exact one
        error = four_bar.revolution(design, errors, output_torque=torque, **ways).error
        wave = jnp.fft.rfft(error)[:8] / 16
        return jnp.stack([wave.real, wave.imag]).at[:, 1:].multiply(2.0)

    at = RVErrors.for_design(design, crank_eccentricity=0.0, disc_bore=0.0, carrier_bore=0.0)
    slopes = jax.jit(jax.jacfwd(waves))(at, 412.0)
    population = Population.of(question.tolerances)
    one, other = (population.deviations(drawn(population, root_key(7), k, count=UNITS)) for k in (0, UNITS))
    np.testing.assert_allclose(found.orders, 40 * np.arange(8))
    assert found.torque == pytest.approx({"loaded": 412.0, "unloaded": 0.412})
    assert found.failed == {"loaded": 0, "unloaded": 0}
    assert all(0 < share < 2e-3 for share, _ in found.together.values())  # nearly linear
    half = np.where(np.arange(8) > 0, 0.5, 1.0)
    for name in ("crank_eccentricity", "disc_bore", "carrier_bore"):
        moved = np.tensordot(getattr(slopes, name), np.asarray(other[name] - one[name]), np.ndim(one[name]) - 1)
        due = half * 0.5 * np.mean(np.sum(moved**2, axis=0), axis=-1)
        for load in found.torque:  # without clearance the play of the bearings decides nothing
            np.testing.assert_allclose(found.variance[load][name], due, rtol=2e-3, atol=2e-3 * due.max())
        whole = half[1:, None] * 0.5 * np.sum(moved**2, axis=0)[1:]
        assert found.error["loaded"][name] == pytest.approx(whole.sum(0).std() / np.sqrt(UNITS), rel=5e-3)
    assert not found.variance["loaded"]["pin_radius"].any()  # of the flank, which the linkage does not know


def test_interactions_of_errors_are_bounded():
    """Oracle: f = a x + b y + c x y + d x y z of normal numbers has the variance a^2 + b^2 + c^2 + d^2, of which c^2 +
    d^2 is together; the bound counts a term of three twice. Five standard errors."""
    a, b, units = 2.0, 1.0, Population.of(dict.fromkeys("xyz", Tolerance.symmetric(1.0)))

    def share(c, d, count=20_000):
        def solve(z):
            x, y, z = np.asarray(z)
            wave = a * x + b * y + c * x * y + d * x * y * z
            return np.stack([np.full_like(x, 7.0), 1j * wave], axis=1)

        draw = lambda first, *, count: draws[:, first : first + count]  # noqa: E731
        load = effects.of_load(solve, draw, units, count, block=20_000)
        assert load["total"][1] == pytest.approx(0.5 * (a**2 + b**2 + c**2 + d**2), rel=5 * np.sqrt(20 / count))
        assert load["failed"] == 0 and load["alike"][0] == pytest.approx(49.0)
        return load["together"]

    draws = jnp.asarray(np.random.default_rng(3).standard_normal((3, 41_000)))
    assert share(0.0, 0.0)[0] < 1e-28
    for c, d, due in ((0.5, 0.0, 0.25 / 5.25), (0.0, 0.5, 2 * 0.25 / 5.25)):
        found, error = share(c, d)
        assert 0 < error < 0.1 * due and abs(found - due) < 5 * error


def test_blocks_of_units_change_nothing():
    def solve(z):
        return np.stack([np.asarray(z).sum(0), np.asarray(z).prod(0) + 1j], axis=1)

    draws = jnp.asarray(np.random.default_rng(0).standard_normal((2, 100)))
    units = Population.of(dict.fromkeys("xy", Tolerance.symmetric(1.0)))
    found = []
    for block in (40, 16):
        found.append(effects._solved(solve, lambda first, *, count: draws[:, first : first + count], units, 40, block))
    jax.tree.map(np.testing.assert_array_equal, *found)
    assert found[0][0].shape == (40, 2)


def test_a_batch_in_which_nothing_can_be_solved_has_no_budget(question):
    with pytest.raises(ValueError, match="study x, strange, nan N m: none of 32 units can be solved"):
        error_budget(question, samples=UNITS, seed=7, loads={"strange": float("nan")})


def test_the_budget_of_a_regression_is_that_of_its_linear_part():
    """Waves 3 x1 + 4i x2 + noise, and 40 elements that move nothing: variances 4.5 and 8, halved as of waves, and 0."""
    rng, units = np.random.default_rng(4), 2000
    errors = rng.standard_normal((42, units)) * np.array([1.0, 1.0, *[1e-6] * 40])[:, None]
    noise = (rng.standard_normal(units) + 1j * rng.standard_normal(units)) / np.sqrt(2)
    waves = np.stack([np.full(units, 7.0), 3 * errors[0] + 4j * errors[1] + 2 * noise], axis=1)
    found = budgets.fitted(errors, waves, {"x": 1, "y": 1, "idle": 40})
    spread = 5 * np.sqrt(2 / units)  # five standard errors of a variance
    assert found["variance"]["x"][1] == pytest.approx(4.5, rel=spread)
    assert found["variance"]["y"][1] == pytest.approx(8.0, rel=spread)
    assert found["variance"]["idle"][1] < 0.3 * 40 * 2 / units  # its coefficients alone would give 40 times 2/units
    assert found["total"][1] == pytest.approx(14.5, rel=spread) and found["alike"][0] == pytest.approx(49)
    share, error = found["together"]
    assert abs(share - 2 / 14.5) < 5 * error and 0 < error < 0.02
    for name, true in (("x", 4.5), ("y", 8.0)):
        assert abs(found["variance"][name][1] - true) < 4 * found["error"][name] < true


def test_waves_of_curves_are_their_amplitudes():
    angle = np.arange(16) / 16 * 2 * np.pi
    curves = np.stack([2 + 3 * np.cos(2 * angle - 0.4), np.where(angle > 1, np.nan, angle)])
    waves = budgets.waves_of(curves)
    np.testing.assert_allclose(waves[0], [2, 0, 3 * np.exp(-0.4j), *[0] * 5], atol=1e-12)
    assert np.isnan(waves[1]).all()


def test_fields_add_up_to_parts_and_stages(found):
    assert found.part == {
        "crank_eccentricity": "cranks", "disc_bore": "discs", "carrier_bore": "carrier", "pin_radius": "ring"
    }  # fmt: skip
    field, part, stage = (found.by(level, "loaded") for level in ("field", "part", "stage"))
    np.testing.assert_array_equal(stage["cranks"], field["crank_eccentricity"] + field["carrier_bore"])
    np.testing.assert_array_equal(part["discs"], stage["cycloid"] - part["ring"])
    assert list(part) == sorted(part, key=lambda name: -part[name][1:].sum())
    for level in ("field", "part", "stage"):
        assert sum(found.shares(level, "unloaded").values()) == pytest.approx(1)
    with pytest.raises(ValueError, match="level = 'pin': must be one of"):
        found.by("pin", "loaded")


def test_every_error_has_a_part_and_every_part_a_stage():
    metadata = {f.name: f.metadata for f in dataclasses.fields(RVErrors)}
    assert {about["part"] for about in metadata.values()} <= set(STAGES)
    assert metadata["pin_offset"]["part"] == "ring" and metadata["planet_runout"]["part"] == "planets"


def test_text_csv_and_picture(question, found, tmp_path):
    folder = write_files(report_on(found, question).folder(), tmp_path / "results")
    text = (folder / "summary.txt").read_text()
    share = found.shares("field", "loaded")["crank_eccentricity"]
    rms = np.sqrt(found.variance["loaded"]["crank_eccentricity"][1:].sum()) / arcsec
    (line,) = [line.split() for line in text.splitlines() if line.startswith("crank_eccentricity")]
    assert line[1:4] == ["cranks", f"{rms:.3g}", f"{100 * share:.1f}"]
    rows = list(csv.DictReader(io.StringIO((folder / "budget.csv").read_text())))
    assert len(rows) == 2 * 8 * (4 + 2)
    shares = {row["owner"]: row for row in csv.DictReader(io.StringIO((folder / "shares.csv").read_text()))}
    assert float(shares["crank_eccentricity"]["loaded share %"]) == pytest.approx(100 * share, rel=1e-9)
    (row,) = [r for r in rows if (r["load"], r["order"], r["error"]) == ("unloaded", "40", "disc_bore")]
    assert float(row["mean square (rad)^2"]) == found.variance["unloaded"]["disc_bore"][1] and row["part"] == "discs"
    figure = plotting.error_budget(found)
    bars = figure.axes[1].patches
    tops = sum(bar.get_height() for bar in bars)
    shown = np.sort(found.total["loaded"][1:])[-8:], np.sort(found.total["unloaded"][1:])[-8:]
    assert tops == pytest.approx(sum(np.sqrt(x).sum() for x in shown) / arcsec)
    assert (folder / "budget.png").stat().st_size > 10_000


def test_the_command_writes_a_folder(found, tmp_path, monkeypatch, capsys):
    """Of the study's own torque, named by hand."""
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(TEXT)
    seen = []
    monkeypatch.setattr(progress.Phases, "detail", lambda self, note, part=0.0: seen.append((self.name, note)))
    asked = ["budget", "x.toml", "--samples", str(UNITS), "--seed", "7"]
    assert cli.main([*asked, "--torque", "412 N m", "--torque", "0.412 N m", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    counted = [note for name, note in seen if name == "error budget" and note.startswith("solving, ")]
    assert counted[5] == "solving, 6 of 12 blocks" and counted[-1] == "solving, 12 of 12 blocks"
    folder = tmp_path / told.pop("results")
    assert folder.name == "x-budget" and json.loads((folder / "result.json").read_text()) == told
    assert {file.name for file in folder.iterdir()} == {
        "study.toml", "summary.txt", "result.json", "shares.csv", "budget.csv", "budget.png"
    }  # fmt: skip
    assert told["torque"] == {"412 N m": 412.0, "0.412 N m": 0.412} and told["unit"] == "rad"
    due = found.shares("part", "loaded")
    assert told["shares"]["part"]["412 N m"] == {name: pytest.approx(share) for name, share in due.items()}
    assert cli.main([*asked, "--torque", "412 N m", "--torque", "0.412 kN m"]) == 2
    assert "--torque 412 N m, 0.412 kN m" in capsys.readouterr().err
    assert cli.main([*asked, "--torque", "412"]) == 2
    assert "--torque = '412': unit '' is not one of" in capsys.readouterr().err


def test_the_report_lists_the_contributors_to_the_error(found):
    section = section_on(found)
    (table,) = (part for part in section.content if isinstance(part, Table))
    headers, rows = table.texts("page")
    assert headers[3:] == ["unloaded rms arcsec", "unloaded share %"]
    share = found.shares("part", "unloaded")["cranks"]
    assert {row[0]: row[4] for row in rows}["cranks"] == f"{100 * share:.1f}"
    said = " ".join(part.text for part in section.content if isinstance(part, Note))
    assert "412 N m" in said and "at most" in said and section.title == "Error budget"


def test_which_studies_have_a_budget(question, monkeypatch):
    monkeypatch.setattr(budgets, "error_budget", lambda one, *, tolerances: one.name)
    monkeypatch.setattr(budgets, "linear_budget", lambda one, tolerances: None)
    asked = [study.load(name, solve=False) for name in ("rv-40e", "rv-40e-whole", "corr")]
    still = parse_study(TEXT.replace('"412 N m"', '"0 N m"'), name="still", solve=False)
    found = [budgets.budget_if_any(one) for one in (*asked, question, still)]
    assert found == ["rv-40e", "rv-40e-whole", None, "x", None]


@pytest.mark.parametrize(("angles", "span", "title"), [
    (24, "crank_turn", "9 deg of the output"), (961, "output_turn", "a turn of the output")
])  # fmt: skip
def test_the_page_of_a_loaded_study_has_the_budget_of_the_units_of_its_curve(angles, span, title, monkeypatch):
    """Of units that are made up: 768, or three for each of their numbers, and no unit under another load."""
    monkeypatch.setattr(Part, "curves", lambda part, population, z: np.outer(z[0], np.sin(np.arange(angles))))
    whole = crank_turn("rv-40e-whole", 24)
    asked = dataclasses.replace(whole, conditions=dataclasses.replace(whole.conditions, span=span, samples=angles))
    made = budgets.budget_if_any(asked)
    assert made.linear and made.samples >= 768 and list(made.torque.values()) == [412.0]
    assert made.title == f"Transmission error of the loaded reducer over {title}"
    assert budgets.curve_of(asked, None) == asked.curve


def test_only_values_of_a_curve_have_its_budget():
    """Others have a budget of their own: in the study of the loaded reducer all read the equilibrium of the curve."""
    loaded, four_bar = (study.load(name, solve=False) for name in ("rv-40e-whole", "rv-40e"))
    of_curve = [name for name in loaded.requirements if budgets.curve_of(loaded, name) is not None]
    assert of_curve == ["loaded_transmission_error"] and budgets.curve_of(loaded, None) is not None
    assert [name for name in four_bar.requirements if budgets.curve_of(four_bar, name)] == ["transmission_error"]


@pytest.mark.parametrize(
    ("old", "new", "options", "words"),
    [
        ('"412 N m"', '"0 N m"', {}, "conditions.output_torque = 0 N m"),
        ("angles", "angles", dict(samples=3), "samples = 3: must be at least 16"),
        ("angles", "angles", dict(output="noise"), "output = 'noise': must be one of misfit, lost_motion"),
        ("angles", "angles", dict(output="lost_motion"), "no response required here has a curve"),
    ],
)
def test_studies_without_a_budget_raise_an_error(old, new, options, words):
    with pytest.raises(ValueError, match=words):
        error_budget(parse_study(TEXT.replace(old, new), name="x", solve=False), **options)


@pytest.mark.long  # the influences of an allocation are compared in test_cli_allocate.py
def test_a_response_without_a_curve_has_shares_and_slopes(question):
    """The lost motion is a sum: of each error the variance is that of its elements times the square of the slope."""
    found = budgets.scalar_budget(question, "lost_motion", samples=512).influence
    population = Population.of(question.tolerances)
    for name, tolerance in population.active.items():
        _, variance, *_ = (np.broadcast_to(moment, tolerance.shape) for moment in tolerance.moments())
        expected = found.slopes[name] ** 2 * float(np.sum(variance))
        assert found.variance[name] == pytest.approx(expected, abs=1e-9 * found.sd**2), name
    assert sum(found.variance.values()) == pytest.approx(found.sd**2) and found.failed == 0


def test_slopes_of_a_life_are_hours_per_micrometre():
    asked = study.load("rv-40e-whole", solve=False)
    fields = Population.of(asked.tolerances).active
    whole, slopes = Estimate(1.0, 0.0, 1.0, 1.0), dict.fromkeys(fields, 250 * 3600 / 1e-6)
    part = Estimate(1 / len(fields), 0.01, 0.02, 0.08)
    found = Influence(
        dict.fromkeys(fields, part), slopes, slopes, dict.fromkeys(fields, 3600.0**2), dict.fromkeys(fields, 1.0),
        whole, 6000 * 3600.0, 3600.0, 64, 0,
    )  # fmt: skip
    made = budgets.ScalarBudget("life", found, dict.fromkeys(fields, "disc"))
    text = report_on_scalar(made, asked).text()
    assert "mean 6000 h, standard deviation 1 h" in text and " 250 h/um" in text and "sd h" in text
    assert "5.0 % [2.0, 8.0]" in text and "act together" not in text
