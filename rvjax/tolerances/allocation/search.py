"""Search of an allocation: a sample that grows, a certificate that says what the sample must show, and its result."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rvjax.response import begin_programs
from rvjax.tolerances.allocation.certificate import Certifier
from rvjax.tolerances.allocation.constraints import FAILED, FEW, SPARE, Constraints, Look
from rvjax.tolerances.allocation.grades import Grades
from rvjax.tolerances.allocation.lists import Lists, Places
from rvjax.tolerances.allocation.prices import intervals, margins_of, prices_of, value_prices
from rvjax.tolerances.allocation.problem import QUICK, Problem
from rvjax.tolerances.allocation.programme import AGAIN, COARSE, MET, RADIUS, STATIONARY, End, Programme
from rvjax.tolerances.allocation.ranges import ranges
from rvjax.tolerances.allocation.rays import Rays
from rvjax.tolerances.allocation.result import Allocation, bounds_active
from rvjax.tolerances.allocation.starts import rivals, starts
from rvjax.tolerances.batch.statistics import Statistics
from rvjax.tolerances.loss import expected_losses

DEARER = 0.2
"""Part of the learned cost by which a certified one may exceed it and still be called the cheapest."""

_BEYOND = 40  # units of the last sample beyond each limit that decides
_STAGES = 2048, 4096  # costly units of samples between the first and the last one
_MOST = 16_384  # costly units of a sample, at most
_TESTS = 6  # certificates of one search, at most
_WORTH = 1e-3, 4e-3  # gain of the cost, as a part of it, for which another one of quick, of costly units is computed
_MORE, _TIMES = 0.02, 4  # part of the cost that more certificate units must save, and how many more at most
_CHANGED = 0.03  # logarithm of wanted rejects, by which a search along rays is repeated
_EXACTLY = 1e-9  # excess of a limit without sampling error that is rounding
_LOOKS = 14  # of a start on a small sample
_RAYS = 2  # times as many units of a sample that is looked at along rays, which are not in the tails
_RIVALS = 3  # ends of starts that are searched on
_INWARD = (
    0.05,
    0.2,
    0.5,
    0.75,
    1.0,
)  # parts of the way to the finest half-widths, where too many units fail at the start


class Search:
    """Search of one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.decisions = problem, problem.decisions
        self.constraints = Constraints(problem, self.decisions)
        self.programme = Programme(self.constraints, self._noted)
        self.certifier = Certifier(problem)
        self.history: list[dict[str, Any]] = []
        self.tried: list[dict[str, Any]] = []
        self._rays: Rays | None = None
        self._last = False
        """True once the sample does not grow any more."""

    def solution(self, *, grades: bool = False, yields: Sequence[float] = ()) -> Allocation:
        """The cheapest certified vector, or the least shortage.

        Args:
            grades: also the cheapest with half-widths of ISO 286 grades.
            yields: other targets of all shares, for the cost curve.
        """
        end = self._learned()
        if end.look.excess > MET or self.constraints.missed(end.look) > _EXACTLY:
            shortage = self._shortage(end.look.x)
            if shortage.look.excess > MET:
                return self._refused(shortage)
            end = self._run(shortage.look.x)
        found, end = self._certified(end)
        kept = self.constraints.rejects.copy(), self.constraints.moved.copy()
        if grades and self.problem.priced and found.feasible:
            rounded = Grades(self).rounded(end, found)
            if rounded.status == "OPTIMAL" and found.status == "NOT_CERTIFIED":  # grades near it are the set
                found = dataclasses.replace(
                    rounded, status=self._status(rounded.certificate, end, found.learned), grades=None
                )
            found = dataclasses.replace(found, graded=rounded)
        self.constraints.rejects, self.constraints.moved = kept
        count = self.constraints.count
        found = dataclasses.replace(found, curve=self._curve(end, yields))
        if self.problem.variables and self._rays is None:
            self.constraints.rejects, self.constraints.moved = kept[0], kept[1].copy()
            found = dataclasses.replace(found, ranges=ranges(self.constraints, self.programme, end))
        return dataclasses.replace(found, evaluations=self.evaluations(count))

    # The search on a growing sample.

    def _learned(self) -> End:
        """The end of the search on the last sample, before any certificate."""
        problem, constraints, decisions = self.problem, self.constraints, self.decisions
        start = decisions.start
        if problem.costly:
            begin_programs(problem.response, decisions.population(start), slopes=True)
        for k, row in enumerate(constraints.rows):
            if row.share:
                constraints.rejects[k] = self.certifier.wanted(constraints, k)
        constraints.begin(start)
        lists = Lists(decisions)
        low, high = self.programme.low, self.programme.high = lists.relaxed(decisions.low, decisions.high)
        several = starts(decisions, start, low, high) if decisions.free or not problem.costly else [start]
        ends = [self._run(x, RADIUS, most=_LOOKS if len(several) > 1 else None) for x in several]
        self.tried = self._told(several, ends) if len(several) > 1 else []
        near = rivals(ends, len(decisions.fields), _RIVALS if not problem.costly else 2)
        counts = self._counts(near[0].look)
        for count in counts:
            self._grow(count, near[0].look)
            self._last = self.constraints.count == counts[-1] and count == counts[-1]
            near = sorted((self._run(end.look.x) for end in near), key=self._worth)[:1]
        self._last, end = True, near[0]
        if lists.entries:
            end = self._listed(lists, end.look.x)
        return end if problem.costly or not self._misled(end) else self._along_rays(end, start)

    def _inside(self, start: np.ndarray) -> np.ndarray:
        """The start, or finer half-widths where so many units fail that a quantile is left nowhere."""
        x, count = start, len(self.decisions.fields)
        for part in _INWARD:
            if not np.isinf(self.constraints.look(x, sloped=False).used).any():
                break
            x = start.copy()
            x[:count] += part * (self.decisions.low[:count] - start[:count])
        return x

    def _counts(self, look: Look) -> list[int]:
        """Units of the samples to come."""
        if not self.problem.costly:
            return [self.problem.sample] * 2  # in the tails, placed twice
        near = [1 - getattr(r.item, "target", self.problem.joint_target or 0.0)
                for k, r in enumerate(self.constraints.rows) if r.share and look.used[k] > SPARE]  # fmt: skip
        wanted = 2 ** math.ceil(math.log2(_BEYOND / min(near, default=1.0)))
        last = min(max(wanted, self.problem.sample, FEW), _MOST)
        return [*(count for count in _STAGES if count < last), last] if last > FEW else []

    def _grow(self, count: int, look: Look) -> None:
        self.constraints.spare(look)
        if count != self.constraints.count:
            self.constraints.sample(count)
        self.constraints.place(look.x)

    def _run(self, x: np.ndarray, radius: float = AGAIN, most: int | None = None) -> End:
        """End of a search; a limit without sampling error that it misses by a step's accuracy moves in."""
        constraints = self.constraints
        most = min(most or self.problem.max_steps, self.problem.max_steps)
        end = self.programme.run(self._inside(x), radius, most=most, gain=None if self._last else COARSE)
        for _ in range(4):
            missed = constraints.missed(end.look)
            if not _EXACTLY < missed < MET:
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
        look, decisions = (self._rays or self.constraints).look(x), self.decisions
        self.problem.advance(1)
        margins = (look.used - 1) * self.constraints.ways
        named = {row.name or "response": float(m) for row, m in zip(self.constraints.rows, margins)}
        widths = dict(zip(decisions.fields, map(float, decisions.half_widths(x))))
        self.history.append(dict(cost=look.total, margins=named, half_widths=widths, values=decisions.values(x)))
        return look

    def _told(self, several: list[np.ndarray], ends: list[End]) -> list[dict[str, Any]]:
        """Starts that were tried, as `Allocation.starts` has them."""
        of = lambda x: self.decisions.values(x) | self.decisions.middles_at(x)  # noqa: E731
        return [
            dict(
                begun=of(x),
                values=of(end.look.x),
                cost=end.look.total,
                met=end.look.excess <= 2 * MET,
                units=self.constraints.count,
            )
            for x, end in zip(several, ends)
        ]

    def _listed(self, lists: Lists, x: np.ndarray) -> End:
        """The best end with numbers of lists, from the end x without them."""
        free = self.programme.low, self.programme.high

        def solved(places: Places) -> End:
            self.programme.low, self.programme.high = lists.fixed(places, *free)
            return self._run(np.clip(x, self.programme.low, self.programme.high), RADIUS)

        best = lists.cheapest(x, solved, self._worth)
        return solved(best)

    def _misled(self, end: End) -> bool:
        """True if derivatives of units do not lead to an optimum of limits on shares."""
        judged = any(row.share or row.name == FAILED for row in self.constraints.rows)
        return judged and end.of_widths > STATIONARY

    def _along_rays(self, end: End, start: np.ndarray) -> End:
        """The best end by looks along rays, from the end of another search, the start and the finest half-widths."""
        self.constraints.sample(_RAYS * QUICK)
        self._rays, count = Rays(self.constraints), len(self.decisions.fields)
        finest = np.concatenate([self.decisions.low[:count], end.look.x[count:]])
        ends = [self._run(x, RADIUS) for x in (end.look.x, start, finest)]
        return min(ends, key=self._worth)

    # Certificates.

    def _certified(self, end: End) -> tuple[Allocation, End]:
        """The end of a search, corrected by certificates until one holds with a small margin, and its result."""
        end = self._enough(end)
        learned, best = self._before(end), None
        constraints, certifier = self.constraints, self.certifier
        held_at, failed_at = np.zeros(len(constraints.rows)), np.full(len(constraints.rows), np.inf)
        for test in range(_TESTS):
            seen = certifier.draw(self.decisions.population(end.look.x))
            held = certifier.holds(seen) and constraints.missed(end.look) <= _EXACTLY
            if held and (best is None or end.look.total < best[0].look.total):
                best = end, seen
            reached = constraints.reached(end.look) if self._rays is None else constraints.rejects
            rejects, moved = certifier.corrected(constraints, end.look, seen, reached)
            bad = certifier.failing(constraints, seen)
            held_at = np.where(bad, held_at, np.maximum(held_at, constraints.rejects))
            failed_at = np.where(bad, np.minimum(failed_at, constraints.rejects), failed_at)
            between = np.sqrt(
                np.where(held_at > 0, held_at, rejects) * np.where(np.isfinite(failed_at), failed_at, rejects)
            )
            rejects = np.where((rejects >= failed_at) | (rejects < held_at), between, rejects)
            gain = self._gain(end, rejects, moved)
            if (held and gain < _WORTH[self.problem.costly] * abs(end.look.total)) or certifier.hopeless():
                break
            if held and test and best is not None and end is not best[0]:  # looser, and dearer
                break
            last, (constraints.rejects, constraints.moved) = end, (rejects, moved)
            end = self._run(end.look.x)
            if held and end.look.total >= last.look.total:
                break
        if best is not None:
            end, seen = best
        return self._result(end, seen, learned), end

    def _gain(self, end: End, rejects: np.ndarray, moved: np.ndarray) -> float:
        """Reduction of the cost by other wanted rejects and corrections, by the prices; along rays unknown."""
        constraints = self.constraints
        if self._rays is not None:
            changed = np.abs(np.log(np.maximum(rejects, 1e-300) / np.maximum(constraints.rejects, 1e-300))).max(
                initial=0.0
            )
            return float(changed > _CHANGED) * abs(end.look.total)
        away = constraints.quantiles(end.look.x, constraints.rejects) - constraints.quantiles(end.look.x, rejects)
        away = np.where(np.isfinite(away), away, 0.0) + constraints.moved - moved
        return float(end.prices @ away)

    def _enough(self, end: End) -> End:
        """The end with more certificate units, where these save more than they cost."""
        certifier, constraints, given = self.certifier, self.constraints, self.problem.run.samples
        while certifier.run.keep and 2 * certifier.run.samples <= _TIMES * given:
            run, certifier.run = certifier.run, dataclasses.replace(certifier.run, samples=2 * certifier.run.samples)
            more = np.array(
                [certifier.wanted(constraints, k) if row.share else 0.0 for k, row in enumerate(constraints.rows)]
            )
            if self._gain(end, more, constraints.moved) < _MORE * abs(end.look.total):
                certifier.run = run
                break
            constraints.rejects = more
            end = self._run(end.look.x)
        return end

    def _before(self, end: End) -> float:
        """Cost without losses at an end if its sample had to show the targets alone, by the prices."""
        if self._rays is not None:
            return end.look.total - end.look.loss
        targets = np.array([self.constraints.target(k) for k in range(len(self.constraints.rows))])
        spared, cost = self._gain(end, targets, self.constraints.moved), end.look.total - end.look.loss
        return cost * math.exp(-spared / cost) if cost > 0 else cost - spared

    def _status(self, seen: Statistics, end: End, learned: float) -> str:
        """Status of an end. No other place calls one OPTIMAL."""
        exact = self.constraints.missed(end.look) <= _EXACTLY
        if not (self.certifier.holds(seen) and exact):
            return "NOT_CERTIFIED"
        cost = end.look.cost + end.look.priced
        if cost > learned + DEARER * abs(learned):
            return "SUBOPTIMAL"
        values = not self.problem.losses and all(row.share or row.nominal for row in self.constraints.rows)
        noisy = self.problem.costly and end.promised <= STATIONARY**2 / 2  # slopes of few units
        stationary = end.residual <= STATIONARY or noisy or (self._rays is not None and values)
        return "OPTIMAL" if end.settled and stationary else "MAX_STEPS"

    def _result(self, end: End, seen: Statistics, learned: float) -> Allocation:
        """Result of an end that was certified."""
        found = self.allocation(end.look, seen, self._status(seen, end, learned), learned)
        reached, slopes = margins_of(self.constraints, end)
        ways = self.constraints.ways if self._rays is None else self._rays.ways(end.look.x)
        prices = prices_of(self.constraints, end, end.prices, ways)
        confidence = self.certifier.run.confidence
        return dataclasses.replace(
            found, residual=end.residual, margins=reached, margin_slopes=slopes,
            multipliers=found.multipliers | {n: -price for n, price in prices.items()},
            multiplier_intervals=intervals(self.programme, end, confidence) if self.problem.costly else {},
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
        cost = look.cost + look.priced
        given = decisions.vector(problem.given, {name: item.first for name, item in problem.variables.items()})
        return Allocation(
            feasible=status != "INFEASIBLE", status=status, cost=cost,
            tolerances=decisions.population(look.x).tolerances,
            start_cost=decisions.cost_of(problem.given, given) + self.constraints.nominal(given)[2],
            learned=learned, costs=decisions.costs(look.x),
            half_widths=dict(zip(decisions.fields, map(float, decisions.half_widths(look.x)))),
            multipliers=nothing, shortfall=nothing, residual=math.nan,
            certificate=seen if problem.run.keep else dataclasses.replace(seen, values=None),
            grades=None, graded=None, history=self.history, evaluations={}, values=decisions.values(look.x),
            bounds_active=bounds_active(decisions, look.x), value_prices=dict.fromkeys(problem.variables, 0.0),
            losses=losses, objective=problem.whole_of(cost, losses), starts=self.tried,
        )  # fmt: skip

    # Problems without a solution.

    def _shortage(self, x: np.ndarray) -> End:
        """The least sum of shortfalls, in parts of their limits, with all half-widths at their finest."""
        programme, constraints, count = self.programme, self.constraints, len(self.decisions.fields)
        self._rays, constraints.aside = None, frozenset()
        self.constraints.rejects = np.array([constraints.target(k) for k in range(len(constraints.rows))])
        high, free = programme.high.copy(), programme.high
        high[:count] = programme.low[:count]
        programme.high, programme.weights = high, constraints.ways / constraints.limits()
        ends = [self._run(np.clip(start, programme.low, high), RADIUS) for start in (x, self.decisions.start)]
        end = min(ends, key=lambda end: float(programme.weights @ np.maximum(end.look.used - 1, 0.0)))
        programme.high, programme.weights = free, None
        constraints.place(end.look.x)
        return programme.end(constraints.look(end.look.x))

    def _refused(self, end: End) -> Allocation:
        """Result where no vector meets all requirements; a certificate that holds there decides."""
        constraints, look = self.constraints, end.look
        run = self.certifier.run
        self.certifier.run = dataclasses.replace(run, keep=True)
        seen = self.certifier.draw(self.decisions.population(look.x))
        self.certifier.run = run
        held = self.certifier.holds(seen) and constraints.missed(look) <= _EXACTLY
        total = look.cost + look.priced
        found = self.allocation(look, seen, "SUBOPTIMAL" if held else "INFEASIBLE", total)
        if held:
            return dataclasses.replace(found, evaluations=self.evaluations(constraints.count))
        joint, missing = self.problem.joint_target or 0.0, dict[str, float]()
        for k, row in enumerate(constraints.rows):
            if row.item is None:
                continue
            own = (look.used[k] - constraints.moved[k] - 1) * constraints.ways[k]
            if not row.exact and (
                self.problem.costly or joint or not row.share or not math.isfinite(own)
            ):  # more units, or all limits
                own = self.problem.requirements[row.name].shortfall(seen.values[row.name], joint)
            missing[row.name] = max(missing.get(row.name, 0.0), float(own), 0.0)
        if constraints.most_failed is not None and seen.failed > constraints.most_failed * seen.samples:
            few = {n for n, item in self.problem.requirements.items() if item.most_failed < 1}
            missing |= dict.fromkeys(few, math.inf)  # no limit helps a statistic of the valid units
        if not any(value > 0 for value in missing.values()) and self.problem.joint_target is None:
            found = dataclasses.replace(found, status="NOT_CERTIFIED", feasible=True)
        helps = self._helping(end)
        return dataclasses.replace(
            found, shortfall=found.shortfall | missing, evaluations=self.evaluations(constraints.count), helps=helps,
            reason=self._reason(missing, helps) if self.problem.variables else None,
        )  # fmt: skip

    def evaluations(self, sample: int) -> dict[str, int]:
        """Units solved so far, and those of the last sample of the search."""
        return {"search": self.constraints.units.solved, "certificates": self.certifier.solved, "sample": sample}

    def _helping(self, end: End) -> tuple[str, str] | None:
        """Bound of a number of the design whose move outwards reduces the shortage most."""
        first = len(self.decisions.fields) + len(self.decisions.moves)
        weights = self.constraints.ways / self.constraints.limits()
        pull = (weights * (end.look.used > 1)) @ np.where(np.isfinite(end.look.jacobian), end.look.jacobian, 0.0)
        x, found = end.look.x, []
        for k, name in enumerate(self.decisions.free, first):
            found += [(float(pull[k]), name, "lower")] if x[k] <= self.programme.low[k] + 1e-6 else []
            found += [(float(-pull[k]), name, "upper")] if x[k] >= self.programme.high[k] - 1e-6 else []
        best = max(found, default=(0.0, "", ""))
        return (best[1], best[2]) if best[0] > 0 else None

    def _reason(self, missing: dict[str, float], helps: tuple[str, str] | None) -> str:
        """The limits that are missed, and the bound of a number that would help most."""
        text = "; ".join(
            f"{name or 'the response'} misses its limit by {value:.4g} (SI)"
            for name, value in missing.items()
            if value > 0
        )
        if helps is not None:
            name, side = helps
            item = self.decisions.variables[name]
            wider = f"a {'lower' if side == 'lower' else 'higher'} {side} bound of {name}"
            text += f"; {wider} than {item.lower if side == 'lower' else item.upper:.6g} (SI) would help most"
        return text

    # Cost of other yields.

    def _curve(self, end: End, yields: Sequence[float]) -> list[tuple[float, float]]:
        """(least yield of a requirement, cost) of other targets, ascending; yields are those of independent units."""
        if not any(row.share for row in self.constraints.rows):
            return []
        goals = [item.target for item in self.problem.requirements.values() if item.goal == "target"]
        points, constraints, goal = list[tuple[float, float]](), self.constraints, min(goals, default=1.0)
        if self.problem.costly and yields:
            constraints.sample(min(constraints.count, 2048))
        for side in (sorted((y for y in yields if y < goal), reverse=True), sorted(y for y in yields if y >= goal)):
            x = end.look.x
            for target in side:
                constraints.rejects = np.array([1 - target if row.share and row.item else r
                                                for row, r in zip(constraints.rows, constraints.rejects)])  # fmt: skip
                there = self.programme.run(x, most=12, gain=5e-3)
                if there.look.excess > 2 * MET:
                    continue
                x, run = there.look.x, self.certifier.run
                fresh = dataclasses.replace(
                    run,
                    population=self.decisions.population(x),
                    samples=min(run.samples, 4096 if self.problem.costly else 65536),
                    keep=False,
                )
                self.certifier.solved += fresh.samples
                points.append((least_yield(fresh.statistics()), there.look.total))
        return sorted(points)


def least_yield(statistics: Statistics) -> float:
    """The least share of units that keeps one requirement."""
    return min(verdict.estimate.value for verdict in statistics.verdicts.values() if verdict.kind == "share")
