"""Search of an allocation: its starts, a sample that grows, certificates that say what it must show, its result."""

import dataclasses
import math
from typing import Any

import numpy as np

from rvjax.tolerances.allocation.certificate import TESTS, Certifier, rejects_at_limits
from rvjax.tolerances.allocation.constraints import constraints_of
from rvjax.tolerances.allocation.cost import expected_losses
from rvjax.tolerances.allocation.decisions import ROUNDING, Decisions, Lists, Places
from rvjax.tolerances.allocation.look import FAILED, Look
from rvjax.tolerances.allocation.problem import Problem
from rvjax.tolerances.allocation.programme import AGAIN, COARSE, LOOKS, MET, RADIUS, STATIONARY, End, Programme
from rvjax.tolerances.allocation.rays import Rays
from rvjax.tolerances.allocation.result import Allocation, bounds_active, intervals, margins_of, prices_of, value_prices
from rvjax.tolerances.batch.statistics import Statistics

DEARER = 0.2
"""Part of the learned cost by which a certified one may exceed it and still be called the cheapest."""

_WHOLE = 3  # certificates of all units, after which a miss is a result
_MORE, _TIMES = 0.02, 4  # part of the cost that more certificate units must save, and how many more at most
_CHANGED = 0.03  # logarithm of wanted rejects, by which a search along rays is repeated
_STARTS = 6  # for one number; one more for each further one
_APART = 0.05  # of the vector: nearer ends are one
_DEARER = 0.03  # than the cheapest end, beyond which another one is no rival
_INWARD = 4  # steps to the finest half-widths, where too many units fail; the first one is the shortest


