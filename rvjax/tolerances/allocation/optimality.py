"""Residual of half-widths in the conditions of an optimum (Karush 1939, Kuhn and Tucker 1951)."""

import math

import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.sample_average import Point

_STEP = 1e-4  # of the differences of a cost, logarithm of a half-width
_AT = 4e-3  # a field nearer to the end of its range, as a part of it, is there: twice what a search settles to
_TINY = 1e-300
_BINDING = 0.05  # nearer to its limit than this part of the way a constraint may bind


def residual(costs: tuple[Cost, ...], point: Point, distance: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Largest saving of a single field that no price of the constraints accounts for, as a part of all savings.

    Savings are derivatives of the cost to the logarithms of the half-widths; the prices (not negative) are those
    that leave the least of them, found by a linear program. A cost with a kink has two derivatives, and any between
    them will do. A field at the end of its range may keep a saving beyond it.

    Args:
        costs: of the fields.
        point: margins and slopes at the half-widths.
        distance: (c,) of the nominal response from each limit.
        low: (j,) finest half-widths.
        high: (j,) coarsest half-widths.
    """
    t = point.half_widths
    loosened, tightened = (
        np.array([_saving(cost, float(x), sign) for cost, x in zip(costs, t)]) for sign in (1.0, -1.0)
    )
    total = float(np.maximum(loosened, tightened).sum())
    if total <= 0:
        return 0.0
    binding = np.isfinite(point.margins) & (point.margins > -_BINDING * distance)
    pull = (point.slopes[binding] / distance[binding, None]).T  # (j, c)
    above, below = t > low * (1 + _AT), t < high * (1 - _AT)
    rows = np.concatenate([-pull[below], pull[above]])  # savings of loosening left over, then those of tightening
    most = np.concatenate([-loosened[below], tightened[above]]) / total
    if not len(rows):
        return 0.0
    rows = np.column_stack([rows / np.maximum(np.abs(rows).max(axis=0, initial=0.0), _TINY), -np.ones(len(rows))])
    found = optimize.linprog(np.eye(rows.shape[1])[-1], rows, most)  # prices and residual, none negative
    return float(found.fun) if found.success else math.nan


def _saving(cost: Cost, half_width: float, sign: float) -> float:
    here, there = (float(cost(jnp.asarray(x))) for x in (half_width, half_width * math.exp(sign * _STEP)))
    return sign * (here - there) / _STEP
