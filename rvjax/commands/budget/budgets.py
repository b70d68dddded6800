"""Error budgets: variance of a curve over units, by error, part, stage and order of the output revolution.

Every share is a total effect (Sobol): half the mean square change of a harmonic when one error is resampled and all
others stay (Jansen, Comput. Phys. Commun. 117, 1999). No derivative is used, so kinks and clearance are allowed.

Linear shares do not include interactions. From a unit a to another unit b, a harmonic changes by what each error
changes alone, and a rest R = f(b) - f(a) - sum_i (f(a with b_i) - f(a)), zero for every unit where errors only add up.
Terms of the variance decomposition (ANOVA) of m errors, of variance V, are orthogonal at these points and leave
E R^2 = (m^2 - m + 2) V: 4 V of pairs and more of others, so that E R^2 / 4 bounds what is together from above.

The page of a costly study has the variances of the linear part of its curve, by a regression on the errors of units.
With the errors x_i of unit i about their mean and its wave X_i, X_i = mean + c' x_i + rest. The variance of a field is
c_f' S_ff c_f with the covariance S of the errors, less sigma^2 tr(S_ff (X' X)^-1_ff): what a coefficient has by chance.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax._jax.sizes import AT_ONCE
from rvjax.base.progress import progress_bar
from rvjax.base.words import choose
from rvjax.commands.budget.effects import FEWEST, MOST, by_level, curves_of, of_load, parts_of, squares
from rvjax.outputs import Curve, torque_condition, torque_of
from rvjax.population import Population, drawn, root_key
from rvjax.response import BLOCK, elements, numbers_of, parts
from rvjax.study import Study, naming
from rvjax.tolerances import Influence, influences

UNLOADED = 1e-3  # of the torque: the limit of no load, as on a test bench


@dataclass(frozen=True)
class Budget:
    """Shares of the variance of a curve over units, about its mean over the cycle.

    Attributes:
        title: of the curve.
        unit: SI unit of the curve.
        orders: of the waves, in periods a turn of the output, (k,) ascending; the first, 0, is the mean over the cycle
            and in no sum.
        torque: {load: N m}.
        variance: {load: {error: (k,) mean square that is gone from each wave when this error is held}}, unit squared.
        error: {load: {error: standard error of the sum of its variances}}.
        total: {load: (k,) variance of each wave over the units}. The shares sum to more where errors act together.
        together: {load: (share of the variance that errors have together, at most, its standard error)}.
        alike: {load: (k,) mean square of each wave that all units have in common}, of the design and its load.
        part: {error: part of the reducer}.
        samples: units, of which `failed` have no curve and are left out.
        failed: {load: units without a curve, or with a neighbour without one}.
        linear: variances are those of a linear regression, not of units with one error resampled.
    """

    title: str
    unit: str
    orders: np.ndarray
    torque: dict[str, float]
    variance: dict[str, dict[str, np.ndarray]]
    error: dict[str, dict[str, float]]
    total: dict[str, np.ndarray]
    together: dict[str, tuple[float, float]]
    alike: dict[str, np.ndarray]
    part: dict[str, str]
    samples: int
    failed: dict[str, int]
    linear: bool = False

    def by(self, level: str, load: str) -> dict[str, np.ndarray]:
        """Variances (k,) of the errors, or summed over those of a part or stage, the largest first.

        Args:
            level: "field", "part" or "stage".
            load: key of `torque`.

        Raises:
            ValueError: another level.
        """
        return by_level(level, self.variance[load], self.part)

    def shares(self, level: str, load: str) -> dict[str, float]:
        """Shares of the variance without the mean curve; they sum to 1, or are all 0 if nothing varies.

        Args:
            level: as in `by`.
            load: key of `torque`.
        """
        sums = {name: float(values[1:].sum()) for name, values in self.by(level, load).items()}
        total = sum(sums.values())
        return {name: value / total if total > 0 else 0.0 for name, value in sums.items()}


def error_budget(
    study: Study,
    *,
    output: str | None = None,
    tolerances: object = None,
    loads: Mapping[str, float] | None = None,
    samples: int = 256,
    seed: int | None = None,
) -> Budget:
    """The error budget of the curve that belongs to an output, such as the transmission error along the output.

    Args:
        study: design, conditions and tolerances. Over one crank turn only multiples of the pin count are seen, and what
            lies between them falls on its neighbours; the condition `span` of the loaded model shows every order.
        output: of the study, whose model has a curve along the output; by default the first that has one.
        tolerances: other than those of the study, such as allocated ones.
        loads: torques by name, N m; by default "loaded", that of the study, and "unloaded", a thousandth of it.
        samples: units; each is solved twice, and once for every error. 256 units give a share of 10 % within 1 %.
        seed: by default that of the study.

    Raises:
        ValueError: no curve along the output, no torque, fewer than 16 samples or more than 65536.
    """
    if not FEWEST <= samples <= MOST:
        raise ValueError(f"samples = {samples}: must be at least {FEWEST} and at most {MOST}")
    study = _of_curves(study)
    curve = _curve(study, output)
    given = study.conditions
    name = torque_condition(given)
    if loads is None:
        if not (torque := torque_of(given)):
            raise ValueError(f"conditions.{name or 'torque'} = 0 N m: a budget under load needs a torque")
        loads = {"loaded": torque, "unloaded": UNLOADED * torque}
    population = Population.of(study.tolerances if tolerances is None else tolerances)
    key = root_key(study.seed if seed is None else seed)

    def draw(first: int, *, count: int) -> np.ndarray:
        return numbers_of(population, key, first + np.arange(count))

    blocks = -(-samples // AT_ONCE)
    found = {}
    with progress_bar(False, len(loads) * blocks * (2 + len(population.active)), "solving", "block") as advance:

        def solve(torque: float, z: np.ndarray) -> np.ndarray:
            _, curves = curves_of(curve, study.design, given, population, z, torque)
            advance(1)
            return waves_of(curves)

        for load, torque in loads.items():
            with naming(f"study {study.name}, {load}, {torque:g} N m"):
                found[load] = of_load(partial(solve, torque), draw, population, samples)
    first = next(iter(found.values()))
    by_load: dict[str, Any] = {name: {load: one[name] for load, one in found.items()} for name in first}
    assert curve.turns is not None
    return Budget(
        title=curve.title,
        unit=curve.unit,
        orders=np.arange(len(first["total"])) / curve.turns(study.design, given),
        torque=dict(loads),
        part=parts_of(study, population),
        samples=samples,
        **by_load,
    )


def waves_of(curves: np.ndarray) -> np.ndarray:
    """Amplitudes X_k of y = Re sum X_k e^(2 pi i k j / n) below the half of n, (units, k); NaN of a failed unit.

    Args:
        curves: over one cycle (units, n).
    """
    count = (curves.shape[1] + 1) // 2
    waves = np.fft.rfft(curves, axis=1)[:, :count] / curves.shape[1]
    waves[:, 1:] *= 2
    return np.where(np.isfinite(curves).all(axis=1)[:, None], waves, np.nan)


def _curve(study: Study, output: str | None) -> Curve:
    """The curve along the output of one model."""
    if output is not None:
        choose("output", output, study.requirements)
    curve = curve_of(study, output)
    if curve is None:
        raise ValueError(f"study {study.name}: no response required here has a curve along the output")
    return curve


def curve_of(study: Study, output: str | None) -> Curve | None:
    """The curve along the output that a response is a value of; without a response, the first of the study.

    Args:
        study: with the design.
        output: required response of the study.
    """
    described = models.kind(study.design).described
    curves = ((described[name].curve, name) for name in (study.requirements if output is None else (output,)))
    curve, name = next(((c, name) for c, name in curves if c is not None and c.turns is not None), (None, ""))
    if curve is None or (output is not None and curve.outputs and output not in curve.outputs):
        return None
    return study.titled(curve, name)


@dataclass(frozen=True)
class ScalarBudget:
    """Shares of the variance of one response over units.

    Attributes:
        output: name of the response.
        influence: of the errors, as in the result of an allocation.
        part: {error: part of the reducer}.
    """

    output: str
    influence: Influence
    part: dict[str, str]

    def by(self, level: str) -> dict[str, float]:
        """Variances of the errors, or summed over those of a part or stage, the largest first.

        Args:
            level: "field", "part" or "stage".
        """
        return by_level(level, self.influence.variance, self.part)


def scalar_budget(study: Study, output: str, *, samples: int = 256, seed: int | None = None) -> ScalarBudget:
    """The error budget of a response by total effects: each error of a unit is sampled again.

    Args:
        study: design, conditions and tolerances.
        output: required response of the study.
        samples: units; each is solved once, and once for every error unless the response is linear.
        seed: by default that of the study.

    Raises:
        ValueError: fewer than 16 samples or more than 65536, or none of the units has a value.
    """
    if not FEWEST <= samples <= MOST:
        raise ValueError(f"samples = {samples}: must be at least {FEWEST} and at most {MOST}")
    seed = study.seed if seed is None else seed
    population = Population.of(study.tolerances)
    response, chunk = study.units, min(samples, BLOCK)
    with progress_bar(False, samples * len(population.active), "solving", "unit") as advance:
        (found,) = influences(
            response, study.tolerances, seed=seed, units=samples, chunk=chunk, names=(output,), advance=advance
        ).values()
    if found.failed == samples:
        raise ValueError(f"none of {samples} units can be solved")
    return ScalarBudget(output, found, parts_of(study, population))


CURVE_ANGLES = 251  # a prime number: the orders of pins and lobes fall on no other up to 125


def _of_curves(study: Study) -> Study:
    """The study with all angles of a curve in each unit, where units choose some."""
    if not study.chooses_angles:
        return study
    fewer = dict(samples=min(study.conditions.samples, CURVE_ANGLES), chosen_angles=None)
    return replace(study, conditions=replace(study.conditions, **fewer))


PER_ELEMENT = 3  # units for each number of the errors, at least
FEWEST_REGRESSED = 768


def budget_if_any(study: Study, tolerances: object = None) -> Budget | None:
    """The budget of a study with a torque and a response that has a curve along the output; None for another study.

    That of a curve that outputs of equilibria read is linear, and under the load of the study only.

    Args:
        study: design, conditions and tolerances.
        tolerances: other than those of the study.
    """
    if curve_of(study, None) is None or not torque_of(study.conditions):
        return None
    found = linear_budget(study, study.tolerances if tolerances is None else tolerances)
    return found or error_budget(study, tolerances=tolerances)


def linear_budget(study: Study, tolerances: object) -> Budget | None:
    """Budget under the load of the study; None where no part of the response has the numbers of the curve.

    Args:
        study: design, conditions and requirements.
        tolerances: whose budget it is.
    """
    study = _of_curves(study)
    curve = curve_of(study, None)
    response, population = study.response(), Population.of(tolerances)
    drawing = [part for part in parts(response, population) if getattr(part.response, "curve", False)]
    if curve is None or curve != study.curve or curve.turns is None or not drawing:
        return None
    torque = torque_of(study.conditions)
    numbers = sum(int(np.prod(t.shape)) for t in population.active.values())
    samples = max(FEWEST_REGRESSED, PER_ELEMENT * numbers)
    z = np.asarray(drawn(population, root_key(study.seed), jnp.uint32(0), count=samples))
    waves = waves_of(drawing[0].curves(population, z))
    good = np.isfinite(waves).all(axis=1)
    if good.sum() <= numbers + 1:
        return None
    errors = np.asarray(elements(population, jnp.asarray(z)), float)[:, good]
    load = "loaded"
    found = fitted(errors, waves[good], {name: int(np.prod(t.shape)) for name, t in population.active.items()})
    return Budget(
        title=curve.title,
        unit=curve.unit,
        orders=np.arange(waves.shape[1]) / curve.turns(study.design, study.conditions),
        torque={load: torque},
        part=parts_of(study, population),
        samples=samples,
        failed={load: int(samples - good.sum())},
        linear=True,
        **{name: {load: value} for name, value in found.items()},
    )


def fitted(errors: np.ndarray, waves: np.ndarray, sizes: dict[str, int]) -> dict[str, Any]:
    """Variances and their errors by field, and of the whole, as in `Budget`, for one load.

    Args:
        errors: of the units (elements, n), one field after the other.
        waves: of the units (n, k).
        sizes: {field: its elements}.
    """
    count, (numbers, power) = len(waves), (len(errors), squares(waves.shape[1]))
    x = (errors - errors.mean(axis=1, keepdims=True)).T
    scale = x.std(axis=0)
    x = x / np.where(scale > 0, scale, 1.0)
    mean = waves.mean(axis=0)
    inverse = np.linalg.pinv(x.T @ x)
    slopes = inverse @ (x.T @ (waves - mean))
    rest = power * np.abs(waves - mean - x @ slopes) ** 2 * (count / (count - numbers - 1))
    noise, total = rest.mean(axis=0), power * (np.abs(waves - mean) ** 2).sum(axis=0) / (count - 1)
    variance, error, start = {}, {}, 0
    for name, size in sizes.items():
        own = slice(start, start := start + size)
        change = power * np.abs(x[:, own] @ slopes[own]) ** 2
        chance = float(np.trace((x[:, own].T @ x[:, own]) @ inverse[own, own])) / count
        variance[name] = np.maximum(change.mean(axis=0) - chance * noise, 0.0)
        drawn_, known = change[:, 1:].sum(axis=1).var() / count, 4 * variance[name][1:] @ noise[1:] / count
        error[name] = float(np.sqrt(drawn_ + known))
    whole, left = total[1:].sum(), rest[:, 1:].sum(axis=1)
    share = (float(left.mean() / whole), float(left.std() / np.sqrt(count) / whole)) if whole > 0 else (0.0, 0.0)
    alike = power * np.abs(mean) ** 2
    return {"variance": variance, "error": error, "total": total, "together": share, "alike": alike}
