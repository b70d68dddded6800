"""Outputs without errors in the model of a step: linear functions that were seen to support them.

Where such an output is the largest of several functions it has corners. Every place that was looked at gives one plane,
and a plane counts as long as it lies below all values seen.
"""

import math

import numpy as np

from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.look import Look


class Planes:
    """Limits on outputs without errors, and the priced ones, as the largest of their linear functions seen so far."""

    def __init__(self, constraints: Constraints, here: Look) -> None:
        self._constraints, self._here = constraints, here
        self.nominal = np.array([row.nominal for row in constraints.rows], bool)
        self._rows = np.flatnonzero(self.nominal)
        self._places: list[np.ndarray] = []
        self.used: list[np.ndarray] = []
        self.priced: list[float] = []
        self._slopes: list[tuple[np.ndarray, np.ndarray]] = []
        self._any = bool(self.nominal.any() or here.priced or here.priced_slopes.any())
        self._add(here.x, here.used, here.jacobian, here.priced, here.priced_slopes)

    def _add(self, x: np.ndarray, used: np.ndarray, rates: np.ndarray, priced: float, towards: np.ndarray) -> None:
        self._places.append(x)
        self.used.append(used)
        self.priced.append(priced)
        self._slopes.append((rates, towards))
        c = len(self.nominal)
        self._flat = [(k, i) for i in range(len(self._places)) for k in [*self._rows, c] if self._supports(k, i)]
        self.owner = [k for k, _ in self._flat]

    def _supports(self, k: int, i: int) -> bool:
        """True if a plane is known and lies below all values seen, or is the latest one."""
        rates, towards = self._slopes[i]
        known = math.isfinite(self._seen(k, i)) and np.isfinite(towards if k == len(self.nominal) else rates[k]).all()
        latest = i == len(self._places) - 1
        return known and (latest or all(self._value(k, i, at) <= self._seen(k, j) for j, at in enumerate(self._places)))

    def _seen(self, k: int, j: int) -> float:
        value = self.priced[j] if k == len(self.nominal) else float(self.used[j][k])
        return value + 1e-7 * (abs(value) + 1e-3)

    def _value(self, k: int, i: int, x: np.ndarray) -> float:
        rates, towards = self._slopes[i]
        priced = k == len(self.nominal)
        value, slope = (self.priced[i], towards) if priced else (float(self.used[i][k]), rates[k])
        return value + float(slope @ (x - self._places[i]))

    def seen(self, x: np.ndarray) -> float:
        """Look at these outputs at the end of a step; the largest error of the planes there, in parts of a way."""
        if not self._any:
            self.used.append(self.used[-1])
            self.priced.append(self.priced[-1])
            return 0.0
        used, rates, priced, towards = self._constraints.nominal(x)
        c = len(self.nominal)
        told = {k: max(self._value(k, i, x) for j, i in self._flat if j == k) for k in self.owner}
        off = [abs(told[k] - used[k]) for k in self._rows if k in told]
        off += [abs(told[c] - priced) / max(abs(priced), 1e-300)] if c in told else []
        error = max(off, default=0.0)
        self._add(x, used, rates, priced, towards)
        return error

    def rows(self, v: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows (m,) of vector, excesses and priced outputs that may not be negative, and their derivatives."""
        c = len(self.nominal)
        n = len(v) - c - 1
        values, slopes = np.zeros(len(self._flat)), np.zeros((len(self._flat), len(v)))
        for row, (k, i) in enumerate(self._flat):
            rates, towards = self._slopes[i]
            slopes[row, :n] = -towards / size if k == c else -rates[k]
            slopes[row, n + k] = 1.0
            value = self._value(k, i, v[:n])
            values[row] = v[n + k] - (value / size if k == c else value - 1)
        return values, slopes
