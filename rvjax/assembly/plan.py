"""Assembly plan: units to build from measured parts, their gain on independent draws, and a bound of all plans."""

import dataclasses
import math
import warnings
import zlib
from collections.abc import Hashable, Mapping

import numpy as np

from rvjax._jax.checks import checked
from rvjax.assembly.alternation import best_so_far
from rvjax.assembly.choice import CLOSE, EXACT, least_largest, least_sum
from rvjax.assembly.costs import Costs, Machine, UnitResponse, costs, good
from rvjax.assembly.on_demand import MOST_VALUED, PILOTS, OnDemand, chosen_on_demand, too_many
from rvjax.assembly.outliers import UnusualPart, outliers
from rvjax.assembly.parts import Kind, Known, known
from rvjax.assembly.random_assembly import MOST_FRESH, random_assembly
from rvjax.assembly.supply import Build, Supply
from rvjax.base.words import choose
from rvjax.population import deviate_of, score_interval
from rvjax.tolerances import Estimate, Requirement

OBJECTIVES = ("mean", "bottleneck", "yield")

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
    pilots: int = PILOTS,
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
        pilots: combinations at least that are evaluated to fit and check the estimates, beyond `most_valued`.
        confidence: of the intervals.
        keep_best: an interruption (Ctrl-C) of the search ends it with the best plan so far.

    Raises:
        ValueError: fewer than two slots, an unknown objective, "yield" without a requirement, counts below 1, parts
            that do not fit each other, or more than 2**24 combinations.
    """
    counts = dict(draws=draws, certificate_draws=certificate_draws, starts=starts, exact_up_to=exact_up_to)
    counts |= dict(most_valued=most_valued, most_fresh=most_fresh, pilots=pilots)
    _check(kinds, objective, requirement, confidence, **counts)
    by_kind = {id(kind): known(kind, slot) for slot, kind in kinds.items()}
    _warn(kinds)
    slots = {slot: by_kind[id(kind)] for slot, kind in kinds.items()}
    machine, supply = Machine(response, slots), supply_of(slots)
    certain = all(one.certain for one in slots.values())
    fewest = min(certificate_draws, LEAST_FRESH)
    fresh = 1 if certain else max(fewest, min(certificate_draws, most_fresh // supply.units))
    draws = 1 if certain else draws
    rng, asked = np.random.default_rng([seed % 2**64, 2]), (draws, requirement, objective == "yield")
    found: Costs | OnDemand
    with best_so_far(keep_best) as unsearched:
        if too_many(machine, draws, most_valued):
            found = OnDemand(machine, draw(slots, seed, 0, draws, alike=True), *asked, pilots)
            build, bound, reached, proved = chosen_on_demand(found, supply, objective, starts, rng, most_valued)
        else:
            found = costs(machine, draw(slots, seed, 0, draws, alike=True), *asked)
            build, bound, reached, proved = chosen(found, supply, objective, starts, rng, exact_up_to)
    if found.level:  # nothing to choose by: in the given order
        build = _as_they_lie(slots, supply)
    build = _in_order(build, slots)
    # Valued on fresh draws, next to random assembly on the same ones.
    place = np.array(build)
    own, best = found.of(place)
    turn = machine.indices[best]
    drawn = draw(slots, seed, 1, fresh, alike=False)
    units = len(build)
    if fresh == 1:  # all is known: the costs that chose are the values
        values = np.where(np.isinf(own), np.nan, own)[:, None]
    else:
        lanes = np.repeat(np.arange(units), fresh), np.tile(np.arange(fresh), units)
        values = machine.values(drawn, place[lanes[0]], turn[lanes[0]], lanes[1]).reshape(units, fresh)
    random, random_good = random_assembly(machine, supply, found, drawn, requirement, seed, fresh, most_fresh)
    failed = np.isnan(values).any(axis=1)
    expected = np.where(failed, np.inf, values.mean(axis=1))
    share = good(values, requirement).mean(axis=0)
    worst = {"mean": expected.mean(), "bottleneck": expected.max(), "yield": share.mean()}[objective]
    infeasible = not np.isfinite(reached)
    gap = 0.0 if proved or reached == bound or infeasible else abs(reached - bound) / max(abs(reached), 1e-300)
    own = np.where(np.isnan(values).any(axis=0), np.nan, values.mean(axis=0))
    checks = 0 if isinstance(found, Costs) or not math.isfinite(bound) else found.checks
    return Plan(
        build=tuple({s: one.id_of(k) for (s, one), k in zip(slots.items(), unit)} for unit in build),
        index=tuple(dict(zip(slots, map(int, at))) for at in turn),
        values=expected,
        objective=float(worst),
        lower_bound=float(bound),
        gap=float(gap),
        status=_status(infeasible, gap, checks),
        left_over=_left_over(slots, supply, place),
        random=_estimate(random, confidence),
        gain=_estimate(random - own, confidence),
        yield_=None if requirement is None else _share(share, confidence),
        random_yield=None if requirement is None else _share(random_good, confidence),
        failing=tuple(map(int, np.flatnonzero(failed))) if infeasible else (),
        valued=found.count,
        combinations=math.prod(machine.shape),
        unsearched=sum(unsearched),
        checks=checks,
    )


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
    if requirement is not None and not isinstance(requirement, Requirement):
        raise ValueError(f"requirement = {requirement!r}: must be a Requirement")
    if objective == "yield" and requirement is None:
        raise ValueError("requirement = None: objective 'yield' needs the limits of a good unit")
    for name, count in counts.items():
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise ValueError(f"{name} = {count!r}: must be a whole number of at least 1")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence!r}: must lie between 0 and 1")


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
    found: dict[str, list[np.ndarray]] = {}
    by_stock: dict[int, str] = {}
    for slot, one in slots.items():
        if not alike and id(one) in by_stock:
            found[slot] = found[by_stock[id(one)]]  # the same piece in any slot
            continue
        by_stock.setdefault(id(one), slot)
        rng = np.random.default_rng([seed % 2**64, purpose, zlib.crc32(slot.encode())])
        found[slot] = one.drawn(rng, draws, alike=alike)
    return found


def chosen(
    found: Costs,
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
            found,
            mean=found.mean.squeeze(tuple(single)),
            outside=None if found.outside is None else found.outside.squeeze(tuple(single)),
        )
        build, bound, reached, proved = chosen(lean, fewer, objective, starts, rng, exact_up_to)
        full = [tuple(dict(zip(kept, unit)).get(k, 0) for k in range(len(supply.shape))) for unit in build]
        return full, bound, reached, proved
    failing = ~np.isfinite(found.mean)
    finite = found.mean[~failing]
    mean = np.where(failing, finite.max(initial=0.0), found.mean)
    units = supply.units
    if failing.any():
        fewest = least_sum([failing, mean], supply, starts, rng, asked=0, exact_up_to=exact_up_to)
        if any(failing[unit] for unit in fewest.build):
            return fewest.build, np.inf, np.inf, fewest.exact
    if objective == "bottleneck":
        worst = np.where(failing, finite.max() + 1 + np.ptp(finite), found.mean)
        choice = least_largest(worst, supply, starts, rng, exact_up_to=exact_up_to)
        return choice.build, choice.bound, max(found.mean[unit] for unit in choice.build), choice.exact
    if objective == "yield":
        assert found.outside is not None
        choice = least_sum([failing, found.outside, mean], supply, starts, rng, asked=1, exact_up_to=exact_up_to)
        share = 1 - sum(found.outside[unit] for unit in choice.build) / units
        return choice.build, 1 - max(choice.bound, 0.0) / units, share, choice.exact
    choice = least_sum([failing, mean], supply, starts, rng, exact_up_to=exact_up_to)
    return choice.build, choice.bound / units, sum(mean[unit] for unit in choice.build) / units, choice.exact


def _as_they_lie(slots: Mapping[str, Known], supply: Supply) -> Build:
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


def _in_order(build: Build, slots: Mapping[str, Known]) -> Build:
    """Units in the order in which the parts of the first slot lie there, then those of the second."""
    orders = [one.order for one in slots.values()]
    return sorted(build, key=lambda unit: tuple(int(order[place]) for order, place in zip(orders, unit)))


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
        if found := outliers(kind):
            more = f" (and {len(found) - 1} more parts)" if found[1:] else ""
            line = found[0].text(f"{slot}: part {found[0].id!r}", f"{found[0].value:.4g}")
            warnings.warn(line + more, UnusualPart, stacklevel=4)


def _share(values: np.ndarray, confidence: float) -> Estimate:
    """As `_estimate`; where every draw shows the same share, the score interval of so many draws."""
    values = np.where(values > 1 - 1e-12, 1.0, values)  # weights add up to less, or more, by rounding
    found = _estimate(values, confidence)
    if len(values) == 1 or found.lower != found.upper:  # one draw: all is known
        return found
    lower, upper = score_interval(found.value, len(values), deviate_of(confidence))
    return dataclasses.replace(found, lower=lower, upper=upper)


def _left_over(slots: Mapping[str, Known], supply: Supply, place: np.ndarray) -> dict[str, tuple[Hashable, ...]]:
    """Ids of unused pieces in the order given, each as often as there are pieces."""
    found = {}
    for number, (slot, one) in enumerate(slots.items()):
        left = one.pieces.copy()
        for other in supply.slots(supply.group[number]):
            np.subtract.at(left, place[:, other], 1)
        in_order = np.argsort(one.order)
        found[slot] = tuple(one.id_of(k) for k in in_order for _ in range(left[k]))
    return found
