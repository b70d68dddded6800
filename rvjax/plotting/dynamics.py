"""Natural frequencies and orders over speed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm

from rvjax.dynamics import Modes, SpeedSweep
from rvjax.plotting.style import PALETTE, Numbers, new_axes
from rvjax.units import readable, rpm

DECADES = 3  # of amplitude that colours show below the largest
KIND_STYLES = {
    "rotational": (PALETTE[0], "-"),
    "translational": (PALETTE[5], "--"),
    "planetary": (PALETTE[2], ":"),
    "disc": (PALETTE[3], "-."),
    "coupled": (PALETTE[7], "-"),
}


def campbell(
    found: Modes,
    speed: Numbers,
    mesh_frequency: Numbers,
    *,
    harmonics: Mapping[int, str],
    highest: float = 2500.0,
    axes: Axes | None = None,
) -> Axes:
    """Natural frequencies and mesh harmonics over speed; a dot where a harmonic meets a kind that it excites.

    A harmonic has the colour of the kind that it excites.

    Args:
        found: modes of the reducer.
        speed: sun speed, rad/s (n,).
        mesh_frequency: fundamental of the stage at each speed, Hz (n,).
        harmonics: {order: kind of mode that it excites}.
        highest: top of the frequency axis, Hz.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    turns, lines = np.asarray(speed) / rpm, np.asarray(mesh_frequency)
    frequency, kind = np.asarray(found.frequency), found.kind
    for name in dict.fromkeys(kind):
        shown = frequency[(kind == name) & (frequency < highest)]
        colour, dash = KIND_STYLES[name]
        for k, value in enumerate(shown):
            axes.axhline(value, color=colour, ls=dash, lw=1.2, label=name if k == 0 else None)
    for order, name in harmonics.items():
        axes.plot(turns, order * lines, color=KIND_STYLES[name][0], lw=0.8, alpha=0.6)
        inside = np.flatnonzero(order * lines <= highest)
        end = inside[-1]
        axes.annotate(
            f" {order}", (turns[end], order * lines[end]), fontsize=8, color=KIND_STYLES[name][0], xytext=(0, 1),
            textcoords="offset points", ha="left", annotation_clip=False,
        )  # fmt: skip
        for value in frequency[(kind == name) & (frequency < highest)]:
            if order * lines[0] <= value <= order * lines[-1]:
                at = np.interp(value, order * lines, turns)
                axes.plot(at, value, "o", ms=4, color=KIND_STYLES[name][0])
    axes.set(xlabel="sun speed (r/min)", ylabel="frequency (Hz)", xlim=(turns[0], turns[-1]), ylim=(0, highest))
    axes.set_title("Natural frequencies and mesh harmonics (numbers); dots: excited", pad=14)
    axes.grid(visible=False)
    axes.legend(loc="upper left", frameon=True, framealpha=0.9)
    return axes


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


def _lines(
    sweep: SpeedSweep, sun_speeds: Numbers, ratio: float, output: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Speeds of the output rad/s, orders, amplitudes (speeds, orders) in the unit that is read, and its name."""
    shown, size = readable("rad")
    height = np.abs(np.asarray(sweep.amplitude)[:, :, output]) / size
    return np.asarray(sun_speeds) / ratio, np.asarray(sweep.order), height, shown
