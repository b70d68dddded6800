"""Units with separate and shared elements: one joint mode, by elimination of the separate elements.

Unit i with slopes J_i over its separate z_i and K_i over the shared w adds rows [J_i, K_i | -r_i] to one least squares
problem. The triangular factor of these rows, with the prior of z_i below them, has z_i above and leaves a few rows for
w alone; those of all units together give the step of w, then each unit its own. So cov w = S^-1 and
cov z_i = A_i^-1 + A_i^-1 B_i S^-1 B_i' A_i^-1 with A = I + J'J, B = J'K and S = I + sum (K'K - B'A^-1 B), without a
square of J. Only the factors of all units are kept; slopes are in memory for one chunk.
"""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rvjax.identify.elements import Elements, compress_rows
from rvjax.identify.gauss_newton import ROUNDINGS, TOLERANCE, half_square, share_of, weights_of
from rvjax.identify.identification import Problem
from rvjax.status import Status

HOPELESS = 12
"""Trials in a row that are not finite, after which a unit is excluded: its steps are below 1e-9 by then."""


class Units(NamedTuple):
    """Units at their modes, on the host."""

    u: np.ndarray  # all elements (k, p)
    u_sd: np.ndarray  # (k, p)
    residual: np.ndarray  # (k, m)
    rows: np.ndarray  # of `linear_rows` (k, rows, p + 1)
    several: np.ndarray  # more than one mode that counts (k,)
    status: np.ndarray  # (k,)
    steps: np.ndarray  # (k,)
    away: np.ndarray  # (k,)


@dataclasses.dataclass(frozen=True, eq=False)
class Split:
    """Elements and columns of M of the single units, and those common to all units."""

    own: np.ndarray
    shared: np.ndarray
    own_columns: np.ndarray
    shared_columns: np.ndarray

    @classmethod
    def of(cls, elements: Elements, shared: str | Iterable[str]) -> "Split":
        """Return the split of the elements that users name.

        Raises:
            ValueError: an unknown name, or a correlation between shared and separate elements.
        """
        common = elements.places("shared", shared)
        own = np.setdiff1d(np.arange(elements.count), common)
        touched = elements.mixing != 0
        of_common, of_own = touched[common].any(axis=0), touched[own].any(axis=0)
        both = of_common & of_own
        if both.any():
            column = int(np.argmax(both))
            names = (elements.names[places[touched[places, column]][0]] for places in (common, own))
            raise ValueError("correlation: shared {} and own {} must be independent".format(*names))
        return cls(own, common, np.flatnonzero(~of_common), np.flatnonzero(of_common))


