"""The vector of decisions: logarithms of half-widths, mid-points and numbers of the design, with its cost.

Mid-points and numbers are parts of their range, so that their units do not matter. A mid-point whose move costs
something is two entries, one for each way, because its cost has a corner at the given mid-point.

Numbers that may take the values of a list only: all combinations where these are few, exchanges where they are many.
Every combination is a search of its own from the end of the search without lists, on the same units. The neighbours of
that end are always among them, so that the result never costs more than the free one rounded.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

import numpy as np

from rvjax.population import Population, Tolerance
from rvjax.tolerances.allocation.cost import Cost, Costs
from rvjax.tolerances.allocation.variable import Middle, Variable

KEPT = 8
"""Vectors whose units are kept: a step that was not taken, or a scaled one, goes back to an earlier one."""

ROUNDING, AT = 1e-9, 1e-6
"""Differences that are rounding; distance from a bound, in parts of a range, below which a decision is at it."""

STEP = 1e-4
"""Step of differences, part of a range."""

_REACH = 0.3  # of a step in a mid-point or a number, where that of a half-width is 1


class Decisions:
    """The choices of an allocation as a vector."""

    def __init__(
        self,
        population: Population,
        priced: Mapping[str, Cost],
        middles: Mapping[str, Middle],
        variables: Mapping[str, Variable],
    ) -> None:
        self.base, self.priced, self.variables = population, dict(priced), dict(variables)
        self.middles = dict(middles)
        self.given = {name: float(population.active[name].middle) for name in middles}
        self.fields = list(priced)
        self.given_widths = np.array([float(population.active[name].half_width) for name in priced])
        moves = [(n, way) for n, m in middles.items() if m.upper > m.lower for way in ((1, -1) if m.scale else (1,))]
        self.moves = moves
        self.free = [name for name, item in variables.items() if item.free]
        self._low = np.array([float(cost.finest) for cost in priced.values()])
        self._high = np.array([float(cost.coarsest) for cost in priced.values()])
        count = len(moves) + len(self.free)
        self.low = np.concatenate([np.log(self._low), np.zeros(count)])
        self.high = np.concatenate([np.log(self._high), np.ones(count)])
        for k, (name, way) in enumerate(moves, len(self.fields)):
            if self.middles[name].scale:  # away from the given mid-point, or to the nearest that may be
                item, origin = self.middles[name], self._origin(name)
                self.high[k] = ((item.upper - origin) if way > 0 else (origin - item.lower)) / (item.upper - item.lower)
        self.reach = np.concatenate([np.ones(len(self.fields)), np.full(count, _REACH)])
        self._costs = Costs(list(priced.values()))
        self._latest: dict[bytes, Population] = {}

    @property
    def size(self) -> int:
        """Entries of the vector."""
        return len(self.low)

    def _origin(self, name: str) -> float:
        item = self.middles[name]
        return min(max(self.given[name], item.lower), item.upper) if item.scale else item.lower

    def vector(self, half_widths: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """The vector of half-widths (j,), the given mid-points and numbers by name."""
        t = np.clip(half_widths, self._low, self._high)
        moved = []
        for name, _ in self.moves:
            item = self.middles[name]
            there = min(max(self.given[name], item.lower), item.upper)
            moved.append(0.0 if item.scale else (there - item.lower) / (item.upper - item.lower))
        return np.array([*np.log(t), *moved, *(self.part(name, values[name]) for name in self.free)])

    def part(self, name: str, value: float) -> float:
        """A value of a number as a part of its range."""
        item = self.variables[name]
        return (value - item.lower) / (item.upper - item.lower)

    def half_widths(self, x: np.ndarray) -> np.ndarray:
        """Half-widths (j,) of the fields that have a cost."""
        logs, count = x[: len(self.fields)], len(self.fields)
        inner = np.where(logs >= self.high[:count], self._high, np.exp(logs))
        return np.clip(np.where(logs <= self.low[:count], self._low, inner), self._low, self._high)

    def middles_at(self, x: np.ndarray) -> dict[str, float]:
        """Mid-points of the limits that may move."""
        found = {name: self._origin(name) for name in self.middles}
        for k, (name, way) in enumerate(self.moves, len(self.fields)):
            found[name] += way * float(x[k]) * (self.middles[name].upper - self.middles[name].lower)
        return found

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Numbers of the design by name, constant ones too."""
        found = {name: item.among[0] if item.among else item.lower for name, item in self.variables.items()}
        first = len(self.fields) + len(self.moves)
        for name, part in zip(self.free, map(float, x[first:])):
            item = self.variables[name]
            value = item.upper if part >= 1 else item.lower + part * (item.upper - item.lower)
            near = min(item.among, key=lambda listed: abs(listed - value), default=value)
            found[name] = near if abs(near - value) <= ROUNDING * (item.upper - item.lower) else value
        return found

    def rates(self) -> np.ndarray:
        """Range of each mid-point (with the sign of its way) and number, for a part of 1."""
        moved = [way * (self.middles[name].upper - self.middles[name].lower) for name, way in self.moves]
        return np.array([*moved, *(self.variables[n].upper - self.variables[n].lower for n in self.free)])

    def by_number(self, rates: Mapping[str, float]) -> np.ndarray:
        """Derivatives (n,) to the vector from those by number of the design."""
        found = np.zeros(self.size)
        if self.free:
            found[-len(self.free) :] = [rates.get(name, 0.0) for name in self.free]
            found[-len(self.free) :] *= self.rates()[-len(self.free) :]
        return found

    def population(self, x: np.ndarray) -> Population:
        """Units at a vector; the latest ones are kept, and with them their values."""
        key = x.tobytes()
        if key not in self._latest:
            self._latest = dict([*self._latest.items()][1 - KEPT :]) | {key: self._population(x)}
        return self._latest[key]

    def without_errors(self, x: np.ndarray) -> Population:
        """Units with these mid-points and numbers, whose priced errors are next to nothing."""
        there = self.population(x)
        widths = self.half_widths(x)
        return there.with_half_widths({name: ROUNDING * t for name, t in zip(self.fields, map(float, widths))})

    def _population(self, x: np.ndarray) -> Population:
        moved = {n: _moved(self.base.active[n], m - self.given[n]) for n, m in self.middles_at(x).items()}
        widths = dict(zip(self.fields, map(float, self.half_widths(x))))
        active = self.base.active | moved
        changed = moved | {name: active[name].with_half_width(t) for name, t in widths.items()}
        there = self.base.with_tolerances(changed)
        return there.replace(values=self.values(x)) if self.variables else there

    @property
    def start(self) -> np.ndarray:
        """The given tolerances and numbers, within the bounds."""
        return self.vector(self.given_widths, {name: item.first for name, item in self.variables.items()})

    def cost_of(self, half_widths: np.ndarray, x: np.ndarray) -> float:
        """Cost of half-widths (j,), which may leave their range, with the other decisions of a vector."""
        with np.errstate(divide="ignore"):
            given, own = (float(self._costs.at(logs)[0].sum()) for logs in (np.log(half_widths), x[: len(self.fields)]))
        return self.cost(x)[0] + given - own

    def costs(self, x: np.ndarray) -> dict[str, float]:
        """Cost of each half-width."""
        return dict(zip(self.fields, map(float, self._costs.at(np.log(self.half_widths(x)))[0])))

    def cost(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost of half-widths, moved mid-points and numbers of the design, its first and second derivatives (n,)."""
        slopes, bends, count = np.zeros(self.size), np.zeros(self.size), len(self.fields)
        each, slopes[:count], bends[:count] = self._costs.at(x[:count])
        total = float(each.sum())
        for k, (name, _) in enumerate(self.moves, count):
            span = self.middles[name].upper - self.middles[name].lower
            slopes[k] = self.middles[name].scale * span
        total += sum(m.scale * abs(self.middles_at(x)[name] - self.given[name]) for name, m in self.middles.items())
        for k, name in enumerate(self.free, count + len(self.moves)):
            item, part = self.variables[name], min(max(float(x[k]), 0.0), 1.0)
            if item.cost is not None:
                at = min(max(part, STEP), 1 - STEP)
                before, here, after = (
                    item.own_cost(item.lower + p * (item.upper - item.lower)) for p in (at - STEP, at, at + STEP)
                )
                bends[k] = (after - 2 * here + before) / STEP**2
                slopes[k] = (after - before) / (2 * STEP) + bends[k] * (part - at)
        own_costs = sum(self.variables[name].own_cost(value) for name, value in self.values(x).items())
        return total + own_costs, slopes, bends


def _moved(tolerance: Tolerance, by: float) -> Tolerance:
    """Limits moved by a distance."""
    return tolerance.replace(lower=tolerance.lower + by, upper=tolerance.upper + by)


_ALL = 32  # combinations that are all tried, or neighbours where there are more

Places = tuple[int, ...]
E = TypeVar("E")  # end of a search


class Lists:
    """The numbers with a list, and their places on it."""

    def __init__(self, decisions: Decisions) -> None:
        first = len(decisions.fields) + len(decisions.moves)
        self.entries = {
            first + k: np.array([decisions.part(name, value) for value in decisions.variables[name].among])
            for k, name in enumerate(decisions.free)
            if decisions.variables[name].among
        }

    def relaxed(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n,) between the ends of the lists."""
        low, high = low.copy(), high.copy()
        for k, parts in self.entries.items():
            low[k], high[k] = parts[0], parts[-1]
        return low, high

    def fixed(self, places: Places, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n,) that hold the numbers at places of their lists."""
        low, high = low.copy(), high.copy()
        for (k, parts), place in zip(self.entries.items(), places):
            low[k] = high[k] = parts[place]
        return low, high

    def first(self, x: np.ndarray) -> list[Places]:
        """All combinations, or those next to a vector."""
        sizes = [len(parts) for parts in self.entries.values()]
        if math.prod(sizes) <= _ALL:
            return list(itertools.product(*map(range, sizes)))
        near = []
        for k, parts in self.entries.items():
            above = min(int(np.searchsorted(parts, x[k])), len(parts) - 1)
            near.append(sorted({max(above - 1, 0), above}, key=lambda i: abs(parts[i] - x[k])))
        return list(itertools.islice(itertools.product(*near), _ALL))

    def exchanges(self, places: Places) -> Iterator[Places]:
        """Combinations with one or two numbers one place on."""
        sizes = [len(parts) for parts in self.entries.values()]
        for count in (1, 2):
            for which in itertools.combinations(range(len(sizes)), count):
                for ways in itertools.product((-1, 1), repeat=count):
                    moved = list(places)
                    for i, way in zip(which, ways):
                        moved[i] += way
                    if all(0 <= place < size for place, size in zip(moved, sizes)):
                        yield tuple(moved)

    def cheapest(self, x: np.ndarray, solve: Callable[[Places], E], worth: Callable[[E], tuple[bool, float]]) -> Places:
        """The best combination; `worth` puts ends in order."""
        ends: dict[Places, tuple[bool, float]] = {}

        def tried(places: Places) -> tuple[bool, float]:
            if places not in ends:
                ends[places] = worth(solve(places))
            return ends[places]

        best = min(self.first(x), key=tried)
        better: Places | None = best
        while better is not None:
            better = next((p for p in self.exchanges(best) if p not in ends and tried(p) < ends[best]), None)
            best = better or best
        return best
