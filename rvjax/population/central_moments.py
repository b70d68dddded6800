"""Central moments that can be merged: what a run keeps of any number of values."""

import dataclasses
import math

import numpy as np

from rvjax.population.estimates import Estimate, deviate_of, skewed


@dataclasses.dataclass
class CentralMoments:
    """Count, mean and sums of central powers 2..6, extremes; combined pairwise without loss (Pebay 2008)."""

    n: int = 0
    mean: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    s5: float = 0.0
    s6: float = 0.0
    minimum: float = math.nan
    maximum: float = math.nan

    @classmethod
    def of(cls, values: np.ndarray) -> "CentralMoments":
        """Moments of one block."""
        if not values.size:
            return cls()
        centred = values - values[0]  # equal values give exactly zero spread
        offset = float(centred.mean())
        centred -= offset
        power, sums = centred, []
        for _ in range(2, 7):
            power = power * centred
            sums.append(float(power.sum()))  # not `@`: BLAS threads would fight with the device for the cores
        s2, s3, s4, s5, s6 = sums
        mean, least, most = float(values[0]) + offset, float(values.min()), float(values.max())
        return cls(values.size, mean, s2, s3, s4, s5, s6, least, most)

    @property
    def sums(self) -> tuple[float, ...]:
        """Sums of the central powers 0..6."""
        return float(self.n), 0.0, self.s2, self.s3, self.s4, self.s5, self.s6

    def merge(self, b: "CentralMoments") -> "CentralMoments":
        """Moments of both blocks together."""
        if not b.n or not self.n:
            return b if b.n else self
        n, d = self.n + b.n, b.mean - self.mean
        mean = self.mean + d * b.n / n
        ours, theirs = -d * b.n / n, d * self.n / n  # of the blocks' own means from the common one
        x, y = self.sums, b.sums
        s2, s3, s4, s5, s6 = (
            sum(math.comb(p, k) * (ours**k * x[p - k] + theirs**k * y[p - k]) for k in range(p + 1))
            for p in range(2, 7)
        )
        least, most = min(self.minimum, b.minimum), max(self.maximum, b.maximum)
        return CentralMoments(n, mean, s2, s3, s4, s5, s6, least, most)

    @property
    def sd(self) -> float:
        """Sample standard deviation; nan for fewer than two values."""
        return math.sqrt(self.s2 / (self.n - 1)) if self.n > 1 else math.nan

    @property
    def mean_or_nan(self) -> float:
        """The mean; nan without values."""
        return self.mean if self.n else math.nan

    def mean_estimate(self, confidence: float) -> Estimate:
        """Return the mean; its error sd/sqrt(n)."""
        error = self.sd / math.sqrt(self.n) if self.n else math.nan
        skewness = math.sqrt(self.n) * self.s3 / self.s2**1.5 if self.s2 > 0 else 0.0
        return skewed(self.mean_or_nan, error, skewness, self.n, deviate_of(confidence))

    def sd_estimate(self, confidence: float) -> Estimate:
        """The standard deviation; its error holds for any distribution, its interval is that of the mean square."""
        sd, n = self.sd, self.n
        if n < 2:
            return Estimate.about(math.nan, math.nan, 0.0)
        m2, m4, m6 = self.s2 / n, self.s4 / n, self.s6 / n
        spread = math.sqrt(max(0.0, m4 - m2**2 * (n - 3) / (n - 1)) / n)
        if not spread > 0:
            return Estimate(sd, 0.0, sd, sd)
        # Third central moment of the squares, whose mean is m2.
        skewness = (m6 - 3 * m4 * m2 + 2 * m2**3) / max(m4 - m2**2, spread**2) ** 1.5
        square = skewed(sd**2, spread, skewness, n, deviate_of(confidence))
        return Estimate(sd, spread / (2 * sd), math.sqrt(max(0.0, square.lower)), math.sqrt(square.upper))


class Pairwise:
    """Moments of a row of blocks, merged in pairs of neighbours, then pairs of pairs.

    The tree depends on the numbers of the blocks only: the sum is bit-identical for any order of the
    blocks and any number of processes. It holds one node for each bit of the count
    while the blocks come in order.
    """

    def __init__(self) -> None:
        self._nodes: dict[tuple[int, int], CentralMoments] = {}

    def add(self, place: int, block: CentralMoments, level: int = 0) -> None:
        """Take in the block of number `place`, or the node `place` of a higher level."""
        while (level, place ^ 1) in self._nodes:
            other = self._nodes.pop((level, place ^ 1))
            block = other.merge(block) if place & 1 else block.merge(other)
            level, place = level + 1, place >> 1
        self._nodes[level, place] = block

    def total(self) -> CentralMoments:
        """Moments of all blocks."""
        whole = CentralMoments()
        for _, node in sorted(self._nodes.items(), key=lambda item: item[0][1] << item[0][0]):
            whole = whole.merge(node)
        return whole

    def state(self) -> np.ndarray:
        """Nodes as rows of level, place and moments."""
        rows = [[level, place, *dataclasses.astuple(node)] for (level, place), node in self._nodes.items()]
        return np.array(rows, float).reshape(len(rows), 2 + len(dataclasses.fields(CentralMoments)))

    def merge(self, state: np.ndarray) -> None:
        """Take in the nodes of another row's `state`."""
        for level, place, n, *figures in state.tolist():
            self.add(int(place), CentralMoments(int(n), *figures), int(level))
