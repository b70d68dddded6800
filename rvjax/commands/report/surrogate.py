"""A study near its allocated tolerances as a few numbers for each unit: what a page follows sliders with.

A sample of units keeps its random numbers while half-widths and places of the limits move. The response of unit i is

    y_i(x) = y_i(0) + sum_k s_ik x_k + sum_{j <= k} b_ijk x_j x_k,   x_k = (p_k - allocated p_k)/reach_k,

with slopes and bends from responses at x_k = +-1, not from derivatives: they hold over the region |x_k| <= 1 and pass
over the kinks of extremes. A linear response is exact. Rare rejects need few units in the sample, so it is thinned
with a chance that grows towards the tails (Horvitz and Thompson 1952) and weighted so that the values at x = 0 are
those of the certificate (Deville and Sarndal 1992). What is left is measured at points of the region, with fresh units.
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from rvjax.commands.allocate import Answer
from rvjax.population import Population, root_key
from rvjax.response import BLOCK, Response, respond
from rvjax.tolerances import Estimate, Limits, Statistics, Tolerance, monte_carlo

UNITS = 2048
REACH = 0.4  # of a half-width: how far it moves within the region, either way
SHIFT = 0.25  # the same of the place of its limits, in half-widths
_FLOOR = 0.5  # of the units are sampled evenly, the others from the tails
_KNOWN = 0.01  # of a standard deviation: a smaller misfit at a probe needs no mixed bends
_FELT = 2e-3  # of a standard deviation: columns that move no unit by more, root mean square, are left out
_MIXED = 12  # parameters of a response, the strongest, that get mixed bends
_POINTS = 8  # of the region at which the error is measured
FRESH = 2 * BLOCK  # units that measure it, at each point

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


@dataclasses.dataclass(frozen=True)
class Check:
    """Surrogate compared with the responses, at one point.

    Attributes:
        where: what the point is.
        figures: {response: (figure of the surrogate, figure of fresh units)} for "yield", "mean" and "sd".
    """

    where: str
    figures: Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class Surrogate:
    """Responses of weighted units as quadratic functions of the parameters.

    Attributes:
        parameters: what may move.
        weights: of the units (units,), sum 1.
        base: {response: values as allocated (units,)}.
        columns: {response: slopes and bends}.
        failed: share of units that fail as allocated.
        checks: how far off it was.
    """

    parameters: tuple[Parameter, ...]
    weights: np.ndarray
    base: Mapping[str, np.ndarray]
    columns: Mapping[str, Columns]
    failed: float
    checks: tuple[Check, ...] = ()

    def values(self, name: str, x: np.ndarray) -> np.ndarray:
        """Responses of the units (units,).

        Args:
            name: of the response.
            x: parameters (p,) in reaches off the allocated ones.
        """
        terms = (column * np.prod(x[list(key)]) for key, column in self.columns[name].items())
        return sum(terms, start=self.base[name])

    def figures(self, name: str, x: np.ndarray, limits: Limits) -> dict[str, float]:
        """Share within the limits, failed units outside, and mean and standard deviation of the valid ones.

        Args:
            name: of the response.
            x: parameters (p,) in reaches.
            limits: of the response.
        """
        values, w = self.values(name, x), self.weights
        mean = float(w @ values)
        within = float(w @ (np.asarray(limits.margin(values)) <= 0))
        sd = math.sqrt(max(0.0, float(w @ (values - mean) ** 2)))
        return {"yield": (1 - self.failed) * within, "mean": mean, "sd": sd}

    def place(self, tolerances: Any) -> np.ndarray:
        """Parameters of tolerances, in reaches (p,).

        Args:
            tolerances: record of the study's errors.
        """
        found = []
        for p in self.parameters:
            tolerance = getattr(tolerances, p.field)
            value = placed(tolerance) if p.place else float(tolerance.half_width)
            found.append((value - p.centre) / p.reach)
        return np.array(found)

    def error(self, figure: str) -> float:
        """The largest error of a statistic at the points of the region; of mean and sd as a part of the sd."""
        misses = [
            abs(ours - true) / (1.0 if figure == "yield" else each["sd"][1] or 1.0)
            for check in self.checks
            for each in check.figures.values()
            for ours, true in [each[figure]]
        ]
        misses = [miss if math.isfinite(miss) else math.inf for miss in misses]  # where every unit fails
        return max(misses, default=0.0)


def surrogate(answer: Answer) -> Surrogate | None:
    """Surrogate of a result with its measured error; None if no unit is valid or nothing can move."""
    study, side = answer.study, answer.after
    names, response = tuple(study.requirements), study.response()
    parameters = tuple(_parameters(answer))
    full = np.stack([np.asarray(side.values[name], float) for name in names])
    valid = np.flatnonzero(np.isfinite(full).all(axis=0))
    if len(valid) < UNITS or not parameters:
        return None
    chance = _chances(full[:, valid], UNITS)
    chosen = _thinned(chance, UNITS, np.random.default_rng(study.seed))
    population = Population.of(side.tolerances)
    z = jax.jit(lambda units: population.draw(root_key(side.seed), units))(valid[chosen].astype(np.uint32))
    design = _Design(response, population, parameters, z)
    base, columns = design.fitted(names)
    certificate = answer.allocation.certificate
    failed = certificate.failed / certificate.samples
    weights = _calibrated(1 / chance[chosen], base, study.requirements, certificate, failed)
    found = Surrogate(parameters, weights, base, columns, failed)
    return dataclasses.replace(found, checks=tuple(_checks(found, answer, design, response)))


def placed(tolerance: Tolerance) -> float:
    """Place of the limits: mid-point, or the lower limit if the distribution begins there."""
    return float(tolerance.lower if grows_from_lower(tolerance) else tolerance.middle)


def grows_from_lower(tolerance: Tolerance) -> bool:
    """True if a larger half-width does not move the lower limit."""
    return float(tolerance.with_half_width(2 * tolerance.half_width).lower) == float(tolerance.lower)


def _parameters(answer: Answer) -> list[Parameter]:
    study, found = answer.study, []
    for field in study.fields:
        tolerance = getattr(answer.after.tolerances, field)
        half = float(tolerance.half_width)
        if half == 0 or tolerance.law.name == "empirical":  # constant, or measured: its limits do not say where it is
            continue
        found.append(Parameter(field, False, half, REACH * half))
        if not tolerance.law.of_vectors:
            asked = study.middles.get(field)
            reach = max(SHIFT * half, (asked.upper - asked.lower) / 8 if asked else 0.0)
            found.append(Parameter(field, True, placed(tolerance), reach))
    return found


def _chances(values: np.ndarray, count: int) -> np.ndarray:
    """Chance of each unit to be kept (n,), sum `count`: a floor for all, and as 1/(share of units further out)."""
    n = values.shape[1]
    ranks = values.argsort(axis=1).argsort(axis=1) + 1.0
    outward = (1 / np.minimum(ranks, n + 1 - ranks)).sum(axis=0)
    low, high = 0.0, float(n)
    for _ in range(100):  # the scale of the tails' part, by halving: the sum grows with it
        scale = (low + high) / 2
        chance = np.minimum(1.0, _FLOOR * count / n + scale * outward)
        low, high = (scale, high) if chance.sum() < count else (low, scale)
    return chance


def _thinned(chance: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Places of units kept with their chances, as many as these add up to: systematic, in random order."""
    order = rng.permutation(len(chance))
    steps = np.cumsum(chance[order]) * (count / chance.sum())
    return np.sort(order[np.searchsorted(steps, np.arange(count) + rng.random())])


