"""Numbers that may take the values of a list only: all combinations where these are few, exchanges where they are many.

Every combination is a search of its own from the end of the search without lists, on the same units. The neighbours of
that end are always among them, so that the result never costs more than the free one rounded.
"""

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np

from rvjax.tolerances.allocation.decisions import Decisions
from rvjax.tolerances.allocation.programme import End

_ALL = 32  # combinations that are all tried, or neighbours where there are more

Places = tuple[int, ...]


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

    def cheapest(
        self, x: np.ndarray, solve: Callable[[Places], End], worth: Callable[[End], tuple[bool, float]]
    ) -> Places:
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
