"""How a pin and a disc yield: force, slope and energy of every law belong together.

Oracles: d = c F (A - ln F), F = k d and d = C F^0.9 put back in; differences of fourth order of the plain functions,
whose steps of 1e-3 leave 1e-12 and rounding 1e-13 / 1e-3.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax.loaded import laws
from rvjax.units import um

DEPTH = jnp.asarray([0.05, 0.3, 1.0, 4.0, 12.0]) * um
CASES = {"hertz": (2.34e-10, 28.0), "linear": (4e8, None), "palmgren": (8e-9, None)}  # steel, 12 mm wide


def force(law, depth=DEPTH):
    compliance, level = CASES[law]
    return laws.force(law, depth, jnp.asarray(compliance), None if level is None else jnp.asarray(level))


def difference(function):
    h = 1e-3 * DEPTH
    near, far = (function(DEPTH + s * h) - function(DEPTH - s * h) for s in (1, 2))
    return (8 * near - far) / (12 * h)


@pytest.mark.parametrize("law", laws.CONTACTS)
def test_force_slope_and_energy_belong_together(law):
    compliance, level = CASES[law]
    load = force(law)
    depth = {
        "hertz": lambda: compliance * load * (level - np.log(load)),
        "linear": lambda: load / compliance,
        "palmgren": lambda: compliance * load**0.9,
    }[law]()
    np.testing.assert_allclose(depth, DEPTH, rtol=1e-13)
    slope = laws.slope(law, DEPTH, load, jnp.asarray(compliance))
    np.testing.assert_allclose(slope, difference(lambda d: force(law, d)), rtol=1e-9)
    stored = difference(lambda d: laws.energy(law, d, force(law, d), jnp.asarray(compliance)))
    np.testing.assert_allclose(stored, load, rtol=1e-9)


@pytest.mark.parametrize("law", laws.CONTACTS)
def test_contacts_that_do_not_touch_carry_no_force(law):
    apart, compliance = jnp.asarray([-1e-6, 0.0]), jnp.asarray(CASES[law][0])
    load = force(law, apart)
    assert np.all(load == 0) and np.all(laws.slope(law, apart, load, compliance) == 0)
    assert np.all(laws.energy(law, apart, load, compliance) == 0)
