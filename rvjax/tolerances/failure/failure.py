"""Rare failures: the share of units beyond a limit, down to parts per million and below.

Points of failure that like parts have in common: one found point, exchanged, turned and mirrored.

The response is evaluated at each image; no symmetry of the failing region is assumed.
"""

import dataclasses
import math
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from rvjax._jax.arguments import checked
from rvjax.population import Correlation, Estimate, Population, deviate_of, rare, skewed, student, wilson
from rvjax.records import PyTree
from rvjax.response import Response, by_name, by_response, response_names
from rvjax.roots import bisect
from rvjax.tolerances.failure.form import BATCH, LANES, Found, LimitState, Units, design_points
from rvjax.tolerances.failure.importance_sampling import ISLANDS, Mixture, Sequential, apart, sequential
from rvjax.tolerances.requirements.kinds import Limits

_SAME = 0.01  # failure begins at an image within this of where it begins at the point, relative: parts of one kind
_ALIKE = 0.25  # the same for parts that differ a little
_HALVINGS = 6
_MATTERS = 0.3  # of the largest number of a point
_FEW = 8  # numbers that matter; with more, a change of one sign is no separate failure mode


def orbit(state: LimitState, point: np.ndarray, converged: bool) -> Found:
    """Images of a point (numbers,) at which failure begins as well.

    Images: the largest number exchanged with each other one, few large numbers of the other sign one at a time, fields
    turned along axes of one length together (pins round a ring), and each of these through the origin. Where one
    number alone makes the point, the parts may differ a little: failure then begins elsewhere on the ray to the image.
    """
    matter = np.flatnonzero(np.abs(point) > _MATTERS * np.abs(point).max())
    images = np.stack(list(_images(state.units.population, point, matter)), axis=1)
    images = np.unique(np.concatenate([images, -images], axis=1), axis=1)
    exact = state.fails((1 - _SAME) * images) != state.fails((1 + _SAME) * images)
    edges = images[:, :0] if len(matter) > 1 else _begins(state, images[:, ~exact])
    points = np.concatenate([images[:, exact], edges], axis=1)
    return Found(points, np.arange(points.shape[1]) < (exact.sum() if converged else 0))


def _begins(state: LimitState, images: np.ndarray) -> np.ndarray:
    """Points where failure begins on the rays to images (numbers, n), where these are near the images."""
    near, far = np.full(images.shape[1], 1 - _ALIKE), np.full(images.shape[1], 1 + _ALIKE)
    inside = state.fails(near * images)
    begins = inside != state.fails(far * images)
    images, near, far, inside = images[:, begins], near[begins], far[begins], inside[begins]
    return images * bisect(lambda at: state.fails(at * images) == inside, near, far, steps=_HALVINGS)[1]


def _images(population: Population, point: np.ndarray, matter: np.ndarray) -> Iterator[np.ndarray]:
    largest = int(np.argmax(np.abs(point)))
    for other in range(len(point)):
        image = point.copy()
        image[[largest, other]] = image[[other, largest]]
        yield image
    for number in matter if len(matter) <= _FEW else []:
        image = point.copy()
        image[number] *= -1
        yield image
    lengths = {length for tolerance in population.active.values() for length in tolerance.shape}
    for length in sorted(lengths - {1}):
        for turn in range(1, length):
            yield _turned(population, point, length, turn)


def _turned(population: Population, point: np.ndarray, length: int, turn: int) -> np.ndarray:
    """Every field with an axis of this length, turned along it."""
    image, start = point.copy(), 0
    for name, tolerance in population.active.items():
        stop, size = start + math.prod(tolerance.shape), population.numbers_by_field[name]
        if length in tolerance.shape:
            own = point[start:stop].reshape(tolerance.shape)
            image[start:stop] = np.roll(own, turn, axis=tolerance.shape.index(length)).ravel()
        start += size
    return image


