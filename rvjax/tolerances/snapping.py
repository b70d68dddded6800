"""From half-widths to ISO 286 grades: the coarsest set of grades whose certificate holds."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.tolerances.certificate import Certifier
from rvjax.tolerances.cost import Cost
from rvjax.tolerances.grades import GRADES, it_width
from rvjax.tolerances.monte_carlo import Statistics
from rvjax.tolerances.training import Training


def snap(
    training: Training, certifier: Certifier, priced: dict[str, Cost], half_widths: np.ndarray, certificate: Statistics
) -> tuple[np.ndarray, dict[str, str], Statistics]:
    """Snap every field with a size to the loosest grade not wider than it, then loosen by saving while it holds.

    Fields without a size, or without a grade within their process range, keep their half-width.

    Returns:
        Half-widths, {field: grade} of the snapped ones, and the certificate of exactly these.
    """
    ladders = {j: _ladder(training.parts.active[n].size, cost) for j, (n, cost) in enumerate(priced.items())}
    places = {}
    for j, ladder in ladders.items():
        fitting = [place for place, (_, t) in enumerate(ladder) if t <= half_widths[j] * (1 + 1e-9)]
        if fitting:
            places[j] = fitting[-1]

    def at(places: dict[int, int]) -> np.ndarray:
        t = half_widths.copy()
        for j, place in places.items():
            t[j] = ladders[j][place][1]
        return t

    def saving(j: int) -> float:
        cost = list(priced.values())[j]
        now, then = (float(cost(jnp.asarray(ladders[j][place][1]))) for place in (places[j], places[j] + 1))
        return now - then

    if places:
        certificate = certifier.draw(training.tolerances(at(places)))
    open_ = set(places)
    while open_ and certifier.holds(certificate):
        open_ = {j for j in open_ if places[j] + 1 < len(ladders[j])}
        if not open_:
            break
        j = max(open_, key=saving)
        trial = {**places, j: places[j] + 1}
        # The learning sample spares certificates that are sure to fail.
        drawn = certifier.draw(training.tolerances(at(trial))) if _promising(training, at(trial)) else None
        if drawn is not None and certifier.holds(drawn):
            places, certificate = trial, drawn
        else:
            open_.discard(j)
    names = list(priced)
    return at(places), {names[j]: ladders[j][place][0] for j, place in places.items()}, certificate


def _ladder(size: Any, cost: Cost) -> list[tuple[str, float]]:
    """Grades within the process range, finest first, with their half-widths."""
    if size is None:
        return []
    steps = [(grade, it_width(grade, size) / 2) for grade in GRADES]
    return [(grade, t) for grade, t in steps if cost.finest <= t * (1 + 1e-9) and t <= cost.coarsest * (1 + 1e-9)]


def _promising(training: Training, half_widths: np.ndarray) -> bool:
    """Not beyond the limit by more than the learning sample may err (5 % of the way there)."""
    return bool((training.margins(half_widths) <= 0.05 * training.distance).all())
