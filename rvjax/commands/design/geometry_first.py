"""Optimum of the geometry without tolerances: least own cost and objective within the nominal limits.

Usual sizing computes it first. Where several points are optimal, the nearest to the start is chosen; distances count in
parts of the ranges. Modifications of the flank are matched to the errors: they belong to the second step, though they
change the curvature of the flank by a few percent.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax.records import Array
from rvjax.study import Study
from rvjax.tolerances import Variable

NEAREST = 1e-5  # weight of the distance to the start, against the change of the cost over the ranges
STEPS = 300
MODIFICATIONS = ("cycloid.equidistant_modification", "cycloid.shift_modification", "cycloid.profile_modification")


def geometry_first(study: Study) -> dict[str, float]:
    """Values of the variables that the nominal limits and prices depend on; the others stay free for the tolerances.

    Args:
        study: with variables.
    """
    fixed = {path: item.first for path, item in study.variables.items() if not item.free}
    later = {path: item.first for path, item in study.variables.items() if path.partition("[")[0] in MODIFICATIONS}
    free = {path: item for path, item in study.variables.items() if path not in fixed and path not in later}
    names = study.without_errors
    if not names or not free:
        return fixed
    response = study.nominal_response()
    nothing = study.design.error_record()
    low = np.array([item.lower for item in free.values()])
    span = np.array([item.upper for item in free.values()]) - low
    start = (np.array([item.first for item in free.values()]) - low) / span

    def outputs(x: Array) -> Array:
        values = dict(zip(free, jnp.asarray(low) + x * jnp.asarray(span)))
        found = response(nothing, values | fixed | later).value
        return jnp.stack([jnp.asarray(found[name], x.dtype) for name in names])

    value, slope = jax.jit(outputs), jax.jit(jax.jacfwd(outputs))
    slopes = np.asarray(slope(start))
    prices = np.array([study.objective[name](1.0) if name in study.objective else 0.0 for name in names])
    spread = float(np.abs(prices @ slopes).sum() + np.abs(_own_slopes(free, low, span, start)).sum()) or 1.0

    def cost(x: np.ndarray) -> float:
        own = sum(item.own_cost(v) for item, v in zip(free.values(), low + x * span))
        return float(prices @ np.asarray(value(x)) + own) / spread + NEAREST * float((x - start) @ (x - start))

    def cost_slope(x: np.ndarray) -> np.ndarray:
        total = prices @ np.asarray(slope(x)) + _own_slopes(free, low, span, x)
        return np.asarray(total / spread + 2 * NEAREST * (x - start))

    limits = [
        (names.index(name), sign, bound)
        for name, item in study.nominal.items()
        for sign, bound in ((1.0, item.lower), (-1.0, item.upper))
        if bound is not None and math.isfinite(bound)
    ]
    rows = np.array([row for row, _, _ in limits], int)
    signs, bounds = (np.array([item[k] for item in limits], float) for k in (1, 2))
    scale = signs / np.where(np.abs(bounds) > 0, np.abs(bounds), 1.0)
    kept = {
        "type": "ineq",
        "fun": lambda x: scale * (np.asarray(value(x))[rows] - bounds),
        "jac": lambda x: scale[:, None] * np.asarray(slope(x))[rows],
    }
    found = optimize.minimize(
        cost, start, jac=cost_slope, bounds=[(0, 1)] * len(free), constraints=[kept] if limits else [],
        method="SLSQP", options={"ftol": 1e-13, "maxiter": STEPS},
    )  # fmt: skip
    chosen = zip(free.items(), low + np.clip(found.x, 0, 1) * span, np.abs(slopes).max(axis=0) > 0)
    return fixed | {path: _listed(item, float(number)) for (path, item), number, seen in chosen if seen}


def _own_slopes(free: dict[str, Variable], low: np.ndarray, span: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Derivatives of the own costs, by differences of half a percent of the range."""
    step, found = 0.005, []
    for item, lower, width, at in zip(free.values(), low, span, x):
        ends = [item.own_cost(lower + width * (at + side)) for side in (-step, step)]
        found.append((ends[1] - ends[0]) / (2 * step))
    return np.array(found)


def _listed(item: Variable, value: float) -> float:
    """The value, or the nearest one of the list."""
    return min(item.among, key=lambda one: abs(one - value)) if item.among else value
