"""Measured tables: what a bench writes, however it spells it, and every way in which a table can be wrong.

Oracle: the numbers from which the tables are written.
"""

import re

import numpy as np
import pytest

from rvjax import measured, study
from rvjax.measured import read_table
from rvjax.study.problem import problem
from rvjax.units import arcmin, arcsec, deg


def refused(path, columns=None):
    """The message, without the folder; one line."""

    def read():
        for run in measured.read([path], columns).runs:
            measured.checked(run, 40)

    with pytest.raises(ValueError, match=re.escape(str(path))) as caught:
        read()
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path}: ", "")


def curve(angle, error=None, more=("", "")):
    """A table; `more` is the header and the cell of one more column."""
    error = np.zeros(len(angle)) if error is None else error
    head, cell = (f",{text}" if text else "" for text in more)
    rows = "".join(f"{float(a)!r},{float(e)!r}{cell}\n" for a, e in zip(angle, error))
    return f"angle [deg],error [arcsec]{head}\n{rows}"


FULL = np.arange(0, 360, 2.0)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Angle [deg],error [arcsec],note\n0.5,-1.25,x\n\n1.5,,y\n2.5,3,z\n", "utf-8"),
        ("angle [deg];error [arcsec]\n0,5;-1,25\n1,5;nan\n2,5;3\n", "utf-8-sig"),
        ("angle [deg]\terror [arcsec]\n0.5\t-1.25\n1.5\t\n2,5\t3\n", "utf-8"),
    ],
)
def test_every_spelling_gives_the_same_run(write, text, encoding):
    (run,) = measured.read([write(text, encoding=encoding)]).items
    np.testing.assert_allclose(run.angle, np.array([0.5, 2.5]) * deg, rtol=1e-15)  # an empty reading is no sample
    np.testing.assert_allclose(run.error, np.array([-1.25, 3]) * arcsec, rtol=1e-15)
    assert run.at == measured.Conditions()


def test_foreign_columns_are_mapped_with_their_units(write):
    path = write("Winkel;TE [arcmin];M\n1;2;-3\n")
    columns = {"angle": {"column": "Winkel", "unit": "deg"}, "error": "TE", "torque": {"column": "M", "unit": "kN m"}}
    table = read_table(path, columns)
    assert {name: values[0] for name, values in table.numbers.items()} == pytest.approx(
        {"angle": deg, "error": 2 * arcmin, "torque": -3000.0}
    )


