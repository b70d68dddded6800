"""Units of a costly response, solved at one vector of decisions and followed along their gradients from there.

A unit keeps its standard normal numbers, so half-widths, mid-points and numbers of the design move its errors e and its
numbers d by known amounts: v + g (e' - e) + h (d' - d). The gradients g, h are those of the unit itself for the units
that are nearest to their limit, which decide a quantile; the others move by the mean gradient of these.

Units of an allocation with design variables: their values and gradients at one vector of decisions.
"""

import dataclasses
import hashlib
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Population
from rvjax.response import (
    BLOCK,
    LANES,
    Part,
    Response,
    elements,
    elements_and_rates,
    gradients,
    is_costly,
    parts,
    respond,
)  # fmt: skip
from rvjax.status import succeeded
from rvjax.tolerances.batch.checkpoint import describe
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.codesign.decisions import Decisions

Weights = dict[str, np.ndarray]  # of units, by name of the response


class Units:
    """Values of units and their derivatives; what a memo holds is not computed again."""

    def __init__(self, response: Response, decisions: Decisions, wanted: set[str], memo: Memo | None) -> None:
        self.parts = [p for p in parts(response, decisions.base) if wanted & set(p.names)] if wanted else []
        self.evaluated = 0
        self._decisions, self._memo = decisions, memo
        self._costly = is_costly(response)

    def values(self, x: np.ndarray, z: np.ndarray, what: str) -> dict[str, np.ndarray]:
        """Values (n,) by name of units with these z, nan where one failed."""
        population = self._decisions.population(x)
        found: dict[str, np.ndarray] = {}
        for part in self.parts:
            found |= dict(zip(part.names, self._solved(part, population, z)))
        self.evaluated += z.shape[1] if what != "centre" else 1
        if what != "centre" and len(found) > 1:
            failed = np.any([np.isnan(row) for row in found.values()], axis=0)
            found = {name: np.where(failed, np.nan, row) for name, row in found.items()}
        return found

    def _solved(self, part: Part, population: Population, z: np.ndarray) -> np.ndarray:
        """Values (k, n) of a part of the response."""

        def compute() -> np.ndarray:
            if self._costly:
                values, status = part.solve(population, z)
            else:
                padded = z[:, np.resize(np.arange(z.shape[1]), -(-z.shape[1] // BLOCK) * BLOCK)]
                blocks = np.split(padded, padded.shape[1] // BLOCK, axis=1)
                found = [respond(part.response, population, jnp.asarray(b, jnp.result_type(float))) for b in blocks]
                rows = [np.stack([np.asarray(values[name], float) for name in part.names]) for values, _ in found]
                values = np.concatenate(rows, axis=1)[:, : z.shape[1]]
                status = np.concatenate([np.asarray(flags) for _, flags in found])[: z.shape[1]]
            return np.where(np.asarray(succeeded(status)) & np.isfinite(values), values, np.nan)

        if self._memo is None:
            return compute()
        about = repr((part.names, sorted(describe(population, {}).items()))).encode()
        return self._memo.recall({"design": hashlib.sha256(about + z.tobytes()).hexdigest()}, compute)

    def _gradients(
        self, population: Population, errors: np.ndarray, pulled: dict[str, np.ndarray], units: np.ndarray | None = None
    ) -> np.ndarray:
        """Gradients (elements and numbers, n) of sums of responses, with weights (n,) by name."""
        total = np.zeros((errors.shape[0] + len(population.values or {}), errors.shape[1]))
        for part in self.parts:
            if not set(part.names) & set(pulled):
                continue
            nothing = np.zeros(errors.shape[1])
            cotangents = np.stack([pulled.get(name, nothing) for name in part.names])

            def compute(part: Part = part, cotangents: np.ndarray = cotangents) -> np.ndarray:
                return gradients(part.response, population, errors, cotangents, part.names)[1]

            if self._memo is None:
                total += compute()
            else:
                about = repr((part.names, sorted((population.values or {}).items()))).encode()
                weighted = hashlib.sha256(about + errors.tobytes() + cotangents.tobytes()).hexdigest()
                total += self._memo.recall({"gradients of": weighted}, compute)
        self.evaluated += errors.shape[1]
        return total

    def slopes(
        self, x: np.ndarray, population: Population, z: np.ndarray, several: list[tuple[np.ndarray, Weights]]
    ) -> list[np.ndarray]:
        """Derivatives (n,) of weighted sums of responses to the vector of decisions, each of its own units.

        Args:
            x: the vector.
            population: with these decisions.
            z: (numbers, n) of a sample.
            several: units (m,) of the sample, and {response: weights (m,)}, of each sum.
        """
        if self._costly:  # each solves its own part of the response
            return [self.slope(x, population, z[:, units], pulled, units) for units, pulled in several]
        ends = np.cumsum([0, *(len(units) for units, _ in several)])
        parts = [slice(*both) for both in itertools.pairwise(ends)]
        names = sorted({name for _, pulled in several for name in pulled})
        weights = {name: np.zeros(ends[-1]) for name in names}
        for part, (_, pulled) in zip(parts, several):
            for name, own in pulled.items():
                weights[name][part] = own
        units = np.concatenate([units for units, _ in several])
        return self._sums(x, population, z[:, units], weights, None, parts)

    def slope(
        self,
        x: np.ndarray,
        population: Population,
        z: np.ndarray,
        pulled: Weights,
        units: np.ndarray | None = None,
    ) -> np.ndarray:
        """Derivative (n,) of a weighted sum of responses to the vector of decisions.

        Args:
            x: the vector.
            population: with these decisions.
            z: (numbers, n) of the units.
            pulled: {response: weights (n,)}.
            units: (n,) their places in the sample of the tails, or None for others.
        """
        return self._sums(x, population, z, pulled, units, [slice(None)])[0]

    def _sums(
        self,
        x: np.ndarray,
        population: Population,
        z: np.ndarray,
        pulled: Weights,
        units: np.ndarray | None,
        several: list[slice],
    ) -> list[np.ndarray]:
        """Derivatives as `slope`, of several parts of the units."""
        decisions, count = self._decisions, z.shape[1]
        given = dict(zip(decisions.fields, jnp.asarray(decisions.half_widths(x))))
        most = LANES * max(len(several), -(-count // LANES))
        padded = np.resize(np.arange(count), most)
        both = elements_and_rates(population, given, jnp.asarray(z[:, padded], jnp.result_type(float)))
        errors, rates = (np.asarray(rows, float)[:, :count] for rows in both)
        slopes = self._gradients(population, errors, pulled, units)
        by_width = slopes[: len(errors)] * rates
        found = []
        for part in several:
            used = np.isfinite(slopes[:, part]).all(axis=0)
            own, free = slopes[: len(errors), part][:, used], slopes[len(errors) :, part][:, used].sum(axis=1)
            widths = population.by_field(by_width[:, part][:, used].sum(axis=1))
            places = population.by_field(own.sum(axis=1))
            to_widths = [float(widths[name].sum()) for name in decisions.fields] * decisions.half_widths(x)
            to_middles = [float(places[name].sum()) for name, _ in decisions.moves]
            by_number = dict(zip(sorted(population.values or {}), free))
            to_numbers = [float(by_number[name]) for name in decisions.free]
            found.append(np.concatenate([to_widths, np.array([*to_middles, *to_numbers]) * decisions.rates()]))
        return found

    def slopes_to_z(self, population: Population, z: np.ndarray, pulled: dict[str, np.ndarray]) -> np.ndarray:
        """Gradients (numbers, n) of responses of units to their z."""
        padded = np.resize(np.arange(z.shape[1]), -(-z.shape[1] // LANES) * LANES)
        lanes = jnp.asarray(z[:, padded], jnp.result_type(float))
        errors = np.asarray(elements(population, lanes), float)[:, : z.shape[1]]
        slopes = self._gradients(population, errors, pulled)[: len(errors)]
        return np.asarray(_to_z(population, lanes, jnp.asarray(slopes[:, padded])), float)[:, : z.shape[1]]


def _rows(population: Population, z: jax.Array) -> jax.Array:
    nothing = jnp.zeros((0, z.shape[-1]), z.dtype)
    return jnp.concatenate([nothing, *(v.reshape(-1, z.shape[-1]) for v in population.deviations(z).values())])


@jax.jit
def _to_z(population: Population, z: jax.Array, slopes: jax.Array) -> jax.Array:
    return jax.vjp(lambda z: _rows(population, z), z)[1](slopes.astype(z.dtype))[0]


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
            units = nearest(np.where(np.isfinite(values[name]), row, np.inf), LANES)
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
    errors = np.asarray(elements(population, jnp.asarray(z, jnp.result_type(float))), float)
    return np.concatenate([errors, _free(population, z.shape[1])])


def _free(population: Population, count: int) -> np.ndarray:
    """Numbers of the design of each unit (numbers, n)."""
    rows = [np.full((1, count), float(value)) for _, value in sorted((population.values or {}).items())]
    return np.concatenate([np.zeros((0, count)), *rows])
