"""Certificate: independent random units decide whether a vector of decisions meets the requirements.

All certificates of a search are of one sample. Tighter and looser vectors are tested on it, and the loosest that holds
counts: its share can be wrong only if the sample already errs at the vector whose true share is the target.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rvjax.population import Population, deviate_of, wilson
from rvjax.response import PLAIN
from rvjax.status import Status
from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.look import DECIDES, FAILED, JOINT, Look
from rvjax.tolerances.allocation.problem import OF_QUICK, SPARE, Effort, Problem
from rvjax.tolerances.allocation.sample import NearUnits, Values
from rvjax.tolerances.allocation.tails import FEWEST
from rvjax.tolerances.batch.run import Run
from rvjax.tolerances.batch.statistics import Statistics, rejects, shares_alone
from rvjax.tolerances.failure import failure_probability
from rvjax.tolerances.limits import Limits, Verdict

TESTS = 10
"""Certificates of one search, at most."""

_RARE = 20_000, 200_000  # units behind a probability of failure
_TRUSTED = {"OK", "SEVERAL_POINTS", "KINKED_POINT", "RARE_NOMINAL"}  # all but OK concern the reliability index alone
_CLOSE = 0.9  # part of the rejects of a target that a probability of failure may show at first
_MOST = 4.0  # factor on the wanted rejects by one certificate


class Certifier:
    """Certificates of one search."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self.run, self.drawn = problem, problem.run, 0
        self.solved = 0
        """Units solved so far."""
        self._near: NearUnits | None = None
        self._of_curve: NearUnits | None = None
        """The first units of the certificate, for the curve of costs."""
        self._names = problem.run.names
        """Responses that certificates solve: those of parts in which a limit decides, then all."""
        self._whole: Statistics | None = None
        """The latest certificate of all units and responses."""

    def test(self, constraints: Constraints, x: np.ndarray) -> Statistics:
        """Statistics of a certificate at a vector, whose verdicts count; `whole` has all its figures.

        Responses that do not decide have no verdict before `whole`.

        Args:
            constraints: of the search.
            x: the vector.
        """
        population = constraints.decisions.population(x)
        if self._near is None:
            rare = any(self.rare(item) for item in self.run.requirements.values())
            if rare or not (constraints.by_quantiles and self.run.keep):
                return self.draw(population)
            self._names = constraints.units.decisive(self.run.names, constraints.aside)
            return self._begun(constraints, population)
        return self._at(self._near, constraints, self._run(population))

    def whole(self, seen: Statistics, constraints: Constraints, x: np.ndarray) -> Statistics:
        """Statistics of all units and responses of a certificate that held; later tests begin with these.

        Args:
            seen: by `test`.
            constraints: of the search.
            x: the vector.
        """
        if self._near is None or seen is self._whole:
            return seen
        self._names = self.run.names
        return self._begun(constraints, constraints.decisions.population(x))

    def shares(self, seen: Statistics) -> Statistics:
        """Statistics of a certificate without the units far from the limits: shares and verdicts.

        All units have shown the same ones in 36 sets of grades, of twelve known problems with three seeds.

        Args:
            seen: by `test`.
        """
        return seen if self._near is None or seen is self._whole else shares_alone(seen)

    def draw(self, population: Population) -> Statistics:
        """Statistics of independent units; a target beyond their resolution uses a probability of failure."""
        self.drawn += 1
        self.solved += self.run.samples
        found = self._run(population).statistics()
        better = self._rare_verdicts(population)
        if not better:
            return found
        shares = found.yield_ | {name: verdict.estimate for name, verdict in better.items()}
        ppm = {name: rejects(share) for name, share in shares.items()}
        return dataclasses.replace(found, verdicts=found.verdicts | better, yield_=shares, ppm=ppm)

    def _begun(self, constraints: Constraints, population: Population) -> Statistics:
        """A certificate of all units, from whose values the next ones begin."""
        found = self.draw(population)
        self._near = NearUnits(constraints.units, self.run.z(), dict(found.values or {}))
        self._whole = found if len(self._names) == len(self.run.names) else None
        return found

    def _run(self, population: Population) -> Run:
        """The run of a certificate, with the responses that it solves."""
        required = {name: item for name, item in self.run.requirements.items() if name in self._names}
        return dataclasses.replace(self.run, population=population, names=self._names, requirements=required)

    def yield_at(self, constraints: Constraints, x: np.ndarray, samples: int) -> float:
        """The least share of independent units that keeps one requirement, at a vector.

        Of costly units these are the first ones of the certificate: only those near a limit are solved again.

        Args:
            constraints: of the search.
            x: the vector.
            samples: units, at most those of a certificate.
        """
        samples = min(self.run.samples, samples)
        run = dataclasses.replace(self._run(constraints.decisions.population(x)), samples=samples, keep=False)
        if self._near is not None:
            self._of_curve = self._of_curve or self._near.first(samples)
            return least_yield(self._at(self._of_curve, constraints, run))
        self.solved += samples
        return least_yield(run.statistics())

    def _at(self, near: NearUnits, constraints: Constraints, run: Run) -> Statistics:
        """Statistics of units of which those near a limit are solved for the population of a run."""
        before = constraints.units.solved
        values = near.values(run.population, constraints.limits(run.names))
        self.solved += constraints.units.solved - before
        constraints.units.solved = before
        failed = np.any([np.isnan(row) for row in values.values()], axis=0)
        return run.of_units(values, np.where(failed, int(Status.NONFINITE), int(Status.CONVERGED)))

    def holds(self, statistics: Statistics) -> bool:
        """True if every requirement is met for certain, and the joint target if there is one."""
        met, wanted = all(verdict.met for verdict in (statistics.verdicts or {}).values()), self._problem.joint_target
        joint = statistics.joint_yield
        return met and (wanted is None or (joint is not None and joint.lower >= wanted))

    def hopeless(self) -> bool:
        """True if not even a sample without rejects could certify every target."""
        n, confidence = self.run.samples, self.run.confidence
        alone = any(item.hopeless(n, confidence) for item in self.run.requirements.values())
        return alone or wilson(n, n, confidence).lower < (self._problem.joint_target or 0.0)

    def rare(self, item: Limits) -> bool:
        """True if a probability of failure certifies a limit."""
        return _rare(item, self.run.samples, self.run.confidence, self._problem.effort)

    def wanted(self, constraints: Constraints, k: int) -> float:
        """Share of rejects that a certificate may show of a row on a share.

        Args:
            constraints: of the search.
            k: number of the row.
        """
        item, target = constraints.rows[k].item, constraints.target(k)
        if item is not None and self.rare(item):
            return _CLOSE * target
        return self._problem.shown(1 - target, self.run.samples)

    def all_wanted(self, constraints: Constraints) -> np.ndarray:
        """`wanted` (c,) of all rows, 0 where no share is limited."""
        return np.array([self.wanted(constraints, k) if row.share else 0.0 for k, row in enumerate(constraints.rows)])

    def _rare_verdicts(self, population: Population) -> dict[str, Verdict]:
        """Verdicts on the targets that the units of a certificate are too few for."""
        n, confidence, verdicts = self.run.samples, self.run.confidence, {}
        for name, item in self.run.requirements.items():
            if not self.rare(item):
                continue
            self.solved += (count := _rare_units(n))
            found = failure_probability(self.run.response, population, {name: item}, samples=count, seed=self.run.seed)
            of: Callable[[Any], Any] = lambda figure: figure if name == PLAIN else figure[name]  # noqa: B023, E731
            failing, trusted = of(found.probability), set(of(found.status).split(", ")) <= _TRUSTED
            if not trusted and not item.beyond(n, confidence):
                continue
            if failing.value > 0:  # its interval is one of 95 %
                wider = (failing.upper / failing.value) ** (deviate_of(confidence) / deviate_of(0.95))
                failing = dataclasses.replace(
                    failing, lower=failing.value / wider, upper=min(1.0, failing.value * wider)
                )
            verdicts[name] = item.rarely(failing, trusted)
        return verdicts

    def corrected(
        self, constraints: Constraints, look: Look, seen: Statistics, reached: np.ndarray, misses: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wanted rejects (c,) and corrections of used ways (c,) with which these units would just show every limit.

        Args:
            constraints: of the search.
            look: at the end of the search.
            seen: the certificate of this end.
            reached: wanted rejects (c,) with which the sample would just meet each limit there.
            misses: certificates that failed one after the other; each aims one unit farther inside.
        """
        rejects, moved, n = constraints.rejects.copy(), constraints.moved.copy(), self.run.samples
        deviate, smooth = deviate_of(self.run.confidence), None
        if constraints.by_quantiles and seen.values:
            smooth = _shares(constraints, look, dict(seen.values), np.ones(n))
        for k, row in enumerate(constraints.rows):
            if row.exact:
                continue
            if row.name == FAILED and row.item is None:
                assert constraints.most_failed is not None
                upper = wilson(seen.failed, n, self.run.confidence).upper
                moved[k] += upper / constraints.most_failed - look.used[k]
                continue
            verdict = (seen.verdicts or {}).get(row.name)
            figure = seen.joint_yield if row.item is None else verdict and verdict.estimate
            if figure is None or (look.used[k] < DECIDES and (verdict is None or verdict.met)):
                continue
            if not row.share:
                assert row.item is not None
                shown = row.item.shown(figure, seen.sd[row.name].value, deviate + SPARE)
                moved[k] += float(np.clip(shown / constraints.ways[k] - look.used[k] + 1, -0.5, 0.5))
                continue
            shown, wanted = max(1 - figure.value, 0.5 / n), self.wanted(constraints, k)
            if row.item is not None and self.rare(row.item):
                shown = max(1 - figure.value, 1e-3 * constraints.target(k))
                wanted = constraints.target(k) / (1 + (deviate + SPARE) * figure.error / shown)
            elif smooth is not None and wanted * n > FEWEST:
                if (shown > wanted) == (smooth[k] > wanted):  # the count moves in steps, a quantile is smoothed
                    shown = (max if shown > wanted else min)(shown, smooth[k])
                wanted -= misses / n
            ratio = reached[k] / rejects[k] * wanted / shown
            rejects[k] = min(rejects[k] * float(np.clip(ratio, 1 / _MOST, _MOST)), 0.5)
        return rejects, moved


def least_yield(statistics: Statistics) -> float:
    """The least share of units that keeps one requirement."""
    verdicts = (statistics.verdicts or {}).values()
    return min(verdict.estimate.value for verdict in verdicts if verdict.kind == "share")


def rejects_at_limits(constraints: Constraints, look: Look) -> np.ndarray:
    """Wanted rejects (c,) with which the sample of a search would just meet each limit at a look.

    Args:
        constraints: of the search.
        look: of the search.
    """
    return _shares(constraints, look, constraints.values(look.x), constraints.tails.weights)


def _shares(constraints: Constraints, look: Look, values: Values, weights: np.ndarray) -> np.ndarray:
    """Shares (c,) with which quantiles of these units lie at the limits; the wanted rejects where none does."""
    found = constraints.rejects.copy()
    for k, row in enumerate(constraints.rows):
        if not row.share or not np.isfinite(look.used[k]) or row.name not in {*values, JOINT}:
            continue
        margins = constraints.margins(k, values)[0]
        low, high = math.log(found[k] / 10), math.log(min(10 * found[k], 0.5))
        while high - low > 1e-4:
            at = (low + high) / 2
            level = constraints.quantile(k, margins, math.exp(at), weights[: len(margins)]).level
            low, high = (at, high) if level > 0 else (low, at)
        found[k] = math.exp((low + high) / 2)
    return found


def units_of(requirements: Mapping[str, Limits], samples: int, confidence: float = 0.95) -> int:
    """Quick units that one certificate solves, with those of probabilities of failure.

    Args:
        requirements: by name of the response.
        samples: independent units of a certificate.
        confidence: of its intervals.
    """
    few = sum(_rare(item, samples, confidence, OF_QUICK) for item in requirements.values())
    return samples + few * _rare_units(samples)


def _rare(item: Limits, samples: int, confidence: float, effort: Effort) -> bool:
    few = item.of_shares and samples * (1 - getattr(item, "target", 0.0)) < effort.expected
    return few or item.beyond(samples, confidence)


def _rare_units(samples: int) -> int:
    return min(max(samples, _RARE[0]), _RARE[1])
