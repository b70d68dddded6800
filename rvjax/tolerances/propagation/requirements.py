"""What a response must keep to: the share of units within limits, their mean, or their capability.

A new kind of requirement is one class that derives from `Limits`: it knows its margin on a sample and how
that moves with the responses of the units (allocation), its figure with interval (Monte Carlo, certificate)
and its text. Study files find it by the names of its fields.
"""

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np
from scipy import special

from rvjax.tolerances.propagation.estimates import Estimate, wilson
from rvjax.tolerances.propagation.sampled import Sampled
from rvjax.tolerances.propagation.tails import nearest, tail_quantile

KINDS: list[type["Limits"]] = []
"""Every kind of requirement."""

MOST_FAILED = 0.0027
"""Share of failed units that a figure of the valid ones may leave out: what lies beyond 3 sd of a capable process."""

_CUSHION = 0.7  # standard errors of a figure kept in hand, so that the next draw passes too
_MOST_FACTOR = 1e3
_FEW_FAILED = f"< {100 * MOST_FAILED:g} % failed"


@dataclasses.dataclass(frozen=True)
class Pull:
    """How a margin moves with some units: d margin = sum(cotangents dy) / sum(norms), over those with a slope.

    Attributes:
        units: (m,) numbers of units.
        cotangents: (m,) weight of each unit's response.
        norms: (m,) its part of the denominator.
    """

    units: np.ndarray
    cotangents: np.ndarray
    norms: np.ndarray


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether a requirement is met, for certain.

    Attributes:
        wanted: the requirement as text.
        kind: what the figure is: "share" of units, "response" (in its unit) or "number".
        estimate: the figure it judges.
        met: True if the whole confidence interval meets it, or the end of it that counts; and, for a figure of the
            valid units alone (a mean, Cpk), the upper end of the share of failed units lies below 0.27 %.
    """

    wanted: str
    kind: str
    estimate: Estimate
    met: bool


@dataclasses.dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a response, and what every kind of requirement does with them.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
    """

    of_units: ClassVar[bool] = True  # a unit beyond the limits is a reject
    most_failed: ClassVar[float] = MOST_FAILED  # share of failed units that its figure leaves out
    goal: ClassVar[str | None] = None  # the field that says how much is enough
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
            raise ValueError(f"{owner}.lower = {self.lower:.6g}: lies above upper = {self.upper:.6g}")
        if math.isinf(self.lower) and math.isinf(self.upper):
            raise ValueError(f"{owner}: needs a lower or an upper limit")

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
        """Cp and Cpk of a response with this mean and standard deviation; without two limits Cp is nan."""
        room = -self.margin(mean)
        if sd == 0:
            cp, cpk = math.inf, math.inf if room >= 0 else -math.inf
        else:
            cp, cpk = (self.upper - self.lower) / (6 * sd), room / (3 * sd)
        return (cp if math.isfinite(self.lower) and math.isfinite(self.upper) else math.nan), cpk

    def normal_yield(self, mean: float, sd: float) -> float:
        """Share within the limits of a normal response."""
        if math.isnan(mean) or math.isnan(sd):
            return math.nan
        if sd == 0:
            return float(self.margin(mean) <= 0)
        return float(special.ndtr((self.upper - mean) / sd) - special.ndtr((self.lower - mean) / sd))

    def limited(self, value: float) -> "Limits":
        """The same requirement with its one limit elsewhere, or two limits this far from their middle."""
        if math.isinf(self.lower):
            return dataclasses.replace(self, upper=value)
        if math.isinf(self.upper):
            return dataclasses.replace(self, lower=value)
        middle = (self.lower + self.upper) / 2
        return dataclasses.replace(self, lower=middle - value, upper=middle + value)

    def widened(self, by: float) -> "Limits":
        """The same requirement with every limit moved outwards."""
        return dataclasses.replace(self, lower=self.lower - by, upper=self.upper + by)

    def aimed(self, value: float) -> "Limits":
        """The same requirement with another goal."""
        if self.goal is None:
            raise ValueError(f"against = 'target': {type(self).__name__} has limits only")
        return dataclasses.replace(self, **{self.goal: value})

    @classmethod
    def file_keys(cls) -> dict[str, str]:
        """Keys in a study file and the fields they stand for; the kind of a table is the first that knows its keys."""
        limits = dict(zip(cls.limit_keys(), ("lower", "upper")))
        return limits | {f.name: f.name for f in dataclasses.fields(cls) if f.name not in limits.values()}

    @classmethod
    def limit_keys(cls) -> tuple[str, str]:
        """Keys of the limits, in the unit of the response; all others are plain numbers."""
        return cls.prefix + "lower", cls.prefix + "upper"

    # What a kind must know.

    def learned(self, values: np.ndarray, distance: float) -> float:
        """Margin of the whole requirement on a sample, unit of the response: <= 0 is met.

        Args:
            values: (n,) of the units, nan where one failed.
            distance: of the nominal response from the limit.
        """
        raise NotImplementedError

    def pull(self, values: np.ndarray, margin: float, distance: float, lanes: int) -> Pull:
        """How the margin moves with the units.

        Args:
            values: as for `learned`.
            margin: as `learned` gave it.
            distance: as for `learned`.
            lanes: units that are enough where only some matter.
        """
        raise NotImplementedError

    def figure(self, sampled: Sampled) -> Estimate:
        """What it judges, with its confidence interval."""
        raise NotImplementedError

    def holds(self, estimate: Estimate) -> bool:
        """True if the interval of the figure meets the requirement."""
        raise NotImplementedError

    def factor(self, estimate: Estimate, samples: int, deviate: float, distance: float) -> float:
        """Common factor on all half-widths after which a draw should just hold.

        Args:
            estimate: of the figure, now.
            samples: units of the draw.
            deviate: standard normal one of its confidence.
            distance: as for `learned`.
        """
        raise NotImplementedError

    def verdict(self, sampled: Sampled) -> Verdict:
        """Its figure, and whether that meets it with few enough failed units."""
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

    def shortfall(self, values: np.ndarray, joint_target: float) -> float:
        """How far the limits would have to move outwards, 0 if met.

        Args:
            values: as for `learned`.
            joint_target: share of units that must meet all requirements, 0 for none.
        """
        return max(0.0, self.learned(values, 1.0))

    def text(self) -> str:
        """What is wanted, without the limits' numbers."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Requirement(Limits):
    """Limits of a response and the share of units that must lie within them.

    Attributes:
        lower: lower limit, unit of the response; -inf for none.
        upper: upper limit, unit of the response; inf for none.
        target: share of units, between 0 and 1.
    """

    goal: ClassVar[str | None] = "target"
    judges: ClassVar[str] = "share"
    most_failed: ClassVar[float] = math.inf  # they are rejects
    target: float = 0.9973

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.target < 1:
            raise ValueError(f"Requirement.target = {self.target:.6g}: must lie between 0 and 1")

    def margins(self, values: np.ndarray) -> np.ndarray:
        """Margin of every unit, inf where one failed."""
        return np.where(np.isnan(values), np.inf, self.margin(values))

    def learned(self, values: np.ndarray, distance: float) -> float:
        """Quantile of the units' margins at the target."""
        return tail_quantile(self.margins(values), self.target, distance)

    def pull(self, values: np.ndarray, margin: float, distance: float, lanes: int) -> Pull:
        """Seen from the nominal response, slopes of a linear response grow like the margin itself.

        Least squares along that line brings the units next to the quantile to it.
        """
        margins = self.margins(values)
        units = nearest(margins, self.target, lanes)
        return along_reach(units, margins[units] + distance, self.outward(values[units]), margin + distance)

    def figure(self, sampled: Sampled) -> Estimate:
        """The yield; failed units are rejects."""
        return sampled.share()

    def holds(self, estimate: Estimate) -> bool:
        """The lower end of the yield reaches the target."""
        return estimate.lower >= self.target

    def factor(self, estimate: Estimate, samples: int, deviate: float, distance: float) -> float:
        """Of a normal response within two limits."""
        return share_factor(estimate, self.target, samples, deviate)

    def hopeless(self, samples: int, confidence: float) -> bool:
        """A sample without rejects could not certify the target."""
        return wilson(samples, samples, confidence).lower < self.target

    def shortfall(self, values: np.ndarray, joint_target: float) -> float:
        """The sampled quantile itself, at the stricter of both targets."""
        ordered = np.sort(self.margins(values))
        return max(0.0, float(ordered[math.ceil(max(self.target, joint_target) * len(ordered)) - 1]))

    def text(self) -> str:
        """The target."""
        return f"{100 * self.target:.4g} %"


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

    def learned(self, values: np.ndarray, distance: float) -> float:
        """Margin of the mean."""
        valid = values[_valid(values)]
        return float(self.margin(valid.mean())) if valid.size else math.inf

    def pull(self, values: np.ndarray, margin: float, distance: float, lanes: int) -> Pull:
        """Every unit moves the mean alike."""
        units = _valid(values)
        sign = float(self.outward(values[units].mean())) if units.size else 0.0
        return Pull(units, np.full(units.size, sign), np.ones(units.size))

    def figure(self, sampled: Sampled) -> Estimate:
        """The mean of the valid units."""
        return sampled.mean()

    def holds(self, estimate: Estimate) -> bool:
        """The whole interval lies within the limits."""
        return self.lower <= estimate.lower and estimate.upper <= self.upper

    def factor(self, estimate: Estimate, samples: int, deviate: float, distance: float) -> float:
        """The mean moves away from its nominal place in proportion."""
        way = float(self.margin(estimate.value)) + distance
        wanted = distance - (deviate + _CUSHION) * estimate.error
        return _bounded(wanted / way) if way > 0 else _MOST_FACTOR

    def text(self) -> str:
        """Which figure keeps the limits."""
        return f"mean, {_FEW_FAILED}"


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

    def learned(self, values: np.ndarray, distance: float) -> float:
        """3 cpk sd - min(U - mean, mean - L): the same statement in the response's unit."""
        valid = values[_valid(values)]
        if valid.size < 2:
            return math.inf
        return float(self.margin(valid.mean()) + 3 * self.cpk * valid.std(ddof=1))

    def pull(self, values: np.ndarray, margin: float, distance: float, lanes: int) -> Pull:
        """d mean = sum dy/n, d sd = sum (y - mean) dy/((n - 1) sd)."""
        units = _valid(values)
        if units.size < 2:
            return Pull(units, np.zeros(units.size), np.ones(units.size))
        valid = values[units]
        mean, sd = valid.mean(), valid.std(ddof=1)
        spread = (valid - mean) / sd * (units.size / (units.size - 1)) if sd > 0 else np.zeros(units.size)
        return Pull(units, self.outward(mean) + 3 * self.cpk * spread, np.ones(units.size))

    def figure(self, sampled: Sampled) -> Estimate:
        """Cpk; its error by the delta method from the covariance of mean and sd, for any law."""
        return sampled.cpk(self)

    def holds(self, estimate: Estimate) -> bool:
        """The lower end of the interval of Cpk reaches it."""
        return estimate.lower >= self.cpk

    def factor(self, estimate: Estimate, samples: int, deviate: float, distance: float) -> float:
        """Cpk falls with the half-widths in proportion."""
        return _bounded(estimate.value / (self.cpk + (deviate + _CUSHION) * estimate.error))

    def text(self) -> str:
        """The least Cpk."""
        return f"Cpk >= {self.cpk:.4g}, {_FEW_FAILED}"


