"""Plot of a correction: the curve before and after."""

import numpy as np
from matplotlib.axes import Axes

from rvjax.compensation import Correction
from rvjax.plotting.style import AFTER, BEFORE, Numbers, new_axes
from rvjax.units import arcsec


def before_and_after(
    angle: Numbers, error: Numbers, correction: Correction, *, title: str = "", axes: Axes | None = None
) -> Axes:
    """A measured error over the output angle, and the rest after the correction.

    Args:
        angle: of the output, rad (n,).
        error: of the output, rad (n,); its mean is taken away.
        correction: added at the output.
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    rank = np.argsort(angle)
    x, y = np.degrees(np.asarray(angle)[rank]), (np.asarray(error) - np.mean(error))[rank] / arcsec
    left = y + correction.output(np.asarray(angle)[rank]) / arcsec
    for values, colour, dash, label in ((y, BEFORE, "--", "before"), (left, AFTER, "-", "after")):
        axes.plot(x, values, color=colour, ls=dash, lw=1.0, label=f"{label}, rms {np.std(values):.3g} arcsec")
    axes.set(
        xlabel="output angle (deg)", ylabel="transmission error (arcsec)", title=title or "Error and its correction"
    )
    axes.set_ylim(top=1.25 * max(1e-12, float(np.max(np.abs(y)))))  # space for the legend
    axes.legend(loc="upper right", ncols=2)
    return axes
