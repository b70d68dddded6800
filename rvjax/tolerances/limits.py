"""Base of all kinds of requirements: limits, a margin on a sample, a verdict.

A new kind of requirement is one class that derives from `Limits`: it defines its margin on a sample, the
derivative to the responses of the units (allocation), its value with interval (Monte Carlo, certificate) and its
text. Study files find it by the names of its fields.
"""

import dataclasses
import math
from typing import ClassVar, TypeVar

import jax
import numpy as np
from scipy import special

from rvjax.population import Estimate, Sampled, wilson
from rvjax.records import PyTree

Value = TypeVar("Value", float, np.ndarray, jax.Array)

KINDS: list[type["Limits"]] = []
"""Every kind of requirement."""

MOST_FAILED = 0.0027
"""Share of failed units that a statistic of the valid units may exclude: the share beyond 3 sd of a capable process."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Result of the check of a requirement, with confidence.

    Attributes:
        wanted: the requirement as text.
        kind: of the value: "share" of units, "response" (in its unit) or "number".
        estimate: the limited value.
        met: True if the whole confidence interval meets it, or the end of it that counts; and, for a statistic of
            the valid units only (a mean, Cpk), the upper end of the share of failed units lies below 0.27 %.
    """

    wanted: str
    kind: str
    estimate: Estimate
    met: bool


