"""Units of a costly response, solved at one vector of decisions and followed along their gradients from there.

A unit keeps its standard normal numbers, so half-widths, mid-points and numbers of the design move its errors e and its
numbers d by known amounts: v + g (e' - e) + h (d' - d). The gradients g, h are those of the unit itself for the units
that are nearest to their limit, which decide a quantile; the others move by the mean gradient of these.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from rvjax._jax.blocks import PULLED
from rvjax.population import Population
from rvjax.response import elements
from rvjax.tolerances.optimum.units import Units

SOLVED = 512
"""Units of each part of the response that are solved at a new anchor: those that are nearest to their limits."""

_NARROW = 10.0  # largest over least value, of values that follow in proportion


@dataclasses.dataclass(frozen=True, eq=False)
class Anchor:
    """Units of a sample where those that decide are solved.

    Attributes:
        x: the vector of decisions.
        numbers: (elements and numbers, n) errors and numbers of the design of the units.
        values: {response: (n,)}.
        sloped: {response: units with gradients}.
        slopes: {response: gradients of these (elements and numbers, m)}.
    """

    x: np.ndarray
    numbers: np.ndarray
    values: dict[str, np.ndarray]
    sloped: dict[str, np.ndarray]
    slopes: dict[str, np.ndarray]

    def at(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Values (n,) by name with other errors and numbers (elements and numbers, n)."""
        moved = np.ascontiguousarray((numbers - self.numbers).T)
        found = {}
        for name, values in self.values.items():
            slopes, units = self.slopes[name], self.sloped[name]
            by = moved @ _mean(slopes)
            by[units] = np.einsum("ne,en->n", moved[units], slopes)
            found[name] = values * np.exp(by / values) if self._narrow(name) else values + by
        return found

    def gradients(self, name: str, units: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Gradients (elements and numbers, k) of units with other errors and numbers (elements and numbers, k)."""
        slopes, mine = self.slopes[name], self.sloped[name]
        place = np.full(len(self.values[name]), -1)
        place[mine] = np.arange(len(mine))
        found = np.repeat(_mean(slopes)[:, None], len(units), axis=1)
        known = place[units] >= 0
        found[:, known] = slopes[:, place[units][known]]
        if self._narrow(name):
            moved = numbers - self.numbers[:, units]
            found = found * np.exp(np.einsum("en,en->n", found, moved) / self.values[name][units])
        return found

    def _narrow(self, name: str) -> bool:
        """True if values follow in proportion: stiffness and lives are powers of the numbers of a design."""
        valid = self.values[name][np.isfinite(self.values[name])]
        return len(valid) > 0 and 0 < float(valid.max()) < _NARROW * float(valid.min())


class AnchoredUnits(Units):
    """Units in the tails that follow from an anchor where there is one."""

    anchor: Anchor | None = None
    sloped = PULLED
    """Units of each response with gradients."""
    _latest: tuple[bytes, np.ndarray, dict[str, np.ndarray]] | None = None

    def drop(self, x: np.ndarray, z: np.ndarray, away: dict[str, np.ndarray]) -> None:
        """Solve the units that are nearest to their limits at a vector, and follow all from there.

        Args:
            x: the vector.
            z: (numbers, n) of the units.
            away: {response: distances (n,) from its limit}.
        """
        values = {name: row.copy() for name, row in self.values(x, z, "tails").items()}
        population = self._decisions.population(x)
        for part in self.parts if self.anchor is not None else ():
            names = [name for name in part.names if name in away]
            if names:
                units = nearest(np.min([away[name] for name in names], axis=0), SOLVED)
                rows = self._solved(part, population, z[:, units])
                self.evaluated += len(units) // len(self.parts)
                for name, row in zip(part.names, rows):
                    if name in values:
                        values[name][units] = row
        numbers = _numbers(population, z)
        count, sloped, slopes = len(population.values or {}), dict[str, np.ndarray](), dict[str, np.ndarray]()
        for name, row in away.items():
            units = nearest(np.where(np.isfinite(values[name]), row, np.inf), self.sloped)
            own = super()._gradients(population, numbers[: len(numbers) - count, units], {name: np.ones(len(units))})
            good = np.isfinite(own).all(axis=0)
            sloped[name], slopes[name] = units[good], own[:, good]
        self.anchor = Anchor(x, numbers, {name: values[name] for name in away}, sloped, slopes)

    def values(self, x: np.ndarray, z: np.ndarray, what: str) -> dict[str, np.ndarray]:
        """Values (n,) by name of units with these z, nan where one failed."""
        if what != "tails" or not self._costly:
            return super().values(x, z, what)
        if self.anchor is not None:
            return self.anchor.at(_numbers(self._decisions.population(x), z))
        if self._latest is None or self._latest[0] != x.tobytes() or self._latest[1] is not z:
            self._latest = x.tobytes(), z, super().values(x, z, what)
        return self._latest[2]

    def _gradients(
        self, population: Population, errors: np.ndarray, pulled: dict[str, np.ndarray], units: np.ndarray | None = None
    ) -> np.ndarray:
        """Gradients (elements and numbers, n) of sums of responses, with weights (n,) by name."""
        if self.anchor is None or units is None:
            return super()._gradients(population, errors, pulled)
        numbers = np.concatenate([errors, _free(population, errors.shape[1])])
        found = np.zeros_like(numbers)
        for name, weights in pulled.items():
            found += self.anchor.gradients(name, units, numbers) * weights
        return found


def nearest(away: np.ndarray, count: int) -> np.ndarray:
    """The units with the least distances.

    Args:
        away: (n,) distances.
        count: of the units, at most.
    """
    return np.sort(np.argsort(away, kind="stable")[:count])


def _mean(slopes: np.ndarray) -> np.ndarray:
    """Mean over units; 0 without any."""
    return slopes.sum(axis=1) / max(slopes.shape[1], 1)


def _numbers(population: Population, z: np.ndarray) -> np.ndarray:
    """Errors of units, and their numbers of the design, in the order of their names (elements and numbers, n)."""
    errors = np.asarray(elements(population, np.asarray(z, jnp.result_type(float))), float)
    return np.concatenate([errors, _free(population, z.shape[1])])


def _free(population: Population, count: int) -> np.ndarray:
    """Numbers of the design of each unit (numbers, n)."""
    rows = [np.full((1, count), float(value)) for _, value in sorted((population.values or {}).items())]
    return np.concatenate([np.zeros((0, count)), *rows])