def _calibrated(
    weights: np.ndarray,
    base: Mapping[str, np.ndarray],
    requirements: Mapping[str, Limits],
    certificate: Statistics,
    failed: float,
) -> np.ndarray:
    """Weights nearest to the given ones with which mean, sd and yields, the joint one too, are the certificate's."""
    rows, wanted, anywhere = [np.ones(len(weights))], [1.0], np.zeros(len(weights), bool)
    for name, values in base.items():
        mean, sd = certificate.mean[name].value, certificate.sd[name].value
        if not sd > 0:
            continue
        scaled = (values - mean) / sd
        rows += [scaled, scaled**2]
        wanted += [0.0, 1.0]
        share = (certificate.yield_ or {}).get(name)
        outside = np.asarray(requirements[name].margin(values)) > 0
        if isinstance(share, Estimate) and 0 < outside.mean() < 1:
            rows.append(outside.astype(float))
            wanted.append(1 - share.value / (1 - failed))
            anywhere |= outside
    joint = certificate.joint_yield
    if joint is not None and 0 < anywhere.mean() < 1 and all(item.of_units for item in requirements.values()):
        rows.append(anywhere.astype(float))
        wanted.append(1 - joint.value / (1 - failed))
    weights, a = weights / weights.sum(), np.stack(rows)
    prices = np.linalg.lstsq((a * weights) @ a.T, np.array(wanted) - a @ weights, rcond=1e-10)[0]
    moved = weights * (1 + prices @ a)
    return moved if (moved > 0).all() else weights


