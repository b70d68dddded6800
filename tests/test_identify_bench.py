"""Bench data for identification: sign of the error, orders of the models, phase of the curve, floor orders."""

import jax
import numpy as np
import pytest

import rvjax
from rvjax import catalogue, measured, study
from rvjax.commands.identify import in_words, rounded
from rvjax.commands.identify.words import SHOWN
from rvjax.identify.observation import Layout
from rvjax.measured import Conditions
from rvjax.study import bench, problem
from rvjax.study.identification import nuisance
from rvjax.units import arcsec, um

THROW = np.array([[4.0, -2.0], [1.0, 3.0]]) * um


@pytest.mark.long  # test_cli_identify.py finds the same combination
def test_one_direction_of_the_errors_of_a_four_bar_curve():
    """RV-40E: lambda = 4 (sigma / (4 R))^2 / noise^2 of e00 - e01 - e10 + e11, and nothing else but the offset.

    The closed form is of first order in e / R; the next order is smaller by sigma / R = 6e-5.
    """
    question = study.load("rv-40e")
    fields = {name: getattr(question.tolerances, name) for name in question.fields}
    fields["offset"] = nuisance("offset", (40,))
    orders = tuple(range(40, 321, 40))
    runs = [Conditions(torque=412.0)]
    model = bench.curve_model(
        "four_bar", question.design, question.conditions, runs, orders, ("offset",), tuple(fields)
    )
    seen = rvjax.identify.identifiability(model, fields, noise=rvjax.identify.Noise(arcsec), nuisance=("offset",))
    radius, sigma = question.design.cranks.circle_radius, question.tolerances.crank_eccentricity.half_width / 3
    offset, only = seen.directions
    assert offset.loadings["offset"] > 0.999
    assert only.information == pytest.approx(4 * (sigma / (4 * radius)) ** 2 / arcsec**2, rel=1e-3)
    assert only.information == pytest.approx(38.5, abs=0.1)
    throws = {name: size for name, size in only.loadings.items() if name.startswith("crank_eccentricity")}
    np.testing.assert_allclose(
        list(throws.values()), 0.5 * np.array([1, -1, -1, 1]) * np.sign(throws[min(throws)]), atol=1e-3
    )
    shown = {name: size for name, size in only.loadings.items() if abs(size) >= SHOWN * max(map(abs, throws.values()))}
    assert in_words(rounded(shown)) == "crank eccentricity [0,0] - [0,1] - [1,0] + [1,1]"


@pytest.mark.long  # the table of docs/identify_bench.md rests on it
def test_orders_of_the_output_agree_between_the_models():
    """Crank 0 and index mark at angle 0: the loaded reducer turns its own output, four_bar only its cranks.

    A throw comes out smaller by zc / (zp + z1 / z2), since the sun is held and not the disc (docs/models/loaded.md).
    """
    from benchmarks.bench_table import DESIGN

    conditions = rvjax.models.kind(DESIGN).conditions(rated_torque=412.0, samples=16, angles=16)
    design = DESIGN.replace(cranks=DESIGN.cranks.replace(bearing_stiffness=5e8))
    found = []
    for name in ("four_bar", "loaded"):
        model = bench.curve_model(
            name, design, conditions, [Conditions(torque=412.0)], (40, 41), (), ("crank_eccentricity",)
        )
        cells = jax.jit(jax.vmap(lambda e, model=model: model({"crank_eccentricity": e})))(np.stack([THROW, 0 * THROW]))
        assert np.all(np.asarray(cells["order 041"]) == 0)  # no pin differs: a turn of the cranks is like the next
        found.append(np.diff(np.asarray(cells["order 040"])[::-1, 0])[0])
    # Elastic parts turn it a little.
    factor, turned = abs(found[1] / found[0]), np.angle(found[1] / found[0])
    assert factor == pytest.approx(39 / (40 + 10 / 26), abs=2e-3) and abs(turned) < 0.02


def test_missing_index_mark_and_floor_orders():
    phase = nuisance("phase", (80, 120))
    assert (phase.lower, phase.upper) == pytest.approx((-np.pi / 40, np.pi / 40)) and phase.distribution == "uniform"
    beside = problem.floor_orders(catalogue.RV_40E, (40, 80))
    assert len(beside) == 20 and not {1, 39, 40, 41, 78, 79, 80, 81} & set(beside) and min(beside) > 4
    assert not [k for k in beside if min(k % 40, 40 - k % 40) <= 1 or min(k % 39, 39 - k % 39) <= 1]
    gears = catalogue.RV_40E.involute.replace(sun_teeth=13, planet_teeth=23)  # a ratio of 71.77, thrice 215.3
    uneven = problem.floor_orders(catalogue.RV_40E.replace(involute=gears), (216,))
    assert not {214, 215, 216} & set(uneven) and 217 in uneven
    run = measured.Run("a.csv", Conditions(), np.arange(0, 2 * np.pi, 1e-3), np.zeros(6284))
    assert measured.checked(run, 80).at.sign == 1


def test_a_curve_states_the_shapes_of_its_measurement():
    """A model that is not traced has the layout of the one that is."""
    question = study.load("rv-40e", solve=False)
    for asked in (("offset", "mounting"), ("phase",), ()):
        fields = {"disc_bore": question.tolerances.disc_bore} | {name: nuisance(name, (40, 80)) for name in asked}
        runs = [Conditions(torque=torque) for torque in (412.0, 200.0, 412.0)]
        model = bench.curve_model(
            "four_bar", question.design, question.conditions, runs, (40, 80), asked, tuple(fields)
        )
        values = {name: np.full(t.shape, float(t.middle)) for name, t in fields.items()}
        traced = jax.eval_shape(model, values)
        assert Layout.of(model.shapes(np.dtype(float))) == Layout.of(traced)
        assert {key: row.dtype for key, row in model.shapes(np.dtype(float)).items()} == {
            key: row.dtype for key, row in traced.items()
        }


@pytest.mark.parametrize(
    "measured", [(1, 4, 7), *(pytest.param(m, marks=pytest.mark.long) for m in ((0, 2, 3, 9), (5,)))]
)
def test_measured_frequencies_are_those_of_the_nearest_modes(measured):
    """Some modes of an RV-320E, measured 0.1 % too high: the model of the unit predicts these and no others."""
    observation = rvjax.models.kind(catalogue.RV_320E).observations("dynamics")["frequencies"]
    conditions = rvjax.models.kind(catalogue.RV_320E).conditions()
    frequency = np.asarray(rvjax.dynamics.modes(catalogue.RV_320E).frequency)
    modes = np.unique(frequency[frequency > 0].round(3))[list(measured)]
    found = bench.frequency_model(observation, catalogue.RV_320E, conditions, 1.001 * modes, {})
    np.testing.assert_allclose(found({})["frequency"], modes, rtol=1e-5)
