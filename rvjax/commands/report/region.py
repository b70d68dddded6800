"""Responses of a sample of units at points of a region round the allocated tolerances, and functions through them.

Slopes and bends of a costly output: derivatives of exact units, corrected by a regression on units at random points.

    y_i(x) = y_i(0) + sum_k (1 + a_k) g_ik x_k + sum_k (b_k + c_k |g_ik|) x_k^2

The derivatives g_ik are those of unit i at x = 0. The factors a, b and c are common to all units, by least squares on
the same units at other places of the region: two random places and one where all half-widths move together.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from rvjax._jax.sizes import calls
from rvjax.population import Population, Tolerance
from rvjax.response import BLOCK, Part, elements, is_costly, respond

COSTLY_UNITS = 768  # three calls of the gradients' program
PLACES = 2  # random ones of each unit
_RIDGE = 1e-4  # of the number of equations, in units of the standard deviation

Columns = dict[tuple[int, ...], np.ndarray]
"""(k,): slopes, (j, k): bends, each (units,) in the unit of the response."""


@dataclasses.dataclass(frozen=True)
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


@dataclasses.dataclass(frozen=True, eq=False)
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

    def tolerances(self, x: np.ndarray) -> dict[str, Tolerance]:
        """Tolerances of the fields that move, x in reaches."""
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
        return made

    def at(self, x: np.ndarray) -> Population:
        """The population at x (p,)."""
        return self.population.with_tolerances(self.tolerances(x))

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


def regressed(part: Part, sample: Sample) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
    """Values (units,) at x = 0 and slopes and bends, each by output.

    Args:
        part: costly outputs.
        sample: of units.
    """
    base, _, state = part.of_elements(sample.population, sample.here)
    seen = [part.of_elements(sample.population, errors)[0] for _, errors in sample.places]
    values_by_name, columns = {}, {}
    for number, name in enumerate(part.names):
        weights = np.zeros((len(part.names), sample.z.shape[1]))
        weights[number] = 1.0
        rise = sample.rise(part.slopes_of_elements(sample.population, sample.here, state, weights))
        rest = [row[number] - base[number] for row in seen]
        values_by_name[name] = base[number]
        columns[name] = _corrected(base[number], rise, [x for x, _ in sample.places], rest)
    return values_by_name, columns


def _corrected(base: np.ndarray, rise: np.ndarray, places: list[np.ndarray], rest: list[np.ndarray]) -> Columns:
    """Columns of one output: its derivatives `rise` (p, units), and its changes `rest` at the places."""
    sd, count = float(base[np.isfinite(base)].std()) or 1.0, len(rise)
    terms = [np.concatenate([rise * x / sd, x**2, np.abs(rise) * x**2 / sd]) for x in places]
    rows = np.concatenate(terms, axis=1)
    target = np.concatenate([(change - (rise * x).sum(0)) / sd for change, x in zip(rest, places)])
    good = np.isfinite(target)
    rows, target = rows[:, good], target[good]
    a, b, c = np.linalg.solve(rows @ rows.T + _RIDGE * len(target) * np.eye(len(rows)), rows @ target).reshape(3, count)
    found: Columns = {(k,): (1 + a[k]) * rise[k] for k in range(count)}
    return found | {(k, k): sd * b[k] + c[k] * np.abs(rise[k]) for k in range(count)}


_KNOWN = 0.01  # of a standard deviation: a smaller misfit at a probe needs no mixed bends
FELT = 2e-3  # of a standard deviation: columns that move no unit by more, root mean square, are left out
_MIXED = 12  # parameters of a response, the strongest, that get mixed bends


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """Responses of chosen units at points of the region, and the quadratic functions through them.

    Attributes:
        part: outputs.
        sample: of units.
    """

    part: Part
    sample: Sample

    def at(
        self, x: np.ndarray, units: np.ndarray | None = None, errors: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Responses (units,), nan where one failed.

        Args:
            x: parameters (p,) in reaches.
            units: their numbers; by default all.
            errors: of these units at x (elements, units), where the caller has them.
        """
        if is_costly(self.part.response):
            errors = self.sample.errors(x, units) if errors is None else errors
            return dict(zip(self.part.names, self.part.of_elements(self.sample.population, errors)[0]))
        population, z = self.sample.at(x), self.sample.z
        lanes = [jnp.asarray(z[:, some]) for some in calls(z.shape[1], BLOCK)]
        found = [respond(self.part.response, population, some)[0] for some in lanes]
        values = {
            n: np.concatenate([np.asarray(each[n], float) for each in found])[: z.shape[1]] for n in self.part.names
        }
        return {name: column[... if units is None else units] for name, column in values.items()}

    def fitted(self) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
        """Values as allocated, and slopes and bends by response."""
        base, columns = regressed(self.part, self.sample) if is_costly(self.part.response) else self._quadratic()
        felt = {
            name: {key: c for key, c in own.items() if np.sqrt(np.mean(c**2)) > FELT * (np.nanstd(base[name]) or 1.0)}
            for name, own in columns.items()
        }
        return base, felt

    def _quadratic(self) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
        """The quadratic functions through the responses at both ends of each parameter, and of pairs."""
        names, count = self.part.names, len(self.sample.parameters)
        unit = np.eye(count)
        base = self.at(np.zeros(count))
        ends = [(self.at(row), self.at(-row)) for row in unit]
        columns: dict[str, Columns] = {name: {} for name in names}
        for name, (k, (up, down)) in itertools.product(names, enumerate(ends)):
            # A unit that fails at one end goes on as from the other; where it fails at both, nothing is known.
            rise = np.where(np.isnan(up[name]), base[name] - down[name], up[name] - base[name])
            fall = np.where(np.isnan(down[name]), rise, base[name] - down[name])
            rise, fall = np.nan_to_num(rise), np.nan_to_num(fall)
            columns[name] |= {(k,): (rise + fall) / 2, (k, k): (rise - fall) / 2}
        spread = {name: float(base[name].std()) or 1.0 for name in names}
        pairs = self._pairs(base, columns, spread)
        for i, k in sorted(set().union(*pairs.values())):
            both, against = self.at(unit[i] + unit[k]), self.at(-unit[i] - unit[k])
            for name in (name for name in names if (i, k) in pairs[name]):
                seen = both[name] + against[name] - 2 * base[name]
                alone = 2 * (columns[name][i, i] + columns[name][k, k])
                columns[name][i, k] = np.nan_to_num((seen - alone) / 2)
        return base, columns

    def _pairs(
        self, base: dict[str, np.ndarray], columns: dict[str, Columns], spread: dict[str, float]
    ) -> dict[str, set[tuple[int, int]]]:
        """Pairs of parameters whose mixed bends each response needs: none where the sum of the single ones will do."""
        width = np.array([0.0 if p.place else 1.0 for p in self.sample.parameters])
        probes = [width, (1 - width) * 0.5 + width * np.where(np.arange(len(width)) % 4 < 2, 1.0, -1.0)]
        seen, found = [self.at(x) for x in probes], {}
        for name, own in columns.items():
            misses = [
                y[name] - base[name] - sum(c * np.prod(x[list(key)]) for key, c in own.items())
                for x, y in zip(probes, seen)
            ]
            strength = [float(np.sqrt(np.mean(own[k,] ** 2 + own[k, k] ** 2))) for k in range(len(width))]
            felt = [k for k, size in enumerate(strength) if size > 5 * FELT * spread[name]]
            strongest = sorted(sorted(felt, key=lambda k: -strength[k])[:_MIXED])
            bent = max(float(np.sqrt(np.nanmean(miss**2))) for miss in misses) > _KNOWN * spread[name]
            found[name] = set(itertools.combinations(strongest, 2)) if bent else set()
        return found
