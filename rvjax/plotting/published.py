"""Plot of the comparison with the literature: how many published values hold."""

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import HATCHES, PALETTE, new_axes, stacked_bars

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
