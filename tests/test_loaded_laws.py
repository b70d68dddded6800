"""How a pin and a disc yield: force, slope and energy of every law belong together.

Oracles: d = c F (A - ln F), F = k d and d = C F^0.9 put back in; differences of fourth order of the plain functions,
whose steps of 1e-3 leave 1e-12 and rounding 1e-13 / 1e-3.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax.loaded import laws
from rvjax.units import um

DEPTH = np.array([0.05, 0.3, 1.0, 4.0, 12.0]) * um
CASES = {"hertz": (2.34e-10, 28.0), "linear": (4e8, None), "palmgren": (8e-9, None)}  # steel, 12 mm wide


@partial(jax.jit, static_argnums=0)
def found(law, depth):
    """Force, slope and energy at depths."""
    compliance, level = (None if x is None else jnp.asarray(x, depth.dtype) for x in CASES[law])
    load = laws.force(law, depth, compliance, level)
    most = laws.largest_depth(compliance, level) if law == "hertz" else None
    return load, laws.slope(law, depth, load, compliance), laws.energy(law, depth, load, compliance, most)


@pytest.mark.parametrize("law", laws.CONTACTS)
def test_force_slope_and_energy_belong_together(law):
    compliance, level = CASES[law]
    load, slope, _ = map(np.asarray, found(law, DEPTH))
    depth = {
        "hertz": lambda: compliance * load * (level - np.log(load)),
        "linear": lambda: load / compliance,
        "palmgren": lambda: compliance * load**0.9,
    }[law]()
    np.testing.assert_allclose(depth, DEPTH, rtol=1e-13)
    h = 1e-3 * DEPTH
    near, far = ([a - b for a, b in zip(found(law, DEPTH + s * h), found(law, DEPTH - s * h))] for s in (1, 2))
    rise, _, work = ((8 * a - b) / (12 * h) for a, b in zip(near, far))
    np.testing.assert_allclose(slope, rise, rtol=1e-9)
    np.testing.assert_allclose(work, load, rtol=1e-9)


@pytest.mark.parametrize("law", laws.CONTACTS)
def test_depth_of_a_force(law):
    """It is the inverse of the force, and 0 without one."""
    compliance, level = (None if x is None else jnp.asarray(x) for x in CASES[law])
    load = jnp.concatenate([found(law, DEPTH)[0], jnp.zeros(1)])
    np.testing.assert_allclose(laws.depth(law, load, compliance, level), [*DEPTH, 0], rtol=1e-13)
    strong = laws.depth(law, jnp.geomspace(1e3, 1e15, 50), compliance, level)
    assert (np.diff(strong) > 0).all()  # beyond the largest depth, too


@pytest.mark.parametrize("law", laws.CONTACTS)
def test_single_precision(law):
    single = found(law, np.asarray(DEPTH, np.float32))
    for one, double in zip(single, found(law, DEPTH)):
        assert one.dtype == jnp.float32
        np.testing.assert_allclose(one, double, rtol=1e-5)


@pytest.mark.parametrize("law", laws.CONTACTS)
def test_contacts_that_do_not_touch_carry_no_force(law):
    for values in found(law, np.array([-1e-6, 0.0, -1e-9, -1e-3, -1.0])):
        assert np.all(np.asarray(values) == 0)


def test_beyond_its_largest_depth_the_hertz_law_is_still_convex():
    """Force and energy go on without a jump; slope and force are the rise of force and energy there too."""
    limit = float(laws.largest_depth(*map(jnp.asarray, CASES["hertz"])))
    compliance, level = CASES["hertz"]
    assert level - np.log(limit / compliance) == pytest.approx(1, abs=1e-3)
    depth = limit * np.array([0.9, 0.99, 1.001, 1.01, 1.3, 3.0])
    load, slope, _ = map(np.asarray, found("hertz", depth))
    h = 1e-6 * depth
    rise, _, work = ((a - b) / (2 * h) for a, b in zip(found("hertz", depth + h), found("hertz", depth - h)))
    np.testing.assert_allclose(slope, rise, rtol=1e-3)
    np.testing.assert_allclose(work, load, rtol=1e-3)
    below, above = (np.asarray(found("hertz", limit * np.array([x]))) for x in (1 - 1e-6, 1 + 1e-6))
    np.testing.assert_allclose(above[[0, 2]], below[[0, 2]], rtol=1e-4)
