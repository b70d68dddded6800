"""Margins of all requirements, and their derivatives, at one vector of decisions.

Shares of units come from a sample of the tails, other statistics (mean, spread, capability, worst case) on a plain
one, nominal outputs without units. A limit on both sides is two constraints where its margin has a corner between
them. Every margin is a part of its way: of the distance of the central response from the limit at the start.
"""

import dataclasses
import hashlib
import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.population import Population, SobolPoints
from rvjax.response import LANES, Part, Response, elements_and_rates, gradients, parts, respond, response_names
from rvjax.status import succeeded
from rvjax.tolerances.batch.checkpoint import describe
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.codesign.decisions import Decisions
from rvjax.tolerances.codesign.nominal import Nominal, NominalOutputs
from rvjax.tolerances.codesign.tail_sample import Centres, TailSample, centres_of, kernel, smooth_quantile
from rvjax.tolerances.requirements.kinds import Requirement
from rvjax.tolerances.requirements.limits import Limits
from rvjax.tolerances.worst_case import Extremes, extremes

WIDTH = 0.06  # of the smoothing of quantiles, standard deviations of the response along its gradient
_STEP = 1e-4  # of differences of a worst case, part of a range
_AT_ONCE = 2048  # units of a call, so that the coarse and the fine search share one program
_MOST_LANES = 2 * LANES  # units behind the slope of a quantile
JOINT = "joint"
"""Name of the constraint on units that meet all limits."""


@dataclasses.dataclass(frozen=True)
class Local:
    """Cost and margins at one vector of decisions, with derivatives.

    Attributes:
        x: (n,) the vector.
        cost: without the objective.
        slopes: (n,) its derivatives.
        bends: (n,) its curvatures.
        objective: priced outputs without errors.
        objective_slopes: (n,) their derivatives.
        margins: (c,) of the constraints, in parts of their ways; <= 0 is met.
        jacobian: (c, n) their derivatives.
    """

    x: np.ndarray
    cost: float
    slopes: np.ndarray
    bends: np.ndarray
    objective: float
    objective_slopes: np.ndarray
    margins: np.ndarray
    jacobian: np.ndarray

    @property
    def total(self) -> float:
        """Cost with the objective."""
        return self.cost + self.objective


@dataclasses.dataclass(frozen=True)
class _Units:
    """Margins (n,) of units, derivatives (n,) of these to each response, and the share that must keep a limit."""

    margins: np.ndarray
    outward: dict[str, np.ndarray]
    target: float


@dataclasses.dataclass(frozen=True)
class Constraint:
    """One row of the margins: a requirement, or one side of it."""

    name: str
    item: Limits


