"""Plots of a correction: the curve before and after; the readings, their contents and the rest."""

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


def contents(angle: Numbers, error: Numbers, fitted: Numbers, *, title: str = "", axes: Axes | None = None) -> Axes:
    """A measured error over the output angle, the curve of its contents, and below it the rest.

    Args:
        angle: of the output, ascending, rad (n,).
        error: measured, rad (n,).
        fitted: curve of the contents, rad (n,).
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    x, y, fit = np.degrees(np.asarray(angle)), np.asarray(error) / arcsec, np.asarray(fitted) / arcsec
    rest = y - fit
    below = min(float(np.min(y)), float(np.min(fit))) - 1.2 * float(np.max(rest, initial=0.0))  # its own zero line
    axes.plot(x, y, ".", color=BEFORE, ms=3, label="measured")
    axes.plot(x, fit, color=AFTER, lw=1.0, label="contents")
    axes.axhline(below, color="0.8", lw=0.8)
    axes.plot(x, below + rest, color="0.4", lw=0.8, label=f"rest, rms {np.std(rest):.3g} arcsec (shifted)")
    axes.set(xlabel="output angle (deg)", ylabel="transmission error (arcsec)", title=title)
    high = max(float(np.max(y)), float(np.max(fit)))
    axes.set_ylim(top=high + 0.2 * max(1e-12, high - below))  # space for the legend
    axes.legend(loc="upper right", ncols=3)
    return axes
