"""Rare failures: the share of units beyond a limit, down to parts per million and below."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax._jax.sizes import SEARCHES, TESTED
from rvjax.population import Correlation, Estimate, Population, clopper_pearson, deviate_of, rare, skewed, student
from rvjax.records import PyTree
from rvjax.response import Response, by_name, by_response, response_names
from rvjax.tolerances.failure.form import Found, LimitState, Units, design_points, orbit
from rvjax.tolerances.failure.importance_sampling import Mixture, apart
from rvjax.tolerances.failure.subset import (
    INWARDS,
    ISLANDS,
    OUTWARDS,
    Levels,
    Sequential,
    Spreads,
    sequential,
    together,
)
from rvjax.tolerances.limits import Limits

__all__ = ["FailureProbability", "failure_probability"]

_ROUNDS = 12  # most batches of searches
_ORBITS = 4  # new points of a batch whose images are tried
_HEAVY = 3.0  # mean weight of failed units of the second estimate, over that of the first, which makes them disagree
_FEWEST_EFFECTIVE = 100
_PLAIN = 4096  # units as they are made: they decide what is rare, and check the result
_FREQUENT = 0.1  # share of the rarer event from which plain units estimate it best
_CERTAIN = 0.999  # confidence of the interval of plain units that an estimate must meet
_COUNTED = 30  # plain units of the event that are a better estimate than one in doubt
_RAY = (2 / 3, 1 / 3)  # of a unit: it belongs to the event around the origin if these do as well
_LEAST_CLOUD = 0.5  # share of a cloud in the draws
_BEYOND = 1.05  # of a point: outside the event around the origin, but within any other that begins there
_HITS = 0.02  # share of draws in the event below which points are a bad proposal
_MISSED = 10.0  # ratio of the first draws to subset simulation over spreads, from which levels are tried
_REACHED = 1e-12  # least probability that levels can reach in their steps


@dataclasses.dataclass(frozen=True)
class FailureProbability:
    """Probability of failure of a unit; fields have the structure of the response.

    Attributes:
        probability: `Estimate` of the share of units beyond the limits or without a valid value.
        reliability_index: distance of the nearest limit from the origin of the standard normal numbers;
            -Phi^-1(P) if the limit is flat. Negative if the origin itself fails, inf without a point.
        point: errors of that point, the most likely failure; None if none was found.
        evaluations: units evaluated in all; a value with its gradient counts as three.
        effective_samples: (sum w)^2 / sum w^2 of the weights of the failed units; of the good ones if these are rare.
        points: points of failure that the sampling is centred at.
        second: `Estimate` of the same probability by subset simulation, which needs neither points nor
            slopes; its standard error is mostly 15 to 30 %.
        status: "OK", or warnings, joined by ", ": "FEW_EFFECTIVE_SAMPLES" (below 100),
            "ESTIMATES_DISAGREE" (the second or the plain units differ, or the failures of the second lie where draws
            of the first are rare; with either of these two, the interval of the probability contains both intervals),
            "PLAIN_UNITS" (value and exact interval of plain units, because the estimates disagree or are weak),
            "SEVERAL_POINTS" (of similar distance: the flat-limit value Phi(-index) misses the others),
            "KINKED_POINT" (no slope at the nearest point: the index may be a little too large), "NO_POINT",
            "RARE_NOMINAL" (the origin fails and most units do not, or the reverse: the index has no relation to P).
    """

    probability: PyTree
    reliability_index: PyTree
    point: PyTree
    evaluations: PyTree
    effective_samples: PyTree
    points: PyTree
    second: PyTree
    status: PyTree


@checked
def failure_probability(
    response: Response,
    tolerances: object,
    requirement: object,
    *,
    samples: int,
    seed: int,
    correlation: Correlation = None,
) -> FailureProbability:
    """Probability that a unit violates a requirement, by importance sampling about its design points.

    A second estimate comes first: subset simulation, which uses only whether a unit fails, and ends
    with units of the failing region, every failure mode in proportion. From these, and from units near a
    limit, the points of the failing region nearest to the origin of the random numbers are searched (the
    first-order reliability method; every limit has separate points), until a batch of searches finds
    nothing new, 12 batches at most. Images of a point by exchange of like parts are points too where the
    response fails there. Then units are sampled from unit normals centred there, each weighted by the ratio
    of the densities (Melchers 1989); a tenth is sampled about the origin, so that no weight exceeds 20.
    A region around the origin, or smaller than these normals, is sampled from a normal fitted to its units.
    Plain units decide first whether failing or passing is rare; both estimates are of the rare one.
    Where the two estimates disagree, the status is "ESTIMATES_DISAGREE" and the interval contains both.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        requirement: `Requirement`, or a dict of them by name of the response, each evaluated separately;
            its target has no effect.
        samples: units of the final draw; the second estimate and the searches add some 20 000 to 80 000 evaluations,
            up to 200 000 for regions that are thin or around the origin.
        seed: of the random numbers.
        correlation: {(field or element, field or element): correlation of their z}.

    Returns:
        `FailureProbability`. A unit without a valid value fails; an infinite value is one, above all limits or below.

    Raises:
        ValueError: no requirement, or too few samples.
    """
    if samples < 2:
        raise ValueError(f"samples = {samples!r}: must be at least 2")
    population = Population.of(tolerances, correlation)
    names = response_names(response, population)
    required = by_response(requirement, names, Limits, "requirement")
    if not required:
        raise ValueError("requirement: needs at least one")
    for name, item in required.items():
        if not item.of_units:
            raise ValueError(f"requirement[{name!r}] = {item!r}: must be a requirement on single units")
    found = {}
    for name, item in required.items():
        random = np.random.default_rng(seed)
        search = _Search(Units(response, population, name), item, random)
        found[name] = _searched(search, random, samples)
    return by_name(FailureProbability, found)


def _searched(search: "_Search", random: np.random.Generator, samples: int) -> dict[str, object]:
    """The fields of the result from the second estimate, the search and draws about its points."""
    second = search.second(random)
    mixture = search.mixture
    first, effective, typical = search.draw(random, samples)
    few = effective < _FEWEST_EFFECTIVE
    disagree = _disagree(first, second, mixture, typical) or search.contradicts(first)
    reasons = ["FEW_EFFECTIVE_SAMPLES"] * few + ["ESTIMATES_DISAGREE"] * disagree
    shown, plain = first, search.counted(0.95)
    if search.contradicts(first) or ((disagree or few) and search.hits >= _COUNTED):
        shown, reasons = plain, [*reasons, "PLAIN_UNITS"]
    elif (disagree or few) and first.value > 0:
        shown = _both(first, second.probability if second.probability.value else plain)
    nearest = search.nominal if search.around else mixture
    reasons += nearest.reasons() + ["RARE_NOMINAL"] * search.around
    distance = float(nearest.distances.min()) if nearest.count else math.inf
    population = search.units.population
    return dict(
        probability=_of_failure(shown, search.good_is_rare),
        reliability_index=-distance if search.middle_fails else distance,
        point=population.errors(jnp.asarray(nearest.centres[:, nearest.nearest])) if nearest.count else None,
        evaluations=search.units.evaluations,
        effective_samples=effective,
        points=mixture.count,
        second=_of_failure(second.probability, search.good_is_rare),
        status=", ".join(reasons) or "OK",
    )


def _of_failure(share: Estimate, good_is_rare: bool) -> Estimate:
    """Probability of failure within 0 and 1, from the share of the rare event; units that show nothing bound it."""
    value, lower, upper = np.clip([share.value, share.lower, share.upper], 0.0, 1.0).tolist()
    if good_is_rare:
        value, lower, upper = 1 - value, 1 - upper, 1 - lower
    if lower == upper:  # closer to 1 than numbers are
        lower, upper = float(np.nextafter(lower, -1.0)), min(1.0, float(np.nextafter(upper, 2.0)))
    return Estimate(value, share.error or (upper - lower) / (2 * deviate_of(0.95)), max(0.0, lower), upper)


def _disagree(first: Estimate, second: Sequential, mixture: Mixture, typical: float) -> bool:
    """True if the two estimates differ, or if draws of the first are rare near failed units of the second."""
    if not (first.value and second.probability.value):
        return first.value != second.probability.value
    # By ratios: a low estimate has a low error.
    apart = abs(math.log(first.value / second.probability.value))
    errors = math.hypot(first.error / first.value, second.probability.error / second.probability.value)
    if apart > student(0.99, ISLANDS) * errors:
        return True
    return float(mixture.weights(second.units).mean()) > _HEAVY * typical


def _both(first: Estimate, second: Estimate) -> Estimate:
    """The first value with an interval that contains both intervals, and the error of that interval."""
    both = _widest(first, second)
    return dataclasses.replace(both, error=max(first.error, (both.upper - both.lower) / (2 * deviate_of(0.95))))


def _widest(first: Estimate, second: Estimate) -> Estimate:
    """The first value with an interval that contains both intervals."""
    return Estimate(first.value, first.error, min(first.lower, second.lower), max(first.upper, second.upper))


class _Search:
    """The points of failure of all limits of one requirement, and the draws about them.

    The event that is sampled is the rarer one among plain units: failing, or passing.
    """

    def __init__(self, units: Units, requirement: Limits, random: np.random.Generator) -> None:
        self.units, self.requirement, self.numbers = units, requirement, units.population.numbers
        sides = [(requirement.upper, 1.0), (requirement.lower, -1.0)]
        self.states = [LimitState(units, limit, sign) for limit, sign in sides if math.isfinite(limit)]
        self.mixture, self.nominal = Mixture(self.numbers), Mixture(self.numbers)
        self.plain = random.standard_normal((self.numbers, _PLAIN))
        self.values = units.values(self.plain)
        failed = int((self._distance(self.values) < 0).sum())
        self.good_is_rare = failed > _PLAIN / 2
        self.hits = min(failed, _PLAIN - failed)
        self.mixture.frequent = self.hits > _FREQUENT * _PLAIN
        self.around = False
        self.around = bool(self.differ(np.zeros((self.numbers, 1)))[0]) and not self.mixture.frequent
        self.middle_fails = bool(self._distance(units.values(np.zeros((self.numbers, 1))))[0] < 0)

    def _distance(self, values: np.ndarray) -> np.ndarray:
        """Distance of values within the limits, negative outside; a unit without a value is furthest outside."""
        return -self.requirement.margins(values)

    def differ(self, z: np.ndarray) -> np.ndarray:
        """Mark units (numbers, n) of the rare event; a unit without a value fails."""
        return (self._distance(self.units.values(z)) < 0) != self.good_is_rare

    def _inside(self, z: np.ndarray) -> np.ndarray:
        """Distance (n,) of units (numbers, n) within the rare event."""
        return self._distance(self.units.values(z)) * (1 if self.good_is_rare else -1)

    def _parted(self, z: np.ndarray, around: bool) -> np.ndarray:
        """Mark units of the rare event that are connected to the origin on their rays, or those that are not."""
        found = self.differ(z)
        if found.any():
            own = z[:, found]
            found[found] = np.all([self.differ(part * own) for part in _RAY], axis=0) == around
        return found

    def _elsewhere(self, z: np.ndarray) -> np.ndarray:
        """Mark units of the rare event but for a part of it around the origin."""
        return self._parted(z, False) if self.around else self.differ(z)

    def counted(self, confidence: float) -> Estimate:
        """Share of the rare event among plain units."""
        return clopper_pearson(self.hits, _PLAIN, confidence)

    def contradicts(self, share: Estimate) -> bool:
        """True if plain units exclude an estimate of the share of the rare event."""
        counted = self.counted(_CERTAIN)
        return share.upper < counted.lower or share.lower > counted.upper

    def second(self, random: np.random.Generator) -> Sequential:
        """Subset simulation of the rare event; with its units the points and the proposal are found."""
        found, around = sequential(Spreads(self._elsewhere, OUTWARDS), self.numbers, random), None
        if self.around:
            nearby = Spreads(lambda z: self._parted(z, True), INWARDS, self.differ)
            around = sequential(nearby, self.numbers, random)
        self.explore(random, found.units)
        if around is not None and around.units.shape[1]:
            part = around.probability.value / (around.probability.value + found.probability.value)
            self.mixture.gather(around.units, max(part, _LEAST_CLOUD))
            found = together(around, found, random)
        if (not self.mixture.count and not found.units.shape[1]) or self.mixture.frequent:
            return found
        drawn = self.mixture.sample(random, TESTED)
        hit = self.differ(drawn)
        share = float(self.mixture.weights(drawn[:, hit]).sum()) / TESTED
        thin = hit.mean() < _HITS  # a part of the event smaller than a unit normal, which spreads may miss
        if thin or share > max(_REACHED, _MISSED * found.probability.value):
            levels = sequential(Levels(self._inside, self.differ), self.numbers, random)
            pool = np.concatenate([found.units, levels.units], axis=1)
            found = max(found, levels, key=lambda one: one.probability.value)  # each can only miss a part
            if thin and pool.shape[1] and not self.around:
                self.mixture.gather(pool, _LEAST_CLOUD)
        return found

    def explore(self, random: np.random.Generator, differing: np.ndarray) -> None:
        """Find the points: from plain units near a limit, then from failures far from every point.

        Failures come from the second estimate and from draws of the current mixture; each starts searches in
        proportion to its weight. Ends when a batch of searches finds nothing new.
        """
        for state in self.states:
            order = np.argsort(np.nan_to_num(np.abs(state.g(self.values)), nan=math.inf))
            found = design_points(state, self.plain[:, order[:SEARCHES]], differing)
            if self.around:  # where the event ends: it gives the index, but is no place to sample
                self.nominal.add(found)
            else:
                self._take(state, found)
        for _ in range(_ROUNDS):
            drawn = self.mixture.sample(random, TESTED)
            pool = np.concatenate([differing, drawn[:, self._elsewhere(drawn)]], axis=1)
            if not pool.shape[1]:
                break
            weights = self.mixture.weights(pool)
            weights = weights if weights.any() else np.ones(len(weights))  # all beyond 38 standard deviations
            count = min(SEARCHES, pool.shape[1])
            starts = pool[:, random.choice(pool.shape[1], count, replace=False, p=weights / weights.sum())]
            values, new = self.units.values(starts), False
            for state in self.states:
                # A unit without a value fails at every limit.
                lost = np.isnan(values) if state is self.states[0] else False
                own = np.full(count, True) if self.good_is_rare else (state.g(values) > 0) | lost
                new |= self._take(state, design_points(state, starts[:, own], pool))
            if not new:
                break

    def _take(self, state: LimitState, found: Found) -> bool:
        """Add points and what their exchange of like parts leads to; whether anything was new."""
        if self.around:
            begins = self.differ(_BEYOND * found.points)
            found = Found(found.points[:, begins], found.converged[begins])
        new = self.mixture.add(found)
        images = np.zeros((len(new), 0))
        for point in new[:, np.argsort(np.linalg.norm(new, axis=0))][:, :_ORBITS].T:
            if apart(point, images):
                place = np.argmin(np.linalg.norm(self.mixture.centres - point[:, None], axis=0))
                of_point = orbit(state, point, bool(self.mixture.converged[place]))
                self.mixture.add(of_point)
                images = np.concatenate([images, of_point.points], axis=1)
        return new.shape[1] > 0

    def draw(self, random: np.random.Generator, samples: int) -> tuple[Estimate, float, float]:
        """Share of units of the rare event, its effective samples and the mean weight of these units."""
        total, squares, cubes, hits, unit = 0.0, 0.0, 0.0, 0, 0.0
        for start in range(0, samples, TESTED):
            z = self.mixture.sample(random, min(TESTED, samples - start))
            seen = self.mixture.weights(z[:, self.differ(z)])
            if not unit and seen.any():
                unit = math.ldexp(1.0, math.frexp(float(seen.max()))[1])  # their squares would be 0 beyond 26 sd
            seen = seen / unit if unit else seen
            total, squares, cubes = (have + float((seen**k).sum()) for k, have in enumerate((total, squares, cubes), 1))
            hits += len(seen)
        if not hits:
            plain = _PLAIN + int(samples * self.mixture.plain)
            return clopper_pearson(self.hits, plain, 0.95), 0.0, math.inf
        if not total:  # beyond 38 standard deviations: below the smallest number
            return Estimate(0.0, 0.0, 0.0, np.finfo(float).tiny), 0.0, math.inf
        share = total / samples
        variance = max(0.0, squares / samples - share**2)
        error, deviate = math.sqrt(variance / (samples - 1)), deviate_of(0.95)
        third = cubes / samples - 3 * share * squares / samples + 2 * share**3
        skewness = third / variance**1.5 if variance > 0 else 0.0
        seen_as = share * unit, error * unit
        found = _widest(rare(*seen_as, deviate), skewed(*seen_as, skewness, samples, deviate))
        return found, total**2 / squares, squares / total * unit
