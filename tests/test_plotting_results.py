"""Pictures of results: what is drawn is what was computed, in the units on the axes.

Oracle: the numbers given to the picture, converted by hand.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

from rvjax import dynamics, four_bar, mesh_force, plotting
from rvjax.plotting.tradeoff import VERDICTS
from rvjax.status import SolveInfo
from rvjax.tolerances import Estimate
from rvjax.units import arcmin, um

INFO = SolveInfo(0, 0, 0.0)


@pytest.fixture(autouse=True)
def styled():
    with plotting.style():
        yield
    plt.close("all")


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_linkages_close_with_links_of_their_length():
    crossed = -2 * np.arctan(0.25)  # coupler from (0, 1/4) to a pin 1/4 away from (1, 0)
    closures = {name: four_bar.Closure(angle, 0.0, 0.0, INFO) for name, angle in (("open", 0.0), ("crossed", crossed))}
    axes = plotting.four_bar.linkages(0.25, 1.0, closures, crank_angle=np.pi / 2)
    for line in axes.lines[1:]:
        links = np.hypot(*np.diff(line.get_xydata(), axis=0).T)
        np.testing.assert_allclose(links, [0.25, 1.0, 0.25], atol=1e-12)
    assert legend(axes) == ["carrier (frame)", "open: disc at 0.00 deg", "crossed: disc at -28.07 deg"]


def test_angles_over_error_are_magnitudes_and_zero_is_a_gap():
    axes = plotting.four_bar.angles_over_error([-10 * um, 0.0, 10 * um], {"a": [-arcmin, 0.0, arcmin]}, name="frame")
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [-10, 0, 10])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), [1, np.nan, 1])
    assert "(um)" in axes.get_xlabel() and "(arcmin)" in axes.get_ylabel()


def test_turns_are_closed_and_tell_their_peak_to_peak():
    angle = np.arange(8) * np.pi / 4
    error = 2 * arcmin * np.sin(angle)
    blank = dict.fromkeys(("misfit", "maximum", "minimum", "mean", "largest_misfit", "harmonics"), 0.0)
    turn = four_bar.Revolution(crank_angle=angle, error=error, peak_to_peak=4 * arcmin, info=INFO, **blank)
    axes = plotting.four_bar.turns({"unit": turn})
    drawn = axes.lines[0].get_ydata()
    assert len(drawn) == 9 and drawn[0] == drawn[-1] and drawn[2] == pytest.approx(2)
    assert legend(axes) == ["unit: 4.000 arcmin peak to peak"]


def test_bars_of_roller_forces():
    forces = [mesh_force.MeshForces(np.arange(6) * k, np.zeros(6), np.zeros(6), 0.0, INFO) for k in (1.0, 2.0)]
    axes = plotting.mesh_force.roller_forces({"one": forces[0], "two": forces[1]})
    heights = np.reshape([bar.get_height() for bar in axes.patches], (2, 6))
    np.testing.assert_array_equal(heights, [forces[0].cam, forces[1].cam])
    assert "(N)" in axes.get_ylabel()


def test_studies_show_printed_values_at_the_ends():
    ramp = np.array([1.0, 2.0, 3.0])
    names = [f for f in mesh_force.CycleStatistics.__dataclass_fields__ if f != "info"]
    one = mesh_force.CycleStatistics(**dict.fromkeys(names, 0.0), info=INFO)
    found = jax.tree.map(lambda leaf: leaf + ramp, one)  # as a sweep gives it: (k,) fields
    results = {"Fig. 14": ("errors.cam_radius", [-10 * um, 0.0, 10 * um], found)}
    figure = plotting.mesh_force.studies(results, {"Fig. 14": {"cam_mean": (5.0, 6.0)}})
    axes = figure.axes[0]
    (crosses,) = (line for line in axes.lines if line.get_marker() == "x" and len(line.get_xdata()))
    np.testing.assert_allclose(crosses.get_xydata(), [[-10, 5], [10, 6]])
    assert axes.get_xlabel() == "error of cam radius (um)"
    assert [a.get_visible() for a in figure.axes] == [True, False, False]


def test_one_period_synthesises_the_harmonics():
    time = np.arange(16) / 16
    motion = 1e-6 * np.cos(2 * np.pi * 2 * time)
    exact = dynamics.Periodic(time, 5e-6 + motion[:, None], 1.0, ("output.x",), INFO)
    amplitude = jnp.array([[0.0], [1e-6 + 0j]])
    found = dynamics.Response(np.ones(2), amplitude, np.zeros(1), np.ones(2), ("output.x",), "first_order", INFO)
    axes = plotting.dynamics.one_period(exact, {"two harmonics": found}, output="output.x", unit="m")
    np.testing.assert_allclose(axes.lines[0].get_ydata(), axes.lines[1].get_ydata(), atol=1e-12)
    assert (
        axes.lines[1].get_ydata()[0] == pytest.approx(1.0)
        and "(um)" in axes.get_ylabel()
        and "(ms)" in axes.get_xlabel()
    )


def test_batch_histogram_misses_the_failed_units():
    values = np.append(np.linspace(0, 1, 80), np.full(20, np.nan)) * um
    axes = plotting.batch_histograms({"all_good": values[:80], "some": values}, unit="m", name="misfit", limits=[um])
    bars = axes.patches[:120]
    assert sum(bar.get_height() * bar.get_width() for bar in bars) == pytest.approx(1)
    outline = axes.patches[120].get_xy()
    assert np.trapezoid(outline[:-1:2, 1], outline[:-1:2, 0]) == pytest.approx(0.8, abs=0.02)
    assert legend(axes) == ["all good, 80 units", "some, 80 of 100 units", "limit 1 um"]


def test_rejects_fall_to_one_unit_and_the_rare_ones_go_on():
    values = np.linspace(0, 1, 1000) * um
    rare = {1.1 * um: Estimate(1e-5, 1e-6, 0.8e-5, 1.2e-5)}
    axes = plotting.rejects_against_limit(values, rare, unit="m", name="misfit", limit=um)
    limits, beyond = axes.lines[0].get_data()
    np.testing.assert_allclose(beyond, 1e6 * (values[:, None] >= limits * um * (1 - 1e-12)).mean(axis=0))
    assert beyond.min() == pytest.approx(1000) and limits[np.argmin(beyond)] == pytest.approx(1.0)
    (circle,) = (line for line in axes.lines if line.get_marker() == "o")
    np.testing.assert_allclose(circle.get_xydata(), [[1.1, 10]])


def test_cost_bars_sum_up_and_carry_their_notes():
    axes = plotting.cost_bars(
        {"disc_bore": 4.0, "crank_phase": 1.0}, {"disc_bore": 2.5, "crank_phase": 2.0}, notes={"disc_bore": "wider"}
    )
    assert sorted(bar.get_width() for bar in axes.patches) == [1.0, 2.0, 2.5, 4.0]
    assert legend(axes) == ["before, 5.00 in all", "after, 4.50 in all"] and "wider" in {
        t.get_text() for t in axes.texts
    }


def test_verdicts_count_every_figure():
    axes = plotting.verdicts({"a": ["reproduced", "close", "close"], "b": ["contradicted"]})
    assert sum(bar.get_width() for bar in axes.patches) == 4
    assert sorted(text.get_text() for text in axes.texts) == ["1", "1", "2"]
    assert len({(bar.get_facecolor(), bar.get_hatch()) for bar in axes.patches}) == len(VERDICTS)


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
