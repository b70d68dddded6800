"""Probability of a rare event by subset simulation (Au and Beck 2001): the event is widened, then narrowed in steps.

Three ways to widen an event F of standard normal numbers z, each from a widening at which the event is common:

- `Spreads` outwards, F(s) = {z: s z in F} with s > 1: events far from the origin.
- `Spreads` inwards, s < 1: events around the origin.
- `Levels`, F(t) = {z: distance within the limit > t} with t < 0: thin shells, small regions anywhere.

Spreads use only whether a unit belongs to the event: no slope, no point, no distance to the limit. Each run ends with
units of the event, each part in proportion to its probability. A run never adds what is not there: a part that no
widened event leads to is missing.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy import special

from rvjax.population import Estimate, clopper_pearson, rare, student

ISLANDS = 8
"""Independent populations: the spread of their estimates gives the error of the mean."""
EACH = 128
"""Units of an island."""
OUTWARDS = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
"""Spreads tried in turn until the event is common."""
INWARDS = (0.5, 0.25, 2.0**-4, 2.0**-8, 2.0**-16, 2.0**-32)
"""The same for an event around the origin; too small a spread costs one more step."""
_ENOUGH = 0.1  # share of units in the event that ends the widening
_KEPT = 0.2  # share of the units that should belong to the next event too
_LEAST = 0.08  # with fewer the step is taken back half-way
_CLOSE, _CLOSE_INWARDS = 0.01, 0.001  # steps no shorter than this; relative: a ball of 100 numbers needs 1.6 %
_MOVES = 3  # of every unit after each step
_MOST_STEPS = 32
_HIGH, _LOW = 0.5, 0.25  # shares of accepted moves that make the next ones longer, shorter
_INDEPENDENT = 16  # units of an island that count as one: most descend from a few
_FLOOR = 1e-20  # of the squares of spreads, relative to the largest
_CONFIDENCE = 0.95  # of the intervals
_LONGEST = 16.0  # most ratio of two spreads inwards: the first step may say little about the next

Event = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Sequential:
    """Result of subset simulation.

    Attributes:
        probability: of the event; its error from the spread between the islands. Where no unit was found, the upper
            end is that of as many units without widening, by Clopper and Pearson.
        units: (numbers, n) units of the event, sampled (nearly) as they occur; none where none was found.
    """

    probability: Estimate
    units: np.ndarray


class Spreads:
    """Events of units spread wider, or less wide, than they are made."""

    end = 1.0  # the event itself

    def __init__(self, event: Event, tried: tuple[float, ...], wider: Event | None = None) -> None:
        """Event of units (numbers, n), and the spreads that are tried in turn.

        Args:
            event: itself.
            tried: spreads.
            wider: event at all other spreads, if it costs less there.
        """
        self.event, self.tried, self.wider = event, tried, wider or event
        self.shaped = tried[0] < 1  # the event may be thin: moves follow the spread of its units
        self._ratio = 0.0  # of the last step inwards; 0 before it

    def begin(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """First of the tried spreads at which the event is common, else the best of them."""
        hit, spread = self.within(z, 1.0), 1.0
        for other in self.tried:
            if hit.mean() >= _ENOUGH:
                break
            trial = self.within(z, other)
            if trial.sum() > hit.sum():
                hit, spread = trial, other
        return spread, hit

    def within(self, z: np.ndarray, t: float) -> np.ndarray:
        """Mark the units whose z times the spread belongs to the event."""
        return self.event(z) if t == 1 else self.wider(t * z)

    def after(self, z: np.ndarray, t: float, share: float, last: float) -> float:
        """Spread at which `_KEPT` should remain, if the limit is flat (outwards) or shares a power of the spread."""
        if t > 1:
            distance = -special.ndtri(min(share, 0.4)) * t
            return max(1.0, distance / -special.ndtri(_KEPT * min(share, 0.4)))
        if self._ratio:
            power = max(-math.log(last), 1e-6) / math.log(self._ratio)
        else:
            power = float(len(z)) if last < 0.9 else 1.0  # of a ball in all numbers; from too small a spread on
        self._ratio = min(_LONGEST, math.exp(min(-math.log(_KEPT) / power, 700.0)), 1 / t)
        return 1.0 if self._ratio == 1 / t else self._ratio * t

    def between(self, wide: float, narrow: float) -> float | None:
        """Geometric mean."""
        if abs(wide - narrow) <= (_CLOSE if wide > 1 else _CLOSE_INWARDS * wide):
            return None
        self._ratio = math.sqrt(self._ratio) if wide < 1 else 0.0
        return math.sqrt(wide * narrow)


class Levels:
    """Events of units whose distance within the limit exceeds a level, which rises to 0."""

    end, shaped = 0.0, True

    def __init__(self, distance: Event, event: Event) -> None:
        """Distance (n,) within the event of units (numbers, n), negative outside; and the event, which counts."""
        self.distance, self.event = distance, event

    def begin(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """All units."""
        return -math.inf, np.full(z.shape[1], True)

    def within(self, z: np.ndarray, t: float) -> np.ndarray:
        """Mark the units beyond the level; at the end those of the event."""
        return self.distance(z) > t if t < 0 else self.event(z)

    def after(self, z: np.ndarray, t: float, share: float, last: float) -> float:
        """The level that `_KEPT` of the units exceed; the end where many have the same distance."""
        level = float(np.quantile(self.distance(z), 1 - _KEPT))
        return level if t < level < 0 else 0.0

    def between(self, wide: float, narrow: float) -> float | None:
        """None: the level is a quantile already."""
        return None


def sequential(path: Spreads | Levels, numbers: int, random: np.random.Generator) -> Sequential:
    """Probability of an event by subset simulation along a path of wider events.

    A region that ends further out, on the ray through its units, is found outwards only as far as it does not.

    Args:
        path: of events.
        numbers: random numbers of a unit.
        random: where the units come from.
    """

    def within(z: np.ndarray, t: float) -> np.ndarray:
        return path.within(z.reshape(numbers, ISLANDS * EACH), t).reshape(ISLANDS, EACH)

    first_units = z = random.standard_normal((numbers, ISLANDS, EACH))
    shares, noise, reach = np.ones(ISLANDS), 0.0, 0.5
    t, first = path.begin(z.reshape(numbers, ISLANDS * EACH))
    hit = first.reshape(ISLANDS, EACH)
    for _ in range(_MOST_STEPS):
        shares *= hit.mean(axis=1)
        noise += float((~hit).mean() / max(1, hit.sum()))
        if not shares.any():
            break
        alive = shares > 0
        z, last = _resampled(z, hit, random), float(hit[alive].mean())
        shapes = _shapes(z, alive) if path.shaped else []
        for _ in range(_MOVES):
            trial = _moved(z, random.standard_normal(z.shape), reach, shapes)
            taken = within(trial, t)
            z = np.where(taken, trial, z)
            reach = min(1.0, 1.4 * reach) if taken.mean() > _HIGH else reach / 1.4 if taken.mean() < _LOW else reach
        if t == path.end:
            return Sequential(_estimate(shares, noise), z[:, alive].reshape(numbers, EACH * alive.sum()))
        wide, t = t, path.after(z[:, alive].reshape(numbers, -1), t, float(shares.mean()), last)
        hit = within(z, t) & alive[:, None]
        while hit.mean() < _LEAST and (half := path.between(wide, t)) is not None:
            t = half
            hit = within(z, t) & alive[:, None]
    seen = clopper_pearson(int(within(first_units, path.end).sum()), ISLANDS * EACH, _CONFIDENCE)
    return Sequential(Estimate(0.0, 0.0, 0.0, seen.upper), np.zeros((numbers, 0)))


Shape = tuple[np.ndarray, np.ndarray]


def _shapes(z: np.ndarray, alive: np.ndarray) -> list[Shape]:
    """Principal axes of units, and the spreads along these, for the moves of each half of the islands.

    They come from the other half: moves that depend on the units they move have a bias.
    """
    found = []
    for other in (slice(ISLANDS // 2, None), slice(0, ISLANDS // 2)):
        islands = np.arange(ISLANDS)[other][alive[other]]
        units = z[:, islands if islands.size else alive].reshape(len(z), -1)
        found.append(shape_of(units))
    return found


def shape_of(units: np.ndarray) -> Shape:
    """Principal axes (numbers, numbers) of units (numbers, n), and their spreads along these.

    Spreads that differ no more than those of so few units of a ball are averaged, by ratios: a thin event at any
    angle to the numbers stays thin.
    """
    numbers, n = units.shape
    square, axes = np.linalg.eigh(np.atleast_2d(np.cov(units)))
    logs = np.log(np.maximum(square, max(_FLOOR * square.max(), np.finfo(float).tiny)))
    chance, seen = numbers * _INDEPENDENT / n, float(logs.var())
    kept = max(0.0, 1 - chance / seen) if seen > 0 and chance < 1 else 0.0
    return axes, np.exp((logs.mean() + kept * (logs - logs.mean())) / 2)


def _moved(z: np.ndarray, random: np.ndarray, reach: float, shapes: list[Shape]) -> np.ndarray:
    """Units moved by standard normal numbers of their shape so that they stay standard normal.

    Args:
        z: (numbers, islands, n).
        random: of the same shape.
        reach: of the moves, 0 to 1; in spreads of the units where these have a shape.
        shapes: of each half of the islands, or none.
    """
    if not shapes:
        return math.sqrt(1 - reach**2) * z + reach * random
    moved = []
    for (axes, sizes), own, by in zip(shapes, np.split(z, 2, axis=1), np.split(random, 2, axis=1)):
        part = np.minimum(1.0, reach * sizes)[:, None, None]
        along = np.sqrt(1 - part**2) * np.tensordot(axes.T, own, 1) + part * np.tensordot(axes.T, by, 1)
        moved.append(np.tensordot(axes, along, 1))
    return np.concatenate(moved, axis=1)


def together(one: Sequential, other: Sequential, random: np.random.Generator) -> Sequential:
    """Both of two events that exclude each other, with units in proportion.

    Args:
        one: of one event.
        other: of the other.
        random: which units stay.
    """
    found = [item for item in (one, other) if item.units.shape[1]]
    if len(found) < 2:
        return found[0] if found else one
    value = sum(item.probability.value for item in found)
    error = math.hypot(*(item.probability.error for item in found))
    kept = []
    for item in found:
        own = max(1, round(ISLANDS * EACH * item.probability.value / value))
        kept.append(item.units[:, random.permutation(item.units.shape[1])[:own]])
    return Sequential(rare(value, error, student(_CONFIDENCE, ISLANDS)), np.concatenate(kept, axis=1))


def _resampled(z: np.ndarray, hit: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """As many units as before from those of the event of each island, all alike; dead islands stay as they are."""
    picks = []
    for row in hit:
        seeds = np.flatnonzero(row) if row.any() else np.arange(row.size)
        picks.append(random.permutation(np.resize(random.permutation(seeds), row.size)))
    return np.stack([z[:, k, pick] for k, pick in enumerate(picks)], axis=1)


def _estimate(shares: np.ndarray, noise: float) -> Estimate:
    """The mean over all islands; its error no less than were all units independent (`noise`: its square, relative).

    No noise: all units of every step belonged to the event, of which one more might not.
    """
    value, spread = float(shares.mean()), float(shares.std(ddof=1)) / math.sqrt(ISLANDS)
    error = max(spread, value * (math.sqrt(noise) or 1 / (ISLANDS * EACH)))
    return rare(value, error, student(_CONFIDENCE, ISLANDS))