def test_rows_of_equal_conditions_are_a_run(write):
    rows = "".join(
        f"{a},{10 * t + a},{t},{d},{c},{u}\n"
        for a in (0, 1, 2)
        for u in "ba"
        for t in (412, 100)
        for d in ("forward", "backward")
        for c in (25, "")
    )
    found = measured.read([write("angle [deg],error [arcsec],torque [N m],direction,temperature [degC],unit\n" + rows)])
    assert len(found.items) == 16 and found.units == ["b", "a"]
    assert all(len(run.angle) == 3 for run in found.items)
    run = found.items[1]
    assert run.at == measured.Conditions("b", 412.0, "forward", None) and run.at.sign == 1
    np.testing.assert_allclose(run.error / arcsec, [4120, 4121, 4122])
    assert found.items[0].at.text() == "412 N m forward, 25 degC"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no table; the first line must name the columns"),
        ("angle [deg],error [arcsec]\n", "no rows under the header"),
        ("angle [deg]\n1\n", "columns angle: what is needed is one of curve: angle, error; loop"),
        (
            "angle,error [arcsec]\n1,2\n",
            "column 'angle': has no unit; write \"angle [deg]\" (deg, rad, arcmin, arcsec, mrad, urad, turn, gon)",
        ),
        ("angle [grad],error [arcsec]\n1,2\n", "column 'angle [grad]': unit 'grad' is not known"),
        ("angle [deg],angle [rad]\n1,2\n", "column 'angle [rad]': angle is in two columns"),
        ("angle [deg],error [arcsec]\n1,2\n3,abc\n", "row 3, error = 'abc': must be a number in arcsec"),
        ("angle [deg],error [arcsec]\n1,inf\n", "row 2, error = 'inf': must be finite, in arcsec"),
        ("angle [deg],error [arcsec]\n1,1e308\n", "row 2, error = '1e308': too large, must be at most 1e+12 arcsec"),
        ("angle [deg],error [arcsec]\n1,-1e400\n", "row 2, error = '-1e400': too large"),
        ("angle [deg],error [arcsec]\n1,1e-400\n", "row 2, error = '1e-400': too small, must be 0 or at least 1e-100"),
        ("angle [deg],error [arcsec]\n1,2\n-1E-320,0\n", "row 3, angle = '-1E-320': too small"),
        ("angle [deg],error [arcsec]\n1,5,2,5\n", "row 2 has 4 cells, the header 2 (decimal commas?"),
        ("angle [deg],error [arcsec]\n,2\n", "row 2, angle is empty"),
        ("angle [deg],error [arcsec],direction\n1,2,left\n", "row 2, direction = 'left': must be forward or backward"),
        ("frequency [Hz],sd [Hz]\n100,1\n-5,1\n", "row 3, frequency = -5: must be positive, in Hz"),
        ("frequency [Hz],sd [Hz]\n100,0\n", "row 2, sd = 0: must be positive, in Hz"),
        ("torque [N m],angle [arcmin]\n1,2\n", "loop of 1 samples over 0 N m: needs 84 samples"),
        ('angle [deg],error [arcsec]\n"1,2\n', "not a table of cells"),
        ("angle [deg],error [arcsec]\n1,2\n" + "\0", "no table"),
        (curve(FULL[:-3]), "run forward: covers 354 deg in 177 samples, needs at least 359 deg"),
        (curve(FULL[:1], more=("torque [N m]", "412")), "run 412 N m forward: covers 0 deg in 1 samples"),
        (curve([*FULL[:90], 170.0, *FULL[90:], 360.0]), "the angle turns back by 8 deg; a run goes one way, forward"),
        (curve(-FULL), "the angle turns back by 358 deg"),
        (curve([*FULL[:90], *FULL[93:], 360.0]), "a gap of 8 deg in the angle; order 40 needs at most 4.5 deg"),
    ],
)
def test_a_bad_table_is_said_in_one_line(write, text, message):
    assert message in refused(write(text))


def test_a_zero_and_its_rounding_error_are_numbers(write):
    path = write("angle [deg],error [arcsec]\n0e-400,0.0\n1,-3e-17\n2,1e12\n")
    assert list(read_table(path).numbers["error"] / arcsec) == pytest.approx([0.0, -3e-17, 1e12])


def test_bad_names_of_columns(write):
    path = write(curve(FULL))
    message = refused(path, {"error": "TE"})
    assert "columns.error = 'TE'" in message and "angle [deg], error [arcsec]" in message
    with pytest.raises(ValueError, match=r"unknown key columns.colour; known here: angle, direction"):
        measured.read([path], {"colour": "n"})
    with pytest.raises(ValueError, match=r"columns.angle = 3: must be the header of a column"):
        measured.read([path], {"angle": 3})
    with pytest.raises(FileNotFoundError, match="no such data file"):
        measured.read([path.with_name("none.csv")])
    path.write_bytes(b"\xff\xfe\x00")
    assert "cannot be read as text" in refused(path)


def test_one_kind_at_a_time(write):
    tones = write("frequency [Hz]\n1\n", "tones.csv")
    with pytest.raises(ValueError, match=r"tones.csv: holds frequencies, .*bench.csv holds curve"):
        measured.read([write(curve(FULL)), tones])
    with pytest.raises(ValueError, match="no data"):
        measured.read([])


@pytest.mark.parametrize("direction", [1, -1])
def test_a_run_may_wrap_jitter_and_go_backward(write, direction):
    """A wrapped angle is unwound; jitter below a tenth of the finest order is sorted; backward runs fall or rise."""
    rng = np.random.default_rng(1)
    angle = 200 + np.arange(0, 361, 0.5) + 0.3 * rng.uniform(-1, 1, 722)
    word = "forward" if direction == 1 else "backward"
    text = curve((angle % 360)[::direction], np.arange(722.0)[::direction], ("direction", word))
    run = measured.checked(measured.read([write(text)]).items[0], 40)
    assert np.all(np.diff(run.angle) >= 0) and np.ptp(run.angle) == pytest.approx(np.ptp(angle) * deg)
    shift = np.round((run.angle[0] / deg - 200) / 360) * 360
    np.testing.assert_allclose(run.angle / deg - shift, np.sort(angle), atol=1e-9)
    np.testing.assert_array_equal(np.round(run.error / arcsec), np.argsort(angle, kind="stable"))


