"""Half-widths, mid-points and numbers of the design together: search, certificate, or the reason for none."""

import dataclasses
import math
from typing import Any

import numpy as np

from rvjax.response import begin_programs
from rvjax.tolerances.batch.monte_carlo import Statistics
from rvjax.tolerances.optimum.certificate import DRAWS, Certifier
from rvjax.tolerances.optimum.correction import MOST, NEAR, WORTH, Correction
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.feasibility import Shortage, least_shortage
from rvjax.tolerances.optimum.lists import Lists, Places
from rvjax.tolerances.optimum.local import Local
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.nominal import Nominal
from rvjax.tolerances.optimum.problem import Problem
from rvjax.tolerances.optimum.programme import End, Programme
from rvjax.tolerances.optimum.rounding import Rounding
from rvjax.tolerances.optimum.sample_average import Training
from rvjax.tolerances.optimum.search import Search
from rvjax.tolerances.optimum.steps import COARSE, followed, ranges, starts, valleys
from rvjax.tolerances.requirements.kinds import Requirement

FINE = 4096
"""Units in the tails, at most."""

_ROUNDS = 3  # of searches, each with its units placed at the end of the one before, at most
_STILL = 2e-3  # change of the cost between rounds that ends them, as a part of it
_MET = 0.01  # excess within the error of the sample
_SHARPENED, _OTHERS = 2, 16  # searches after such corrections, at most, and times as many units behind each
_AGAIN = 0.2  # radius of the first step of a search that is repeated


@dataclasses.dataclass(frozen=True)
class Found:
    """Solution of a problem.

    Attributes:
        status: as in `Allocation`.
        decisions: whose vector `x` is.
        x: (n,) the solution.
        end: of the search; None where the problem is infeasible.
        margins: with the correction that the certificate called for.
        certificate: of the solution.
        learned: cost before certification.
        shortage: of an infeasible problem.
        history: one dict per vector.
    """

    status: str
    decisions: Decisions
    x: np.ndarray
    end: End | None
    margins: Margins
    certificate: Statistics
    learned: float
    shortage: Shortage | None
    history: list[dict[str, Any]]


