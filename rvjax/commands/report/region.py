"""Quadratic regression of responses on parameters of the tolerances, near the allocated ones.

With the derivatives g_ik of unit i at x = 0 and u_k = g_ik x_k, its response is

    y_i(x) = y_i(0) + sum_k (1 + a_k) u_k + sum_k (b_k + c_k |g_ik|) x_k^2 + sum_{j < k} d_jk u_j u_k.

The factors a, b, c and d are common to all units, by least squares on the same units at other places of the region:
two random places and one where all half-widths move together. A linear response is exact.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from rvjax.population import Population, Tolerance
from rvjax.response import Part, elements

PLACES = 2  # random ones of each unit
FELT = 2e-3  # of a standard deviation: columns that move no unit by more, root mean square, are left out
_RIDGE = 1e-4, 1e-3  # of the number of equations, in units of the standard deviation: of a, b and c; of d

Columns = dict[tuple[int, ...], np.ndarray]
"""(k,): slopes, (j, k): bends, each (units,) in the unit of the response."""


@dataclass(frozen=True)
class Parameter:
    """A half-width, or the place of the limits of an error: mid-point, or lower limit where the distribution begins.

    Attributes:
        field: name of the error.
        place: False for its half-width.
        centre: as allocated, unit of the error.
        reach: how far it may move within the region, either way.
    """

    field: str
    place: bool
    centre: float
    reach: float


@dataclass(frozen=True, eq=False)
class Sample:
    """Units with the same random numbers at every point of the region; their errors are linear in x.

    Attributes:
        population: of the allocated tolerances.
        parameters: what may move.
        z: random numbers of the units (numbers, units).
        seed: of the places of the regression.
    """

    population: Population
    parameters: Sequence[Parameter]
    z: np.ndarray
    seed: int

    def at(self, x: np.ndarray) -> Population:
        """The population at x (p,), in reaches."""
        made: dict[str, Tolerance] = {}
        for p, step in zip(self.parameters, map(float, x)):
            if not step:
                continue
            tolerance = made.get(p.field, self.population.active[p.field])
            if p.place:
                way = step * p.reach
                made[p.field] = tolerance.replace(lower=tolerance.lower + way, upper=tolerance.upper + way)
            else:
                made[p.field] = tolerance.scaled(p.centre + step * p.reach)  # also of a clearance below 0
        return self.population.with_tolerances(made)

    def errors(self, x: np.ndarray, units: np.ndarray | None = None) -> np.ndarray:
        """Errors (elements, units) at x.

        Args:
            x: parameters (p,) in reaches.
            units: their numbers; by default all.
        """
        z = self.z if units is None else self.z[:, units]
        return np.asarray(elements(self.at(x), jnp.asarray(z)), float)

    @cached_property
    def here(self) -> np.ndarray:
        """Errors as allocated (elements, units)."""
        return self.errors(np.zeros(len(self.parameters)))

    @cached_property
    def rates(self) -> list[tuple[slice, np.ndarray]]:
        """Elements that each parameter moves, and how far (elements, units)."""
        sizes = {name: math.prod(t.shape) for name, t in self.population.active.items()}
        ends = dict(zip(sizes, np.cumsum(list(sizes.values()))))
        found = []
        for p, row in zip(self.parameters, np.eye(len(self.parameters))):
            own = slice(ends[p.field] - sizes[p.field], ends[p.field])
            found.append((own, (self.errors(row)[own] - self.errors(-row)[own]) / 2))
        return found

    @cached_property
    def places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Places of each unit (p, units): random ones, and one where all half-widths move; errors there."""
        rng, shape = np.random.default_rng(self.seed), (len(self.parameters), self.z.shape[1])
        width = np.array([not p.place for p in self.parameters], float)
        made = [rng.uniform(-1, 1, shape) for _ in range(PLACES)] + [np.outer(width, rng.uniform(-1, 1, shape[1]))]
        found = []
        for x in made:
            errors = self.here.copy()
            for (own, rate), step in zip(self.rates, x):
                errors[own] += rate * step
            found.append((x, errors))
        return found

    def rise(self, slopes: np.ndarray) -> np.ndarray:
        """Derivatives (p, units) along the parameters, from those to the elements (elements, units)."""
        found = [np.einsum("eu,eu->u", rate, slopes[own]) for own, rate in self.rates]
        return np.nan_to_num(np.stack(found), posinf=0.0, neginf=0.0)


def fitted(parts: Sequence[Part], sample: Sample) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
    """Values (units,) at x = 0, nan where a unit failed, and slopes and bends, each by output.

    Args:
        parts: outputs that are solved together.
        sample: of units.
    """
    values, columns = dict[str, np.ndarray](), dict[str, Columns]()
    for part in parts:
        base, _, state = part.of_elements(sample.population, sample.here)
        seen = [part.of_elements(sample.population, errors)[0] for _, errors in sample.places]
        for number, name in enumerate(part.names):
            weights = np.zeros(base.shape)
            weights[number] = 1.0
            rise = sample.rise(part.slopes_of_elements(sample.population, sample.here, state, weights))
            rest = [row[number] - base[number] for row in seen]
            values[name] = base[number]
            columns[name] = _regressed(base[number], rise, [x for x, _ in sample.places], rest)
    return values, columns


def _regressed(base: np.ndarray, rise: np.ndarray, places: list[np.ndarray], rest: list[np.ndarray]) -> Columns:
    """Columns of one output: its derivatives `rise` (p, units), and its changes `rest` at the places."""
    sd, count = float(base[np.isfinite(base)].std()) or 1.0, len(rise)
    pairs = list(itertools.combinations(range(count), 2))
    first, second = np.array(pairs, int).reshape(-1, 2).T
    terms = []
    for x in places:
        along = rise * x / sd
        terms.append(np.concatenate([along, x**2, np.abs(rise) * x**2 / sd, along[first] * along[second]]))
    rows = np.concatenate(terms, axis=1)
    target = np.concatenate([(change - (rise * x).sum(0)) / sd for change, x in zip(rest, places)])
    good = np.isfinite(target)
    rows, target = rows[:, good], target[good]
    ridge = len(target) * np.repeat(_RIDGE, [3 * count, len(pairs)])
    found = np.linalg.solve(rows @ rows.T + np.diag(ridge), rows @ target)
    a, b, c, d = np.split(found, [count, 2 * count, 3 * count])
    made: Columns = {(k,): (1 + a[k]) * rise[k] for k in range(count)}
    made |= {(k, k): sd * b[k] + c[k] * np.abs(rise[k]) for k in range(count)}
    made |= {(j, k): factor * rise[j] * rise[k] / sd for (j, k), factor in zip(pairs, d)}
    return {key: column for key, column in made.items() if np.sqrt(np.mean(column**2)) > FELT * sd}
