"""Proposal of importance sampling: unit normals about points of failure, and wider ones about the origin."""

import math

import numpy as np
from scipy import special

from rvjax.tolerances.failure.form import Found

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
