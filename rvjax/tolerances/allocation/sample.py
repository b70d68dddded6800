"""Units at which an allocation looks: their values, and derivatives of sums of these to the vector of decisions.

Of costly units, at a neighbouring vector only those near a limit are solved, the others keep their values. A limit on a
share needs the values of the units about a quantile. Units that were far inside the limit at one vector are rarely
beyond it at the next. Some of them, spread over all, are solved too and show whether this is so.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.sizes import AT_ONCE, PULLED, padded
from rvjax.population import Population
from rvjax.response import Part, Response, elements, elements_and_rates, parts
from rvjax.status import succeeded
from rvjax.tolerances.allocation.decisions import KEPT, Decisions
from rvjax.tolerances.allocation.look import DECIDES
from rvjax.tolerances.allocation.tails import FEWEST
from rvjax.tolerances.batch.checkpoint import Memo, describe

Values = dict[str, np.ndarray]
"""Numbers (n,) of units, by name of the response."""


class Units:
    """Values of units and their derivatives; what a memo holds is not computed again."""

    def __init__(self, response: Response, decisions: Decisions, wanted: set[str], memo: Memo | None) -> None:
        self.solved = self._parted = 0
        self._decisions, self._memo, self._wanted = decisions, memo, wanted
        self.renew(response)

    def renew(self, response: Response, near: Population | None = None) -> None:
        """Take another response of the same outputs.

        Args:
            response: of one unit.
            near: population for which it is meant.
        """
        wanted = self._wanted
        self.parts = [p for p in parts(response, self._decisions.base) if wanted & set(p.names)] if wanted else []
        self._near = None if near is None else sorted(describe(near, {}).items())
        self._latest = list[tuple[Population, np.ndarray, frozenset[str], Values]]()
        self._states = list[tuple[Part, Population, dict[bytes, int], np.ndarray]]()

    def values(
        self, population: Population, z: np.ndarray, least: frozenset[str] = frozenset(), few: int = 0
    ) -> Values:
        """Values (n,) by name of the units of a population, nan where one failed.

        Args:
            population: of the units.
            z: (numbers, n) of the units.
            least: responses that may have `few` units: a part with no other one is solved for these alone.
            few: number of these.
        """
        for there, own, reduced, found in self._latest:
            if there is population and own is z and reduced == least:
                return found
        found = {}
        for part in self.parts:
            own = z[:, :few] if few < z.shape[1] and set(part.names) <= least else z
            found |= dict(zip(part.names, self.of_part(part, population, own)))
        found = self.failing_in_all(found)
        self._latest = [*self._latest[1 - KEPT :], (population, z, least, found)]
        return found

    def decisive(self, names: tuple[str, ...], aside: frozenset[str]) -> tuple[str, ...]:
        """The responses but those of parts in which no limit decides; all where none does.

        Args:
            names: of the responses.
            aside: responses whose limits do not decide.
        """
        spared = {name for part in self.parts if set(part.names) <= aside for name in part.names}
        return tuple(name for name in names if name not in spared) or names

    @staticmethod
    def failing_in_all(values: Values) -> Values:
        """The values, nan in every part where a unit failed in one."""
        shortest = min((len(row) for row in values.values()), default=0)
        failed = np.any([np.isnan(row[:shortest]) for row in values.values()], axis=0)
        for row in values.values():
            row[:shortest][failed] = np.nan
        return values

    def of_part(self, part: Part, population: Population, z: np.ndarray) -> np.ndarray:
        """Values (k, n) of a part of the response.

        Args:
            part: one of `parts`.
            population: of the units.
            z: (numbers, n) of the units.
        """
        self._parted += z.shape[1]
        self.solved += self._parted // len(self.parts)
        self._parted %= len(self.parts)

        def compute() -> np.ndarray:
            values, status, state = part.solve(population, z)
            if part.keeps:
                place = {column.tobytes(): k for k, column in enumerate(z.T)}
                self._states = [*self._states[1 - KEPT * len(self.parts) :], (part, population, place, state)]
            return np.where(succeeded(np.asarray(status)), values, np.nan)

        return self._recalled(
            "design", lambda: (part.names, sorted(describe(population, {}).items()), *(self._near or ())), [z], compute
        )

    def _recalled(
        self, kind: str, about: Callable[[], object], arrays: list[np.ndarray], compute: Callable[[], np.ndarray]
    ) -> np.ndarray:
        """The stored array of these inputs, else the computed one."""
        if self._memo is None:
            return compute()
        inputs = repr(about()).encode() + b"".join(array.tobytes() for array in arrays)
        return self._memo.recall({kind: hashlib.sha256(inputs).hexdigest()}, compute).copy()

    def gradients(self, population: Population, z: np.ndarray, errors: np.ndarray, pulled: Values) -> np.ndarray:
        """Gradients (elements and numbers, n) of sums of responses with weights (n,) by name.

        Args:
            population: with the numbers of the design.
            z: (numbers, n) of the units.
            errors: (elements, n) of the units.
            pulled: weights; other parts of the response are not computed.
        """
        total = np.zeros((errors.shape[0] + len(population.values or {}), errors.shape[1]))
        for part in self.parts:
            if not set(part.names) & set(pulled):
                continue
            nothing = np.zeros(errors.shape[1])
            weights = np.stack([pulled.get(name, nothing) for name in part.names])
            units = np.flatnonzero(weights.any(axis=0))
            if not len(units):
                continue
            total[:, units] += self._pulled(part, population, z[:, units], errors[:, units], weights[:, units])
        return total

    def _pulled(
        self, part: Part, population: Population, z: np.ndarray, errors: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Gradients (elements and numbers, n) of a part; units whose state is known are not solved again."""

        def compute() -> np.ndarray:
            if not part.keeps:
                return part.slopes_of_elements(population, errors, np.zeros((0, errors.shape[1])), weights)
            known = [(place, state) for own, there, place, state in self._states if own is part and there is population]
            keys = [column.tobytes() for column in z.T]
            found = {key: state[:, place[key]] for key in keys for place, state in known if key in place}
            missing = {key: k for k, key in enumerate(keys) if key not in found}
            if missing:
                self.solved += len(missing)
                found |= zip(missing, part.of_elements(population, errors[:, list(missing.values())])[2].T)
            return part.slopes_of_elements(population, errors, np.stack([found[key] for key in keys], axis=1), weights)

        about = part.names, sorted((population.values or {}).items())
        return self._recalled("gradients of", lambda: about, [errors, weights], compute)

    def slope(self, x: np.ndarray, z: np.ndarray, pulled: Values) -> np.ndarray:
        """Derivative (n,) of the sum over units of responses with weights (m,), to the vector of decisions."""
        return np.asarray(self.slopes(x, z, pulled).sum(axis=1))

    def slopes(self, x: np.ndarray, z: np.ndarray, pulled: Values) -> np.ndarray:
        """Derivatives (n, m) of responses of units with weights (m,), to the vector of decisions; 0 where one failed.

        Args:
            x: the vector.
            z: (numbers, m) of the units.
            pulled: weights by name of the response.
        """
        decisions, population = self._decisions, self._decisions.population(x)
        errors, rates = elements_and_rates(population, dict(zip(decisions.fields, decisions.half_widths(x))), z)
        slopes, count = self.gradients(population, z, errors, pulled), len(rates)
        slopes = np.where(np.isfinite(slopes).all(axis=0), slopes, 0.0)
        ends = np.cumsum([0, *(math.prod(t.shape) for t in population.active.values())])
        place = dict(zip(population.active, map(slice, ends[:-1], ends[1:])))

        def by_field(rows: np.ndarray, name: str) -> np.ndarray:
            return np.asarray(rows[place[name]].sum(axis=0))

        numbers = dict(zip(sorted(population.values or {}), slopes[count:]))
        own, spans = slopes[:count] * np.where(slopes[:count] == 0, 0.0, rates), decisions.rates()
        found = [t * by_field(own, name) for name, t in zip(decisions.fields, decisions.half_widths(x))]
        found += [span * by_field(slopes[:count], name) for (name, _), span in zip(decisions.moves, spans)]
        found += [span * numbers[name] for name, span in zip(decisions.free, spans[len(decisions.moves) :])]
        return np.reshape(found, (decisions.size, z.shape[1]))

    def slopes_to_z(self, population: Population, z: np.ndarray, pulled: Values) -> np.ndarray:
        """Gradients (numbers, n) of responses of units to their z."""
        lanes = np.asarray(padded(z, PULLED, axis=1), jnp.result_type(float))
        errors = np.asarray(elements(population, lanes), float)[:, : z.shape[1]]
        slopes = self.gradients(population, z, errors, pulled)[: len(errors)]
        return np.asarray(_to_z(population, lanes, padded(slopes, PULLED, axis=1)), float)[:, : z.shape[1]]


@jax.jit
def _to_z(population: Population, z: jax.Array, slopes: jax.Array) -> jax.Array:
    return jax.vjp(lambda z: elements(population, z), z)[1](slopes.astype(z.dtype))[0]


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

    def first(self, count: int) -> "NearUnits":
        """The first so many of the units, with their known values."""
        return NearUnits(self._units, self.z[:, :count], {name: row[:count] for name, row in self._known.items()})

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
