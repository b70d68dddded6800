"""Requirements on a response: share of units within limits, their mean, spread or capability, or the worst case."""

import dataclasses
import math
from typing import ClassVar

import numpy as np

from rvjax.population import Estimate, Sampled, score_interval, wilson
from rvjax.tolerances.limits import MOST_FAILED, Limits, Verdict

_FEW_FAILED = f"< {100 * MOST_FAILED:g} % failed"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Requirement(Limits):
    """Limits of a response and the share of units that must lie within them.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
        target: share of units, between 0 and 1.
    """

    of_shares: ClassVar[bool] = True
    goal: ClassVar[str | None] = "target"
    judges: ClassVar[str] = "share"
    most_failed: ClassVar[float] = math.inf  # they are rejects
    target: float = 0.9973

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.target < 1:
            raise ValueError(f"Requirement.target = {self.target:.6g}: must lie between 0 and 1")

    def figure(self, sampled: Sampled) -> Estimate:
        """The yield; failed units are rejects."""
        return sampled.share()

    def holds(self, estimate: Estimate) -> bool:
        """The lower end of the yield reaches the target."""
        return estimate.lower >= self.target

    def beyond(self, samples: int, confidence: float) -> bool:
        """A sample without rejects could not certify the target."""
        return wilson(samples, samples, confidence).lower < self.target

    def certified_margin(self, values: np.ndarray, deviate: float) -> float:
        """Margin of the unit at which these units would just prove the target; inf where no share would.

        Args:
            values: (n,) of independent units, nan where one failed.
            deviate: standard errors by which the share must exceed the target.
        """
        n = len(values)
        counts = range(math.ceil(self.target * n), n + 1)
        enough = next((k for k in counts if score_interval(k / n, n, deviate)[0] >= self.target), 0)
        return float(np.sort(self.margins(values))[enough - 1]) if enough else math.inf

    def rarely(self, failing: Estimate, trusted: bool) -> Verdict:
        """The whole interval keeps the target, and its value is reliable."""
        share = Estimate(1 - failing.value, failing.error, 1 - failing.upper, 1 - failing.lower)
        how = "importance sampling" if trusted else "importance sampling, not to be trusted"
        return Verdict(f"{self.text()}, {how}", self.judges, share, trusted and self.holds(share))

    def shortfall(self, values: np.ndarray, joint_target: float) -> float:
        """The sampled quantile itself, at the stricter of both targets."""
        ordered = np.sort(self.margins(values))
        return max(0.0, float(ordered[math.ceil(max(self.target, joint_target) * len(ordered)) - 1]))

    def text(self) -> str:
        """The target."""
        return f"{100 * self.target:.12g} %"


