"""Floquet multipliers of the mesh stiffness: parametric resonance, limits in closed form, what is not allowed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import Damping, Status, dynamics
from rvjax.catalogue import RV_320E
from rvjax.units import rpm

RATED = 1000 * rpm


def varied(design, **changes):
    return design.replace(mesh_variation=design.mesh_variation.replace(**changes))


def test_multipliers_of_a_resonance_and_of_constant_stiffness():
    """Multipliers of a parametric resonance, found by a period map of 40 digits: 1.13 and 1.23."""
    design = varied(RV_320E.replace(damping=Damping(modal_ratio=0.001)), planetary_swing=0.6)
    unit = RATED / 248.64864864864865
    found = [dynamics.floquet(design, sun_speed=f * unit) for f in (2229.0, 5200.0, 248.6)]
    found = jax.tree.map(lambda *lanes: jnp.stack(lanes), *found)
    np.testing.assert_allclose(found.multiplier[:2], [1.13, 1.23], atol=0.005)
    assert found.info.status.tolist() == [Status.UNSTABLE, Status.UNSTABLE, Status.CONVERGED]
    with pytest.raises(rvjax.SolveError, match="UNSTABLE 2"):
        rvjax.check(found)
    undamped = dynamics.floquet(RV_320E, sun_speed=RATED)
    assert float(undamped.multiplier) == pytest.approx(1, abs=1e-9) and undamped.info.status == Status.CONVERGED
    # Without variation the multipliers are those of constant damping: e^{-zeta w_1 T}.
    calm = varied(RV_320E.replace(damping=Damping(modal_ratio=0.02)), planetary_swing=0.0)
    lowest = 2 * np.pi * float(dynamics.modes(RV_320E).frequency[0])
    expected = np.exp(-0.02 * lowest / 248.64864864864865)
    assert float(dynamics.floquet(calm, sun_speed=RATED).multiplier) == pytest.approx(expected, rel=1e-9)


def test_what_floquet_cannot_solve_is_an_error_or_nan():
    for design, name in (
        (varied(RV_320E, planetary_ramp=0.1), "planetary_ramp"),
        (RV_320E.replace(damping=Damping(loss_factor=0.01)), "loss_factor"),
    ):
        with pytest.raises(ValueError, match=name):
            dynamics.floquet(design, sun_speed=RATED)
    assert np.isnan(dynamics.floquet(RV_320E, sun_speed=0.0).multiplier)
