"""Half-widths, mid-points and numbers of the design together: search, certificate, or the reason for none."""

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from rvjax._jax.blocks import PULLED
from rvjax.response import begin_programs
from rvjax.tolerances.batch.monte_carlo import Statistics
from rvjax.tolerances.loss import expected_losses
from rvjax.tolerances.optimum.certificate import DRAWS, Certifier
from rvjax.tolerances.optimum.correction import MOST, NEAR, WORTH, Correction
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.ends import STATIONARY, confirmed, intervals, margins_of, pricing
from rvjax.tolerances.optimum.feasibility import Shortage, least_shortage
from rvjax.tolerances.optimum.found import Found, status_of
from rvjax.tolerances.optimum.half_widths import HalfWidths
from rvjax.tolerances.optimum.lists import Lists, Places
from rvjax.tolerances.optimum.local import Local
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.problem import Problem
from rvjax.tolerances.optimum.programme import End, Programme
from rvjax.tolerances.optimum.rounding import graded_by_objective
from rvjax.tolerances.optimum.steps import CLOSE, FIRST, far, followed, ranges
from rvjax.tolerances.optimum.valleys import COARSE, FEW, apart, rivals, searched, starts, told

FINE = 4096
"""Units in the tails, at most."""

_ROUNDS = 3  # of searches, each with its units placed at the end of the one before, at most
_STILL = 2e-3  # change of the cost between rounds that ends them, as a part of it
_MET = 0.01  # excess within the error of the sample
_SHARPENED, _OTHERS = 2, 16  # searches after such corrections, at most, and times as many units behind each
_EXACTLY = 1e-9  # excess of a limit without sampling error that is rounding
_TIMES = 4  # searches that move such a limit in, at most
_AGAIN = 0.2  # radius of the first step of a search that is repeated


