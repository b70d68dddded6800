"""Bars by name, side by side or stacked, and the plots of results that are bars."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from rvjax.plotting.style import AFTER, AFTER_BARS, BEFORE, BEFORE_BARS, LIMIT, PALETTE, Looks, look, new_axes, words
from rvjax.units import arcsec

MOST = 40
"""Most elements of one plot: those that the data move most."""


def bars(
    names: Sequence[str],
    rows: Mapping[str, ArrayLike],
    *,
    xlabel: str,
    title: str = "",
    looks: Looks | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Horizontal bars, side by side for each name.

    Args:
        names: of the groups, from the top (n,).
        rows: {set: sizes in the unit of the axis (n,)}.
        xlabel: name of the sizes with their unit.
        title: of the plot.
        looks: {set: options of Matplotlib for its bars}.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    places, thick = np.arange(len(names))[::-1], 0.76 / len(rows)
    for k, (name, sizes) in enumerate(rows.items()):
        default = {"color": PALETTE[k % len(PALETTE)], "label": name}
        shift = ((len(rows) - 1) / 2 - k) * thick
        axes.barh(places + shift, sizes, 0.95 * thick, **{**default, **(looks or {}).get(name, {})})
    axes.set_yticks(places, list(names))
    axes.set(xlabel=xlabel, title=title)
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower right")
    return axes


def stacked_bars(
    rows: Mapping[str, Mapping[str, float]],
    *,
    xlabel: str,
    title: str = "",
    looks: Sequence[tuple[str, str]] | None = None,
    least: float = 6.0,
    axes: Axes | None = None,
) -> Axes:
    """Horizontal bars of several parts, with the number of each large part in it; negative parts extend to the left.

    Args:
        rows: {bar, from the top: {part: width}}; all have the parts of the first.
        xlabel: name of the widths with their unit.
        title: of the plot.
        looks: colour and hatch of each part.
        least: width from which on a part shows its number.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    places, left, right = np.arange(len(rows))[::-1], np.zeros(len(rows)), np.zeros(len(rows))
    for k, part in enumerate(next(iter(rows.values()))):
        widths = np.array([row[part] for row in rows.values()])
        starts = np.where(widths >= 0, right, left)
        colour, hatch = looks[k] if looks else look(k)
        axes.barh(places, widths, 0.6, starts, color=colour, hatch=hatch, edgecolor="white", label=words(part))
        for place, width, start in zip(places, widths, starts):
            if width >= least:
                box = dict(facecolor="white", edgecolor="none", pad=1.0, alpha=0.85)
                axes.text(start + width / 2, place, f"{width:.0f}", ha="center", va="center", bbox=box, fontsize=9)
        left, right = left + np.minimum(widths, 0), right + np.maximum(widths, 0)
    axes.set_yticks(places, list(rows))
    axes.set(xlabel=xlabel, title=title)
    axes.grid(axis="y", visible=False)
    return axes


