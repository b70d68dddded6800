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
from rvjax.tolerances.optimum.followed import WRONG, Followed
from rvjax.tolerances.optimum.sample_average import Point
from rvjax.tolerances.optimum.search import Search
from rvjax.tolerances.requirements.factors import CUSHION, MOST_FACTOR, bounded, share_factor
from rvjax.tolerances.requirements.limits import Verdict

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

    def draw(self, population: Population, *, keep: bool | None = None, wrong: float = WRONG) -> Statistics:
        """Statistics of independent units; a target beyond their resolution uses a probability of failure."""
        self.drawn += 1
        if self.units is None:
            self.run = dataclasses.replace(self.run, seed=self.run.seed + 1)
        asked = dataclasses.replace(self.run, population=population, keep=self.run.keep if keep is None else keep)
        found = self._followed(asked, wrong) if self.follows else asked.statistics()
        return dataclasses.replace(found, verdicts=found.verdicts | self.rare(population)) if found.verdicts else found

    def _followed(self, asked: Run, wrong: float) -> Statistics:
        """Statistics of the units of the first certificate, those near a limit solved."""
        if self.units is None:
            self.units = Followed(asked.response, asked.population, asked.samples, asked.seed, asked.memo)
        ends = {
            name: [end for end in (item.lower, item.upper) if math.isfinite(end)]
            for name, item in asked.requirements.items()
        }
        return asked.of_units(*self.units.at(asked.population, lambda values, moved: ends, wrong))

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
        statistics = self.draw(training.with_half_widths(half_widths))
        for _ in range(draws - 1):
            factors = self.factors(statistics, training.distance)
            factors[np.argmin(factors)] = max(0.5, min(factors.min(), 1 - _LEAST))
            after = search.tightened(point, half_widths, factors)
            if self.holds(statistics) or self.hopeless() or np.array_equal(after, half_widths):
                break
            half_widths, statistics = after, self.draw(training.with_half_widths(after))
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
        drawn = self.draw(training.with_half_widths(wider))
        return (wider, drawn) if self.holds(drawn) else (half_widths, statistics)

    def shortfall(self, population: Population) -> tuple[Statistics, dict[str, float]]:
        """Distance by which each limit must move outwards for these tolerances; 0 where it is met."""
        statistics = self.draw(population, keep=True)
        missing = {
            name: item.shortfall(statistics.values[name], self.joint_target or 0.0)
            for name, item in self.run.requirements.items()
        }
        return statistics if self.run.keep else dataclasses.replace(statistics, values=None), missing
