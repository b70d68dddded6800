"""Scrambled Sobol points as the random numbers of units, computed on the host.

Unit i is point i // 16 of scramble i mod 16: every 16 neighbours are one point of each of 16 independent
scrambles (Owen 1995), whose spread gives standard errors.
"""

import math
import operator
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

if TYPE_CHECKING:
    from scipy.stats import qmc

SCRAMBLES = 16
_BITS = 32  # SciPy cannot fast-forward more of them


class SobolPoints:
    """The z of any range of units of one study."""

    def __init__(self, numbers: int, seed: int) -> None:
        """With this many random numbers per unit."""
        self._numbers, self._seed = numbers, operator.index(seed) % 2**64
        self._engines: dict[int, qmc.Sobol] = {}

    def z(self, start: int, count: int) -> np.ndarray:
        """Standard normal numbers of units start .. start + count - 1, (numbers, count)."""
        z = np.empty((self._numbers, count))
        if not self._numbers:
            return z
        for scramble in range(SCRAMBLES):
            offset = (scramble - start) % SCRAMBLES
            points = math.ceil((count - offset) / SCRAMBLES)
            if points > 0:
                z[:, offset::SCRAMBLES] = self._points(scramble, (start + offset) // SCRAMBLES, points).T
        # A point represents a cell of width 2^-32: its mid-point, which is never 0 or 1.
        return special.ndtri(z + 0.5 / 2**_BITS)

    def _points(self, scramble: int, first: int, points: int) -> np.ndarray:
        from scipy.stats import qmc  # a second: half of the start of a command that draws none

        engine = self._engines.get(scramble)
        if engine is None or engine.num_generated > first:
            rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(scramble,)))
            engine = self._engines[scramble] = qmc.Sobol(self._numbers, scramble=True, bits=_BITS, rng=rng)
        if first > engine.num_generated:
            engine.fast_forward(first - engine.num_generated)
        if engine.num_generated:
            return engine.random(points)
        # The very first point by itself: SciPy would warn about a first draw that is no power of two.
        return np.concatenate([engine.random(1), engine.random(points - 1)])
