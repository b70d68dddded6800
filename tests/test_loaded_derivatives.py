"""Derivatives of the loaded equilibrium against differences of the plain value.

Central differences of fourth order. Their rounding is 1e-13 of a value over the step, their truncation the fourth power
of a step that is 1e-4 of what is stepped; a contact that changes sides within a step spoils more: 1e-5 relative to the
larger, beside what rounding leaves.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, by_newton, design_of, errors_of, plain

from rvjax import Status

CASE = NAMED["rv40: all errors, rated, hertz"]
SUPPORT = dict(pin_support=np.linspace(1e8, 2e8, 40))
DESIGN = design_of(CASE).replace(contact=design_of(CASE).contact.replace(**SUPPORT))
DESIGN, ERRORS = plain((DESIGN, errors_of(CASE, DESIGN)))
START = (DESIGN, ERRORS, 412.0, 576.525)
CLEARANCES = ("bearing_clearance", "support_clearance", "pin_hole_clearance")
UNREAD = ("module", "centre_distance", "sun_radius", "disc_phase", "output_torsion", "pin_position", "disc_runout")


def shown(r):
    parts = (1e4 * r.error, r.input_torque, r.stiffness / 1e6, (r.pressure**2).sum() / 1e19, r.pins[0, 25] / 1e3)
    return (*parts, r.disc_bearing[0, 1, 0] / 1e3, r.support_bearing[1, 0] / 1e3, r.disc_torque[1] / 1e2)


def traced(inputs):
    design, errors, torque, angle = inputs
    found = by_newton(design, errors, angle, torque)
    return jnp.stack(shown(found)), found.info.status


@jax.jit
def forward(inputs, tangent):
    return jax.jvp(lambda inputs: traced(inputs)[0], (inputs,), (tangent,))[1]


@jax.jit
def evaluated(inputs, weights):
    """Plain values, (8,), the status, and the slopes of their weighted sum, by one program."""
    values, pull, status = jax.vjp(traced, inputs, has_aux=True)
    return values, status, pull(weights)[0]


def backward(inputs, weights):
    return evaluated(inputs, weights)[2]


def fields():
    paths = jax.tree_util.tree_leaves_with_path(START)
    return [(number, path[-1].name if len(path) > 1 else "condition") for number, (path, _) in enumerate(paths)]


def along(number, direction, size):
    leaves, tree = jax.tree.flatten(START)
    leaves[number] = leaves[number] + size * direction
    return jax.tree.unflatten(tree, leaves)


def test_derivatives_to_every_input_agree_with_differences():
    """By reverse mode, one output at a time."""
    random = np.random.default_rng(0)
    gradients = [jax.tree.leaves(backward(START, row)) for row in np.eye(8)]
    outputs = lambda case: np.asarray(evaluated(plain(case), np.ones(8))[0])  # noqa: E731
    value, moves = outputs(START), []
    for number, name in fields():
        leaf = jax.tree.leaves(START)[number]
        direction = random.standard_normal(np.shape(leaf))
        slope = np.array([np.vdot(gradient[number], direction) for gradient in gradients])
        if name in UNREAD:
            assert all(np.all(np.asarray(gradient[number]) == 0) for gradient in gradients), name
            continue
        in_design = number < len(jax.tree.leaves(START[0]))
        step = 1e-5 * float(np.max(np.abs(leaf))) if in_design or name == "condition" else 1e-9
        step = max(step, 1e-9) if name != "crank_phase" else 1e-7
        moves.append((name, slope, step, [along(number, direction, s * step) for s in (-2, -1, 1, 2)]))
    for name, slope, step, cases in moves:
        far_left, left, right, far_right = map(outputs, cases)
        expected = (8 * (right - left) - (far_right - far_left)) / (12 * step)
        noise = 1e-12 * np.abs(value) / step
        bound = 1e-5 * np.maximum(np.abs(slope), np.max(np.abs(slope)) * 1e-3) + 10 * noise
        assert np.all(np.abs(expected - slope) <= bound), (name, slope, expected)


def test_slopes_without_clearance_are_those_of_clearance():
    """Clearances are at least 0, and a lesser number counts as 0: the slope at 0 is not the mean of both sides."""

    def slopes(x):
        loose = ERRORS.replace(**{name: np.asarray(x) for name in CLEARANCES})
        found = backward((DESIGN, loose, *START[2:]), np.eye(8)[0])[1]
        return np.array([getattr(found, name) for name in CLEARANCES])

    np.testing.assert_allclose(slopes(0.0), slopes(1e-12), rtol=1e-5)
    assert np.all(slopes(0.0) != 0)


@pytest.mark.long  # forward mode is what reverse mode transposes
def test_reverse_derivatives_are_the_transpose():
    random = np.random.default_rng(1)
    tangent = jax.tree.map(lambda x: random.standard_normal(np.shape(x)) * (1e-9 + 1e-3 * np.max(np.abs(x))), START)
    weights = random.standard_normal(8)
    pulled = backward(START, weights)
    one = sum(np.vdot(a, b) for a, b in zip(jax.tree.leaves(pulled), jax.tree.leaves(tangent)))
    np.testing.assert_allclose(one, weights @ forward(START, tangent), rtol=1e-9)


def assert_finite(inputs):
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(backward(plain(inputs), np.ones(8))))


def test_derivatives_of_failed_and_idle_cases_are_finite():
    """NaN among the errors: its lane has derivative zero. No errors and no torque: finite."""
    for torque, radius in ((412.0, np.nan), (412.0, 0.02), (0.0, 0.0)):
        spoilt = jax.tree.map(lambda leaf: 0.0 * leaf, ERRORS).replace(pin_radius=radius)
        assert_finite((DESIGN, spoilt, torque, START[3]))


def test_numbers_that_leave_the_arithmetic_are_a_status_and_spoil_no_gradient():
    """Squares of 1e300 m overflow, those of 1e-300 m vanish; angles beyond 2^50 rad have no direction."""

    def changed(name, x):  # as a sampler makes it: no constructor judged
        def number(path, leaf):
            return x if path[-1].name == name else leaf

        return (jax.tree_util.tree_map_with_path(number, DESIGN), *START[1:])

    names = ("circle_radius", "face_width", "pin_radius")
    cases = [changed(name, x) for name in names for x in (1e300, 1e-300)]
    cases.append((*START[:3], 1e30))
    for case in cases:
        values, status, _ = evaluated(plain(case), np.ones(8))
        assert status == Status.NONFINITE and np.isnan(values[0])
        assert_finite(case)


def test_a_flank_whose_curvature_has_no_slope_spoils_no_gradient():
    """K1 within 1e-9 of 1: the sharpest point is nearly a cusp, which judges undercut and is no part of the answer."""
    cycloid = DESIGN.cycloid
    missing = (1 - 1e-9) * cycloid.pin_circle_radius / cycloid.pin_count - cycloid.eccentricity
    assert_finite((DESIGN, ERRORS.replace(eccentricity=missing), *START[2:]))
