"""One four-bar linkage: derivatives.

Oracles: closed-form sensitivities at zero error (1e-12, float derivations by hand); finite differences (steps of 1e-3
of the deviation, so 1e-6 relative); the Newton and the closed form of the same linkage against each other.
"""

import jax
import numpy as np
import pytest
from four_bar_cases import METHODS, MM, SPACING, E, at, batch, columns, one, padded, random_linkages, slopes, solver

from rvjax import LinkDeviations, Status


def sensitivities(cranks, angle):
    """Closed-form derivatives of b2 at zero error, in the order of the deviations; float derivations by hand."""
    sine, cosine, one_ = np.sin(angle), np.cos(angle), np.ones_like(angle)
    if cranks == "free":
        cot = cosine / sine
        rows = [-1 / sine, -cot, 1 / sine, cot, 0 * one_, SPACING * one_, cot, one_]
    else:
        rows = [-sine, 0 * one_, sine, 0 * one_, E * cosine, SPACING * one_, 0 * one_, one_]
    return np.array(rows) / SPACING


# Values of the other methods have the same references; their derivatives have no rules of their own.
RULES = [("free", "newton", "open"), ("phase_locked", "newton", "open"), ("geared", "newton", "open")]


def others_long(methods):
    return [pytest.param(m, marks=[] if m in RULES else [pytest.mark.long]) for m in methods]


@pytest.mark.parametrize("methods", others_long(m for m in METHODS if m[2] == "open" and m[0] != "geared"))
def test_sensitivities_at_zero_error(methods, reference):
    angle = np.deg2rad(np.array([90, 30, 60, 137, 211, 300.0]))
    zeros = batch(*np.zeros((8, 6)))
    _, _, found = slopes(methods)((np.full(6, E), np.full(6, SPACING), zeros), angle, np.ones(6))
    np.testing.assert_allclose(columns(found), sensitivities(methods[0], angle), rtol=1e-12, atol=1e-11)
    printed = reference("four_bar")["sensitivities"]
    key = "free_open_exact" if methods[0] == "free" else "locked"
    order = ["crank_1", "coupler", "crank_3", "frame", "crank_phase", "frame_angle", "joint_x", "joint_y"]
    for i, case in enumerate(printed):
        per = [case[key].get(f"{name}_per_mm", case[key].get(f"{name}_per_rad")) for name in order]
        scale = [1 if name in ("crank_phase", "frame_angle") else 1e3 for name in order]
        np.testing.assert_allclose(np.array(columns(found))[:, i], np.multiply(per, scale), rtol=1e-10, atol=1e-11)


def test_locked_zero_error_is_finite_everywhere(thorough):
    angle = np.concatenate([np.deg2rad(np.arange(0, 361, 15.0)), [0, np.pi, 2 * np.pi]])
    for methods in (m for m in (METHODS if thorough else RULES) if m[0] != "free"):
        n = len(angle)
        result = at(methods, angle)
        assert np.all(np.asarray(result.coupler_angle) == 0)
        numbers = (np.full(n, E), np.full(n, SPACING), batch(*np.zeros((8, n))))
        for leaf in jax.tree.leaves(slopes(methods)(numbers, angle, np.ones(n))):
            assert np.all(np.isfinite(leaf))


@pytest.mark.parametrize("methods", others_long(METHODS))
def test_derivatives_equal_differences(methods):
    e, spacing, deviations, angle, ratio = random_linkages(20, seed=11, away=0.4)
    numbers = (e, spacing, deviations)
    found = jax.tree.leaves(slopes(methods)(numbers, angle, ratio))
    leaves, tree = jax.tree.flatten(numbers)
    for i, leaf in enumerate(leaves):
        step = 1e-6 if i in (6, 7) else 1e-8  # rad, m

        def shifted(by, i=i, leaf=leaf):
            moved = tree.unflatten([*leaves[:i], leaf + by, *leaves[i + 1 :]])
            return np.asarray(solver(methods)(*moved, angle, ratio).coupler_angle)

        difference = (8 * (shifted(step) - shifted(-step)) - (shifted(2 * step) - shifted(-2 * step))) / (12 * step)
        np.testing.assert_allclose(found[i], difference, rtol=1e-6, atol=1e-7 if i in (6, 7) else 1e-6)


