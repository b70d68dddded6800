"""Pictures of the dynamic transmission error: orders over speed, spectra, spread of a batch, shares of the errors."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm

from rvjax.dynamics import SpeedSweep
from rvjax.plotting.style import AFTER, HATCHES, LIMIT, PALETTE, new_axes, words
from rvjax.units import readable, rpm

DECADES = 3  # of amplitude that colours and spectra show below the largest


def campbell_amplitudes(
    sweep: SpeedSweep,
    sun_speeds: Any,
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
    lowest, top = largest / 10**DECADES, highest or _highest(turns, order)
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


def waterfall(
    sweep: SpeedSweep,
    sun_speeds: Any,
    *,
    ratio: float,
    highest: float | None = None,
    output: int = 0,
    spectra: int = 24,
    axes: Axes | None = None,
) -> Axes:
    """Spectra of one unit at one speed behind the other: each baseline is a speed, each line on it an order.

    Heights are logarithmic: three decades below the largest line of all they vanish.

    Args:
        sweep: of `dynamics.speed_sweep`.
        sun_speeds: of the sweep, rad/s (speeds,), ascending.
        ratio: sun turns for one of the output.
        highest: end of the frequency axis, Hz; by default that of the highest order.
        output: which of the sweep's outputs.
        spectra: that are drawn, spread over the speeds.
        axes: where to draw; a new figure by default.
    """
    axes = plt.subplots(figsize=(7, 5.2))[1] if axes is None else axes
    turns, order, height, shown = _lines(sweep, sun_speeds, ratio, output)
    picked = np.unique(np.linspace(0, len(turns) - 1, spectra).round().astype(int))
    step = (turns[-1] - turns[0]) / rpm / max(len(picked) - 1, 1)
    largest, end = height.max(initial=0) or 1.0, highest or _highest(turns, order)
    with np.errstate(divide="ignore"):
        rise = 4 * step * np.maximum(1 + np.log10(height / largest) / DECADES, 0)
    for number, place in enumerate(picked[::-1]):  # the fastest lies behind
        base = turns[place] / rpm
        axes.plot([0, end], [base, base], color="0.85", lw=0.6, zorder=2 * number)
        for k, n in enumerate(order):
            at = n * abs(turns[place]) / (2 * np.pi)
            axes.plot(
                [at, at], [base, base + rise[place, k]], color=PALETTE[k % len(PALETTE)], lw=1.8, clip_on=True,
                solid_capstyle="butt", zorder=2 * number + 1, label=f"{n:.4g}" if number == 0 else None,
            )  # fmt: skip
    axes.set(xlabel="frequency (Hz)", ylabel="output speed (r/min)", xlim=(0, end))
    axes.set_ylim(turns[0] / rpm - step, turns[-1] / rpm + 4 * step)
    axes.set_title(f"Spectra of one unit: {DECADES} decades in four steps, up to {largest:.3g} {shown}")
    axes.grid(visible=False)
    axes.legend(title="order per output turn", ncols=len(order), loc="upper right", fontsize=8, frameon=True)
    return axes


def batch_over_speed(
    output_speed: Any, values: Any, *, unit: str, name: str, limit: float | None = None, axes: Axes | None = None
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


def error_contributions(
    order: Any, power: Mapping[str, Any], *, unit: str, title: str, axes: Axes | None = None
) -> Axes:
    """What each error contributes to the vibration of a series of units at one speed, split by order.

    Args:
        order: per output turn (orders,).
        power: {error: mean square of each line, SI squared (orders,)}, of `dynamics.error_statistics` with the
            standard deviation of that error alone; independent errors add.
        unit: SI unit of the lines.
        title: says the speed.
        axes: where to draw; a new figure by default.
    """
    table = {name: np.asarray(values, float) / 2 for name, values in power.items()}  # mean square over time
    names = sorted(table, key=lambda name: table[name].sum())
    axes = plt.subplots(figsize=(7, 1.6 + 0.32 * len(names)))[1] if axes is None else axes
    shown, size = readable(unit)
    whole = sum(values.sum() for values in table.values()) or 1.0
    start = np.zeros(len(names))
    for k, n in enumerate(np.asarray(order)):
        share = np.array([table[name][k] for name in names]) / whole
        if share.any():
            colour, hatch = PALETTE[k % len(PALETTE)], HATCHES[k % len(HATCHES)]
            axes.barh(_words(names), share, left=start, color=colour, hatch=hatch, edgecolor="white", label=f"{n:.4g}")
            start += share
    axes.set(xlabel=f"share of the mean square; in all {np.sqrt(whole) / size:.3g} {shown} rms", title=title)
    axes.xaxis.set_major_formatter(lambda x, _: f"{100 * x:.0f} %")
    axes.grid(axis="y", visible=False)
    axes.legend(title="order per output turn", loc="lower right")
    return axes


def _lines(
    sweep: SpeedSweep, sun_speeds: Any, ratio: float, output: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Speeds of the output rad/s, orders, amplitudes (speeds, orders) in the unit that is read, and its name."""
    shown, size = readable("rad")
    height = np.abs(np.asarray(sweep.amplitude)[:, :, output]) / size
    return np.asarray(sun_speeds) / ratio, np.asarray(sweep.order), height, shown


def _highest(turns: np.ndarray, order: np.ndarray) -> float:
    return float(1.05 * order.max(initial=1) * np.abs(turns).max() / (2 * np.pi))


def _words(names: Sequence[str]) -> list[str]:
    """Field names as words."""
    return [words(name) for name in names]
