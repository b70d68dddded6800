"""`rvjax compensate` and `rvjax identify` on curves with drift, aliases, bad readings and passes forth and back."""

import json
from pathlib import Path

import numpy as np
import pytest

from rvjax import cli
from rvjax.compensation import read as read_table
from rvjax.units import arcsec, deg
from tests.measured_cases import NOISE, TRUTH, curve, equal, noise

STUDY = """
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 8
closure = "first_order"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[identify]
model = "four_bar"
orders = [40]
noise = "floor"
nuisance = ["offset", "mounting"]
"""


@pytest.fixture
def bench(here, undrawn):
    """A folder with a study, and what writes a bench file."""
    (here / "my.toml").write_text(STUDY)

    def write(angle, error):
        rows = "".join(f"{a:.6f},{e:.6f}\n" for a, e in zip(angle, error))
        (here / "curve.csv").write_text("angle [deg],error [arcsec]\n" + rows)

    return write


def told(capsys, *arguments):
    code = cli.main([*arguments, "--quiet"])
    found = capsys.readouterr()
    return code, found.out, found.err


def compensated(capsys):
    code, text, _ = told(capsys, "compensate", "my.toml", "curve.csv", "--export", "t.csv", "--format", "json")
    assert code == 0
    return json.loads(text)["curves"]


def test_forth_and_back_without_directions_have_a_table_each(bench, capsys):
    angle = np.concatenate([np.arange(0, 360, 0.5), np.arange(359.5, -0.1, -0.5)])
    side = np.repeat([1.0, -1.0], 720)
    bench(angle, curve(angle * deg) + 2 * side * np.cos(40 * angle * deg) + noise(1440))
    curves = compensated(capsys)
    assert [one["direction"] for one in curves] == ["forward", "backward"]
    for one, sign in zip(curves, (1, -1)):
        value = dict(zip(one["order"], one["value"]))[40]
        assert complex(*value) / arcsec == pytest.approx(TRUTH[40] + 2 * sign, abs=0.1)
        assert one["residual_rms"] == pytest.approx(NOISE * arcsec, rel=0.2)


def test_before_and_after_are_those_of_the_measured_curve(bench, capsys):
    """Without mean and order 1; a turn that was not fitted; 120 points, of which nothing may be stored but order 39."""
    angle = equal(720, 2)
    bench(angle, 5 + curve(angle * deg, TRUTH | {1: 20.0}) + noise(1440))
    (one,) = compensated(capsys)
    size = np.hypot(4.18, NOISE)
    assert one["before_rms"] / arcsec == pytest.approx(size, rel=0.02)
    assert one["residual_rms"] / arcsec == pytest.approx(NOISE, rel=0.1)
    assert np.array(one["held_out_rms"]) / arcsec == pytest.approx([size, NOISE], rel=0.1)
    angle = equal(120)
    bench(angle, curve(angle * deg) + noise(120))
    (one,) = compensated(capsys)
    assert one["order"] == [39] and set(one["not_stored"]) == {"40", "42"} and one["held_out_rms"] is None
    assert one["before_rms"] / arcsec == pytest.approx(4.18, rel=0.05)
    assert one["residual_rms"] / arcsec == pytest.approx(np.sqrt(4.18**2 - 3.8**2 / 2), rel=0.05)
    rows = read_table("t.csv")
    assert np.std(rows.correction) > 0


def test_the_report_names_what_was_found(bench, capsys):
    angle = equal(720)
    error = curve(angle * deg, TRUTH | {66.6: 1.0}) + 10 * angle / 360 + noise(720)
    error[300] += 500
    bench(angle, error)
    code, text, _ = told(capsys, "compensate", "my.toml", "curve.csv", "--results", "out")
    assert code == 0
    for line in ("warning: drift per revolution, ", "warning: order 66.", "warning: bad reading, 50"):
        assert line in text
    assert "arcsec: row 302, 150 deg: left out" in text
    assert "The measurement:" in text and "highest resolved order" in text
    found = json.loads(Path("out/result.json").read_text())["curves"][0]["measurement"]
    assert {one["name"] for one in found} >= {"points", "stroke", "closure", "drift per revolution", "bad reading"}
    page = Path("out/report.html").read_text()
    assert "<h2>The measurement</h2>" in page and "drift per revolution" in page


def test_identify_refuses_orders_that_are_alike(bench, capsys):
    angle = equal(118)
    bench(angle, curve(angle * deg, {78: 3.4}) + noise(118))
    code, _, error = told(capsys, "identify", "my.toml", "curve.csv")
    assert code == 2 and "118 points: order 78 (twice the disc teeth) looks like order 40" in error
    angle = equal(720)
    bench(angle, curve(angle * deg) + 5 * (angle > 200) + noise(720))
    code, _, error = told(capsys, "identify", "my.toml", "curve.csv")
    assert code == 2 and "jumps by 5" in error and "200.5 deg" in error


@pytest.mark.parametrize("disturbed", ["drift", "repeated"])
def test_identify_is_not_moved_by_a_drift_or_repeated_readings(bench, capsys, disturbed):
    """The combination of throws that a curve shows, with and without 60 arcsec of drift: order 40 is the same."""
    values = []
    for add in (False, True):
        angle = np.repeat(equal(180), 3) if add and disturbed == "repeated" else equal(720)
        slope = 60 if add and disturbed == "drift" else 0
        bench(angle, curve(angle * deg, {40: 3j}) + slope * angle / 360 + 0.3 * noise(len(angle)))
        code, text, _ = told(capsys, "identify", "my.toml", "curve.csv", "--results", f"out{add}", "--format", "json")
        found = json.loads(text)
        values.append(found["value"]["crank_eccentricity[0,0]"])
        names = {one["name"] for several in found["measurement"].values() for one in several}
    assert "points" in names and ("drift per revolution" in names) == (disturbed == "drift")
    assert values[1] == pytest.approx(values[0], rel=0.02)
    assert code in (0, 1)
