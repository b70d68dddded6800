"""Search for half-widths alone, at constant mid-points and numbers of the design.

Costly units with limits on shares only are searched here. A search of all decisions with the programme solves 2.4 times
as many units of `rv-40e-whole`, takes 1.6 times as long and ends 1.1 % dearer (four looks by the separable model
against 284). Units that fail and responses in steps are searched here too: differences along rays need no derivative.
"""

import dataclasses

import numpy as np

from rvjax.tolerances.batch.monte_carlo import Statistics
from rvjax.tolerances.optimum.certificate import DRAWS, WORTH, Certifier
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.found import Found, status_of, with_grades
from rvjax.tolerances.optimum.problem import Problem
from rvjax.tolerances.optimum.rounding import Rounding
from rvjax.tolerances.optimum.sample_average import Point, Training
from rvjax.tolerances.optimum.search import SETTLED, Search


class HalfWidths:
    """Half-widths of one problem; the other decisions stay as they are in a vector."""

    def __init__(
        self, problem: Problem, decisions: Decisions, x: np.ndarray, certifier: Certifier | None = None
    ) -> None:
        self.problem, self.decisions, self.x = problem, decisions, x
        limited = {name: item for name, item in problem.requirements.items() if item.of_sample}
        self.training = Training(
            problem.response, decisions.population(x), tuple(problem.priced), limited, problem.joint_target,
            problem.samples, problem.seed, problem.memo,
        )  # fmt: skip
        self.search = Search(self.training, problem.priced, problem.max_steps, problem.advance)
        follows = self.training.followed is not None
        self.certifier = certifier or Certifier(problem.run, problem.joint_target, follows=follows)
        self.learned: np.ndarray | None = None
        """The cheapest half-widths (j,) before certification, None where none meet every requirement."""
        self.ended = self.training
        """The sample at the end of the search: grades have slopes of their own."""

    def solution(self) -> Found:
        """The cheapest certified half-widths, or the shortfall of the finest."""
        self.problem.advance(0)
        start = self.decisions.half_widths(self.x)
        point, possible = self.search.opened(start)
        return self._cheapest(point, start) if possible else self._finest()

    def graded(self, found: Found) -> tuple[Found, dict[str, str]]:
        """A solution with its half-widths rounded to grades, and the grades."""
        rounding = Rounding(self.search, self.certifier, self.problem.priced)
        t, grades, certificate = rounding.graded(found.decisions.half_widths(found.x), found.certificate)
        certificate = self.certifier.completed(self.training.with_half_widths(t), certificate)
        x, cost = found.decisions.with_half_widths(found.x, t), found.cost + self._dearer(found, t)
        return with_grades(found, x, certificate, cost, certified=self.certifier.holds(certificate)), grades

    def _dearer(self, found: Found, half_widths: np.ndarray) -> float:
        return self.search.cost(half_widths) - self.search.cost(found.decisions.half_widths(found.x))

    def _cheapest(self, point: Point, start: np.ndarray) -> Found:
        training, search, certifier = self.training, self.search, self.certifier
        point, settled = search.find(point, start)
        if certifier.run.samples > training.samples and training.followed is None:  # a larger sample is more accurate
            seen = certifier.draw(training.with_half_widths(point.half_widths))
            point, settled = search.find(training.correct(point, certifier.factors(seen, training.distance)), start)
        prices, intervals = search.prices(point), search.intervals(point, certifier.run.confidence)
        if search.shrinks(point):
            half_widths, certificate = self._certified(point, start)
        else:
            half_widths, certificate = self._aimed(point, start)
        certificate = certifier.completed(training.with_half_widths(half_widths), certificate)
        self.learned = point.half_widths
        if training.followed is not None:
            self.ended = training.aimed(training.requirements, point.half_widths, training.wrong)
        learned, nothing = search.cost(point.half_widths), dict.fromkeys(training.requirements, 0.0)
        status = status_of(
            certified=certifier.holds(certificate), exact=True, cost=search.cost(half_widths), learned=learned,
            settled=settled, stationary=True,
        )  # fmt: skip
        found = self._found(status, half_widths, certificate, learned, prices, nothing, search.residual(point), settled)
        # Certified half-widths cost more, as if limits were nearer: prices grow with the cost.
        dearer = max(search.cost(half_widths) / learned, 1.0)
        return dataclasses.replace(found, intervals={n: (low, dearer * high) for n, (low, high) in intervals.items()})

    def _certified(self, point: Point, start: np.ndarray) -> tuple[np.ndarray, Statistics]:
        """The cheapest certified set: what was found, tightened where need be, or the start, or the finest."""
        search, certifier = self.search, self.certifier
        start = search.inside(start)
        best, certificate = certifier.settle(search, point)
        best, certificate = certifier.polished(search, point, best, certificate)
        held = certifier.holds(certificate)
        others = [t for t in (start, search.low) if not held or search.cost(t) < search.cost(best)]
        for other in sorted(others, key=search.cost):
            if certifier.hopeless():
                break
            if search.promising(other):
                drawn = certifier.draw(self.training.with_half_widths(other), alone=True)
                if certifier.holds(drawn):
                    return other, drawn
        return best, certificate

    def _aimed(self, point: Point, start: np.ndarray) -> tuple[np.ndarray, Statistics]:
        """Certified set where smaller half-widths do not help: correct the sample by a certificate, search again.

        A limit that held gives back half of its margin: with all of it, one of several limits fails each time.
        """
        training, certifier = self.training, self.certifier
        self.search.settled = SETTLED  # a miss of half a percent has to move the search
        certificate = certifier.draw(training.with_half_widths(point.half_widths))
        for _ in range(DRAWS - 1):
            if certifier.holds(certificate) or certifier.hopeless():
                break
            factors = certifier.exact_factors(certificate, training.distance)
            factors = np.where(factors < 1, (1 - WORTH) * factors, np.sqrt(factors))
            told = training.correct(point, factors)
            point, _ = self.search.find(told, start)
            certificate = certifier.draw(training.with_half_widths(point.half_widths))
        return point.half_widths, certificate

    def _finest(self) -> Found:
        """Result where the finest half-widths fail on the learning sample; an independent one gives the shortfall."""
        search, certifier = self.search, self.certifier
        certificate, shortfall = certifier.shortfall(self.training.with_half_widths(search.low))
        refused = certifier.joint_target is not None or any(missing > 0 for missing in shortfall.values())
        status = "INFEASIBLE" if refused else "NOT_CERTIFIED"  # the larger sample may see the limits just met
        if certifier.holds(certificate):  # nothing cheaper was searched
            status = "SUBOPTIMAL"
        nothing = np.zeros(len(shortfall))
        return self._found(status, search.low, certificate, search.cost(search.low), nothing, shortfall)

    def _found(
        self,
        status: str,
        half_widths: np.ndarray,
        certificate: Statistics,
        learned: float,
        prices: np.ndarray,
        shortfall: dict[str, float],
        residual: float = np.nan,
        settled: bool = True,
    ) -> Found:
        rest = self.decisions.cost(self.x) - self.decisions.widths_cost(self.x)
        return Found(
            status, self.decisions, self.decisions.with_half_widths(self.x, half_widths), certificate,
            learned + rest, self.search.cost(half_widths) + rest,
            dict(zip(self.training.requirements, map(float, prices))), shortfall, residual, settled, True, True,
            self.training.evaluated[0], self.search.history,
        )  # fmt: skip
