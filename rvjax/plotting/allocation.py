"""Plot of an allocation: cost of each tolerance, before and after."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import AFTER, BEFORE, new_axes, words


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
