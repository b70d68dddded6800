"""Pictures of matched parts: what matching does to the units, and how much of it the gauge lets through."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from rvjax.plotting.style import AFTER, BEFORE, LIMIT, Numbers, limit_lines, new_axes, words
from rvjax.units import readable


def units(
    planned: Numbers,
    random: Numbers,
    *,
    unit: str,
    name: str,
    upper: float = np.inf,
    lower: float = -np.inf,
    axes: Axes | None = None,
) -> Axes:
    """Share of units up to each value of the response, matched and by chance.

    Args:
        planned: responses of units of the plan, SI (n,).
        random: responses of random units, SI (m,).
        unit: SI unit of the response.
        name: of the response.
        upper: upper limit, SI.
        lower: lower limit, SI.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    for values, colour, dash, label in ((random, BEFORE, "--", "random"), (planned, AFTER, "-", "matched")):
        seen = np.sort(np.asarray(values)[np.isfinite(values)]) / size
        share = 100 * np.arange(1, len(seen) + 1) / len(values)
        axes.step(seen, share, where="post", color=colour, ls=dash, lw=1.8, label=label)
    limit_lines(axes, (lower, upper), shown, size)
    axes.set(
        xlabel=f"{words(name)} ({shown})",
        ylabel="units up to there (%)",
        ylim=(0, 102),
        title=f"Matched parts: {words(name)}",
    )
    axes.legend(loc="lower right")
    return axes


def gain_against_gauge(
    sd: Sequence[float],
    promised: Numbers,
    came_true: Numbers | None = None,
    *,
    chance: float,
    known: float,
    title: str = "What the gauge lets through",
    axes: Axes | None = None,
) -> Axes:
    """Response left by matching against the standard deviation of the measurement, as shares of random assembly.

    Args:
        sd: standard deviations of the measurement, as multiples of the one in use (k,).
        promised: mean response of the plans, as they expect it (k,).
        came_true: mean response with the true errors of the same units (k,); None where they are not known.
        chance: mean response of random assembly.
        known: mean response of plans from exact measurements.
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    axes.axhline(100, color=BEFORE, ls="--", label="random assembly")
    axes.axhline(100 * known / chance, color="0.5", ls=":", label="exact measurement")
    axes.plot(sd, 100 * np.asarray(promised) / chance, "o-", color=AFTER, label="promised")
    if came_true is not None:
        axes.plot(sd, 100 * np.asarray(came_true) / chance, "x", ms=9, mew=2, color=LIMIT, label="came true")
    axes.set(xlabel="measurement uncertainty (share of the spread of the parts)", ylabel="mean response (% of random)")
    axes.set(title=title, ylim=(0, None))
    axes.legend()
    return axes


def price_of_accuracy(
    shares: Sequence[float], alone: Sequence[float], matched: Sequence[float], *, axes: Axes | None = None
) -> Axes:
    """Cost of the tolerances against yield, for random assembly and opened by matching.

    Args:
        shares: yields (k,).
        alone: cheapest cost of tolerances for random assembly (k,).
        matched: cost of the same tolerances, opened (k,).
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    axes.plot(100 * np.asarray(shares), alone, "s--", color=BEFORE, label="tighter tolerances, random assembly")
    axes.plot(100 * np.asarray(shares), matched, "o-", color=AFTER, label="opened tolerances, matched parts")
    axes.set(
        xlabel="yield (%)", ylabel="cost of the tolerances", ylim=(0, None), title="Tighter tolerances or matching"
    )
    axes.legend()
    return axes
