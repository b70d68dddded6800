"""Choice of combinations: exact assignments, HiGHS for small ones, alternation with a Lagrangian bound beyond.

A cost comes in layers, the first counts most: failing units, then units outside the limits, then the response.
"""

import contextlib
import dataclasses
import itertools
from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from rvjax.assembly.costs import Costs
from rvjax.assembly.supply import Build, Supply, alternate, assigned, copies, lagrangian, stopped

EXACT = 20_000
"""Combinations up to which HiGHS proves its plan."""

CLOSE = 1e-6
"""Gap below which a plan counts as optimal."""

PATIENCE = 120.0
"""Seconds after which HiGHS leaves a plan to the alternation and its bound."""

SCALE = 1e6  # of the largest cost in HiGHS, whose gap is absolute: 1e-6


class _TooLong(Exception):
    """HiGHS found no proof in time."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """Chosen combinations.

    Attributes:
        build: parts of each unit.
        bound: no plan has a lower sum of the required layer (a lower largest cost).
        exact: it is proved that no plan is better.
    """

    build: Build
    bound: float
    exact: bool


def least_sum(
    layers: Sequence[np.ndarray],
    supply: Supply,
    starts: int,
    rng: np.random.Generator,
    *,
    asked: int = -1,
    exact_up_to: int = EXACT,
) -> Choice:
    """Return the plan with the least sums, layer by layer.

    Args:
        layers: finite costs of every combination, the first counts most.
        supply: stocks.
        starts: of the alternation.
        rng: of its random plans.
        asked: layer whose bound is required.
        exact_up_to: combinations up to which HiGHS proves the plan.
    """
    cost = weigh(layers, supply.units)
    if len(supply.shape) == 2 and not supply.shared:
        build = assigned(cost, supply)
        return Choice(build, _sum(layers[asked], build), True)
    allowed = supply.allowed()
    with contextlib.suppress(_TooLong):
        if (proved := _prove(layers, supply, allowed, exact_up_to)) is not None:
            return Choice(proved, _sum(layers[asked], proved), True)
    build = alternate(np.where(allowed, cost, np.inf), supply, starts, rng)
    reached = _sum(layers[asked], build)
    bound = lagrangian(layers[asked], supply, reached)
    return Choice(build, bound, reached - bound <= CLOSE * abs(reached))


def least_largest(
    cost: np.ndarray, supply: Supply, starts: int, rng: np.random.Generator, *, exact_up_to: int = EXACT
) -> Choice:
    """Return the plan whose largest cost is least, and among these the one with the least sum.

    Args:
        cost: of every combination.
        supply: stocks.
        starts: of the alternation.
        rng: of its random plans.
        exact_up_to: combinations up to which HiGHS proves the plan.
    """
    levels = np.unique(cost)
    if len(supply.shape) == 2 and not supply.shared:
        level = _least_level(cost, supply, levels)
        return Choice(assigned(weigh([cost > level, cost], supply.units), supply), float(level), True)
    allowed = supply.allowed()
    floor = _pair_level(np.where(allowed, cost, np.inf), supply)
    with contextlib.suppress(_TooLong):
        if (best := _prove_least(cost, supply, allowed, levels, floor, exact_up_to)) is not None:
            return Choice(best, max(float(cost[unit]) for unit in best), True)
    # Each step forbids what is as bad as the worst unit so far.
    build = alternate(np.where(allowed, cost, np.inf), supply, starts, rng)
    while True:
        worst = max(cost[unit] for unit in build)
        trial = alternate(np.where(allowed, weigh([cost >= worst, cost], supply.units), np.inf), supply, starts, rng)
        if stopped() or max(cost[unit] for unit in trial) >= worst:
            return Choice(build, float(floor), worst - floor <= CLOSE * abs(worst))
        build = trial


def _prove_least(
    cost: np.ndarray, supply: Supply, allowed: np.ndarray, levels: np.ndarray, floor: float, exact_up_to: int
) -> Build | None:
    """Prove the least largest cost by bisection over its levels, each step a program; None if too large."""
    best = _prove([cost], supply, allowed, exact_up_to)
    if best is None:
        return None
    plans = {}

    def possible(level: float) -> bool:
        plans[level] = _prove([cost], supply, allowed & (cost <= level), exact_up_to)
        return plans[level] is not None

    low, high = (int(np.searchsorted(levels, end)) for end in (floor, max(cost[unit] for unit in best)))
    level = levels[bisect_left(levels, True, low, high, key=possible)]
    return plans.get(level, best)


def weigh(layers: Sequence[np.ndarray], units: int) -> np.ndarray:
    """One cost whose sums have the order of the sums of the layers, first layer first; a single layer is unchanged.

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


def _least_level(cost: np.ndarray, supply: Supply, levels: np.ndarray) -> float:
    """Return the least cost below which a plan exists."""
    rows, columns = map(copies, supply.pieces)
    full = cost[np.ix_(rows, columns)]

    def enough(level: float) -> bool:
        matched = maximum_bipartite_matching(csr_array(full <= level), perm_type="column")
        return bool((matched >= 0).sum() >= supply.units)

    return levels[bisect_left(levels[:-1], True, key=enough)]


