"""Plans where all combinations are too many or too costly to value: estimates lead, exact values decide.

An estimate of the expected response of every combination from few exact ones, and a checked margin below it.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping

import numpy as np

from rvjax._jax.sizes import COMBINATIONS
from rvjax.assembly.choice import least_largest, least_sum
from rvjax.assembly.costs import Machine, best_turn, good, valued
from rvjax.assembly.supply import Build, Supply, alternated_by, keeps_best, stopped
from rvjax.base.progress import detail
from rvjax.tolerances import Requirement

PILOTS = 256  # exact combinations at least: three in four to fit, the others to check
PER_FEATURE = 4  # pilots for each coefficient of a regression
MOST_FEATURES = 512  # of a regression with products of all pairs; beyond, with squares only
ALIKE = 1e-2  # difference of two positions over the spread of all combinations, below which one is estimated for both

Estimate = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Screen:
    """Estimates of all combinations.

    Attributes:
        mean: expected response in the best position (combinations,).
        margin: largest excess over an exact value: of the combinations that check, or, if more, that expected of all
            combinations with normal errors of the same spread; inf where none checks.
        checks: their count.
    """

    mean: np.ndarray
    margin: float
    checks: int


def pilot_count(drawn: Mapping[str, list[np.ndarray]]) -> int:
    """Exact combinations that a screen requires, for the errors of each slot."""
    columns = sum(numbers.shape[1] for numbers in _numbers(drawn))
    return max(PILOTS, PER_FEATURE * _features(np.zeros((1, columns))).shape[1] * 4 // 3)


def screen(
    machine: Machine, drawn: Mapping[str, list[np.ndarray]], draws: int, most: int, cells: np.ndarray, mean: np.ndarray
) -> Screen:
    """Estimate all combinations: by few draws where these are cheap enough, else by a regression on the parts.

    The regression is quadratic in the measured numbers of the parts, of the response or of its square; that with the
    least error of the checks is taken. The mean over draws is a smooth function of these numbers.

    Args:
        machine: response and parts.
        drawn: errors of each slot.
        draws: of an exact value.
        most: responses at most for all combinations, positions and draws.
        cells: flat numbers of the pilots (n,).
        mean: exact expected responses of these (n, positions), inf where a unit fails.
    """
    total = math.prod(machine.shape)
    finite = np.isfinite(mean).all(axis=1)
    cells, mean = cells[finite], mean[finite]
    if len(cells) < PER_FEATURE:
        return Screen(np.zeros(total), np.inf, 0)
    turns, best = _distinct(mean), mean.min(axis=1)
    check = np.arange(len(cells)) % 4 == 3
    few = min(most // (total * len(turns)), draws) // 2
    estimates: list[Estimate]
    if few:
        half = np.arange(few)
        own = np.concatenate([half, draws // 2 + half]) if draws > 1 else half  # antithetic pairs

        def by_draws(cells: np.ndarray) -> np.ndarray:
            return valued(machine, drawn, own, None, cells, turns)[0].min(axis=1)

        scale = _line(by_draws(cells[~check]), best[~check])
        estimates = [lambda cells: scale[0] + scale[1] * by_draws(cells)]
    else:
        estimates = _regressions(machine, drawn, cells[~check], mean[~check][:, turns])
    errors = [estimate(cells[check]) - best[check] for estimate in estimates]
    chosen = int(np.argmin([np.mean(error**2) for error in errors]))
    parts = np.split(np.arange(total), range(COMBINATIONS, total, COMBINATIONS))
    estimated = np.concatenate([estimates[chosen](part) for part in parts])
    error = errors[chosen]
    farthest = error.mean() + error.std() * math.sqrt(2 * math.log(total))  # of so many normal errors
    return Screen(estimated, float(max(error.max(), farthest, 0.0)), int(check.sum()))


def _distinct(mean: np.ndarray) -> np.ndarray:
    """Positions that differ from each other, by the pilots."""
    size, kept = ALIKE * np.std(mean.min(axis=1)), [0]
    for turn in range(1, mean.shape[1]):
        if np.abs(mean[:, kept] - mean[:, [turn]]).max(axis=0).min() > size:
            kept.append(turn)
    return np.array(kept)


def _line(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Intercept and slope of least squares."""
    right = np.isfinite(x)
    coefficients: np.ndarray = np.linalg.lstsq(
        np.stack([np.ones(right.sum()), x[right]], axis=1), y[right], rcond=None
    )[0]
    return coefficients


def _numbers(drawn: Mapping[str, list[np.ndarray]]) -> list[np.ndarray]:
    """Numbers of each part that differ between the parts of a slot, in their standard deviations (parts, k)."""
    columns = []
    for leaves in drawn.values():
        rows = np.concatenate([leaf.mean(axis=1).reshape(len(leaf), -1) for leaf in leaves], axis=1)
        spread = rows.std(axis=0)
        differs = spread > 1e-12 * np.abs(rows).max(axis=0, initial=0.0)
        columns.append((rows[:, differs] - rows[:, differs].mean(axis=0)) / spread[differs])
    return columns


