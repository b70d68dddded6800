"""Every output of every model: its gradient to every error against differences of the plain value.

The oracle is the value function alone, compiled by itself: a rule of a derivative that computes its own value, wrong
alike, is seen. Second derivatives, to the numbers of the design too, are compared with differences of the first ones.
Each field of the errors is moved along a random direction of the size at which parts deviate, by a share h of it, to
both sides and by twice as much. Differences of fourth order leave less than they differ by from those of second order,
and the rounding of a value over h: values are good to 1e-12, for they grow from errors without cancellation or are
solved to that. h is 1e-3, and 1e-4 where forty contacts may open within a step. Where the two sides differ, at a kink,
the gradient lies between them. The same program tells what NaN and infinity in a field do: a status, or nothing at all.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, design_of

from rvjax import CrankStage, Damping, Friction, models
from rvjax.catalogue import CORR, CYCLOIDAL_17, RV_40E, RV_320E
from rvjax.geometry.outputs import of_design
from rvjax.status import succeeded
from rvjax.study.response import Response
from rvjax.units import rpm

ROUNDING, CLOSE = 1e-12, 1e-6
SERIES = dict.fromkeys(("sun_orders", "planet_orders", "disc_orders", "ring_orders"), 2)  # series bring their own
SIZES = {"m": 2e-6, "rad": 1e-4, "-": 2e-2}
PLAY = {"pin_circle_radius": 8e-6, "pin_radius": -8e-6}  # the disc fits between the pins
WHOLE = design_of(NAMED["rv40: all errors, rated, hertz"]).replace(  # what all models of an RV reducer read
    cranks=CrankStage(2, 0.036, 6e8),
    inertia=RV_320E.inertia,
    mesh_variation=RV_320E.mesh_variation,
    damping=Damping(modal_ratio=0.02),
)
RUN = dict(
    output_torque=412.0,
    rated_torque=412.0,
    angles=16,
    samples=4,
    sun_speed=1500 * rpm,
    slowest_sun_speed=1400 * rpm,
    fastest_sun_speed=1600 * rpm,
)
LOADED = ("loaded_transmission_error", "pin_force")
BENCH = ("pin_pressure", "backlash", "bench_lost_motion", "torsional_stiffness")
TURN = ("second_transmission_error", "unloaded_transmission_error", "mean_shift", "order_amplitude")
TURN += ("turn_pin_pressure", "arm_bearing_force", "support_bearing_force", "crank_sharing", "disc_sharing")
LIFE = ("life", "arm_bearing_life", "static_safety", "rated_torque")
RATED = dict(duty=((412.0, 1.5, 1.0),), rated_life=2e7, rated_speed=1.5)
SPINNING = ("static_transmission_error", "dynamic_transmission_error", "dynamic_vibration")
FRICTION = Friction(0.05, None, 0.002, 0.0015, 0.01, input_drag=0.05, output_drag=8.0, static_factor=1.2)
RUNNING = ("efficiency", "backward_efficiency", "starting_torque", "no_load_torque", "power_loss")
STANDING = ("back_driving_torque", "hysteresis")
SLIDING = WHOLE.replace(bearings=RV_40E.bearings, friction=FRICTION)
CASES = {  # design, outputs, conditions
    "four bar": (WHOLE, ("transmission_error",), RUN),
    "four bar, misfit": (WHOLE, ("misfit",), RUN),
    "four bar, curve": (WHOLE, ("transmission_error",), RUN | dict(closure="newton")),
    "lost motion": (WHOLE, ("lost_motion",), RUN),
    "lost motion, contact": (WHOLE, ("lost_motion",), RUN | dict(lost_motion_profile="contact")),
    "dynamics": (WHOLE, ("vibration", "resonance_margin"), RUN),
    "balance": (WHOLE, ("vibration",), RUN | dict(method="harmonic_balance", harmonics=3)),
    "mesh force": (CORR.replace(gear_teeth=3), ("cam_force", "contact_pressure"), dict(input_torque=110.0, angles=2)),
    "loaded": (WHOLE, LOADED, RUN),
    "clearance": (WHOLE, ("flank_clearance",), RUN),
    "bench": (WHOLE, BENCH, RUN),
    "turn": (WHOLE, TURN, RUN | dict(second_torque=200.0, order=40)),
    "life": (WHOLE.replace(bearings=RV_40E.bearings), LIFE, RUN | RATED),
    "turn and life": (WHOLE.replace(bearings=RV_40E.bearings), ("loaded_transmission_error", "life"), RUN | RATED),
    "running": (SLIDING, RUNNING, RUN | dict(output_speed=1.5, running_samples=3)),
    "standing": (SLIDING, STANDING, RUN | dict(probe_angles=1, running_samples=3)),
    "speed": (WHOLE, SPINNING, RUN | dict(load_inertia=10.0, speeds=4)),
}
# These compile long; a quicker way through most of the same model runs by default.
FORTY = ("loaded", "bench", "turn", "life", "turn and life", "running", "standing", "speed")  # contacts may open
LONG = ("four bar, misfit", "four bar, curve", "lost motion, contact", "dynamics", "balance", *FORTY)
WAVED = WHOLE.replace(cycloid=WHOLE.cycloid.replace(profile_modification=np.array([1e-6, 2e-6, -1e-6, 1.5e-6])))
CROSSING = dict(load_inertia=10.0, speeds=4, slowest_sun_speed=20.0, fastest_sun_speed=400.0)  # of an order and a mode
FIGURES = ("convex_radius", "flank_slope", "contact_ratio", "envelope_volume", "nominal_pin_pressure", "mass")
OF_A_DRIVE = ("convex_radius", "nominal_pin_pressure", "nominal_hole_pressure", "hole_wall", "eccentric_force")
DRIVEN = ("hole_pressure", "backlash", "torsional_stiffness", "fit_clearance", "loaded_transmission_error")
OF_DESIGNS = CASES | {  # read no error, or those of another kind
    "figures": (WAVED, FIGURES, dict(output_torque=412.0)),
    "figures of a drive": (CYCLOIDAL_17, OF_A_DRIVE, dict(output_torque=8.8)),
    "speed": (WHOLE, SPINNING, RUN | CROSSING),
    "drive": (CYCLOIDAL_17, DRIVEN, dict(output_torque=8.8, rated_torque=8.8, samples=4, probe_angles=2)),
}
LONG += ("drive",)
# Rollers and the clearance of the flanks have gradients against differences in files of their own.
LONG += ("mesh force", "clearance")
SECOND = (*LONG, "four bar", "figures")  # the linkage alone, test_four_bar_derivatives.py, and figures of a drive


def test_no_output_is_left_out():
    for kind in (models.kind(WHOLE), models.kind(CORR)):
        for name, output in kind.outputs.items():
            if getattr(output.evaluate, "sources", ()) == (of_design,):
                continue  # reads no error; its derivatives to the design are those of test_geometry
            if name == "loaded_pins":
                continue  # a count: no error has a slope
            assert any(name in outputs for _, outputs, _ in CASES.values()), name


def drawn(design, random):
    """Errors of a random unit, for each field a move along a random direction, and the names of the fields."""
    blank = design.error_record()
    errors, moves, names = {}, {}, [f.name for f in dataclasses.fields(blank)]
    for number, f in enumerate(dataclasses.fields(blank)):
        size, shape = SIZES[f.metadata["unit"]], tuple((design.counts | SERIES).get(n, n) for n in f.metadata["shape"])
        errors[f.name] = size * random.standard_normal(shape) + PLAY.get(f.name, 0.0)
        if f.metadata["sign"] == "nonnegative":
            errors[f.name] = np.abs(errors[f.name])
        moves[f.name] = np.zeros((len(names), *shape))
        moves[f.name][number] = size * random.standard_normal(shape)
    tree = jax.tree.structure(blank)
    order = [path[0].name for path, _ in jax.tree_util.tree_leaves_with_path(blank)]
    return (*(tree.unflatten([np.asarray(v[n]) for n in order]) for v in (errors, moves)), names)


def quick_first(cases, long):
    return pytest.mark.parametrize("case", [pytest.param(c, marks=pytest.mark.long) if c in long else c for c in cases])


@quick_first(CASES, LONG)
def test_gradients_are_slopes_of_the_plain_value(case):
    design, outputs, given = CASES[case]
    h = 1e-4 if case in FORTY else 1e-3
    response = Response.of(design, outputs, models.kind(design).conditions(**given))

    def values(errors):
        found = response(errors)
        return jnp.stack([found.value[name] for name in outputs]), found.status

    def with_value(errors):
        value, _ = values(errors)
        return value, value

    errors, moves, names = drawn(design, np.random.default_rng(12))
    along = np.repeat([-2, -1, 0, 1, 2], len(names)) * h

    def laid_out(x, d):  # five places along each field, then each field with numbers that are none
        lost = [np.where(d != 0, no_number, x) for no_number in (np.nan, np.inf)]
        return np.concatenate([x + along.reshape(-1, *(1,) * x.ndim) * np.concatenate([d] * 5), *lost])

    every = jax.jit(lambda units: jax.lax.map(values, units))  # one after the other: traced once, not batched too
    plain, status = map(np.asarray, every(jax.tree.map(laid_out, errors, moves)))
    plain, lost = (part.reshape(-1, len(names), len(outputs)) for part in np.split(plain, [5 * len(names)]))
    good = np.asarray(succeeded(status))
    assert np.isfinite(plain).all() and good[: 5 * len(names)].all()
    # A number that is none has a status, or nobody reads it.
    good = good[5 * len(names) :].reshape(2, len(names))
    assert np.array_equal(good, (lost == plain[2]).all(axis=2)), [names[f] for _, f in np.argwhere(good)]
    assert np.isnan(lost[~good]).any(axis=1).all()
    unread = [name for name, read in zip(names, ~good.all(axis=0)) if not read]
    slopes = jax.jit(jax.jacrev(with_value, has_aux=True))
    gradient, value = jax.tree.map(np.asarray, slopes(errors))
    np.testing.assert_allclose(value, plain[2, 0], rtol=10 * ROUNDING)
    assert all(np.all(np.asarray(getattr(gradient, name)) == 0) for name in unread)
    signed = [f.name for f in dataclasses.fields(errors) if f.metadata["sign"] == "nonnegative"]
    there = (errors.replace(**{name: np.full_like(getattr(errors, name), x) for name in signed}) for x in (0.0, 1e-12))
    at_bound, inside = (slopes(jax.tree.map(np.asarray, unit))[0] for unit in there)  # types as above: one program
    for name in signed:  # the slope of the side that a sign admits
        one, other = (np.asarray(getattr(found, name)) for found in (at_bound, inside))
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-9 * np.max(np.abs(other), initial=0), err_msg=name)
    slope = sum(
        np.reshape(d, (len(names), -1)) @ np.reshape(g, (len(outputs), -1)).T
        for g, d in zip(jax.tree.leaves(gradient), jax.tree.leaves(moves))
    )
    far_left, left, middle, right, far_right = plain
    central = (8 * (right - left) - (far_right - far_left)) / (12 * h)
    sides = np.sort([4 * right - far_right - 3 * middle, 3 * middle - 4 * left + far_left], axis=0) / (2 * h)
    largest = np.abs(slope).max(0)
    left_over = np.abs(central - (right - left) / (2 * h))
    bound = CLOSE * np.abs(slope) + left_over + ROUNDING / h * np.abs(middle)
    kink = sides[1] - sides[0] > 1e-3 * largest
    outside = (slope < sides[0] - 1e-2 * largest) | (slope > sides[1] + 1e-2 * largest)
    wrong = np.where(kink, outside, np.abs(slope - central) > bound)
    worst = [(names[f], outputs[o], slope[f, o], central[f, o], bound[f, o]) for f, o in np.argwhere(wrong)]
    assert not worst, worst
    assert kink.mean() < 0.02 and (bound < 1e-4 * largest).mean() > 0.9
    assert (np.abs(central) > bound).any(axis=0).all()  # every output depends on something


@quick_first(OF_DESIGNS, SECOND)
def test_second_derivatives_are_slopes_of_the_first(case):
    """Of each field of the design and of the errors, with a direction in which all move at once.

    A place that is found without derivatives, as that of a largest value, shows here and not in the first ones.
    """
    design, outputs, given = OF_DESIGNS[case]
    conditions, random, h = models.kind(design).conditions(**given), np.random.default_rng(12), 1e-3
    errors, moves, _ = drawn(design, random)
    sizes = jax.tree.map(lambda x: 1e-3 * np.abs(x) * random.standard_normal(np.shape(x)), design)
    numbers, tree = jax.tree.flatten((design, errors))
    moves = jax.tree.leaves((sizes, jax.tree.map(lambda move: move.sum(axis=0), moves)))

    def value(numbers):
        design, errors = jax.tree.unflatten(tree, numbers)
        found = Response.of(design, outputs, conditions)(errors).value
        return jnp.stack([found[name] for name in outputs])

    def along(numbers):
        return jax.jvp(value, (numbers,), (moves,))[1]

    def both(given):
        place, field = given
        own = [share * move for share, move in zip(field, moves)]
        return jax.jvp(along, ([x + place * move for x, move in zip(numbers, own)],), (own,))

    fields = np.flatnonzero([np.any(move) for move in moves])
    units = np.tile(np.eye(len(moves))[fields], (5, 1))
    first, second = jax.jit(lambda x: jax.lax.map(both, x))((np.repeat([-2, -1, 0, 1, 2], len(fields)) * h, units))
    far_left, left, at, right, far_right = np.asarray(first).reshape(5, len(fields), -1)
    found = np.asarray(second).reshape(5, len(fields), -1)[2]
    due, rough = (8 * (right - left) - (far_right - far_left)) / (12 * h), (right - left) / (2 * h)
    bound = 1e-4 * np.abs(found).max(axis=0) + 3 * np.abs(due - rough) + 1e-12 / h * np.abs(at)
    names = [jax.tree_util.keystr(path) for path, _ in jax.tree.leaves_with_path((design, errors))]
    wrong = np.argwhere(~(np.abs(found - due) <= bound))
    assert not len(wrong), [(names[fields[f]], outputs[o], found[f, o], due[f, o]) for f, o in wrong]
