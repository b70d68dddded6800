"""Probability of failure from failing units: spread until they fail, then contracted step by step.

Subset simulation (Au and Beck 2001) over the sets F(s) = {z: s z fails}, from a spread s at which failures are common
down to 1. It uses only whether a unit fails: no slope, no point, no distance to the limit. Its spread does not
grow with the number of random numbers. It ends with units of the failing region, each failure mode in proportion to
its probability.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy import special

from rvjax.population import Estimate, rare, student

ISLANDS = 8
"""Independent populations: the spread of their estimates gives the error of the mean."""
EACH = 128
"""Units of an island."""
_SPREADS = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)  # tried in turn
_ENOUGH = 0.1  # share of failing units that ends the spreading
_KEPT = 0.2  # share of the units that should fail at the next spread too
_LEAST = 0.08  # with fewer the step is taken back half-way
_CLOSE = 0.01  # steps no shorter than this
_MOVES = 3  # of every unit after each step
_MOST_STEPS = 32
_HIGH, _LOW = 0.5, 0.25  # shares of accepted moves that make the next ones longer, shorter

Fails = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Sequential:
    """Result of the failing units.

    Attributes:
        probability: of failure; its error from the spread between the islands.
        failing: (numbers, n) failing units, sampled (nearly) as failures occur; none where no unit failed.
    """

    probability: Estimate
    failing: np.ndarray


def sequential(fails: Fails, numbers: int, random: np.random.Generator, confidence: float = 0.95) -> Sequential:
    """Probability of failure by subset simulation over spreads.

    A failing region that ends further out, on the ray through its units, is seen only as far as it does not.

    Args:
        fails: which units (numbers, n) fail, (n,).
        numbers: random numbers of a unit.
        random: where the units come from.
        confidence: of the interval.
    """

    def fail(z: np.ndarray, spread: float) -> np.ndarray:
        return fails(spread * z.reshape(numbers, ISLANDS * EACH)).reshape(ISLANDS, EACH)

    z = random.standard_normal((numbers, ISLANDS, EACH))
    shares, noise, reach = np.ones(ISLANDS), 0.0, 0.5
    failed, spread = fail(z, 1.0), 1.0
    for wider in _SPREADS:
        if failed.mean() >= _ENOUGH:
            break
        trial = fail(z, wider)
        if trial.sum() > failed.sum():
            failed, spread = trial, wider
    for _ in range(_MOST_STEPS):
        shares *= failed.mean(axis=1)
        noise += float((~failed).mean() / max(1, failed.sum()))
        if not shares.any():
            break
        alive = shares > 0
        z = _resampled(z, failed, random)
        for _ in range(_MOVES):
            trial = math.sqrt(1 - reach**2) * z + reach * random.standard_normal(z.shape)
            taken = fail(trial, spread)
            z = np.where(taken, trial, z)
            reach = min(1.0, 1.4 * reach) if taken.mean() > _HIGH else reach / 1.4 if taken.mean() < _LOW else reach
        if spread == 1:
            return Sequential(_estimate(shares, noise, confidence), z[:, alive].reshape(numbers, EACH * alive.sum()))
        before, spread = spread, _next(float(shares.mean()), spread)
        failed = fail(z, spread) & alive[:, None]
        while failed.mean() < _LEAST and before - spread > _CLOSE:
            spread = math.sqrt(before * spread)
            failed = fail(z, spread) & alive[:, None]
    return Sequential(Estimate(0.0, 0.0, 0.0, 0.0), np.zeros((numbers, 0)))


def _next(share: float, spread: float) -> float:
    """The spread at which `_KEPT` of the units should still fail, were the limit flat."""
    distance = -special.ndtri(min(share, 0.4)) * spread
    return max(1.0, distance / -special.ndtri(_KEPT * min(share, 0.4)))


def _resampled(z: np.ndarray, failed: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """As many units as before from the failing ones of each island, all alike; dead islands stay as they are."""
    picks = []
    for row in failed:
        seeds = np.flatnonzero(row) if row.any() else np.arange(row.size)
        picks.append(random.permutation(np.resize(random.permutation(seeds), row.size)))
    return np.stack([z[:, k, pick] for k, pick in enumerate(picks)], axis=1)


def _estimate(shares: np.ndarray, noise: float, confidence: float) -> Estimate:
    """The mean over all islands; its error no less than were all units independent (`noise`: its square, relative)."""
    value, spread = float(shares.mean()), float(shares.std(ddof=1)) / math.sqrt(ISLANDS)
    error = max(spread, value * math.sqrt(noise))
    return rare(value, error, student(confidence, ISLANDS))
