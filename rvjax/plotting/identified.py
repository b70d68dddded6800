"""Plots of an identification: curve, residual, and each element before and after."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import AFTER, BEFORE, LIMIT, PALETTE, new_axes, words
from rvjax.units import arcmin, arcsec, deg

MOST = 40
"""Most elements of one plot: those that the data move most."""


def measured_curve(
    angle: np.ndarray,
    error: np.ndarray,
    *,
    predicted_angle: np.ndarray,
    predicted: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    title: str,
    axes: Axes | None = None,
) -> Axes:
    """A measured transmission error and that of the identified unit.

    Args:
        angle: of the output, rad (n,).
        error: measured, rad (n,).
        predicted_angle: rad (k,).
        predicted: rad (k,).
        lower: of the band, rad (k,).
        upper: of the band, rad (k,).
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown = (angle >= predicted_angle[0]) & (angle <= predicted_angle[-1])
    axes.plot(angle[shown] / deg, error[shown] / arcsec, ".", color="0.6", ms=3, label="measured")
    degrees = predicted_angle / deg
    axes.fill_between(degrees, lower / arcsec, upper / arcsec, color=AFTER, alpha=0.25, lw=0, label="95 % band")
    axes.plot(degrees, predicted / arcsec, color=AFTER, label="identified unit")
    axes.set(xlabel="angle of the output (deg)", ylabel="arcsec", xlim=(degrees[0], degrees[-1]), title=title)
    axes.legend(loc="upper right", ncols=3)
    return axes


