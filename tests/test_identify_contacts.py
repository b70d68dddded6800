"""Identification where slopes jump: a mode may lie where a contact opens, with a gradient of zero on neither side."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from rvjax import identify
from rvjax.identify import Noise
from rvjax.tolerances import Tolerance

GAP, SOFT = 0.6, 0.95  # of the contact; slope behind it
PRIOR = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0)}  # standard normal numbers
NOISE = Noise(0.2)


def saturating(values):
    """Readings of two parts in series and of their difference; the sum closes a gap and then moves a little less."""
    total = values["a"] + values["b"]
    seen = jnp.minimum(total, GAP) + SOFT * jnp.maximum(total - GAP, 0.0)
    return jnp.stack([seen, 0.3 * (values["a"] - values["b"])])


def lowest(y):
    """Minimum of Phi without derivatives, the best of many starts."""

    def phi(z):
        seen = np.asarray(saturating({"a": z[0], "b": z[1]}))
        return (z @ z + (((seen - y) / NOISE.sd) ** 2).sum()) / 2

    starts = np.random.default_rng(0).normal(size=(4, 2))
    ends = [minimize(phi, z, method="Nelder-Mead", options=dict(xatol=1e-10, fatol=1e-13)) for z in starts]
    return min(ends, key=lambda end: end.fun)


@pytest.mark.parametrize("reading", [0.6121, *(pytest.param(r, marks=pytest.mark.long) for r in (0.6123, 0.6125))])
def test_a_mode_where_a_contact_opens(reading):
    """One unit and a batch of two: status CONVERGED, at the minimum that a search without derivatives finds."""
    y = np.array([reading, 0.02])
    due = lowest(y)
    assert due.x.sum() == pytest.approx(GAP, abs=1e-6)  # on the kink
    found = identify.solve(saturating, PRIOR, y, noise=NOISE)
    assert found.info.status == 0 and found.status in ("CONVERGED", "LAPLACE_DOUBTFUL")
    assert found.u == pytest.approx(due.x, abs=0.02) and found.info.residual < 0.02
    many = identify.solve_many(saturating, PRIOR, np.stack([y, y - 0.4]), noise=NOISE)
    assert (many.info.status == 0).all() and many.u[0] == pytest.approx(due.x, abs=0.02)


def test_steps_that_stop_far_from_a_mode_are_none():
    """Two steps from far away: no mode, and the distance says so."""
    found = identify.solve(saturating, PRIOR, np.array([-9.0, -9.5]), noise=NOISE, max_steps=1)
    assert found.status == "MAX_STEPS" and found.info.residual > 0.02 and np.isnan(found.value["a"])
