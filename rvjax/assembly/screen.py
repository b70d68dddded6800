"""An estimate of the expected response of every combination from few exact ones, and a checked margin below it."""

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np

from rvjax.assembly.costs import Machine, valued

PILOTS = 256  # exact combinations at least: three in four to fit, the others to check
PER_FEATURE = 4  # pilots for each coefficient of a regression
MOST_FEATURES = 512  # of a regression with products of all pairs; beyond, with squares only
ALIKE = 1e-2  # difference of two positions over the spread of all combinations, below which one is estimated for both
AT_ONCE = 2**18  # combinations

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
    """Exact combinations that a screen requires.

    Args:
        drawn: errors of each slot.
    """
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
    parts = np.split(np.arange(total), range(AT_ONCE, total, AT_ONCE))
    found = np.concatenate([estimates[chosen](part) for part in parts])
    error = errors[chosen]
    farthest = error.mean() + error.std() * math.sqrt(2 * math.log(total))  # of so many normal errors
    return Screen(found, float(max(error.max(), farthest, 0.0)), int(check.sum()))


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
    found: np.ndarray = np.linalg.lstsq(np.stack([np.ones(right.sum()), x[right]], axis=1), y[right], rcond=None)[0]
    return found


def _numbers(drawn: Mapping[str, list[np.ndarray]]) -> list[np.ndarray]:
    """Numbers of each part that differ between the parts of a slot, in their standard deviations (parts, k)."""
    found = []
    for leaves in drawn.values():
        rows = np.concatenate([leaf.mean(axis=1).reshape(len(leaf), -1) for leaf in leaves], axis=1)
        spread = rows.std(axis=0)
        differs = spread > 1e-12 * np.abs(rows).max(axis=0, initial=0.0)
        found.append((rows[:, differs] - rows[:, differs].mean(axis=0)) / spread[differs])
    return found


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
    found: list[Estimate] = [lambda cells: (rows(cells) @ plain).min(axis=1)]
    if (mean > 0).all():
        found.append(lambda cells: np.sqrt(np.maximum(rows(cells) @ square, 0.0)).min(axis=1))
    return found
