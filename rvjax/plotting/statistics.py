"""Plots of an allocation: before is always the light dashed one, after the dark solid one.

Plot of an allocation: cost of each tolerance, before and after.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import (
    AFTER,
    BEFORE,
    LIMIT,
    Numbers,
    limit_lines,
    look,
    new_axes,
    readable_bins,
    stacked_bars,
    words,
)
from rvjax.units import readable


def cost_bars(
    before: Mapping[str, float],
    after: Mapping[str, float],
    *,
    notes: Mapping[str, str] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Cost of each tolerance before and after, with the sums in the legend.

    Args:
        before: {field: cost} of the tolerances of the study.
        after: {field: cost} of the allocated ones.
        notes: {field: text at the bars}, such as the two tolerances.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    rows = np.arange(len(before))[::-1]
    for shift, costs, colour, hatch, name in (
        (0.19, before, BEFORE, "//", "before"),
        (-0.19, after, AFTER, "", "after"),
    ):
        label = f"{name}, {sum(costs.values()):.2f} in all"
        widths = [costs[field] for field in before]
        axes.barh(rows + shift, widths, 0.36, color=colour, hatch=hatch, edgecolor="white", label=label)
    for row, field in zip(rows, before):
        place = (max(before[field], after[field]), row)
        text = (notes or {}).get(field, "")
        axes.annotate(text, place, xytext=(6, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_yticks(rows, [words(field) for field in before])
    axes.set(xlabel="cost (units of the study)", xlim=(0, 1.45 * max(*before.values(), *after.values())))
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower right")
    return axes


def unit_curves(
    angle: Numbers,
    before: Numbers,
    after: Numbers,
    title: str,
    unit: str,
    *,
    read_in: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """A response of sample units over one cycle, before and after; angles about their own mean.

    Args:
        angle: rad (n,), uniform over the cycle.
        before: values, SI (units, n), with the tolerances of the study.
        after: the same with the allocated tolerances.
        title: of the plot.
        unit: SI unit of the values; a mean angle is an offset of assembly and is taken away.
        read_in: measurement unit of the plot; by default the usual one of responses in `unit`.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit, read_in)
    end = np.degrees(2 * angle[-1] - angle[-2])
    closed = np.append(np.degrees(angle), end)
    for curves, colour, dash, label in ((after, AFTER, "-", "after"), (before, BEFORE, (0, (4, 2)), "before")):
        values = np.asarray(curves) / size
        values = values - values.mean(axis=1, keepdims=True) if unit == "rad" else values
        lines = axes.plot(closed, np.column_stack([values, values[:, :1]]).T, color=colour, ls=dash, lw=0.8, alpha=0.7)
        lines[0].set_label(f"{label} ({len(values)} units)")
    axes.set(xlabel="angle (deg)", ylabel=f"{shown}", xlim=(0, end), title=title)
    if np.isclose(end, 360):
        axes.set_xticks(range(0, 361, 60))
    axes.legend(loc="upper right", ncols=2)
    return axes


def response_histogram(
    before: Numbers,
    after: Numbers,
    *,
    unit: str,
    name: str,
    upper: float = np.inf,
    lower: float = -np.inf,
    read_in: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Distribution of a response before and after, with its limits.

    Args:
        before: values of the response, SI (samples,), with the tolerances of the study.
        after: the same with the allocated tolerances.
        unit: SI unit of the response.
        name: of the response.
        upper: upper limit, SI.
        lower: lower limit, SI.
        read_in: measurement unit of the plot; by default the usual one of responses in `unit`.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit, read_in)
    whole = [np.asarray(v)[~np.isnan(v)] / size for v in (before, after)]
    values = [v[np.isfinite(v)] for v in whole]
    bins = readable_bins(axes, np.concatenate(values), 80, shown)
    looks: Any = (dict(histtype="step", color=BEFORE, lw=1.6, ls="--"), dict(color=AFTER, alpha=0.75))
    for label, all_of, finite, drawn in reversed(list(zip(("before", "after"), whole, values, looks))):
        if finite.size:  # every unit may have failed
            endless = len(all_of) - len(finite)
            text = f"{label}, {endless:,} of {len(all_of):,} units infinite" if endless else label
            weights = np.full(len(finite), 1 / (len(all_of) * bins.step))
            axes.hist(finite, bins.edges, weights=weights, label=text, **drawn)
    limit_lines(axes, (lower, upper), shown, size)
    axes.set(xlabel=f"{words(name)} ({shown}){bins.beyond}", ylabel=f"density (1/{bins.per})")
    axes.set_title(f"Distribution of {words(name)}")
    axes.legend()
    return axes


