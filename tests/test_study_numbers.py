"""Numbers of a bench against what they mean: floors of known noise, index marks, encoders, directions, lines."""

import jax
import numpy as np
import pytest

from rvjax import study
from rvjax.study import bench, measured
from rvjax.study.branches import _local
from rvjax.study.measured import Conditions
from rvjax.study.problem import problem
from rvjax.units import arcsec, um

STUDY = """
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 16
closure = "first_order"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[tolerances.bearing_clearance]
lower = "4 um"
upper = "12 um"
[identify]
model = "four_bar"
orders = [40, 80]
noise = "floor"
nuisance = ["offset"]
"""


def noise_of(folder, sizes, seeds):
    """Noise of units whose curves are nothing but noise of these standard deviations, arcsec."""
    n, rows = 900, []
    for unit, (size, seed) in enumerate(zip(sizes, seeds)):
        noise = size * np.random.default_rng(seed).standard_normal(n)
        rows += [f"{k * 360 / n!r},{float(error)!r},412,forward,u{unit}" for k, error in enumerate(noise)]
    (folder / "curves.csv").write_text("\n".join(["angle [deg],error [arcsec],torque [N m],direction,unit", *rows]))
    (folder / "study.toml").write_text(STUDY)
    found = problem(study.load(folder / "study.toml", solve=False), measured.read([folder / "curves.csv"]))
    return {name: np.sqrt(np.mean(np.square(sd))) / arcsec for name, sd in found.noise.sd.items()}


def test_the_floor_of_noise_is_the_error_of_an_amplitude(tmp_path):
    """White noise of sd s in n samples gives real and imaginary parts of an order the sd s sqrt(2/n).

    The median of 20 Rayleigh amplitudes is known to 15 %, the mean square of 6 units to 6 %: two of these.
    """
    found = noise_of(tmp_path, [2.0] * 6, range(6))
    assert found["order 040"] == pytest.approx(2.0 * np.sqrt(2 / 900), rel=0.12)


def test_the_noise_of_two_units_is_the_root_of_the_mean_square(tmp_path):
    """The second unit has the same random numbers, three times as large: sqrt((1 + 9)/2) of the first floor."""
    one, both = (noise_of(tmp_path, sizes, [5, 5])["order 080"] for sizes in ([1.0], [1.0, 3.0]))
    assert both == pytest.approx(np.sqrt(5) * one, rel=1e-9)


def test_a_line_knows_the_spread_of_its_value():
    """4000 lines through six samples: the mean of their variances is the variance of their values, to 6 %."""
    rng, torque = np.random.default_rng(0), np.array([-0.9, -0.5, 0.1, 0.3, 0.6, 0.8])
    found = np.array([_local("x", torque, 2 * torque + rng.standard_normal(6), 0.0, 1.0) for _ in range(4000)])
    assert np.mean(found[:, 1] ** 2) == pytest.approx(np.var(found[:, 0]), rel=0.06)


def test_load_opposes_the_motion():
    runs = [Conditions(torque=100.0, direction="backward"), Conditions(torque=100.0), Conditions(direction="backward")]
    conditions = study.load("rv-40e", solve=False).conditions
    own = bench.study_torque(conditions)
    assert bench.signed_torques(runs, conditions).tolist() == [-100.0, 100.0, -own] and own > 0


def test_an_index_mark_and_an_encoder_change_the_curve():
    """The curve is that of an angle less the mark's, plus c cos + s sin; its orders are sums over a turn."""
    question = study.load("rv-40e", solve=False)
    fields = ("crank_eccentricity", "phase", "mounting")
    model = bench.curve_model(
        "four_bar", question.design, question.conditions, [Conditions(torque=412.0)], (40, 80), fields[1:], fields
    )
    throw = np.array([[4.0, -2.0], [1.0, 3.0]]) * um
    mark, mounting = 0.01, np.array([3.0, -2.0]) * arcsec
    model = jax.jit(model)
    plain = model({"crank_eccentricity": throw, "phase": 0.0, "mounting": np.zeros(2)})
    found = model({"crank_eccentricity": throw, "phase": mark, "mounting": mounting})
    angle = np.arange(512) * 2 * np.pi / 512
    value = {order: complex(plain[bench.order_name(order)][0]) for order in (40, 80)}
    curve = sum(np.real(v * np.exp(1j * order * (angle - mark))) for order, v in value.items())
    curve += mounting[0] * np.cos(angle) + mounting[1] * np.sin(angle)
    for order in (1, 40, 80):
        due = 2 * np.mean(curve * np.exp(-1j * order * angle))
        assert complex(found[bench.order_name(order)][0]) == pytest.approx(due, abs=1e-9 * arcsec + 1e-12 * abs(due))
