"""Plans where all combinations are too many or too costly to value: estimates lead, exact values decide."""

import functools
import math
from collections.abc import Mapping

import numpy as np

from rvjax.assembly.alternation import alternated_by, keeps_best, stopped
from rvjax.assembly.choice import least_largest, least_sum
from rvjax.assembly.costs import Machine, best_turn, good, valued
from rvjax.assembly.screen import Screen, pilot_count, screen
from rvjax.assembly.supply import Build, Supply
from rvjax.progress import detail
from rvjax.tolerances import Requirement

MOST_VALUED = 2**26
"""Responses for the choice, over combinations, positions and draws; beyond, they are valued on demand."""

ROUNDS = 24  # of plans whose units are then valued exactly
WORTH = 0.1  # gain of a unit, in margins of the estimates, below which a further plan is not valued
SHARE = 16  # of the responses that would be too many: what the estimate of all combinations may take


def too_many(machine: Machine, draws: int, most: int) -> bool:
    """Return true if all combinations in all positions are too many to evaluate."""
    return math.prod(machine.shape) * len(machine.indices) * draws > most


class OnDemand:
    """Costs of all combinations in their best angular position: exact where evaluated, else estimated."""

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
        total = math.prod(machine.shape)
        self.known = np.zeros(total, bool)
        self.mean, self._outside, self._turn = np.zeros(total), np.zeros(total), np.zeros(total, np.int32)
        self.margin, self.checks = np.inf, 0

    @property
    def count(self) -> int:
        """Combinations valued so far."""
        return int(self.known.sum())

    def begin(self, supply: Supply, rng: np.random.Generator, most: int) -> None:
        """Value pilots, and estimate all other combinations.

        Args:
            supply: stocks.
            rng: of the pilots.
            most: responses at most for the estimate.
        """
        possible = np.flatnonzero(supply.allowed())
        count = min(pilot_count(self._drawn), len(possible))
        pilots = np.sort(rng.choice(possible, count, replace=False))
        mean = self._value(pilots)
        if count == len(possible):
            self.margin = 0.0
            return
        order = rng.permutation(count)
        found: Screen = screen(self.machine, self._drawn, self.draws, most, pilots[order], mean[order])
        self.mean = np.where(self.known, self.mean, found.mean)
        self._outside = np.where(self.known, self._outside, 1.0 - good(found.mean, self._requirement))
        self.margin, self.checks = found.margin, found.checks

    def _value(self, cells: np.ndarray) -> np.ndarray:
        """Value combinations exactly: their expected response in every position (cells, positions)."""
        mean, outside = valued(self.machine, self._drawn, self.draws, self._requirement, cells)
        best, rows = best_turn(mean, outside, self._by_yield), np.arange(len(cells))
        if self.checks:  # each exact value checks its estimate
            excess = self.mean[cells] - mean.min(axis=1)
            self.margin = max(self.margin, float(excess.max(initial=0.0)))
            self.checks += len(cells)
        self.mean[cells], self._outside[cells], self._turn[cells] = mean[rows, best], outside[rows, best], best
        self.known[cells] = True
        return mean

    def cells(self, at: tuple[np.ndarray, ...]) -> np.ndarray:
        """Flat numbers of combinations, from the part of each slot, broadcast against each other."""
        return np.ravel_multi_index(np.broadcast_arrays(*at), self.machine.shape)

    def look(self, at: tuple[np.ndarray, ...]) -> np.ndarray:
        """Mean (inf where a unit fails), share outside and best position (3, ...) of combinations, exact.

        Args:
            at: part of each slot, broadcast against each other.
        """
        cells = self.cells(at)
        new = np.unique(cells[~self.known[cells]])
        if len(new):
            self._value(new)
        return np.stack([self.mean[cells], self._outside[cells], self._turn[cells]])

    def led(self, at: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Mean and share outside of combinations, exact or estimated.

        Args:
            at: part of each slot, broadcast against each other.
        """
        cells = self.cells(at)
        return self.mean[cells], self._outside[cells]

    def of(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Expected response and number of the best position of some combinations (cells, slots), each (cells,)."""
        mean, _, best = self.look(tuple(place.T))
        return mean, best.astype(int)


def chosen_on_demand(
    found: OnDemand, supply: Supply, objective: str, starts: int, rng: np.random.Generator, most: int
) -> tuple[Build, float, float, bool]:
    """Build, bound, objective on the draws that chose (inf if it fails), and False: nothing is proved.

    Plans of the estimates are valued exactly until the best plan holds exact units only. The bound takes the estimates
    less their margin; for "yield" it is 1.

    Args:
        found: combinations, valued on demand.
        supply: stocks.
        objective: of `plan`.
        starts: random plans from which the alternation begins.
        rng: of these.
        most: responses that are too many.
    """
    found.begin(supply, rng, most // SHARE)
    size = np.abs(found.mean[np.isfinite(found.mean)]).max(initial=0.0) or 1.0
    step = 4 * size * supply.units * found.draws  # more than any sum of responses

    def price(at: tuple[np.ndarray, ...], forbidden: float = np.inf) -> np.ndarray:
        mean, outside = found.led(at)
        failed = ~np.isfinite(mean)
        cost = np.where(failed, size, mean)
        if objective == "yield":
            cost = cost + step * outside
        return cost + step * supply.units * (1e3 * failed + (mean >= forbidden))

    def worst(build: Build) -> float:
        return float(found.led(tuple(np.array(build).T))[0].max())

    def planned(begin: Build | None) -> Build:
        build = alternated_by(price, supply, starts if begin is None else 1, rng, begin)
        while objective == "bottleneck" and not stopped():  # each step forbids what is as bad as the worst unit so far
            forbidding = functools.partial(price, forbidden=worst(build))
            trial = alternated_by(forbidding, supply, starts if begin is None else 1, rng, build)
            if not worst(trial) < worst(build):
                break
            build = trial
        return build

    def total(build: Build) -> tuple[float, float]:
        cost = price(tuple(np.array(build).T))
        return (worst(build), float(cost.sum())) if objective == "bottleneck" else (float(cost.sum()), 0.0)

    best = build = planned(None)
    for number in range(ROUNDS):
        at = tuple(np.array(build).T)
        done = bool(found.known[found.cells(at)].all())
        with keeps_best():
            found.look(at)
        if number == 0 or total(build) < total(best):
            best = build
        if done or stopped():
            break
        detail(f"plan {number + 1}: {found.count} combinations evaluated")
        build = planned(best)
        if total(best)[0] - total(build)[0] < WORTH * found.margin * (1 if objective == "bottleneck" else supply.units):
            break
    mean, outside, _ = found.look(tuple(np.array(best).T))
    if not np.isfinite(mean).all():
        return best, np.inf, np.inf, False
    if objective == "yield":
        return best, 1.0, 1 - outside.mean(), False
    reached = float(mean.max() if objective == "bottleneck" else mean.mean())
    return best, _bound(found, supply, objective, rng), reached, False


def _bound(found: OnDemand, supply: Supply, objective: str, rng: np.random.Generator) -> float:
    """No plan has a lower objective, if no estimate exceeds its exact value by more than the margin."""
    if stopped() or not np.isfinite(found.margin):
        return -np.inf
    lower = np.where(found.known, found.mean, found.mean - found.margin)
    finite = np.isfinite(lower)
    cost = np.where(finite, lower, lower[finite].max(initial=0.0)).reshape(supply.shape)
    kept, fewer = supply.lean()
    cost = cost.squeeze(tuple(slot for slot in range(len(supply.shape)) if slot not in kept))
    if objective == "bottleneck":
        return least_largest(cost, fewer, 1, rng, exact_up_to=0).bound
    return least_sum([cost], fewer, 1, rng, exact_up_to=0).bound / supply.units
