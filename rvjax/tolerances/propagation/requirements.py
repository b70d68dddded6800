"""What a response must keep to, and the share of units that must keep it."""

import dataclasses
import math
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True, kw_only=True)
class Requirement:
    """Limits of a response and the share of units that must lie within them.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
        target: share of units, between 0 and 1.
    """

    lower: float = -math.inf
    upper: float = math.inf
    target: float = 0.9973

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "target"):
            try:
                object.__setattr__(self, name, float(getattr(self, name)))
            except (TypeError, ValueError):
                raise ValueError(f"Requirement.{name} = {getattr(self, name)!r}: must be a number") from None
        if not self.lower <= self.upper:
            raise ValueError(f"Requirement.lower = {self.lower:.6g}: lies above upper = {self.upper:.6g}")
        if math.isinf(self.lower) and math.isinf(self.upper):
            raise ValueError("Requirement: needs a lower or an upper limit")
        if not 0 < self.target < 1:
            raise ValueError(f"Requirement.target = {self.target:.6g}: must lie between 0 and 1")

    def margin(self, value: Any) -> Any:
        """How far a value lies outside the nearer limit, negative inside; floats and arrays of any library."""
        above, below = value - self.upper, self.lower - value
        if math.isinf(self.lower):
            return above
        if math.isinf(self.upper):
            return below
        middle, half = (self.lower + self.upper) / 2, (self.upper - self.lower) / 2
        return abs(value - middle) - half

    def outward(self, value: Any) -> Any:
        """Derivative of the margin to the value, +1 or -1; NumPy arrays."""
        if math.isinf(self.lower) or math.isinf(self.upper):
            return np.full(np.shape(value), 1.0 if math.isinf(self.lower) else -1.0)
        return np.where(value < (self.lower + self.upper) / 2, -1.0, 1.0)

    def capability(self, mean: float, sd: float) -> tuple[float, float]:
        """Cp and Cpk; a one-sided requirement has no Cp (nan).

        Args:
            mean: of the response, its unit.
            sd: standard deviation, its unit.
        """
        room = -self.margin(mean)
        if sd == 0:
            cp, cpk = math.inf, math.inf if room >= 0 else -math.inf
        else:
            cp, cpk = (self.upper - self.lower) / (6 * sd), room / (3 * sd)
        return (cp if math.isfinite(self.lower) and math.isfinite(self.upper) else math.nan), cpk
