"""From half-widths to ISO 286 grades: the cheapest set whose certificate holds.

Powers of the used ways are linear in powers of the half-widths, so the cheapest set of grades under the model of the
search is a mixed-integer linear programme: one of the grades of each field, and of fields without grades one of many
half-widths. The model is taken again at each set that it proposes, because it is right near its own vector only.
"""

import dataclasses
import math
from typing import Any

import numpy as np
import scipy

from rvjax.population import GRADES, it_width
from rvjax.tolerances.allocation.certificate import TESTS, rejects_at_limits
from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.look import Look
from rvjax.tolerances.allocation.programme import AGAIN, COARSE, MET, End, expansion
from rvjax.tolerances.allocation.result import Allocation
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.batch.statistics import Statistics

_FINE = 48  # half-widths of a field without grades, in its range
_FINER = 5  # times the gain that ends a search: for the best set
_SETS = 12  # sets that are looked at before each certificate, at most

Places = dict[int, int]
"""Places of the graded fields on their ladders."""


class Grades:
    """Grades of the fields with a size; half-widths of the other fields are fitted to them."""

    def __init__(self, search: Search) -> None:
        self._search, self._decisions = search, search.decisions
        priced, active = self._decisions.priced, self._decisions.base.active
        self.ladders = {j: _ladder(active[name].size, cost) for j, (name, cost) in enumerate(priced.items())}
        self.ladders = {j: ladder for j, ladder in self.ladders.items() if ladder}
        self._known: dict[tuple[int, ...], Look] = {}

    def rounded(self, end: End, found: Allocation) -> tuple[Allocation, Look]:
        """The cheapest certified set of grades near the end of a search, and its look.

        Args:
            end: the end.
            found: its result.
        """
        search, certifier, constraints = self._search, self._search.certifier, self._search.constraints
        near, rejects, moved = end.look, constraints.rejects, constraints.moved
        best: tuple[Places, Look, Statistics] | None = None
        for misses in range(1, TESTS + 1):
            places, near = self._cheapest(near)
            if places is None:
                break
            best = places, near, certifier.test(constraints, near.x)
            if certifier.holds(best[2]) or certifier.hopeless():  # the cheapest on the sample
                break
            constraints.rejects, constraints.moved = certifier.corrected(
                constraints, near, best[2], rejects_at_limits(constraints, near), misses
            )
            self._known.clear()
        constraints.rejects, constraints.moved = rejects, moved
        if best is None:
            places = {
                j: max(0, sum(t <= math.exp(end.look.x[j]) for _, t in ladder) - 1)
                for j, ladder in self.ladders.items()
            }
            near = constraints.look(self._at(places, end.look.x), sloped=False)
            best = places, near, certifier.test(constraints, near.x)
        places, look, seen = best
        seen = certifier.shares(seen)
        held = certifier.holds(seen) and constraints.missed(look) <= 0
        names = {self._decisions.fields[j]: self.ladders[j][place][0] for j, place in places.items()}
        result = search.allocation(look, seen, "OPTIMAL" if held else "NOT_CERTIFIED", found.learned)
        return dataclasses.replace(
            result, grades=names, residual=found.residual, multipliers=found.multipliers, margins=found.margins,
            margin_slopes=found.margin_slopes, value_prices=found.value_prices,
            evaluations=search.evaluations(constraints.count),
        ), look  # fmt: skip

    def _cheapest(self, near: Look) -> tuple[Places | None, Look]:
        """The cheapest set that meets the limits of the sample, and its look; None where none does."""
        best: tuple[Places, Look] | None = None
        tried = set[tuple[int, ...]]()
        for _ in range(_SETS):
            bound = math.inf if best is None else best[1].total
            places = self._proposed(near, tried, bound * (1 - COARSE))
            if places is None:
                break
            key = tuple(places.values())
            tried.add(key)
            if key not in self._known:
                self._known[key] = self._fitted(places, near, COARSE)
            near = self._known[key]
            if near.excess <= MET / 4 and near.total < bound:
                best = places, near
        if best is None:
            return None, near
        places, near = best
        if len(places) == len(self._decisions.fields):
            return best
        finer = self._fitted(places, near, _FINER * self._search.problem.effort.gain)
        return places, finer if finer.excess <= MET / 4 and finer.total < near.total else near

    def _fitted(self, places: Places, near: Look, gain: float) -> Look:
        """Look at a set of grades, with the other half-widths fitted to it.

        Args:
            places: of the graded fields.
            near: a look to begin with.
            gain: promised gain that ends the search, as a part of the cost.
        """
        search, programme = self._search, self._search.programme
        x = self._at(places, near.x)
        free = programme.low, programme.high
        count = len(self._decisions.fields)
        held = np.zeros(len(x), bool)
        held[list(places)] = True
        held[count:] = True
        programme.low, programme.high = np.where(held, x, free[0]), np.where(held, x, free[1])
        look = (
            programme.run(x, AGAIN, most=search.problem.max_steps, gain=gain).look
            if not held.all()
            else search._noted(x)
        )
        programme.low, programme.high = free
        return look

    def _at(self, places: Places, x: np.ndarray) -> np.ndarray:
        found = x.copy()
        for j, place in places.items():
            found[j] = math.log(self.ladders[j][place][1])
        return found

    def _proposed(self, near: Look, tried: set[tuple[int, ...]], most: float) -> Places | None:
        """The cheapest set under the model around a look that was not tried; None where none costs less than most."""
        decisions, count = self._decisions, len(self._decisions.fields)
        columns: list[tuple[int, float]] = []
        for j in range(count):
            own = (
                [t for _, t in self.ladders[j]]
                if j in self.ladders
                else np.exp(np.linspace(decisions.low[j], decisions.high[j], _FINE))
            )
            columns += [(j, math.log(t)) for t in own]
        fields, logs = np.array([j for j, _ in columns]), np.array([x for _, x in columns])
        costs = self._costs(near, fields, logs)
        rows = np.flatnonzero(np.isfinite(near.used) & ~np.isneginf(near.used))
        rows = rows[near.jacobian[rows, :count].any(axis=1)]
        p, (start, rate) = near.powers[rows, None], expansion(near)
        model = rate[rows][:, fields] / p * np.expm1(p * (logs - near.x[fields]))
        one = (fields[None, :] == np.arange(count)[:, None]).astype(float)
        limits = [
            scipy.optimize.LinearConstraint(one, 1, 1),
            scipy.optimize.LinearConstraint(model, -np.inf, 1 - start[rows] + MET / 4),
        ]
        if math.isfinite(most):
            spare = most - (near.total - float(self._costs(near, np.arange(count), near.x[:count]).sum()))
            limits.append(scipy.optimize.LinearConstraint(costs[None], -np.inf, spare))
        for places in tried:
            row = np.zeros(len(fields))
            for j, place in zip(self.ladders, places):
                row[np.flatnonzero(fields == j)[place]] = 1.0
            limits.append(scipy.optimize.LinearConstraint(row[None], -np.inf, len(self.ladders) - 1 + 0.5))
        found: Any = scipy.optimize.milp(costs, constraints=limits, integrality=np.ones(len(fields)), bounds=(0, 1))
        if found.x is None:
            return None
        taken = found.x > 0.5
        return {j: int(np.flatnonzero(taken[fields == j])[0]) for j in self.ladders}

    def _costs(self, near: Look, fields: np.ndarray, logs: np.ndarray) -> np.ndarray:
        """Costs of half-widths of fields, with what they add to the loss under the model."""
        found = np.zeros(len(fields))
        for j, cost in enumerate(self._decisions.priced.values()):
            own = fields == j
            found[own] = [float(cost(math.exp(x))) for x in logs[own]]
        return found + near.loss_slopes[fields] / 2 * np.expm1(2 * (logs - near.x[fields]))


def _ladder(size: Any, cost: Cost) -> list[tuple[str, float]]:
    """Grades within the process range, finest first, with their half-widths."""
    if size is None:
        return []
    steps = [(grade, it_width(grade, size) / 2) for grade in GRADES]
    return [(grade, t) for grade, t in steps if cost.finest <= t * (1 + 1e-9) and t <= cost.coarsest * (1 + 1e-9)]
