"""Estimates: values with standard errors and intervals.

The units of one scramble of Sobol points depend on each other, which is the point of them; the scrambles do not, so the
spread between the values of the scrambles gives the error of their mean (Owen 1997).
"""

import dataclasses
import math

import numpy as np
from scipy import special

FEW = 160
"""With fewer hits or misses than this a share counts as no better than one of independent units: ten per
scramble are too few to show by their spread that it is."""

_DECIDES, _FEW_TERMS = 0.1, 48.0  # part of one term in a sum of very many; of 1024 it is 0.25, of 128 it is 0.52

_UNSEEN_SKEWNESS = 2.0  # times that of 16 values: covers 94 % of chi-square and lognormal cases, 1 covers 90 %


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A sampled statistic.

    Attributes:
        value: the estimate.
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
        """Return a value with an interval of equal sides.

        Args:
            value: the estimate.
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
    """Return a share of independent units with the score interval."""
    share = successes / samples
    lower, upper = score_interval(share, samples, deviate_of(confidence))
    return Estimate(share, math.sqrt(share * (1 - share) / samples), lower, upper)


def clopper_pearson(successes: int, samples: int, confidence: float) -> Estimate:
    """Return a share of independent units with the exact interval of Clopper and Pearson (1934)."""
    share, tail = successes / samples, (1 - confidence) / 2
    lower = float(special.betaincinv(successes, samples - successes + 1, tail)) if successes else 0.0
    upper = float(special.betaincinv(successes + 1, samples - successes, 1 - tail)) if successes < samples else 1.0
    return Estimate(share, math.sqrt(share * (1 - share) / samples), lower, upper)


def rare(share: float, error: float, deviate: float) -> Estimate:
    """A small share, its interval of equal factors: a sample without what is rare and heavy has a low error too."""
    factor = math.exp(min(deviate * error / share, 700.0)) if share > 0 else 1.0
    return Estimate(share, error, share / factor, min(1.0, share * factor))


def student(confidence: float, scrambles: int) -> float:
    """Deviate of a two-sided confidence where the error comes from the spread between scrambles."""
    deviate_of(confidence)
    return float(special.stdtrit(scrambles - 1, (1 + confidence) / 2)) if scrambles > 1 else math.inf


def skewed(value: float, error: float, skewness: float, n: float, deviate: float) -> Estimate:
    """Return a mean of n independent terms: an interval that holds both the symmetric one and Hall's.

    Where the terms are skewed, a sample without the rare large ones has a low mean and a low error together; the
    transformation of Hall (1992, J. R. Stat. Soc. B 54, 221) moves the interval towards the long tail.

    Args:
        value: of the mean.
        error: its standard error.
        skewness: of the terms.
        n: terms.
        deviate: errors to each side if the terms are not skewed.
    """
    if not (error > 0 and math.isfinite(skewness)):
        return Estimate.about(value, error, deviate if error > 0 else 0.0)
    third = skewness / 3 if abs(skewness) > 1e-6 else math.copysign(1e-6, skewness)

    def way(x: float) -> float:
        """Mean less value, over the error, where the transformed statistic is x."""
        moved = 1 + 3 * third * (x / math.sqrt(n) - skewness / (6 * n))
        return -math.sqrt(n) * float(np.cbrt(moved) - 1) / third

    lower, upper = min(way(deviate), -deviate), max(way(-deviate), deviate)
    return Estimate(value, error, value + error * lower, value + error * upper)


def one_decides(largest: float, whole: float, n: float) -> bool:
    """True if one of n positive terms has so large a part of their sum that their mean may not exist.

    Of squares of 1024 values: exponential 0, squared normal 1, lognormal (0.83) 38 of 1000 samples; of Pareto values
    with index 2, 1.5, 1, 0.3, whose variance does not exist, 559, 770, 949, 1000.

    Args:
        largest: of the terms.
        whole: their sum.
        n: terms.
    """
    return largest > _DECIDES * (1 + _FEW_TERMS / math.sqrt(n)) * whole


def unknown_share(share: Estimate) -> Estimate:
    """Return a share with the interval of one that nothing is known of.

    Args:
        share: the estimate.
    """
    return Estimate(share.value, 0.5, min(0.0, share.value), max(1.0, share.value))


def of_groups(figures: np.ndarray, value: float, confidence: float) -> Estimate:
    """Estimate a statistic, with error and interval, from a few independent values (scrambles) of any distribution.

    A few values show less than half of the skewness of their distribution; the interval compensates for it.
    """
    n = figures.size
    if n < 2 or not np.isfinite(figures).all():
        return Estimate.about(value, math.nan, 0.0)
    centred = figures - figures.mean()
    spread = float(figures.std(ddof=1))
    power = float((centred**2).mean()) ** 1.5
    skewness = _UNSEEN_SKEWNESS * float((centred**3).mean()) / power if power > 0 else 0.0
    return skewed(value, spread / math.sqrt(n), skewness, n, student(confidence, n))


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
    """Return a share with the score interval of as many independent units as would have its standard error."""
    n, share = int(totals.sum()), float(hits.sum() / totals.sum())
    error, scrambles = share_error(hits, totals)
    effective = share * (1 - share) / error**2 if error > 0 else n
    lower, upper = score_interval(share, effective, student(confidence, scrambles))
    return Estimate(share, error, lower, upper)
