"""Plots of results: distributions with their limits, costs and trade-offs.

Costs of each tolerance, against yield, against priced outputs; error against time.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from rvjax.levels import Level, Model, Table
from rvjax.plotting.bars import bars
from rvjax.plotting.style import (
    AFTER,
    AFTER_BARS,
    BEFORE,
    BEFORE_BARS,
    LIMIT,
    PALETTE,
    Numbers,
    limit_lines,
    new_axes,
    style,
    words,
)
from rvjax.units import readable

_OUTLINES = ((BEFORE, "--", 1.6), (PALETTE[7], "-", 1.2), (PALETTE[2], "-.", 1.2))  # colour, dash, width


def histogram(
    batches: Mapping[str, Numbers],
    *,
    unit: str,
    name: str,
    limits: Sequence[float] = (),
    read_in: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Distribution of a response in several batches of units, with its limits; the first is filled.

    Args:
        batches: {batch: values, SI (units,)}; failed units, NaN, and infinite values are missing from its area.
        unit: SI unit of the response.
        name: of the response.
        limits: SI; infinite ones have no line.
        read_in: measurement unit of the plot; by default the usual one of responses in `unit`.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit, read_in)
    whole = {label: np.asarray(v) / size for label, v in batches.items()}
    bins = readable_bins(axes, np.concatenate([v[np.isfinite(v)] for v in whole.values()]), 80, shown)
    for k, (label, values) in enumerate(whole.items()):
        finite, text = values[np.isfinite(values)], words(label)
        for count, what in ((np.isinf(values).sum(), "infinite"), (np.isnan(values).sum(), "failed")):
            text += f", {count:,} of {len(values):,} units {what}" if count else ""
        if finite.size:  # every unit may have failed
            weights = np.full(len(finite), 1 / (len(values) * bins.step))
            outline: Any = dict(zip(("color", "ls", "lw"), _OUTLINES[(k - 1) % 3]), histtype="step")
            drawn: Any = outline if k else {"color": AFTER, "alpha": 0.75}
            axes.hist(finite, bins.edges, weights=weights, label=text, **drawn)
    limit_lines(axes, limits, shown, size)
    axes.set(xlabel=f"{words(name)} ({shown}){bins.beyond}", ylabel=f"density (1/{bins.per})")
    axes.set_title(f"Distribution of {words(name)}")
    axes.legend()
    return axes


_BODY = 20  # part of an axis that the middle 90 % of the values have, at least


@dataclass(frozen=True)
class Bins:
    """Bins of a histogram whose middle 90 % of the values have a twentieth of the axis or more.

    Attributes:
        edges: ends of the bins, in the unit of the axis.
        step: width of each, or on a logarithmic axis its decades.
        per: measurement unit of this width.
        beyond: text on the values outside, for the label of the axis; "" without any.
    """

    edges: Any  # (bins + 1,)
    step: float
    per: str
    beyond: str


def readable_bins(axes: Axes, values: np.ndarray, count: int, unit: str) -> Bins:
    """Bins for values of any distribution.

    The axis becomes logarithmic for positive values whose extremes are far from the others, such as lives. It ends at
    four widths of the middle 90 % where that does not suffice.

    Args:
        axes: whose scale is set.
        values: finite, in the unit of the axis.
        count: of the bins.
        unit: of the axis.
    """
    values = np.zeros(1) if not values.size else values
    (low, high), all_shown = _ends(values)
    per = unit
    if not all_shown and values.min() > 0:
        (low, high), _ = _ends(np.log10(values))
        axes.set_xscale("log")
        per = "decade"
    edges = np.linspace(low, high, count + 1)
    step = edges[1] - edges[0]
    if per == "decade":
        edges, ends = 10**edges, np.array([values.min(), values.max()])
        edges[[0, -1]] = np.where(np.isclose(edges[[0, -1]], ends, rtol=1e-9, atol=0), ends, edges[[0, -1]])
    outside = float(np.mean((values < edges[0]) | (values > edges[-1])))
    return Bins(edges, float(step), per, f"; {100 * outside:.2g} % of the units are beyond the axis" if outside else "")


def _ends(values: np.ndarray) -> tuple[tuple[float, float], bool]:
    """Ends of an axis, and whether they are those of the values."""
    low, high = float(values.min()), float(values.max())
    first, last = np.quantile(values, [0.05, 0.95])
    if low == high:
        return (low - 0.5, high + 0.5), True
    if not 0 < last - first < (high - low) / _BODY:
        return (low, high), True
    return (max(low, first - 2 * (last - first)), min(high, last + 2 * (last - first))), False


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
    first, last = (f"{n}, {sum(c.values()):.2f} in all" for n, c in (("before", before), ("after", after)))
    rows = {first: list(before.values()), last: [after[field] for field in before]}
    looks = {first: BEFORE_BARS, last: AFTER_BARS}
    axes = bars([words(f) for f in before], rows, xlabel="cost (units of the study)", looks=looks, axes=axes)
    for row, field in enumerate(reversed(list(before))):
        place, text = (max(before[field], after[field]), row), (notes or {}).get(field, "")
        axes.annotate(text, place, xytext=(6, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_xlim(0, 1.45 * max(*before.values(), *after.values()))
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
        axes.plot(*point, "Ds"[number == 0], ms=8, color=PALETTE[2] if number else BEFORE, label=name, zorder=3)
    axes.set(xlabel=f"cost of {label}", ylabel="cost of the tolerances", title="Trade front")
    axes.legend()
    return axes


def pareto(model: Model, *, axes: Axes | None = None) -> Axes:
    """Largest error against time per case of the levels of one model, both logarithmic.

    Filled: float64, hollow: float32. The line joins the levels that no other beats in both; the reference, whose
    error is zero by definition, is at the bottom.

    Args:
        model: measured.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown = [level for level in model.levels if math.isfinite(model.relative(level))]
    positive = [model.relative(level) for level in shown if model.relative(level) > 0]
    floor = min(positive) / 10 if positive else 1e-16
    front = [level for level in model.front() if level in shown]

    def place(level: Level) -> tuple[float, float]:
        return level.ns, max(model.relative(level), floor)

    axes.plot(*zip(*map(place, front)), color="0.6", lw=1.2, zorder=1)
    kinds = list(dict.fromkeys(level.name.split(",")[0] for level in shown))
    for level in shown:
        colour = PALETTE[kinds.index(level.name.split(",")[0]) % len(PALETTE)]
        face = colour if level.precision == "float64" else "white"
        marker = "*" if level.name == model.reference else "o"
        axes.scatter(*place(level), s=90 if marker == "*" else 36, marker=marker, facecolors=face, edgecolors=colour)
    slowest, fastest = (pick(level.ns for level in shown) for pick in (max, min))
    named: list[Level] = []
    for level in front:
        if named and model.relative(level) > 0.6 * model.relative(named[-1]):
            continue  # little better than its neighbour: the names would cover each other
        named.append(level)
        # The front falls to the right: above it there is space on the right, below it on the left.
        right = (level.ns / fastest) ** 2 < slowest / fastest
        axes.annotate(
            level.name.rsplit(", float", 1)[0],
            place(level),
            xytext=(6, 5) if right else (-7, -9),
            textcoords="offset points",
            ha="left" if right else "right",
            fontsize=8,
            color="0.2",
            bbox=dict(facecolor="white", edgecolor="none", alpha=0.7, pad=0.5),
        )
    axes.set(xscale="log", yscale="log", xlabel="time per case (ns)", ylabel="largest error / rms of the output")
    axes.set_title(words(model.name), fontsize=10)
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.margins(x=0.12, y=0.15)
    return axes


def tradeoff(table: Table) -> Figure:
    """All models of a table, one plot each."""
    models = list(table.models.values())
    rows = math.ceil(len(models) / 2)
    with style():
        figure, axes = plt.subplots(rows, 2, figsize=(10, 3.1 * rows), squeeze=False)
        for model, place in zip(models, axes.flat):
            pareto(model, axes=place)
        for place in axes.flat[len(models) :]:
            place.set_visible(False)
        figure.suptitle("Speed against accuracy (filled: float64, hollow: float32, star: reference)")
    return figure
