"""Outputs of the whole reducer in studies.

Oracle: `loaded.equilibrium` angle by angle, whose forces the reference cases hold; `numpy.fft` for orders. The reducer is
small, so that its programs compile in seconds.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import CycloidStage, InvoluteStage, RVErrors, RVReducer, loaded, models
from rvjax.designs import Contact, CrankStage, Stiffness
from rvjax.study.response import Response
from rvjax.units import arcsec, mm, um

DESIGN = RVReducer(
    involute=InvoluteStage.from_teeth(12, 24, module=1 * mm, pressure_angle=0.35),
    cycloid=CycloidStage(9, 10, 2, 1.5 * mm, 40 * mm, 4 * mm),
    cranks=CrankStage(2, 18 * mm),
    stiffness=Stiffness(
        sun_support=4e7, sun_torsion=1e4, planet_crank_bending=2e8, planet_crank_torsion=5e4, support_bearing=9e8,
        turning_arm_bearing=6e8, sun_planet_mesh=2e8, disc_pin_mesh=6e8,
    ),
    contact=Contact(young_modulus=206e9, poisson_ratio=0.3, face_width=12 * mm),
)  # fmt: skip
KIND = models.kind(DESIGN)
GIVEN = KIND.conditions(
    output_torque=100.0, second_torque=40.0, rated_torque=100.0, samples=8, probe_angles=3, input_angle=0.4,
    order=20, pin_contact="linear",
)  # fmt: skip


def errors():
    random = np.random.default_rng(3)
    drawn = lambda *shape: 3 * um * random.normal(size=shape)  # noqa: E731
    return RVErrors.for_design(
        DESIGN, crank_eccentricity=drawn(2, 2), carrier_bore=drawn(2, 2), disc_bore=drawn(2, 2, 2),
        bearing_clearance=3 * um, pin_offset=drawn(10, 2), disc_centre=drawn(2, 2), equidistant_modification=2 * um,
        base_tangent_upper=-6 * um,
    )  # fmt: skip


TURN = 2 * np.pi * DESIGN.ratio / 10
ALONG = TURN * np.arange(8) / 8
ALL = tuple(name for name in KIND.outputs if KIND.described[name].conditions is loaded.outputs.Conditions)


BENCH = 0.4 + TURN * np.arange(3) / 3
SHARES = (1.0, 0.5, 0.03, -0.03, 1e-3, -1e-3)


def alone():
    """The equilibria of all outputs, every one for itself: (turns, bench, one) in one program."""
    cases = [(ALONG, torque) for torque in (100.0, 40.0, 0.1)]
    cases += [(BENCH, 100.0 * share) for share in SHARES] + [(BENCH[:1], 100.0)]
    angles, torques = np.hstack([np.broadcast_arrays(*case) for case in cases])
    solve = lambda angle, torque: loaded.equilibrium(  # noqa: E731
        DESIGN, errors(), input_angle=angle, output_torque=torque, contact="linear"
    )
    found = jax.tree.map(np.asarray, jax.jit(jax.vmap(solve))(angles, torques))
    assert not found.info.status.any()
    ends = np.cumsum([len(case[0]) for case in cases])
    parts = [jax.tree.map(lambda x, a=a, b=b: x[a:b], found) for a, b in zip([0, *ends], ends)]
    return parts[:3], dict(zip(SHARES, (part.error for part in parts[3:9]))), parts[9]


def test_every_output_is_what_its_equilibria_show():
    """1e-9: Newton's end, 1e-13 of the largest force, times a condition of 1e3; at the probe torque, where play
    decides, 1e-6 (condition 1e7 of rounding, with a margin of ten)."""
    found = Response.of(DESIGN, ALL, GIVEN)(errors())
    assert int(found.status) == 0
    values = {name: float(value) for name, value in found.value.items()}
    (first, second, light), twist, one = alone()
    share = lambda loads: np.max(loads.shape[1] * np.abs(loads) / np.abs(loads.sum(1, keepdims=True)))  # noqa: E731
    due = {
        "loaded_transmission_error": np.ptp(first.error),
        "second_transmission_error": np.ptp(second.error),
        "mean_shift": second.error.mean() - first.error.mean(),
        "order_amplitude": np.abs(np.fft.fft(first.error))[2] * 2 / 8,  # order 20: twice in a crank turn of ten pins
        "pin_force": first.pins.max(),
        "pin_pressure": one.pressure.max(),
        "turn_pin_pressure": first.pressure.max(),
        "arm_bearing_force": np.linalg.norm(first.disc_bearing, axis=-1).max(),
        "support_bearing_force": np.linalg.norm(first.support_bearing, axis=-1).max(),
        "crank_sharing": share(first.gear),
        "disc_sharing": share(first.disc_torque),
        "bench_lost_motion": (twist[-0.03] - twist[0.03]).max(),
        "torsional_stiffness": (0.5 * 100.0 / (twist[0.5] - twist[1.0])).min(),
    }
    for name, value in due.items():
        assert values[name] == pytest.approx(value, rel=1e-9), name
    loose = {"unloaded_transmission_error": np.ptp(light.error), "backlash": (twist[-1e-3] - twist[1e-3]).max()}
    for name, value in loose.items():
        assert values[name] == pytest.approx(value, rel=1e-6), name
    assert set(due) | set(loose) == set(ALL)
    assert values["mean_shift"] > 0 and 1 < values["disc_sharing"] < 2 and values["backlash"] > 1 * arcsec


def solved(*outputs):
    """How often a question of these outputs solves a turn, a bench and a single angle: calls in its traced program."""
    program = jax.make_jaxpr(Response.of(DESIGN, outputs, GIVEN))(errors())
    names = [equation.params.get("name") for equation in program.jaxpr.eqns]
    return [names.count(name) for name in ("_revolution", "twisted", "_equilibrium")]


def test_outputs_of_the_same_equilibria_share_them():
    assert solved("loaded_transmission_error", "pin_force", "order_amplitude", "disc_sharing") == [1, 0, 0]
    assert solved("loaded_transmission_error", "mean_shift", "second_transmission_error") == [2, 0, 0]
    assert solved("backlash", "bench_lost_motion") == [0, 2, 0] and solved(*ALL) == [3, 3, 1]


REFUSED = [
    ("order_amplitude", dict(order=40), "conditions.order = 40: beyond half of conditions.samples = 8 .* 9 at least"),
    ("order_amplitude", dict(order=15), "conditions.order = 15: a crank turn shows multiples of 10 only"),
    ("order_amplitude", dict(order=4, span="output_turn"), "conditions.order = 4: beyond half .* 9 at least"),
    ("order_amplitude", dict(order=None), "conditions.order is missing: order_amplitude needs it"),
    ("torsional_stiffness", dict(rated_torque=0.0), "conditions.rated_torque = 0 N m: must be positive"),
    ("torsional_stiffness", dict(rated_torque=None), "conditions.rated_torque is missing"),
    ("backlash", dict(rated_torque=-1.0), "conditions.rated_torque = -1 N m: must be positive"),
    ("crank_sharing", dict(output_torque=0.0), "conditions.output_torque = 0 N m: without torque"),
    ("mean_shift", dict(second_torque=None), "conditions.second_torque is missing"),
]


@pytest.mark.parametrize(("output", "changes", "words"), REFUSED)
def test_conditions_that_cannot_give_an_output_are_refused(output, changes, words):
    with pytest.raises(ValueError, match=words) as caught:
        Response.of(DESIGN, (output,), replace(GIVEN, **changes))
    assert "\n" not in str(caught.value)
    assert Response.of(DESIGN, ("order_amplitude",), replace(GIVEN, order=3, span="output_turn")).outputs
