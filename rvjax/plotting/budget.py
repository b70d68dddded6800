"""Plot of an error budget: contributors, and orders of the output revolution."""

from typing import Protocol

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rvjax.plotting.style import look, stacked_bars, words
from rvjax.units import arcsec


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
