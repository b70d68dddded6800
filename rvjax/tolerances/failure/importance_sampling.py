"""Proposal of importance sampling: unit normals about points of failure, wider ones about the origin, and a cloud."""

import dataclasses
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
_LEAST = 16  # units of a cloud
_DEPTH = 4  # halvings of the units into clouds
_APART_IF = (
    0.85  # part of the variance along an axis between two halves: 0.64 of a normal, 0.75 of even, 0.81 of a ring
)
_INFLATED = 0.5  # spread of a cloud beyond that of its units, over the root of the numbers: an event has an edge


@dataclasses.dataclass(frozen=True)
class Cloud:
    """A normal of any spread.

    Attributes:
        mean: (numbers,).
        axes: (numbers, numbers), principal.
        sizes: (numbers,) spreads along these.
        share: of all clouds.
    """

    mean: np.ndarray
    axes: np.ndarray
    sizes: np.ndarray
    share: float

    def placed(self, normal: np.ndarray) -> np.ndarray:
        """Units (numbers, n) from standard normal numbers."""
        return self.mean[:, None] + (self.axes * self.sizes) @ normal

    def log_density(self, z: np.ndarray) -> np.ndarray:
        """Logarithm (n,) of the density at units (numbers, n), but for the factor of all normals."""
        steps = self.axes.T @ (z - self.mean[:, None]) / self.sizes[:, None]
        return -0.5 * np.sum(steps**2, axis=0) - float(np.log(self.sizes).sum())


def split(units: np.ndarray, depth: int = 0) -> list[np.ndarray]:
    """Parts of units (numbers, n) that lie apart: halved along the longest axis while that explains its spread."""
    if depth == _DEPTH or units.shape[1] < 2 * _LEAST:
        return [units]
    axes, _ = shape_of(units)
    along = np.sort(place := axes[:, -1] @ units)
    sums, n = np.cumsum(along), np.arange(1, along.size + 1)
    left, right = sums[:-1] / n[:-1], (sums[-1] - sums[:-1]) / (along.size - n[:-1])
    between = n[:-1] * (along.size - n[:-1]) * (left - right) ** 2 / along.size**2
    k = int(np.argmax(between))
    if between[k] <= _APART_IF * along.var() or min(k + 1, along.size - k - 1) < _LEAST:
        return [units]
    low = place <= along[k]
    return split(units[:, low], depth + 1) + split(units[:, ~low], depth + 1)


class Mixture:
    """Normals of unit spread about points of failure; a tenth of the draws is about the origin, half of these wider.

    The share about the origin bounds every weight by 20, and reaches failures near the origin that no point covers. An
    event around the origin, or with parts smaller than a unit normal, has normals of their own spread as well: clouds.
    """

    def __init__(self, numbers: int) -> None:
        """Create a mixture without points, for units of `numbers` random numbers."""
        self.centres = np.zeros((numbers, 0))
        self.converged = np.zeros(0, bool)
        self.clouds: list[Cloud] = []
        self.in_clouds = 0.0
        """Share of the draws in the clouds, of those not about the origin."""
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
        """Lay clouds over units of the event (numbers, n), for this share of all draws not about the origin."""
        inflated = 1 + _INFLATED / math.sqrt(len(units))
        self.clouds, self.in_clouds = [], share
        for part in split(units):
            axes, sizes = shape_of(part)
            self.clouds.append(Cloud(part.mean(axis=1), axes, inflated * sizes, part.shape[1] / units.shape[1]))

    def _shares(self) -> np.ndarray:
        """Shares of the draws about the origin, in each cloud, and about each point."""
        middle = np.array([share for _, share in _MIDDLE])
        rest = 1 - middle.sum()
        if self.frequent or not (self.count or self.clouds):
            return np.eye(1, len(middle) + len(self.clouds) + self.count)[0]
        in_clouds = (self.in_clouds if self.count else 1.0) if self.clouds else 0.0
        about = special.ndtr(-self.distances)
        if self.count and not about.any():  # all beyond 38 standard deviations
            about = special.softmax(special.log_ndtr(-self.distances))
        about = (1 - in_clouds) * about / max(about.sum(), np.finfo(float).tiny)
        within = [in_clouds * cloud.share for cloud in self.clouds]
        return np.concatenate([middle, rest * np.array(within), rest * about])

    @property
    def plain(self) -> float:
        """Share of the draws that are units as they are made."""
        return float(self._shares()[0])

    def sample(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Units (numbers, count)."""
        numbers, first = len(self.centres), len(_MIDDLE) + len(self.clouds)
        centres = np.concatenate([np.zeros((numbers, first)), self.centres], axis=1)
        spreads = np.concatenate([[spread for spread, _ in _MIDDLE], np.ones(len(self.clouds) + self.count)])
        picks = random.choice(first + self.count, count, p=self._shares())
        normal = random.standard_normal((numbers, count))
        z = centres[:, picks] + spreads[picks] * normal
        for k, cloud in enumerate(self.clouds, len(_MIDDLE)):
            z = np.where(picks == k, cloud.placed(normal), z)
        return z

    def weights(self, z: np.ndarray) -> np.ndarray:
        """Ratio of the standard normal density to that of the mixture at units (numbers, n)."""
        square = 0.5 * np.sum(z**2, axis=0)
        wide = [square * (1 - spread**-2) - len(z) * math.log(spread) for spread, _ in _MIDDLE]
        # log of the ratio phi(z - c)/phi(z) = c . z - |c|^2/2
        ratios = self.centres.T @ z - 0.5 * np.sum(self.centres**2, axis=0)[:, None]
        within = [square + cloud.log_density(z) for cloud in self.clouds]
        logs = special.logsumexp(
            np.concatenate([wide, *[row[None] for row in within], ratios]), b=self._shares()[:, None], axis=0
        )
        return np.exp(-logs)


def apart(point: np.ndarray, points: np.ndarray) -> bool:
    """True if a point (numbers,) is separate from all points (numbers, n)."""
    return bool((np.linalg.norm(points - point[:, None], axis=0) > _APART).all())
