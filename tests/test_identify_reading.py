"""The nuisance "reading": what one encoder head adds is never an error of a part. Data: `loaded.reading` itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_turns import PINS, TURN, found_over_a_turn, orders_read, sprung

from rvjax import catalogue, identify, loaded, models
from rvjax.loaded import observation
from rvjax.measured import Conditions
from rvjax.published.rv160 import ENCODER, NONE, READ
from rvjax.status import at_once
from rvjax.study import bench
from rvjax.study.identification import NUISANCES, nuisance, part_orders
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec, um

GIVEN = models.kind(READ).conditions(rated_torque=1600.0, samples=16)
RUNS = [Conditions(torque=torque, direction=way) for torque in (500.0, 1200.0) for way in ("forward", "backward")]
TORQUES = bench.signed_torques(RUNS, GIVEN)
ORDERS = (3, 39, 40, 78)
THROW = np.array([[2.0, -1.0, 0.5], [1.5, 0.0, -2.5]]) * um
NAMES = [bench.order_name(order) for order in ORDERS]


WAVES = {40: 4.0j, 80: 1.0 + 0.5j}  # arcsec of the error at 1000 N m, by order: throws make multiples of 40


def told_error(torque, angle):
    turned = {order: order * angle / READ.ratio for order in WAVES}
    return (
        torque
        / 1000.0
        * sum(arcsec * (wave.real * jnp.cos(turned[k]) - wave.imag * jnp.sin(turned[k])) for k, wave in WAVES.items())
    )


def told(design, errors, *, input_angle, output_torque, **_):
    """Half of the pins of each disc carry, by the sine of their place from its eccentric."""
    place = jnp.asarray(PINS)[None] + 39 * input_angle / READ.ratio - jnp.pi * jnp.arange(2.0)[:, None]
    pins = jnp.maximum(output_torque * jnp.sin(place), 0) / 0.6
    error = told_error(output_torque, input_angle)
    nothing = jnp.zeros(())
    return loaded.Loaded(error, pins, *[nothing] * 7, at_once(nothing))


@pytest.fixture(params=["told", pytest.param("equilibria", marks=pytest.mark.long)])
def law(request, monkeypatch):
    """What the loaded model answers: forces and errors of a formula, or those of its equilibria."""
    if request.param == "told":
        monkeypatch.setattr(observation, "_errors", lambda *_: told_error(_[-2][:, None], _[-1][None]))
        monkeypatch.setattr(observation, "equilibrium", told)
        effects = observation._effects.__wrapped__  # wrapped: no program of the formula is kept for others
        monkeypatch.setattr(observation, "_effects", jax.jit(lambda *given: effects(*given), static_argnums=(3, 4, 5)))
    return request.param


@pytest.fixture
def measured(law):
    """Orders of a unit, read by a head at 0.7 rad; {name: (runs,) complex}. Real ones have unequal throws."""
    errors, encoder = NONE.replace(crank_eccentricity=THROW), ENCODER.replace(heads=(0.7,))

    def turn(torque):
        if law == "equilibria":
            return found_over_a_turn(sprung(), torque, errors=errors)
        return jax.vmap(lambda angle: told(READ, errors, input_angle=angle, output_torque=torque))(TURN * READ.ratio)

    waves = [orders_read(turn(torque), encoder, torque) for torque in TORQUES]
    return dict(zip(NAMES, np.stack(waves)[:, ORDERS].T))


def model(nuisances):
    return bench.curve_model("loaded", READ, GIVEN, RUNS, ORDERS, nuisances, ("crank_eccentricity",))


def test_six_numbers_make_every_run(law, measured):
    """Linear in them, in both directions and at both torques: exactly where the forces are those of equal throws,
    else to 1 % of the largest."""
    close = 1e-9 if law == "told" else 0.02
    made = model(("reading",))
    batch = jax.vmap(lambda numbers: made({"crank_eccentricity": THROW, "reading": numbers}))  # equilibria once for all
    seen = jax.device_get(jax.jit(batch)(np.eye(7)[:, :6]))
    found = np.stack([seen[name] for name in NAMES], axis=1)
    without, slopes = found[6], np.moveaxis(found[:6] - found[6], 0, -1)
    due = np.stack([measured[name] for name in NAMES])
    assert np.abs(due - without)[[1, 3]].max() > 2 * arcsec  # orders 39 and 78
    rows, right = slopes.reshape(-1, 6), (due - without).ravel()
    real = lambda x: np.concatenate([x.real, x.imag])  # noqa: E731
    best = np.linalg.lstsq(real(rows), real(right), rcond=None)[0]
    assert np.abs(rows @ best - right).max() < close * np.abs(right).max()
    ring, tilt = best[0] + 1j * best[1], best[2] + 1j * best[3]
    assert abs(np.angle(ring * np.exp(-2j * 0.7))) < close and abs(np.angle(tilt * np.exp(-0.7j))) < close


@pytest.mark.long  # three programs with derivatives of the whole reducer: a minute
@pytest.mark.parametrize("law", ["equilibria"], indirect=True)
def test_a_reading_is_no_error_of_a_part(measured):
    """Without the nuisance the model check refuses the curves; with it the throws are those of the unit."""
    prior = {"crank_eccentricity": Tolerance.symmetric(6 * um, shape=(2, 3))}
    asked = dict(noise=identify.Noise(0.1 * arcsec), starts=2)
    rejected = identify.solve(model(()), prior, measured, **asked)
    assert rejected.status == "REJECTED" and not rejected.adequate
    wide = prior | {"reading": nuisance("reading", ORDERS)}
    found = identify.solve(model(("reading",)), wide, measured, nuisance="reading", **asked)
    assert found.adequate and found.status == "CONVERGED"
    alone = {name: value if name == NAMES[2] else 0 * value for name, value in measured.items()}  # order 40
    due = identify.solve(model(()), prior, alone, **asked)
    np.testing.assert_allclose(
        found.value["crank_eccentricity"], due.value["crank_eccentricity"], atol=0.02 * um
    )  # fmt: skip


def test_orders_of_parts_alone():
    """Three cranks and 39 teeth: the housing makes multiples of three only; two cranks and 39 teeth: every order."""
    by_rule = {order for m in range(120) for order in loaded.housing_orders(READ, m)}
    assert set(part_orders(READ, range(241))) == set(range(241)) - by_rule
    assert part_orders(READ, (39, 40, 78, 80)) == (40, 80)
    assert part_orders(catalogue.RV_40E, (39, 40, 78, 80)) == ()


def test_only_the_loaded_model_has_a_reading():
    prior = nuisance("reading", ORDERS)
    assert prior.shape == (6,) and prior.upper == pytest.approx(3000 * arcsec)
    assert "reading" in NUISANCES
    plain = bench.curve_model("four_bar", READ, GIVEN, RUNS, (40,), (), ())
    assert plain.reading is None
