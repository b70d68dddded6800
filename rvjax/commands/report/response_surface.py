"""Surrogate of a study near its allocated tolerances: a few numbers for each unit, for the sliders of the page.

A sample of units keeps its random numbers while half-widths and places of the limits move. Each response is a quadratic
function of x_k = (p_k - allocated p_k)/reach_k, by a regression over the region |x_k| <= 1 (`region`). Rare rejects
need few units in the sample, so it is thinned with a chance that grows towards the tails (Horvitz and Thompson 1952)
and weighted so that the values at x = 0 are those of the certificate (Deville and Sarndal 1992). The error is measured
at points of the region, with fresh units, or with some of the same units of a costly response.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Self

import numpy as np

from rvjax.commands.allocate import Answer
from rvjax.commands.forecast import effort_of
from rvjax.commands.report.region import Columns, Parameter, Sample, fitted
from rvjax.population import Population, grows_from_lower, root_key
from rvjax.response import BLOCK, Part, numbers_of, parts
from rvjax.tolerances import Estimate, Limits, Statistics, Tolerance, monte_carlo

UNITS = 2048
REACH = 0.4  # of a half-width: how far it moves within the region, either way
SHIFT = 0.25  # the same of the place of its limits, in half-widths
_FLOOR = 0.5  # of the units are sampled evenly, the others from the tails
POINTS = 8  # of the region at which the error is measured
FRESH = 8 * BLOCK  # units that measure it, at each point
COMPARED = 256  # of its own units, of which the response is computed at each point where fresh ones take too long
Places = list[tuple[str, np.ndarray]]  # points of the region: name, parameters in reaches


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
        compared: units of which these checks are: "fresh", or "own" for some of its units.
    """

    parameters: tuple[Parameter, ...]
    weights: np.ndarray
    base: Mapping[str, np.ndarray]
    columns: Mapping[str, Columns]
    failed: float
    checks: tuple[Check, ...] = ()
    compared: str = "fresh"

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

    def of_units(self, units: np.ndarray) -> Self:
        """Surrogate of some of the units.

        Args:
            units: their numbers.
        """
        columns = {name: {key: c[units] for key, c in own.items()} for name, own in self.columns.items()}
        base = {name: row[units] for name, row in self.base.items()}
        weights = self.weights[units] / self.weights[units].sum()
        return dataclasses.replace(self, weights=weights, base=base, columns=columns)

    def place(self, tolerances: object) -> np.ndarray:
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


def surrogate(
    answer: Answer, *, units: int = UNITS, points: int = POINTS, fresh: int = FRESH, chunk: int = BLOCK
) -> Surrogate | None:
    """Surrogate of a result with its measured error; None if no unit is valid or nothing can move.

    Args:
        answer: result of an allocation.
        units: of the surrogate; a costly response has those of its `Effort`.
        points: of the region at which the error is measured.
        fresh: independent units at each point; a costly response has `COMPARED` of its own units.
        chunk: units in one call.
    """
    study, side = answer.study, answer.after
    names, response = tuple(study.requirements), study.units
    own = effort_of(response).surrogate
    count, compared = own or units, "own" if own else "fresh"
    parameters = tuple(_parameters(answer))
    full = np.stack([np.asarray(side.values[name], float) for name in names])
    valid = np.flatnonzero(np.isfinite(full).all(axis=0))
    if len(valid) < count or not parameters:
        return None
    chance = _chances(full[:, valid], count)
    chosen = _thinned(chance, count, np.random.default_rng(study.seed))
    population = Population.of(side.tolerances)
    z = numbers_of(population, root_key(side.seed), valid[chosen])
    sample = Sample(population, parameters, z, study.seed + 1)
    solved = parts(response, population)
    base, columns = fitted(solved, sample)
    good = np.isfinite(np.stack([base[name] for name in names])).all(axis=0)
    certificate = answer.allocation.certificate
    failed = certificate.failed / certificate.samples
    found = Surrogate(parameters, 1 / chance[chosen], base, columns, failed, compared=compared)
    found = found.of_units(np.flatnonzero(good))
    weights = _calibrated(found.weights, found.base, study.requirements, certificate, failed)
    found = dataclasses.replace(found, weights=weights)
    places = _points(found, study.seed, points)
    if compared == "own":
        checks = _own_checks(found, answer, solved, sample, np.flatnonzero(good), places)
    else:
        run = partial(monte_carlo, response, samples=fresh, chunk=chunk)
        checks = _checks(found, answer, sample, run, places)
    return dataclasses.replace(found, checks=tuple(checks))