class _Design:
    """Responses of chosen units at points of the region, and the quadratic functions through them."""

    def __init__(
        self, response: Response, population: Population, parameters: Sequence[Parameter], z: jax.Array
    ) -> None:
        self.response, self.population, self.parameters, self.z = response, population, parameters, z

    def tolerances(self, x: np.ndarray) -> dict[str, Tolerance]:
        """Tolerances of the fields that move, x in reaches."""
        made: dict[str, Tolerance] = {}
        for p, step in zip(self.parameters, map(float, x)):
            tolerance = made.get(p.field, self.population.active[p.field])
            if p.place:
                way = step * p.reach
                made[p.field] = tolerance.replace(lower=tolerance.lower + way, upper=tolerance.upper + way)
            else:
                made[p.field] = tolerance.with_half_width(p.centre + step * p.reach)
        return made

    def at(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Responses (units,), nan where one failed."""
        values, _ = respond(self.response, self.population.with_tolerances(self.tolerances(x)), self.z)
        return {name: np.asarray(column, float) for name, column in values.items()}

    def fitted(self, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, Columns]]:
        """Values as allocated, and slopes and bends by response."""
        count = len(self.parameters)
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
        felt = {
            name: {key: c for key, c in own.items() if np.sqrt(np.mean(c**2)) > _FELT * spread[name]}
            for name, own in columns.items()
        }
        return base, felt

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
            felt = [k for k, size in enumerate(strength) if size > 5 * _FELT * spread[name]]
            strongest = sorted(sorted(felt, key=lambda k: -strength[k])[:_MIXED])
            bent = max(float(np.sqrt(np.nanmean(miss**2))) for miss in misses) > _KNOWN * spread[name]
            found[name] = set(itertools.combinations(strongest, 2)) if bent else set()
        return found


def _checks(found: Surrogate, answer: Answer, design: _Design, response: Response) -> list[Check]:
    """Compare the surrogate with independent units: all finer, all coarser, random points, the study if it is near."""
    study = answer.study
    judged = {name: item for name, item in study.requirements.items() if item.limits_values}
    width = np.array([not p.place for p in found.parameters], float)
    rng = np.random.default_rng(study.seed + 1)
    points = [("all half-widths finer", -width), ("all half-widths coarser", width)]
    for number in range(_POINTS - len(points)):
        points.append((f"random point {number + 1}", rng.uniform(-1, 1, len(width))))
    checks = []
    for where, x in points:
        tolerances = design.population.with_tolerances(design.tolerances(x)).tolerances
        true = monte_carlo(
            response, tolerances, samples=FRESH, seed=study.seed + 3, chunk=BLOCK, requirements=study.requirements
        )
        checks.append(_check(where, found, x, judged, true))
    own = found.place(study.tolerances)
    if (np.abs(own) <= 1).all():
        checks.append(_check("the study's own tolerances", found, own, judged, answer.certificate_before))
    return checks


def _check(where: str, found: Surrogate, x: np.ndarray, judged: Mapping[str, Limits], true: Statistics) -> Check:
    figures = {}
    for name, limits in judged.items():
        ours = found.figures(name, x, limits)
        theirs = {"mean": true.mean[name].value, "sd": true.sd[name].value}
        share = (true.yield_ or {}).get(name)
        theirs["yield"] = share.value if isinstance(share, Estimate) else ours["yield"]
        figures[name] = {key: (ours[key], theirs[key]) for key in ours}
    return Check(where, figures)