def variance_shares(shares: Mapping[str, Mapping[str, float]], *, title: str, axes: Axes | None = None) -> Axes:
    """Share of each error in the variance of each response, as stacked bars.

    Args:
        shares: {response: {field: share}}.
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    fields, rows = next(iter(shares.values())), np.arange(len(shares))
    widths = {field: np.array([100 * shares[name][field] for name in shares]) for field in fields}
    stacked_bars(axes, rows, widths, map(look, range(len(widths))), least=6)
    axes.set_yticks(rows, [words(name) for name in shares])
    axes.set(xlabel="share of variance (%)", xlim=(0, 100), title=title)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.36, -0.18), ncols=3, fontsize=9
    )  # below the names of the rows too
    return axes


def cost_against_yield(
    targets: Sequence[float],
    costs: Sequence[float],
    *,
    chosen: tuple[float, float],
    start: tuple[float, float],
    axes: Axes | None = None,
) -> Axes:
    """Cheapest cost for each yield; the yield axis is stretched towards 1.

    Args:
        targets: yields that every requirement must reach, 0 to 1.
        costs: cheapest cost for each.
        chosen: (yield, cost) of the allocation.
        start: (yield, cost) of the tolerances of the study.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    rejects = [1 - share for share in (*targets, chosen[0], start[0])]
    seen = [rejected for rejected in rejects[:-1] if rejected > 0]
    floor = min(seen, default=1e-6) / 3  # yields beyond the range of the plot are shown at its edge
    *rejects, rejected, rejected_before = np.maximum(rejects, floor)
    axes.plot(rejects, costs, "o-", color=AFTER, label="cheapest tolerances")
    axes.plot(rejected, chosen[1], "*", ms=15, color=LIMIT, label="this study", zorder=3)
    axes.plot(rejected_before, start[1], "s", ms=8, color=BEFORE, label="before", zorder=3)
    axes.set_xscale("log")
    axes.invert_xaxis()
    ticks: list[float] = []
    for steps in ((1,), (1, 2, 5), range(1, 10)):  # finer where decades label less than two places
        ends = floor, 1.05 * max(*rejects, rejected)
        ticks = [t for k in range(1, 7) for step in steps if ends[0] <= (t := step * 10.0**-k) <= ends[1]]
        if len(ticks) > 1:
            break
    axes.set_xticks(ticks, [f"{100 * (1 - t):.6g}" for t in ticks])
    axes.set_xticks([], minor=True)
    axes.set(xlabel="yield of each requirement (%)", ylabel="cost", title="Cost against yield")
    axes.legend()
    return axes


def trade_front(
    points: Sequence[tuple[float, float]],
    *,
    chosen: tuple[float, float],
    others: Mapping[str, tuple[float, float]],
    label: str,
    uncertified: Sequence[tuple[float, float]] = (),
    axes: Axes | None = None,
) -> Axes:
    """Cost of the tolerances against the cost of priced outputs, for optima at several prices.

    Args:
        points: (priced outputs, tolerances) of each optimum.
        chosen: the optimum at the prices of the study.
        others: further points, by name; the first one is the study before.
        label: of the priced outputs.
        uncertified: optima whose certificate does not hold; hollow, off the line.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    axes.plot(*zip(*sorted(points)), "o-", color=AFTER, label="optima at other prices")
    if uncertified:
        axes.plot(*zip(*uncertified), "o", mfc="white", color=AFTER, label="at other prices, not certified", zorder=3)
    axes.plot(*chosen, "*", ms=15, color=LIMIT, label="joint optimum", zorder=4)
    for number, (name, point) in enumerate(others.items()):
        axes.plot(*point, "Ds"[number == 0], ms=8, color=look(2)[0] if number else BEFORE, label=name, zorder=3)
    axes.set(xlabel=f"cost of {label}", ylabel="cost of the tolerances", title="Trade front")
    axes.legend()
    return axes


def cost_against_limit(
    limits: Sequence[float],
    costs: Sequence[float],
    *,
    unit: str,
    name: str,
    prices: Sequence[float] | None = None,
    chosen: tuple[float, float] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Cheapest cost for each limit of a requirement; limits that cannot be met are shaded.

    Args:
        limits: SI.
        costs: cheapest cost for each, nan where the requirements cannot be met.
        unit: SI unit of the limit.
        name: of the response.
        prices: d cost / d limit at each limit, SI, plotted as short tangents.
        chosen: (limit, cost) of the study, SI.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    order = np.argsort(limits)
    x, y = np.asarray(limits, float)[order] / size, np.asarray(costs, float)[order]
    met = np.isfinite(y)
    axes.plot(x[met], y[met], "o-", color=AFTER, label="cheapest tolerances")
    if prices is not None:
        slopes = np.asarray(prices, float)[order] * size
        reach = 0.04 * (x[-1] - x[0])
        tangents = np.array([[x - reach, x + reach], [y - slopes * reach, y + slopes * reach]])
        lines = axes.plot(*tangents[:, :, met & np.isfinite(slopes)], color=LIMIT, lw=1.5)
        if lines:
            lines[0].set_label("shadow price")
    if not met.all():
        ends = [x[~met].min(), x[~met].max()]
        if met.any():  # half-way to the neighbour that is met, on the side where it lies
            side = int(x[met].mean() > x[~met].mean())
            ends[side] = (ends[side] + (x[met].min() if side else x[met].max())) / 2
        axes.axvspan(*ends, color="0.85", label="cannot be met")
    if chosen is not None:
        axes.plot(chosen[0] / size, chosen[1], "*", ms=15, color=LIMIT, label="this study", zorder=3)
    axes.set(
        xlabel=f"limit of {words(name)} ({shown})", ylabel="cost", title=f"Cost against the limit of {words(name)}"
    )
    axes.legend()
    return axes
