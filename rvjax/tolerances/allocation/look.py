"""Constraints of an allocation, and what is seen of all of them at one vector of decisions."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from rvjax.tolerances.limits import Limits

DECIDES = 0.85
"""Used way below which a limit does not decide."""

JOINT, FAILED = "joint", "failed"
"""Names of the constraints on units that meet all limits, and on failed units, which statistics of others exclude."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One constraint: a requirement, one side of it, or a share of units of several requirements.

    Attributes:
        name: of the response, `JOINT` or `FAILED`.
        item: the limits; None for these two.
        share: True for a share of units.
    """

    name: str
    item: Limits | None
    share: bool = False

    @property
    def exact(self) -> bool:
        """True if no sampling error changes it."""
        return self.item is not None and self.item.exact

    @property
    def nominal(self) -> bool:
        """True if it limits an output without errors."""
        return self.item is not None and not self.item.of_sample

    @property
    def power(self) -> float:
        """Power of the used way that is linear in powers of half-widths."""
        return 1.0 if self.exact or (self.item is None and not self.share) else 2.0


def rows_of(requirements: Mapping[str, Limits], *, joint: bool) -> list[Row]:
    """Constraints of requirements: on shares of units, on other values, on failed units, on units that meet all limits.

    Args:
        requirements: by name of the response.
        joint: with the last one.
    """
    rows = [Row(name, item, True) for name, item in requirements.items() if item.of_shares]
    rows += [Row(name, side) for name, item in requirements.items() if not item.of_shares for side in _sides(item)]
    rows += [Row(FAILED, None)] if any(item.most_failed < 1 for item in requirements.values()) else []
    return [*rows, Row(JOINT, None, True)] if joint else rows


def _sides(item: Limits) -> list[Limits]:
    """The limits one by one, where the margin of both has a corner."""
    if math.isinf(item.lower) or math.isinf(item.upper):
        return [item]
    return [dataclasses.replace(item, lower=-math.inf), dataclasses.replace(item, upper=math.inf)]


@dataclasses.dataclass(frozen=True)
class Look:
    """Cost and used ways at one vector of decisions.

    Attributes:
        x: (n,) the vector.
        cost: of half-widths, moved mid-points and numbers.
        slopes: (n,) its derivatives.
        priced: priced outputs without errors.
        priced_slopes: (n,) their derivatives.
        loss: mean loss.
        loss_slopes: (n,) its derivatives.
        used: (c,) used ways, inf where too many units fail.
        jacobian: (c, n) their derivatives.
        errors: (c, n) standard errors of these, of a mean over few units.
        powers: (c,) of the used ways.
    """

    x: np.ndarray
    cost: float
    slopes: np.ndarray
    priced: float
    priced_slopes: np.ndarray
    loss: float
    loss_slopes: np.ndarray
    used: np.ndarray
    jacobian: np.ndarray
    errors: np.ndarray
    powers: np.ndarray

    @property
    def total(self) -> float:
        """Cost, priced outputs and mean loss, which a search minimises."""
        return self.cost + self.priced + self.loss

    @property
    def pull(self) -> np.ndarray:
        """Derivatives (n,) of `total`."""
        return self.slopes + self.priced_slopes + self.loss_slopes

    @property
    def excess(self) -> float:
        """Largest excess over a limit, in parts of its way; negative where all are met."""
        return float((self.used - 1).max(initial=-np.inf))
