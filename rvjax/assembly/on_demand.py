"""Plans where all combinations are too many to value: only those that the search meets, each once."""

import functools
import math
from collections.abc import Mapping

import numpy as np

from rvjax.assembly.alternation import alternated_by, random_plan, stopped
from rvjax.assembly.costs import Machine, best_turn, valued
from rvjax.assembly.supply import Build, Supply
from rvjax.tolerances import Requirement

MOST_VALUED = 2**26
"""Responses for the choice, over combinations, positions and draws; beyond, they are valued on demand."""

STARTS = 16  # random plans at most: each meets thousands of combinations
PILOTS = 256  # random combinations that give the scale of the response


def too_many(machine: Machine, draws: int, most: int) -> bool:
    """Return true if all combinations in all positions are too many to evaluate."""
    return math.prod(machine.shape) * len(machine.indices) * draws > most


class OnDemand:
    """Costs of the combinations evaluated so far in their best angular position; replaces `Costs`."""

    level = False

    def __init__(
        self,
        machine: Machine,
        drawn: Mapping[str, list[np.ndarray]],
        draws: int,
        requirement: Requirement | None,
        by_yield: bool,
    ) -> None:
        """No combination is valued yet; arguments as of `costs`."""
        self.machine, self._drawn, self.draws = machine, drawn, draws
        self._requirement, self._by_yield = requirement, by_yield
        self._known = np.empty(0, int)  # flat numbers, ascending
        self._found = np.empty((3, 0))  # mean, share outside, number of the position

    @property
    def count(self) -> int:
        """Combinations valued so far."""
        return len(self._known)

    def look(self, at: tuple[np.ndarray, ...]) -> np.ndarray:
        """Mean (inf where a unit fails), share outside and best position (3, ...) of combinations.

        Args:
            at: part of each slot, broadcast against each other.
        """
        cells = np.ravel_multi_index(np.broadcast_arrays(*at), self.machine.shape)
        new = np.setdiff1d(cells, self._known)
        if len(new):
            mean, outside = valued(self.machine, self._drawn, self.draws, self._requirement, new)
            best, rows = best_turn(mean, outside, self._by_yield), np.arange(len(new))
            order = np.argsort(known := np.append(self._known, new))
            found = np.stack([mean[rows, best], outside[rows, best], best])
            self._known, self._found = known[order], np.append(self._found, found, axis=1)[:, order]
        return self._found[:, np.searchsorted(self._known, cells)]

    def of(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Expected response and number of the best position of some combinations (cells, slots), each (cells,)."""
        mean, _, best = self.look(tuple(place.T))
        return mean, best.astype(int)


def chosen_on_demand(
    found: OnDemand, supply: Supply, objective: str, starts: int, rng: np.random.Generator
) -> tuple[Build, float, float, bool]:
    """Build, bound, objective on the draws that chose (inf if it fails), and False: nothing is proved.

    A share of good units is at most 1. Of a mean or a largest response nothing is known without all combinations.

    Args:
        found: combinations, valued on demand.
        supply: stocks.
        objective: of `plan`.
        starts: random plans from which the alternation begins, `STARTS` at most.
        rng: of these.
    """
    pilots = np.concatenate([random_plan(supply, rng) for _ in range(-(-PILOTS // supply.units))], axis=1)
    mean = found.look(tuple(pilots))[0]
    size = np.abs(mean[np.isfinite(mean)]).max(initial=0.0) or 1.0
    step = 4 * size * supply.units * found.draws  # dearer than any sum of responses

    def price(at: tuple[np.ndarray, ...], forbidden: float = np.inf) -> np.ndarray:
        mean, outside, _ = found.look(at)
        failed = ~np.isfinite(mean)
        cost = np.where(failed, size, mean)
        if objective == "yield":
            cost = cost + step * outside
        return cost + step * supply.units * (1e3 * failed + (mean >= forbidden))

    starts = min(starts, STARTS)
    build = alternated_by(price, supply, starts, rng)
    while objective == "bottleneck" and not stopped():  # each step forbids what is as bad as the worst unit so far
        worst = found.of(np.array(build))[0].max()
        trial = alternated_by(functools.partial(price, forbidden=worst), supply, starts, rng)
        if not found.of(np.array(trial))[0].max() < worst:
            break
        build = trial
    mean, outside, _ = found.look(tuple(np.array(build).T))
    if not np.isfinite(mean).all():
        return build, np.inf, np.inf, False
    if objective == "yield":
        return build, 1.0, 1 - outside.mean(), False
    return build, -np.inf, float(mean.max() if objective == "bottleneck" else mean.mean()), False