def variance_shares(shares: Mapping[str, Mapping[str, float]], *, title: str, axes: Axes | None = None) -> Axes:
    """Share of each error in the variance of each response, as stacked bars.

    Args:
        shares: {response: {field: share}}.
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    rows = {words(name): {f: 100 * share for f, share in own.items()} for name, own in reversed(list(shares.items()))}
    axes = stacked_bars(rows, xlabel="share of variance (%)", title=title, axes=axes)
    axes.set_xlim(0, 100)
    # Below the names of the rows too.
    axes.legend(loc="upper center", bbox_to_anchor=(0.36, -0.18), ncols=3, fontsize=9)
    return axes


def phase_shares(names: Sequence[str], time: ArrayLike, damage: ArrayLike, *, axes: Axes | None = None) -> Axes:
    """Share of each phase of a duty in the time and in the damage.

    Args:
        names: of the phases (p,).
        time: shares (p,).
        damage: shares (p,).
        axes: where to draw; a new figure by default.
    """
    rows = {of: dict(zip(names, 100 * np.asarray(values))) for of, values in (("time", time), ("damage", damage))}
    looks = [(PALETTE[k % len(PALETTE)], "") for k in range(len(names))]
    axes = new_axes(axes, (7, 2.6))
    stacked_bars(rows, xlabel="share (%)", title="Phases of the duty", looks=looks, least=5, axes=axes)
    axes.set_xlim(0, 100)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.28), ncols=2, fontsize=8)
    return axes


def observation_shares(groups: Mapping[str, Mapping[str, float]], *, axes: Axes | None = None) -> Axes:
    """Share of each field in each group of an observation, from 1 %; a negative share cancels others.

    Args:
        groups: {group: {field: share}}.
        axes: where to draw; a new figure by default.
    """
    fields = [f for f in next(iter(groups.values())) if any(abs(group[f]) >= 0.01 for group in groups.values())]
    rows = {name.replace("order 0", "order ").replace("order 0", "order "): own for name, own in groups.items()}
    rows = {name: {field: 100 * own[field] for field in fields} for name, own in rows.items()}
    looks = [(PALETTE[k % len(PALETTE)], "") for k in range(len(fields))]
    axes = stacked_bars(rows, xlabel="share of the curve (%)", looks=looks, least=np.inf, axes=axes)
    axes.axvline(0, color=BEFORE, lw=1)
    if fields:  # nothing was found, nothing is named
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8)
    return axes


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
    whole = dict(zip(("errors at the centre of their limits", "root mean square over the units"), force.T / 1e3))
    looks = dict(zip(whole, (AFTER_BARS, BEFORE_BARS)))
    bars(orders, whole, xlabel="amplitude (kN)", title=f"Force on {weakest}, by order", looks=looks, axes=right)
    right.legend(loc="upper center", bbox_to_anchor=(0.4, -0.16), fontsize=8)
    left.margins(x=0.12)
    left.invert_yaxis()
    left.grid(axis="y", visible=False)
    return figure


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


def identified_elements(
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


def error_budget(budget: Any, *, orders: int = 8) -> Figure:
    """Shares of the parts under every load, above; root mean square of the largest orders and their parts, below.

    Args:
        budget: a `rvjax.commands.budget.Budget`.
        orders: number of plotted orders of the output revolution.
    """
    unit, size = ("arcsec", arcsec) if budget.unit == "rad" else (budget.unit, 1.0)
    shares = {load: budget.shares("part", load) for load in budget.torque}
    parts = sorted(dict.fromkeys(budget.part.values()), key=lambda part: -sum(share[part] for share in shares.values()))
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.6, 6.8), height_ratios=(1, 1.6))
    loads = {load: f"{torque:.4g} N m" for load, torque in budget.torque.items()}
    rows = {
        name if load == name else f"{words(load)}\n{name}": {part: 100 * shares[load][part] for part in parts}
        for load, name in loads.items()
    }
    stacked_bars(rows, xlabel="share of the variance (%)", title=f"Error budget: {budget.title}", axes=above)
    above.set_xlim(0, 100)
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.32), ncols=4)
    largest = np.max([budget.total[load] for load in loads], axis=0)[1:]
    shown = np.sort(1 + np.argsort(-largest, kind="stable")[:orders])
    thick = 0.8 / len(loads)
    for n, load in enumerate(loads):
        at = np.arange(len(shown)) + (n - (len(loads) - 1) / 2) * thick
        owned = budget.by("part", load)
        whole = np.maximum(np.sum(list(owned.values()), axis=0)[shown], np.finfo(float).tiny)
        height, bottom = np.sqrt(budget.total[load][shown]) / size, np.zeros(len(shown))
        for k, part in enumerate(parts):  # a bar is as high as the order, divided as its mean square is
            piece = height * owned[part][shown] / whole
            colour, hatch = look(k)
            below.bar(at, piece, 0.92 * thick, bottom=bottom, color=colour, hatch=hatch, edgecolor="white")
            bottom += piece
        for x, y in zip(at, height):
            below.text(x, y, words(load), rotation=90, ha="center", va="bottom", fontsize=7, color="0.35")
    below.set_xticks(np.arange(len(shown)), [f"{order:.4g}" for order in budget.orders[shown]])
    below.margins(y=0.22)
    below.set(xlabel="order of the output turn", ylabel=f"rms over the units ({unit})")
    below.grid(axis="x", visible=False)
    return figure
