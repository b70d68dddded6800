"""Plot of the comparison with the literature: how many published values hold."""

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import HATCHES, PALETTE, new_axes, words

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
    rows, left = np.arange(len(counts))[::-1], np.zeros(len(counts))
    for (verdict, colour), hatch in zip(VERDICTS.items(), HATCHES):
        width = np.array([found[verdict] for found in counts.values()])
        axes.barh(rows, width, 0.6, left, color=colour, hatch=hatch, edgecolor="white", label=words(verdict))
        for row, number, start in zip(rows, width, left):
            if number:
                box = dict(facecolor="white", edgecolor="none", pad=1.0, alpha=0.85)
                axes.text(start + number / 2, row, str(number), ha="center", va="center", fontsize=9, bbox=box)
        left += width
    axes.set_yticks(rows, list(counts))
    axes.set(xlabel="published values and statements (number)")
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return axes
