"""Stocks that feed the slots, and the exact assignment of two of them."""

import dataclasses

import numpy as np
from scipy.optimize import linear_sum_assignment

Build = list[tuple[int, ...]]


@dataclasses.dataclass(frozen=True)
class Supply:
    """Slots, and the stocks that feed them.

    Attributes:
        pieces: of each part, by slot; slots of one group share them.
        group: number of the stock that feeds each slot.
        units: to be built.
    """

    pieces: tuple[np.ndarray, ...]
    group: tuple[int, ...]
    units: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Parts of each slot."""
        return tuple(map(len, self.pieces))

    @property
    def shared(self) -> bool:
        """True if one stock feeds two slots."""
        return len(set(self.group)) < len(self.group)

    def slots(self, group: int) -> list[int]:
        """Slots that a stock feeds."""
        return [slot for slot, own in enumerate(self.group) if own == group]

    def weight(self) -> np.ndarray:
        """Frequency of each combination in random assembly, up to a factor: pieces of its parts (parts, ...)."""
        places = np.meshgrid(*map(np.arange, self.shape), indexing="ij", sparse=True)
        found = np.ones(self.shape)
        for slot, pieces in enumerate(self.pieces):
            before = [other for other in self.slots(self.group[slot]) if other < slot]
            left = pieces[places[slot]] - sum((places[slot] == places[other]).astype(int) for other in before)
            found = found * np.maximum(left, 0)
        return found

    def lean(self) -> tuple[list[int], "Supply"]:
        """Slots with a choice of parts, two at least, and the stocks of these."""
        kept = [slot for slot, size in enumerate(self.shape) if size > 1]
        kept = kept if len(kept) >= 2 else list(range(len(self.shape)))
        pieces, group = tuple(self.pieces[k] for k in kept), tuple(self.group[k] for k in kept)
        return kept, Supply(pieces, group, self.units)

    def allowed(self) -> np.ndarray:
        """Combinations that one unit can be: never more of a part than there are pieces."""
        return self.weight() > 0


def copies(pieces: np.ndarray) -> np.ndarray:
    """Each part as often as there are pieces."""
    return np.repeat(np.arange(len(pieces)), pieces)


def assigned(cost: np.ndarray, supply: Supply) -> Build:
    """Two slots, exactly; where both stocks are larger than the units, pieces left over go to dummies at no cost."""
    rows, columns = map(copies, supply.pieces)
    full, units = cost[np.ix_(rows, columns)], supply.units
    spare = len(rows) - units, len(columns) - units
    if min(spare) > 0:
        padded = np.zeros((len(rows) + spare[1], len(columns) + spare[0]))
        padded[: len(rows), : len(columns)] = full
        padded[len(rows) :, len(columns) :] = beyond(np.append(full, 0.0), max(padded.shape))
        full = padded
    chosen = linear_sum_assignment(full)
    return [(int(rows[i]), int(columns[j])) for i, j in zip(*chosen) if i < len(rows) and j < len(columns)]


def beyond(cost: np.ndarray, units: int) -> float:
    """Return the price of a forbidden combination, above all differences between plans."""
    finite = cost[np.isfinite(cost)]
    return float(finite.max() + (units + 1) * (np.ptp(finite) + 1e-9 * np.abs(finite).max() + 1e-300))
