"""Responses of a sample of units at points of a region round the allocated tolerances, and functions through them.

Slopes and bends of a costly output: derivatives of exact units, corrected by a regression on units at random points.

    y_i(x) = y_i(0) + sum_k (1 + a_k) g_ik x_k + sum_k (b_k + c_k |g_ik|) x_k^2

The derivatives g_ik are those of unit i at x = 0. The factors a, b and c are common to all units, by least squares on
the same units at other places of the region: two random places and one where all half-widths move together.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from rvjax._jax.blocks import calls
from rvjax.population import Population, Tolerance
from rvjax.response import BLOCK, Part, elements, is_costly, respond

COSTLY_UNITS = 768  # three calls of the gradients' program
PLACES = 2  # random ones of each unit
_RIDGE = 1e-4  # of the number of equations, in units of the standard deviation

Columns = dict[tuple[int, ...], np.ndarray]
"""(k,): slopes, (j, k): bends, each (units,) in the unit of the response."""


def errors_of(population: Population, z: np.ndarray) -> np.ndarray:
    """Errors (elements, units) of units with random numbers z (numbers, units)."""
    return np.asarray(elements(population, jnp.asarray(z)), float)


def regressed(
    part: Part,
    population: Population,
    moved: Callable[[np.ndarray], Mapping[str, Tolerance]],
    width: np.ndarray,
    z: np.ndarray,
    rng: np.random.Generator,
) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
    """Values (units,) at x = 0 and slopes and bends, each by output.

    Args:
        part: costly outputs.
        population: at x = 0.
        moved: x (p,) -> tolerances of the fields that move; the errors of a unit are linear in x.
        width: 1 where x is a half-width, 0 where it is a place (p,).
        z: random numbers of the units (numbers, units).
        rng: of the places.
    """
    units, count = z.shape[1], len(width)

    def errors_at(x: np.ndarray) -> np.ndarray:
        return errors_of(population.with_tolerances(moved(x)), z)

    here = errors_at(np.zeros(count))
    rates = np.stack([(errors_at(row) - errors_at(-row)) / 2 for row in np.eye(count)])
    base, _, state = part.of_elements(population, here)
    places = [rng.uniform(-1, 1, (count, units)) for _ in range(PLACES)] + [np.outer(width, rng.uniform(-1, 1, units))]
    seen = []
    for x in places:
        seen.append(part.of_elements(population, here + np.einsum("ku,keu->eu", x, rates))[0])
    values_by_name, columns = {}, {}
    for number, name in enumerate(part.names):
        weights = np.zeros((len(part.names), units))
        weights[number] = 1.0
        slopes = part.slopes_of_elements(population, here, state, weights)
        rise = np.nan_to_num(np.einsum("keu,eu->ku", rates, slopes), posinf=0.0, neginf=0.0)
        rest = [row[number] - base[number] for row in seen]
        values_by_name[name] = base[number]
        columns[name] = _corrected(base[number], rise, places, rest)
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
class Region:
    """Responses of chosen units at points of the region, and the quadratic functions through them.

    Attributes:
        part: outputs.
        population: of the allocated tolerances.
        parameters: what may move.
        z: random numbers of the units (numbers, units).
    """

    part: Part
    population: Population
    parameters: Sequence[Parameter]
    z: np.ndarray

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

    def at(self, x: np.ndarray, units: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Responses (units,), nan where one failed.

        Args:
            x: parameters (p,) in reaches.
            units: their numbers; by default all.
        """
        population = self.population.with_tolerances(self.tolerances(x))
        if is_costly(self.part.response):
            z = self.z if units is None else self.z[:, units]
            return dict(zip(self.part.names, self.part.of_elements(population, errors_of(population, z))[0]))
        count = self.z.shape[1]
        lanes = [jnp.asarray(self.z[:, some]) for some in calls(count, BLOCK)]
        found = [respond(self.part.response, population, some)[0] for some in lanes]
        values = {n: np.concatenate([np.asarray(each[n], float) for each in found])[:count] for n in self.part.names}
        return {name: column[... if units is None else units] for name, column in values.items()}

    def fitted(self, rng: np.random.Generator) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
        """Values as allocated, and slopes and bends by response."""
        if is_costly(self.part.response):
            width = np.array([not p.place for p in self.parameters], float)
            found = regressed(self.part, self.population, self.tolerances, width, self.z, rng)
        else:
            found = self._quadratic()
        base, columns = found
        felt = {
            name: {key: c for key, c in own.items() if np.sqrt(np.mean(c**2)) > FELT * (np.nanstd(base[name]) or 1.0)}
            for name, own in columns.items()
        }
        return base, felt

    def _quadratic(self) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
        """The quadratic functions through the responses at both ends of each parameter, and of pairs."""
        names, count = self.part.names, len(self.parameters)
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
        width = np.array([0.0 if p.place else 1.0 for p in self.parameters])
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