@dataclasses.dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a response, with the methods of every kind of requirement.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
    """

    of_units: ClassVar[bool] = True  # a unit beyond the limits is a reject
    limits_values: ClassVar[bool] = True  # its limits are values of the response: a histogram shows them
    of_shares: ClassVar[bool] = False  # it limits the share of units beyond the limits
    of_extremes: ClassVar[bool] = False  # it limits the worst case; units have no effect
    of_sample: ClassVar[bool] = True  # errors have an effect; False: it limits an output without errors
    exact: ClassVar[bool] = False  # its value has no sampling error
    most_failed: ClassVar[float] = MOST_FAILED  # share of failed units that its value excludes
    goal: ClassVar[str | None] = None  # the field of the target
    judges: ClassVar[str] = "number"  # "share" of units, "response" in its unit, or a plain number
    prefix: ClassVar[str] = ""  # of the limits in study files

    lower: float = -math.inf
    upper: float = math.inf

    def __init_subclass__(cls) -> None:
        KINDS.append(cls)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        for f in dataclasses.fields(self):
            try:
                object.__setattr__(self, f.name, float(getattr(self, f.name)))
            except (TypeError, ValueError):
                raise ValueError(f"{owner}.{f.name} = {getattr(self, f.name)!r}: must be a number") from None
        if not self.lower <= self.upper:
            limits = f"lower = {self.lower:.6g}: lies above upper = {self.upper:.6g}"
            raise ValueError(f"{owner}.{limits} (both in the unit of the response)")
        if math.isinf(self.lower) and math.isinf(self.upper):
            raise ValueError(f"{owner}: needs a lower or an upper limit")

    def margin(self, value: Value) -> Value:
        """Distance of a value outside the nearer limit, negative inside; floats and arrays of any library."""
        if math.isinf(self.lower):
            return value - self.upper
        if math.isinf(self.upper):
            return self.lower - value
        middle, half = (self.lower + self.upper) / 2, (self.upper - self.lower) / 2
        return abs(value - middle) - half

    def margins(self, values: np.ndarray) -> np.ndarray:
        """Margin of every unit, inf where one failed."""
        return np.where(np.isnan(values), np.inf, self.margin(values))

    def outward(self, value: np.ndarray | float) -> PyTree:
        """Derivative of the margin to the value, +1 or -1; NumPy arrays."""
        if math.isinf(self.lower) or math.isinf(self.upper):
            return np.full(np.shape(value), 1.0 if math.isinf(self.lower) else -1.0)
        return np.where(value < (self.lower + self.upper) / 2, -1.0, 1.0)

    def capability(self, mean: float, sd: float) -> tuple[float, float]:
        """Cp and Cpk of a response whose units have these limits; without two limits Cp is nan.

        Args:
            mean: of the response.
            sd: its standard deviation.
        """
        room = -self.margin(mean)
        if sd == 0:
            cp, cpk = math.inf, math.inf if room >= 0 else -math.inf
        else:
            cp, cpk = (self.upper - self.lower) / (6 * sd), room / (3 * sd)
        return (cp if math.isfinite(self.lower) and math.isfinite(self.upper) else math.nan), cpk

    def normal_yield(self, mean: float, sd: float) -> float:
        """Share within the limits of a normal response.

        Args:
            mean: of the response.
            sd: its standard deviation.
        """
        if math.isnan(mean) or math.isnan(sd):
            return math.nan
        if sd == 0:
            return float(self.margin(mean) <= 0)
        return float(special.ndtr((self.upper - mean) / sd) - special.ndtr((self.lower - mean) / sd))

    def limited(self, value: float) -> "Limits":
        """Requirement with another limit, or with two limits this far from their mid-point."""
        if math.isinf(self.lower):
            return dataclasses.replace(self, upper=value)
        if math.isinf(self.upper):
            return dataclasses.replace(self, lower=value)
        middle = (self.lower + self.upper) / 2
        return dataclasses.replace(self, lower=middle - value, upper=middle + value)

    def widened(self, by: float) -> "Limits":
        """Requirement with all limits moved outwards."""
        return dataclasses.replace(self, lower=self.lower - by, upper=self.upper + by)

    def aimed(self, value: float) -> "Limits":
        """Requirement with another goal."""
        if self.goal is None:
            raise ValueError(f"against = 'target': {type(self).__name__} has limits only")
        return dataclasses.replace(self, **{self.goal: value})

    @classmethod
    def file_keys(cls) -> dict[str, str]:
        """Keys in a study file and their fields; the kind of a table is the first that has all its keys."""
        limits = dict(zip(cls.limit_keys(), ("lower", "upper")))
        return limits | {f.name: f.name for f in dataclasses.fields(cls) if f.name not in limits.values()}

    @classmethod
    def limit_keys(cls) -> tuple[str, str]:
        """Keys of the limits, in the unit of the response; all others are plain numbers."""
        return cls.prefix + "lower", cls.prefix + "upper"

    # Methods that each kind must define.

    def learned(self, values: np.ndarray) -> float:
        """Margin of the whole requirement on a sample, unit of the response: <= 0 is met.

        Args:
            values: (n,) of the units, nan where one failed.
        """
        raise NotImplementedError

    def pull(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the margin to the units: numbers (m,) of those with a slope, and their slopes (m,).

        Args:
            values: as for `learned`.
        """
        raise NotImplementedError

    def error(self, values: np.ndarray) -> float:
        """Standard error of the margin of a statistic, times the root of the number of units; 0 for other limits.

        Args:
            values: as for `learned`.
        """
        return 0.0

    def figure(self, sampled: Sampled) -> Estimate:
        """Limited value with its confidence interval."""
        raise NotImplementedError

    def holds(self, estimate: Estimate) -> bool:
        """True if the interval of the value meets the requirement."""
        raise NotImplementedError

    def shown(self, estimate: Estimate, sd: float, deviate: float) -> float:
        """Margin of a statistic as a certificate shows it.

        Args:
            estimate: of the current value.
            sd: standard deviation of the response.
            deviate: standard errors of the value that must lie within the limit.
        """
        raise NotImplementedError

    def verdict(self, sampled: Sampled) -> Verdict:
        """Limited value, and True if it meets the limits with few enough failed units."""
        figure = self.figure(sampled)
        met = self.holds(figure) and sampled.failed().upper < self.most_failed
        return Verdict(self.text(), self.judges, figure, met)

    def hopeless(self, samples: int, confidence: float) -> bool:
        """True if not even the best sample could certify it.

        Args:
            samples: its size.
            confidence: of the certificate.
        """
        return wilson(0, samples, confidence).upper >= self.most_failed

    def beyond(self, samples: int, confidence: float) -> bool:
        """True if no sample could show it, but a probability of failure could; see `rarely`.

        Args:
            samples: its size.
            confidence: of the certificate.
        """
        return False

    def rarely(self, failing: Estimate, trusted: bool) -> Verdict:
        """The verdict on a probability of failure.

        Args:
            failing: share of units beyond the limits or without a value.
            trusted: whether its status is good.
        """
        raise NotImplementedError

    def shortfall(self, values: np.ndarray, joint_target: float) -> float:
        """Distance by which the limits must move outwards, 0 if met.

        Args:
            values: as for `learned`.
            joint_target: share of units that must meet all requirements, 0 for none.
        """
        return max(0.0, self.learned(values))

    def text(self) -> str:
        """Text of the requirement, without the limits' numbers."""
        raise NotImplementedError