class Designer:
    """Solves one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.decisions = problem, problem.decisions()
        self.low, self.high = self.decisions.low, self.decisions.high
        self.history: list[dict[str, Any]] = []
        self.follows = problem.costly and self._only_shares(problem)
        self.certifier = Certifier(problem.run, problem.joint_target, follows=self.follows)
        self.correction = Correction(self.certifier)

    @staticmethod
    def _only_shares(problem: Problem) -> bool:
        return all(isinstance(item, (Requirement, Nominal)) for item in problem.requirements.values())

    def solution(self) -> Found:
        """The cheapest certified vector, or the least shortage; values of units only where these are few."""
        found = self._solution()
        if self.problem.run.keep or found.certificate.values is None:
            return found
        return dataclasses.replace(found, certificate=dataclasses.replace(found.certificate, values=None))

    def _solution(self) -> Found:
        decisions, lists = self.decisions, Lists(self.decisions)
        start = self.problem.start(decisions)
        if lists.entries:
            self.low, self.high = lists.relaxed(decisions.low, decisions.high)
        margins = self.problem.margins(decisions, FINE)
        if self.problem.costly:
            begin_programs(self.problem.response, decisions.population(start), slopes=True)
        rivals = self._rivals(start)
        margins.begin(rivals[0])
        end = self._best([self._searched(margins, x) for x in rivals])
        if lists.entries:
            end = self._listed(margins, lists, end.point.x)
        if end.excess > _MET:
            shortage = self._shortage(margins, [end.point.x, start])
            if shortage.total > _MET:
                return self._refused(margins, shortage)
            end = self._searched(margins, shortage.x)
        return self._certified(margins, end)

    def _listed(self, margins: Margins, lists: Lists, x: np.ndarray) -> End:
        """The best end with numbers of lists, from the end x without them."""
        free = self.low, self.high

        def solved(places: Places, again: bool = False) -> End:
            self.low, self.high = lists.fixed(places, *free)
            return self._searched(margins, x) if again else self._run(margins, x, 1.0)

        def worth(end: End) -> tuple[bool, float]:
            met = end.excess <= _MET
            return not met, end.point.total if met else end.excess

        if np.isfinite(margins.look(x).margins).all():
            margins.replace_sample(x)
        rivals = lists.cheapest(x, solved, worth)
        ends = [solved(places, again=True) for places in rivals]
        best = min(range(len(ends)), key=lambda i: worth(ends[i]))
        self.low, self.high = lists.fixed(rivals[best], *free)
        if best < len(ends) - 1:
            margins.replace_sample(ends[best].point.x)
        return ends[best]

    def _rivals(self, start: np.ndarray) -> list[np.ndarray]:
        """Vectors from which the search on the large sample begins."""
        several = [start] if self.follows else starts(self.decisions, start, self.low, self.high)
        if len(several) == 1:
            return several
        coarse = self.problem.margins(self.decisions, COARSE)
        coarse.begin(start)
        return [end.point.x for end in valleys(coarse, several, self.low, self.high, self.decisions.reach)]

    def _shortage(self, margins: Margins, several: list[np.ndarray]) -> Shortage:
        """The least shortage of the requirements as they are."""
        exact = self.problem.margins(self.decisions, FINE, aimed=False)
        exact.begin(several[0])
        exact.ways = margins.ways
        return least_shortage(
            exact, self.decisions, several[: 1 if self.follows else None], self.low, self.high, self.problem.max_steps,
            follows=self.follows,
        )  # fmt: skip

    def _searched(self, margins: Margins, x: np.ndarray) -> End:
        """End of a search that is repeated with its units placed at its end, until that changes nothing."""
        curvature, radius, before = None, 1.0, math.inf
        for number in range(_ROUNDS - self.follows):
            if number:
                margins.replace_sample(x)
            end = self._run(margins, x, radius, curvature)
            x, curvature, radius = end.point.x, end.curvature, _AGAIN
            if (number and abs(end.point.total - before) <= _STILL * abs(before)) or not len(margins.names):
                break
            before = end.point.total
        return end

    def _run(self, margins: Margins, x: np.ndarray, radius: float = _AGAIN, curvature: np.ndarray | None = None) -> End:
        if self.follows:
            look = lambda x: self._noted(margins, x)  # noqa: E731
            return followed(margins, look, self.low, self.high, x, self.problem.max_steps, curvature)
        search = Programme(
            lambda x: self._noted(margins, x), self.low, self.high, self.decisions.reach, self.problem.max_steps
        )
        return search.run(x, radius, curvature)

    def _noted(self, margins: Margins, x: np.ndarray) -> Local:
        """Evaluate a vector and note it."""
        point, decisions = margins.look(x), self.decisions
        self.problem.advance(1)
        named = {name or "response": float(m) for name, m in zip(margins.names, point.margins * margins.ways)}
        widths = dict(zip(decisions.fields, map(float, decisions.half_widths(x))))
        self.history.append(dict(cost=point.total, margins=named, half_widths=widths, values=decisions.values(x)))
        return point

    @staticmethod
    def _best(ends: list[End]) -> End:
        met = [end for end in ends if end.excess <= _MET]
        return min(met, key=lambda end: end.point.total) if met else min(ends, key=lambda end: end.excess)

    # Certificates.

    def _certified(self, margins: Margins, end: End) -> Found:
        """The end of a search, corrected by certificates until one holds with a small margin."""
        end = self._sharpened(margins, end)
        certifier, decisions, learned = self.certifier, self.decisions, end.point.total
        kept: tuple[End, Statistics] | None = None
        certificate = self._drawn(end.point.x)
        for _ in range(DRAWS - 1):
            held, before = certifier.holds(certificate), None if kept is None else kept[0].point.total
            if held and (before is None or end.point.total < before):
                kept = end, certificate
            corrected = self.correction.apply(margins, end, certificate, held)
            little = before is not None and end.point.total > before - WORTH * abs(before)
            enough = little or (not self.follows and certifier.drawn > 2)
            if not corrected or (enough if held else certifier.hopeless()):
                break
            end = self._run(margins, end.point.x, _AGAIN, end.curvature)
            certificate = self._drawn(end.point.x)
        if certifier.holds(certificate) and (kept is None or end.point.total < kept[0].point.total):
            kept = end, certificate
        if kept is not None:
            end, certificate = kept
        x = end.point.x
        if kept is None and not certifier.hopeless():
            x, certificate = self._tightened(x, certificate)
        status = "OPTIMAL" if end.settled and end.excess <= _MET else "MAX_STEPS"
        if margins.total(x) > learned + 0.2 * abs(learned):
            status = "SUBOPTIMAL"
        if not certifier.holds(certificate) or end.excess > _MET:
            status = "NOT_CERTIFIED"
        return Found(status, decisions, x, end, margins, certificate, learned, None, self.history)

    def _sharpened(self, margins: Margins, end: End) -> End:
        """The end of a search, its margins corrected by many other units in the tails: a certificate costs more."""
        if self.problem.costly or not self.problem.requirements:
            return end
        for _ in range(_SHARPENED):
            own = end.point.margins - margins.offsets / margins.ways
            seen = margins.of_others(end.point.x, _OTHERS)
            moved = {k: margin - own[k] for k, margin in seen.items() if own[k] > -NEAR and math.isfinite(margin)}
            for k, by in moved.items():
                margins.offsets[k] = float(np.clip(by, -MOST, MOST)) * margins.ways[k]
            margins.draw_lines(end.point.x, {k: seen[k] for k in moved})
            margins.offsets[list(margins.lines)] = 0.0
            before, end = end, self._run(margins, end.point.x, _AGAIN, end.curvature)
            same = abs(end.point.total - before.point.total) <= _STILL * abs(end.point.total)
            if same or set(margins.lines) >= set(moved):
                break
        return end

    def _drawn(self, x: np.ndarray) -> Statistics:
        """Certificate; values of costly units correct the margins."""
        return self.certifier.draw(self.decisions.population(x), keep=True if self.follows else None)

    def _tightened(self, x: np.ndarray, certificate: Statistics) -> tuple[np.ndarray, Statistics]:
        """Half-widths made smaller at these numbers until a certificate holds; the last one otherwise."""
        if not self.decisions.fields:
            return x, certificate
        search = self._search(x)
        point = search.look(self.decisions.half_widths(x))
        if not np.isfinite(point.margins).all():
            return x, certificate
        half_widths, drawn = self.certifier.settle(search, point)
        return self._with(x, half_widths), drawn

    def _with(self, x: np.ndarray, half_widths: np.ndarray) -> np.ndarray:
        found = x.copy()
        found[: len(half_widths)] = np.log(half_widths)
        return found

    def _search(self, x: np.ndarray) -> Search:
        """Search for half-widths at constant mid-points and numbers."""
        problem = self.problem
        limited = {n: i for n, i in problem.requirements.items() if not isinstance(i, Nominal)}
        training = Training(
            problem.response, self.decisions.population(x), tuple(problem.priced), limited, problem.joint_target,
            problem.samples, problem.seed, problem.memo,
        )  # fmt: skip
        return Search(training, problem.priced, problem.max_steps, problem.advance)

    def ranges(self, found: Found) -> dict[str, tuple[float, float]]:
        """Values of each number with which the cost stays within 0.5 %; none where units are costly."""
        if found.end is None or self.problem.costly or not self.problem.variables:
            return {}
        coarse = self.problem.margins(self.decisions, COARSE)
        coarse.begin(found.end.point.x)
        return ranges(coarse, self.decisions, found.end, self.low, self.high)

    def graded(self, found: Found) -> tuple[Found, dict[str, str]]:
        """The solution with half-widths rounded to grades at its mid-points and numbers."""
        search = self._search(found.x)
        half_widths = self.decisions.half_widths(found.x)
        t, grades, certificate = Rounding(search, self.certifier, self.problem.priced).graded(
            half_widths, found.certificate
        )
        status = "OPTIMAL" if self.certifier.holds(certificate) else "NOT_CERTIFIED"
        there = dataclasses.replace(found, x=self._with(found.x, t), certificate=certificate, status=status)
        return there, grades

    def _refused(self, margins: Margins, shortage: Shortage) -> Found:
        """The solution where no vector meets all requirements.

        A smoothed quantile is too wide where units crowd at a limit. So a certificate that holds there decides.
        """
        x, certificate = shortage.x, self._drawn(shortage.x)
        held, total = self.certifier.holds(certificate), margins.total(x)
        status, missed = ("SUBOPTIMAL", None) if held else ("INFEASIBLE", shortage)
        return Found(status, self.decisions, x, None, margins, certificate, total, missed, self.history)
