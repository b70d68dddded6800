"""Certificate: independent random units decide whether a set of tolerances meets its requirements."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from rvjax.population import Population, deviate_of, wilson
from rvjax.response import PLAIN
from rvjax.tolerances.batch.monte_carlo import Run, Statistics
from rvjax.tolerances.failure.failure import failure_probability
from rvjax.tolerances.optimum.followed import REACHED, WRONG, Followed
from rvjax.tolerances.optimum.sample_average import Point
from rvjax.tolerances.optimum.search import Search
from rvjax.tolerances.requirements.factors import CUSHION, MOST_FACTOR, bounded, share_factor
from rvjax.tolerances.requirements.kinds import Requirement
from rvjax.tolerances.requirements.limits import Limits, Verdict

DRAWS = 8  # certificates in one search; every one is a new chance to pass by luck
_RARE = 20_000, 200_000  # units behind a probability of failure
_TRUSTED = {"OK", "SEVERAL_POINTS", "KINKED_POINT", "RARE_NOMINAL"}  # all but OK concern the reliability index alone
_LEAST = 1e-3  # least step of a shrinking half-width, relative
WORTH = 2e-3  # least margin in half-widths for another certificate
_ROOM = 0.1  # the most of it to use


@dataclasses.dataclass
class Certifier:
    """Certificates, each from a new seed."""

    run: Run
    joint_target: float | None
    drawn: int = 0
    follows: bool = False
    units: Followed | None = None
    """Costly units, which serve every certificate of a search: looser and looser tolerances are then tested in turn on
    one sample, and the last that holds is as sure as a single test."""

    @property
    def solved(self) -> int:
        """Units solved so far."""
        return self.units.solved if self.units is not None else self.drawn * self.run.samples

    def draw(
        self, population: Population, *, keep: bool | None = None, wrong: float = WRONG, alone: bool = False
    ) -> Statistics:
        """Statistics of independent units; a target beyond their resolution uses a probability of failure.

        Args:
            population: tolerances of the units.
            keep: keep their values, None: as the run does.
            wrong: costly units expected on the wrong side of a limit, at most.
            alone: the verdicts matter alone: costly units near a limit count only where the share may miss its target.
        """
        self.drawn += 1
        if self.units is None:
            self.run = dataclasses.replace(self.run, seed=self.run.seed + 1)
        asked = dataclasses.replace(self.run, population=population, keep=self.run.keep if keep is None else keep)
        found = self._followed(asked, wrong, alone) if self.follows else asked.statistics()
        return dataclasses.replace(found, verdicts=found.verdicts | self.rare(population)) if found.verdicts else found

    def completed(self, population: Population, statistics: Statistics) -> Statistics:
        """Statistics that count every unit near a limit, where those of a certificate are of its verdicts alone."""
        if self.units is None or not statistics.verdicts:
            return statistics
        found = self._followed(dataclasses.replace(self.run, population=population), WRONG, False)
        rare = {n: v for n, v in statistics.verdicts.items() if self.run.requirements[n].beyond(*self._size)}
        return dataclasses.replace(found, verdicts=found.verdicts | rare)

    @property
    def _size(self) -> tuple[int, float]:
        """Units of a certificate, and the confidence of its intervals."""
        return self.run.samples, self.run.confidence

    def _followed(self, asked: Run, wrong: float, alone: bool) -> Statistics:
        """Statistics of the units of the first certificate, those near a limit solved."""
        if self.units is None:
            self.units = Followed(asked.response, asked.population, asked.samples, asked.seed, asked.memo)
        required, deviate = asked.requirements.items(), deviate_of(asked.confidence)
        ends = {name: [end for end in (item.lower, item.upper) if math.isfinite(end)] for name, item in required}

        def deciding(values: dict[str, np.ndarray], moved: float) -> dict[str, list[float]]:
            near = {n for n, item in required if reach(item, values[n], deviate) > REACHED * (1 - moved)}
            return {name: ends[name] if name in near else [] for name in ends}

        every = not alone or self.joint_target is not None
        aims = (lambda values, moved: ends) if every else deciding
        return asked.of_units(*self.units.at(asked.population, aims, wrong))

    def rare(self, population: Population) -> dict[str, Verdict]:
        """Verdicts on the targets that the units of a certificate are too few for."""
        n, confidence = self.run.samples, self.run.confidence
        beyond = {name: item for name, item in self.run.requirements.items() if item.beyond(n, confidence)}
        verdicts = {}
        for name, item in beyond.items():
            count = min(max(n, _RARE[0]), _RARE[1])
            found = failure_probability(self.run.response, population, {name: item}, samples=count, seed=self.run.seed)
            of: Callable[[Any], Any] = lambda figure: figure if name == PLAIN else figure[name]  # noqa: B023, E731
            failing, reasons = of(found.probability), set(of(found.status).split(", "))
            if failing.value > 0:  # its interval is one of 95 %
                wider = (failing.upper / failing.value) ** (deviate_of(confidence) / deviate_of(0.95))
                failing = dataclasses.replace(
                    failing, lower=failing.value / wider, upper=min(1.0, failing.value * wider)
                )
            verdicts[name] = item.rarely(failing, reasons <= _TRUSTED)
        return verdicts

    def holds(self, statistics: Statistics) -> bool:
        """True if every requirement is met for certain, and the joint target if there is one."""
        met = all(verdict.met for verdict in (statistics.verdicts or {}).values())
        joint = statistics.joint_yield
        return met and (self.joint_target is None or (joint is not None and joint.lower >= self.joint_target))

    def hopeless(self) -> bool:
        """True if not even a sample without rejects could certify every target."""
        n, confidence = self.run.samples, self.run.confidence
        alone = any(item.hopeless(n, confidence) for item in self.run.requirements.values())
        return alone or wilson(n, n, confidence).lower < (self.joint_target or 0.0)

    def factors(self, statistics: Statistics, distance: np.ndarray, more: float = 0.0) -> np.ndarray:
        """Common factor on all half-widths after which each constraint should just hold; `more`: standard errors."""
        n, z = self.run.samples, deviate_of(self.run.confidence) + more
        z -= CUSHION if self.units is not None else 0.0  # the same units hold no surprise
        found = [
            item.factor(statistics.verdicts[name].estimate, n, z, float(d))
            for (name, item), d in zip(self.run.requirements.items(), distance)
        ]
        if any(item.most_failed < 1 for item in self.run.requirements.values()):
            found.append(self.of_failures(statistics))
        if self.joint_target is not None and statistics.joint_yield is not None:
            found.append(share_factor(statistics.joint_yield, self.joint_target, n, z))
        return np.array(found)

    def exact_factors(self, statistics: Statistics, distance: np.ndarray) -> np.ndarray:
        """`factors` by the unit at which costly units would just prove each limit, where these are kept.

        A lost motion whose units without errors lie at the limit does not follow a common factor on all half-widths.
        """
        found = self.factors(statistics, distance)
        for k, (name, item) in enumerate(self.run.requirements.items()):
            if self.units is None or statistics.values is None:
                continue
            margin = item.certified_margin(statistics.values[name], deviate_of(self.run.confidence)) / distance[k]
            if math.isfinite(margin):
                found[k] = bounded(1 / max(margin + 1, 1 / MOST_FACTOR))
        return found

    def of_failures(self, statistics: Statistics) -> float:
        """Common factor after which few enough units should fail for statistics of the valid units to count."""
        n, most = statistics.samples, min(item.most_failed for item in self.run.requirements.values())
        valid = wilson(n - statistics.failed, n, self.run.confidence)
        return share_factor(valid, 1 - most, n, deviate_of(self.run.confidence))

    def settle(self, search: Search, point: Point, *, draws: int = DRAWS) -> tuple[np.ndarray, Statistics]:
        """Tighten half-widths, where that costs least, until a certificate holds; the last one otherwise."""
        half_widths, training = point.half_widths, search.training
        statistics = self.draw(training.with_half_widths(half_widths), alone=True)
        for step in range(draws - 1):  # the share is enough for a first step; after it only a rest is left
            seen = statistics, training.distance
            factors = self.exact_factors(*seen) if step else self.factors(*seen)
            factors[np.argmin(factors)] = max(0.5, min(factors.min(), 1 - _LEAST))
            after = search.tightened(point, half_widths, factors)
            if self.holds(statistics) or self.hopeless() or np.array_equal(after, half_widths):
                break
            half_widths, statistics = after, self.draw(training.with_half_widths(after), alone=True)
        return half_widths, statistics

    def polished(
        self, search: Search, point: Point, half_widths: np.ndarray, statistics: Statistics
    ) -> tuple[np.ndarray, Statistics]:
        """Looser half-widths where a certificate holds with a margin, if their certificate holds too.

        Tried once, by half of the margin, because the other half may be chance.
        """
        training = search.training
        factors = np.minimum(self.factors(statistics, training.distance), 1 + _ROOM)
        if not self.holds(statistics) or factors.min() < 1 + WORTH:
            return half_widths, statistics
        wider = search.loosened_to(point, half_widths, np.sqrt(factors))
        if np.array_equal(wider, half_widths):
            return half_widths, statistics
        drawn = self.draw(training.with_half_widths(wider), alone=True)
        return (wider, drawn) if self.holds(drawn) else (half_widths, statistics)

    def shortfall(self, population: Population) -> tuple[Statistics, dict[str, float]]:
        """Distance by which each limit must move outwards for these tolerances; 0 where it is met."""
        statistics = self.draw(population, keep=True)
        missing = {
            name: item.shortfall(statistics.values[name], self.joint_target or 0.0)
            for name, item in self.run.requirements.items()
        }
        return statistics if self.run.keep else dataclasses.replace(statistics, values=None), missing


def reach(item: Limits, values: np.ndarray, deviate: float) -> float:
    """Way from the median of some units to the one that would just prove a share, in parts of the way to the limit.

    Args:
        item: a share within limits.
        values: (n,) of independent units, nan where one failed.
        deviate: standard errors by which the share must exceed the target.
    """
    assert isinstance(item, Requirement)
    middle, proves = float(np.median(item.margins(values))), item.certified_margin(values, deviate)
    return 1 - proves / middle if middle < 0 else math.inf