class Margins:
    """Constraints of an allocation as functions of its vector of decisions."""

    def __init__(
        self,
        response: Response,
        decisions: Decisions,
        requirements: dict[str, Limits],
        objective: dict[str, float],
        joint_target: float | None,
        samples: int,
        seed: int,
        memo: Memo | None = None,
    ) -> None:
        self.decisions, self.requirements, self.objective = decisions, requirements, objective
        self.joint_target, self.samples, self.seed, self._memo = joint_target, samples, seed, memo
        self.response, self.evaluated = response, [0]
        wanted = {name for name, item in requirements.items() if not isinstance(item, Nominal)}
        self._parts = [p for p in parts(response, decisions.base) if wanted & set(p.names)] if wanted else []
        self._outputs = response_names(response, decisions.base)
        self._costly = bool(getattr(response, "costly", False))
        self.rows = [Constraint(n, i) for n, i in requirements.items() if isinstance(i, Requirement)]
        self._shares = len(self.rows)
        for name, item in requirements.items():
            if not isinstance(item, Requirement):
                self.rows += [Constraint(name, side) for side in _sides(item)]
        outputs = {n for n, item in requirements.items() if isinstance(item, Nominal)} | set(objective)
        self._nominal = NominalOutputs(response, tuple(sorted(outputs)))
        self._plain = any(not isinstance(i, (Requirement, Nominal)) for i in requirements.values())
        self.names = [row.name for row in self.rows] + ([JOINT] if joint_target is not None else [])
        self.offsets = np.zeros(len(self.names))
        self.ways = np.ones(len(self.names))
        self.widths = np.ones(len(self.names))
        numbers = decisions.base.numbers
        self.tails = TailSample(numbers, samples, seed)
        self.plain = SobolPoints(numbers, seed).z(0, samples) if self._plain else np.zeros((numbers, 0))

    # The sample.

    def begin(self, x: np.ndarray) -> None:
        """Measure the way of each margin, and place units in the tails."""
        outputs, _ = self._nominal.at(self.decisions.population(x))
        centre = self._central(x) if self._parts else {}
        values = self._values(x, self.tails.z, "tails") if self._parts else {}
        for k, row in enumerate(self.rows):
            if isinstance(row.item, Nominal):
                self.ways[k] = _size(row.item) or abs(outputs[row.name]) or 1.0
            else:
                spread = float(np.nanstd(values[row.name])) if np.isfinite(values[row.name]).any() else 0.0
                way = abs(float(row.item.margin(centre[row.name])))
                self.ways[k] = max(w for w in (way, spread, 1e-300) if math.isfinite(w))
                if not row.item.limits_values:
                    self.ways[k] = row.item.upper
        self.replace_sample(x)

    def replace_sample(self, x: np.ndarray) -> None:
        """Units in the tails as they lie at x."""
        if not self._shares:
            return
        population = self.decisions.population(x)
        values = self._values(x, self.tails.z, "tails")
        found = []
        for k, shared in enumerate(self._shared(values)):
            margins, target = shared.margins, shared.target
            order = np.argsort(margins)
            order = order[np.isfinite(margins[order])]
            beyond = np.cumsum(self.tails.weights[order[::-1]])[::-1] / self.samples
            at = min(int(np.searchsorted(-beyond, -(1 - target))), max(len(order) - LANES // 2, 0))
            units = order[max(0, at - LANES // 2) : max(0, at - LANES // 2) + LANES]
            if not len(units):
                continue
            cotangents = {name: pull[units] for name, pull in shared.outward.items()}
            slopes = self._slopes_to_z(population, self.tails.z[:, units], cotangents)
            middle = margins[order[min(at, len(order) - 1)]]
            near = np.abs(margins[units] - middle)
            weights = self.tails.weights[units] / (near + np.median(near) + 1e-300)
            sizes = np.linalg.norm(slopes, axis=0)
            self.widths[self._row(k)] = WIDTH * float(np.median(sizes)) or WIDTH * self.ways[self._row(k)]
            found.append(centres_of(self.tails.z[:, units], slopes, weights, float(special.ndtri(max(target, 0.6)))))
        found = [item for item in found if len(item.places)]
        if found:
            self.tails = TailSample(self.decisions.base.numbers, self.samples, self.seed, Centres.joined(found))

    def _row(self, k: int) -> int:
        return k if k < self._shares else len(self.names) - 1

    # Margins.

    def look(self, x: np.ndarray) -> Local:
        """Cost, margins and derivatives at a vector of decisions."""
        decisions, n = self.decisions, self.decisions.size
        population = decisions.population(x)
        margins, jacobian = np.zeros(len(self.names)), np.zeros((len(self.names), n))
        if self._shares:
            self._look_at_shares(x, population, margins, jacobian)
        if self._plain:
            self._look_at_statistics(x, population, margins, jacobian)
        outputs, rates = self._nominal.at(population)
        for k, row in enumerate(self.rows):
            if isinstance(row.item, Nominal):
                value = outputs[row.name]
                margins[k] = row.item.margin(value) if math.isfinite(value) else math.inf
                jacobian[k] = float(row.item.outward(np.array(value))) * self._to_numbers(rates[row.name])
        slopes, bends = decisions.cost_slopes(x)
        priced = sum(price * outputs[name] for name, price in self.objective.items())
        towards = sum((p * self._to_numbers(rates[name]) for name, p in self.objective.items()), np.zeros(n))
        margins = (margins + self.offsets) / self.ways
        return Local(
            x, decisions.cost(x), slopes, bends, float(priced), towards, margins, jacobian / self.ways[:, None]
        )

    def total(self, x: np.ndarray) -> float:
        """Cost at a vector of decisions, with the objective."""
        outputs, _ = self._nominal.at(self.decisions.population(x))
        return self.decisions.cost(x) + sum(price * outputs[name] for name, price in self.objective.items())

    def central_ways(self, x: np.ndarray) -> np.ndarray:
        """Distance (c,) of the central response from each limit, in parts of the way of each margin."""
        found = np.ones(len(self.names))
        if self._parts:
            centre = self._central(x)
            for k, row in enumerate(self.rows):
                if not isinstance(row.item, Nominal) and row.item.limits_values:
                    found[k] = max(abs(float(row.item.margin(centre[row.name]))) / self.ways[k], 1e-3)
        return found

    def limits(self) -> np.ndarray:
        """Sizes (c,) of the limits, unit of each response; the way of a margin where the limit is 0."""
        found = [_size(row.item) or float(way) for row, way in zip(self.rows, self.ways)]
        return np.array(found + [1.0] * (len(self.names) - len(self.rows)))

    def leading(self, x: np.ndarray) -> dict[str, float]:
        """{requirement: derivative of the joint margin to its margin}."""
        values = self._values(x, self.tails.z, "tails")
        shared = self._shared(values)[-1]
        level = smooth_quantile(shared.margins, self.tails.weights, 1 - shared.target, self.widths[-1])
        weights = kernel(shared.margins, self.tails.weights, level, self.widths[-1])
        return {name: float(np.abs(pull) @ weights) for name, pull in shared.outward.items()}

    def _central(self, x: np.ndarray) -> dict[str, float]:
        """Responses of the unit whose standard normal numbers are 0."""
        values = self._values(x, np.zeros((self.decisions.base.numbers, 1)), "centre")
        return {name: float(row[0]) for name, row in values.items()}

    def _shared(self, values: dict[str, np.ndarray]) -> list[_Units]:
        """Units of each constraint on a share."""
        found = []
        for row in self.rows[: self._shares]:
            assert isinstance(row.item, Requirement)
            own = values[row.name]
            outward = np.where(np.isnan(own), 0.0, row.item.outward(own))
            found.append(_Units(row.item.margins(own), {row.name: outward}, row.item.target))
        if self.joint_target is not None:
            items = {n: i for n, i in self.requirements.items() if i.of_units}
            ways = {n: float(self.ways[self.names.index(n)]) for n in items}
            failed = np.any([np.isnan(values[n]) for n in items], axis=0)
            scaled = np.stack([item.margin(values[n]) / ways[n] for n, item in items.items()])
            leading = np.where(failed, -1, scaled.argmax(axis=0))
            pulls = {
                n: np.where(leading == i, item.outward(values[n]) / ways[n], 0.0)
                for i, (n, item) in enumerate(items.items())
            }
            found.append(_Units(np.where(failed, np.inf, scaled.max(axis=0)), pulls, self.joint_target))
        return found

    def _look_at_shares(self, x: np.ndarray, population: Population, margins: np.ndarray, jacobian: np.ndarray) -> None:
        values = self._values(x, self.tails.z, "tails")
        for number, shared in enumerate(self._shared(values)):
            own, target, k = shared.margins, shared.target, self._row(number)
            margins[k] = smooth_quantile(own, self.tails.weights, 1 - target, self.widths[k])
            if not math.isfinite(margins[k]):
                continue
            weights = kernel(own, self.tails.weights, margins[k], self.widths[k])
            units = np.argsort(-weights, kind="stable")[: min(_MOST_LANES, int((weights > 0).sum()))]
            weights = weights[units] / weights[units].sum()
            pulled = {name: pull[units] * weights for name, pull in shared.outward.items()}
            if np.isfinite(weights).all():
                jacobian[k] = self._slope(x, population, self.tails.z[:, units], pulled)
            # A normal tail at distance z, widened by h, is too wide by z h^2/2 (in standard deviations).
            margins[k] -= self.widths[k] * WIDTH * max(float(special.ndtri(target)), 0.0) / 2

    def _look_at_statistics(
        self, x: np.ndarray, population: Population, margins: np.ndarray, jacobian: np.ndarray
    ) -> None:
        values = self._values(x, self.plain, "plain")
        for k, row in enumerate(self.rows):
            item = row.item
            if isinstance(item, (Requirement, Nominal)):
                continue
            if item.of_extremes:
                margins[k], jacobian[k] = self._worst(x, row, self.ways[k])
                continue
            own = values[row.name]
            valid = own if item.most_failed >= 1 else own[~np.isnan(own)]
            margins[k] = item.learned(valid, self.ways[k])
            pull = item.pull(own, margins[k], self.ways[k], self.samples)
            if len(pull.units) and math.isfinite(margins[k]):
                weighted = {row.name: pull.cotangents / pull.norms.sum()}
                jacobian[k] = self._slope(x, population, self.plain[:, pull.units], weighted)

    def _worst(self, x: np.ndarray, row: Constraint, way: float) -> tuple[float, np.ndarray]:
        """Margin of a worst case and its derivatives; those to mid-points and numbers by differences."""

        def ends(x: np.ndarray) -> Extremes:
            return extremes(self.response, self.decisions.population(x), self._outputs, row.name)

        here, found, count = ends(x), np.zeros(len(x)), len(self.decisions.fields)
        margin = row.item.learned(here.values, way)
        pull = row.item.pull(here.values, margin, way, self.samples)
        active = list(self.decisions.base.active)
        by_width = pull.cotangents @ here.slopes[pull.units]
        found[:count] = by_width[[active.index(name) for name in self.decisions.fields]]
        for j in range(count, len(x)):
            there = x.copy()
            there[j] += _STEP if x[j] + _STEP <= self.decisions.high[j] else -_STEP
            found[j] = (row.item.learned(ends(there).values, way) - margin) / (there[j] - x[j])
        return margin, found

    def _to_numbers(self, rates: dict[str, float]) -> np.ndarray:
        """Derivatives by number of the design as those to the vector."""
        found, free = np.zeros(self.decisions.size), self.decisions.free
        if free:
            found[-len(free) :] = [rates.get(name, 0.0) for name in free]
            found[-len(free) :] *= self.decisions.rates()[-len(free) :]
        return found

    # Units.

    def _values(self, x: np.ndarray, z: np.ndarray, what: str) -> dict[str, np.ndarray]:
        """Values (n,) by name of units with these z, nan where one failed."""
        population = self.decisions.population(x)
        found: dict[str, np.ndarray] = {}
        for part in self._parts:
            found |= dict(zip(part.names, self._solved(part, population, z)))
        self.evaluated[0] += z.shape[1] if what != "centre" else 1
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
                padded = z[:, np.resize(np.arange(z.shape[1]), -(-z.shape[1] // _AT_ONCE) * _AT_ONCE)]
                blocks = np.split(padded, padded.shape[1] // _AT_ONCE, axis=1)
                found = [respond(part.response, population, jnp.asarray(b, jnp.result_type(float))) for b in blocks]
                rows = [np.stack([np.asarray(values[name], float) for name in part.names]) for values, _ in found]
                values = np.concatenate(rows, axis=1)[:, : z.shape[1]]
                status = np.concatenate([np.asarray(flags) for _, flags in found])[: z.shape[1]]
            return np.where(np.asarray(succeeded(status)) & np.isfinite(values), values, np.nan)

        if self._memo is None:
            return compute()
        about = repr((part.names, sorted(describe(population, {}).items()))).encode()
        return self._memo.recall({"design": hashlib.sha256(about + z.tobytes()).hexdigest()}, compute)

    def _gradients(self, population: Population, errors: np.ndarray, pulled: dict[str, np.ndarray]) -> np.ndarray:
        """Gradients (elements and numbers, n) of sums of responses, with weights (n,) by name."""
        total = np.zeros((errors.shape[0] + len(population.values or {}), errors.shape[1]))
        for part in self._parts:
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
        self.evaluated[0] += errors.shape[1]
        return total

    def _slope(self, x: np.ndarray, population: Population, z: np.ndarray, pulled: dict[str, np.ndarray]) -> np.ndarray:
        """Derivative (n,) of a weighted sum of responses to the vector of decisions."""
        decisions, count = self.decisions, z.shape[1]
        given = dict(zip(decisions.fields, jnp.asarray(decisions.half_widths(x))))
        padded = np.resize(np.arange(count), -(-count // LANES) * LANES)
        both = elements_and_rates(population, given, jnp.asarray(z[:, padded], jnp.result_type(float)))
        errors, rates = (np.asarray(rows, float)[:, :count] for rows in both)
        slopes = self._gradients(population, errors, pulled)
        used = np.isfinite(slopes).all(axis=0)
        own, free = slopes[: len(errors), used], slopes[len(errors) :, used].sum(axis=1)
        widths = population.by_field((own * rates[:, used]).sum(axis=1))
        places = population.by_field(own.sum(axis=1))
        to_widths = [float(widths[name].sum()) for name in decisions.fields] * decisions.half_widths(x)
        to_middles = [float(places[name].sum()) for name, _ in decisions.moves]
        by_number = dict(zip(sorted(population.values or {}), free))
        to_numbers = [float(by_number[name]) for name in decisions.free]
        return np.concatenate([to_widths, np.array([*to_middles, *to_numbers]) * decisions.rates()])

    def _slopes_to_z(self, population: Population, z: np.ndarray, pulled: dict[str, np.ndarray]) -> np.ndarray:
        """Gradients (numbers, n) of responses of units to their z."""
        padded = np.resize(np.arange(z.shape[1]), -(-z.shape[1] // LANES) * LANES)
        lanes = jnp.asarray(z[:, padded], jnp.result_type(float))
        errors = np.asarray(_errors(population, lanes), float)[:, : z.shape[1]]
        slopes = self._gradients(population, errors, pulled)[: len(errors)]
        return np.asarray(_to_z(population, lanes, jnp.asarray(slopes[:, padded])), float)[:, : z.shape[1]]


def _sides(item: Limits) -> list[Limits]:
    """The limits one by one, where the margin of both has a corner."""
    if math.isinf(item.lower) or math.isinf(item.upper):
        return [item]
    return [dataclasses.replace(item, lower=-math.inf), dataclasses.replace(item, upper=math.inf)]


def _size(item: Limits) -> float:
    """Size of a limit."""
    return abs(item.lower if math.isinf(item.upper) else item.upper)


def _rows(population: Population, z: jax.Array) -> jax.Array:
    nothing = jnp.zeros((0, z.shape[-1]), z.dtype)
    return jnp.concatenate([nothing, *(v.reshape(-1, z.shape[-1]) for v in population.deviations(z).values())])


@jax.jit
def _errors(population: Population, z: jax.Array) -> jax.Array:
    return _rows(population, z)


@jax.jit
def _to_z(population: Population, z: jax.Array, slopes: jax.Array) -> jax.Array:
    return jax.vjp(lambda z: _rows(population, z), z)[1](slopes.astype(z.dtype))[0]
