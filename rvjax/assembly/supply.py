"""Stocks that feed the slots: units that they allow, exact assignment of two, plans of more of them and their bound.

Of many slots one after the other is assigned exactly; a Lagrangian bounds what any plan can reach.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from rvjax.assembly.belief import Known
from rvjax.base.progress import detail

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

    def stock(self, group: int) -> np.ndarray:
        """Pieces of each part in a stock."""
        return self.pieces[self.group.index(group)]

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


ROUNDS = 150  # of the Lagrangian

Price = Callable[[tuple[np.ndarray, ...]], np.ndarray]
"""Places of the parts of each slot, broadcast against each other -> finite costs of these combinations."""

_UNSEARCHED: ContextVar[list[int] | None] = ContextVar("unsearched", default=None)


@contextlib.contextmanager
def best_so_far(wanted: bool) -> Iterator[list[int]]:
    """End an interrupted search with its best plan; yields the counts of random plans that were left.

    Args:
        wanted: False lets it pass as always.
    """
    left: list[int] = []
    token = _UNSEARCHED.set(left if wanted else None)
    try:
        yield left
    finally:
        _UNSEARCHED.reset(token)


@contextlib.contextmanager
def keeps_best() -> Iterator[None]:
    """End the search at an interruption if `best_so_far` requires its best plan."""
    try:
        yield
    except KeyboardInterrupt:
        left = _UNSEARCHED.get()
        if left is None:
            raise
        left.append(1)


def stopped() -> bool:
    """Return whether the search was interrupted."""
    return bool(_UNSEARCHED.get())


def alternate(cost: np.ndarray, supply: Supply, starts: int, rng: np.random.Generator) -> Build:
    """Assign one slot after the other exactly, the others fixed, until none improves; the best of several starts."""
    big = beyond(cost, supply.units)
    priced = np.where(np.isfinite(cost), cost, big)
    return alternated_by(priced.__getitem__, supply, starts, rng)


def alternated_by(
    price: Price, supply: Supply, starts: int, rng: np.random.Generator, begin: Build | None = None
) -> Build:
    """`alternate`, by a function of the combinations.

    Args:
        price: of combinations.
        supply: stocks.
        starts: random plans to begin with.
        rng: of these.
        begin: a plan that replaces the first of them.
    """
    best, least = None, np.inf
    for number in range(starts):
        places = random_plan(supply, rng) if begin is None or number else np.array(begin).T.copy()
        left = _UNSEARCHED.get()
        try:
            total = _improved(price, supply, places)
        except KeyboardInterrupt:  # `places` is a complete plan after every step
            if left is None:
                raise
            left.append(starts - number)
            total = price(tuple(places)).sum()
        if total < least:
            least, best = total, places.copy()
        if left:
            break
        detail(f"plan {number + 1} of {starts}")
    assert best is not None  # `starts` is at least 1 and every price is finite
    return [tuple(map(int, unit)) for unit in best.T]


def _improved(price: Price, supply: Supply, places: np.ndarray) -> float:
    """Sum of prices after all slots but one are fixed, that one assigned exactly, in turn; changes `places`."""
    total, waiting = price(tuple(places)).sum(), len(places)
    for slot in itertools.cycle(range(len(places))):
        left = supply.pieces[slot].copy()
        for other in supply.slots(supply.group[slot]):
            if other != slot:
                np.subtract.at(left, places[other], 1)
        pool = copies(left)
        at = tuple(row[:, None] if k != slot else pool[None] for k, row in enumerate(places))
        places[slot] = pool[linear_sum_assignment(price(at))[1]]
        now = price(tuple(places)).sum()
        waiting, total = (len(places) - 1, now) if now < total - 1e-15 * abs(total) else (waiting - 1, now)
        if waiting <= 0:
            break
    return _exchanged(price, supply, places) if supply.shared else float(total)


def random_plan(supply: Supply, rng: np.random.Generator) -> np.ndarray:
    """Parts of each slot (slots, units), taken by chance.

    Args:
        supply: stocks.
        rng: of the choice.
    """
    places = np.empty((len(supply.shape), supply.units), int)
    for group in set(supply.group):
        slots = supply.slots(group)
        pool = rng.permutation(copies(supply.stock(group)))
        for number, slot in enumerate(slots):
            places[slot] = pool[number * supply.units : (number + 1) * supply.units]
    return places


def _exchanged(price: Price, supply: Supply, places: np.ndarray) -> float:
    """Sum after exchanges of parts of one stock between slots of any two units; changes `places`."""
    units = supply.units
    improved = True
    while improved:
        improved = False
        for group in set(supply.group):
            for first, second in itertools.combinations(supply.slots(group), 2):
                for i in range(units):  # the part in `first` of unit i against that in `second` of each unit
                    mine, theirs = places.copy(), places[:, [i]].repeat(units, axis=1)
                    mine[second] = places[first, i]
                    theirs[first] = places[second]
                    theirs[second, i] = places[first, i]
                    now, changed, other = (price(tuple(x)) for x in (places, mine, theirs))
                    gain = now + now[i] - changed - other
                    gain[i] = now[i] - other[i]
                    j = int(gain.argmax())
                    if gain[j] > 1e-12 * abs(now).max():
                        places[[first, second], [i, j]] = places[[second, first], [j, i]]
                        improved = True
    return float(price(tuple(places)).sum())


def lagrangian(cost: np.ndarray, supply: Supply, upper: float) -> float:
    """Lower bound of the sum of any plan: all stocks but those of two slots are priced, these two are assigned exactly.

    Held, 1981: subgradient steps of Polyak's length towards the sum of the plan found.
    """
    pairs = list(itertools.combinations(range(len(supply.shape)), 2))
    started = sorted(pairs, key=lambda pair: -next(_bounds(cost, supply, pair, upper)))
    return max(max(itertools.islice(_bounds(cost, supply, pair, upper), ROUNDS)) for pair in started[:3])


def _bounds(cost: np.ndarray, supply: Supply, pair: tuple[int, int], upper: float) -> Iterator[float]:
    """Bounds from one pair of slots, round by round."""
    kept = {supply.group[slot] for slot in pair if len(supply.slots(supply.group[slot])) == 1}
    priced = [group for group in sorted(set(supply.group)) if group not in kept]
    prices = {group: np.zeros(len(supply.stock(group))) for group in priced}
    spare = {group: supply.stock(group).sum() - supply.units * len(supply.slots(group)) for group in priced}
    others = tuple(slot for slot in range(len(supply.shape)) if slot not in pair)
    allowed, best, pace = supply.allowed(), -np.inf, 1.0
    reduced_cost = np.where(allowed, cost, np.inf)
    while True:
        total = reduced_cost.copy()
        for group in priced:
            for slot in supply.slots(group):
                total += prices[group].reshape([-1 if k == slot else 1 for k in range(total.ndim)])
        flat = np.moveaxis(total, (*pair, *others), range(total.ndim)).reshape(*(total.shape[k] for k in pair), -1)
        least = flat.min(axis=2)
        big = beyond(least, supply.units)
        two = Supply((supply.pieces[pair[0]], supply.pieces[pair[1]]), (0, 1), supply.units)
        chosen = np.array(assigned(np.where(np.isfinite(least), least, big), two))
        bound = least[chosen[:, 0], chosen[:, 1]].sum()
        used = {group: np.zeros(len(price)) for group, price in prices.items()}
        best_rest = flat.argmin(axis=2)[chosen[:, 0], chosen[:, 1]]
        rest = np.unravel_index(best_rest, [total.shape[k] for k in others]) if others else ()
        for group in priced:
            for slot in supply.slots(group):
                places = chosen[:, pair.index(slot)] if slot in pair else rest[others.index(slot)]
                np.add.at(used[group], places, 1)
        over = {}
        for group, price in prices.items():
            pieces = supply.stock(group)
            bound -= price @ pieces
            over[group] = used[group] - pieces
            if spare[group]:  # some may be left over: no price below 0
                over[group] = np.where((price <= 0) & (over[group] < 0), 0.0, over[group])
        pace *= 0.97
        if np.isfinite(bound):
            best = max(best, bound)
        yield best
        norm = sum(float(one @ one) for one in over.values())
        if norm == 0 or not np.isfinite(bound):
            while True:
                yield best
        step = pace * max(upper - bound, 1e-12 * abs(upper)) / norm
        for group, price in prices.items():
            moved = price + step * over[group]
            prices[group] = np.maximum(moved, 0.0) if spare[group] else moved
