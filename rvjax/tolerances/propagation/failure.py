"""Rare failures: the share of units beyond a limit, down to parts per million and below."""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.tolerances.population.correlation import Correlation
from rvjax.tolerances.population.population import Population
from rvjax.tolerances.propagation.design_points import (
    BATCH,
    LANES,
    Found,
    LimitState,
    Units,
    design_points,
    without_slope,
)
from rvjax.tolerances.propagation.estimates import Estimate, deviate_of, wilson
from rvjax.tolerances.propagation.requirements import Limits
from rvjax.tolerances.propagation.responses import Response, by_name, by_response, response_names

_PILOT = BATCH // 2  # plain units that show where to start; as many are spread wider
_WIDE = (2.0, 3.0)  # spreads that reach failures which plain units do not foretell
_ROUNDS = 4  # of looking for failures that no point stands for yet
_APART = 0.8  # least distance of two points that both stand for themselves
_MOST_POINTS = 192
_FAR = 1e-4  # points less likely than this, beside the nearest, are left to their neighbours
_DEFENSIVE = 0.1  # share drawn about the middle: no weight exceeds its reciprocal
_SIMILAR = 0.5  # difference of reliability index
_FEWEST_EFFECTIVE = 100


@dataclasses.dataclass(frozen=True)
class FailureProbability:
    """How rarely a unit fails; fields have the structure of the response.

    Attributes:
        probability: `Estimate` of the share of units beyond the limits or without a valid value.
        reliability_index: distance of the nearest point of failure from the middle of the standard normal
            numbers; -Phi^-1(P) if the limit is flat. Negative if the middle itself fails, inf without a point.
        point: errors of that point, the most likely failure; None if none was found.
        evaluations: units evaluated in all; a value with its gradient counts as three.
        effective_samples: (sum w)^2 / sum w^2 of the weights of the failed units.
        points: points of failure that the sampling is centred at.
        status: "OK", or reasons to look twice, joined by ", ": "FEW_EFFECTIVE_SAMPLES" (below 100),
            "SEVERAL_POINTS" (of similar distance: the flat-limit figure Phi(-index) misses the others),
            "KINKED_POINT" (no slope at the nearest point: the index may be a little too large), "NO_POINT".
    """

    probability: Any
    reliability_index: Any
    point: Any
    evaluations: Any
    effective_samples: Any
    points: Any
    status: Any


