"""Worst case: the range of a response over the box of all limits."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax._jax.kernels import in_blocks
from rvjax._jax.sizes import CORNERS
from rvjax.population import Population
from rvjax.records import PyTree
from rvjax.response import Response, by_name, evaluate, per_response, response_names
from rvjax.status import succeeded

_ALL_CORNERS = 12  # up to so many coordinates every corner is looked at
_INSIDE = 62  # points within the limits, mid-point included; with a corner they fill a block
_CLIMB = 24  # steps of all of them at once, only where slopes change sign
_FIRST, _LONGER, _SHORTER = 0.5, 2.0, 0.25  # step of a climb, in half-widths, and its change after success and failure
_NO_SLOPE = 1e-6  # part of the largest slope: rounding has a sign as well
_ROUNDS = 20  # gradient signs taken again; every round must improve, so this is a limit seldom met


@dataclasses.dataclass(frozen=True)
class WorstCase:
    """Range of a response over the limits; fields have its structure.

    Attributes:
        lower: smallest value found.
        upper: largest value found.
        at_lower: errors of the smallest value.
        at_upper: errors of the largest value.
        failed: looked-at points where the response failed; the range holds for the others.
        status: "OK": each slope has the same sign at 62 points within the limits, so the ends are at corners.
            "SLOPES_CHANGE_SIGN": the ends are the best of a search from these points and the corners; the true range
            may be wider. "ONE_CORNER": without `refine`, one corner was looked at for each end.
    """

    lower: PyTree
    upper: PyTree
    at_lower: PyTree
    at_upper: PyTree
    failed: PyTree
    status: PyTree


@checked
def worst_case(response: Response, tolerances: object, *, refine: bool = True) -> WorstCase:
    """Smallest and largest response when every error may lie anywhere between its limits.

    The search starts at the corner that the gradient signs at the mid-point point to. With `refine` it
    starts from the corners that the signs at 62 points spread over the limits point to (from all corners up to 12
    coordinates), takes the signs again and flips single coordinates until nothing improves. Where a slope changes its
    sign among the points, each of them climbs to an extremum nearby too. Exact for responses monotone in each error;
    otherwise the true range may be wider, and `status` says so. The limits of a Rayleigh vector are a disc of radius
    `upper`.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        refine: False: only the corner that the gradient at the mid-point points to.

    Returns:
        `WorstCase`.
    """
    population = Population.of(tolerances)
    names = response_names(response, population)
    search = _Search(response, population, names)
    found = {}
    for k, name in enumerate(names):
        (low, at_low, failed), (high, at_high, also) = (search.extreme(k, sign, refine) for sign in (-1.0, 1.0))
        status = "ONE_CORNER" if not refine else "SLOPES_CHANGE_SIGN" if search.bends(k) else "OK"
        places = dict(at_lower=search.errors(at_low), at_upper=search.errors(at_high))
        found[name] = dict(lower=-low, upper=high, failed=failed + also, status=status, **places)
    return by_name(WorstCase, found)


def slopes_change_sign(response: Response, tolerances: object) -> dict[str, bool]:
    """Mark the responses, by name, with a slope that changes its sign within the limits.

    Args:
        response: pure function of the errors of one unit.
        tolerances: record or dict with a `Tolerance` or None in each field.
    """
    population = Population.of(tolerances)
    names = response_names(response, population)
    search = _Search(response, population, names)
    return {name: search.bends(k) for k, name in enumerate(names)}


@dataclasses.dataclass(frozen=True)
class Extremes:
    """Both ends of the range of one response over the limits.

    Attributes:
        values: (2,) smallest and largest; nan where the response failed at any point that was looked at.
        slopes: (2, fields) their derivatives to the logarithms of the half-widths of all active fields.
    """

    values: np.ndarray
    slopes: np.ndarray


def extremes(response: Response, population: Population, names: tuple[str, ...], name: str) -> Extremes:
    """Return the range of one of the responses, and how it grows with the half-widths.

    At an end of the range the place within the limits is the best already: the end moves as the errors there do while
    the limits scale (envelope theorem).
    """
    search, k = _Search(response, population, names), names.index(name)
    values, slopes = [], []
    for sign in (-1.0, 1.0):
        top, place, failed = search.extreme(k, sign, True)
        _, gradient = search.look(place[None], k, sign)
        values.append(math.nan if failed else sign * top)
        slopes.append(sign * _scaling(population, place, gradient[0]))
    return Extremes(np.array(values), np.array(slopes))


def _scaling(population: Population, place: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Derivatives (fields,) of a response to the logarithms of the half-widths where unit coordinates stay in place."""
    here = _unit_errors(population, jnp.asarray(place))
    halved = population.with_half_widths({name: float(t.half_width) / 2 for name, t in population.active.items()})
    there = _unit_errors(halved, jnp.asarray(place))
    slopes = []
    for name, to_unit in population.by_field(gradient).items():
        tolerance = population.active[name]
        unit = float(tolerance.upper if tolerance.is_vector else tolerance.half_width)  # d error/d coordinate
        moved = 2 * np.asarray(here[name] - there[name])  # errors are linear in the half-width
        slopes.append(float(np.sum(to_unit * moved)) / unit if unit > 0 else 0.0)
    return np.array(slopes)


