"""Pictures of the loaded reducer: what is drawn is what was computed, in the units on the axes.

Oracle: the numbers given to the picture, converted by hand, and the law of gearing (force through the pitch point).
"""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.quiver import Quiver

from rvjax import catalogue, loaded, plotting
from rvjax.status import SolveInfo
from rvjax.units import arcmin, arcsec, mm

DESIGN = catalogue.RV_40E
INFO = SolveInfo(0, 0, 0.0)


@pytest.fixture(autouse=True)
def styled():
    with plotting.style():
        yield
    plt.close("all")


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def result():
    """Forces that nobody solved for: pin 10 presses disc 0 with 2 kN, pin 30 disc 1 with 1 kN."""
    pins, bearing = np.zeros((2, 40)), np.zeros((2, 2, 2))
    pins[0, 10], pins[1, 30] = 2e3, 1e3
    bearing[0, :, 1] = [4e3, 8e3]
    rest = dict.fromkeys(("error", "pressure", "support_bearing", "input_torque", "stiffness"), 0.0)
    loads = dict(gear=np.array([300.0, 100.0]), disc_torque=np.array([-200.0, -200.0]))
    return loaded.Loaded(pins=pins, disc_bearing=bearing, **loads, info=INFO, **rest)


@pytest.mark.parametrize("disc", [0, 1])
@pytest.mark.parametrize("output", [0.0, 0.31])
def test_arrows_of_a_disc_start_on_its_flank_and_aim_at_the_pitch_point(disc, output):
    cycloid = DESIGN.cycloid
    axes = plotting.loaded.pin_forces(DESIGN, result(), input_angle=output * DESIGN.ratio, disc=disc)
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
    assert legend(axes)[0] == f"1 of 40 pins, at most {2 - disc} kN"


def test_torsion_is_drawn_as_a_bench_turns_it():
    """Error falls with the torque of the discs, the bench's angle rises with its load; the play stands about zero."""
    torque = np.array([-400, -200, -12, -0.4, 0.4, 12, 200, 400.0])
    angle = (1.0 - 0.002 * torque - 0.1 * np.sign(torque)) * arcmin
    found = loaded.Torsion(
        torque=torque,
        angle=angle,
        backlash=0.2008 * arcmin,
        lost_motion=0.248 * arcmin,
        stiffness=500 / arcmin,
        info=INFO,
    )
    axes = plotting.loaded.torsion_curve(found)
    load, twist = axes.lines[0].get_data()
    np.testing.assert_allclose(load, -torque)
    np.testing.assert_allclose(twist, 0.002 * load + 0.1 * np.sign(load), atol=1e-12)
    assert legend(axes)[1:] == ["stiffness 500 N m/arcmin", "backlash 0.201 arcmin", "lost motion 0.248 arcmin"]
    (secant,) = (line for line in axes.lines if line.get_label().startswith("stiffness"))
    np.testing.assert_allclose(secant.get_ydata(), [0.1, 0.9], atol=1e-12)  # through the end, with its slope
    ends = sorted(abs(text.xy[1]) for text in axes.child_axes[0].texts)
    np.testing.assert_allclose(ends, [0.1004, 0.124], rtol=1e-9)


def test_orders_tell_a_known_wave():
    angle = 2 * np.pi * np.arange(256) / 256
    error = (2 * np.cos(40 * angle) + 0.5 * np.sin(78 * angle) + 7) * arcsec
    rest = {f.name: 0.0 for f in dataclasses.fields(loaded.Revolution)}  # what these pictures do not show
    wave = loaded.Revolution(**rest | dict(error=error, peak_to_peak=np.ptp(error), mean=7 * arcsec, info=INFO))
    axes = plotting.loaded.output_orders({"unit": wave}, named=2)
    assert {text.get_text(): round(text.xy[1], 9) for text in axes.texts} == {"40": 2.0, "78": 0.5}
    assert {text.get_ha() for text in axes.texts} == {"center"}
    near = wave.replace(error=error + 0.4 * np.cos(79 * angle) * arcsec)
    axes = plotting.loaded.output_orders({"unit": near}, named=3)  # names of neighbours lean away from each other
    assert {text.get_text(): text.get_ha() for text in axes.texts} == {"40": "center", "78": "right", "79": "left"}


def test_the_measured_curve_says_how_far_the_unseen_points_lie():
    torque, fitted = np.array([0.0, 1.0, 2.0]), np.array([True, False, True])
    axes = plotting.loaded.measured_curve(torque, torque * arcmin, fitted, {"model": 1.1 * torque * arcmin})
    assert legend(axes)[-1] == "model: predicted within 0.100 arcmin"
    np.testing.assert_array_equal(axes.lines[1].get_xydata(), [[1, 1]])
    axes = plotting.loaded.measured_curve(torque, torque * arcmin, fitted, {}, stiffness=2 / arcmin)
    np.testing.assert_allclose(axes.lines[0].get_ydata(), [0, 1])  # 2 N m wind up 2 arcmin, of which 1 is straight