@dataclasses.dataclass(frozen=True, kw_only=True)
class MeanWithin(Limits):
    """Limits of the mean of a response over all valid units: how far a batch may be off as a whole.

    Met only if also, for certain, less than 0.27 % of the units fail.

    Attributes:
        lower: lower limit of the mean, unit of the response; -inf for none.
        upper: upper limit of the mean; inf for none.
    """

    of_units: ClassVar[bool] = False
    judges: ClassVar[str] = "response"
    prefix: ClassVar[str] = "mean_"

    def learned(self, values: np.ndarray) -> float:
        """Margin of the mean."""
        valid = values[_valid(values)]
        return float(self.margin(valid.mean())) if valid.size else math.inf

    def pull(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All units have equal weight in the mean."""
        units = _valid(values)
        sign = float(self.outward(values[units].mean())) if units.size else 0.0
        return units, np.full(units.size, sign) / units.size

    def error(self, values: np.ndarray) -> float:
        """Spread of the units."""
        return float(values[_valid(values)].std()) if _valid(values).size else 0.0

    def figure(self, sampled: Sampled) -> Estimate:
        """The mean of the valid units."""
        return sampled.mean()

    def holds(self, estimate: Estimate) -> bool:
        """The whole interval lies within the limits."""
        return self.lower <= estimate.lower and estimate.upper <= self.upper

    def shown(self, estimate: Estimate, sd: float, deviate: float) -> float:
        """Margin of the worse end of the interval."""
        return float(self.margin(estimate.value)) + deviate * estimate.error

    def text(self) -> str:
        """Name of the limited statistic."""
        return f"mean, {_FEW_FAILED}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class SdAtMost(Limits):
    """A bound on the standard deviation of a response over all valid units.

    Met only if also, for certain, less than 0.27 % of the units fail.

    Attributes:
        lower: a standard deviation has no lower limit: -inf.
        upper: largest standard deviation, unit of the response, positive.
    """

    of_units: ClassVar[bool] = False
    limits_values: ClassVar[bool] = False
    judges: ClassVar[str] = "response"
    prefix: ClassVar[str] = "sd_"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lower != -math.inf:
            raise ValueError(f"SdAtMost.lower = {self.lower:.6g}: a standard deviation has an upper limit only")
        if not self.upper > 0:
            raise ValueError(f"SdAtMost.upper = {self.upper:.6g}: must be positive")

    def learned(self, values: np.ndarray) -> float:
        """The standard deviation beyond its limit."""
        valid = values[_valid(values)]
        return float(valid.std(ddof=1)) - self.upper if valid.size > 1 else math.inf

    def pull(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """d sd = sum (y - mean) dy/((n - 1) sd)."""
        units = _valid(values)
        return units, _spread_pull(values[units]) / units.size

    def error(self, values: np.ndarray) -> float:
        """Spread of what each unit adds to the standard deviation."""
        return float(_spread_part(values[_valid(values)]).std()) if _valid(values).size > 1 else 0.0

    def figure(self, sampled: Sampled) -> Estimate:
        """The standard deviation of the valid units."""
        return sampled.sd()

    def holds(self, estimate: Estimate) -> bool:
        """The upper end of the interval keeps the limit."""
        return estimate.upper <= self.upper

    def shown(self, estimate: Estimate, sd: float, deviate: float) -> float:
        """Margin of the upper end of the interval."""
        return estimate.value + deviate * estimate.error - self.upper

    def text(self) -> str:
        """Name of the limited statistic."""
        return f"standard deviation, {_FEW_FAILED}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class WorstCaseWithin(Limits):
    """Limits of a response for all errors within their limits: arithmetic tolerancing.

    The value is the end of the range of `worst_case` that is nearest to its limit, or furthest beyond it.
    Distributions have no effect. For a linear response the half-widths times the sizes of its slopes add up.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
    """

    of_units: ClassVar[bool] = False
    of_extremes: ClassVar[bool] = True
    exact: ClassVar[bool] = True
    most_failed: ClassVar[float] = math.inf  # sampled units may lie beyond the limits of the errors
    judges: ClassVar[str] = "response"
    prefix: ClassVar[str] = "worst_"

    def learned(self, values: np.ndarray) -> float:
        """Margin of the worse of both ends of the range; inf where the response fails within the limits."""
        return float(self.margins(values).max())

    def pull(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value of the worse end."""
        worse = np.argmax(self.margin(values), keepdims=True)
        return worse, self.outward(values[worse])

    def figure(self, sampled: Sampled) -> Estimate:
        """The worse end of the range; exact as far as `worst_case` is."""
        ends = np.array(sampled.extremes)
        worse = float(ends[np.argmax(self.margins(ends))])
        return Estimate(worse, 0.0, worse, worse)

    def holds(self, estimate: Estimate) -> bool:
        """True if the value keeps the limits, except for rounding."""
        margin = self.margin(estimate.value)
        rounding = 1e-12 * max(abs(self.margin(0.0)), abs(estimate.value)) if math.isfinite(estimate.value) else 0.0
        return bool(margin <= rounding)

    def text(self) -> str:
        """Name of the limited statistic."""
        return "worst case"


@dataclasses.dataclass(frozen=True, kw_only=True)
class CpkAtLeast(Limits):
    """Limits of a response and the capability of the batch: Cpk = min(U - mean, mean - L)/(3 sd) >= cpk.

    Moments are those of the valid units; a unit beyond a limit, or failed, is a reject in the yield as ever.
    Met only if also, for certain, less than 0.27 % of the units fail.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
        cpk: least capability, positive.
    """

    goal: ClassVar[str | None] = "cpk"
    cpk: float = 1.33

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.cpk < math.inf:
            raise ValueError(f"CpkAtLeast.cpk = {self.cpk:.6g}: must be positive and finite")

    def learned(self, values: np.ndarray) -> float:
        """3 cpk sd - min(U - mean, mean - L): the same statement in the response's unit."""
        valid = values[_valid(values)]
        if valid.size < 2:
            return math.inf
        return float(self.margin(valid.mean()) + 3 * self.cpk * valid.std(ddof=1))

    def pull(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """d mean = sum dy/n, d sd = sum (y - mean) dy/((n - 1) sd)."""
        units = _valid(values)
        if units.size < 2:
            return units, np.zeros(units.size)
        valid = values[units]
        return units, (self.outward(valid.mean()) + 3 * self.cpk * _spread_pull(valid)) / units.size

    def error(self, values: np.ndarray) -> float:
        """Spread of what each unit adds to the margin."""
        valid = values[_valid(values)]
        if valid.size < 2:
            return 0.0
        return float((self.outward(valid.mean()) * valid + 3 * self.cpk * _spread_part(valid)).std())

    def figure(self, sampled: Sampled) -> Estimate:
        """Cpk; its error by the delta method from the covariance of mean and sd, for any distribution."""
        return sampled.cpk(self)

    def holds(self, estimate: Estimate) -> bool:
        """The lower end of the interval of Cpk reaches it."""
        return estimate.lower >= self.cpk

    def shown(self, estimate: Estimate, sd: float, deviate: float) -> float:
        """3 sd (cpk - Cpk) at the lower end of the interval."""
        return 3 * sd * (self.cpk + deviate * estimate.error - estimate.value)

    def text(self) -> str:
        """The least Cpk."""
        return f"Cpk >= {self.cpk:.4g}, {_FEW_FAILED}"


def _valid(values: np.ndarray) -> np.ndarray:
    """Numbers of the valid units; none where too many failed, or are infinite, for a statistic of the others."""
    units = np.flatnonzero(np.isfinite(values))
    return units if values.size - units.size <= MOST_FAILED * values.size else units[:0]


def _spread_part(valid: np.ndarray) -> np.ndarray:
    """Part of each valid unit in their standard deviation, whose mean is that of the deviation."""
    sd = valid.std()
    return (valid - valid.mean()) ** 2 / (2 * sd) if sd > 0 else np.zeros(valid.size)


def _spread_pull(valid: np.ndarray) -> np.ndarray:
    """n d sd/dy_i of valid units."""
    sd = valid.std(ddof=1) if valid.size > 1 else 0.0
    return (valid - valid.mean()) / sd * (valid.size / (valid.size - 1)) if sd > 0 else np.zeros(valid.size)