class _Search:
    """Ascent in unit coordinates u: box coordinates in [-1, 1], pairs of a vector in the unit disc."""

    def __init__(self, response: Response, population: Population, names: tuple[str, ...]) -> None:
        self.response, self.population, self.names = response, population, names
        pairs = [np.full(math.prod(t.shape), t.is_vector) for t in population.active.values()]
        self.in_disc = np.concatenate([np.zeros(0, bool), *pairs])
        self.failed = 0
        self._spread: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def errors(self, u: np.ndarray) -> PyTree:
        """Errors of unit coordinates."""
        return self.population.fill(_unit_errors(self.population, jnp.asarray(u)))

    def look(self, points: np.ndarray, k: int, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Values (nan where failed) and gradients of sign * response k at points (m, n)."""

        def of_block(points: np.ndarray) -> tuple[jax.Array, jax.Array]:
            return _values_and_gradients(self.response, self.population, jnp.asarray(points), k, names=self.names)

        values, gradients = in_blocks(of_block, CORNERS, points)
        self.failed += int(np.isnan(values).sum())
        return sign * values, np.nan_to_num(sign * gradients)

    def extreme(self, k: int, sign: float, refine: bool) -> tuple[float, np.ndarray, int]:
        """Largest sign * response k: value, place, and failed points on the way."""
        self.failed = 0
        n = len(self.in_disc)
        middle = np.zeros((1, n))
        if not refine or not n:
            value, gradient = self.look(middle, k, sign)
        if not n:
            return float(value[0]), middle[0], self.failed
        if refine:
            _, inside, gradient = self.spread(k)
            self.failed = int(np.isnan(inside).sum())  # at both ends alike
            starts = self.starts(sign * gradient)
        else:
            starts = self.corner(gradient)
        points, (values, gradients) = starts, self.look(starts, k, sign)
        if refine:
            points, values, gradients = self.by_signs(points, values, gradients, k, sign)
        if refine and self.bends(k):
            others, heights = self.climbed(k, sign)
            points, values = np.concatenate([points, others]), np.concatenate([values, heights])
        if np.isnan(values).all():
            return math.nan, points[0], self.failed
        best = int(np.nanargmax(values))
        place, top = points[best], float(values[best])
        if refine:
            place, top = self.by_flips(place, top, k, sign)
            place, top = self.inside(place, top, k, sign)
        return top, place, self.failed

    def corner(self, gradients: np.ndarray) -> np.ndarray:
        """Return the point of the box (and discs) that a linear response with these gradients prefers."""
        signs = np.where(gradients < 0, -1.0, 1.0)
        discs = gradients[:, self.in_disc].reshape(len(gradients), -1, 2)
        norms = np.linalg.norm(discs, axis=2, keepdims=True)
        along = np.divide(discs, norms, out=np.broadcast_to([1.0, 0.0], discs.shape).copy(), where=norms > 0)
        signs[:, self.in_disc] = along.reshape(len(gradients), -1)
        return signs

    def starts(self, gradients: np.ndarray) -> np.ndarray:
        """The mid-point, and all corners if few, else those that gradients (m, n) point to."""
        n = len(self.in_disc)
        if n <= _ALL_CORNERS and not self.in_disc.any():
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=n)))
        else:
            corners = self.corner(gradients)
        return np.concatenate([np.zeros((1, n)), corners])

    def spread(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (m, n) that fill the limits evenly, the mid-point first; values (m,) and gradients (m, n) there."""
        if k not in self._spread:
            from scipy.stats import qmc  # slow to import

            drawn = qmc.Sobol(len(self.in_disc), seed=0).random(CORNERS)[: _INSIDE - 1]
            points = np.concatenate([np.zeros((1, drawn.shape[1])), self.project(2 * drawn - 1)])
            self._spread[k] = points, *self.look(points, k, 1.0)
        return self._spread[k]

    def bends(self, k: int) -> bool:
        """True if a slope changes its sign within the limits, or that along a disc turns by more than 90 degrees."""
        if not len(self.in_disc):
            return False
        _, _, gradients = self.spread(k)
        seen = np.where(np.abs(gradients) > _NO_SLOPE * np.abs(gradients).max(), gradients, 0.0)
        both = (seen.max(axis=0) > 0) & (seen.min(axis=0) < 0)
        discs = seen[:, self.in_disc].reshape(len(seen), -1, 2)
        along = (discs * discs.sum(axis=0)).sum(axis=2)
        return bool(both[~self.in_disc].any() or (along < 0).any())

    def climbed(self, k: int, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Places (m, n) and values (m,) after steps along the gradient from all points, each as long as it succeeds."""
        points, values, gradients = self.spread(k)
        values, gradients, step = sign * values, sign * gradients, np.full(len(points), _FIRST)
        for _ in range(_CLIMB):
            size = np.abs(gradients).max(axis=1)
            ways = np.divide(gradients, size[:, None], out=np.zeros_like(gradients), where=size[:, None] > 0)
            trial = self.project(points + step[:, None] * ways)
            new, slopes = self.look(trial, k, sign)
            better = new > values
            points, gradients = (np.where(better[:, None], a, b) for a, b in ((trial, points), (slopes, gradients)))
            values, step = np.where(better, new, values), step * np.where(better, _LONGER, _SHORTER)
        return points, values

    def by_signs(
        self, points: np.ndarray, values: np.ndarray, gradients: np.ndarray, k: int, sign: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Take gradient signs at each corner until no corner improves."""
        for _ in range(_ROUNDS):
            after = self.corner(gradients)
            new, slopes = self.look(after, k, sign)
            better = np.isnan(values) & ~np.isnan(new) | (new > values)
            if not better.any():
                break
            points, gradients = (np.where(better[:, None], a, b) for a, b in ((after, points), (slopes, gradients)))
            values = np.where(better, new, values)
        return points, values, gradients

    def by_flips(self, place: np.ndarray, top: float, k: int, sign: float) -> tuple[np.ndarray, float]:
        """Move single coordinates (or the vector pair they belong to) across until none improves."""
        n = len(place)
        for _ in range(2 * n):
            flipped, before = np.where(np.eye(n, dtype=bool), -place, place), top
            values, gradients = self.look(flipped, k, sign)
            corners = self.corner(gradients)
            values = np.concatenate([values, self.look(corners, k, sign)[0]])
            place, top = _better(place, top, np.concatenate([flipped, corners]), values)
            if top == before:
                break
        return place, top

    def inside(self, place: np.ndarray, top: float, k: int, sign: float) -> tuple[np.ndarray, float]:
        """Projected gradient steps of many lengths at once, for an extremum away from the corners."""
        for _ in range(_ROUNDS):
            _, gradient = self.look(place[None], k, sign)
            size = float(np.abs(gradient).max())
            if size == 0:
                break
            steps, before = 2.0 ** -np.arange(20)[:, None] * gradient / size, top
            candidates = self.project(place[None] + steps)
            place, top = _better(place, top, candidates, self.look(candidates, k, sign)[0])
            if top == before:
                break
        return place, top

    def project(self, points: np.ndarray) -> np.ndarray:
        """Nearest points within the box and discs."""
        inside = np.clip(points, -1.0, 1.0)
        discs = points[:, self.in_disc].reshape(len(points), -1, 2)
        norms = np.maximum(np.linalg.norm(discs, axis=2, keepdims=True), 1.0)
        inside[:, self.in_disc] = (discs / norms).reshape(len(points), -1)
        return inside


def _better(place: np.ndarray, top: float, candidates: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the best candidate, or the old place where none is better."""
    best = int(np.argmax(np.nan_to_num(values, nan=-np.inf)))
    return (candidates[best], float(values[best])) if values[best] > top else (place, top)


def _unit_errors(population: Population, u: jax.Array) -> dict[str, jax.Array]:
    """Errors of the active fields from unit coordinates (n,)."""
    placed = {}
    for name, own in population.by_field(u).items():
        tolerance = population.active[name]
        value = tolerance.upper * own if tolerance.is_vector else tolerance.middle + tolerance.half_width * own
        placed[name] = jnp.asarray(value)
    return placed


@per_response(static=("names",))
def _values_and_gradients(
    response: Response, population: Population, points: jax.Array, k: int, *, names: tuple[str, ...]
) -> tuple[jax.Array, jax.Array]:
    """Value k (nan where the unit failed) and its gradient in unit coordinates at points (m, n)."""

    def value(u: jax.Array) -> tuple[jax.Array, jax.Array]:
        values, status = evaluate(response, population.fill(_unit_errors(population, u)))
        return jnp.stack([values[name] for name in names])[k], status

    (found, status), gradients = jax.vmap(jax.value_and_grad(value, has_aux=True), in_axes=-1)(points.T)
    return jnp.where(succeeded(status), found, jnp.nan), gradients
