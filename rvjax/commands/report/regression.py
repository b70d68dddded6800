"""Slopes and bends of a costly output: derivatives of exact units, corrected by a regression on units at random points.

    y_i(x) = y_i(0) + sum_k (1 + a_k) g_ik x_k + sum_k (b_k + c_k |g_ik|) x_k^2

The derivatives g_ik are those of unit i at x = 0. The factors a, b and c are common to all units, by least squares on
the same units at other places of the region: two random places and one where all half-widths move together.
"""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np

from rvjax.population import Population, Tolerance
from rvjax.response import Part, elements, gradients

UNITS = 768  # three calls of the gradients' program
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
    base, _ = part.of_elements(population, here)
    places = [rng.uniform(-1, 1, (count, units)) for _ in range(PLACES)] + [np.outer(width, rng.uniform(-1, 1, units))]
    seen = []
    for x in places:
        values, _ = part.of_elements(population, here + np.einsum("ku,keu->eu", x, rates))
        seen.append(values)
    values_by_name, columns = {}, {}
    for number, name in enumerate(part.names):
        weights = np.zeros((len(part.names), units))
        weights[number] = 1.0
        slopes = gradients(part.response, population, here, weights, part.names)[1]
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
