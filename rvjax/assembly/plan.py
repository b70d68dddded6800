"""Assembly plan: units to build from measured parts, their gain on independent draws, and a bound of all plans."""

import dataclasses
import math
import warnings
from collections.abc import Hashable, Mapping

import numpy as np

from rvjax._jax.checks import checked
from rvjax.assembly.belief import Known, draw, known
from rvjax.assembly.choice import CLOSE, EXACT, chosen
from rvjax.assembly.costs import Costs, Machine, UnitResponse, costs, good
from rvjax.assembly.on_demand import MOST_VALUED, OnDemand, chosen_on_demand, too_many
from rvjax.assembly.parts import Kind, UnusualPart, outliers
from rvjax.assembly.supply import Build, Supply, best_so_far, supply_of
from rvjax.base.words import choose
from rvjax.population import deviate_of, score_interval
from rvjax.tolerances import Estimate, Requirement

OBJECTIVES = ("mean", "bottleneck", "yield")

MOST_FRESH = 2**21
"""Units of random assembly at most."""

LEAST_FRESH = 32  # draws of a unit on which every plan is valued


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Plan of the units to build, and its gain.

    `values`, `objective`, `random`, `gain` and both yields come from fresh draws of what is not known of the parts;
    `lower_bound` and `gap` evaluate the choice, on the draws that chose.

    Attributes:
        build: the part of each slot, for every unit: ({slot: id}, ...).
        index: angular position of each part, for every unit: ({slot: int}, ...).
        values: expected response of each unit (n,), inf where it fails.
        objective: their mean or the largest of them; for "yield" the expected share of good units.
        lower_bound: no plan has a lower objective; for "yield" none has a higher share.
        gap: (objective - bound)/|objective| of the choice, 0 where it is proved optimal, inf without a bound.
        status: "OPTIMAL", "BOUNDED", "SEARCHED" (no bound exists: better plans are possible) or "INFEASIBLE".
        left_over: pieces that no unit takes: {slot: (id, ...)}.
        random: mean response of all combinations in all positions; those that fail are left out.
        gain: random less the mean response of the plan.
        yield_: share of good units; None without a requirement.
        random_yield: of all combinations in all positions; None without a requirement.
        failing: units that fail; more than none only where every complete plan has as many.
        valued: combinations of parts that were evaluated for the choice.
        combinations: all of them.
        unsearched: random plans from which an interrupted search did not begin or end; 0 otherwise.
        checks: combinations whose exact values were compared with their estimates, where the bound rests on estimates;
            it is no proof then. 0: the bound rests on exact values.
    """

    build: tuple[dict[str, Hashable], ...]
    index: tuple[dict[str, int], ...]
    values: np.ndarray
    objective: float
    lower_bound: float
    gap: float
    status: str
    left_over: dict[str, tuple[Hashable, ...]]
    random: Estimate
    gain: Estimate
    yield_: Estimate | None
    random_yield: Estimate | None
    failing: tuple[int, ...]
    valued: int = 0
    combinations: int = 0
    unsearched: int = 0
    checks: int = 0


@checked
def plan(
    response: UnitResponse,
    kinds: Mapping[str, Kind],
    *,
    objective: str = "mean",
    requirement: Requirement | None = None,
    draws: int = 64,
    certificate_draws: int = 1024,
    seed: int = 0,
    starts: int = 32,
    exact_up_to: int = EXACT,
    most_valued: int = MOST_VALUED,
    most_fresh: int = MOST_FRESH,
    confidence: float = 0.95,
    keep_best: bool = False,
) -> Plan:
    """Choose the part and the position of every slot of every unit.

    Two slots are assigned exactly; more, and two slots fed by one stock, by HiGHS up to `exact_up_to` combinations;
    beyond by alternation, with a Lagrangian bound. Beyond `most_valued` responses estimates of all combinations lead,
    and only those that come into a plan are evaluated; the bound then rests on `checks` comparisons (1 for "yield").

    Args:
        response: (parts {slot: errors}, index {slot: int}) -> scalar or `Outcome` of one unit, a pure JAX function;
            small is good. The index is traced, or a plain integer where the response needs one.
        kinds: what may be mounted in each slot. One `Kind` given for several slots is one stock.
        objective: "mean" response, "bottleneck" (the worst unit) or "yield" (good units).
        requirement: limits of a good unit.
        draws: of what is not known of the parts, to choose by; one where all is known.
        certificate_draws: fresh ones, to value by.
        seed: of both.
        starts: random plans from which the alternation begins.
        exact_up_to: combinations up to which HiGHS proves that no plan is better.
        most_valued: responses at most, combinations x positions x draws, if all combinations are evaluated.
        most_fresh: responses at most to value the plan, and as many for random assembly; `certificate_draws` are fewer
            where the plan has many units.
        confidence: of the intervals.
        keep_best: an interruption (Ctrl-C) of the search ends it with the best plan so far.

    Raises:
        ValueError: fewer than two slots, an unknown objective, "yield" without a requirement, counts below 1, parts
            that do not fit each other, or more than 2**24 combinations.
    """
    counts = dict(draws=draws, certificate_draws=certificate_draws, starts=starts, most_fresh=most_fresh)
    _check(kinds, objective, requirement, confidence, exact_up_to=exact_up_to, most_valued=most_valued, **counts)
    by_kind = {id(kind): known(kind, slot) for slot, kind in kinds.items()}
    _warn(kinds)
    slots = {slot: by_kind[id(kind)] for slot, kind in kinds.items()}
    machine, supply = Machine(response, slots), supply_of(slots)
    certain = all(one.certain for one in slots.values())
    fresh = 1 if certain else min(certificate_draws, max(LEAST_FRESH, most_fresh // supply.units))
    draws = 1 if certain else draws
    given = machine, draw(slots, seed, 0, draws, alike=True), draws, requirement, objective == "yield"
    priced = OnDemand(*given) if too_many(machine, draws, most_valued) else costs(*given)
    with best_so_far(keep_best) as unsearched:
        build, bound, reached, proved = _choice(priced, supply, objective, starts, seed, exact_up_to, most_valued)
    if priced.level:  # nothing to choose by: in the given order
        build = as_they_lie(slots, supply)
    place, drawn = np.array(in_order(build, slots)), draw(slots, seed, 1, fresh, alike=False)
    values, turn = _valued(machine, priced, place, drawn, fresh)
    random, random_good = _random_assembly(machine, supply, priced, drawn, requirement, seed, fresh, most_fresh)
    failed = np.isnan(values).any(axis=1)
    expected = np.where(failed, np.inf, values.mean(axis=1))
    share = good(values, requirement).mean(axis=0)
    worst = {"mean": expected.mean(), "bottleneck": expected.max(), "yield": share.mean()}[objective]
    infeasible, gap = not np.isfinite(reached), _gap(reached, bound, proved)
    checks = 0 if isinstance(priced, Costs) or not math.isfinite(bound) else priced.checks
    return Plan(
        build=tuple({s: one.id_of(k) for (s, one), k in zip(slots.items(), unit)} for unit in place),
        index=tuple(dict(zip(slots, map(int, at))) for at in turn),
        values=expected,
        objective=float(worst),
        lower_bound=float(bound),
        gap=float(gap),
        status=_status(infeasible, gap, checks),
        left_over=left_over(slots, supply, place),
        random=_estimate(random, confidence),
        gain=_estimate(random - values.mean(axis=0), confidence),
        yield_=None if requirement is None else _share(share, confidence),
        random_yield=None if requirement is None else _share(random_good, confidence),
        failing=tuple(map(int, np.flatnonzero(failed))) if infeasible else (),
        valued=priced.count,
        combinations=math.prod(machine.shape),
        unsearched=sum(unsearched),
        checks=checks,
    )


def _choice(
    priced: Costs | OnDemand,
    supply: Supply,
    objective: str,
    starts: int,
    seed: int,
    exact_up_to: int,
    most_valued: int,
) -> tuple[Build, float, float, bool]:
    """The parts chosen, a bound, the objective reached, and whether it is proved."""
    rng = np.random.default_rng([seed % 2**64, 2])
    if isinstance(priced, OnDemand):
        return chosen_on_demand(priced, supply, objective, starts, rng, most_valued)
    return chosen(priced, supply, objective, starts, rng, exact_up_to)


def _valued(
    machine: Machine, priced: Costs | OnDemand, place: np.ndarray, drawn: Mapping[str, list[np.ndarray]], fresh: int
) -> tuple[np.ndarray, np.ndarray]:
    """Responses (units, draws) of a plan, NaN where a unit fails, and the angular positions of the parts."""
    cost, best = priced.of(place)
    turn = machine.indices[best]
    if fresh == 1:  # all is known: the costs that chose are the values
        return np.where(np.isinf(cost), np.nan, cost)[:, None], turn
    units = len(place)
    unit, each = np.repeat(np.arange(units), fresh), np.tile(np.arange(fresh), units)
    return machine.values(drawn, place[unit], turn[unit], each).reshape(units, fresh), turn


def _gap(reached: float, bound: float, proved: bool) -> float:
    """(objective - bound)/|objective| of a choice; 0 where it is proved, and where its units fail."""
    if proved or reached == bound or not np.isfinite(reached):
        return 0.0
    return abs(reached - bound) / max(abs(reached), 1e-300)


def _status(infeasible: bool, gap: float, checks: int) -> str:
    if infeasible or (gap <= CLOSE and not checks):
        return "INFEASIBLE" if infeasible else "OPTIMAL"
    return "BOUNDED" if math.isfinite(gap) else "SEARCHED"


def _check(
    kinds: Mapping[str, Kind], objective: str, requirement: Requirement | None, confidence: float, **counts: int
) -> None:
    if len(kinds) < 2:
        raise ValueError(f"kinds: {len(kinds)} slots, must be at least 2")
    for slot, kind in kinds.items():
        if not isinstance(kind, Kind):
            raise ValueError(f"kinds[{slot!r}] = {kind!r}: must be a Kind")
    choose("objective", objective, OBJECTIVES)
    if objective == "yield" and requirement is None:
        raise ValueError("requirement = None: objective 'yield' needs the limits of a good unit")
    for name, count in counts.items():
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise ValueError(f"{name} = {count!r}: must be a whole number of at least 1")
    deviate_of(confidence)  # an error if it is not between 0 and 1


def _estimate(values: np.ndarray, confidence: float) -> Estimate:
    """Mean over the draws, their spread, and the quantiles as the interval."""
    seen = values[~np.isnan(values)]
    if not len(seen):
        return Estimate(np.nan, np.nan, np.nan, np.nan)
    lower, upper = np.quantile(seen, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Estimate(float(seen.mean()), float(seen.std()), float(lower), float(upper))


def _warn(kinds: Mapping[str, Kind]) -> None:
    """Name the furthest part of each kind that may have a wrong unit."""
    for slot, kind in {id(kind): (slot, kind) for slot, kind in kinds.items()}.values():
        if unusual := outliers(kind):
            more = f" (and {len(unusual) - 1} more parts)" if unusual[1:] else ""
            line = unusual[0].text(f"{slot}: part {unusual[0].id!r}", f"{unusual[0].value:.4g}")
            warnings.warn(line + more, UnusualPart, stacklevel=4)


def _share(values: np.ndarray, confidence: float) -> Estimate:
    """As `_estimate`; where every draw shows the same share, the score interval of so many draws."""
    values = np.where(values > 1 - 1e-12, 1.0, values)  # weights add up to less, or more, by rounding
    estimate = _estimate(values, confidence)
    if len(values) == 1 or estimate.lower != estimate.upper:  # one draw: all is known
        return estimate
    lower, upper = score_interval(estimate.value, len(values), deviate_of(confidence))
    return dataclasses.replace(estimate, lower=lower, upper=upper)


def _random_assembly(
    machine: Machine,
    supply: Supply,
    priced: Costs | OnDemand,
    drawn: Mapping[str, list[np.ndarray]],
    requirement: Requirement | None,
    seed: int,
    fresh: int,
    most_fresh: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean response and share of good units of random assembly, for every fresh draw.

    Args:
        machine: response and parts.
        supply: stocks.
        priced: costs that chose; they are the values where all is known of the parts.
        drawn: fresh errors of each slot.
        requirement: limits of a good unit, or None.
        seed: of the random units.
        fresh: draws.
        most_fresh: units at most over all draws: all combinations where they are no more, else a random part of them.
    """
    weight = supply.weight()
    if fresh == 1 and isinstance(priced, Costs):
        every = np.nan_to_num(priced.every_mean)
        succeeds = weight * np.isfinite(priced.every_mean)
        mean = (succeeds * every).sum() / succeeds.sum() if succeeds.any() else np.nan
        share = np.nan if priced.every_good is None else (weight * priced.every_good).sum() / weight.sum()
        return np.array([mean]), np.array([share])
    cells, turns = np.argwhere(weight > 0), len(machine.indices)
    likely = weight[weight > 0] / weight.sum()
    most = max(1, most_fresh // fresh)
    rng, sums = np.random.default_rng([seed % 2**64, 3]), np.cumsum(likely)
    if len(cells) * turns <= most:
        cell, turn = (x.ravel() for x in np.meshgrid(np.arange(len(cells)), np.arange(turns), indexing="ij"))
        chosen = [(cell, turn)] * fresh
        share = likely[cell] / turns
    else:
        chosen = [
            (np.searchsorted(sums / sums[-1], rng.random(most), side="right"), rng.integers(turns, size=most))
            for _ in range(fresh)
        ]
        share = np.full(most, 1 / most)
    # All draws at once: a call of few units costs as much as one of many.
    cell, turn = (np.concatenate(x) for x in zip(*chosen))
    draw = np.repeat(np.arange(fresh), len(share))
    values = machine.values(drawn, cells[cell], machine.indices[turn], draw).reshape(fresh, -1)
    right = ~np.isnan(values)
    weighed = np.where(right, share * np.nan_to_num(values), 0.0).sum(axis=1)
    with np.errstate(invalid="ignore"):
        mean = weighed / (share * right).sum(axis=1)
    return mean, (share * good(values, requirement)).sum(axis=1)


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
