"""Torque-angle loop: simulated against its closed forms.

Oracles: tests/reference/lost_motion.json (1e-12 arcmin); the loop's own figures read off a simulated cycle, the
dissipated energy by the trapezoidal rule on a fine torque grid (1e-6, its error); central differences (1e-6).
"""

from itertools import pairwise

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from rvjax.lost_motion import hysteresis_loop, loop_figures
from rvjax.units import arcmin

LOOP = dict(play=0.5467 * arcmin, stiffness=49 / arcmin, friction=0.8, smoothing=1.0)


def cycle(limit, steps=4000, turns=2):
    quarter = np.linspace(0, limit, steps + 1)
    once = np.concatenate([quarter, quarter[-2::-1], -quarter[1:], -quarter[-2::-1]])
    return np.concatenate([once] + [once[1:]] * (turns - 1))


def test_reference_cases(reference):
    kinds = []
    for case in reference("lost_motion")["cases"]:
        if case["kind"] not in ("hysteresis_loop", "loop_figures"):
            continue
        kinds.append(case["kind"])
        options = dict(
            play=case["play"] * arcmin,
            stiffness=case["stiffness"] / arcmin,
            friction=case["friction"],
            smoothing=case["smoothing"],
        )
        if case["kind"] == "hysteresis_loop":
            angle = hysteresis_loop(jnp.array(case["torque"]), **options)
            np.testing.assert_allclose(angle / arcmin, case["expect_arcmin"], rtol=0, atol=1e-12)
        else:
            figures = loop_figures(torque_threshold=case["torque_threshold"], torque_max=case["torque_max"], **options)
            expected = case["expect"]
            np.testing.assert_allclose(figures.lost_motion / arcmin, expected["lost_motion_arcmin"], atol=1e-10)
            np.testing.assert_allclose(
                figures.zero_torque_width / arcmin, expected["zero_torque_width_arcmin"], atol=1e-10
            )
            np.testing.assert_allclose(figures.energy / arcmin, expected["energy_N_m_arcmin"], rtol=1e-12)
    assert sorted(kinds) == ["hysteresis_loop", "loop_figures"]


def test_the_play_is_taken_up_along_its_whole_curve():
    """tanh by mpmath, from nothing to where it is 1 to rounding, and its slope 1 - tanh^2 to the last digit it has."""
    ratios = [0.0, 1e-9, 0.3, 2.0, 4.5, 9.0, 17.0, 19.0, 25.0, 39.9, 40.1, 400.0]
    torque = jnp.asarray([sign * ratio * 0.7 for ratio in ratios for sign in (1, -1)])
    options = dict(stiffness=1e9, friction=0.0)
    angle = hysteresis_loop(torque, play=2.0, smoothing=0.7, **options)
    exact = [float(mpmath.tanh(mpmath.mpf(float(t)) / mpmath.mpf(0.7))) + float(t) / 1e9 for t in torque]
    np.testing.assert_allclose(angle, exact, rtol=4e-16 * 4, atol=0)  # four roundings
    slope = jax.vmap(jax.grad(lambda t: hysteresis_loop(t[None], play=2.0, smoothing=0.7, **options)[0]))(torque)
    sharp = [float((1 - mpmath.tanh(mpmath.mpf(float(t)) / mpmath.mpf(0.7)) ** 2) / mpmath.mpf(0.7)) for t in torque]
    np.testing.assert_allclose(slope - 1e-9, sharp, rtol=1e-9, atol=2 * 16e-16 / 0.7)  # of 1 - tanh^2, as above


@pytest.mark.parametrize("change", [{}, {"smoothing": 0.0}, {"friction": 0.0}, {"friction": 9.0}, {"play": 0.0}])
def test_figures_equal_the_simulated_loop(change):
    options, x, limit = LOOP | change, 5.0, 167.0
    torque = cycle(limit, steps=33400)  # steps of 5 mN m: threshold and zero are samples
    angle = np.asarray(hysteresis_loop(torque, **options))
    n = len(torque) // 2
    last, turn = angle[n:], torque[n:]  # the second turn is closed

    def read(at):
        return np.sort(last[np.abs(turn - at) < 1e-9])

    figures = loop_figures(torque_threshold=x, torque_max=limit, **options)
    middle = [np.mean(read(at)[[0, -1]]) for at in (-x, x)]
    np.testing.assert_allclose(figures.lost_motion, middle[1] - middle[0], rtol=1e-9)
    if change != {"friction": 0.0, "smoothing": 0.0}:
        np.testing.assert_allclose(figures.zero_torque_width, np.ptp(read(0.0)), rtol=1e-9, atol=1e-15)
    assert last[0] == last[-1]
    # A jump at smoothing 0 is one grid step wide: its energy is off by play times that step.
    energy = np.trapezoid(turn, last)
    np.testing.assert_allclose(figures.energy, energy, rtol=1e-6, atol=options["play"] * 6e-3)


