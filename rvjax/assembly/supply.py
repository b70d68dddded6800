"""Stocks that feed the slots: the errors of their parts, the units that they allow, the exact assignment of two."""

import dataclasses
import zlib
from collections.abc import Hashable, Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from rvjax.assembly.parts import Known

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
        weight = np.ones(self.shape)
        for slot, pieces in enumerate(self.pieces):
            before = [other for other in self.slots(self.group[slot]) if other < slot]
            left = pieces[places[slot]] - sum((places[slot] == places[other]).astype(int) for other in before)
            weight = weight * np.maximum(left, 0)
        return weight

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


def supply_of(slots: Mapping[str, Known]) -> Supply:
    """Stocks of the slots, and the units that they allow.

    Raises:
        ValueError: not even one unit.
    """
    kinds = list(dict.fromkeys(id(one) for one in slots.values()))
    group = tuple(kinds.index(id(one)) for one in slots.values())
    pieces = tuple(one.pieces for one in slots.values())
    units = min(int(own.sum()) // group.count(number) for own, number in zip(pieces, group))
    if units < 1:
        raise ValueError("kinds: must have parts for one unit")
    return Supply(pieces, group, units)


def draw(
    slots: Mapping[str, Known], seed: int, purpose: int, draws: int, *, alike: bool
) -> dict[str, list[np.ndarray]]:
    """Errors of all parts by slot; the draws of a slot depend on its name, not on its place.

    Args:
        slots: what is known of the parts.
        seed: of the study.
        purpose: 0 to choose, 1 to value; draws for one never serve the other.
        draws: their count.
        alike: common to all parts of a slot.
    """
    errors: dict[str, list[np.ndarray]] = {}
    by_stock: dict[int, str] = {}
    for slot, one in slots.items():
        if not alike and id(one) in by_stock:
            errors[slot] = errors[by_stock[id(one)]]  # the same piece in any slot
            continue
        by_stock.setdefault(id(one), slot)
        rng = np.random.default_rng([seed % 2**64, purpose, zlib.crc32(slot.encode())])
        errors[slot] = one.drawn(rng, draws, alike=alike)
    return errors


def as_they_lie(slots: Mapping[str, Known], supply: Supply) -> Build:
    """Combine the first pieces of every stock; the first pieces of a shared stock go into the first slot."""
    rows: list[np.ndarray] = [np.empty(0)] * len(slots)
    for group in set(supply.group):
        own = supply.slots(group)
        one = list(slots.values())[own[0]]
        place = np.argsort(one.order)  # of each part as given
        pool = np.repeat(place, one.kind.pieces)
        for number, slot in enumerate(own):
            rows[slot] = pool[number : supply.units * len(own) : len(own)]
    return [tuple(map(int, unit)) for unit in zip(*rows)]


def in_order(build: Build, slots: Mapping[str, Known]) -> Build:
    """Units in the order in which the parts of the first slot lie there, then those of the second."""
    orders = [one.order for one in slots.values()]
    return sorted(build, key=lambda unit: tuple(int(order[place]) for order, place in zip(orders, unit)))


def left_over(slots: Mapping[str, Known], supply: Supply, place: np.ndarray) -> dict[str, tuple[Hashable, ...]]:
    """Ids of unused pieces in the order given, each as often as there are pieces."""
    ids = {}
    for number, (slot, one) in enumerate(slots.items()):
        left = one.pieces.copy()
        for other in supply.slots(supply.group[number]):
            np.subtract.at(left, place[:, other], 1)
        in_order = np.argsort(one.order)
        ids[slot] = tuple(one.id_of(k) for k in in_order for _ in range(left[k]))
    return ids
