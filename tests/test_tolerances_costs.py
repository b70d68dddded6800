"""Cost against half-width: values by hand, and bad numbers named."""

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax.tolerances import Exponential, ReciprocalPower, Table
from rvjax.units import um
from tests.oracles.linear_pair import WIDE


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ReciprocalPower(finest=2.0, coarsest=1.0), "ReciprocalPower.finest = 2: must not exceed coarsest = 1"),
        (lambda: ReciprocalPower(finest=-1.0, coarsest=1.0), "ReciprocalPower.finest = -1: must be positive"),
        (lambda: Exponential(finest=1.0, coarsest=2.0, decay=0.0), "Exponential.decay = 0: must be positive"),
        (lambda: Table((1.0, 2.0), (1.0, 3.0)), "Table.costs = .*must fall"),
        (lambda: Table((2.0, 1.0), (3.0, 1.0)), "Table.half_widths = .*must ascend"),
        (lambda: Table((2.0,), (3.0,)), "needs at least two"),
    ],
)
def test_bad_costs_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_costs_of_half_widths():
    t = jnp.asarray([5 * um, 20 * um])
    np.testing.assert_allclose(WIDE.replace(scale=6.0, fixed=1.0, power=2.0)(t), [25.0, 2.5])
    np.testing.assert_allclose(Exponential(decay=5 * um, finest=1 * um, coarsest=1.0)(t), np.exp([-1.0, -4.0]))
    table = Table((5 * um, 20 * um, 80 * um), (8.0, 2.0, 0.5))
    np.testing.assert_allclose(table(jnp.asarray([5 * um, 10 * um, 40 * um])), [8.0, 4.0, 1.0])
    assert (table.finest, table.coarsest) == (5 * um, 80 * um)
