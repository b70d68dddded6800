"""Pictures: the data that is drawn is the data that was given, axes carry units, nothing is left open."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.quiver import Quiver

from rvjax import loaded, plotting
from rvjax.catalogue import RV_40E
from rvjax.status import SolveInfo
from rvjax.units import arcmin, mm, um


@pytest.fixture(autouse=True)
def styled():
    with plotting.style():
        yield
    plt.close("all")


def test_unit_curves_are_drawn_about_their_mean_and_closed():
    """The unit of median range, and the range of all but a failed one at each angle."""
    angle = np.arange(8) * np.pi / 4
    curves = 3 * arcmin + arcmin * np.sin(angle)[None] * np.array([[1.0], [3.0], [2.0], [np.nan]])
    axes = plotting.unit_curves(angle, curves, 2 * curves, "title", "rad")
    after = axes.lines[1].get_ydata()
    np.testing.assert_allclose(after[:-1], 4 * np.sin(angle), atol=1e-12)
    ends = [path.vertices[:, 1] for band in axes.collections for path in band.get_paths()]
    np.testing.assert_allclose([[rows.min(), rows.max()] for rows in ends], [[-3, 3], [-6, 6]])
    assert "before, 3 units" in {text.get_text() for text in axes.get_legend().get_texts()}
    assert after[0] == after[-1] and axes.get_xlim() == (0, 360) and axes.get_ylabel() == "arcmin"
    axes = plotting.unit_curves(angle, curves[3:], curves[3:], "all fail", "rad")
    assert {text.get_text() for text in axes.get_legend().get_texts()} >= {"before, 0 units", "after, 0 units"}


def test_histogram_marks_both_limits_in_readable_units():
    values = np.linspace(-1, 1, 100) * um
    axes = plotting.histogram({"after": values / 2, "before": values}, unit="m", name="misfit", limits=(-um, 2 * um))
    labels = {text.get_text() for text in axes.get_legend().get_texts()}
    assert labels == {"before", "after", "limit -1 um", "limit 2 um"}
    assert plotting.histogram({"constant": np.zeros(5)}, unit="m", name="constant", limits=(-np.inf, np.inf))


def life(seed):
    """A life whose mean does not exist: nine tenths are below 30,000, the largest of 4096 near 1e17."""
    return 1e4 * np.abs(2 + np.random.default_rng(seed).normal(size=4096)) ** (-10 / 3)


def test_histogram_of_a_heavy_tail_shows_its_body():
    """On a logarithmic axis where all values are positive, else between ends that few units are beyond."""
    ends = np.append(life(0), [np.inf, np.inf])
    axes = plotting.histogram({"after": ends, "before": life(1)}, unit="s", name="life", limits=[100.0])
    assert axes.get_xscale() == "log" and axes.get_ylabel() == "density (1/decade)"
    bars = axes.patches[:80]
    step = np.log10(bars[0].get_x() + bars[0].get_width()) - np.log10(bars[0].get_x())
    assert sum(bar.get_height() * step for bar in bars) == pytest.approx(4096 / 4098)
    assert sum(bar.get_height() * step > 2e-3 for bar in bars) > 15  # on a linear axis one bar would have all
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {
        "before", "after, 2 of 4,098 units infinite", "limit 100 s"
    }  # fmt: skip
    signed = life(0) * np.where(np.arange(4096) % 2, 1, -1)
    axes = plotting.histogram({"some": signed}, unit="s", name="change")
    bars, beyond = axes.patches[:80], np.mean(np.abs(signed) > 3e5)
    assert axes.get_xscale() == "linear" and sum(bar.get_height() > 0 for bar in bars) > 40
    assert 0.9 < sum(bar.get_height() * bar.get_width() for bar in bars) < 1 - beyond
    assert "units are beyond the axis" in axes.get_xlabel()


def test_a_histogram_misses_the_failed_units_and_says_how_many():
    values = np.append(np.linspace(0, 1, 80), np.full(20, np.nan)) * um
    axes = plotting.histogram({"all_good": values[:80], "some": values}, unit="m", name="misfit", limits=[um])
    assert sum(bar.get_height() * bar.get_width() for bar in axes.patches[:80]) == pytest.approx(1)
    outline = axes.patches[80].get_xy()
    assert np.trapezoid(outline[:-1:2, 1], outline[:-1:2, 0]) == pytest.approx(0.8, abs=0.02)
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["all good", "some, 20 of 100 units failed", "limit 1 um"]


def test_lines_are_named_and_a_gap_stays_a_gap():
    axes = plotting.lines(
        [-10.0, 0.0, 10.0],
        {"a": [1.0, np.nan, 1.0], "b": [2.0, 3.0, 4.0]},
        band={"all units": ([0.0, 0.0, 0.0], [5.0, 6.0, 7.0])},
        looks={"b": {"marker": "o"}},
        xlabel="error (um)",
        ylabel="angle (arcmin)",
        title="title",
    )
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), [[-10, 1], [0, np.nan], [10, 1]])
    assert [line.get_marker() for line in axes.lines] == ["None", "o"]
    assert len({(line.get_color(), line.get_linestyle()) for line in axes.lines}) == 2
    assert axes.collections[0].get_datalim(axes.transData).y1 == 7
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["all units", "a", "b"]
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("error (um)", "angle (arcmin)", "title")


def test_bars_stand_at_their_names_from_the_top():
    axes = plotting.bars(["x", "y"], {"one": [1.0, 2.0], "two": [3.0, 4.0]}, xlabel="force (N)")
    place = {text.get_text(): tick for text, tick in zip(axes.get_yticklabels(), axes.get_yticks())}
    found = {(bar.get_y() + bar.get_height() / 2, bar.get_width()) for bar in axes.patches}
    at = {width: y for y, width in found}
    assert place["x"] > place["y"] and at[1] > place["x"] > at[3] and at[2] > place["y"] > at[4]


def test_a_negative_part_of_a_stacked_bar_extends_to_the_left():
    axes = plotting.stacked_bars({"a": {"x": 60.0, "y": -20.0, "z": 50.0, "w": -10.0}}, xlabel="share (%)", least=55)
    ends = [sorted((bar.get_x(), bar.get_x() + bar.get_width())) for bar in axes.patches]
    assert ends == [[0, 60], [-20, 0], [60, 110], [-30, -20]] and [text.get_text() for text in axes.texts] == ["60"]


def test_shares_fill_the_bar():
    axes = plotting.variance_shares({"a": {"x": 0.25, "y": 0.75}, "b": {"x": 1.0, "y": 0.0}}, title="shares")
    assert sum(bar.get_width() for bar in axes.patches) == pytest.approx(200)
    many = plotting.variance_shares({"a": {f"field{k}": 1 / 16 for k in range(16)}}, title="shares")
    looks = {(bar.get_facecolor(), bar.get_hatch()) for bar in many.patches}
    assert len(looks) == 16  # no two errors look alike


def test_cost_against_yield_shows_the_study_between_its_neighbours():
    axes = plotting.cost_against_yield([0.9, 0.99, 0.999], [1.0, 2.0, 3.0], chosen=(0.9973, 2.5), start=(1.0, 5.0))
    curve = axes.lines[0].get_xdata()
    assert curve == pytest.approx([0.1, 0.01, 0.001])
    assert axes.lines[2].get_xdata()[0] > 0  # a yield of 1 stands at the edge, not at infinity


def test_cost_against_yield_of_a_narrow_range_has_several_labels():
    axes = plotting.cost_against_yield([0.985, 0.992, 0.994], [1.0, 2.0, 3.0], chosen=(0.992, 2.0), start=(0.97, 1.0))
    labels = [text.get_text() for text in axes.get_xticklabels()]
    assert labels == ["99", "99.5"] and axes.get_xticks() == pytest.approx([1e-2, 5e-3])


def test_cost_against_yield_without_rejects_has_a_logarithmic_axis(recwarn):
    """No unit fails: Matplotlib would warn that nothing is positive."""
    axes = plotting.cost_against_yield([1.0], [1.0], chosen=(1.0, 1.0), start=(1.0, 2.0))
    axes.figure.canvas.draw()
    assert axes.get_xscale() == "log" and not recwarn.list
    assert all(line.get_xdata()[0] > 0 for line in axes.lines)


def test_cost_bars_sum_up_and_carry_their_notes():
    axes = plotting.cost_bars(
        {"disc_bore": 4.0, "crank_phase": 1.0}, {"disc_bore": 2.5, "crank_phase": 2.0}, notes={"disc_bore": "wider"}
    )
    assert sorted(bar.get_width() for bar in axes.patches) == [1.0, 2.0, 2.5, 4.0]
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["before, 5.00 in all", "after, 4.50 in all"] and "wider" in {t.get_text() for t in axes.texts}


def pressed():
    """Forces that nobody solved for: pin 10 presses disc 0 with 2 kN, pin 30 disc 1 with 1 kN."""
    pins, bearing = np.zeros((2, 40)), np.zeros((2, 2, 2))
    pins[0, 10], pins[1, 30] = 2e3, 1e3
    bearing[0, :, 1] = [4e3, 8e3]
    rest = dict.fromkeys(("error", "pressure", "support_bearing", "input_torque", "stiffness"), 0.0)
    loads = dict(gear=np.array([300.0, 100.0]), disc_torque=np.array([-200.0, -200.0]))
    return loaded.Loaded(pins=pins, disc_bearing=bearing, **loads, info=SolveInfo(0, 0, 0.0), **rest)


@pytest.mark.parametrize("disc", [0, 1])
@pytest.mark.parametrize("output", [0.0, 0.31])
def test_arrows_of_a_disc_start_on_its_flank_and_aim_at_the_pitch_point(disc, output):
    cycloid = RV_40E.cycloid
    axes = plotting.drawings.pin_forces(RV_40E, pressed(), input_angle=output * RV_40E.ratio, disc=disc)
    pins, cranks = (c for c in axes.collections if isinstance(c, Quiver))
    crank = -40 * output + np.pi * disc
    pitch = 40 * cycloid.eccentricity * np.array([np.cos(crank), np.sin(crank)]) / mm
    start, arrow = pins.get_offsets()[0], np.array([pins.U[0], pins.V[0]])
    across = (pitch - start)[0] * arrow[1] - (pitch - start)[1] * arrow[0]
    assert abs(across) < 1e-9 * np.linalg.norm(pitch) * np.linalg.norm(arrow) and arrow @ (pitch - start) > 0
    # Both discs share the scale: 2 kN and 1 kN.
    assert np.hypot(*arrow) == pytest.approx(0.45 * cycloid.pin_circle_radius / mm * (1 - disc / 2))
    flank = axes.patches[0].get_xy()
    # Drawn with 60 points a tooth, a step of the flank below 0.2 mm; its sag stays below 3 um.
    step = np.max(np.linalg.norm(np.diff(flank, axis=0), axis=1))
    assert np.min(np.linalg.norm(flank - start, axis=1)) < step
    assert np.hypot(cranks.U, cranks.V).max() == pytest.approx(0 if disc else 0.4 * cycloid.pin_circle_radius / mm)
    assert axes.get_legend().get_texts()[0].get_text() == f"1 of 40 pins, at most {2 - disc} kN"


def test_the_style_stays_only_where_it_is_asked_to():
    with plt.rc_context():
        plt.rcdefaults()
        plt.ioff()
        before = dict(plt.rcParams)
        with plotting.style():
            assert plt.rcParams["axes.grid"]
            plt.ion()  # as the first figure of a notebook does
        assert dict(plt.rcParams) == before | {"interactive": True}
        plotting.use_style()
        assert plt.rcParams["axes.grid"] and plt.rcParams["figure.dpi"] == 100
