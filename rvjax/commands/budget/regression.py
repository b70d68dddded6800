"""Error budget of a costly curve: variances of the linear part, by a regression of the curve on the errors of units.

With the errors x_i of unit i about their mean and its wave X_i, X_i = mean + c' x_i + rest. The variance of a field is
c_f' S_ff c_f with the covariance S of the errors, less sigma^2 tr(S_ff (X' X)^-1_ff): what a coefficient has by chance.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.commands.budget.budgets import Budget, curve_along, error_budget, waves_of
from rvjax.commands.budget.effects import parts_of, squares
from rvjax.outputs import torque_of
from rvjax.population import Population, drawn, root_key
from rvjax.response import elements, parts
from rvjax.study import CURVE, Study

PER_ELEMENT = 3  # units for each number of the errors, at least
FEWEST = 768


def budget_if_any(study: Study, tolerances: Any = None) -> Budget | None:
    """The budget of a study with a torque and a response that has a curve along the output; None for another study.

    That of a costly curve is linear, and under the load of the study only.

    Args:
        study: design, conditions and tolerances.
        tolerances: other than those of the study.
    """
    if curve_along(study, tuple(study.requirements)) is None or not torque_of(study.conditions):
        return None
    found = linear_budget(study, study.tolerances if tolerances is None else tolerances) if study.costly else None
    return found or error_budget(study, tolerances=tolerances)


def linear_budget(study: Study, tolerances: Any) -> Budget | None:
    """Budget under the load of the study; None where no costly output reads the curve.

    Args:
        study: design, conditions and requirements.
        tolerances: whose budget it is.
    """
    curve = curve_along(study, tuple(study.requirements))
    response, population = study.response(), Population.of(tolerances)
    drawing = [part for part in parts(response, population) if getattr(part.response, "curve", False)]
    if curve is None or curve is not study.curve or curve.turns is None or not (response.costly and drawing):
        return None
    torque = torque_of(study.conditions)
    numbers = sum(int(np.prod(t.shape)) for t in population.active.values())
    samples = max(FEWEST, PER_ELEMENT * numbers)
    z = np.asarray(drawn(population, root_key(study.seed), jnp.uint32(0), count=samples))
    waves = waves_of(drawing[0].rows(population, z, CURVE))
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
