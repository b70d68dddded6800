"""Model of a step: planes below outputs without errors, and the interior point method that finds its minimum.

An output without errors has corners where it is the largest of several functions. Every place that was looked at gives
one plane, and a plane counts as long as it lies below all values seen.

The minimum takes primal-dual Newton steps (Nocedal and Wright, Numerical Optimization, chapter 19) with second
derivatives, which are nearly diagonal here. SLSQP needs some hundred updates of a dense matrix for 200 fields, 2 s a
step for 0.05 s.
"""

import dataclasses
import math
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.decisions import ROUNDING
from rvjax.tolerances.allocation.look import Look


class Planes:
    """Limits on outputs without errors, and the priced ones, as the largest of their linear functions seen so far."""

    def __init__(self, constraints: Constraints, here: Look) -> None:
        self._constraints = constraints
        self.nominal = np.array([row.nominal for row in constraints.rows], bool)
        self._rows = [*np.flatnonzero(self.nominal).tolist(), len(self.nominal)]  # the last one of the priced outputs
        self._places: list[np.ndarray] = []
        self._slopes: list[np.ndarray] = []
        self.values: list[np.ndarray] = []
        """Used ways and priced outputs (c + 1,) at every place."""
        self._any = bool(self.nominal.any() or here.priced or here.priced_slopes.any())
        self._add(here.x, here.used, here.jacobian, here.priced, here.priced_slopes)

    def _add(self, x: np.ndarray, used: np.ndarray, rates: np.ndarray, priced: float, towards: np.ndarray) -> None:
        self._places.append(x)
        self.values.append(np.append(used, priced))
        self._slopes.append(np.vstack([rates, towards]))
        self._flat = [(k, i) for i in range(len(self._places)) for k in self._rows if self._supports(k, i)]
        self.owner = [k for k, _ in self._flat]

    def _supports(self, k: int, i: int) -> bool:
        """True if a plane is known and lies below all values seen, or is the latest one."""
        known = math.isfinite(self._seen(k, i)) and np.isfinite(self._slopes[i][k]).all()
        latest = i == len(self._places) - 1
        return known and (latest or all(self._value(k, i, at) <= self._seen(k, j) for j, at in enumerate(self._places)))

    def _seen(self, k: int, j: int) -> float:
        value = float(self.values[j][k])
        return value + 1e-7 * (abs(value) + 1e-3)

    def _value(self, k: int, i: int, x: np.ndarray) -> float:
        return float(self.values[i][k]) + float(self._slopes[i][k] @ (x - self._places[i]))

    def seen(self, x: np.ndarray) -> float:
        """Look at these outputs at the end of a step; the largest error of the planes there, in parts of a way."""
        if not self._any:
            self.values.append(self.values[-1])
            return 0.0
        told = {k: max(self._value(k, i, x) for j, i in self._flat if j == k) for k in self.owner}
        self._add(x, *self._constraints.nominal(x))
        sizes = [1.0] * len(self.nominal) + [max(abs(float(self.values[-1][-1])), 1e-300)]
        return max((abs(value - self.values[-1][k]) / sizes[k] for k, value in told.items()), default=0.0)

    def rows(self, v: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows (m,) of vector, excesses and priced outputs that may not be negative, and their derivatives."""
        c = len(self.nominal)
        n = len(v) - c - 1
        values, slopes = np.zeros(len(self._flat)), np.zeros((len(self._flat), len(v)))
        for row, (k, i) in enumerate(self._flat):
            slopes[row, :n] = -self._slopes[i][k] / (size if k == c else 1.0)
            slopes[row, n + k] = 1.0
            value = self._value(k, i, v[:n])
            values[row] = v[n + k] - (value / size if k == c else value - 1)
        return values, slopes


_STEPS = 80
_CENTRED, _SHORT = 0.15, 0.995  # part of the gap that a step leaves; of the way to the boundary
_INSIDE = 1e-2  # of a range, by which a start lies inside it
_TINY = 1e-11  # curvature of variables that have none
_FLOOR = 1e-14  # of a span, distance of a variable from its bound, at least: times a price of 1e4 it is no gap


@dataclasses.dataclass(frozen=True)
class Model:
    """Values and derivatives of a model at a vector (n,).

    Attributes:
        slopes: (n,) of the objective.
        hessian: (n, n) of the objective less the priced rows, positive semidefinite.
        rows: (m,) that may not be negative.
        jacobian: (m, n) of the rows.
    """

    slopes: np.ndarray
    hessian: np.ndarray
    rows: np.ndarray
    jacobian: np.ndarray


def minimum(
    model: Callable[[np.ndarray, np.ndarray], Model], start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Minimum (n,) of a model, and the prices (m,) of its rows.

    Args:
        model: of a vector and the prices of the rows.
        start: (n,) vector.
        low: (n,) bounds, -inf for none.
        high: (n,) bounds, inf for none.
    """
    span = np.where(np.isfinite(high - low), high - low, 1.0)
    v = np.clip(start, low + _INSIDE * span, high - _INSIDE * span)
    here = model(v, np.zeros(0))
    slack = np.maximum(here.rows, 0.1)
    prices = 0.1 / slack
    below, above = (
        np.where(np.isfinite(end), 0.1 / np.maximum(np.abs(end - v), 1e-3 * span), 0.0) for end in (low, high)
    )
    rounding = max(ROUNDING, 10 * float(np.finfo(jnp.result_type(float)).eps))  # costs may be in float32
    bounded = np.isfinite(low).sum() + np.isfinite(high).sum() + len(slack)
    for _ in range(_STEPS):
        here = model(v, prices)
        under = np.where(np.isfinite(low), np.maximum(v - low, _FLOOR * span), 1.0)
        over = np.where(np.isfinite(high), np.maximum(high - v, _FLOOR * span), 1.0)
        gap = float(slack @ prices + under @ below + over @ above) / max(bounded, 1)
        off = here.slopes - here.jacobian.T @ prices - below + above
        missed = here.rows - slack
        if max(gap, float(np.abs(off).max()), float(np.abs(missed).max(initial=0.0))) < rounding:
            break
        aim = _CENTRED * gap
        to_rows = (aim - slack * prices - prices * missed) / slack
        to_low = np.where(np.isfinite(low), aim / under - below, 0.0)
        to_high = np.where(np.isfinite(high), aim / over - above, 0.0)
        matrix = here.hessian + here.jacobian.T @ ((prices / slack)[:, None] * here.jacobian)
        matrix[np.diag_indices(len(v))] += below / under + above / over + _TINY
        dv = np.linalg.solve(matrix, -off + here.jacobian.T @ to_rows + to_low - to_high)
        ds = here.jacobian @ dv + missed
        dp = to_rows - prices / slack * (here.jacobian @ dv)
        db, da = to_low - below / under * dv, to_high + above / over * dv
        primal = _SHORT * min(_way(slack, ds), _way(under, np.where(np.isfinite(low), dv, 0.0)),
                              _way(over, np.where(np.isfinite(high), -dv, 0.0)))  # fmt: skip
        dual = _SHORT * min(_way(prices, dp), _way(below, db), _way(above, da))
        v, slack = v + primal * dv, slack + primal * ds
        prices, below, above = prices + dual * dp, below + dual * db, above + dual * da
    return np.clip(v, low, high), prices


def _way(values: np.ndarray, steps: np.ndarray) -> float:
    """Largest part of a step, at most 1, that leaves no value negative."""
    falling = steps < 0
    return min(1.0, float((-values[falling] / steps[falling]).min(initial=np.inf)))
