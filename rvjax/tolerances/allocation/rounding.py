"""From half-widths to ISO 286 grades: the coarsest grades whose certificate holds, and the other fields beside them."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.population import GRADES, it_width
from rvjax.tolerances.allocation.certificate import Certifier
from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.batch.monte_carlo import Statistics

_DRAWS = 2  # certificates of one set of grades: fields that are free may shrink once

Places = dict[int, int]  # of graded fields on their ladders


class Snapping:
    """Chooses grades for the fields with a size, and fits the half-widths of the other fields to them."""

    def __init__(self, search: Search, certifier: Certifier, priced: dict[str, Cost]) -> None:
        self.training, self.certifier, self.priced = search.training, certifier, priced
        self.costs, self.cost, self.max_steps = search.costs, search.cost, search.max_steps
        active = search.training.population.active
        self.ladders = {j: _ladder(active[name].size, cost) for j, (name, cost) in enumerate(priced.items())}

    def snap(self, half_widths: np.ndarray, certificate: Statistics) -> tuple[np.ndarray, dict[str, str], Statistics]:
        """The loosest grades not wider than certified half-widths, then cheaper ones while a certificate holds.

        One grade at a time becomes coarser, by saving. A field without a size, or without a grade within its
        process range, stays free: it takes up what the grades leave over, and gives way where that lets a
        grade be coarser at less cost in all.

        Returns:
            Half-widths, {field: grade} of the snapped ones, and the certificate of exactly these.
        """
        places: Places = {}
        for j, ladder in self.ladders.items():
            fitting = sum(t <= half_widths[j] * (1 + 1e-9) for _, t in ladder)
            if fitting:
                places[j] = fitting - 1
        if not places:
            return half_widths, {}, certificate
        best = self.at(places, half_widths)
        proof: Statistics | None = None  # none yet: finer than what is certified, and most often not the last word
        open_ = set(places)
        # The grades as they are come first where free fields may take up what they leave.
        trial = dict(places) if len(places) < len(self.priced) else None
        while proof is None or self.certifier.holds(proof):
            if trial is not None:
                found, drawn = self.certified(trial, best)
                if drawn is not None and self.certifier.holds(drawn) and self.cost(found) < self.cost(best):
                    best, places, proof = found, trial, drawn
                else:
                    open_ -= {j for j in open_ if trial[j] != places[j]}
            open_ = {j for j in open_ if places[j] + 1 < len(self.ladders[j])}
            if not open_:
                break
            j = max(open_, key=lambda j: self.saving(j, places[j]))
            trial = {**places, j: places[j] + 1}
        fields = list(self.priced)
        certificate = proof or self.certifier.draw(self.training.with_half_widths(best))
        return best, {fields[j]: self.ladders[j][place][0] for j, place in places.items()}, certificate

    def certified(self, places: Places, half_widths: np.ndarray) -> tuple[np.ndarray, Statistics | None]:
        """The free fields fitted to some grades, and a certificate unless the learning sample sees it is no use."""
        t, free = self.at(places, half_widths), len(places) < len(self.priced)
        if free:
            search = Search(self.training, self.priced, self.max_steps)
            held = np.array([j in places for j in range(len(t))])
            search.low, search.high = np.where(held, t, search.low), np.where(held, t, search.high)
            if not self.promising(search.low):
                return t, None
            t = search.run(search.look(t))[0].half_widths
        if not self.promising(t) or self.cost(t) >= self.cost(half_widths):
            return t, None
        if free:
            return self.certifier.settle(self.training, t, search.low, draws=_DRAWS)
        return t, self.certifier.draw(self.training.with_half_widths(t))

    def promising(self, half_widths: np.ndarray) -> bool:
        """Not beyond a limit by more than the learning sample may err (5 % of the way there)."""
        return bool((self.training.margins(half_widths) <= 0.05 * self.training.distance).all())

    def at(self, places: Places, half_widths: np.ndarray) -> np.ndarray:
        """Half-widths with these grades, the free fields as they are."""
        t = half_widths.copy()
        for j, place in places.items():
            t[j] = self.ladders[j][place][1]
        return t

    def saving(self, j: int, place: int) -> float:
        """What the next coarser grade of a field saves."""
        now, then = (float(self.costs[j](jnp.asarray(self.ladders[j][k][1]))) for k in (place, place + 1))
        return now - then


def _ladder(size: Any, cost: Cost) -> list[tuple[str, float]]:
    """Grades within the process range, finest first, with their half-widths."""
    if size is None:
        return []
    steps = [(grade, it_width(grade, size) / 2) for grade in GRADES]
    return [(grade, t) for grade, t in steps if cost.finest <= t * (1 + 1e-9) and t <= cost.coarsest * (1 + 1e-9)]
