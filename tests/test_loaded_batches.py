"""Batches of the loaded model: every lane as alone, slow ones too, failed ones contained; precision and compilation."""

import jax
import jax.numpy as jnp
import numpy as np
from loaded_cases import NAMED, design_of, errors_of

from rvjax import Status, loaded

CASE = NAMED["rv40: all errors, rated, hertz"]
DESIGN = design_of(CASE)
ANGLE, RATED = 576.525, 412.0
FIXED = ("eccentricity", "pin_position", "disc_runout", "disc_cumulative_pitch")


def sampled(count, seed=0):
    """Units with errors of the size of the reference case, the eccentricity nominal; clearances positive."""
    random = np.random.default_rng(seed)
    nominal = errors_of(CASE, DESIGN)
    drawn = jax.tree.map(lambda leaf: leaf, nominal)
    for name, value in vars(nominal).items():
        size = 0.0 if name in FIXED else np.sqrt(np.mean(np.square(value)))
        values = size * random.standard_normal((count, *np.shape(value)))
        object.__setattr__(drawn, name, jnp.asarray(np.abs(values) if "clearance" in name else values))
    return drawn


def unit(errors, n):
    return jax.tree.map(lambda leaf: leaf[n], errors)


@jax.jit
def solve_units(errors, torque):
    errors = errors.replace(**dict.fromkeys(FIXED, 0.0))
    solve = lambda e: loaded.equilibrium(DESIGN, e, input_angle=ANGLE, output_torque=torque)  # noqa: E731
    found = jax.vmap(solve, in_axes=(jax.tree.map(lambda leaf: 0 if np.ndim(leaf) else None, errors),))(errors)
    return found.error, found.pins, found.info


def solve_one(errors, torque):
    return loaded.equilibrium(DESIGN, errors, input_angle=ANGLE, output_torque=torque)


def test_many_units_at_little_torque_all_converge_and_agree_with_each_alone():
    """300 units at 3 % of rated torque with clearance, where a median case takes 7 steps and the worst near 100: more
    lanes than a block has, so that cases take the places of others. 1e-8: condition 1e7 of rounding, 1e-15."""
    errors = sampled(300)
    error, pins, info = solve_units(errors, 0.03 * RATED)
    assert np.all(np.asarray(info.status) == Status.CONVERGED)
    steps = np.asarray(info.steps)
    assert steps.max() > 3 * np.median(steps)  # there were slow ones
    slow = np.argsort(steps)[[-1, -2, 0, 150]]
    for n in slow:
        alone = solve_one(unit(errors, n), 0.03 * RATED)
        np.testing.assert_allclose(error[n], alone.error, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(pins[n], alone.pins, rtol=0, atol=1e-7 * np.max(alone.pins))


def test_a_failed_lane_disturbs_no_neighbour():
    errors = sampled(300)
    good = solve_units(errors, RATED)
    spoilt = jax.tree.map(lambda leaf: leaf, errors)
    for name, values in {
        "pin_radius": {3: jnp.nan},
        "pin_circle_radius": {7: -0.02},
        "crank_phase": {9: jnp.inf},
    }.items():
        leaf = getattr(spoilt, name)
        for lane, value in values.items():
            leaf = leaf.at[lane].set(value)
        object.__setattr__(spoilt, name, leaf)
    bad = solve_units(spoilt, RATED)
    expected = {3: Status.NONFINITE, 7: Status.CONTACT_OVERLOAD, 9: Status.NONFINITE}
    for lane, status in expected.items():
        assert int(bad[2].status[lane]) == status and np.isnan(bad[0][lane])
    rest = np.setdiff1d(np.arange(300), list(expected))
    np.testing.assert_allclose(bad[0][rest], good[0][rest], rtol=1e-12)


def test_single_precision():
    """The aim for loaded cases: error 1e-4 relative + 1e-8 rad, forces 1e-3 of the largest. A few ill-conditioned units
    of a hundred miss it, by up to the rounding of their gaps times a condition of 1e4: 5e-4."""
    errors = sampled(300)
    double = solve_units(errors, RATED)
    single = solve_units(jax.tree.map(lambda leaf: leaf.astype(jnp.float32), errors), jnp.float32(RATED))
    assert single[0].dtype == jnp.float32
    assert np.all(np.asarray(single[2].status) == Status.CONVERGED)
    off = np.abs(np.asarray(single[0], float) - double[0])
    assert np.mean(off <= 1e-4 * np.abs(double[0]) + 1e-8) > 0.97
    assert np.all(off <= 5e-4 * np.abs(double[0]))
    largest = np.max(double[1], axis=(1, 2), keepdims=True)
    assert np.max(np.abs(np.asarray(single[1], float) - double[1]) / largest) < 1e-3


def test_other_numbers_compile_nothing():
    errors = errors_of(CASE, DESIGN)
    solve_one(errors, RATED)
    before = _programs()
    solve_one(jax.tree.map(lambda leaf: 0.5 * np.asarray(leaf) if np.ndim(leaf) else 0.5 * leaf, errors), 0.3 * RATED)
    assert _programs() == before


def _programs():
    from rvjax.loaded.equilibrium import _equilibrium

    return _equilibrium._cache_size()
