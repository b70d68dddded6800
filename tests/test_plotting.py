"""Pictures: the data that is drawn is the data that was given, axes carry units, nothing is left open."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from rvjax import catalogue, lost_motion, plotting
from rvjax.units import arcmin, um


@pytest.fixture(autouse=True)
def styled():
    with plotting.style():
        yield
    plt.close("all")


def test_contributions_draw_every_term_and_their_sum():
    result = lost_motion.geometric(catalogue.RV_20E, catalogue.RV_20E_ERRORS)
    axes = plotting.contributions(result)
    widths = [bar.get_width() for bar in axes.patches]
    assert sum(widths) == pytest.approx(float(result.total) / arcmin)
    assert "+1.757 arcmin" in axes.get_title() and "(arcmin)" in axes.get_xlabel()


def test_torque_angle_loop_closes_and_is_odd():
    options = dict(torque_max=167.0, torque_threshold=5.0, play=1 * arcmin, stiffness=50 / arcmin)
    axes = plotting.torque_angle_loop(**options, friction=2.0, smoothing=1.5)
    cycle = next(line for line in axes.lines if line.get_label() == "cycle")
    angle = cycle.get_ydata()
    assert angle[0] == pytest.approx(angle[-1]) and angle.max() == pytest.approx(-angle.min())
    assert "(N m)" in axes.get_xlabel() and "(arcmin)" in axes.get_ylabel()


def test_unit_curves_are_drawn_about_their_mean_and_closed():
    angle = np.arange(8) * np.pi / 4
    curves = 3 * arcmin + arcmin * np.sin(angle)[None] * np.array([[1.0], [2.0]])
    axes = plotting.unit_curves(angle, curves, 2 * curves, "title", "rad")
    after = axes.lines[1].get_ydata()
    np.testing.assert_allclose(after[:-1], 4 * np.sin(angle), atol=1e-12)
    assert after[0] == after[-1] and axes.get_xlim() == (0, 360) and axes.get_ylabel() == "arcmin"


def test_histogram_marks_both_limits_in_readable_units():
    values = np.linspace(-1, 1, 100) * um
    axes = plotting.response_histogram(values, values / 2, unit="m", name="misfit", lower=-1 * um, upper=2 * um)
    labels = {text.get_text() for text in axes.get_legend().get_texts()}
    assert labels == {"before", "after", "limit -1 um", "limit 2 um"}
    assert plotting.response_histogram(np.zeros(5), np.zeros(5), unit="m", name="constant")


def life(seed):
    """A life whose mean does not exist: nine tenths are below 30,000, the largest of 4096 near 1e17."""
    return 1e4 * np.abs(2 + np.random.default_rng(seed).normal(size=4096)) ** (-10 / 3)


def test_histogram_of_a_heavy_tail_shows_its_body():
    """On a logarithmic axis where all values are positive, else between ends that few units are beyond."""
    ends = np.append(life(0), [np.inf, np.inf])
    axes = plotting.response_histogram(life(1), ends, unit="s", name="life", lower=100.0)
    assert axes.get_xscale() == "log" and axes.get_ylabel() == "density (1/decade)"
    bars = axes.patches[:80]
    step = np.log10(bars[0].get_x() + bars[0].get_width()) - np.log10(bars[0].get_x())
    assert sum(bar.get_height() * step for bar in bars) == pytest.approx(4096 / 4098)
    assert sum(bar.get_height() * step > 2e-3 for bar in bars) > 15  # on a linear axis one bar would have all
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {
        "before", "after, 2 of 4,098 units infinite", "limit 100 s"
    }  # fmt: skip
    signed = life(0) * np.where(np.arange(4096) % 2, 1, -1)
    for axes, bins in (
        (plotting.response_histogram(signed, signed, unit="s", name="change"), 80),
        (plotting.batch_histograms({"some": signed}, unit="s", name="change"), 120),
        (plotting.dynamics.spread(signed, mean=0.0, sd=1e3, unit="s", name="change"), 60),
    ):
        bars, beyond = axes.patches[:bins], np.mean(np.abs(signed) > 3e5)
        assert axes.get_xscale() == "linear" and sum(bar.get_height() > 0 for bar in bars) > bins / 2
        assert 0.9 < sum(bar.get_height() * bar.get_width() for bar in bars) < 1 - beyond
        assert "units are beyond the axis" in axes.get_xlabel()


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
