"""Pictures of the lost motion: who contributes what, and the torque-angle loop."""

import dataclasses

import numpy as np
from matplotlib.axes import Axes

from rvjax.lost_motion import LostMotion, hysteresis_loop
from rvjax.plotting.style import AFTER, BEFORE, LIMIT, new_axes, words
from rvjax.units import arcmin


def contributions(result: LostMotion, *, axes: Axes | None = None) -> Axes:
    """Every contribution to the lost motion as a bar, clearance to the right and interference to the left.

    Args:
        result: of `lost_motion.geometric`, one unit.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    names = [f.name for f in dataclasses.fields(result.terms) if float(getattr(result.terms, f.name)) != 0]
    values = [float(getattr(result.terms, name)) / arcmin for name in names]
    rows = np.arange(len(names))[::-1]
    axes.barh(rows, values, color=[AFTER if value > 0 else BEFORE for value in values], height=0.6)
    for row, value in zip(rows, values):
        axes.annotate(
            f"{value:+.3f}",
            (value, row),
            xytext=(4 if value > 0 else -4, 0),
            textcoords="offset points",
            ha="left" if value > 0 else "right",
            va="center",
            fontsize=9,
        )
    total = float(result.total) / arcmin
    axes.axvline(total, color=LIMIT, lw=1.5, ls="--", zorder=0)
    axes.axvline(0, color="0.3", lw=0.8)
    axes.set_yticks(rows, [words(name) for name in names])
    axes.margins(x=0.15)
    title = f"Contributions to the lost motion; their sum {total:+.3f} arcmin is the dashed line"
    axes.set_title(title, fontsize=10)
    axes.set(xlabel="contribution (arcmin)")
    axes.grid(axis="y", visible=False)
    return axes


def torque_angle_loop(
    *,
    torque_max: float,
    torque_threshold: float,
    play: float,
    stiffness: float,
    friction: float,
    smoothing: float,
    axes: Axes | None = None,
) -> Axes:
    """Torque-angle loop of an output whose torque is cycled, as a test bench plots it.

    Args:
        torque_max: the torque is cycled between +-torque_max, N m.
        torque_threshold: where lost motion is read, N m.
        play: free angle in total, rad.
        stiffness: of the elastic line, N m/rad.
        friction: torque that dry friction can hold, N m.
        smoothing: torque over which the backlash closes, N m.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    ramp = np.linspace(-1, 1, 801)
    torque = torque_max * np.concatenate([np.linspace(0, 1, 401), ramp[::-1], ramp])
    angle = np.asarray(hysteresis_loop(torque, play=play, stiffness=stiffness, friction=friction, smoothing=smoothing))
    axes.plot(torque[401:], angle[401:] / arcmin, color=AFTER, lw=2.0, label="cycle")
    axes.plot(torque[:401], angle[:401] / arcmin, color=BEFORE, ls="--", lw=1.2, label="first loading")
    for sign in (-1, 1):
        axes.axvline(sign * torque_threshold, color=LIMIT, lw=1.0, ls=":")
    axes.plot([], [], color=LIMIT, lw=1.0, ls=":", label=f"+-{torque_threshold:.3g} N m")
    axes.set(
        xlabel="torque at the output (N m)",
        ylabel="angle of the output (arcmin)",
        title="Torque-angle loop, input locked",
    )
    axes.legend(loc="upper left")
    return axes