def test_odd_with_return_point_memory():
    rng = np.random.default_rng(1)
    torque = rng.uniform(-20, 20, 200)
    angle = hysteresis_loop(torque, **LOOP)
    np.testing.assert_allclose(hysteresis_loop(-torque, **LOOP), -angle, rtol=0, atol=1e-18)
    inner = np.array([0.0, 30.0, 10.0, 25.0, 12.0, 14.0, 12.0, 25.0, 10.0, 30.0, 5.0])
    plain = np.array([0.0, 30.0, 10.0, 30.0, 5.0])
    assert hysteresis_loop(inner, **LOOP)[-1] == hysteresis_loop(plain, **LOOP)[-1]
    first, second = (np.asarray(hysteresis_loop(inner, **LOOP))[k] for k in (1, 9))
    assert first == second
    # Rate independent: samples on the way change nothing
    dense = np.concatenate([np.linspace(a, b, 7)[:-1] for a, b in pairwise(inner)] + [inner[-1:]])
    np.testing.assert_array_equal(hysteresis_loop(dense, **LOOP)[::6], hysteresis_loop(inner, **LOOP))


def test_friction_above_the_threshold_hides_the_play():
    figures = loop_figures(torque_threshold=5.0, torque_max=100.0, **LOOP | {"friction": 6.0, "smoothing": 0.0})
    np.testing.assert_allclose(figures.lost_motion, 2 * 5.0 / LOOP["stiffness"], rtol=1e-12)


def test_extremes_are_finite():
    torque = jnp.array([0.0, 1e12, -1e12, 0.0])
    for smoothing in (0.0, 1e-9):
        for friction in (0.0, 0.8):
            options = LOOP | {"smoothing": smoothing, "friction": friction}
            values = (hysteresis_loop(torque, **options), hysteresis_loop(torque.astype(jnp.float32), **options))
            assert np.all(np.isfinite(values[0])) and np.all(np.isfinite(values[1]))
            assert values[1].dtype == jnp.float32
            slope = jax.grad(lambda o: jnp.sum(hysteresis_loop(torque, **o)))(options)
            assert all(np.isfinite(leaf) for leaf in slope.values())


def test_derivatives_equal_finite_differences():
    torque = jnp.array([0.0, 5, 20, 3, -2, -30, 1, 0.7])
    weight = jnp.arange(1.0, 9.0)

    def angle(**options):
        return jnp.sum(weight * hysteresis_loop(torque, **options))

    def figures(**options):
        found = loop_figures(torque_threshold=5.0, torque_max=100.0, **options)
        return 3 * found.lost_motion + 2 * found.zero_torque_width + found.energy

    for function in (angle, figures):
        slope = jax.grad(lambda o, function=function: function(**o))(LOOP)
        for name, value in LOOP.items():
            step = value * 1e-5
            up, down = (function(**LOOP | {name: value + sign * step}) for sign in (1, -1))
            np.testing.assert_allclose(slope[name], (up - down) / (2 * step), rtol=1e-6, atol=1e-12)


def test_wrong_numbers():
    torque = jnp.array([0.0, 1.0])
    for change in ({"stiffness": 0.0}, {"play": -1e-9}, {"friction": -0.1}, {"smoothing": -1.0}):
        with pytest.raises(ValueError, match=next(iter(change))):
            hysteresis_loop(torque, **LOOP | change)
    with pytest.raises(ValueError, match=r"torque: shape \(\)"):
        hysteresis_loop(1.0, **LOOP)
    with pytest.raises(ValueError, match="torque_max"):
        loop_figures(torque_threshold=5.0, torque_max=6.0, **LOOP)
    traced = jax.jit(lambda limit: loop_figures(torque_threshold=5.0, torque_max=limit, **LOOP))(6.0)
    assert all(np.isnan(leaf) for leaf in jax.tree.leaves(traced))
