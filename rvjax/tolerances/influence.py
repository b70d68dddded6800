"""Influence of each error on a response: total effects and mean slopes, over units with all their errors.

The total effect of a field is E[var(y | all other fields)]: half the mean square change D of y if the field alone is
sampled again (Jansen, Comput. Phys. Commun. 117, 1999). It includes effects without a slope, such as b^2, and those
that fields have together. With the mean gradient g of the units, what the linear part g'd changes is known exactly:

    T_f = g_f' S_ff g_f + E[D_f^2 - (g_f' d_f)^2] / 2,   S: covariance of the errors.

So a linear response has the closed form, without a sampling error, and needs no more units.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rvjax._jax.sizes import PULLED, calls
from rvjax.population import Estimate, Population, deviate_of, one_decides, root_key, skewed, unknown_share
from rvjax.response import BLOCK, Part, Response, Whole, elements, is_costly, numbers_of, parts
from rvjax.status import succeeded
from rvjax.tolerances.moments import Spread

COSTLY_UNITS = 128  # of a costly value: shares of 10 and 30 % have standard errors of 1.5 and 4 %
CHEAP_UNITS = 1024  # of other values of a costly response
CURVED = 1e-6  # of the variance: a response whose linear part leaves less is linear
CONFIDENCE = 0.95
_CHANCE = 8.0  # square of three standard errors, less 1: with a smaller mean slope one element may have none


@dataclasses.dataclass(frozen=True)
class Influence:
    """Effects of the errors on one response.

    Attributes:
        shares: {field: part of its total effect in the sum of all, with a 95 % interval}; they sum to 1. The interval
            is 0 to 1 where one unit has so large a part of the variance that it may not exist.
        slopes: {field: derivative to one of its elements, mean over the units, root mean square over the elements};
            0 where it may be chance: raising and lowering the error act alike.
        scatter: {field: the same derivative, root mean square over elements and units}.
        variance: {field: total effect}, unit of the response squared.
        error: {field: standard error of the total effect}.
        total: sum of the total effects over the variance: 1 if errors only add up, more if they act together.
        mean: of the units, unit of the response.
        sd: standard deviation of the units.
        units: whose errors are sampled again.
        failed: units without a value, or with a neighbour without one; they are excluded.
    """

    shares: dict[str, Estimate]
    slopes: dict[str, float]
    scatter: dict[str, float]
    variance: dict[str, float]
    error: dict[str, float]
    total: Estimate
    mean: float
    sd: float
    units: int
    failed: int


def influences(
    response: Response,
    tolerances: object,
    *,
    seed: int = 0,
    units: int | None = None,
    chunk: int = BLOCK,
    names: tuple[str, ...] | None = None,
    advance: Callable[[int], None] = lambda solved: None,
) -> dict[str, Influence]:
    """Influence of every error on the values of a response, by name.

    Args:
        response: pure function of the errors of one unit; a dict or record of scalars, or an `Outcome` of these.
        tolerances: record or dict with a `Tolerance` or None in each field, independent of each other.
        seed: of the units.
        units: whose errors are sampled again; by default `chunk`, less of a costly response.
        chunk: units of one call of a response that is not costly.
        names: of the values; by default all.
        advance: is given the number of units with one error sampled again that were solved.
    """
    population, found = Population.of(tolerances), dict[str, Influence]()
    spread = Spread(population)
    for part in parts(response, population, chunk):
        wanted = [name for name in part.names if names is None or name in names]
        if not wanted:
            continue
        usual = COSTLY_UNITS if is_costly(part.response) else CHEAP_UNITS
        count = units or (chunk if isinstance(part, Whole) else usual)
        z = numbers_of(population, root_key(seed), np.arange(2 * count))
        one, other = z[:, :count], z[:, count:]
        errors, others = _errors(population, one), _errors(population, other)
        about, new = (each - spread.mean[:, None] for each in (errors, others))
        solver = _Solver(part, population)
        values, good, state = solver.solution(one)
        rows = [part.names.index(name) for name in wanted]
        slopes = [solver.slopes(errors, good, state, k) for k in rows]
        values, changes = values[rows], None
        if not all(_is_linear(y[good], each, about[:, good]) for y, each in zip(values, slopes)):
            changes = solver.changed(one, other, advance)[:, rows] - values
            good = good & np.isfinite(changes).all(axis=(0, 1))
        for k, name in enumerate(wanted):
            moved = None if changes is None else changes[:, k, good]
            sample = _Sample(values[k, good], slopes[k], about[:, good], (new - about)[:, good], moved, count)
            found[name] = sample.influence(spread)
    return found


def _errors(population: Population, z: np.ndarray) -> np.ndarray:
    """Errors (elements, n) of units with random numbers z (numbers, n), by the program for the gradients' units."""
    lanes = calls(z.shape[1], PULLED)
    found = [np.asarray(elements(population, z[:, some]), float) for some in lanes]
    return np.concatenate(found, axis=1)[:, : z.shape[1]]


