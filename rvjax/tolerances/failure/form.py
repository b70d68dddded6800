"""Design points of rare failures: points of the failing region nearest to the origin of all random numbers.

The first-order reliability method (Hasofer and Lind 1974; Rackwitz and Fiessler 1978) in the space of the
standard normal numbers z, where the density falls with |z| alone.

Like parts have points of failure in common: one found point, exchanged, turned and mirrored. The response is evaluated
at each image; no symmetry of the failing region is assumed.
"""

import dataclasses
import math
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.sizes import SEARCHES, TESTED, padded
from rvjax.population import Population
from rvjax.response import Response, evaluate, per_response, respond
from rvjax.roots import bisect
from rvjax.status import Status, succeeded

_GRADIENT_COST = 3  # evaluations that a value with its gradient counts for
_STEPS = 40  # trials of a search, backtracking included
_SHORTEST = 2.0**-8  # of a backtracked step; a kink lets no search come closer
_ON_LIMIT = 1e-5  # distance from the limit of a converged search, relative to 1 + |z|
_ALIGNED = 1e-3  # angle between z and the slope there; the distance is wrong by its square
_BISECTIONS = 20
_SHRUNK = 8  # failed units without slope that are walked to the edge of failure
_TURNS = 3  # of assigning known failures to points and points to their means


