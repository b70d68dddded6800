"""Pictures of one batch of units: its distribution, and how rarely it goes beyond a limit.

Plot of an error budget: contributors, and orders of the output revolution.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rvjax.plotting.style import (
    AFTER,
    BEFORE,
    PALETTE,
    Numbers,
    limit_lines,
    look,
    new_axes,
    readable_bins,
    stacked_bars,
    words,
)
from rvjax.tolerances import Estimate
from rvjax.units import arcsec, readable


class Budget(Protocol):
    """Plotted content of an error budget, as in `rvjax.commands.budget.Budget`."""

    @property
    def title(self) -> str:
        """Of the curve."""

    @property
    def unit(self) -> str:
        """SI unit of the curve."""

    @property
    def orders(self) -> NDArray[np.float64]:
        """In periods a revolution of the output (k,)."""

    @property
    def torque(self) -> dict[str, float]:
        """{load: N m}."""

    @property
    def total(self) -> dict[str, NDArray[np.float64]]:
        """{load: variance of each order over the units (k,)}."""

    @property
    def part(self) -> dict[str, str]:
        """{error: part of the reducer}."""

    def by(self, level: str, load: str) -> dict[str, NDArray[np.float64]]:
        """Variances by part under a load."""

    def shares(self, level: str, load: str) -> dict[str, float]:
        """Shares by part under a load."""


def error_budget(budget: Budget, *, orders: int = 8) -> Figure:
    """Shares of the parts under every load, above; root mean square of the largest orders and their parts, below.

    Args:
        budget: from `rvjax.commands.budget.error_budget`.
        orders: number of plotted orders of the output revolution.
    """
    unit, size = ("arcsec", arcsec) if budget.unit == "rad" else (budget.unit, 1.0)
    loads = list(budget.torque)
    parts = sorted({*budget.part.values()}, key=lambda part: -sum(budget.shares("part", load)[part] for load in loads))
    style = {part: look(k) for k, part in enumerate(parts)}
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.6, 6.8), height_ratios=(1, 1.6))
    rows = np.arange(len(loads), dtype=float)
    widths = {part: np.array([100 * budget.shares("part", load)[part] for load in loads]) for part in parts}
    stacked_bars(above, rows, widths, style.values(), least=6)
    names = {load: f"{budget.torque[load]:.4g} N m" for load in loads}
    above.set_yticks(rows, [name if load == name else f"{words(load)}\n{name}" for load, name in names.items()])
    above.invert_yaxis()
    above.set(xlabel="share of the variance (%)", xlim=(0, 100), title=f"Error budget: {budget.title}")
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.32), ncols=4)
    largest = np.max([budget.total[load] for load in loads], axis=0)[1:]
    shown = np.sort(1 + np.argsort(-largest, kind="stable")[:orders])
    thick = 0.8 / len(loads)
    for n, load in enumerate(loads):
        at = np.arange(len(shown)) + (n - (len(loads) - 1) / 2) * thick
        owned = budget.by("part", load)
        whole = np.maximum(np.sum(list(owned.values()), axis=0)[shown], np.finfo(float).tiny)
        height, bottom = np.sqrt(budget.total[load][shown]) / size, np.zeros(len(shown))
        for part in parts:  # a bar is as high as the order, divided as its mean square is
            piece = height * owned[part][shown] / whole
            colour, hatch = style[part]
            below.bar(at, piece, 0.92 * thick, bottom=bottom, color=colour, hatch=hatch, edgecolor="white")
            bottom += piece
        for x, y in zip(at, height):
            below.text(x, y, words(load), rotation=90, ha="center", va="bottom", fontsize=7, color="0.35")
    below.set_xticks(np.arange(len(shown)), [f"{order:.4g}" for order in budget.orders[shown]])
    below.margins(y=0.22)
    below.set(xlabel="order of the output turn", ylabel=f"rms over the units ({unit})")
    below.grid(axis="x", visible=False)
    return figure


def batch_histograms(
    batches: Mapping[str, Numbers], *, unit: str, name: str, limits: Sequence[float] = (), axes: Axes | None = None
) -> Axes:
    """Histograms of a response in one or several samples, with its limits.

    Args:
        batches: {batch: values, SI (units,)}; failed units, NaN, are missing from the area of their batch.
        unit: SI unit of the response.
        name: of the response.
        limits: SI.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    values = {label: np.asarray(v)[np.isfinite(v)] / size for label, v in batches.items()}
    bins = readable_bins(axes, np.concatenate(list(values.values())), 120, shown)
    for k, (label, found) in enumerate(values.items()):
        units = len(batches[label])
        weights = np.full(len(found), 1 / (units * bins.step))
        text = f"{words(label)}, {'' if len(found) == units else f'{len(found):,} of '}{units:,} units"
        if k == 0:
            axes.hist(found, bins.edges, weights=weights, color=AFTER, alpha=0.7, label=text)
        else:
            look = ((PALETTE[7], "-", 1.2), (BEFORE, "--", 1.8), (PALETTE[2], "-.", 1.2))[(k - 1) % 3]
            options: Any = dict(zip(("color", "ls", "lw"), look))
            axes.hist(found, bins.edges, weights=weights, histtype="step", label=text, **options)
    limit_lines(axes, limits, shown, size)
    axes.set(xlabel=f"{words(name)} ({shown}){bins.beyond}", ylabel=f"density (1/{bins.per})")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return axes


def rejects_against_limit(
    values: Numbers,
    rare: Mapping[float, Estimate],
    *,
    unit: str,
    name: str,
    limit: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Units beyond an upper limit, per million, over that limit: counted, and by importance sampling.

    Args:
        values: of the response, SI (units,), from Monte Carlo.
        rare: {limit, SI: `Estimate` of the probability}, of `tolerances.failure_probability`.
        unit: SI unit of the response.
        name: of the response.
        limit: that the response has, SI.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    rising = np.sort(np.asarray(values)[np.isfinite(values)])
    count = len(rising)
    kept = np.unique(np.round(np.geomspace(1, count, 400)).astype(int))  # so many units at and beyond each value
    axes.semilogy(
        rising[count - kept] / size, 1e6 * kept / count, color=AFTER, lw=2, label=f"counted in {count:,} units"
    )
    places = np.array(list(rare))
    middle, low, high = (1e6 * np.array([getattr(e, f) for e in rare.values()]) for f in ("value", "lower", "upper"))
    axes.errorbar(
        places / size, middle, [middle - low, high - middle], fmt="o", ms=6, mfc="white", color=BEFORE, capsize=3,
        label="importance sampling, 95 % interval", zorder=3,
    )  # fmt: skip
    axes.axhline(1e6 / count, color="0.5", lw=1, ls=":", label="one unit of those counted")
    limit_lines(axes, [] if limit is None else [limit], shown, size)
    axes.set(xlabel=f"limit of {words(name)} ({shown})", ylabel="units beyond it (per million)")
    low_end = min(places.min(), np.quantile(rising, 0.5)) / size
    axes.set_xlim(low_end, None)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9)
    return axes