class _Solver(NamedTuple):
    """Units of a part of a response, by the programs that a search compiles."""

    part: Part
    population: Population

    def solution(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k, n), nan where a unit failed; which units have them (n,); and what their gradients need.

        An infinite value is a failure here: no line through other values foresees it.
        """
        values, status, state = self.part.solve(self.population, z)
        good = np.asarray(succeeded(status)) & np.isfinite(values).all(axis=0)
        return np.where(good, values, np.nan), good, state

    def slopes(self, errors: np.ndarray, good: np.ndarray, state: np.ndarray, k: int) -> np.ndarray:
        """Gradients (n, elements) of value k of the first units, without those that have none."""
        first = np.arange(min(PULLED, errors.shape[1]))
        weights = np.zeros((len(self.part.names), len(first)))
        weights[k] = 1.0
        found = self.part.slopes_of_elements(self.population, errors[:, first], state[:, first], weights).T
        return found[good[first] & np.isfinite(found).all(axis=1)]

    def changed(self, one: np.ndarray, other: np.ndarray, advance: Callable[[int], None]) -> np.ndarray:
        """Values (fields, k, n) of the units `one` with one field of the others (numbers, n)."""
        units, size, found = one.shape[1], self.part.at_once, []
        for first in range(0, units, size):
            own, new = one[:, first : first + size], other[:, first : first + size]
            z = np.concatenate([mixed for _, mixed in self.population.exchanged(own, new)], axis=1)
            steps = []
            for at in range(0, z.shape[1], 4 * size):
                steps.append(self.solution(z[:, at : at + 4 * size])[0])
                advance(steps[-1].shape[1])
            found.append(np.concatenate(steps, axis=1).reshape(len(self.part.names), -1, own.shape[1]))
        return np.concatenate(found, axis=2).transpose(1, 0, 2)


def _mean(slopes: np.ndarray) -> np.ndarray:
    return slopes.mean(axis=0) if len(slopes) else np.zeros(slopes.shape[1])


def _is_linear(y: np.ndarray, slopes: np.ndarray, about: np.ndarray) -> bool:
    """True if the linear part leaves next to nothing of the variance, or if nothing varies."""
    return not len(y) or float((y - _mean(slopes) @ about).var()) <= CURVED * float(y.var())


class _Sample(NamedTuple):
    """One value of the units that count, with what its influences need.

    Attributes:
        y: values (n,).
        slopes: gradients (m, elements) of some units.
        about: errors about their mean (elements, n).
        moved: change of the errors that are sampled again (elements, n).
        changes: of the value if one field is sampled again (fields, n); None of a linear response.
        units: units, with those that do not count.
    """

    y: np.ndarray
    slopes: np.ndarray
    about: np.ndarray
    moved: np.ndarray
    changes: np.ndarray | None
    units: int

    def influence(self, spread: Spread) -> Influence:
        """Influences of the fields of a population."""
        fields, count, gradient = tuple(spread.fields), len(self.y), _mean(self.slopes)
        if not count:  # nothing is known: as of one unit without values
            lost = np.full((len(gradient), 1), math.nan)
            unit = self._replace(y=np.full(1, math.nan), about=lost, moved=lost, changes=lost[: len(fields)])
            return unit.influence(spread)
        known = np.array(list(spread.shares(gradient).values()))
        effects = np.repeat(known[:, None], count, axis=1)
        if self.changes is not None:
            linear = np.stack([each.sum(axis=0) for each in spread.rows(gradient[:, None] * self.moved).values()])
            effects += (self.changes - linear) * (self.changes + linear) / 2
        rest = self.y - gradient @ self.about
        mean = float(rest.mean())
        rest = rest - mean
        squares = known.sum() + 2 * (gradient @ self.about) * rest + rest**2 * count / max(1, count - 1)
        total, slopes = effects.sum(axis=0), spread.rows(self.slopes.T)
        away = (self.y - self.y.mean()) ** 2
        unknown = self.changes is not None and one_decides(float(away.max()), float(away.sum()), count)
        whole = _ratio(total, squares, 1.0)
        share: Callable[[Estimate], Estimate] = unknown_share if unknown else _within
        return Influence(
            shares={name: share(_ratio(row, total)) for name, row in zip(fields, effects)},
            slopes={name: _mean_slope(each, spread.block(name)) for name, each in slopes.items()},
            scatter={name: float(np.sqrt((each**2).sum() / max(1, each.size))) for name, each in slopes.items()},
            variance=dict(zip(fields, np.maximum(effects.mean(axis=1), 0.0).tolist())),
            error=dict(zip(fields, (effects.std(axis=1) / math.sqrt(count)).tolist())),
            total=dataclasses.replace(whole, lower=0.0, upper=math.inf) if unknown else whole,
            mean=mean,
            sd=float(np.sqrt(np.maximum(squares.mean(), 0.0))),
            units=self.units,
            failed=self.units - int(np.isfinite(self.y).sum()),
        )


def _ratio(part: np.ndarray, whole: np.ndarray, none: float = 0.0) -> Estimate:
    """Ratio of two means over units, with its interval from the linearised ratio of each unit.

    Args:
        part: terms of the numerator.
        whole: terms of the denominator.
        none: value where the denominator is 0.
    """
    count, size = len(whole), float(whole.mean())
    if not size > 0:
        return Estimate.about(math.nan if math.isnan(size) else none, 0.0, 0.0)
    value = max(0.0, float(part.mean()) / size)
    terms = (part - value * whole) / size
    power = float(terms.var()) ** 1.5
    lean = float(((terms - terms.mean()) ** 3).mean()) / power if power > 0 else 0.0
    return skewed(value, float(terms.std()) / math.sqrt(count), lean, count, deviate_of(CONFIDENCE))


def _within(share: Estimate) -> Estimate:
    """A share with its interval cut to 0 .. 1."""
    return dataclasses.replace(share, lower=max(0.0, share.lower), upper=min(1.0, share.upper))


def _mean_slope(slopes: np.ndarray, covariance: np.ndarray) -> float:
    """Mean slopes (elements, n), root mean square over the elements; 0 where their part of the variance may be chance.

    Args:
        slopes: of the units.
        covariance: of the errors (elements, elements).
    """
    elements, count = slopes.shape
    mean = slopes.mean(axis=1) if count else np.zeros(elements)
    chance = np.atleast_2d(np.cov(slopes)) / count if count > 1 else np.zeros((elements, elements))
    weighted = (covariance if covariance.any() else np.eye(elements)) @ chance
    expected, square = float(np.trace(weighted)), float((weighted * weighted.T).sum())
    found = float(mean @ covariance @ mean) if covariance.any() else float(mean @ mean)
    if expected > 0 and found <= expected * (1 + _CHANCE * math.sqrt(square) / expected):
        return 0.0  # square of the trace over `square`: how many elements vary alone
    return math.sqrt(max(0.0, float(mean @ mean) - float(np.trace(chance))) / elements)
