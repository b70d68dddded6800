"""Style of all plots: readable in print and with colour-vision deficiency."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes

from rvjax.base.words import words as words
from rvjax.records import Array
from rvjax.units import with_unit

Numbers = Array | np.ndarray | Sequence[float]
"""Numbers to plot, of any library."""

BEFORE, AFTER, LIMIT = "#E69F00", "#0072B2", "#D55E00"
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
DASHES = ("-", "--", "-.", ":")
HATCHES = ("", "//", "..", "xx", "\\\\", "++", "oo", "--")

_STYLE: Any = {
    "figure.dpi": 120,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=PALETTE),
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
}


@contextmanager
def style() -> Iterator[None]:
    """Style of all plots."""
    # Not rc_context: the first figure of a notebook, made inside, makes pyplot interactive, and that has to stay.
    before = {key: plt.rcParams[key] for key in _STYLE}
    plt.rcParams.update(_STYLE)
    try:
        yield
    finally:
        plt.rcParams.update(before)


def use_style() -> None:
    """Set the style for all further plots, of a size that keeps notebooks small."""
    plt.rcParams.update(_STYLE | {"figure.dpi": 100})


def new_axes(axes: Axes | None = None, size: tuple[float, float] = (7, 4.2)) -> Axes:
    """The axes given, or those of a new figure.

    Args:
        axes: where to draw, or None.
        size: width and height of a new figure, inches.
    """
    return plt.subplots(figsize=size)[1] if axes is None else axes


def look(k: int) -> tuple[str, str]:
    """Colour and hatch of part `k`; the second round of colours has other hatches."""
    return PALETTE[k % len(PALETTE)], HATCHES[(k + k // len(PALETTE)) % len(HATCHES)]


def stacked_bars(
    axes: Axes, rows: np.ndarray, widths: Mapping[str, np.ndarray], looks: Iterable[tuple[str, str]], *, least: float
) -> None:
    """Horizontal bars of several parts, with the number of each large part in it.

    Args:
        axes: where to draw.
        rows: places of the bars (n,).
        widths: {part: its width in each bar (n,)}.
        looks: colour and hatch of each part.
        least: width from which on a part shows its number.
    """
    left = np.zeros(len(rows))
    for (name, width), (colour, hatch) in zip(widths.items(), looks):
        axes.barh(rows, width, 0.6, left, color=colour, hatch=hatch, edgecolor="white", label=words(name))
        for row, size, start in zip(rows, width, left):
            if size >= least:
                box = dict(facecolor="white", edgecolor="none", pad=1.0, alpha=0.85)
                axes.text(start + size / 2, row, f"{size:.0f}", ha="center", va="center", bbox=box, fontsize=9)
        left = left + width
    axes.grid(axis="y", visible=False)


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


def limit_lines(axes: Axes, limits: Iterable[float], unit: str, size: float) -> None:
    """A line at each finite limit.

    Args:
        axes: where to draw.
        limits: SI.
        unit: in which they are read.
        size: of the unit, SI.
    """
    for limit in limits:
        if np.isfinite(limit):
            axes.axvline(limit / size, color=LIMIT, lw=1.5, label=f"limit {with_unit(limit / size, unit)}")