@pytest.mark.parametrize(
    "methods",
    [
        pytest.param(m, marks=[] if m[0] == "free" else [pytest.mark.long])  # the root that bends most stays
        for m in METHODS
        if m[1:] == ("newton", "open")
    ],
)
def test_second_derivatives(methods):
    def gradient(vector, crank_angle):
        def coupler_angle(vector):
            deviations = jax.tree.unflatten(jax.tree.structure(LinkDeviations()), list(vector))
            return one(E, SPACING, deviations, crank_angle, 5.0, methods=methods).coupler_angle

        return jax.grad(coupler_angle)(vector)

    @padded
    def curvature(vector, direction, crank_angle):
        return jax.jvp(lambda v: gradient(v, crank_angle), (vector,), (direction,))

    first, second = (lambda *inputs, k=k: curvature(*inputs)[k] for k in range(2))
    _, _, deviations, angle, _ = random_linkages(6, seed=12, away=0.6)
    vector = np.array(columns(deviations)).T
    direction = np.random.default_rng(0).normal(size=vector.shape)
    found = second(vector, direction, angle)
    ends = (first(vector + step * direction, direction, angle) for step in (1e-7, -1e-7))
    difference = np.subtract(*ends) / 2e-7
    np.testing.assert_allclose(found, difference, rtol=1e-4, atol=2e-2)  # of 1/m^2, up to 1e5
    if methods[0] == "free":  # b2 = -d2^2/(2 e l) and the same of d4, nearly, at 90 deg
        zero = second(np.zeros((2, 8)), np.eye(8)[[1, 3]], np.full(2, np.pi / 2))
        np.testing.assert_allclose([zero[0, 1], zero[1, 3]], -1 / (E * SPACING), rtol=2e-2)


def test_newton_equals_closed_form(thorough):
    inputs = e, spacing, deviations, angle, ratio = random_linkages(200, seed=13, away=0.2)
    for cranks, branch in (("free", "open"), ("free", "crossed"), ("phase_locked", "open")):
        pair = [(cranks, closure, branch) for closure in ("newton", "closed_form")]
        values = [solver(methods)(*inputs).coupler_angle for methods in pair]
        np.testing.assert_allclose(*values, rtol=1e-11)
        if not thorough:  # test_four_bar_reducer_derivatives.py has those of the closed form
            continue
        tangents = [jax.tree.leaves(slopes(methods)((e, spacing, deviations), angle, ratio)) for methods in pair]
        for first, second in zip(*tangents):
            np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("methods", others_long(METHODS))
def test_lost_lanes_leave_their_neighbours_alone(methods):
    """A sum over the linkages that converged: lost ones get no derivative, and change none."""
    size = 6
    e, spacing, deviations, angle, ratio = random_linkages(2 * size, seed=14, away=0.6)
    rows = np.array(columns(deviations))
    lost = rows.copy()
    lost[0, size:] = [np.nan, -1.0, 0, 0, 0, 0]
    lost[1, size:] = [0, 0, 2 * MM, 1.0, np.inf, -1.0]
    lost_angle = angle.copy()
    lost[:, -3], lost_angle[-3] = 0, 0  # no error at the dead point
    lost[:, -1], lost_angle[-1] = 0, np.nan
    (values, each), (lost_values, lost_each) = (
        (solver(methods)(*inputs), slopes(methods)(inputs[:3], *inputs[3:]))
        for inputs in ((e, spacing, batch(*rows), angle, ratio), (e, spacing, batch(*lost), lost_angle, ratio))
    )
    counted = lost_values.info.status == Status.CONVERGED
    assert np.all(counted[:size]) and not counted[size] and not counted[-1]
    assert np.array_equal(lost_values.coupler_angle[:size], values.coupler_angle[:size])
    for lane, lost_lane in zip(jax.tree.leaves(each), jax.tree.leaves(lost_each)):
        assert np.array_equal(lane[:size], lost_lane[:size])
        assert np.all(np.isfinite(lost_lane))
        assert np.all(lost_lane[~counted] == 0)
