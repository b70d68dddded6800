"""The certificate: fresh random units decide whether a set of tolerances meets its requirements."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import special

from rvjax.tolerances.propagation.estimates import Estimate, deviate_of, wilson
from rvjax.tolerances.propagation.monte_carlo import Statistics, monte_carlo
from rvjax.tolerances.propagation.requirements import Requirement
from rvjax.tolerances.propagation.responses import BLOCK, PLAIN, Response

_DRAWS = 8  # certificates in one search; every one is a new chance to pass by luck
_CUSHION = 0.7  # standard errors of the yield kept in hand, so that the next draw passes too
_LEAST = 1e-3  # least step of a shrinking half-width, relative


@dataclasses.dataclass
class Certifier:
    """Draws certificates, each from a seed no one has seen before."""

    response: Response
    requirements: dict[str, Requirement]
    joint_target: float | None
    samples: int
    confidence: float
    seed: int
    progress: bool = False

    def draw(self, tolerances: Any, *, keep: bool = False) -> Statistics:
        """Statistics of fresh units."""
        self.seed += 1
        required: Any = self.requirements
        return monte_carlo(
            self.response,
            tolerances,
            samples=self.samples,
            seed=self.seed,
            chunk=BLOCK,
            requirements=required.get(PLAIN, required),
            confidence=self.confidence,
            keep=keep,
            progress=self.progress,
        )

    def judged(self, statistics: Statistics) -> list[tuple[Estimate, float]]:
        """Every yield with its target."""
        yields = statistics.yield_ if isinstance(statistics.yield_, Mapping) else {PLAIN: statistics.yield_}
        pairs = [(yields[name], requirement.target) for name, requirement in self.requirements.items()]
        if self.joint_target is not None and statistics.joint_yield is not None:
            pairs.append((statistics.joint_yield, self.joint_target))
        return pairs

    def holds(self, statistics: Statistics) -> bool:
        """True if the lower confidence bound of every yield reaches its target."""
        return all(share.lower >= target for share, target in self.judged(statistics))

    def hopeless(self) -> bool:
        """True if not even a sample without rejects could certify every target."""
        targets = [r.target for r in self.requirements.values()] + [self.joint_target or 0.0]
        return wilson(self.samples, self.samples, self.confidence).lower < max(targets)

    def factors(self, statistics: Statistics) -> np.ndarray:
        """Of each constraint: the common factor on all half-widths after which a draw should just hold (normal law)."""
        z, n = deviate_of(self.confidence), self.samples
        found = []
        for share, target in self.judged(statistics):
            # The score interval has its lower end at the target where the share lies z errors of the target above it.
            wanted = min(target + (z + _CUSHION) * math.sqrt(target * (1 - target) / n), 1 - 0.5 / n)
            seen = min(max(share.value, 0.5 / n), 1 - 0.5 / n)
            found.append(_two_sided(seen) / _two_sided(wanted))
        return np.array(found)

    def settle(
        self, training: Any, start: np.ndarray, low: np.ndarray, *, draws: int = _DRAWS
    ) -> tuple[np.ndarray, Statistics]:
        """Shrink all half-widths by common factors until a certificate holds; the last one drawn otherwise."""
        half_widths, statistics = start, self.draw(training.tolerances(start))
        for _ in range(draws - 1):
            factor = max(0.5, min(self.factors(statistics).min(), 1 - _LEAST))
            after = np.maximum(half_widths * factor, np.minimum(low, half_widths))
            if self.holds(statistics) or self.hopeless() or np.array_equal(after, half_widths):
                break
            half_widths, statistics = after, self.draw(training.tolerances(after))
        return half_widths, statistics

    def shortfall(self, tolerances: Any) -> tuple[Statistics, dict[str, float]]:
        """How far each limit would have to move outwards for these tolerances; 0 where it is met."""
        statistics = self.draw(tolerances, keep=True)
        values = statistics.values if isinstance(statistics.values, Mapping) else {PLAIN: statistics.values}
        missing = {}
        for name, requirement in self.requirements.items():
            target = max(requirement.target, self.joint_target or 0.0)
            margins = requirement.margin(values[name])
            margins = np.sort(np.where(np.isnan(margins), np.inf, margins))
            missing[name] = max(0.0, float(margins[math.ceil(target * len(margins)) - 1]))
        return dataclasses.replace(statistics, values=None), missing


def _two_sided(share: float) -> float:
    """z with P(|Z| <= z) = share."""
    return float(special.ndtri((1 + share) / 2))