def linear_rows(problem: Problem, slopes: np.ndarray, u: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Slopes (..., m, p) and linearised data J u - r (..., m, p + 1); of normal noise turned into fewer rows."""
    datum = (slopes @ u[..., None])[..., 0] - residual
    rows = np.concatenate([slopes, datum[..., None]], axis=-1)
    return compress_rows(rows) if problem.dof is None else rows


def triangular(rows: np.ndarray) -> np.ndarray:
    """Return the factor R (units, n, n) of rows (units, m, n); fewer than n rows are completed by zeros."""
    if (missing := rows.shape[2] - rows.shape[1]) > 0:
        rows = np.pad(rows, ((0, 0), (0, missing), (0, 0)))
    return np.asarray(np.linalg.qr(rows, mode="r"))


class _Step(NamedTuple):
    """One damped step of all units, and the factors it came from."""

    own: np.ndarray  # (units, no)
    common: np.ndarray  # (ns,)
    away: float
    upper: np.ndarray  # R_J (units, no, no)
    across: np.ndarray  # T (units, no, ns)
    shared: np.ndarray  # R_S (ns, ns)


def _step(factors: np.ndarray, z: np.ndarray, w: np.ndarray, damping: np.ndarray) -> _Step:
    """Return the step; `damping` (units + 1,) is that of each unit and of the shared elements."""
    units, no = z.shape
    ns, root, own = w.size, np.sqrt(1 + damping[-1]), np.sqrt(1 + damping[:-1, None])
    prior = np.zeros((units, no, no + ns + 1))
    prior[:, np.arange(no), np.arange(no)] = own
    prior[:, :, -1] = -z / own
    triangle = triangular(np.concatenate([factors, prior], axis=1))
    upper, across, right = triangle[:, :no, :no], triangle[:, :no, no:-1], triangle[:, :no, -1]
    common = np.concatenate([root * np.eye(ns), -(w / root)[:, None]], axis=1)
    (rest,) = triangular(np.concatenate([triangle[:, no:, no:].reshape(-1, ns + 1), common])[None])
    shared, below = rest[:ns, :ns], rest[:ns, -1]
    dw = np.linalg.solve(shared, below)
    dw = share_of(dw) * dw
    dz = np.linalg.solve(upper, (right - across @ dw)[..., None])[..., 0]
    dz = share_of(dz)[:, None] * dz
    return _Step(dz, dw, float(np.sqrt((right**2).sum() + below @ below)), upper, across, shared)


class Joint:
    """All units at one point, evaluated chunk by chunk."""

    def __init__(self, problem: Problem, split: Split, y: np.ndarray, rows: list[slice]) -> None:
        """Create the evaluation of units y (units, m) in the chunks `rows`."""
        self.problem, self.split, self.y, self.rows = problem, split, y, rows
        self.mixing = problem.elements.mixing
        self.order = np.concatenate([split.own_columns, split.shared_columns])
        self.active = np.ones(len(y), bool)
        self.z, self.w = np.zeros((len(y), split.own_columns.size)), np.zeros(split.shared_columns.size)
        self.phi, self.steps, self.away, self.status = np.inf, 0, np.inf, Status.NONFINITE
        self.u_sd, self.shared_u, self.shared_sd = np.zeros((len(y), len(self.mixing))), self.w, self.w

    def evaluate(self, part: slice, z: np.ndarray, w: np.ndarray) -> list[np.ndarray]:
        """Evaluate the units of a chunk.

        Returns:
            Triangular factors (k, n + 1, n + 1) of the weighted rows [J, -r] with the columns in this order, what the
            data add to Phi (k,), residuals, slopes over u, and the size of the numbers behind them.
        """
        own, dof = z[part], self.problem.dof
        numbers = np.empty((len(own), self.mixing.shape[1]))
        numbers[:, self.split.own_columns] = own
        numbers[:, self.split.shared_columns] = w
        together = self.rows[0].stop
        residual, slopes, _, size = self.problem.linearise(self.y[part], numbers @ self.mixing.T, together=together)
        rows = np.concatenate([slopes @ self.mixing[:, self.order], -residual[..., None]], axis=-1)
        rows = np.sqrt(weights_of(residual, dof))[..., None] * rows
        fine = np.isfinite(rows).all(axis=(1, 2), keepdims=True)
        factors = np.where(fine, triangular(np.where(fine, rows, 0.0)), np.nan)
        return [factors, half_square(residual, dof), residual, slopes, size]

    def all(self, z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Factors of all units, what their data add to Phi, and the size of the numbers."""
        parts = [self.evaluate(part, z, w) for part in self.rows]
        return tuple(np.concatenate([part[k] for part in parts]) for k in (0, 1, 4))  # type: ignore[return-value]

    def solve(self, start: np.ndarray, max_steps: int) -> None:
        """Go to the joint mode from a start z (n,), the same for every unit.

        Each unit has a separate damping, so that a unit where the model is not finite does not shorten the steps of
        others. A kink that moves with what is shared ends as MAX_STEPS: no step along it lowers every side.
        """
        units = len(self.y)
        z, w = np.tile(start[self.split.own_columns], (units, 1)), start[self.split.shared_columns]
        factors, data, size = self.all(z, w)
        self.active = np.isfinite(data) & np.isfinite(factors).all(axis=(1, 2))
        damping, growth, failures = np.zeros(units + 1), np.full(units + 1, 2.0), np.zeros(units, int)
        phi, slack, whole, enough = np.full(units, np.inf), np.zeros(units), np.inf, TOLERANCE
        least = ROUNDINGS * np.finfo(factors.dtype).eps
        trial = z, w
        for steps in range(max_steps + 1):
            finite = np.isfinite(data) & np.isfinite(factors).all(axis=(1, 2))
            failures = np.where(finite, 0, failures + 1)
            self.active &= failures < HOPELESS
            live = self.active
            new_phi = np.where(live, (trial[0] ** 2).sum(axis=1) / 2 + data, 0.0)
            total = new_phi.sum() + trial[1] @ trial[1] / 2
            better = new_phi <= phi + slack
            if finite[live].all() and total <= whole + slack.sum():
                (z, w), phi, whole = (np.where(live[:, None], trial[0], 0.0), trial[1]), new_phi, total
                at = np.where(live[:, None, None], factors, 0.0)
                rounding = np.where(live, least * size, 0.0)
                slack = rounding * np.sqrt(2 * phi) + rounding**2 + least * phi
                # Every unit may be as far off as a single one.
                enough = TOLERANCE * np.sqrt(units) + np.linalg.norm(rounding)
                damping, growth = damping / 9, np.full(units + 1, 2.0)
            else:
                worse = np.append(~(better & finite), True)
                damping = np.where(worse, np.maximum(damping, 1e-3) * growth, damping)
                growth = np.where(worse, 2 * growth, growth)
            if not live.any():
                break
            step = _step(at, z, w, damping)
            self.away, self.steps = step.away, steps
            if step.away <= enough or steps == max_steps:
                break
            trial = z + step.own, w + step.common
            factors, data, size = self.all(*trial)
        self.z, self.w, self.phi = z, w, float(whole)
        self.status = Status.CONVERGED if self.away <= enough else Status.MAX_STEPS
        if not self.active.any():
            self.phi, self.status = np.inf, Status.NONFINITE

    def finish(self) -> None:
        """The covariances at the mode."""
        factors = self.all(self.z, self.w)[0] if self.problem.dof is None else self._expected_factors()
        step = _step(np.where(self.active[:, None, None], factors, 0.0), self.z, self.w, np.zeros(len(self.y) + 1))
        own, common = self.split.own, self.split.shared
        of_own = self.mixing[np.ix_(own, self.split.own_columns)]
        of_common = self.mixing[np.ix_(common, self.split.shared_columns)]
        root = np.linalg.inv(step.shared)
        inverse = np.linalg.inv(step.upper)
        # The uncertainty of what is shared comes on top of that of each unit with it known.
        parts = np.concatenate([of_own @ inverse, of_own @ inverse @ step.across @ root], axis=-1)
        self.shared_u, self.shared_sd = of_common @ self.w, np.linalg.norm(of_common @ root, axis=1)
        self.u_sd[:, own], self.u_sd[:, common] = np.linalg.norm(parts, axis=-1), self.shared_sd
        if self.status != Status.CONVERGED:
            self.shared_u, self.shared_sd = (np.full(common.size, np.nan) for _ in range(2))

    def _expected_factors(self) -> np.ndarray:
        """Factors with the expected information of Student noise."""
        factors = []
        for part in self.rows:
            slopes = self.evaluate(part, self.z, self.w)[3] @ self.mixing[:, self.order]
            rows = np.sqrt(self.problem.discount) * np.pad(slopes, ((0, 0), (0, slopes.shape[-1] + 1), (0, 1)))
            factors.append(triangular(rows))
        return np.concatenate(factors)

    def units(self, part: slice) -> Units:
        """Some of the units at the mode."""
        _, _, residual, slopes, _ = self.evaluate(part, self.z, self.w)
        good = self.active[part] & (self.status == Status.CONVERGED)
        numbers = np.zeros((len(good), self.mixing.shape[1]))
        numbers[:, self.split.own_columns], numbers[:, self.split.shared_columns] = self.z[part], self.w
        status = np.where(self.active[part], int(self.status), int(Status.NONFINITE)).astype(np.int32)
        residual, slopes = np.where(good[:, None], residual, 0.0), np.where(good[:, None, None], slopes, 0.0)
        u = numbers @ self.mixing.T
        return Units(
            u,
            self.u_sd[part],
            residual,
            linear_rows(self.problem, slopes, u, residual),
            np.zeros(len(good), bool),
            status,
            np.full(len(good), self.steps, np.int32),
            np.full(len(good), self.away),
        )


def joint_mode(
    problem: Problem, split: Split, y: np.ndarray, points: np.ndarray, max_steps: int, rows: list[slice]
) -> Joint:
    """Return the lowest joint mode from starts (k, n).

    Args:
        problem: of one unit.
        split: into separate and shared elements.
        y: data of all units (units, m).
        points: starts.
        max_steps: most steps from each.
        rows: the chunks.
    """

    def solved(point: np.ndarray) -> Joint:
        joint = Joint(problem, split, y, rows)
        joint.solve(point, max_steps)
        return joint

    best = min(map(solved, points), key=lambda joint: (joint.status != Status.CONVERGED, joint.phi))
    best.finish()
    return best
