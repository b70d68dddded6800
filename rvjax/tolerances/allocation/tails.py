"""Units where the limits are: importance sampling of the tails that decide, and quantiles of weighted units.

A plain sample of thousands of units leaves a dozen beyond a limit at 99.73 %. Where units are quick most of them lie
about the points at which a limit is met: standard normal numbers z, moved by a centre c along the gradient of the
response. The density of the mixture q(z) = s_0 phi(z) + sum_m s_m phi(z - c_m) gives every unit its weight phi/q =
1/(s_0 + sum_m s_m exp(c_m.z - c_m.c_m/2)), never above 1/s_0 (Owen and Zhou 2000). Along its centre each part is
stratified.
"""

import dataclasses
import math

import numpy as np
from scipy import special

PLAIN_SHARE = 0.25
"""Share of the units without importance: no weight exceeds its reciprocal."""

_NARROW = 0.29  # logarithm of that at a share of 1; the window grows as the tail becomes straighter
FEWEST = 16
"""Units that a quantile is formed of, at least; fewer rejects are counted."""

_WIDE = math.log(4)  # logarithm of a rank over that of a quantile, that it is formed of
_ALIKE = 0.9  # cosine of two directions that one centre serves
_CENTRES = 8  # of one requirement, at most


@dataclasses.dataclass(frozen=True)
class Centres:
    """Places of the tails.

    Attributes:
        places: (m, numbers) centres in the space of z.
        shares: (m,) of the units, adding up to 1.
    """

    places: np.ndarray
    shares: np.ndarray

    @classmethod
    def joined(cls, several: list["Centres"]) -> "Centres":
        """Centres of several requirements, alike in units."""
        places = np.concatenate([item.places for item in several])
        return cls(places, np.concatenate([item.shares for item in several]) / len(several))


def centres_of(z: np.ndarray, gradients: np.ndarray, weights: np.ndarray, least: float) -> Centres:
    """Centres of the tail that some units begin: at their distance along the gradients of their margins.

    Args:
        z: (numbers, n) of the units.
        gradients: (numbers, n) of their margins.
        weights: (n,) of the units.
        least: distance of a centre from the mean, at least.
    """
    sizes = np.linalg.norm(gradients, axis=0)
    used = np.flatnonzero((sizes > 0) & np.isfinite(sizes) & (weights > 0))
    along = gradients[:, used] / sizes[used]
    weights, reach = weights[used], np.einsum("ij,ij->j", along, z[:, used])
    members = np.full(len(used), -1)
    heads: list[np.ndarray] = []
    for i in np.argsort(-weights, kind="stable"):
        cosines = np.array([head @ along[:, i] for head in heads])
        if not heads or (cosines.max() < _ALIKE and len(heads) < _CENTRES):
            heads.append(along[:, i])
            cosines = np.append(cosines, 1.0)
        members[i] = int(np.argmax(cosines))
    places, shares = [], []
    for m in range(len(heads)):
        own = members == m
        mean = along[:, own] @ weights[own]
        distance = max(least, float(weights[own] @ reach[own] / weights[own].sum()))
        places.append(distance * mean / np.linalg.norm(mean))
        shares.append(weights[own].sum())
    return Centres(np.reshape(places, (len(heads), len(z))), np.array(shares) / max(sum(shares), 1e-300))


class TailSample:
    """Standard normal numbers z (numbers, n) of units, and their weights (n,), 1 on average."""

    def __init__(self, z: np.ndarray, seed: int, centres: Centres | None = None) -> None:
        """Units of a plain sample z; with `centres` they are moved there."""
        self.z, self.weights = z, np.ones(z.shape[1])
        if centres is None or not len(centres.places) or not len(z):
            return
        rng, samples = np.random.default_rng(seed), z.shape[1]
        self.z = rng.standard_normal(z.shape)
        counts = np.floor((1 - PLAIN_SHARE) * samples * centres.shares).astype(int)
        first, density = 0, np.full(samples, (samples - counts.sum()) / samples)
        for place, count in zip(centres.places, counts):
            distance = float(np.linalg.norm(place))
            if count and distance > 0:
                self._place(place / distance, distance, slice(first, first + count), rng)
            first += count
        place = centres.places[int(np.argmax(centres.shares))]
        distance = float(np.linalg.norm(place))
        if samples > first and distance > 0:  # the plain ones are stratified along the first direction
            self._place(place / distance, 0.0, slice(first, samples), rng)
        for place, count in zip(centres.places, counts):
            density += count / samples * np.exp(np.clip(place @ self.z - place @ place / 2, -700, 700))
        self.weights = 1 / density

    def _place(self, along: np.ndarray, distance: float, units: slice, rng: np.random.Generator) -> None:
        """Units about a centre, stratified along its direction."""
        count = units.stop - units.start
        strata = special.ndtri((rng.permutation(count) + rng.random(count)) / count)
        own = self.z[:, units]
        self.z[:, units] = own + np.outer(along, distance + strata - along @ own)


@dataclasses.dataclass(frozen=True)
class Quantile:
    """The margin beyond which a share of the units lies: a sum of margins near it.

    Attributes:
        level: the margin; inf where more units have failed, -inf where none is finite.
        units: (m,) near the quantile; none where it is not finite.
        weights: (m,) of their margins in it, adding up to 1.
    """

    level: float
    units: np.ndarray
    weights: np.ndarray


def quantile(margins: np.ndarray, weights: np.ndarray, rejects: float, way: float, near: int) -> Quantile:
    """Smooth quantile of weighted units: a line through the margins of units near it, over the logarithm of their rank.

    So its derivative is a sum of those of these units, and tails may be as heavy as those of a pin force are. The line
    also extends a tail with few units beyond. A unit infinitely far inside (an infinite life) counts as one that lies
    `way` inside.

    Args:
        margins: (n,) of the units, inf where one failed.
        weights: (n,) of the units, 1 on average.
        rejects: share of the units.
        way: of the limit.
        near: units behind the derivative, at most.
    """
    nothing = np.zeros(0, int), np.zeros(0)
    order = np.argsort(-margins, kind="stable")
    mass = weights[order] / weights.sum()
    beyond = np.cumsum(mass) - mass / 2
    lost = int((margins == math.inf).sum())
    if lost and mass[:lost].sum() >= rejects:
        return Quantile(math.inf, *nothing)
    if lost == len(margins) or np.isneginf(margins).all():
        return Quantile(-math.inf, *nothing)
    rank = -np.log(beyond[lost:])
    far = np.abs(rank + math.log(rejects))  # the outermost units, which may lie anywhere, do not count
    wide = min(_WIDE, _NARROW / rejects ** (1 / 3))  # a tail is the straighter, the farther out it is
    nearest = np.argsort(far, kind="stable")[: max(min(int((far < wide).sum()), near), FEWEST)]
    first, last = lost + int(nearest.min()), lost + int(nearest.max()) + 1
    units, rank, far = order[first:last], rank[first - lost : last - lost], far[first - lost : last - lost]
    shares = np.maximum(1 - far / (far.max() * (1 + 1 / len(far))), 0.0) * mass[first:last]
    shares /= shares.sum()
    away = rank - shares @ rank
    spread = float(shares @ away**2)
    line = shares * (1 + away * float(-math.log(rejects) - shares @ rank) / spread) if spread > 0 else shares
    level = float(line @ np.maximum(margins[units], -way))
    return Quantile(level, units, np.where(np.isfinite(margins[units]), line, 0.0))
