"""Units where the limits are: importance sampling of the tails that decide, with smooth quantiles.

A plain sample of thousands of units leaves a dozen beyond a limit at 99.73 %. Here most units lie about the points at
which a limit is met: standard normal numbers z, moved by a centre c along the gradient of the response. The density of
the mixture q(z) = s_0 phi(z) + sum_m s_m phi(z - c_m) gives every unit its weight phi/q = 1/(s_0 + sum_m s_m
exp(c_m.z - c_m.c_m/2)), never above 1/s_0 (Owen and Zhou 2000). Along its centre each part is stratified.

A quantile is that of margins with a normal error of small width h: sum w Phi((margin - q)/h) = allowed rejects. It is
differentiable, and its derivative is the mean of the derivatives of units, weighted by w phi((margin - q)/h).
"""

import copy
import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import scipy
from scipy import special

from rvjax.tolerances.optimum.jackknife import GROUPS, groups

PLAIN_SHARE = 0.25
"""Share of the units without importance: no weight exceeds its reciprocal."""

_ALIKE = 0.9  # cosine of two directions that one centre serves
_CENTRES = 8  # of one requirement, at most
_MIRRORED, _OPPOSITE = 1.6, 0.25  # times as far, an opposite limit may matter; its share of the units
_WIDTHS = 3.5  # beyond which a unit has no effect on the slope of a smooth quantile
_ROUNDED = 9.0  # beyond which its share is 0 or 1 to the last bit of a sum


@dataclasses.dataclass(frozen=True)
class Centres:
    """Places of the tails.

    Attributes:
        places: (m, numbers) centres in the space of z.
        shares: (m,) of the units, adding up to 1.
    """

    places: np.ndarray
    shares: np.ndarray

    def mirrored(self, reach: float) -> "Centres":
        """With the opposite of the largest place, `reach` times as far away, if that is near and none lies there."""
        place = self.places[int(np.argmax(self.shares))]
        sizes = np.linalg.norm(self.places, axis=1) * np.linalg.norm(place)
        if not 0 < reach < _MIRRORED or (self.places @ place < -_ALIKE * sizes).any():
            return self
        shares = np.append((1 - _OPPOSITE) * self.shares, _OPPOSITE * self.shares.sum())
        return Centres(np.concatenate([self.places, -reach * place[None]]), shares)

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
    """Standard normal numbers of units, and their weights."""

    def __init__(self, numbers: int, samples: int, seed: int, centres: Centres | None = None) -> None:
        rng = np.random.default_rng(seed)
        self.centres = centres
        self.z = rng.standard_normal((numbers, samples))
        self.weights = np.ones(samples)
        if centres is None or not len(centres.places) or not numbers:
            return
        counts = np.floor((1 - PLAIN_SHARE) * samples * centres.shares).astype(int)
        first, density = 0, np.full(samples, (samples - counts.sum()) / samples)
        for place, count in zip(centres.places, counts):
            distance = float(np.linalg.norm(place))
            if count and distance > 0:
                self._place(place / distance, distance, slice(first, first + count), rng)
            first += count
        self._stratify_plain(centres, slice(first, samples), rng)
        for place, count in zip(centres.places, counts):
            density += count / samples * np.exp(np.clip(place @ self.z - place @ place / 2, -700, 700))
        self.weights = 1 / density

    def parts(self) -> Iterator["TailSample"]:
        """The sample without one group of units, which have no weight, for each group."""
        group = groups(len(self.weights))
        for k in range(GROUPS):
            found = copy.copy(self)
            found.weights = np.where(group == k, 0.0, self.weights * len(group) / (group != k).sum())
            yield found

    def _place(self, along: np.ndarray, distance: float, units: slice, rng: np.random.Generator) -> None:
        """Units about a centre, stratified along its direction."""
        count = units.stop - units.start
        strata = special.ndtri((rng.permutation(count) + rng.random(count)) / count)
        own = self.z[:, units]
        self.z[:, units] = own + np.outer(along, distance + strata - along @ own)

    def _stratify_plain(self, centres: Centres, units: slice, rng: np.random.Generator) -> None:
        """Units without a centre, stratified along the first direction."""
        place = centres.places[int(np.argmax(centres.shares))]
        distance = float(np.linalg.norm(place))
        if units.stop > units.start and distance > 0:
            self._place(place / distance, 0.0, units, rng)


def smooth_quantile(margins: np.ndarray, weights: np.ndarray, rejects: float, width: float) -> float:
    """Margin beyond which the weighted share of `rejects` lies; inf where more than that have failed (inf).

    A margin of -inf is that of a unit within its limits, such as one with an infinite life.

    Args:
        margins: (n,) of the units.
        weights: (n,) of the units, 1 on average.
        rejects: allowed share.
        width: of the smoothing, unit of the margins.
    """
    finite = np.isfinite(margins)
    failed = float(weights[~finite & ~np.isneginf(margins)].sum()) / len(margins)
    if failed >= rejects or not finite.any():
        return math.inf
    own, mass = margins[finite], weights[finite] / len(margins)
    if float(mass.sum()) + failed <= rejects:
        return float(own.min())
    order = np.argsort(-own)
    beyond = failed + np.cumsum(mass[order])
    at = own[order[min(int(np.searchsorted(beyond, rejects)), len(own) - 1)]]

    def excess(level: float) -> float:
        away = (own - level) / width
        shares, near = (away > 0).astype(float), np.flatnonzero(np.abs(away) < _ROUNDED)
        shares[near] = special.ndtr(away[near])
        return failed + float(mass @ shares) - rejects

    low, high = at - width, at + width
    while excess(low) < 0:
        low -= 2 * (high - low)
    while excess(high) > 0:
        high += 2 * (high - low)
    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-10 * width + 1e-300, rtol=1e-12))


def kernel(margins: np.ndarray, weights: np.ndarray, level: float, width: float) -> np.ndarray:
    """Weights (n,) of the units in the derivative of a smooth quantile; they add up to 1.

    Args:
        margins: (n,) of the units.
        weights: (n,) of the units.
        level: the quantile.
        width: of the smoothing, unit of the margins.
    """
    away = (margins - level) / width
    near = np.abs(away) < _WIDTHS
    found = np.zeros(len(margins))
    found[near] = weights[near] * np.exp(-(away[near] ** 2) / 2)
    total = found.sum()
    return found / total if total > 0 else found
