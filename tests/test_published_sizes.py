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


def test_the_rated_torque_twists_the_gears_of_every_size_alike():
    """Torque grows as the length cubed, a force as its square. Hence k L^2/T of every spring in N/m, and k/T of shafts.

    Roller bearings are softer in proportion: k grows as the length to the power of 0.8.
    """
    for size in ("20e", "320e"):
        grown, torque = sizes.similar(sizes.TORQUE[size]).stiffness, sizes.TORQUE[size] / sizes.TORQUE["40e"]
        base, length = sizes.similar(sizes.TORQUE["40e"]).stiffness, torque ** (1 / 3)
        for name in ("sun_planet_mesh", "disc_pin_mesh", "sun_support", "planet_crank_bending"):
            assert getattr(grown, name) / getattr(base, name) * length**2 / torque == pytest.approx(1.0), name
        for name in ("sun_torsion", "planet_crank_torsion"):
            assert getattr(grown, name) / getattr(base, name) / torque == pytest.approx(1.0), name
        for name in ("support_bearing", "turning_arm_bearing"):
            assert getattr(grown, name) / getattr(base, name) == pytest.approx(length**0.8), name


@pytest.mark.long  # with the values of this source
def test_stiffness_grows_between_bearings_and_shafts():
    """Every spring that turns the output grows as the length to the power of 2.8 (bearings) to 3 (shafts, flanks)."""
    assert sizes.stiffness("40e") == pytest.approx(sizes.PUBLISHED, rel=1e-4)
    for size in ("20e", "160e"):
        grown, ratio = sizes.stiffness(size) / sizes.PUBLISHED, (sizes.TORQUE[size] / 412.0) ** (1 / 3)
        low, high = np.sort(ratio ** np.array([2.8, 3.0]))
        assert 0.995 * low < grown < 1.005 * high


def test_discs_of_a_similar_reducer_weigh_as_its_torque(monkeypatch):
    """Equal stresses: mass grows as length cubed, as the torque does. Two plates of 61 mm radius and 12 mm: 2.2 kg."""
    base = sizes.disc_mass("40e")
    assert base == pytest.approx(2 * np.pi * 0.061**2 * 0.012 * 7850, rel=1e-9)
    assert sizes.disc_mass("160e") / base == pytest.approx(1568 / 412, rel=1e-9)
    assert sizes.COMPUTED["sizes.weight"]()
    monkeypatch.setitem(sizes.WEIGHT, "320e", 1.9 * sizes.disc_mass("320e"))  # lighter than what turns in it
    assert not sizes.COMPUTED["sizes.weight"]()