def residual_orders(residual: Mapping[str, np.ndarray], sd: float, *, axes: Axes | None = None) -> Axes:
    """Residual of each order of the identified unit, and the noise.

    Args:
        residual: {order: complex amplitude of each run, rad (runs,)}.
        sd: noise of a real number, rad.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    runs = max(len(values) for values in residual.values())
    width = 0.8 / runs
    for r in range(runs):
        places = np.arange(len(residual)) + (r - (runs - 1) / 2) * width
        sizes = [abs(values[r]) / arcsec for values in residual.values()]
        axes.bar(places, sizes, 0.9 * width, color=PALETTE[r % len(PALETTE)], label=f"run {r + 1}")
    # The amplitude of noise with sd in real and imaginary part stays below this in 95 % of the cases.
    axes.axhline(np.sqrt(-2 * np.log(0.05)) * sd / arcsec, color=LIMIT, ls="--", label="noise, 95 %")
    axes.set_xticks(range(len(residual)), [name.removeprefix("order ").lstrip("0") for name in residual])
    axes.set(xlabel="order of the output turn", ylabel="left over (arcsec)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=min(runs + 1, 5), fontsize=8)
    return axes


def loop(
    torque: np.ndarray,
    midline: np.ndarray,
    width: np.ndarray,
    predicted: np.ndarray,
    *,
    recorded: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Midline and branches of a measured torque-angle loop and the identified unit.

    Args:
        torque: of the bench, N m (n,).
        midline: measured, rad (n,).
        width: of the loop, rad (n,).
        predicted: midline of the unit, rad (n,).
        recorded: torque N m, angle rad, and branch of each sample: 1 rising, -1 falling, 0 not used (m,).
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    low, high = (midline - width / 2) / arcmin, (midline + width / 2) / arcmin
    axes.fill_between(torque, low, high, color="0.88", lw=0, label="measured loop" if recorded is None else "width")
    if recorded is not None:
        for branch, colour, label in ((0, "0.6", "not used"), (1, PALETTE[4], "rising"), (-1, PALETTE[3], "falling")):
            own = recorded[2] == branch
            if np.any(own):
                axes.plot(recorded[0][own], recorded[1][own] / arcmin, ".", color=colour, ms=2, label=label)
    axes.plot(torque, midline / arcmin, "o", color=BEFORE, ms=4, label="its midline")
    axes.plot(torque, predicted / arcmin, color=AFTER, label="identified unit")
    if torque[0] <= 0 <= torque[-1]:
        ends = [float(np.interp(0.0, torque, side)) for side in (low, high)]
        axes.plot([0.0, 0.0], ends, "|-", color=LIMIT, lw=1.4, label=f"{ends[1] - ends[0]:.3g} arcmin at zero torque")
    axes.set(xlabel="torque on the output (N m)", ylabel="arcmin")
    axes.legend(loc="upper left", markerscale=2 if recorded is not None else 1)
    return axes


def elements(
    names: Sequence[str],
    before: Mapping[str, tuple[float, float]],
    after: Mapping[str, tuple[float, float, float]],
    limits: Mapping[str, tuple[float, float]],
    *,
    verdict: Mapping[str, str],
    axes: Axes | None = None,
) -> Axes:
    """One bar for each element: the range of the drawing, the posterior interval, and the limits.

    Args:
        names: elements, from the top.
        before: {element: 95 % interval of the prior}, in its own unit.
        after: {element: (value, lower, upper)}.
        limits: {element: limits of the drawing}; every bar is in half-widths about their mid-point.
        verdict: {element: "identified", "combination" or "unseen"}.
        axes: where to draw; a new figure by default.
    """
    names = list(names)[:MOST]
    axes = new_axes(axes, (7, 1.3 + 0.22 * len(names)))
    colours = {"identified": AFTER, "combination": PALETTE[4], "unseen": "0.55"}
    for row, name in enumerate(reversed(names)):
        middle, half = (limits[name][0] + limits[name][1]) / 2, (limits[name][1] - limits[name][0]) / 2
        place = lambda x, middle=middle, half=half: (x - middle) / half  # noqa: E731
        low, high = map(place, before[name])
        axes.barh(row, high - low, 0.7, left=low, color="0.88", label="drawing, 95 %" if row == 0 else None)
        value, low, high = map(place, after[name])
        axes.barh(row, high - low, 0.34, left=low, color=colours[verdict[name]])
        axes.plot(value, row, "|", color="black", ms=9)
    for side in (-1, 1):
        axes.axvline(side, color=LIMIT, ls="--", lw=1.2, label="limit" if side == 1 else None)
    for kind in dict.fromkeys(verdict[name] for name in names):
        axes.barh(0, 0, color=colours[kind], label=kind)
    axes.set_yticks(range(len(names)), [words(name).replace("[", " [") for name in reversed(names)], fontsize=8)
    axes.set(xlabel="half-widths of the tolerance about its middle", ylim=(-0.7, len(names) - 0.3))
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=5, fontsize=8)
    return axes


def shares(groups: Mapping[str, Mapping[str, float]], *, least: float = 0.01, axes: Axes | None = None) -> Axes:
    """Share of each field in each group of the observation; a negative share cancels others.

    Args:
        groups: {group: {field: share}}.
        least: share below which a field is not plotted.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    fields = [f for f in next(iter(groups.values())) if any(abs(group[f]) >= least for group in groups.values())]
    places = np.arange(len(groups))[::-1]
    left, right = np.zeros(len(groups)), np.zeros(len(groups))
    for k, name in enumerate(fields):
        sizes = 100 * np.array([group[name] for group in groups.values()])
        start = np.where(sizes >= 0, right, left)
        axes.barh(places, sizes, 0.6, left=start, color=PALETTE[k % len(PALETTE)], edgecolor="white", label=words(name))
        right, left = right + np.maximum(sizes, 0), left + np.minimum(sizes, 0)
    axes.set_yticks(places, [name.replace("order 0", "order ").replace("order 0", "order ") for name in groups])
    axes.axvline(0, color=BEFORE, lw=1)
    axes.set(xlabel="share of the curve (%)")
    axes.grid(axis="y", visible=False)
    if axes.get_legend_handles_labels()[0]:  # nothing was found, nothing is named
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8)
    return axes


def known_numbers(
    numbers: Mapping[str, int], benches: Mapping[str, Mapping[str, float]], *, axes: Axes | None = None
) -> Axes:
    """Share of the parameters of each error that benches identify.

    Args:
        numbers: {field: how many numbers it has}.
        benches: {bench: {field: how many of them it identifies}}.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    rows = np.arange(len(numbers))[::-1]
    height = 0.8 / len(benches)
    for k, (bench, known) in enumerate(benches.items()):
        sizes = [100 * known[name] / count for name, count in numbers.items()]
        places = rows + (len(benches) / 2 - 0.5 - k) * height
        axes.barh(places, sizes, 0.9 * height, color=PALETTE[k % len(PALETTE)], label=bench)
    axes.set_yticks(rows, [f"{words(name)} ({count})" for name, count in numbers.items()], fontsize=8)
    axes.set(xlabel="of its numbers, known (%)", xlim=(0, 100))
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower right", fontsize=8)
    return axes