def failure_probability(
    response: Response,
    tolerances: Any,
    requirement: Any,
    *,
    samples: int,
    seed: int,
    correlation: Correlation = None,
) -> FailureProbability:
    """Probability that a unit violates a requirement, by importance sampling about its design points.

    First the points of the failing region nearest to the middle of the random numbers are searched
    from units with a high response (the first-order reliability method; every limit has points of its
    own). Then units are drawn from unit normals centred there, each weighted by the ratio of the
    densities (Melchers 1989). Failures drawn far from every known point start further searches before
    the final draw: where all phases are equally bad, the points become a ring. A tenth of the units is
    drawn about the middle, so that no failure carries more than ten times its own share.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        requirement: `Requirement`, or a dict of them by name of the response, each judged alone; its target
            plays no part.
        samples: units of the final draw; the searches add some 10 000 to 40 000 evaluations.
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
            raise ValueError(f"requirement[{name!r}] = {item!r}: says nothing of one unit")
    found = {name: _probability(response, population, name, item, samples, seed) for name, item in required.items()}
    return by_name(FailureProbability, found)


def _probability(
    response: Response, population: Population, name: str, requirement: Limits, samples: int, seed: int
) -> dict[str, Any]:
    units, random = Units(response, population, name), np.random.default_rng(seed)
    points = _Points(units, requirement, population.numbers)
    points.explore(random)
    total, squares, hits = points.draw(random, samples)
    effective = total**2 / squares if squares > 0 else 0.0
    share = total / samples
    if not hits:
        estimate = dataclasses.replace(wilson(0, max(1, int(_DEFENSIVE * samples)), 0.95), error=0.0)
    else:
        error = math.sqrt(max(0.0, squares / samples - share**2) / (samples - 1))
        half = deviate_of(0.95) * error
        estimate = Estimate(share, error, max(0.0, share - half), min(1.0, share + half))
    reasons = points.reasons()
    if effective < _FEWEST_EFFECTIVE:
        reasons.insert(0, "FEW_EFFECTIVE_SAMPLES")
    return dict(
        probability=estimate,
        reliability_index=points.index,
        point=None if points.nearest is None else population.errors(jnp.asarray(points.nearest)),
        evaluations=units.evaluations,
        effective_samples=effective,
        points=points.centres.shape[1],
        status=", ".join(reasons) or "OK",
    )


class _Points:
    """The points of failure of all limits of one requirement, and the mixture of normals about them."""

    def __init__(self, units: Units, requirement: Limits, numbers: int) -> None:
        self.units, self.requirement = units, requirement
        sides = [(requirement.upper, 1.0), (requirement.lower, -1.0)]
        self.states = [LimitState(units, limit, sign) for limit, sign in sides if math.isfinite(limit)]
        self.centres = np.zeros((numbers, 0))
        self.converged = np.zeros(0, bool)
        self.middle_fails = bool(self.fails(units.values(np.zeros((numbers, 1))))[0])

    def fails(self, values: np.ndarray) -> np.ndarray:
        """Which values (nan for none) violate a limit."""
        return ~(self.requirement.margin(values) <= 0)

    @property
    def distances(self) -> np.ndarray:
        return np.linalg.norm(self.centres, axis=0)

    @property
    def nearest(self) -> np.ndarray | None:
        return self.centres[:, np.argmin(self.distances)] if self.centres.shape[1] else None

    @property
    def index(self) -> float:
        """Reliability index."""
        if not self.centres.shape[1]:
            return -math.inf if self.middle_fails else math.inf
        return float(self.distances.min()) * (-1.0 if self.middle_fails else 1.0)

    def reasons(self) -> list[str]:
        """What a reader should know about the points."""
        if not self.centres.shape[1]:
            return ["NO_POINT"]
        nearest = int(np.argmin(self.distances))
        alike = self.distances < self.distances[nearest] + _SIMILAR
        if self.converged[nearest]:  # then the others that no search ended at merely follow a bent limit
            alike &= self.converged
        found = ["SEVERAL_POINTS"] if alike.sum() > 1 else []
        if not self.converged[nearest]:
            found.append("KINKED_POINT")
        return found

    def explore(self, random: np.random.Generator) -> None:
        """Find the points: from plain units and from widely spread ones, then from failures far from all points."""
        pilot = random.standard_normal((len(self.centres), 2 * _PILOT))
        pilot[:, _PILOT::2] *= _WIDE[0]
        pilot[:, _PILOT + 1 :: 2] *= _WIDE[1]
        values = self.units.values(pilot)
        for state in self.states:
            # Nearest to the limit from the side of the middle; failing units, where only few do.
            order = np.argsort(np.nan_to_num(-state.g(values[:_PILOT]), nan=math.inf))
            self.add(design_points(state, pilot[:, order[:LANES]]))
            far = _PILOT + np.flatnonzero(state.g(values[_PILOT:]) > 0)
            self.add(design_points(state, pilot[:, far[:LANES]]))
        if np.isnan(values).any() and not self.middle_fails:
            self.add(without_slope(self.states[0], pilot[:, np.isnan(values)]))
        for _ in range(_ROUNDS):
            known = self.centres
            z, weights = self.sample(random, _PILOT)
            values = self.units.values(z)
            for state in self.states:
                # The heaviest failures are those that no point stands near.
                seen = np.flatnonzero(state.g(values) > 0)
                self.add(design_points(state, z[:, seen[np.argsort(-weights[seen])[:LANES]]]))
            if np.array_equal(self.centres, known):
                break

    def add(self, found: Found) -> None:
        """Keep points that stand apart, nearest first."""
        points = np.concatenate([self.centres, found.points], axis=1)
        converged = np.concatenate([self.converged, found.converged])
        distances = np.linalg.norm(points, axis=0)
        kept: list[int] = []
        for k in np.argsort(distances):
            likely = not kept or distances[k] ** 2 - distances[kept[0]] ** 2 < -2 * math.log(_FAR)
            if likely and len(kept) < _MOST_POINTS:
                gaps = np.linalg.norm(points[:, kept] - points[:, [k]], axis=0)
                if (gaps > _APART).all():
                    kept.append(int(k))
        self.centres, self.converged = points[:, kept], converged[kept]

    def sample(self, random: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Units (numbers, count) of the mixture and their weights, the ratio of the densities."""
        numbers, k = self.centres.shape
        centres = np.concatenate([np.zeros((numbers, 1)), self.centres], axis=1)
        likely = special.ndtr(-self.distances)
        shares = np.concatenate([[_DEFENSIVE], (1 - _DEFENSIVE) * likely / likely.sum()]) if k else np.ones(1)
        z = centres[:, random.choice(k + 1, count, p=shares)] + random.standard_normal((numbers, count))
        # log of the ratio phi(z - c)/phi(z) = c . z - |c|^2/2
        ratios = centres.T @ z - 0.5 * np.sum(centres**2, axis=0)[:, None]
        return z, np.exp(-special.logsumexp(ratios, b=shares[:, None], axis=0))

    def draw(self, random: np.random.Generator, samples: int) -> tuple[float, float, int]:
        """Sum of the weights of failed units, of their squares, and the number of these units."""
        total, squares, hits = 0.0, 0.0, 0
        for start in range(0, samples, BATCH):
            z, weights = self.sample(random, min(BATCH, samples - start))
            lost = weights[self.fails(self.units.values(z))]
            total, squares, hits = total + float(lost.sum()), squares + float((lost**2).sum()), hits + len(lost)
        return total, squares, hits