def test_frequencies_are_sorted_with_their_scatter(write):
    (tones,) = measured.read([write("frequency [kHz],sd [Hz],unit\n2,3,a\n1,4,a\n")]).items
    np.testing.assert_allclose(tones.frequency, [1000, 2000])
    np.testing.assert_allclose(tones.sd, [4, 3])
    assert tones.at.unit == "a"


LOOP = """
[design]
base = "rv-40e-whole"
[conditions]
rated_torque = "412 N m"
[tolerances.bearing_clearance]
lower = "0 um"
upper = "12 um"
[requirement.torsional_stiffness]
lower = "50 N m/arcmin"
[identify]
model = "loaded"
noise = "floor"
nuisance = ["offset", "drag"]
"""


def hysteresis(samples=4000, cut=np.inf, noise=0.0, sine=False):
    """angle = 2 T/100 + 0.5 sign(T) T^2/1e4 -+ 0.3 arcmin on the branches; a sensor that ends at `cut`."""
    time = np.linspace(0, 2, samples, endpoint=False)
    wave = np.sin(2 * np.pi * time) if sine else 2 / np.pi * np.arcsin(np.sin(2 * np.pi * time))
    torque = 100 * wave
    rising = np.cos(2 * np.pi * time) > 0
    angle = 2 * torque / 100 + 0.5 * np.sign(torque) * torque**2 / 1e4 - np.where(rising, 0.3, -0.3)
    rng = np.random.default_rng(0)
    angle = angle + noise * rng.normal(size=samples)
    torque = np.clip(torque, -cut, cut)
    return "torque [N m],angle [arcmin]\n" + "".join(f"{float(t)!r},{float(a)!r}\n" for t, a in zip(torque, angle))


@pytest.mark.parametrize(("cut", "sine"), [(np.inf, False), (np.inf, True), (80.0, False)])
def test_a_loop_becomes_midline_and_width(write, cut, sine):
    """A line in each bin misses the curvature a = 0.5e-4 arcmin/(N m)^2 by at most a h^2 with h = half a step."""
    (loop,) = measured.read([write(hysteresis(cut=cut, sine=sine))]).items
    assert loop.clipped == np.isfinite(
        cut
    )  # a sine rests at its ends, 2 % of the time within a thousandth: no clipping
    assert loop.torque[-1] == pytest.approx(-loop.torque[0], abs=0.2) and loop.torque[-1] < min(100, cut)
    due = 2 * loop.torque / 100 + 0.5 * np.sign(loop.torque) * loop.torque**2 / 1e4
    half = np.diff(loop.torque)[0] / 2
    np.testing.assert_allclose(loop.midline / arcmin, due, atol=1.0 * 0.5e-4 * half**2 + 1e-9)
    np.testing.assert_allclose(loop.width / arcmin, 0.6, atol=2e-4)


def test_the_scatter_of_a_midline_is_known(write):
    """Residuals over their standard deviations: a sum of 21 squares of Student numbers with many degrees of freedom."""
    (loop,) = measured.read([write(hysteresis(noise=0.05))]).items
    due = 2 * loop.torque / 100 + 0.5 * np.sign(loop.torque) * loop.torque**2 / 1e4
    score = np.sum(((loop.midline / arcmin - due) / (loop.sd / arcmin)) ** 2)
    assert 5.9 < score < 46.8  # chi square of 21: 0.05 % on either side


def test_the_scatter_of_a_width_is_known(write, tmp_path):
    """A width is the difference of two branches. Its scatter is twice that of their mean; chi square as above."""
    path = tmp_path / "loop.toml"
    path.write_text(LOOP)
    question = study.load(path, solve=False)
    found = problem(question, measured.read([write(hysteresis(noise=0.05))]))
    (loop,) = found.items[0]
    score = np.sum(((loop.width / arcmin - 0.6) / (found.noise.sd["width"] / arcmin)) ** 2)
    assert 5.9 < score < 46.8


def test_half_a_loop_is_refused(write):
    lines = hysteresis().splitlines()
    assert "only one branch" in refused(write("\n".join(lines[:480])))
    row = lines[5].split(",")[0] + ","
    assert "row 6, angle is empty" in refused(write("\n".join([*lines[:5], row, *lines[6:]])))