def _valid(values: np.ndarray) -> np.ndarray:
    """Numbers of the valid units; none where so many failed that a figure of the others says nothing."""
    units = np.flatnonzero(~np.isnan(values))
    return units if values.size - units.size <= MOST_FAILED * values.size else units[:0]


def along_reach(units: np.ndarray, reach: np.ndarray, signs: np.ndarray, wanted: float) -> Pull:
    """Slopes of units brought from their own distance `reach` from the nominal response to `wanted`."""
    used = np.isfinite(reach) & (reach > 0) & np.isfinite(wanted)
    reach = np.where(used, reach, 0.0)
    return Pull(units, np.where(used, signs * reach * (wanted if np.isfinite(wanted) else 0.0), 0.0), reach**2)


def share_factor(share: Estimate, target: float, samples: int, deviate: float) -> float:
    """Factor on the half-widths of a two-sided normal response whose share of units should reach a target."""
    # The score interval has its lower end at the target where the share lies z errors of the target above it.
    wanted = min(target + (deviate + _CUSHION) * math.sqrt(target * (1 - target) / samples), 1 - 0.5 / samples)
    seen = min(max(share.value, 0.5 / samples), 1 - 0.5 / samples)
    return float(special.ndtri((1 + seen) / 2) / special.ndtri((1 + wanted) / 2))


def _bounded(factor: float) -> float:
    return 0.0 if math.isnan(factor) else min(max(factor, 1 / _MOST_FACTOR), _MOST_FACTOR)