_ROUNDS = 12  # most batches of searches
_ORBITS = 4  # new points of a batch whose images are tried
_HEAVY = 3.0  # mean weight of failed units of the second estimate, over that of the first, which makes them disagree
_FEWEST_EFFECTIVE = 100


@dataclasses.dataclass(frozen=True)
class FailureProbability:
    """Probability of failure of a unit; fields have the structure of the response.

    Attributes:
        probability: `Estimate` of the share of units beyond the limits or without a valid value.
        reliability_index: distance of the nearest point of failure from the origin of the standard normal
            numbers; -Phi^-1(P) if the limit is flat. Negative if the origin itself fails, inf without a point.
        point: errors of that point, the most likely failure; None if none was found.
        evaluations: units evaluated in all; a value with its gradient counts as three.
        effective_samples: (sum w)^2 / sum w^2 of the weights of the failed units; of the good ones if the origin fails.
        points: points of failure that the sampling is centred at.
        second: `Estimate` of the same probability by subset simulation, which needs neither points nor
            slopes; its standard error is mostly 15 to 30 %.
        status: "OK", or warnings, joined by ", ": "FEW_EFFECTIVE_SAMPLES" (below 100),
            "ESTIMATES_DISAGREE" (the second differs, or its failures lie where draws of the first are rare; with
            either of these two, the interval of the probability contains both intervals),
            "SEVERAL_POINTS" (of similar distance: the flat-limit value Phi(-index) misses the others),
            "KINKED_POINT" (no slope at the nearest point: the index may be a little too large), "NO_POINT".
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
    tolerances: PyTree,
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
    Where the two estimates disagree, the status is "ESTIMATES_DISAGREE" and the interval contains both.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        requirement: `Requirement`, or a dict of them by name of the response, each evaluated separately;
            its target has no effect.
        samples: units of the final draw; the second estimate and the searches add some 20 000 to 80 000 evaluations.
        seed: of the random numbers.
        correlation: {(field or element, field or element): correlation of their z}.

    Returns:
        `FailureProbability`. A unit without a valid value fails.

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
        search = _Search(Units(response, population, name), item)
        found[name] = _searched(search, np.random.default_rng(seed), samples)
    return by_name(FailureProbability, found)


def _searched(search: "_Search", random: np.random.Generator, samples: int) -> dict[str, PyTree]:
    """The fields of the result from the second estimate, the search and draws about its points."""
    second = sequential(search.differ, search.numbers, random)
    search.explore(random, second.failing)
    mixture = search.mixture
    first, effective, typical = search.draw(random, samples)
    reasons = mixture.reasons()
    disagree, few = _disagree(first, second, mixture, typical), effective < _FEWEST_EFFECTIVE
    reasons = ["FEW_EFFECTIVE_SAMPLES"] * few + ["ESTIMATES_DISAGREE"] * disagree + reasons
    shown = _both(first, second.probability) if (disagree or few) and first.value > 0 else first
    distance = float(mixture.distances.min()) if mixture.count else math.inf
    population = search.units.population
    return dict(
        probability=_complement(shown) if search.middle_fails else shown,
        reliability_index=-distance if search.middle_fails else distance,
        point=population.errors(jnp.asarray(mixture.centres[:, mixture.nearest])) if mixture.count else None,
        evaluations=search.units.evaluations,
        effective_samples=effective,
        points=mixture.count,
        second=_complement(second.probability) if search.middle_fails else second.probability,
        status=", ".join(reasons) or "OK",
    )


def _complement(share: Estimate) -> Estimate:
    return Estimate(1 - share.value, share.error, 1 - share.upper, 1 - share.lower)


def _disagree(first: Estimate, second: Sequential, mixture: Mixture, typical: float) -> bool:
    """True if the two estimates differ, or if draws of the first are rare near failed units of the second."""
    if not (first.value and second.probability.value):
        return first.value != second.probability.value
    # By ratios: a low estimate has a low error.
    apart = abs(math.log(first.value / second.probability.value))
    errors = math.hypot(first.error / first.value, second.probability.error / second.probability.value)
    if apart > student(0.99, ISLANDS) * errors:
        return True
    return float(mixture.weights(second.failing).mean()) > _HEAVY * typical


def _both(first: Estimate, second: Estimate) -> Estimate:
    """The first value with an interval that contains both intervals, and the error of that interval."""
    both = _widest(first, second)
    return dataclasses.replace(both, error=max(first.error, (both.upper - both.lower) / (2 * deviate_of(0.95))))


def _widest(first: Estimate, second: Estimate) -> Estimate:
    """The first value with an interval that contains both intervals."""
    return Estimate(first.value, first.error, min(first.lower, second.lower), max(first.upper, second.upper))


class _Search:
    """The points of failure of all limits of one requirement, and the draws about them.

    Where the origin itself fails, good units are the rare ones, and the search is for these.
    """

    def __init__(self, units: Units, requirement: Limits) -> None:
        self.units, self.requirement, self.numbers = units, requirement, units.population.numbers
        sides = [(requirement.upper, 1.0), (requirement.lower, -1.0)]
        self.states = [LimitState(units, limit, sign) for limit, sign in sides if math.isfinite(limit)]
        self.mixture = Mixture(self.numbers)
        self.middle_fails = False
        self.middle_fails = bool(self.differ(np.zeros((self.numbers, 1)))[0])

    def differ(self, z: np.ndarray) -> np.ndarray:
        """Mark units (numbers, n) whose failure differs from the origin; a unit without a value fails."""
        good = self.requirement.margin(self.units.values(z)) <= 0
        return good if self.middle_fails else ~good

    def explore(self, random: np.random.Generator, differing: np.ndarray) -> None:
        """Find the points: from plain units near a limit, then from failures far from every point.

        Failures come from the second estimate and from draws of the current mixture; each starts searches in
        proportion to its weight. Ends when a batch of searches finds nothing new.
        """
        plain = random.standard_normal((len(differing), BATCH))
        values = self.units.values(plain)
        for state in self.states:
            order = np.argsort(np.nan_to_num(np.abs(state.g(values)), nan=math.inf))
            self._take(state, design_points(state, plain[:, order[:LANES]], differing))
        for _ in range(_ROUNDS):
            drawn = self.mixture.sample(random, BATCH)
            pool = np.concatenate([differing, drawn[:, self.differ(drawn)]], axis=1)
            if not pool.shape[1]:
                break
            weights = self.mixture.weights(pool)
            weights = weights if weights.any() else np.ones(len(weights))  # all beyond 38 standard deviations
            count = min(LANES, pool.shape[1])
            starts = pool[:, random.choice(pool.shape[1], count, replace=False, p=weights / weights.sum())]
            values, new = self.units.values(starts), False
            for state in self.states:
                # A unit without a value fails at every limit.
                lost = np.isnan(values) if state is self.states[0] else False
                own = np.full(count, True) if self.middle_fails else (state.g(values) > 0) | lost
                new |= self._take(state, design_points(state, starts[:, own], pool))
            if not new:
                break

    def _take(self, state: LimitState, found: Found) -> bool:
        """Add points and what their exchange of like parts leads to; whether anything was new."""
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
        """Share of units that differ from the origin, its effective samples and the mean weight of these units."""
        total, squares, cubes, hits, unit = 0.0, 0.0, 0.0, 0, 0.0
        for start in range(0, samples, BATCH):
            z = self.mixture.sample(random, min(BATCH, samples - start))
            seen = self.mixture.weights(z[:, self.differ(z)])
            if not unit and seen.any():
                unit = math.ldexp(1.0, math.frexp(float(seen.max()))[1])  # their squares would be 0 beyond 26 sd
            seen = seen / unit if unit else seen
            total, squares, cubes = (have + float((seen**k).sum()) for k, have in enumerate((total, squares, cubes), 1))
            hits += len(seen)
        if not hits:
            plain = max(1, int(samples * self.mixture.plain))
            return dataclasses.replace(wilson(0, plain, 0.95), error=0.0), 0.0, math.inf
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
