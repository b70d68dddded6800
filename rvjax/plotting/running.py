"""Plots of friction: efficiency against torque and speed."""

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from rvjax.plotting.style import DASHES, LIMIT, PALETTE, new_axes
from rvjax.units import rpm


def efficiency_against_torque(
    torque: ArrayLike, efficiency: ArrayLike, *, speeds: ArrayLike, rated: int, axes: Axes | None = None
) -> Axes:
    """Efficiency against the output torque at several speeds: the median of the units and their band.

    Args:
        torque: sizes (t,) N m.
        efficiency: low, 50 % and high quantile over the units at each speed (3, s, t).
        speeds: sizes (s,) rad/s; 0 for rest.
        rated: place of the torque of the conditions, which is marked.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    torque, band, speeds = np.asarray(torque), 100 * np.asarray(efficiency), np.asarray(speeds)
    for k, speed in enumerate(speeds):
        label = f"{speed / rpm:.4g} r/min" if speed else "limit of low speed"
        dash = DASHES[k % len(DASHES)]
        if k == len(speeds) // 2:  # one band is filled, the others would cover it
            axes.fill_between(torque, band[0, k], band[2, k], color=PALETTE[k], alpha=0.25, lw=0)
        axes.plot(torque, band[::2, k].T, dash, color=PALETTE[k], lw=0.7)
        axes.plot(torque, band[1, k], dash, color=PALETTE[k], marker="o", ms=3, label=label)
    axes.axvline(torque[rated], color=LIMIT, lw=1, label="torque of the conditions")
    axes.set(xlabel="output torque (N m)", ylabel="efficiency (%)", xlim=(0, None))
    axes.set_title("Efficiency against torque: median, and 1 to 99 % of the units")
    axes.legend(fontsize=8)
    return axes
