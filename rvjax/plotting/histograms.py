"""Histograms by name with limits, readable for every distribution."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import AFTER, BEFORE, PALETTE, Numbers, limit_lines, new_axes, words
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
