"""Which combinations to build: exact assignments, HiGHS for small ones, alternation with a Lagrangian bound beyond.

A cost comes in layers, the first counts most: failing units, then units outside the limits, then the response.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

EXACT = 20_000
"""Combinations up to which HiGHS proves its plan."""

CLOSE = 1e-6
"""Gap below which a plan counts as optimal."""

PATIENCE = 120.0
"""Seconds after which HiGHS leaves a plan to the alternation and its bound."""

SCALE = 1e6  # of the largest cost in HiGHS, whose gap is absolute: 1e-6
ROUNDS = 150  # of the Lagrangian

Build = list[tuple[int, ...]]


class _TooLong(Exception):
    """HiGHS has found no proof in time."""


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
        """Two slots are fed by one stock."""
        return len(set(self.group)) < len(self.group)

    def slots(self, group: int) -> list[int]:
        """Fed by a stock."""
        return [slot for slot, own in enumerate(self.group) if own == group]

    def weight(self) -> np.ndarray:
        """How often random assembly takes each combination, but for a factor: pieces of its parts (parts, ...)."""
        places = np.meshgrid(*map(np.arange, self.shape), indexing="ij", sparse=True)
        found = np.ones(self.shape)
        for slot, pieces in enumerate(self.pieces):
            before = [other for other in self.slots(self.group[slot]) if other < slot]
            left = pieces[places[slot]] - sum((places[slot] == places[other]).astype(int) for other in before)
            found = found * np.maximum(left, 0)
        return found

    def allowed(self) -> np.ndarray:
        """Combinations that one unit can be: never more of a part than there are pieces."""
        return self.weight() > 0


@dataclasses.dataclass(frozen=True)
class Choice:
    """What to build.

    Attributes:
        build: parts of each unit.
        bound: no plan has a lower sum of the layer asked for (a lower largest cost).
        exact: it is proved that no plan is better.
    """

    build: Build
    bound: float
    exact: bool


def least_sum(
    layers: Sequence[np.ndarray], supply: Supply, starts: int, rng: np.random.Generator, *, asked: int = -1
) -> Choice:
    """The plan with the least sums, layer by layer.

    Args:
        layers: finite costs of every combination, the first counts most.
        supply: stocks.
        starts: of the alternation.
        rng: of its random plans.
        asked: layer whose bound is asked for.
    """
    cost = weighed(layers, supply.units)
    if len(supply.shape) == 2 and not supply.shared:
        build = _assigned(cost, supply)
        return Choice(build, _sum(layers[asked], build), True)
    allowed = supply.allowed()
    with contextlib.suppress(_TooLong):
        if (found := _proved(layers, supply, allowed)) is not None:
            return Choice(found, _sum(layers[asked], found), True)
    build = _alternated(np.where(allowed, cost, np.inf), supply, starts, rng)
    reached = _sum(layers[asked], build)
    bound = _lagrangian(layers[asked], supply, reached)
    return Choice(build, bound, reached - bound <= CLOSE * abs(reached))


def least_largest(cost: np.ndarray, supply: Supply, starts: int, rng: np.random.Generator) -> Choice:
    """The plan whose largest cost is least, and among these the one with the least sum.

    Args:
        cost: finite, of every combination.
        supply: stocks.
        starts: of the alternation.
        rng: of its random plans.
    """
    levels = np.unique(cost)
    if len(supply.shape) == 2 and not supply.shared:
        level = _least_level(cost, supply, levels)
        return Choice(_assigned(weighed([cost > level, cost], supply.units), supply), float(level), True)
    allowed = supply.allowed()
    floor = _pair_level(np.where(allowed, cost, np.inf), supply)
    with contextlib.suppress(_TooLong):
        if (best := _least_proved(cost, supply, allowed, levels, floor)) is not None:
            return Choice(best, max(float(cost[unit]) for unit in best), True)
    # Each step forbids what is as bad as the worst unit so far.
    build = _alternated(np.where(allowed, cost, np.inf), supply, starts, rng)
    while True:
        worst = max(cost[unit] for unit in build)
        trial = _alternated(
            np.where(allowed, weighed([cost >= worst, cost], supply.units), np.inf), supply, starts, rng
        )
        if max(cost[unit] for unit in trial) >= worst:
            return Choice(build, float(floor), worst - floor <= CLOSE * abs(worst))
        build = trial


def _least_proved(
    cost: np.ndarray, supply: Supply, allowed: np.ndarray, levels: np.ndarray, floor: float
) -> Build | None:
    """By bisection over the levels of cost, each step a program; None where it is too large to prove."""
    best = _proved([cost], supply, allowed)
    if best is None:
        return None
    low, high = int(np.searchsorted(levels, floor)), int(np.searchsorted(levels, max(cost[unit] for unit in best)))
    while low < high:
        middle = (low + high) // 2
        found = _proved([cost], supply, allowed & (cost <= levels[middle]))
        low, high, best = (low, middle, found) if found is not None else (middle + 1, high, best)
    return (
        best
        if max(cost[unit] for unit in best) <= levels[high]
        else _proved([cost], supply, allowed & (cost <= levels[high]))
    )


def weighed(layers: Sequence[np.ndarray], units: int) -> np.ndarray:
    """One cost whose sums order like the sums of the layers, one after the other; the last layer alone is as it is.

    Args:
        layers: the first counts most; all but the last are whole multiples of the least step between their values.
        units: summed.
    """
    layers = [np.asarray(layer, float) for layer in layers]
    layers = [layer for layer in layers[:-1] if np.ptp(layer)] + [layers[-1]]
    cost = layers[-1]
    for layer in layers[-2::-1]:
        values = np.unique(layer)
        span = np.ptp(cost)
        cost = (cost - cost.min()) / (span if span else 1.0)
        cost = (layer - values[0]) / np.diff(values).min() * (units + 1) + cost
    return cost


def _sum(cost: np.ndarray, build: Build) -> float:
    return float(sum(cost[unit] for unit in build))


def _copies(pieces: np.ndarray) -> np.ndarray:
    """Each part as often as there are pieces."""
    return np.repeat(np.arange(len(pieces)), pieces)


def _assigned(cost: np.ndarray, supply: Supply) -> Build:
    """Two slots, exactly; where both stocks are larger than the units, pieces left over go to stand-ins at no cost."""
    rows, columns = map(_copies, supply.pieces)
    full, units = cost[np.ix_(rows, columns)], supply.units
    spare = len(rows) - units, len(columns) - units
    if min(spare) > 0:
        padded = np.zeros((len(rows) + spare[1], len(columns) + spare[0]))
        padded[: len(rows), : len(columns)] = full
        padded[len(rows) :, len(columns) :] = _beyond(np.append(full, 0.0), max(padded.shape))
        full = padded
    chosen = linear_sum_assignment(full)
    return [(int(rows[i]), int(columns[j])) for i, j in zip(*chosen) if i < len(rows) and j < len(columns)]


def _least_level(cost: np.ndarray, supply: Supply, levels: np.ndarray) -> float:
    """The least cost below which a plan exists."""
    rows, columns = map(_copies, supply.pieces)
    full = cost[np.ix_(rows, columns)]
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high) // 2
        matched = maximum_bipartite_matching(csr_array(full <= levels[middle]), perm_type="column")
        low, high = (low, middle) if (matched >= 0).sum() >= supply.units else (middle + 1, high)
    return levels[high]


def _pair_level(cost: np.ndarray, supply: Supply) -> float:
    """No plan has a lower largest cost: each pair of slots on its own, the others as they suit."""
    floors = []
    for first, second in itertools.combinations(range(len(supply.shape)), 2):
        others = tuple(k for k in range(len(supply.shape)) if k not in (first, second))
        least = cost.min(axis=others)
        pair = Supply((supply.pieces[first], supply.pieces[second]), (0, 1), supply.units)
        finite = np.unique(least[np.isfinite(least)])
        floors.append(_least_level(least, pair, finite))
    return max(floors)


def _columns(supply: Supply, allowed: np.ndarray) -> int:
    """Unknowns of the exact program: slots of one stock are taken in one order."""
    return int(allowed.sum()) // (2 if supply.shared else 1)


def _proved(layers: Sequence[np.ndarray], supply: Supply, allowed: np.ndarray) -> Build | None:
    """The best plan by HiGHS; None where there is none, or it is too large to prove.

    Raises:
        _TooLong: it took more than `PATIENCE`.
    """
    if _columns(supply, allowed) > EXACT:
        return None
    combos = np.argwhere(allowed)
    one_cost = weighed(layers, supply.units)
    if supply.shared:  # of the orders of a pair only the better one
        ordered = combos.copy()
        for group in set(supply.group):
            slots = supply.slots(group)
            ordered[:, slots] = np.sort(combos[:, slots], axis=1)
        rank = np.argsort(one_cost[tuple(combos.T)], kind="stable")
        _, first = np.unique(ordered[rank], axis=0, return_index=True)
        combos = combos[rank[first]]
    if not len(combos):
        return None
    used, caps = [], []
    for group in sorted(set(supply.group)):
        slots = supply.slots(group)
        pieces = supply.pieces[slots[0]]
        count = len(combos)
        rows = np.concatenate([combos[:, slot] for slot in slots])
        columns = np.tile(np.arange(count), len(slots))
        used.append(csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(pieces), count)))
        caps.append(pieces)
    limits = [LinearConstraint(matrix, ub=pieces) for matrix, pieces in zip(used, caps)]
    limits.append(LinearConstraint(np.ones((1, len(combos))), lb=supply.units, ub=supply.units))
    most = np.min([supply.pieces[slot][combos[:, slot]] for slot in range(combos.shape[1])], axis=0)
    counts = None
    for number, layer in enumerate(layers):
        cost = np.asarray(layer, float)[tuple(combos.T)]
        span = np.ptp(cost)
        if number < len(layers) - 1 and not span:
            continue
        scaled = (cost - cost.min()) / (span if span else 1.0)
        found = milp(
            SCALE * scaled,
            constraints=limits,
            integrality=np.ones(len(combos)),
            bounds=Bounds(0, most),
            options={"mip_rel_gap": 0.0, "time_limit": PATIENCE},
        )
        if found.status == 2:
            return None
        if found.status != 0:
            raise _TooLong
        counts = np.round(found.x).astype(int)
        steps = np.diff(np.unique(scaled)).min(initial=1.0)
        limits.append(LinearConstraint(scaled[None], ub=float(scaled @ counts) + 0.25 * steps))
    if counts is None:
        return None
    return [tuple(map(int, combos[k])) for k in np.flatnonzero(counts) for _ in range(counts[k])]


def _alternated(cost: np.ndarray, supply: Supply, starts: int, rng: np.random.Generator) -> Build:
    """All slots fixed but one, that one assigned exactly, in turn, until none improves; the best of several starts."""
    best, least = None, np.inf
    big = _beyond(cost, supply.units)
    priced = np.where(np.isfinite(cost), cost, big)
    for _ in range(starts):
        places = _random_plan(supply, rng)
        total, waiting = priced[tuple(places)].sum(), len(places)
        for slot in itertools.cycle(range(len(places))):
            left = supply.pieces[slot].copy()
            for other in supply.slots(supply.group[slot]):
                if other != slot:
                    np.subtract.at(left, places[other], 1)
            pool = _copies(left)
            at = tuple(row[:, None] if k != slot else pool[None] for k, row in enumerate(places))
            places[slot] = pool[linear_sum_assignment(priced[at])[1]]
            now = priced[tuple(places)].sum()
            waiting, total = (len(places) - 1, now) if now < total - 1e-15 * abs(total) else (waiting - 1, now)
            if waiting <= 0:
                break
        if supply.shared:
            places, total = _exchanged(priced, supply, places)
        if total < least:
            least, best = total, places.copy()
    assert best is not None  # `starts` is at least 1 and every price is finite
    return [tuple(map(int, unit)) for unit in best.T]


def _beyond(cost: np.ndarray, units: int) -> float:
    """A price that no plan pays if it need not."""
    finite = cost[np.isfinite(cost)]
    return float(finite.max() + (units + 1) * (np.ptp(finite) + 1e-9 * np.abs(finite).max() + 1e-300))


def _random_plan(supply: Supply, rng: np.random.Generator) -> np.ndarray:
    """Parts of each slot (slots, units)."""
    places = np.empty((len(supply.shape), supply.units), int)
    for group in set(supply.group):
        slots = supply.slots(group)
        pool = rng.permutation(_copies(supply.pieces[slots[0]]))
        for number, slot in enumerate(slots):
            places[slot] = pool[number * supply.units : (number + 1) * supply.units]
    return places


def _exchanged(cost: np.ndarray, supply: Supply, places: np.ndarray) -> tuple[np.ndarray, float]:
    """Exchange parts of one stock between slots of any two units while that lowers the sum."""
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
                    gain = cost[tuple(places)] + cost[tuple(places[:, i])] - cost[tuple(mine)] - cost[tuple(theirs)]
                    gain[i] = cost[tuple(places[:, i])] - cost[tuple(theirs[:, i])]
                    j = int(gain.argmax())
                    if gain[j] > 1e-12 * abs(cost[tuple(places)]).max():
                        places[first, i], places[second, j] = places[second, j], places[first, i]
                        improved = True
    return places, float(cost[tuple(places)].sum())


def _lagrangian(cost: np.ndarray, supply: Supply, upper: float) -> float:
    """No plan has a lower sum: all stocks but those of two slots are priced, these two assigned exactly.

    Held, 1981: subgradient steps of Polyak's length towards the sum of the plan found.
    """
    pairs = list(itertools.combinations(range(len(supply.shape)), 2))
    started = sorted(pairs, key=lambda pair: -next(_bounds(cost, supply, pair, upper)))
    return max(max(itertools.islice(_bounds(cost, supply, pair, upper), ROUNDS)) for pair in started[:3])


def _bounds(cost: np.ndarray, supply: Supply, pair: tuple[int, int], upper: float) -> Iterator[float]:
    """Bounds from one pair of slots, round by round."""
    kept = {supply.group[slot] for slot in pair if len(supply.slots(supply.group[slot])) == 1}
    priced = [group for group in sorted(set(supply.group)) if group not in kept]
    prices = {group: np.zeros(len(supply.pieces[supply.slots(group)[0]])) for group in priced}
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
        big = _beyond(least, supply.units)
        two = Supply((supply.pieces[pair[0]], supply.pieces[pair[1]]), (0, 1), supply.units)
        chosen = np.array(_assigned(np.where(np.isfinite(least), least, big), two))
        bound = least[chosen[:, 0], chosen[:, 1]].sum()
        used = {group: np.zeros(len(price)) for group, price in prices.items()}
        rest = (
            np.stack(
                np.unravel_index(flat.argmin(axis=2)[chosen[:, 0], chosen[:, 1]], [total.shape[k] for k in others])
            )
            if others
            else np.empty((0, len(chosen)), int)
        )
        for group in priced:
            for slot in supply.slots(group):
                places = chosen[:, pair.index(slot)] if slot in pair else rest[others.index(slot)]
                np.add.at(used[group], places, 1)
        over = {}
        for group, price in prices.items():
            pieces = supply.pieces[supply.slots(group)[0]]
            bound -= price @ pieces
            over[group] = used[group] - pieces
            if pieces.sum() > supply.units * len(supply.slots(group)):  # some may be left over: no price below 0
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
            pieces = supply.pieces[supply.slots(group)[0]]
            moved = price + step * over[group]
            free = pieces.sum() == supply.units * len(supply.slots(group))
            prices[group] = moved if free else np.maximum(moved, 0.0)
