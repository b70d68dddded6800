"""Control variates by regression: the mean of a dear figure from few units, that of its cheap prediction from many.

With a prediction h, E f = E(f - h) + E h: the first mean needs units on which f is known and scatters as little as
f - h does, the second needs none. h is a regression on the cheap values, fitted without the units that it is subtracted
from (in ten parts, each predicted by the other nine), so that no estimate is biased by its fit (Avramidis and Wilson
1993, Oper. Res. 41, 540).
"""

import dataclasses
import math
from typing import Self

import numpy as np
from scipy import special

from rvjax.population import Estimate, skewed

PER_COLUMN = 10
"""Units per coefficient of the regression, at least."""

_FOLDS = 10


@dataclasses.dataclass(frozen=True)
class Basis:
    """Columns of a regression: cheap values, their squares and products as far as the units suffice.

    Attributes:
        middle: (j,) of each cheap value.
        scale: (j,) its spread.
        gaps: whether some unit lacks a cheap value: then a column for each says so.
        order: "linear", "squares" or "products".
    """

    middle: np.ndarray
    scale: np.ndarray
    gaps: bool
    order: str

    @classmethod
    def of(cls, own: np.ndarray, fresh: np.ndarray) -> Self | None:
        """The richest basis that the units allow; None where they allow none.

        Args:
            own: (n, j) cheap values of the units with a dear one, nan where one failed.
            fresh: (N, j) those of the others.
        """
        gaps, valid = bool(np.isnan(own).any() or np.isnan(fresh).any()), np.isfinite(fresh)
        count = np.maximum(valid.sum(axis=0), 1)
        first = np.where(valid, fresh, 0.0).sum(axis=0) / count
        spread = np.sqrt(np.where(valid, (fresh - first) ** 2, 0.0).sum(axis=0) / count)
        for order in ("products", "squares", "linear"):
            basis = cls(first, np.where(spread > 0, spread, 1.0), gaps, order)
            if len(own) >= PER_COLUMN * (1 + basis.columns(own[:1]).shape[1]):
                return basis
        return None

    def columns(self, values: np.ndarray) -> np.ndarray:
        """Columns (n, p) of cheap values (n, j); a missing one stands at its middle."""
        missing = np.isnan(values)
        x = np.where(missing, 0.0, (values - self.middle) / self.scale)
        parts = [x]
        if self.order == "squares":
            parts.append(x**2)
        if self.order == "products":
            rows, others = np.triu_indices(x.shape[1])
            parts.append(x[:, rows] * x[:, others])
        return np.concatenate([*parts, missing.astype(float)] if self.gaps else parts, axis=1)


@dataclasses.dataclass(frozen=True)
class Regressed:
    """A mean by regression.

    Attributes:
        value: of the mean.
        variance: of `value`.
        skewness: of `value`, times sqrt(n): that of n independent terms with this mean.
        n: units with a dear value.
        freedom: degrees of freedom of the variance.
        residual: variance of what the regression leaves.
        explained: variance of what it predicts.
        plain: variance of the figure itself.
    """

    value: float
    variance: float
    skewness: float
    n: int
    freedom: int
    residual: float
    explained: float
    plain: float

    @property
    def gain(self) -> float:
        """Variance of the plain mean of the same units over that of this one."""
        return (self.plain / self.n) / self.variance if self.variance > 0 else 1.0

    @property
    def correlation(self) -> float:
        """Multiple correlation of figure and prediction, seen on units that were not fitted."""
        return math.sqrt(max(0.0, 1 - self.residual / self.plain)) if self.plain > 0 else 0.0

    def estimate(self, confidence: float, value: float | None = None) -> Estimate:
        """The mean with its interval, about another value where one is given."""
        deviate = float(special.stdtrit(self.freedom, (1 + confidence) / 2))
        centre = self.value if value is None else value
        return skewed(centre, math.sqrt(self.variance), self.skewness, self.n, deviate)


def regressed(figure: np.ndarray, own: np.ndarray, fresh: np.ndarray, squared: np.ndarray | None = None) -> Regressed:
    """The mean of a figure.

    Args:
        figure: (n,) of the units with a dear value.
        own: (n, p) columns of these units.
        fresh: (N, p) columns of others.
        squared: (n,) another figure; the square of its prediction is one more column.
    """
    n, others = len(figure), len(fresh)
    # Both means are sampled: so much of the prediction is used that their errors together are least.
    share = others / (n + others)
    part = np.arange(n) % _FOLDS
    left, whole, predicted = np.empty(n), np.empty(n), np.zeros(others)
    for k in range(_FOLDS):
        mine = part == k
        x, more = own, fresh
        if squared is not None:
            line = _fit(own[~mine], squared[~mine])
            x = np.column_stack([own, (line[0] + own @ line[1:]) ** 2])
            more = np.column_stack([fresh, (line[0] + fresh @ line[1:]) ** 2])
        beta = _fit(x[~mine], figure[~mine])
        far = more @ beta[1:]
        off = x[mine] @ beta[1:] - far.mean()
        left[mine], whole[mine] = figure[mine] - share * off, figure[mine] - off
        predicted += share * mine.mean() * (far - far.mean())
    residual, explained = float(left.var(ddof=1)), float((predicted**2).mean())
    variance = residual / n + explained / others
    third = float(((left - left.mean()) ** 3).mean()) / n**2 + float((predicted**3).mean()) / others**2
    return Regressed(
        value=float(left.mean()),
        variance=variance,
        skewness=math.sqrt(n) * third / variance**1.5 if variance > 0 else 0.0,
        n=n,
        freedom=n - 1 - own.shape[1] - (squared is not None),
        residual=float(whole.var(ddof=1)),
        explained=explained / share**2,
        plain=float(figure.var(ddof=1)),
    )


def _fit(columns: np.ndarray, figure: np.ndarray) -> np.ndarray:
    """Constant and slopes (1 + p,)."""
    return np.linalg.lstsq(np.column_stack([np.ones(len(columns)), columns]), figure, rcond=None)[0]