def _features(x: np.ndarray) -> np.ndarray:
    """One, the numbers, and their products or squares."""
    count = x.shape[1]
    first, second = np.triu_indices(count)
    if 1 + count + len(first) > MOST_FEATURES:
        first = second = np.arange(count)
    return np.concatenate([np.ones((len(x), 1)), x, x[:, first] * x[:, second]], axis=1)


def _regressions(
    machine: Machine, drawn: Mapping[str, list[np.ndarray]], cells: np.ndarray, mean: np.ndarray
) -> list[Estimate]:
    """Regressions of the response and, where it is positive, of its square."""
    numbers = _numbers(drawn)

    def rows(cells: np.ndarray) -> np.ndarray:
        place = np.unravel_index(cells, machine.shape)
        return _features(np.concatenate([own[at] for own, at in zip(numbers, place)], axis=1))

    known = rows(cells)
    plain, square = (np.linalg.lstsq(known, y, rcond=None)[0] for y in (mean, mean**2))
    estimates: list[Estimate] = [lambda cells: (rows(cells) @ plain).min(axis=1)]
    if (mean > 0).all():
        estimates.append(lambda cells: np.sqrt(np.maximum(rows(cells) @ square, 0.0)).min(axis=1))
    return estimates


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
        screened: Screen = screen(self.machine, self._drawn, self.draws, most, pilots[order], mean[order])
        self.mean = np.where(self.known, self.mean, screened.mean)
        self._outside = np.where(self.known, self._outside, 1.0 - good(screened.mean, self._requirement))
        self.margin, self.checks = screened.margin, screened.checks

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
    priced: OnDemand, supply: Supply, objective: str, starts: int, rng: np.random.Generator, most: int
) -> tuple[Build, float, float, bool]:
    """Build, bound, objective on the draws that chose (inf if it fails), and False: nothing is proved.

    Plans of the estimates are valued exactly until the best plan holds exact units only. The bound takes the estimates
    less their margin; for "yield" it is 1.

    Args:
        priced: combinations, valued on demand.
        supply: stocks.
        objective: of `plan`.
        starts: random plans from which the alternation begins.
        rng: of these.
        most: responses that are too many.
    """
    priced.begin(supply, rng, most // SHARE)
    size = np.abs(priced.mean[np.isfinite(priced.mean)]).max(initial=0.0) or 1.0
    step = 4 * size * supply.units * priced.draws  # more than any sum of responses

    def price(at: tuple[np.ndarray, ...], forbidden: float = np.inf) -> np.ndarray:
        mean, outside = priced.led(at)
        failed = ~np.isfinite(mean)
        cost = np.where(failed, size, mean)
        if objective == "yield":
            cost = cost + step * outside
        return cost + step * supply.units * (1e3 * failed + (mean >= forbidden))

    def worst(build: Build) -> float:
        return float(priced.led(tuple(np.array(build).T))[0].max())

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
        done = bool(priced.known[priced.cells(at)].all())
        with keeps_best():
            priced.look(at)
        if number == 0 or total(build) < total(best):
            best = build
        if done or stopped():
            break
        detail(f"plan {number + 1}: {priced.count} combinations evaluated")
        build = planned(best)
        if total(best)[0] - total(build)[0] < WORTH * priced.margin * (
            1 if objective == "bottleneck" else supply.units
        ):
            break
    mean, outside, _ = priced.look(tuple(np.array(best).T))
    if not np.isfinite(mean).all():
        return best, np.inf, np.inf, False
    if objective == "yield":
        return best, 1.0, 1 - outside.mean(), False
    reached = float(mean.max() if objective == "bottleneck" else mean.mean())
    return best, _bound(priced, supply, objective, rng), reached, False


def _bound(priced: OnDemand, supply: Supply, objective: str, rng: np.random.Generator) -> float:
    """Lower bound of the objective of any plan, if no estimate exceeds its exact value by more than the margin."""
    if stopped() or not np.isfinite(priced.margin):
        return -np.inf
    lower = np.where(priced.known, priced.mean, priced.mean - priced.margin)
    finite = np.isfinite(lower)
    cost = np.where(finite, lower, lower[finite].max(initial=0.0)).reshape(supply.shape)
    kept, fewer = supply.lean()
    cost = cost.squeeze(tuple(slot for slot in range(len(supply.shape)) if slot not in kept))
    if objective == "bottleneck":
        return least_largest(cost, fewer, 1, rng, exact_up_to=0).bound
    return least_sum([cost], fewer, 1, rng, exact_up_to=0).bound / supply.units
