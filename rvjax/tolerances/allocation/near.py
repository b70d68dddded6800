"""Costly units near their limits: at a neighbouring vector only these are solved, the others keep their values.

A limit on a share needs the values of the units about a quantile. Units that were far inside the limit at one vector
are rarely beyond it at the next. Some of them, spread over all, are solved too and show whether this is so.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from rvjax._jax.sizes import AT_ONCE
from rvjax.population import Population
from rvjax.response import Part
from rvjax.tolerances.allocation.decisions import KEPT
from rvjax.tolerances.allocation.look import DECIDES
from rvjax.tolerances.allocation.sample import Units, Values
from rvjax.tolerances.allocation.tails import FEWEST

_FIRST = 8.0  # times the rejects: units that are solved at first
_SPREAD = 32  # units at least that are spread over all others
_WINDOW = 4.0  # times the rejects: units that a quantile may be formed of
_CLOSER = 0.5  # part of the way to the quantile that a solved unit like the others may have made
_INSIDE = 1 - DECIDES  # part of the way inside a limit, of a quantile that does not decide; of units twice as much


class Limited(NamedTuple):
    """A limit on a share: its responses, margins of units with these values in ways of the limit, and the share."""

    names: tuple[str, ...]
    margins: Callable[[Values], np.ndarray]
    share: float


class NearUnits:
    """One sample: values of all its units at one vector, and at others of those that are near a limit."""

    def __init__(self, units: Units, z: np.ndarray, known: Values) -> None:
        self.z, self._units, self._known = z, units, known
        self._latest: list[tuple[Population, list[float], Values]] = []

    def values(self, population: Population, limits: Sequence[Limited]) -> Values:
        """Values (n,) by name at another vector; of units far inside every limit those of the last known one.

        Args:
            population: at the vector.
            limits: that decide which units are near.
        """
        shares = [limit.share for limit in limits]
        for there, theirs, found in self._latest:
            if there is population and all(one <= _FIRST / _WINDOW * other for one, other in zip(shares, theirs)):
                return found
        found = {name: row.copy() for name, row in self._known.items()}
        solved = [self._solve(part, population, limits, found) for part in self._units.parts]
        found = self._units.failing_in_all(found)
        if all(solved):
            self._known = found
        self._latest = [*self._latest[1 - KEPT :], (population, shares, found)]
        return found

    def _solve(self, part: Part, population: Population, limits: Sequence[Limited], found: Values) -> bool:
        """Solve the units of a part that are near, the nearest first; True if these are all."""
        rows = {name: k for k, name in enumerate(part.names) if name in found}
        if not rows:
            return True
        count = len(found[next(iter(rows))])
        own = [limit for limit in limits if set(limit.names) & set(part.names)]
        before = [limit.margins(found) for limit in own]
        place = np.full(count, np.inf)
        for limit, margins in zip(own, before):
            rank = np.empty(count)
            rank[np.argsort(-margins, kind="stable")] = np.arange(count)
            last = count if _margin(margins, limit.share * count) < -2 * _INSIDE else 0  # the limit does not decide
            place = np.minimum(place, rank / (limit.share * count) + np.where(margins > -2 * _INSIDE, 0, last))
        order, nearest = np.argsort(place, kind="stable"), int((place < _FIRST).sum())
        size = AT_ONCE * -(-(nearest + _SPREAD) // AT_ONCE)  # a call that is not full takes as long
        spread = order[np.linspace(nearest, count - 1, size - nearest, dtype=int)] if 2 * size <= count else order
        todo, solved = np.union1d(order[:nearest], spread), np.zeros(count, bool)
        while len(todo):
            values = self._units.of_part(part, population, self.z[:, todo])
            solved[todo] = True
            for name, k in rows.items():
                found[name][todo] = values[k]
            if all(_enough(limit, was, found, solved) for limit, was in zip(own, before)):
                break
            more = max(int(solved.sum()) // 2 // AT_ONCE, 1) * AT_ONCE
            todo = order[~solved[order]][:more]
        return bool(solved.all())


def _enough(limit: Limited, before: np.ndarray, found: Values, solved: np.ndarray) -> bool:
    """True if no other unit can be among those that the quantile is formed of."""
    if solved.all():
        return True
    now, rejects, others = limit.margins(found), limit.share * len(before), float(before[~solved].max())
    far, close = before <= others, now > -_INSIDE
    if close[~far].sum() + close[far & solved].mean() * far.sum() <= rejects:  # the limit does not decide
        return others < -_INSIDE
    level = _margin(now, _WINDOW * rejects + FEWEST)
    if others >= level:
        return False
    like = solved & (before <= max(others, float(np.median(before[solved])))) & np.isfinite(before)
    with np.errstate(invalid="ignore"):  # where too many units fail
        way = (now[like] - before[like]) / np.maximum(level - before[like], 1e-300)
    return bool(way.max(initial=0.0) <= _CLOSER)


def _margin(margins: np.ndarray, beyond: float) -> float:
    """The margin that so many others exceed."""
    place = max(len(margins) - 1 - int(beyond), 0)
    return float(np.partition(margins, place)[place])
