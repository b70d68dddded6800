"""Figures with their uncertainty: estimates and intervals, moments that can be merged.

The units of one scramble of Sobol points depend on each other, which is the point of them; the scrambles do not, so the
spread between the figures of the scrambles tells the error of their mean (Owen 1997).
"""

import dataclasses
import math

import numpy as np
from scipy import special

FEW = 160
"""With fewer hits or misses than this a share counts as no better than one of independent units: ten per
scramble are too few to show by their spread that it is."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A sampled figure.

    Attributes:
        value: the figure.
        error: its standard error.
        lower: lower end of its confidence interval.
        upper: upper end.
    """

    value: float
    error: float
    lower: float
    upper: float

    @classmethod
    def about(cls, value: float, error: float, deviate: float) -> "Estimate":
        """A figure with an interval of equal sides.

        Args:
            value: of the figure.
            error: its standard error.
            deviate: errors to each side.
        """
        return cls(value, error, value - deviate * error, value + deviate * error)


def deviate_of(confidence: float) -> float:
    """Normal deviate of a two-sided confidence, 1.96 for 0.95."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence!r}: must lie between 0 and 1")
    return float(special.ndtri((1 + confidence) / 2))


def score_interval(share: float, n: float, deviate: float) -> tuple[float, float]:
    """Score interval of Wilson (1927) for a share of n units, which holds at 0 and 1 too."""
    z = deviate
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    return (0.0 if share == 0 else max(0.0, centre - half)), (1.0 if share == 1 else min(1.0, centre + half))


def wilson(successes: int, samples: int, confidence: float) -> Estimate:
    """A share of independent units with the score interval."""
    share = successes / samples
    lower, upper = score_interval(share, samples, deviate_of(confidence))
    return Estimate(share, math.sqrt(share * (1 - share) / samples), lower, upper)


def rare(share: float, error: float, deviate: float) -> Estimate:
    """A small share with an interval of equal factors: a sample that misses what is rare and heavy has a low error too."""
    factor = math.exp(min(deviate * error / share, 700.0)) if share > 0 else 1.0
    return Estimate(share, error, share / factor, min(1.0, share * factor))


def student(confidence: float, scrambles: int) -> float:
    """Deviate of a two-sided confidence where the error comes from the spread between scrambles."""
    deviate_of(confidence)
    return float(special.stdtrit(scrambles - 1, (1 + confidence) / 2)) if scrambles > 1 else math.inf


def mean_of(figures: list[float], value: float, confidence: float) -> Estimate:
    """The figure of all units with its error from those of the scrambles; those without units are nan."""
    known = np.array([figure for figure in figures if not math.isnan(figure)])
    if known.size < 2:
        return Estimate.about(value, math.nan, 0.0)
    return Estimate.about(value, float(known.std(ddof=1)) / math.sqrt(known.size), student(confidence, known.size))


def share_error(hits: np.ndarray, totals: np.ndarray) -> tuple[float, int]:
    """Standard error of a share from hits and units of each scramble, and the number of scrambles behind it."""
    n, filled = totals.sum(), totals > 0
    share = hits.sum() / n
    binomial = math.sqrt(max(0.0, share * (1 - share)) / n)
    scrambles = int(filled.sum())
    if scrambles < 2:
        return binomial, len(totals)
    spread = float(np.std(hits[filled] / totals[filled], ddof=1)) / math.sqrt(scrambles)
    return (max(spread, binomial) if min(hits.sum(), n - hits.sum()) < FEW else spread), scrambles


def share_estimate(hits: np.ndarray, totals: np.ndarray, confidence: float) -> Estimate:
    """A share with the score interval of as many independent units as would have its standard error."""
    n, share = int(totals.sum()), float(hits.sum() / totals.sum())
    error, scrambles = share_error(hits, totals)
    effective = share * (1 - share) / error**2 if error > 0 else n
    lower, upper = score_interval(share, effective, student(confidence, scrambles))
    return Estimate(share, error, lower, upper)


@dataclasses.dataclass
class Moments4:
    """Count, mean and sums of central powers 2..4, extremes; combined pairwise without loss (Pebay 2008)."""

    n: int = 0
    mean: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    minimum: float = math.nan
    maximum: float = math.nan

    @classmethod
    def of(cls, values: np.ndarray) -> "Moments4":
        """Moments of one block."""
        if not values.size:
            return cls()
        centred = values - values[0]  # equal values give exactly zero spread
        offset = float(centred.mean())
        centred -= offset
        squares = centred * centred
        # Not `@`: BLAS threads would fight with the device for the cores.
        sums = float(squares.sum()), float((squares * centred).sum()), float((squares * squares).sum())
        return cls(values.size, float(values[0]) + offset, *sums, float(values.min()), float(values.max()))

    def merge(self, b: "Moments4") -> "Moments4":
        """Moments of both blocks together."""
        if not b.n or not self.n:
            return b if b.n else self
        na, nb, n = self.n, b.n, self.n + b.n
        d = b.mean - self.mean
        s2 = self.s2 + b.s2 + d**2 * na * nb / n
        s3 = self.s3 + b.s3 + d**3 * na * nb * (na - nb) / n**2 + 3 * d * (na * b.s2 - nb * self.s2) / n
        s4 = self.s4 + b.s4 + d**4 * na * nb * (na**2 - na * nb + nb**2) / n**3
        s4 += 6 * d**2 * (na**2 * b.s2 + nb**2 * self.s2) / n**2 + 4 * d * (na * b.s3 - nb * self.s3) / n
        extremes = min(self.minimum, b.minimum), max(self.maximum, b.maximum)
        return Moments4(n, self.mean + d * nb / n, s2, s3, s4, *extremes)

    @property
    def sd(self) -> float:
        """Sample standard deviation; nan for fewer than two values."""
        return math.sqrt(self.s2 / (self.n - 1)) if self.n > 1 else math.nan

    @property
    def mean_or_nan(self) -> float:
        """The mean; nan without values."""
        return self.mean if self.n else math.nan

    def mean_estimate(self, confidence: float) -> Estimate:
        """The mean; its error sd/sqrt(n)."""
        error = self.sd / math.sqrt(self.n) if self.n else math.nan
        return Estimate.about(self.mean_or_nan, error, deviate_of(confidence))

    def sd_estimate(self, confidence: float) -> Estimate:
        """The standard deviation; its error holds for any law, from the fourth moment."""
        sd, n = self.sd, self.n
        if n < 2:
            return Estimate.about(math.nan, math.nan, 0.0)
        m2, m4 = self.s2 / n, self.s4 / n
        spread = math.sqrt(max(0.0, m4 - m2**2 * (n - 3) / (n - 1)) / n)
        error = spread / (2 * sd) if sd > 0 else 0.0
        half = deviate_of(confidence) * error
        return Estimate(sd, error, max(0.0, sd - half), sd + half)


class Pairwise:
    """Moments of a row of blocks, merged in pairs of neighbours, then pairs of pairs.

    The tree depends on the numbers of the blocks alone: in whatever order, or in however many
    processes, the blocks come, the sum has the same bits. It holds one node for each bit of the count
    while the blocks come in order.
    """

    def __init__(self) -> None:
        self._nodes: dict[tuple[int, int], Moments4] = {}

    def add(self, place: int, block: Moments4, level: int = 0) -> None:
        """Take in the block of number `place`, or the node `place` of a higher level."""
        while (level, place ^ 1) in self._nodes:
            other = self._nodes.pop((level, place ^ 1))
            block = other.merge(block) if place & 1 else block.merge(other)
            level, place = level + 1, place >> 1
        self._nodes[level, place] = block

    def total(self) -> Moments4:
        """Moments of all blocks."""
        whole = Moments4()
        for _, node in sorted(self._nodes.items(), key=lambda item: item[0][1] << item[0][0]):
            whole = whole.merge(node)
        return whole

    def state(self) -> np.ndarray:
        """Nodes as rows of level, place and moments."""
        rows = [[level, place, *dataclasses.astuple(node)] for (level, place), node in self._nodes.items()]
        return np.array(rows, float).reshape(len(rows), 2 + len(dataclasses.fields(Moments4)))

    def merge(self, state: np.ndarray) -> None:
        """Take in the nodes of another row's `state`."""
        for level, place, n, *figures in state.tolist():
            self.add(int(place), Moments4(int(n), *figures), int(level))
