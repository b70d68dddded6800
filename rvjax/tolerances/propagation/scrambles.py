"""Standard errors from independent scrambles of Sobol points.

The units of one scramble depend on each other, which is the point of them; the scrambles do not, so
the spread between the figures of the scrambles tells the error of their mean (Owen 1997).
"""

import math

import numpy as np
from scipy import special

from rvjax.tolerances.propagation.estimates import Estimate, deviate_of, score_interval

FEW = 160
"""With fewer hits or misses than this a share counts as no better than one of independent units: ten per
scramble are too few to show by their spread that it is."""


def student(confidence: float, scrambles: int) -> float:
    """Deviate of a two-sided confidence where the error comes from the spread between scrambles."""
    deviate_of(confidence)
    return float(special.stdtrit(scrambles - 1, (1 + confidence) / 2)) if scrambles > 1 else math.inf


def mean_of(figures: list[float], value: float, confidence: float) -> Estimate:
    """The figure of all units with its error from those of the scrambles; those without units are nan."""
    known = np.array([figure for figure in figures if not math.isnan(figure)])
    if known.size < 2:
        return Estimate(value, math.nan, math.nan, math.nan)
    error = float(known.std(ddof=1)) / math.sqrt(known.size)
    half = student(confidence, known.size) * error
    return Estimate(value, error, value - half, value + half)


def share_error(hits: np.ndarray, totals: np.ndarray) -> tuple[float, int]:
    """Standard error of a share, and the number of scrambles behind it.

    Args:
        hits: of each scramble.
        totals: units of each scramble.
    """
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
