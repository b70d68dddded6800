"""Pictures of one batch of units: its distribution, and how rarely it goes beyond a limit."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import AFTER, BEFORE, PALETTE, Numbers, limit_lines, new_axes, words
from rvjax.tolerances import Estimate
from rvjax.units import readable


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
    bins: Any = np.linspace(min(v.min() for v in values.values()), max(v.max() for v in values.values()), 121)
    for k, (label, found) in enumerate(values.items()):
        units = len(batches[label])
        weights = np.full(len(found), 1 / (units * (bins[1] - bins[0])))
        text = f"{words(label)}, {'' if len(found) == units else f'{len(found):,} of '}{units:,} units"
        if k == 0:
            axes.hist(found, bins, weights=weights, color=AFTER, alpha=0.7, label=text)
        else:
            look = ((PALETTE[7], "-", 1.2), (BEFORE, "--", 1.8), (PALETTE[2], "-.", 1.2))[(k - 1) % 3]
            options: Any = dict(zip(("color", "ls", "lw"), look))
            axes.hist(found, bins, weights=weights, histtype="step", label=text, **options)
    limit_lines(axes, limits, shown, size)
    axes.set(xlabel=f"{words(name)} ({shown})", ylabel=f"density (1/{shown})")
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
