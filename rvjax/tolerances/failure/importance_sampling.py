"""Proposal of importance sampling: unit normals about points of failure, and wider ones about the origin.

Probability of failure from failing units: spread until they fail, then contracted step by step.

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
from rvjax.tolerances.failure.form import Found

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


_APART = 0.8  # least distance of two separate points
_MOST_POINTS = 512
_FAR = 1e-4  # points less likely than this, relative to the nearest, are covered by their neighbours
_MIDDLE = ((1.0, 0.05), (2.0, 0.05))  # spread and share of the draws about the origin
_SIMILAR = 0.5  # difference of reliability index


class Mixture:
    """Normals of unit spread about points of failure; a tenth of the draws is about the origin, half of these wider.

    The share about the origin bounds every weight by 20, and reaches failures near the origin that no point covers.
    """

    def __init__(self, numbers: int) -> None:
        """Create a mixture without points, for units of `numbers` random numbers."""
        self.centres = np.zeros((numbers, 0))
        self.converged = np.zeros(0, bool)

    @property
    def count(self) -> int:
        """Points."""
        return self.centres.shape[1]

    @property
    def distances(self) -> np.ndarray:
        """Distances of the points from the origin."""
        return np.linalg.norm(self.centres, axis=0)

    @property
    def nearest(self) -> int:
        """The most likely point."""
        return int(np.argmin(self.distances))

    def reasons(self) -> list[str]:
        """Warnings about the points."""
        if not self.count:
            return ["NO_POINT"]
        alike = self.distances < self.distances[self.nearest] + _SIMILAR
        if self.converged[self.nearest]:  # then the others that no search ended at merely follow a bent limit
            alike &= self.converged
        found = ["SEVERAL_POINTS"] if alike.sum() > 1 else []
        if not self.converged[self.nearest]:
            found.append("KINKED_POINT")
        return found

    def add(self, found: Found) -> np.ndarray:
        """Keep separate points, nearest first; return the new ones (numbers, n)."""
        before = self.centres
        points = np.concatenate([before, found.points], axis=1)
        converged = np.concatenate([self.converged, found.converged])
        distances = np.linalg.norm(points, axis=0)
        kept: list[int] = []
        for k in np.argsort(distances, kind="stable"):
            likely = not kept or distances[k] ** 2 - distances[kept[0]] ** 2 < -2 * math.log(_FAR)
            if likely and len(kept) < _MOST_POINTS and apart(points[:, k], points[:, kept]):
                kept.append(int(k))
        self.centres, self.converged = points[:, kept], converged[kept]
        return points[:, [k for k in kept if apart(points[:, k], before)]]

    def _shares(self) -> np.ndarray:
        """Shares of the draws about the origin, then about each point."""
        middle = np.array([share for _, share in _MIDDLE])
        if not self.count:
            return np.eye(1, len(middle))[0]
        likely = special.ndtr(-self.distances)
        if not likely.any():  # all beyond 38 standard deviations
            likely = special.softmax(special.log_ndtr(-self.distances))
        return np.concatenate([middle, (1 - middle.sum()) * likely / likely.sum()])

    @property
    def plain(self) -> float:
        """Share of the draws that are units as they are made."""
        return float(self._shares()[0])

    def sample(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Units (numbers, count)."""
        numbers, wide = len(self.centres), len(_MIDDLE)
        centres = np.concatenate([np.zeros((numbers, wide)), self.centres], axis=1)
        spreads = np.concatenate([[spread for spread, _ in _MIDDLE], np.ones(self.count)])
        picks = random.choice(wide + self.count, count, p=self._shares())
        return centres[:, picks] + spreads[picks] * random.standard_normal((numbers, count))

    def weights(self, z: np.ndarray) -> np.ndarray:
        """Ratio of the standard normal density to that of the mixture at units (numbers, n)."""
        square = 0.5 * np.sum(z**2, axis=0)
        wide = [square * (1 - spread**-2) - len(z) * math.log(spread) for spread, _ in _MIDDLE]
        # log of the ratio phi(z - c)/phi(z) = c . z - |c|^2/2
        ratios = self.centres.T @ z - 0.5 * np.sum(self.centres**2, axis=0)[:, None]
        logs = special.logsumexp(np.concatenate([wide, ratios]), b=self._shares()[:, None], axis=0)
        return np.exp(-logs)


def apart(point: np.ndarray, points: np.ndarray) -> bool:
    """True if a point (numbers,) is separate from all points (numbers, n)."""
    return bool((np.linalg.norm(points - point[:, None], axis=0) > _APART).all())
