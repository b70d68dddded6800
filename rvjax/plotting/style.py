"""Style of all plots: readable in print and with colour-vision deficiency."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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
Looks = Mapping[str, Mapping[str, Any]]
"""Options of Matplotlib by name of a curve or of bars."""

BEFORE, AFTER, LIMIT = "#E69F00", "#0072B2", "#D55E00"
BEFORE_BARS = {"color": BEFORE, "hatch": "//", "edgecolor": "white"}
AFTER_BARS = {"color": AFTER, "edgecolor": "white"}
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
