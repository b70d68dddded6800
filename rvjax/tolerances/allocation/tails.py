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

_ALIKE = 0.9  # cosine of two directions that one centre serves
_CENTRES = 8  # of one requirement, at most
_EXTENDED = 8  # units of a plain sample beyond a quantile, at least; a farther tail is extended as a normal one


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
        self.z, self.weights, self.plain = z, np.ones(z.shape[1]), True
        if centres is None or not len(centres.places) or not len(z):
            return
        rng, samples = np.random.default_rng(seed), z.shape[1]
        self.z, self.plain = rng.standard_normal(z.shape), False
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
    """The margin beyond which a share of the units lies, and the units near it.

    Attributes:
        level: the margin; inf where more units have failed, -inf where none is finite.
        units: (m,) near the quantile; none where it is not finite.
        weights: (m,) of these in its derivative, adding up to 1.
        ratio: of its way from the median to that of these units.
    """

    level: float
    units: np.ndarray
    weights: np.ndarray
    ratio: float = 1.0


def quantile(
    margins: np.ndarray, weights: np.ndarray, rejects: float, way: float, near: int, *, plain: bool, sides: int
) -> Quantile:
    """Smooth quantile of weighted units: their mean over ranks near it, so that its derivative is that of these units.

    A normal response gives the ratio of the quantile to this mean, both as ways from the median. The ratio also extends
    the tail of a plain sample with few units beyond. A unit infinitely far inside (an infinite life) counts as one that
    lies `way` inside.

    Args:
        margins: (n,) of the units, inf where one failed.
        weights: (n,) of the units, 1 on average.
        rejects: share of the units.
        way: of the limit.
        near: units behind the derivative.
        plain: True where all weights are 1.
        sides: 2 where units beyond two limits are rejects, else 1.
    """
    nothing = np.zeros(0, int), np.zeros(0)
    order = np.argsort(-margins, kind="stable")
    mass = weights[order] / weights.sum()
    beyond = np.cumsum(mass) - mass / 2
    known = max(rejects, min(_EXTENDED / len(margins), 0.5)) if plain else rejects
    lost = int((margins == math.inf).sum())
    if lost and mass[:lost].sum() >= rejects:
        return Quantile(math.inf, *nothing)
    if lost == len(margins) or np.isneginf(margins).all():
        return Quantile(-math.inf, *nothing)
    at = lost + float(np.interp(known, beyond[lost:], np.arange(len(margins) - lost)))
    half = max(near // 2, 1)
    first, last = max(lost, math.ceil(at) - half), min(len(margins), math.ceil(at) + half)
    units = order[first:last]
    shares = np.maximum(1 - np.abs(np.arange(first, last) - at) / (half + 1), 0.0) * mass[first:last]
    shares /= shares.sum()
    finite = np.maximum(margins, -way)
    median = float(np.interp(0.5, beyond[lost:], finite[order[lost:]]))
    mean = float(shares @ finite[units])
    deviate = lambda share: special.ndtri(1 - np.minimum(share, 0.9) / sides)  # noqa: E731
    ratio = float((deviate(rejects) - deviate(0.5)) / (shares @ deviate(beyond[first:last]) - deviate(0.5)))
    return Quantile(median + (mean - median) * ratio, units, np.where(np.isfinite(margins[units]), shares, 0.0), ratio)