class Search:
    """Search of one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.decisions = problem, problem.decisions
        self.constraints = constraints_of(problem)
        self.programme = Programme(self.constraints, self._noted)
        self.certifier = Certifier(problem)
        self.history: list[dict[str, Any]] = []
        self.tried: list[dict[str, Any]] = []
        self.rays: Rays | None = None
        """Looks along rays, once derivatives have misled."""
        self._last = False
        """True once the sample does not grow any more."""

    # The search on a growing sample.

    def learned(self) -> End:
        """The end of the search on the last sample, before any certificate."""
        constraints, decisions, effort = self.constraints, self.decisions, self.problem.effort
        start = decisions.start
        constraints.rejects = self.certifier.all_wanted(constraints)
        constraints.begin(start)
        lists, programme = Lists(decisions), self.programme
        low, high = programme.low, programme.high = lists.relaxed(decisions.low, decisions.high)
        several = starts(decisions, start, low, high) if decisions.free or effort.middles else [start]
        ends = [self.run(x, RADIUS, most=LOOKS if len(several) > 1 else None) for x in several]
        self.tried = tried(decisions, several, ends, constraints.count) if len(several) > 1 else []
        near = rivals(ends, len(decisions.fields), effort.rivals)
        self._renew(near[0].look.x)
        *growing, last = constraints.counts(near[0].look) or [constraints.count]
        for count in (*growing, last):
            if growing and count == last:  # fewer looks at the largest sample
                near = [self._enough(near[0])]
            self._grow(count, near[0].look)
            self._last = count == last
            near = sorted((self.run(end.look.x) for end in near), key=self._worth)[:1]
        end = self._listed(lists, near[0].look.x) if lists.entries else near[0]
        return self._along_rays(end, start) if effort.rays and self._misled(end) else end

    def _inside(self, start: np.ndarray) -> np.ndarray:
        """The start, or finer half-widths where so many units fail that a quantile is left nowhere."""
        x, count = start, len(self.decisions.fields)
        for part in np.linspace(0, 1, _INWARD + 1)[1:] ** 2:
            if not np.isinf(self.constraints.look(x, sloped=False).used).any():
                break
            x = start.copy()
            x[:count] += part * (self.decisions.low[:count] - start[:count])
        return x

    def _renew(self, x: np.ndarray) -> None:
        """Take the response that is good near a vector, where it depends on the tolerances of its units."""
        if (renewed := getattr(self.problem.response, "near", None)) is None:
            return
        population = self.decisions.population(x)
        response = renewed(population)
        if response is not self.problem.response:
            run = dataclasses.replace(self.problem.run, response=response)
            self.problem = dataclasses.replace(self.problem, response=response, run=run)
            self.constraints.units.renew(response, population)
            self.certifier = Certifier(self.problem)

    def _grow(self, count: int, look: Look) -> None:
        self.constraints.spare(look)
        if count != self.constraints.count:
            self.constraints.sample(count)
        self.constraints.place(look.x)

    def run(self, x: np.ndarray, radius: float = AGAIN, most: int | None = None) -> End:
        """End of a search; a limit without sampling error that it misses by a step's accuracy moves in.

        Args:
            x: (n,) vector from which it begins.
            radius: of the first box.
            most: looks, at most; None: as the problem allows.
        """
        constraints = self.constraints
        most = min(most or self.problem.max_steps, self.problem.max_steps)
        end = self.programme.run(self._inside(x), radius, most=most, gain=None if self._last else COARSE)
        for _ in range(4):
            missed = constraints.missed(end.look)
            if not ROUNDING < missed < MET:
                break
            for k, row in enumerate(constraints.rows):
                if row.exact and end.look.used[k] - constraints.moved[k] - 1 > 0:
                    constraints.moved[k] += 2 * (end.look.used[k] - constraints.moved[k] - 1)
            end = self.programme.run(end.look.x, AGAIN, most=self.problem.max_steps)
        return end

    def _worth(self, end: End) -> tuple[bool, float]:
        met = end.look.excess <= MET
        return not met, end.look.total if met else end.look.excess

    def _noted(self, x: np.ndarray) -> Look:
        """Evaluate a vector and note it."""
        look, decisions = (self.rays or self.constraints).look(x), self.decisions
        self.problem.advance(1)
        rows, margins = self.constraints.rows, (look.used - 1) * self.constraints.ways
        named = {row.name or "response": float(m) for row, m in zip(rows, margins)}
        widths = dict(zip(decisions.fields, map(float, decisions.half_widths(x))))
        self.history.append(dict(cost=look.total, margins=named, half_widths=widths, values=decisions.values(x)))
        return look

    def _listed(self, lists: Lists, x: np.ndarray) -> End:
        """The best end with numbers of lists, from the end x without them."""
        free = self.programme.low, self.programme.high

        def solved(places: Places) -> End:
            self.programme.low, self.programme.high = lists.fixed(places, *free)
            return self.run(np.clip(x, self.programme.low, self.programme.high), RADIUS)

        best = lists.cheapest(x, solved, self._worth)
        return solved(best)

    def _misled(self, end: End) -> bool:
        """True if derivatives of units do not lead to an optimum of limits on shares."""
        judged = any(row.share or row.name == FAILED for row in self.constraints.rows)
        return judged and end.of_widths > STATIONARY

    def _along_rays(self, end: End, start: np.ndarray) -> End:
        """The best end by looks along rays, from the end of another search, the start and the finest half-widths."""
        self.constraints.sample(self.problem.effort.rays)
        self.rays, count = Rays(self.constraints), len(self.decisions.fields)
        finest = np.concatenate([self.decisions.low[:count], end.look.x[count:]])
        ends = [self.run(x, RADIUS) for x in (end.look.x, start, finest)]
        return min(ends, key=self._worth)

    # Certificates.

    def certified(self, end: End) -> tuple[Allocation, End]:
        """The end of a search, corrected by certificates until one holds with a small margin, and its result."""
        end = self._enough(end)
        learned, misses = self._before(end), 0
        best: tuple[End, Statistics, np.ndarray, np.ndarray] | None = None
        missed: np.ndarray | None = None
        constraints, certifier, enough = self.constraints, self.certifier, self.problem.effort.worth
        for test in range(TESTS):
            seen = certifier.test(constraints, end.look.x)
            held = certifier.holds(seen) and constraints.missed(end.look) <= ROUNDING
            misses = 0 if held else misses + 1
            if held and (best is None or end.look.total < best[0].look.total):
                best = end, seen, constraints.rejects, constraints.moved
            elif not held:
                missed = constraints.rejects
            reached = rejects_at_limits(constraints, end.look) if self.rays is None else constraints.rejects
            rejects, moved = certifier.corrected(constraints, end.look, seen, reached, misses)
            if best is not None and missed is not None:  # between them: edges known from other vectors fail together
                inside = (rejects - best[2]) * (missed - rejects) > 0
                rejects = np.where(inside, rejects, np.sqrt(best[2] * missed))
            gain = self._gain(end, rejects, moved) if held or best is None else best[0].look.total - end.look.total
            if (best is not None and gain < enough * abs(end.look.total)) or certifier.hopeless():
                break
            if held and test and best is not None and end is not best[0]:  # looser, and dearer
                break
            last, (constraints.rejects, constraints.moved) = end, (rejects, moved)
            end = self.run(end.look.x)
            if held and end.look.total >= last.look.total:
                break
        if best is not None:
            end, seen, constraints.rejects, constraints.moved = best
        held, seen = certifier.holds(seen), certifier.whole(seen, constraints, end.look.x)
        if held and not certifier.holds(seen) and certifier.drawn <= _WHOLE:  # limits or units that tests left out
            constraints.spare(None)
            return self.certified(self.run(end.look.x))
        return self._result(end, seen, learned), end

    def _gain(self, end: End, rejects: np.ndarray, moved: np.ndarray) -> float:
        """Reduction of the cost by other wanted rejects and corrections, by the prices; along rays unknown."""
        constraints = self.constraints
        if self.rays is not None:
            ratios = np.maximum(rejects, 1e-300) / np.maximum(constraints.rejects, 1e-300)
            return float(np.abs(np.log(ratios)).max(initial=0.0) > _CHANGED) * abs(end.look.total)
        with np.errstate(invalid="ignore"):  # where too many units fail
            away = constraints.quantiles(end.look.x, constraints.rejects) - constraints.quantiles(end.look.x, rejects)
        away = np.where(np.isfinite(away), away, 0.0) + constraints.moved - moved
        return float(end.prices @ away)

    def _enough(self, end: End) -> End:
        """The end with more certificate units, where these save more than they cost; unchanged after a certificate."""
        certifier, constraints, given = self.certifier, self.constraints, self.problem.run.samples
        while not certifier.drawn and certifier.run.keep and 2 * certifier.run.samples <= _TIMES * given:
            run, certifier.run = certifier.run, dataclasses.replace(certifier.run, samples=2 * certifier.run.samples)
            more = certifier.all_wanted(constraints)
            if self._gain(end, more, constraints.moved) < _MORE * abs(end.look.total):
                certifier.run = run
                break
            constraints.rejects = more
            end = self.run(end.look.x)
        return end

    def _before(self, end: End) -> float:
        """Cost without losses at an end if its sample had to show the targets alone, by the prices."""
        cost = end.look.total - end.look.loss
        if self.rays is not None:
            return cost
        targets = np.array([self.constraints.target(k) for k in range(len(self.constraints.rows))])
        spared = self._gain(end, targets, self.constraints.moved)
        return cost * math.exp(-spared / cost) if cost > 0 else cost - spared

    def status(self, seen: Statistics, end: End, learned: float, look: Look) -> str:
        """Status of a look: of an end, or of grades near it; a set of grades by itself is OPTIMAL if certified."""
        exact = self.constraints.missed(look) <= ROUNDING
        if not (self.certifier.holds(seen) and exact):
            return "NOT_CERTIFIED"
        cost = look.cost + look.priced
        if cost > learned + DEARER * abs(learned):
            return "SUBOPTIMAL"
        values = not self.problem.losses and all(row.share or row.nominal for row in self.constraints.rows)
        stationary = end.certain <= STATIONARY or (self.rays is not None and values)
        return "OPTIMAL" if end.settled and stationary else "MAX_STEPS"

    def _result(self, end: End, seen: Statistics, learned: float) -> Allocation:
        """Result of an end that was certified."""
        found = self.allocation(end.look, seen, self.status(seen, end, learned, end.look), learned)
        every = self.constraints.look(end.look.x, every=True) if self.constraints.aside else end.look
        reached, slopes = margins_of(self.constraints, every, seen)
        ways = self.constraints.ways if self.rays is None else self.rays.ways(end.look.x)
        prices = prices_of(self.constraints, end, end.prices, ways)
        confidence = self.certifier.run.confidence
        return dataclasses.replace(
            found, residual=end.residual, margins=reached, margin_slopes=slopes,
            multipliers=found.multipliers | {n: -price for n, price in prices.items()},
            multiplier_intervals=intervals(self.programme, end, confidence) if self.problem.effort.intervals else {},
            value_prices=value_prices(self.decisions, end),
        )  # fmt: skip

    def allocation(self, look: Look, seen: Statistics, status: str, learned: float) -> Allocation:
        """Result at a vector without prices.

        Args:
            look: at the vector.
            seen: its certificate.
            status: of the result.
            learned: cost before certification.
        """
        problem, decisions = self.problem, self.decisions
        nothing, losses = dict.fromkeys(problem.run.names, 0.0), expected_losses(problem.losses, seen)
        cost, start = look.cost + look.priced, decisions.start
        return Allocation(
            feasible=status != "INFEASIBLE", status=status, cost=cost,
            tolerances=decisions.population(look.x).tolerances,
            start_cost=decisions.cost_of(decisions.given_widths, start) + self.constraints.nominal(start)[2],
            learned=learned, costs=decisions.costs(look.x),
            half_widths=dict(zip(decisions.fields, map(float, decisions.half_widths(look.x)))),
            multipliers=nothing, shortfall=nothing, residual=math.nan,
            certificate=seen if problem.run.keep else dataclasses.replace(seen, values=None),
            grades=None, graded=None, history=self.history, evaluations={}, values=decisions.values(look.x),
            bounds_active=bounds_active(decisions, look.x), value_prices=dict.fromkeys(problem.variables, 0.0),
            losses=losses, objective=problem.whole_of(cost, losses), starts=self.tried,
        )  # fmt: skip

    def evaluations(self, sample: int) -> dict[str, int]:
        """Units solved so far, and those of the last sample of the search."""
        return {"search": self.constraints.units.solved, "certificates": self.certifier.solved, "sample": sample}


def starts(decisions: Decisions, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """The given vector, and others spread evenly over mid-points and numbers.

    Args:
        decisions: of the vector.
        x: (n,) the vector.
        low: (n,) bounds.
        high: (n,) bounds.
    """
    count, first = decisions.size - len(decisions.fields), len(decisions.fields)
    if not count:
        return [x]
    # Points of an additive recurrence: low discrepancy in any number of dimensions (Roberts 2018).
    root = 1.5  # of r^(count + 1) = r + 1
    for _ in range(50):
        root = (1 + root) ** (1 / (count + 1))
    shifts, found = root ** -np.arange(1.0, count + 1), [x]
    for i in range(_STARTS + count - 1):
        there = x.copy()
        there[first:] = low[first:] + (0.5 + (i + 1) * shifts) % 1.0 * (high[first:] - low[first:])
        found.append(there)
    return found


def rivals(ends: list[End], first: int, most: int) -> list[End]:
    """Ends on a small sample to go on from: distinct, the cheapest first.

    Args:
        ends: of the searches.
        first: entry of the vectors from which on they must differ.
        most: ends, at most.
    """
    met = [end for end in ends if end.look.excess <= 2 * MET]
    ranked = sorted(met, key=lambda end: end.look.total) or sorted(ends, key=lambda end: end.look.excess)
    found = list[End]()
    limit = ranked[0].look.total + _DEARER * abs(ranked[0].look.total)
    for end in ranked:
        different = all(np.abs(end.look.x - other.look.x)[first:].max(initial=0.0) > _APART for other in found)
        if not found or (different and met and end.look.total <= limit):
            found.append(end)
    return found[:most]


def tried(decisions: Decisions, several: list[np.ndarray], ends: list[End], units: int) -> list[dict[str, Any]]:
    """Starts that were tried, as `Allocation.starts` has them.

    Args:
        decisions: of the vectors.
        several: the starts, (n,) vectors.
        ends: of their searches.
        units: of the sample.
    """

    def of(x: np.ndarray) -> dict[str, float]:
        return decisions.values(x) | decisions.middles_at(x)

    return [
        dict(begun=of(x), values=of(end.look.x), cost=end.look.total, met=end.look.excess <= 2 * MET, units=units)
        for x, end in zip(several, ends)
    ]
