"""The yield of a dear response from units near its limits: the cheap responses say which.

What a unit far from the limits does, its cheap values tell nearly for certain; so dear units are spent where there is
doubt. Of many units with cheap values, each enters with a probability in proportion to the spread of its indicator
(Neyman 1934), and the difference between indicator and predicted probability is averaged with the inverse of that
probability (Cassel, Sarndal and Wretman 1976): unbiased whatever the prediction is worth.
"""

import dataclasses
import math

import numpy as np
from scipy import special

from rvjax.population import Estimate, score_interval
from rvjax.tolerances.fidelity.control_variates import Basis
from rvjax.tolerances.requirements.limits import Limits

_NEAREST = 0.2  # share of the fitted units whose residuals stand for those at a limit
_FEWEST = 30  # of them, at least
_GRID = 2001  # places at which the law of the residuals is tabulated
_EVEN = 0.2  # share of the draws that is spread evenly over all units
_LEAST = 1e-12  # of a predicted probability, and its complement


@dataclasses.dataclass(frozen=True)
class Prediction:
    """What cheap values say of a dear one: a mean by regression and residuals about it.

    Attributes:
        basis: of the regression.
        slopes: (1 + p,) of its columns.
        middles: (m,) predicted means of the fitted units.
        residuals: (m,) of these units, each by the fit to the others.
        valid: share of units with a dear value, 1 if all have one.
    """

    basis: Basis
    slopes: np.ndarray
    middles: np.ndarray
    residuals: np.ndarray
    valid: float

    @classmethod
    def fitted(cls, basis: Basis, cheap: np.ndarray, dear: np.ndarray) -> "Prediction":
        """From cheap values (n, j) and dear ones (n,), nan where a unit failed."""
        good = ~np.isnan(dear)
        x = np.concatenate([np.ones((int(good.sum()), 1)), basis.columns(cheap[good])], axis=1)
        slopes = np.linalg.lstsq(x, dear[good], rcond=None)[0]
        left, sizes, _ = np.linalg.svd(x, full_matrices=False)
        left = left[:, sizes > 1e-10 * sizes[0]]
        leverage = np.minimum((left**2).sum(axis=1), 0.99)
        residuals = (dear[good] - x @ slopes) / (1 - leverage)
        valid = 1.0 if good.all() else (good.sum() + 0.5) / (good.size + 1)
        return cls(basis, slopes, x @ slopes, residuals, valid)

    def passes(self, cheap: np.ndarray, limits: Limits) -> np.ndarray:
        """Predicted probability (N,) that units with these cheap values keep the limits."""
        mean = self.slopes[0] + self.basis.columns(cheap) @ self.slopes[1:]
        kept = self._below(mean, limits.upper) - self._below(mean, limits.lower)
        return np.clip(self.valid * kept, _LEAST, 1 - _LEAST)

    def _below(self, mean: np.ndarray, limit: float) -> np.ndarray:
        """Probability (N,) that a value lies below a limit, by residuals.

        Half by those of the units nearest to the limit, as they are there; half by all, which also know of what happens
        where the prediction sees no danger.
        """
        if math.isinf(limit):
            return np.full(mean.shape, float(limit > 0))
        count = min(len(self.residuals), max(_FEWEST, int(_NEAREST * len(self.residuals))))
        near = self.residuals[np.argsort(np.abs(self.middles - limit), kind="stable")[:count]]
        room = limit - mean
        laws = (_law(near, room) + _law(self.residuals, room)) / 2
        # One more residual that nobody has seen, of a heavy tail: what is never in doubt would never be drawn.
        spread, seen = float(self.residuals.std()), len(self.residuals)
        return (seen * laws + special.stdtr(2, room / spread)) / (seen + 1) if spread > 0 else laws