def placed(tolerance: Tolerance) -> float:
    """Place of the limits: mid-point, or the lower limit if the distribution begins there."""
    return float(tolerance.lower if grows_from_lower(tolerance) else tolerance.middle)


def _parameters(answer: Answer) -> list[Parameter]:
    study, found = answer.study, []
    for field in study.fields:
        tolerance = getattr(answer.after.tolerances, field)
        half = float(tolerance.half_width)
        if half == 0 or tolerance.law.name == "empirical":  # constant, or measured: its limits do not say where it is
            continue
        found.append(Parameter(field, False, half, REACH * half))
        inputs = study.middles.get(field)
        if not tolerance.law.of_vectors and (inputs or field not in study.forms):  # a drawing states widths only
            reach = max(SHIFT * half, (inputs.upper - inputs.lower) / 8 if inputs else 0.0)
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


def _checks(
    found: Surrogate, answer: Answer, sample: Sample, run: Callable[..., Statistics], places: Places
) -> list[Check]:
    """Compare the surrogate with independent units, at points of the region and at the study if it is near."""
    study, checks, limited = answer.study, [], _limited(answer)
    for where, x in places:
        tolerances = sample.at(x).tolerances
        true = run(tolerances, seed=study.seed + 3, requirements=study.requirements)
        checks.append(_check(where, found, x, limited, true))
    own = found.place(study.tolerances)
    if (np.abs(own) <= 1).all():
        checks.append(_check("the study's own tolerances", found, own, limited, answer.certificate_before))
    return checks


def _own_checks(
    found: Surrogate, answer: Answer, solved: Sequence[Part], sample: Sample, units: np.ndarray, places: Places
) -> list[Check]:
    """Compare the surrogate with the responses of some of its own `units` of the sample, at points of the region."""
    place = np.arange(0, len(found.weights), -(-len(found.weights) // COMPARED))
    ours, checks = found.of_units(place), []
    for where, x in places:
        errors = sample.errors(x, units[place])
        rows = [zip(part.names, part.of_elements(sample.population, errors)[0]) for part in solved]
        exact = dict(itertools.chain(*rows))
        here = np.isfinite(np.stack(list(exact.values()))).all(axis=0)
        figures = {}
        for name, limits in _limited(answer).items():
            both = ours.of_units(np.flatnonzero(here))
            truth = dataclasses.replace(both, base={name: exact[name][here]}, columns={name: {}})
            mine, true = both.figures(name, x, limits), truth.figures(name, x, limits)
            figures[name] = {key: (mine[key], true[key]) for key in mine}
        checks.append(Check(where, figures))
    return checks


def _limited(answer: Answer) -> dict[str, Limits]:
    return {name: item for name, item in answer.study.requirements.items() if item.limits_values}


def _points(found: Surrogate, seed: int, count: int) -> Places:
    """Points of the region: all finer, all coarser, random ones."""
    width = np.array([not p.place for p in found.parameters], float)
    rng = np.random.default_rng(seed + 1)
    points = [("all half-widths finer", -width), ("all half-widths coarser", width)]
    return points + [(f"random point {n + 1}", rng.uniform(-1, 1, len(width))) for n in range(count - len(points))]


def _check(where: str, found: Surrogate, x: np.ndarray, limited: Mapping[str, Limits], true: Statistics) -> Check:
    figures = {}
    for name, limits in limited.items():
        ours = found.figures(name, x, limits)
        theirs = {"mean": true.mean[name].value, "sd": true.sd[name].value}
        share = (true.yield_ or {}).get(name)
        theirs["yield"] = share.value if isinstance(share, Estimate) else ours["yield"]
        figures[name] = {key: (ours[key], theirs[key]) for key in ours}
    return Check(where, figures)
