"""Similar reducers: what is as stiff as published, and between which laws the others lie."""

import numpy as np
import pytest

from rvjax.published import sizes
from rvjax.units import GPa


def test_the_size_of_the_base_is_the_base():
    base, found = sizes.similar(412.0), sizes.similar(8 * 412.0)
    assert found.cycloid.pin_circle_radius == pytest.approx(2 * base.cycloid.pin_circle_radius)
    assert found.cranks.circle_radius == pytest.approx(2 * base.cranks.circle_radius)
    assert found.involute.centre_distance == pytest.approx(2 * base.involute.centre_distance)
    assert found.stiffness.turning_arm_bearing == pytest.approx(2**0.8 * base.stiffness.turning_arm_bearing)
    assert found.stiffness.planet_crank_torsion == pytest.approx(8 * base.stiffness.planet_crank_torsion)
    assert found.contact.young_modulus == pytest.approx(206 * GPa)


def test_stiffness_grows_between_bearings_and_shafts():
    """Every spring that turns the output grows as the length to the power of 2.8 (bearings) to 3 (shafts, flanks)."""
    assert sizes.stiffness("40e") == pytest.approx(sizes.PUBLISHED, rel=1e-4)
    for size in ("20e", "160e"):
        grown, ratio = sizes.stiffness(size) / sizes.PUBLISHED, (sizes.TORQUE[size] / 412.0) ** (1 / 3)
        low, high = np.sort(ratio ** np.array([2.8, 3.0]))
        assert 0.995 * low < grown < 1.005 * high
