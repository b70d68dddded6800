"""Plots of bearing lives: who fails first, under which load; life against torque; phases of a duty."""

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter
from numpy.typing import ArrayLike

from rvjax.plotting.style import AFTER, BEFORE, DASHES, LIMIT, PALETTE, new_axes
from rvjax.units import rpm

HOUR = 3600.0


def first_failures(
    bearings: Sequence[str], share: ArrayLike, orders: Sequence[str], force: ArrayLike, *, weakest: str
) -> Figure:
    """Probability that each bearing fails first, left; orders in the force of the weakest arm bearing, right.

    Args:
        bearings: names (b,).
        share: probabilities (b,), sum 1.
        orders: names of the shown orders (k,).
        force: at the centre of the tolerances, and root mean square over the units (k, 2) N.
        weakest: name of the arm bearing.
    """
    share, force = np.asarray(share), np.asarray(force)
    size = (9.6, 0.36 * max(len(bearings), len(orders)) + 1.6)
    figure, (left, right) = plt.subplots(1, 2, figsize=size, layout="constrained", gridspec_kw={"wspace": 0.1})
    left.barh(range(len(share)), 100 * share, color=AFTER)
    for row, value in enumerate(share):
        left.text(100 * value, row, f" {100 * value:.0f}", va="center", fontsize=9)
    left.set_yticks(range(len(share)), bearings)
    left.set(xlabel="probability to fail first (%)", title="Which bearing fails first")
    rows = np.arange(len(orders))
    right.barh(rows - 0.2, force[:, 0] / 1e3, height=0.4, color=AFTER, label="errors at the centre of their limits")
    right.barh(rows + 0.2, force[:, 1] / 1e3, height=0.4, color=BEFORE, hatch="//", edgecolor="white",
               label="root mean square over the units")  # fmt: skip
    right.set_yticks(rows, orders)
    right.set(xlabel="amplitude (kN)", title=f"Force on {weakest}, by order")
    right.legend(loc="upper center", bbox_to_anchor=(0.4, -0.16), fontsize=8)
    left.margins(x=0.12)
    for axes in (left, right):
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
    return figure


def life_against_torque(
    torque: ArrayLike,
    life: ArrayLike,
    *,
    low: float,
    speeds: Sequence[float],
    speed: float,
    limit: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Life of all bearings of a unit against a constant torque, at several speeds; the spread of the units at one.

    Args:
        torque: (t,) N m.
        life: with errors at the centre of their limits; low, 50 % and high quantile over the units, at `speed`
            (t, 4) s.
        low: share of the units below the low quantile, and above the high one.
        speeds: of the output, rad/s: life is in inverse proportion to the speed.
        speed: of the lives, rad/s.
        limit: s, or None.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    torque, life = np.asarray(torque), np.asarray(life) / HOUR
    for dash, one in zip(DASHES, speeds):
        label = f"{one / rpm:.4g} r/min, errors at the centre of their limits"
        axes.plot(torque, life[:, 0] * speed / one, dash, color=AFTER, label=label)
    axes.fill_between(torque, life[:, 1], life[:, 3], color=BEFORE, alpha=0.35, lw=0,
                      label=f"{speed / rpm:.4g} r/min, {100 - 200 * low:g} % of the units")  # fmt: skip
    axes.plot(torque, life[:, 2], color=BEFORE, label=f"{speed / rpm:.4g} r/min, median unit")
    if limit is not None:
        axes.axhline(limit / HOUR, color=LIMIT, lw=1.5, label=f"limit {limit / HOUR:.4g} h")
    axes.set(xscale="log", yscale="log", xlabel="output torque (N m)", ylabel="life (h)")
    axes.set_title("Life of the rated bearings against torque and speed")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(lambda *_: "")
    axes.legend(fontsize=8)
    return axes


def phase_shares(names: Sequence[str], time: ArrayLike, damage: ArrayLike, *, axes: Axes | None = None) -> Axes:
    """Share of each phase of a duty in the time and in the damage.

    Args:
        names: of the phases (p,).
        time: shares (p,).
        damage: shares (p,).
        axes: where to draw; a new figure by default.
    """
    axes = plt.subplots(figsize=(7, 2.6))[1] if axes is None else axes
    left = np.zeros(2)
    for k, (name, *shares) in enumerate(zip(names, np.asarray(time), np.asarray(damage))):
        width = 100 * np.asarray(shares)
        axes.barh((0, 1), width, left=left, color=PALETTE[k % len(PALETTE)], edgecolor="white", height=0.6, label=name)
        for row in range(2):
            if width[row] >= 5:
                box = dict(facecolor="white", edgecolor="none", pad=1.0, alpha=0.85)
                axes.text(left[row] + width[row] / 2, row, f"{width[row]:.0f}", ha="center", va="center", bbox=box)
        left += width
    axes.set_yticks((0, 1), ("time", "damage"))
    axes.invert_yaxis()
    axes.set(xlabel="share (%)", xlim=(0, 100), title="Phases of the duty")
    axes.grid(axis="y", visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.28), ncols=2, fontsize=8)
    return axes
