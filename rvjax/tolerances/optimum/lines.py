"""Lines across a limit: quantiles of margins and their derivatives with next to no noise.

A unit on a line z = p + r u has its part p across the direction u of a centre; where its margin reaches a level, at
r(p), it fails beyond. The share of failed units is the mean of Phi(-r) over lines (line sampling: Koutsourelakis,
Pradlwarter and Schueller 2004), and the derivative of a quantile is that of the units where lines meet it, weighted by
phi(r) over the slope of the margin along the line. For a linear response of normal errors both are exact, because p
comes in pairs p and -p. Of several centres each counts the part of a unit that its share in the mixture of
`tail_sample` has.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy import special

from rvjax.tolerances.optimum.tail_sample import Centres

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_FAR = 12.0  # standard deviations, beyond which no unit counts
_STEP = 1.5  # of a line, at most, in one iteration
_CLOSE = 1e-4  # of such a step, weighted, at the end; the error is of its square
_ITERATIONS = 15
_LOST = 1e-3  # share of the weights of lines that may not meet the level
_LEVELS = 30  # steps for a level on linear lines

Measure = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Margins (n,) of units z (numbers, n), and their derivatives (n,) along directions (numbers, n)."""


@dataclasses.dataclass(frozen=True)
class Crossing:
    """Crossings of lines with the quantile of a margin.

    Attributes:
        level: the quantile.
        weights: (n,) of the units measured last in the derivative of the quantile, adding up to 1.
    """

    level: float
    weights: np.ndarray


class Lines:
    """Lines along the directions of the centres of one limit; they begin where they last met it."""

    def __init__(self, centres: Centres, count: int, seed: int) -> None:
        """`count` lines for each centre, an even number."""
        places = centres.places
        sizes = np.linalg.norm(places, axis=1)
        with np.errstate(divide="ignore"):
            logs = np.log(centres.shares)
        numbers, pieces = places.shape[1], []
        for k, (place, size) in enumerate(zip(places, sizes)):
            draw, row = np.random.default_rng((seed, k)), np.arange(count // 2)  # scipy.stats takes a second to import
            places_of = draw.permuted(np.broadcast_to(row, (numbers, len(row))), axis=1)  # Latin hypercube
            p = special.ndtri((places_of + 0.5) / len(row))
            p -= np.outer(place, place @ p) / size**2
            pieces.append(np.concatenate([p, -p], axis=1))
        self._across = np.concatenate(pieces, axis=1)
        self._along = np.repeat((places / sizes[:, None]).T, count, axis=1)
        self._r = np.repeat(sizes, count)
        self._count = count
        # Logarithm of the part of each other centre over that of the line's own: offset + rate r.
        offsets = (logs - sizes**2 / 2)[:, None] + places @ self._across
        own = np.repeat(np.arange(len(places)), count)
        self._offsets = offsets - offsets[own, np.arange(len(own))]
        rates = places @ self._along
        self._rates = rates - rates[own, np.arange(len(own))]

    def _part(self, r: np.ndarray) -> np.ndarray:
        """Part (n, q) of units at r (n, q) that the line's own centre counts."""
        if len(self._offsets) == 1:
            return np.ones_like(r)
        powers = self._offsets[:, :, None] + self._rates[:, :, None] * r
        return 1 / np.exp(np.clip(powers, -700, 300)).sum(axis=0)

    def _beyond(self, r: np.ndarray) -> float:
        """Share of units beyond r (n,) on the lines."""
        tail = special.ndtr(-r)
        s = -special.ndtri(np.clip(np.outer(tail, (1 + _NODES) / 2), 1e-300, 1.0))
        return float(tail @ (self._part(np.minimum(s, 37.0)) @ (_WEIGHTS / 2))) / self._count

    def _density(self, r: np.ndarray) -> np.ndarray:
        return np.exp(-(r**2) / 2) / math.sqrt(2 * math.pi) * self._part(r[:, None])[:, 0] / self._count

    def cross(self, measure: Measure, rejects: float) -> Crossing | None:
        """Find the crossings beyond which the share of `rejects` lies; None where lines do not meet it."""
        r = self._r
        for _ in range(_ITERATIONS):
            z = self._across + r * self._along
            margins, rates = measure(z, self._along)
            good = np.isfinite(margins) & np.isfinite(rates) & (rates > 0)
            if not good.any():
                return None
            level = self._level(r, margins, rates, good, rejects)
            if level is None:
                return None
            steps = np.where(good, (level - np.where(good, margins, 0.0)) / np.where(good, rates, 1.0), _STEP)
            moved = np.clip(r + np.clip(steps, -_STEP, _STEP), -_FAR, _FAR)
            weights = np.where(good & (moved < _FAR), self._density(moved) / np.where(good, rates, 1.0), 0.0)
            total, change = float(weights.sum()), np.abs(moved - r)
            r = moved
            if not total > 0:
                return None
            if float(weights @ change) <= _CLOSE * total and float(weights[change > 0.1].sum()) <= _LOST * total:
                self._r = r
                return Crossing(level, weights / total)
        return None

    def _level(
        self, r: np.ndarray, margins: np.ndarray, rates: np.ndarray, good: np.ndarray, rejects: float
    ) -> float | None:
        """Level beyond which the share of `rejects` lies, with margins linear on each line."""
        start, at, slope = r[good], margins[good], rates[good]
        level = float(np.average(at, weights=self._density(r)[good] / slope + 1e-300))
        for _ in range(_LEVELS):
            there = np.full(len(r), _FAR)
            there[good] = np.clip(start + np.clip((level - at) / slope, -_STEP, _STEP), -_FAR, _FAR)
            share, density = self._beyond(there), float(self._density(there)[good] @ (1 / slope))
            if not (share > 0 and density > 0):
                return None
            step = share * math.log(share / rejects) / density
            level += step
            if abs(step) * density <= 1e-9 * share:
                return level
        return None
