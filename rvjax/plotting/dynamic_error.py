"""Pictures of the dynamic transmission error: orders over speed, spectra, spread of a batch, shares of the errors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm

from rvjax.dynamics import SpeedSweep
from rvjax.plotting.style import AFTER, LIMIT, PALETTE, Numbers, new_axes, words
from rvjax.units import readable, rpm

DECADES = 3  # of amplitude that colours and spectra show below the largest


def campbell_amplitudes(
    sweep: SpeedSweep,
    sun_speeds: Numbers,
    *,
    ratio: float,
    modes: Sequence[float] = (),
    highest: float | None = None,
    output: int = 0,
    axes: Axes | None = None,
) -> Axes:
    """Frequencies of the orders over the speed of the output, thick and dark where large, and the modes they cross.

    Args:
        sweep: of `dynamics.speed_sweep`.
        sun_speeds: of the sweep, rad/s (speeds,), ascending.
        ratio: sun turns for one of the output.
        modes: natural frequencies to draw as lines, Hz.
        highest: top of the frequency axis, Hz; by default that of the highest order.
        output: which of the sweep's outputs.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    turns, order, height, shown = _lines(sweep, sun_speeds, ratio, output)
    largest = height.max(initial=0) or 1.0
    lowest, top = (
        largest / 10**DECADES,
        highest or float(1.05 * order.max(initial=1) * np.abs(turns).max() / (2 * np.pi)),
    )
    norm = LogNorm(lowest, largest)
    drawn: Any = None
    ends: dict[tuple[float, float], list[str]] = {}  # of lines side by side, one label
    for k, n in enumerate(order):
        if not height[:, k].any():
            continue
        points = np.stack([turns / rpm, np.abs(n * turns) / (2 * np.pi)], axis=1)
        value = np.maximum((height[1:, k] + height[:-1, k]) / 2, lowest)
        drawn = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis_r", norm=norm)
        drawn.set(array=value, linewidth=1 + 6 * np.asarray(norm(value)), capstyle="round")
        axes.add_collection(drawn)
        x, y = points[points[:, 1] <= top][-1] if points[0, 1] <= top else points[0]
        near = (end for end in ends if abs(end[0] - x) < 0.1 * np.ptp(turns) / rpm and abs(end[1] - y) < 0.04 * top)
        ends.setdefault(next(near, (x, y)), []).append(f"{n:.4g}")
    for end, numbers in ends.items():
        axes.annotate(" " + ", ".join(numbers), end, fontsize=8, annotation_clip=False)
    for k, value in enumerate(modes):
        axes.axhline(value, color="0.35", ls="--", lw=1.0, zorder=1, label="mode" if k == 0 else None)
    axes.set(
        xlabel="output speed (r/min)", ylabel="frequency (Hz)", xlim=(turns[0] / rpm, turns[-1] / rpm), ylim=(0, top)
    )
    axes.set_title("Orders per output turn (numbers) and their amplitudes", pad=14)
    axes.grid(visible=False)
    if modes:
        axes.legend(loc="upper left")
    if drawn is not None:
        axes.figure.colorbar(drawn, ax=axes, label=f"amplitude ({shown})", pad=0.1)
    return axes


def batch_over_speed(
    output_speed: Numbers,
    values: Numbers,
    *,
    unit: str,
    name: str,
    limit: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Spread of a response over a batch of units at every speed: median, 90 % and 99.73 % of the units, the worst.

    Args:
        output_speed: rad/s (speeds,).
        values: of every unit at every speed, SI (units, speeds); not finite ones are left out.
        unit: SI unit of the values.
        name: of the response.
        limit: that is required, SI.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    turns, found = np.asarray(output_speed) / rpm, np.asarray(values) / size
    found = found[np.isfinite(found).all(axis=1)]
    low, middle, high, most = np.quantile(found, (0.05, 0.5, 0.95, 0.9973), axis=0)
    axes.fill_between(turns, low, high, color=AFTER, alpha=0.3, lw=0, label="90 % of the units")
    axes.plot(turns, middle, color=AFTER, lw=1.8, label="median")
    axes.plot(turns, most, color=PALETTE[7], ls="--", lw=1.2, label="99.73 % lie below")
    axes.plot(turns, found.max(axis=0), color="0.5", ls=":", lw=1.2, label=f"worst of {len(found)}")
    if limit is not None:
        axes.axhline(limit / size, color=LIMIT, lw=1.5, label="limit")
    axes.set(xlabel="output speed (r/min)", ylabel=f"{words(name)} ({shown})", xlim=(turns[0], turns[-1]))
    axes.set_ylim(0, None)
    axes.set_title(f"Spread of {words(name)} over speed")
    axes.legend(fontsize=9)
    return axes


def _lines(
    sweep: SpeedSweep, sun_speeds: Numbers, ratio: float, output: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Speeds of the output rad/s, orders, amplitudes (speeds, orders) in the unit that is read, and its name."""
    shown, size = readable("rad")
    height = np.abs(np.asarray(sweep.amplitude)[:, :, output]) / size
    return np.asarray(sun_speeds) / ratio, np.asarray(sweep.order), height, shown