def _law(residuals: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Smoothed share of residuals below `room` (N,)."""
    spread = float(residuals.std())
    if not spread > 0:
        return (residuals.mean() <= room).astype(float)
    width = spread * len(residuals) ** -0.2
    grid = np.linspace(residuals.min() - 5 * width, residuals.max() + 5 * width, _GRID)
    steps = np.searchsorted(np.sort(residuals), grid, side="right") / len(residuals)
    smooth = np.exp(-0.5 * (np.arange(-4, 4 + 1e-9, (grid[1] - grid[0]) / width)) ** 2)
    law = np.convolve(np.pad(steps, len(smooth) // 2, mode="edge"), smooth / smooth.sum(), mode="valid")
    return np.interp(room, grid, law[: len(grid)])


def inclusion(passes: list[np.ndarray], count: int) -> np.ndarray:
    """Probabilities (N,) by which units enter, `count` in all, from the predictions (N,) of each requirement."""
    doubts = [p * (1 - p) / np.sqrt(p * (1 - p)).mean() ** 2 for p in passes]
    score = np.sqrt(np.sum(doubts, axis=0))
    wanted = (1 - _EVEN) * score / score.sum() + _EVEN / len(score)
    whole = np.zeros(len(score), bool)  # those that enter for certain
    while True:
        factor = (count - whole.sum()) / wanted[~whole].sum()
        over = ~whole & (factor * wanted >= 1)
        if not over.any():
            return np.where(whole, 1.0, factor * wanted)
        whole |= over


def chosen(probabilities: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """`count` units, each with its probability, none twice: equal steps along all in random order (Madow 1949)."""
    order = random.permutation(len(probabilities))
    ends = np.cumsum(probabilities[order])
    places = (random.random() + np.arange(count)) * (ends[-1] / count)
    return order[np.minimum(np.searchsorted(ends, places, side="right"), len(order) - 1)]


@dataclasses.dataclass(frozen=True)
class Targeted:
    """A yield and the two parts of its variance.

    Attributes:
        value: of the yield, between 0 and 1.
        doubt: variance from the dear units that were not drawn.
        units: variance from the units with cheap values, as if all had a dear one.
        freedom: degrees of freedom.
    """

    value: float
    doubt: float
    units: float
    freedom: int

    def estimate(self, confidence: float) -> Estimate:
        """The score interval of as many independent units as have this variance."""
        variance = self.doubt + self.units
        deviate = float(special.stdtrit(self.freedom, (1 + confidence) / 2))
        inside = min(max(self.value, _LEAST), 1 - _LEAST)
        lower, upper = score_interval(self.value, inside * (1 - inside) / variance, deviate)
        return Estimate(self.value, math.sqrt(variance), lower, upper)


def expected_doubt(passes: np.ndarray, probabilities: np.ndarray) -> float:
    """Variance from the units that are not drawn, were the predictions (N,) right."""
    return float(((1 - probabilities) / probabilities * passes * (1 - passes)).sum()) / len(passes) ** 2


def targeted(passes: np.ndarray, probabilities: np.ndarray, drawn: np.ndarray, kept: np.ndarray) -> Targeted:
    """The yield.

    Args:
        passes: (N,) predictions of all units.
        probabilities: (N,) by which they entered.
        drawn: (m,) units that entered.
        kept: (m,) which of them kept the limits.
    """
    n, pi = len(passes), probabilities[drawn]
    off = (kept - passes[drawn]) / pi
    value = float(passes.mean() + off.sum() / n)
    free = 1 - pi  # Hajek 1964: as drawn one by one, given how many
    middle = float((free * off).sum() / free.sum()) if free.sum() > 0 else 0.0
    seen = float((free * (off - middle) ** 2).sum()) / n**2 * len(drawn) / max(1, len(drawn) - 1)
    value = min(max(value, 0.0), 1.0)
    inside = min(max(value, 0.5 / n), 1 - 0.5 / n)
    return Targeted(value, max(seen, expected_doubt(passes, probabilities)), inside * (1 - inside) / n, len(drawn) - 1)
