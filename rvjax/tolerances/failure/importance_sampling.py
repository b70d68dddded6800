"""Proposal of importance sampling: unit normals about points of failure, wider ones about the origin, and a cloud."""

import math

import numpy as np
from scipy import special

from rvjax.tolerances.failure.form import Found
from rvjax.tolerances.failure.subset import shape_of

_APART = 0.8  # least distance of two separate points
_MOST_POINTS = 512
_FAR = 1e-4  # points less likely than this, relative to the nearest, are covered by their neighbours
_MIDDLE = ((1.0, 0.05), (2.0, 0.05))  # spread and share of the draws about the origin
_SIMILAR = 0.5  # difference of reliability index
_INFLATED = 0.5  # spread of a cloud beyond that of its units, over the root of the numbers: an event has an edge


class Mixture:
    """Normals of unit spread about points of failure; a tenth of the draws is about the origin, half of these wider.

    The share about the origin bounds every weight by 20, and reaches failures near the origin that no point covers. An
    event around the origin, or smaller than a unit normal, has a normal of its own spread instead of points: the cloud.
    """

    def __init__(self, numbers: int) -> None:
        """Create a mixture without points, for units of `numbers` random numbers."""
        self.centres = np.zeros((numbers, 0))
        self.converged = np.zeros(0, bool)
        self.cloud: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        """Mean (numbers,) of the cloud, its principal axes, and its spreads along these."""
        self.in_cloud = 0.0
        """Share of the draws in the cloud, of those not about the origin."""
        self.frequent = False
        """The event is so common that units as they are made estimate it best."""

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

    def gather(self, units: np.ndarray, share: float) -> None:
        """Lay a cloud over units of the event (numbers, n), for this share of all draws not about the origin."""
        axes, sizes = shape_of(units)
        inflated = 1 + _INFLATED / math.sqrt(len(units))
        self.cloud, self.in_cloud = (units.mean(axis=1), axes, inflated * sizes), share

    def _shares(self) -> np.ndarray:
        """Shares of the draws about the origin, in the cloud, and about each point."""
        middle = np.array([share for _, share in _MIDDLE])
        rest = 1 - middle.sum()
        if self.frequent or not (self.count or self.cloud):
            return np.eye(1, len(middle) + 1 + self.count)[0]
        in_cloud = (self.in_cloud if self.count else 1.0) if self.cloud else 0.0
        about = special.ndtr(-self.distances)
        if self.count and not about.any():  # all beyond 38 standard deviations
            about = special.softmax(special.log_ndtr(-self.distances))
        about = (1 - in_cloud) * about / max(about.sum(), np.finfo(float).tiny)
        return np.concatenate([middle, [rest * in_cloud], rest * about])

    @property
    def plain(self) -> float:
        """Share of the draws that are units as they are made."""
        return float(self._shares()[0])

    def sample(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Units (numbers, count)."""
        numbers, wide = len(self.centres), len(_MIDDLE)
        centres = np.concatenate([np.zeros((numbers, wide + 1)), self.centres], axis=1)
        spreads = np.concatenate([[spread for spread, _ in _MIDDLE], np.ones(1 + self.count)])
        picks = random.choice(wide + 1 + self.count, count, p=self._shares())
        normal = random.standard_normal((numbers, count))
        z = centres[:, picks] + spreads[picks] * normal
        if self.cloud:
            mean, axes, sizes = self.cloud
            z = np.where(picks == wide, mean[:, None] + (axes * sizes) @ normal, z)
        return z

    def weights(self, z: np.ndarray) -> np.ndarray:
        """Ratio of the standard normal density to that of the mixture at units (numbers, n)."""
        square = 0.5 * np.sum(z**2, axis=0)
        wide = [square * (1 - spread**-2) - len(z) * math.log(spread) for spread, _ in _MIDDLE]
        # log of the ratio phi(z - c)/phi(z) = c . z - |c|^2/2
        ratios = self.centres.T @ z - 0.5 * np.sum(self.centres**2, axis=0)[:, None]
        within = np.zeros(z.shape[1])
        if self.cloud:
            mean, axes, sizes = self.cloud
            steps = axes.T @ (z - mean[:, None]) / sizes[:, None]
            within = square - 0.5 * np.sum(steps**2, axis=0) - np.log(sizes).sum()
        logs = special.logsumexp(np.concatenate([wide, [within], ratios]), b=self._shares()[:, None], axis=0)
        return np.exp(-logs)


def apart(point: np.ndarray, points: np.ndarray) -> bool:
    """True if a point (numbers,) is separate from all points (numbers, n)."""
    return bool((np.linalg.norm(points - point[:, None], axis=0) > _APART).all())