@dataclasses.dataclass
class Units:
    """One value of a response as a function of the random numbers of units; counts what it evaluates."""

    response: Response
    population: Population
    name: str
    evaluations: int = 0

    def values(self, z: np.ndarray) -> np.ndarray:
        """Values (n,) of units (numbers, n), nan where a unit has none; an infinite value is a value."""
        self.evaluations += z.shape[1]
        found = np.full(z.shape[1], np.nan)
        for start in range(0, z.shape[1], TESTED):
            part = z[:, start : start + TESTED]
            given = jnp.asarray(padded(part, TESTED, axis=1, fill=0), jnp.result_type(float))
            values, status = respond(self.response, self.population, given)
            numbers, ended = np.asarray([values[name] for name in sorted(values)], float), np.asarray(status)
            infinite = (ended == int(Status.NONFINITE)) & ~np.isnan(numbers).any(axis=0)  # such as a life without load
            valid = np.where(succeeded(ended) | infinite, np.asarray(values[self.name], float), np.nan)
            found[start : start + TESTED] = valid[: part.shape[1]]
        return found

    def slopes(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (n,) and gradients (numbers, n), nan where a unit has no value."""
        self.evaluations += _GRADIENT_COST * z.shape[1]
        given = jnp.asarray(z, jnp.result_type(float))
        value, gradient = slopes(self.response, self.population, given, name=self.name)
        return np.asarray(value, float), np.asarray(gradient, float)


@per_response(static=("name",))
def slopes(response: Response, population: Population, z: jax.Array, *, name: str) -> tuple[jax.Array, jax.Array]:
    """Values (n,) of one name and their gradients (numbers, n) at z (numbers, n), nan where a unit has no value."""

    def value(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        values, status = evaluate(response, population.errors(z))
        return values[name], status

    (found, status), gradient = jax.vmap(jax.value_and_grad(value, has_aux=True), in_axes=-1, out_axes=-1)(z)
    good = succeeded(status)
    return jnp.where(good, found, jnp.nan), jnp.where(good, gradient, jnp.nan)


@dataclasses.dataclass(frozen=True)
class LimitState:
    """One limit: a unit fails where g = sign (value - limit) > 0, or where it has no value."""

    units: Units
    limit: float
    sign: float

    def g(self, values: np.ndarray) -> np.ndarray:
        """Distance of values beyond the limit."""
        return self.sign * (values - self.limit)

    def fails(self, z: np.ndarray) -> np.ndarray:
        """Mark the failing units (numbers, n)."""
        return ~(self.g(self.units.values(z)) <= 0)

    def slopes(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """g (n,) and its gradient (numbers, n)."""
        value, gradient = self.units.slopes(z)
        return self.g(value), self.sign * gradient


@dataclasses.dataclass(frozen=True)
class Found:
    """Points of a limit (numbers, n), and which of them are design points: nearest to 0 in their neighbourhood."""

    points: np.ndarray
    converged: np.ndarray


def design_points(state: LimitState, starts: np.ndarray, failing: np.ndarray) -> Found:
    """The limit's nearest points to 0, found from starts (numbers, n <= `SEARCHES`), with points near the starts.

    Where a search ends at a kink, the edge of failure on its ray replaces it. Starts without a slope (plateaus, units
    without value), and failed starts whose search leads away from all failures (corners), lose the numbers without
    effect. Known failures (numbers, m) near them give the centre of their region.
    """
    if not starts.shape[1]:
        return Found(starts, np.zeros(0, bool))
    points, converged, first = _search(state, starts)
    middle_fails = state.fails(np.zeros((len(starts), 1)))[0]
    sloped = np.isfinite(first).all(axis=0)
    # The first steps stay near their starts: they follow a limit that bends away from its design point.
    ends = np.stack([np.where(np.isfinite(points).all(axis=0), 1.2 * points, starts), 1.2 * first])
    ends = np.where(sloped & np.stack([~converged, sloped])[:, None], ends, np.nan)
    beyond = state.fails(np.concatenate(list(ends), axis=1)).reshape(2, -1) != middle_fails
    beyond &= np.isfinite(ends).all(axis=1)
    flat = starts[:, ~(converged | beyond.any(axis=0))]
    ends = np.concatenate([end[:, kept] for end, kept in zip(ends, beyond)], axis=1)
    if flat.shape[1] and not middle_fails:
        flat = _shrunk(state, flat[:, state.fails(flat)][:, :_SHRUNK])
        centres = 1.2 * _middles(flat, failing)
        ends = np.concatenate([ends, flat, centres[:, state.fails(centres)]], axis=1)
    edges = _edges(state, ends, middle_fails)
    kept = np.concatenate([points[:, converged], edges], axis=1)
    return Found(kept, np.arange(kept.shape[1]) < converged.sum())


def _shrunk(state: LimitState, failed: np.ndarray) -> np.ndarray:
    """Failed units (numbers, n) whose numbers that do not matter are 0."""
    z = failed
    for j in range(len(z)):
        trial = z.copy()
        trial[j] = 0.0
        z = np.where(state.fails(trial), trial, z)
    return z


def _middles(centres: np.ndarray, failing: np.ndarray) -> np.ndarray:
    """Means of the known failures (numbers, m) that belong to each centre (numbers, n), found in turns."""
    for _ in range(_TURNS if failing.shape[1] and centres.shape[1] else 0):
        logs = centres.T @ failing - 0.5 * np.sum(centres**2, axis=0)[:, None]
        belong = special.softmax(logs, axis=0)
        whole = belong.sum(axis=1)
        centres = np.where(whole > 1, failing @ belong.T / np.maximum(whole, 1), centres)
    return centres


def _edges(state: LimitState, ends: np.ndarray, middle_fails: bool) -> np.ndarray:
    """Points where failure begins (or ends) on the rays from 0 to `ends` (numbers, n), which differ from 0 in it."""
    near, far = np.zeros(ends.shape[1]), np.ones(ends.shape[1])
    return ends * bisect(lambda at: state.fails(ends * at) == middle_fails, near, far, steps=_BISECTIONS)[1]


def _search(state: LimitState, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """End of each search, True if it is a design point, and the point after its first full step.

    A step goes to the point of the linearised limit nearest to 0, shortened until the merit |z|^2/2 + c |g|
    falls (Zhang and Der Kiureghian 1995).
    """
    n = starts.shape[1]
    z = padded(starts, SEARCHES, axis=1)
    (g, slope), step = state.slopes(z), np.ones(SEARCHES)
    first = goal = _goal(z, g, slope)[0]
    for _ in range(_STEPS):
        goal, size = _goal(z, g, slope)
        converged = _converged(z, g, slope)
        done = converged | ~np.isfinite(goal).all(axis=0) | (step < _SHORTEST)
        if done[:n].all():
            break
        trial = np.where(done, z, z + step * (goal - z))
        g_trial, slope_trial = state.slopes(trial)
        # c > |z| / |slope| makes the step a descent; the same c on both sides of the comparison.
        c = 2 * np.maximum(np.linalg.norm(z, axis=0), np.linalg.norm(goal, axis=0)) / size
        before = 0.5 * np.sum(z**2, axis=0) + c * np.abs(g)
        after = 0.5 * np.sum(trial**2, axis=0) + c * np.abs(g_trial)
        better = ~done & np.isfinite(slope_trial).all(axis=0) & (after < before)
        z, slope = np.where(better, trial, z), np.where(better, slope_trial, slope)
        g, step = np.where(better, g_trial, g), np.where(better, 1.0, step / 2)
    return z[:, :n], _converged(z, g, slope)[:n], first[:, :n]


def _goal(z: np.ndarray, g: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rackwitz and Fiessler 1978: z' = (slope . z - g) slope / |slope|^2, nan without slope; and |slope|."""
    slope = np.where(np.isfinite(slope), slope, np.nan)
    square = np.sum(slope**2, axis=0)
    square = np.where((square > 0) & np.isfinite(g), square, np.nan)
    g = np.where(np.isfinite(g), g, np.nan)
    return slope * (np.sum(slope * z, axis=0) - g) / square, np.sqrt(square)


def _converged(z: np.ndarray, g: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """On the limit, and z along the slope; false where anything is nan."""
    slope = np.where(np.isfinite(slope), slope, np.nan)
    size, length = np.linalg.norm(slope, axis=0), np.linalg.norm(z, axis=0)
    on_limit = np.abs(g) <= _ON_LIMIT * (1 + length) * size
    along = np.abs(np.sum(slope * z, axis=0))
    return on_limit & (size > 0) & (size * length - along <= 0.5 * _ALIGNED**2 * size * length)


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