def _pair_level(cost: np.ndarray, supply: Supply) -> float:
    """Lower bound of the largest cost of any plan: each pair of slots separately, the others at their best fit."""
    floors = []
    for first, second in itertools.combinations(range(len(supply.shape)), 2):
        others = tuple(k for k in range(len(supply.shape)) if k not in (first, second))
        least = cost.min(axis=others)
        pair = Supply((supply.pieces[first], supply.pieces[second]), (0, 1), supply.units)
        finite = np.unique(least[np.isfinite(least)])
        floors.append(_least_level(least, pair, finite))
    return max(floors)


def _prove(layers: Sequence[np.ndarray], supply: Supply, allowed: np.ndarray, exact_up_to: int) -> Build | None:
    """Return the best plan by HiGHS; None where there is none, or it is too large to prove.

    Raises:
        _TooLong: it took more than `PATIENCE`.
    """
    if int(allowed.sum()) // (2 if supply.shared else 1) > exact_up_to:  # slots of one stock are in one order
        return None
    combos = np.argwhere(allowed)
    one_cost = weigh(layers, supply.units)
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
    limits = []
    for group in sorted(set(supply.group)):
        slots = supply.slots(group)
        pieces = supply.stock(group)
        rows, columns = combos[:, slots].T.ravel(), np.tile(np.arange(len(combos)), len(slots))
        used = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(pieces), len(combos)))
        limits.append(LinearConstraint(used, ub=pieces))
    limits.append(LinearConstraint(np.ones((1, len(combos))), lb=supply.units, ub=supply.units))
    most = np.min([supply.pieces[slot][combos[:, slot]] for slot in range(combos.shape[1])], axis=0)
    counts = np.zeros(len(combos), int)
    for number, layer in enumerate(layers):
        cost = np.asarray(layer, float)[tuple(combos.T)]
        span = np.ptp(cost)
        if number < len(layers) - 1 and not span:
            continue
        scaled = (cost - cost.min()) / (span if span else 1.0)
        solution = milp(
            SCALE * scaled,
            constraints=limits,
            integrality=np.ones(len(combos)),
            bounds=Bounds(0, most),
            options={"mip_rel_gap": 0.0, "time_limit": PATIENCE},
        )
        if solution.status == 2:
            return None
        if solution.status != 0:
            raise _TooLong
        counts = np.round(solution.x).astype(int)
        steps = np.diff(np.unique(scaled)).min(initial=1.0)
        limits.append(LinearConstraint(scaled[None], ub=float(scaled @ counts) + 0.25 * steps))
    return [tuple(map(int, combos[k])) for k in np.flatnonzero(counts) for _ in range(counts[k])]


def chosen(
    priced: Costs,
    supply: Supply,
    objective: str,
    starts: int,
    rng: np.random.Generator,
    exact_up_to: int = EXACT,
) -> tuple[Build, float, float, bool]:
    """Build, bound and objective on the draws that chose (inf if it fails), and whether it is proved."""
    kept, fewer = supply.lean()
    single = [slot for slot in range(len(supply.shape)) if slot not in kept]
    if single:  # what is the same in every unit is no choice, and two slots are exact
        lean = dataclasses.replace(
            priced,
            mean=priced.mean.squeeze(tuple(single)),
            outside=None if priced.outside is None else priced.outside.squeeze(tuple(single)),
        )
        build, bound, reached, proved = chosen(lean, fewer, objective, starts, rng, exact_up_to)
        full = [tuple(dict(zip(kept, unit)).get(k, 0) for k in range(len(supply.shape))) for unit in build]
        return full, bound, reached, proved
    failing = ~np.isfinite(priced.mean)
    finite = priced.mean[~failing]
    mean = np.where(failing, finite.max(initial=0.0), priced.mean)
    units = supply.units
    if failing.any():
        fewest = least_sum([failing, mean], supply, starts, rng, asked=0, exact_up_to=exact_up_to)
        if any(failing[unit] for unit in fewest.build):
            return fewest.build, np.inf, np.inf, fewest.exact
    if objective == "bottleneck":
        worst = np.where(failing, finite.max() + 1 + np.ptp(finite), priced.mean)
        choice = least_largest(worst, supply, starts, rng, exact_up_to=exact_up_to)
        return choice.build, choice.bound, max(priced.mean[unit] for unit in choice.build), choice.exact
    if objective == "yield":
        assert priced.outside is not None
        choice = least_sum([failing, priced.outside, mean], supply, starts, rng, asked=1, exact_up_to=exact_up_to)
        share = 1 - sum(priced.outside[unit] for unit in choice.build) / units
        return choice.build, 1 - max(choice.bound, 0.0) / units, share, choice.exact
    choice = least_sum([failing, mean], supply, starts, rng, exact_up_to=exact_up_to)
    return choice.build, choice.bound / units, sum(mean[unit] for unit in choice.build) / units, choice.exact
