"""Error against time of every level of every model, with the levels that no other beats.

Plot of the comparison with the literature: how many published values hold.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from rvjax.levels import Level, Model, Table
from rvjax.plotting.style import HATCHES, PALETTE, new_axes, stacked_bars, style, words

VERDICTS = {
    "reproduced": PALETTE[2],
    "reproduced_with_reading": PALETTE[4],
    "close": PALETTE[1],
    "consistent": PALETTE[0],
    "contradicted": PALETTE[5],
    "not_computable": "0.75",
}


def verdicts(statuses: Mapping[str, Iterable[str]], *, axes: Axes | None = None) -> Axes:
    """Published values of each source by verdict, as stacked bars with their numbers.

    Args:
        statuses: {source: status word of each of its figures}.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes, (7, 1.5 + 0.5 * len(statuses)))
    counts = {source: Counter(found) for source, found in statuses.items()}
    rows = np.arange(len(counts))[::-1]
    widths = {verdict: np.array([found[verdict] for found in counts.values()]) for verdict in VERDICTS}
    stacked_bars(axes, rows, widths, zip(VERDICTS.values(), HATCHES), least=1)
    axes.set_yticks(rows, list(counts))
    axes.set(xlabel="published values and statements (number)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
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
