"""How far half-widths stand from the conditions of an optimum (Karush 1939, Kuhn and Tucker 1951)."""

import math

import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.sample_average import Point

_STEP = 1e-4  # of the differences of a cost, logarithm of a half-width
_BINDING = 0.05  # nearer to its limit than this part of the way a constraint may bind


def residual(costs: tuple[Cost, ...], point: Point, distance: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Largest saving of a single field that no price of the constraints accounts for, as a part of all savings.

    Savings are derivatives of the cost to the logarithms of the half-widths; the prices (not negative) are those
    that account for them best. A cost with a kink has two derivatives, and any between them will do. A field at the
    end of its range may want to go further.

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
    inside = (t > low * (1 + 1e-9)) & (t < high * (1 - 1e-9))
    taken = np.zeros(len(t))
    if pull.size and inside.any():
        prices, _ = optimize.nnls(pull[inside] / total, (loosened + tightened)[inside] / 2 / total)
        taken = pull @ prices
    wants_more = np.where(t < high * (1 - 1e-9), loosened - taken, 0.0)
    wants_less = np.where(t > low * (1 + 1e-9), taken - tightened, 0.0)
    return float(max(0.0, wants_more.max(), wants_less.max())) / total


def _saving(cost: Cost, half_width: float, sign: float) -> float:
    here, there = (float(cost(jnp.asarray(x))) for x in (half_width, half_width * math.exp(sign * _STEP)))
    return sign * (here - there) / _STEP
