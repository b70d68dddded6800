"""Outputs of the whole reducer in studies.

Oracle: `loaded.equilibrium` angle by angle, whose forces the reference cases hold; `numpy.fft` for orders. The
reducer is that of the reference cases, on linear pins, whose programs are compiled anyway.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, newton_alone, plain, solve, supported

from rvjax import loaded, models
from rvjax.status import SolveInfo
from rvjax.study.response import Response

CASE = NAMED["rv40: all errors, rated, linear"]
DESIGN, ERRORS = plain((supported(design_of(CASE), 1e9), errors_of(CASE, design_of(CASE))))
RATED = 412.0
KIND = models.kind(DESIGN)
GIVEN = KIND.conditions(
    output_torque=RATED, second_torque=165.0, rated_torque=RATED, samples=24, probe_angles=3, input_angle=0.4, order=80,
    pin_contact="linear",
)  # fmt: skip


TURN = 2 * np.pi * DESIGN.ratio / 40
ALONG = TURN * np.arange(24) / 24
OWN = tuple(name for name in KIND.outputs if KIND.described[name].conditions is loaded.outputs.LoadedConditions)
ALL = tuple(name for name in OWN if KIND.costly((name,)))  # those that solve equilibria


BENCH = 0.4 + TURN * np.arange(3) / 3
SHARES = (1.0, 0.5, 0.03, -0.03, 1e-3, -1e-3)


BENCHES = ("backlash", "bench_lost_motion", "torsional_stiffness")  # programs of their own: the long profile


@newton_alone()
def ask(outputs):
    """Outputs of the reducer in a study, their status and their curve."""
    return Response.of(DESIGN, outputs, GIVEN).replace(curve="loaded_transmission_error" in outputs)(ERRORS)


def alone(angles, torque):
    """The equilibria at some input angles, every one for itself."""
    found = [solve(DESIGN, ERRORS, angle, torque, contact="linear") for angle in angles]
    return jax.tree.map(lambda *values: np.stack(values), *found)


def test_every_output_is_what_its_equilibria_show(thorough):
    """1e-9: Newton's end, 1e-13 of the largest force, times a condition of 1e3; at the probe torque, where play
    decides, 1e-6 (condition 1e7 of rounding, with a margin of ten)."""
    asked = ALL if thorough else tuple(name for name in ALL if name not in BENCHES)
    found = ask(asked)
    assert int(found.status) == 0
    values = {name: float(value) for name, value in found.value.items()}
    first, second, light = (alone(ALONG, torque) for torque in (RATED, 165.0, 1e-3 * RATED))
    twist, one = {s: alone(BENCH, s * RATED).error for s in SHARES}, alone(BENCH[:1], RATED)
    share = lambda loads: np.max(loads.shape[1] * np.abs(loads) / np.abs(loads.sum(1, keepdims=True)))  # noqa: E731
    due = {
        "loaded_transmission_error": np.ptp(first.error),
        "second_transmission_error": np.ptp(second.error),
        "mean_shift": second.error.mean() - first.error.mean(),
        "order_amplitude": np.abs(np.fft.fft(first.error))[2] * 2 / 24,  # order 80: twice in a crank turn
        "pin_force": first.pins.max(),
        "pin_pressure": one.pressure.max(),
        "turn_pin_pressure": first.pressure.max(),
        "arm_bearing_force": np.linalg.norm(first.disc_bearing, axis=-1).max(),
        "support_bearing_force": np.linalg.norm(first.support_bearing, axis=-1).max(),
        "crank_sharing": share(first.gear),
        "disc_sharing": share(first.disc_torque),
        "loaded_pins": (first.pins > 0).sum(axis=(1, 2)).min(),
        "bench_lost_motion": (twist[-0.03] - twist[0.03]).max(),
        "torsional_stiffness": (0.5 * RATED / (twist[0.5] - twist[1.0])).min(),
    }
    np.testing.assert_allclose(found.curve, first.error, rtol=1e-9)
    for name in due.keys() & values.keys():
        assert values[name] == pytest.approx(due[name], rel=1e-9), name
    loose = {"unloaded_transmission_error": np.ptp(light.error), "backlash": (twist[-1e-3] - twist[1e-3]).max()}
    for name in loose.keys() & values.keys():
        assert values[name] == pytest.approx(loose[name], rel=1e-6) and values[name] > 0, name
    assert set(due) | set(loose) == set(ALL) and values["mean_shift"] > 0 and 1 < values["disc_sharing"] < 2
    assert 2 < values["loaded_pins"] < 2 * 20  # half of the pins are on the side that carries


def test_outputs_of_a_bench_are_those_of_its_rotations(monkeypatch):
    """The worst of the input angles, of rotations that are told; the bench itself is that of `loaded.torsion`."""
    told = 1e-4 * np.random.default_rng(0).uniform([[3, -5], [1, -3]], [[5, -3], [3, -1]], (3, 2, 2))
    seen = []

    def twisted(layout, design, errors, angle, rated_torque, shares):
        seen.append((rated_torque, *shares))
        rotation = jnp.asarray(told[:, : len(shares)])[jnp.argmin(jnp.abs(BENCH - angle))]
        return rotation, SolveInfo(jnp.int32(0), jnp.int32(5), 0 * angle)

    monkeypatch.setattr(loaded.outputs, "twisted", twisted)
    found = ask(BENCHES).value
    assert set(seen) == {(RATED, 1e-3), (RATED, 0.03), (RATED, 1.0, 0.5)}
    play, secant = np.max(told[:, 0, 0] - told[:, 0, 1]), 0.5 * RATED / (told[:, 1, 1] - told[:, 0, 1])
    for name, due in zip(BENCHES, (play, play, np.min(secant))):
        assert float(found[name]) == pytest.approx(due, rel=1e-12), name


def test_outputs_of_the_same_equilibria_share_them(monkeypatch):
    """How often a question solves a turn, a bench and a single angle; its programs are those of the test above."""
    calls, names = [], ("revolution", "twisted", "equilibrium")
    homes = dict(zip(names, (loaded.observation, loaded.outputs, loaded.outputs)))

    def counted(name, real, *arguments, **options):
        calls.append(name)
        return real(*arguments, **options)

    def unmoved(layout, design, errors, angle, rated_torque, shares):
        return jnp.zeros((len(shares), 2)), SolveInfo(jnp.int32(0), jnp.int32(5), 0 * angle)

    for name, home in homes.items():
        monkeypatch.setattr(home, name, partial(counted, name, getattr(home, name)))

    def solved(*outputs):
        calls.clear()
        ask(outputs)
        return [calls.count(name) for name in names]

    assert solved("loaded_transmission_error", "pin_force", "order_amplitude", "disc_sharing") == [1, 0, 0]
    assert solved("loaded_transmission_error", "mean_shift", "second_transmission_error") == [2, 0, 0]
    monkeypatch.setattr(loaded.outputs, "twisted", partial(counted, "twisted", unmoved))
    assert solved("backlash", "bench_lost_motion") == [0, 2, 0] and solved(*ALL) == [3, 3, 1]


REFUSED = [
    (
        "order_amplitude",
        dict(order=480),
        "conditions.order = 480: beyond half of conditions.samples = 24 .* 25 at least",
    ),
    ("order_amplitude", dict(order=15), "conditions.order = 15: a crank turn shows multiples of 40 only"),
    ("order_amplitude", dict(order=12, span="output_turn"), "conditions.order = 12: beyond half .* 25 at least"),
    ("order_amplitude", dict(order=None), "conditions.order is missing: order_amplitude needs it"),
    ("torsional_stiffness", dict(rated_torque=0.0), "conditions.rated_torque = 0 N m: must be positive"),
    ("torsional_stiffness", dict(rated_torque=None), "conditions.rated_torque is missing"),
    ("backlash", dict(rated_torque=-1.0), "conditions.rated_torque = -1 N m: must be positive"),
    ("crank_sharing", dict(output_torque=0.0), "conditions.output_torque = 0 N m: without torque"),
    ("mean_shift", dict(second_torque=None), "conditions.second_torque is missing"),
    ("mean_shift", dict(second_torque=412.0), "conditions.second_torque = 412 N m: must differ from conditions.output"),
]


@pytest.mark.parametrize(("output", "changes", "words"), REFUSED)
def test_conditions_that_cannot_give_an_output_are_refused(output, changes, words):
    with pytest.raises(ValueError, match=words) as caught:
        Response.of(DESIGN, (output,), replace(GIVEN, **changes))
    assert "\n" not in str(caught.value)
    assert Response.of(DESIGN, ("order_amplitude",), replace(GIVEN, order=3, span="output_turn")).outputs