class Designer:
    """Solves one problem."""

    def __init__(self, problem: Problem, decisions: Decisions) -> None:
        self.problem, self.decisions = problem, decisions
        self.low, self.high = self.decisions.low, self.decisions.high
        self.history: list[dict[str, Any]] = []
        self.follows = problem.costly and all(i.of_shares or not i.of_sample for i in problem.requirements.values())
        self.certifier = Certifier(problem.run, problem.joint_target, follows=self.follows)
        self.samples: list[Margins] = []
        self.starts: list[dict[str, Any]] = []
        self.allowed = 0
        """Units that the search may solve, if they are costly and there are several starts."""

    def solution(self) -> Found:
        """The cheapest certified vector, or the least shortage; values of units only where these are few."""
        found = self._solution()
        found = dataclasses.replace(found, ranges=self._ranges(found), starts=self.starts)
        if self.follows:
            found = dataclasses.replace(found, evaluated=self._evaluated())
        if self.problem.run.keep or found.certificate.values is None:
            return found
        return dataclasses.replace(found, certificate=dataclasses.replace(found.certificate, values=None))

    def _solution(self) -> Found:
        decisions, lists = self.decisions, Lists(self.decisions)
        start = self.problem.start(decisions)
        if lists.entries:
            self.low, self.high = lists.relaxed(decisions.low, decisions.high)
        margins = self._sample(FINE)
        if self.problem.costly:
            begin_programs(self.problem.response, decisions.population(start), slopes=True)
        several = self._rivals(start)
        margins.begin(several[0])
        end = min([self._searched(margins, x) for x in several], key=functools.partial(self._worth, margins))
        ends = self._others(margins, end, start)
        margins, end = ends[0]
        if lists.entries:
            end = self._listed(margins, lists, end.point.x)
        if not self._met(margins, end):
            shortage = self._shortage(margins, [end.point.x, start])
            if shortage.total > _MET:
                return self._refused(margins, shortage)
            end = self._searched(margins, shortage.x)
            if (margins.missed(end.point) > _EXACTLY).any():
                return self._refused(margins, shortage)
        values = decisions.fields and any(item.of_sample for item in self.problem.requirements.values())
        if values and not self.problem.costly and not confirmed(margins, decisions, end):
            return self._by_values(end)
        found = self._certified(margins, end)
        if found.status in ("NOT_CERTIFIED", "SUBOPTIMAL") and not lists.entries:
            others = [self._certified(*other) for other in ends[1:] if self._met(*other)]
            found = min([found, *others], key=lambda item: (item.status == "NOT_CERTIFIED", self._whole(item)))
        return found

    def _whole(self, found: Found) -> float:
        """Cost with the mean losses of its certificate."""
        problem = self.problem
        return problem.whole_of(found.cost, expected_losses(problem.losses, found.certificate)).value

    def _met(self, margins: Margins, end: End) -> bool:
        """True if an end keeps the limits of the sample within its error, and the others exactly."""
        return end.excess <= _MET and not (margins.missed(end.point) > _EXACTLY).any()

    def _by_values(self, end: End) -> Found:
        """Solution where derivatives of units mislead: by values alone, at the mid-points and numbers of an end.

        Other mid-points and numbers, and losses, were not compared by values: with these it need not be the cheapest.
        """
        found = HalfWidths(self.problem, self.decisions, end.point.x, self.certifier).solution()
        others = self.decisions.size > len(self.decisions.fields) or bool(self.problem.losses)
        status = "MAX_STEPS" if others and found.status == "OPTIMAL" else found.status
        return dataclasses.replace(found, status=status, history=self.history + found.history)

    def _listed(self, margins: Margins, lists: Lists, x: np.ndarray) -> End:
        """The best end with numbers of lists, from the end x without them."""
        free = self.low, self.high

        def solved(places: Places, again: bool = False) -> End:
            self.low, self.high = lists.fixed(places, *free)
            return self._searched(margins, x) if again else self._run(margins, x, 1.0)

        worth = functools.partial(self._worth, margins)
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
        ends = searched(coarse, several, self.low, self.high)
        self.starts = told(self.decisions, several, ends, coarse.samples)
        return [end.point.x for end in rivals(ends)]

    def _sample(self, most: int, sloped: int = PULLED) -> Margins:
        """A sample, whose units count."""
        self.samples.append(self.problem.margins(self.decisions, most, sloped=sloped))
        self.samples[-1].mirrored = self.follows and self.decisions.size > len(self.decisions.fields)
        return self.samples[-1]

    def _evaluated(self) -> int:
        return sum(margins.evaluated for margins in self.samples)

    def _others(self, margins: Margins, end: End, start: np.ndarray) -> list[tuple[Margins, End]]:
        """Ends on large samples, the cheapest first: a given one, and of costly units that of the best other start.

        All starts are tried on a small sample, from that end too. They may solve half as many units as this end and
        its certificate. The other half is for searches on a large sample, from ends with other numbers.
        """
        several = starts(self.decisions, start, self.low, self.high)[1:] if self.follows else []
        if not several:
            return [(margins, end)]
        small, first = self._sample(COARSE, FEW), len(self.decisions.fields)
        if far(margins, end.point.x):
            end = self._run(margins, end.point.x)
        given, pairs = margins.evaluated, [(margins, end)]
        small.begin_like(margins)
        most = given + self.problem.run.samples
        self.allowed = given + most
        found = searched(small, [end.point.x, *several], self.low, self.high, most / 2)
        self.starts = told(self.decisions, [start, *several], found, small.samples)
        for rival in rivals(found, first):
            if self._evaluated() + given / 2 > self.allowed or not apart(rival, end, first):
                continue
            small.anchor = None
            small.replace_sample(rival.point.x)
            large = self._sample(FINE)
            large.begin_like(small)
            pairs.append((large, self._run(large, rival.point.x)))
        return sorted(pairs, key=lambda pair: self._worth(*pair))

    def _worth(self, margins: Margins, end: End) -> tuple[bool, float]:
        met = self._met(margins, end)
        return not met, end.point.total if met else end.excess

    def _shortage(self, margins: Margins, several: list[np.ndarray]) -> Shortage:
        """The least shortage of the requirements as they are."""
        exact = self.problem.margins(self.decisions, FINE, aimed=False)
        exact.begin(several[0])
        exact.ways = margins.ways
        exact.offsets[:] = 0.0
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
        """End of a search; where it misses a limit without sampling error by a step's accuracy, that limit moves in."""
        end = self._run_once(margins, x, radius, curvature)
        for _ in range(_TIMES):
            missed, given = np.maximum(margins.missed(end.point), 0.0), margins.offsets.copy()
            if not 0 < missed.max(initial=0.0) < _MET:
                break
            margins.offsets[margins.exact] += 2 * missed * margins.ways[margins.exact]
            end = self._run_once(margins, end.point.x, _AGAIN, end.curvature)
            if margins.missed(end.point).max() > missed.max() / 2:  # nothing meets it: it stays where it was
                margins.offsets[:] = given
                break
        return end

    def _run_once(self, margins: Margins, x: np.ndarray, radius: float, curvature: np.ndarray | None) -> End:
        if self.follows:
            look = lambda x: self._noted(margins, x)  # noqa: E731
            size = CLOSE if len(self.samples) > 1 else FIRST
            return followed(margins, look, self.low, self.high, x, self.problem.max_steps, curvature, size=size)
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

    # Certificates.

    def _certified(self, margins: Margins, end: End) -> Found:
        """The end of a search, corrected by certificates until one holds with a small margin."""
        end, correction = self._sharpened(margins, end), Correction(self.certifier)
        certifier, decisions, learned = self.certifier, self.decisions, self._learned(margins, end)
        kept: tuple[End, Statistics] | None = None
        certificate = self._drawn(end.point.x)
        for _ in range(DRAWS - 1):
            held, before = certifier.holds(certificate), None if kept is None else kept[0].point.total
            if held and (before is None or end.point.total < before):
                kept = end, certificate
            corrected = correction.apply(margins, end, certificate, held)
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
        cost, loss = margins.total(x), margins.losses.look(x, sloped=False)[0]
        stationary = end.residual <= self._stationary
        exact = not (margins.missed(end.point) > _EXACTLY).any()
        status = status_of(
            certified=certifier.holds(certificate) and end.excess <= _MET, exact=exact, cost=cost + loss,
            learned=learned, settled=end.settled, stationary=stationary,
        )  # fmt: skip
        reached, slopes = margins_of(margins, decisions, end)
        priced = pricing(margins, end, x)
        confidence = certifier.run.confidence
        uncertain = intervals(margins, end, priced, self.low, self.high, confidence) if self.follows else {}
        return Found(
            status, decisions, x, certificate, learned - loss, cost, priced(end.prices), {}, end.residual,
            end.settled, stationary, exact, margins.evaluated, self.history, end, None, reached, slopes, uncertain,
        )  # fmt: skip

    @property
    def _stationary(self) -> float:
        """Largest residual of an optimum; with losses, costly ends with 0.07 to 0.1 were 2 % above the least."""
        return STATIONARY / 2 if self.problem.costly and self.problem.losses else STATIONARY

    def _learned(self, margins: Margins, end: End) -> float:
        """Cost at an end without what its targets have beyond those of the requirements, by the prices."""
        total = end.point.total
        if not self._met(margins, end):
            return total
        spared = float(end.prices @ margins.spared(end.point.x, self.problem.requirements))
        return total * math.exp(-spared / total) if total > 0 else total - spared

    def _sharpened(self, margins: Margins, end: End) -> End:
        """The end of a search, its margins corrected by many other units in the tails: a certificate costs more."""
        if self.problem.costly or not self.problem.requirements:
            return end
        for _ in range(_SHARPENED):
            own = end.point.margins - end.point.moved
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
        search = HalfWidths(self.problem, self.decisions, x, self.certifier).search
        point = search.look(self.decisions.half_widths(x))
        if not np.isfinite(point.margins).all():
            return x, certificate
        half_widths, drawn = self.certifier.settle(search, point)
        return self.decisions.with_half_widths(x, half_widths), drawn

    def _ranges(self, found: Found) -> dict[str, tuple[float, float]]:
        """Values of each number with which the cost stays within 0.5 %; of costly units as a certificate has units."""
        if found.end is None or not self.problem.variables or self.problem.costly != self.follows:
            return {}
        coarse = self._sample(COARSE // 2, FEW // 2) if self.follows else self._sample(COARSE)
        coarse.begin(found.end.point.x)
        if self.follows:
            coarse.follow(found.end.point.x)
        most = max(self.allowed - self._evaluated(), self.problem.run.samples) if self.follows else math.inf
        return ranges(coarse, self.decisions, found.end, self.low, self.high, most)

    def graded(self, found: Found) -> tuple[Found, dict[str, str]]:
        """The solution with half-widths rounded to grades at its mid-points and numbers."""
        if self.problem.losses:
            return graded_by_objective(found, self.problem.margins(self.decisions, FINE), self.certifier, self._drawn)
        return HalfWidths(self.problem, self.decisions, found.x, self.certifier).graded(found)

    def _refused(self, margins: Margins, shortage: Shortage) -> Found:
        """The solution where no vector meets all requirements.

        A smoothed quantile is too wide where units crowd at a limit. So a certificate that holds there decides.
        """
        x, certificate = shortage.x, self._drawn(shortage.x)
        exact = not (margins.missed(margins.look(x, sloped=False)) > _EXACTLY).any()
        held, total = self.certifier.holds(certificate) and exact, margins.total(x)
        status, missed = ("SUBOPTIMAL", None) if held else ("INFEASIBLE", shortage)
        nothing = dict.fromkeys(margins.requirements, math.nan if held else 0.0)
        return Found(
            status, self.decisions, x, certificate, total, total, nothing, {} if held else shortage.by_name, math.nan,
            True, True, exact, margins.evaluated, self.history, None, missed,
        )  # fmt: skip
