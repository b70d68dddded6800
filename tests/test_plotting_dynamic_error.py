"""Pictures of the dynamic transmission error: the data that is drawn is the data that was given, axes carry units."""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

from rvjax import plotting
from rvjax.dynamics import SpeedSweep
from rvjax.status import SolveInfo
from rvjax.units import arcmin, rpm

RATIO = 105.0
SPEEDS = np.linspace(5, 60, 45) * RATIO * rpm
ORDER = np.array([40.0, 78.0, 80.0, 208.0])
HEIGHT = arcmin * np.stack([np.linspace(2, 1, 45), np.linspace(0.2, 0.1, 45), np.zeros(45), np.full(45, 2e-4)], 1)
LINES = jnp.asarray(HEIGHT[:, :, None] * 1j)
SWEEP = SpeedSweep(ORDER, LINES, HEIGHT.max(0)[:, None], None, ("output.rotation",), SolveInfo(0))


@pytest.fixture(autouse=True)
def styled():
    with plotting.style():
        yield
    plt.close("all")


def test_orders_rise_with_speed_and_carry_their_amplitudes():
    axes = plotting.dynamics.campbell_amplitudes(SWEEP, SPEEDS, ratio=RATIO, modes=[10.5], highest=80.0)
    lines = axes.collections
    assert len(lines) == 3  # order 80 has no errors
    for line, n, height in zip(lines, ORDER[[0, 1, 3]], HEIGHT.T[[0, 1, 3]]):
        ends = np.array([line.get_segments()[0][0], line.get_segments()[-1][1]])
        np.testing.assert_allclose(ends, [[5, n * 5 / 60], [60, n]])
        floor = 2e-3  # three decades below the largest
        np.testing.assert_allclose(line.get_array()[0], max(height[:2].mean() / arcmin, floor))
    assert [text.get_text().strip() for text in axes.texts] == ["40", "78", "208"]
    assert axes.get_ylim() == (0, 80) and axes.lines[0].get_ydata()[0] == 10.5 and "(Hz)" in axes.get_ylabel()
    nothing = SWEEP.replace(amplitude=jnp.zeros_like(LINES))
    assert not plotting.dynamics.campbell_amplitudes(nothing, SPEEDS, ratio=RATIO).collections
