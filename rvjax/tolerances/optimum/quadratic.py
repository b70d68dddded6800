"""Convex quadratic programme with elastic constraints, by an interior point method.

minimise g'p + p'Hp/2 + sum_k r_k e_k   subject to   A p + c <= e (of the group of each row), low <= p <= high, and
e_k >= 0 but for the groups that are free, which are the largest of their rows.

Predictor and corrector of Mehrotra (SIAM J. Optim. 2, 1992). The dual values of the rows are the prices.
"""

import dataclasses

import numpy as np

_STEPS, _KNOWN, _TINY = 60, 1e-9, 1e-12
_SHORT = 0.995  # of the way to the boundary


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Result of a quadratic programme.

    Attributes:
        step: (n,) p.
        prices: (m,) of the rows, 0 to the elastic price of their group.
        at_low: (n,) of the lower bounds, not negative.
        at_high: (n,) of the upper bounds, not negative.
    """

    step: np.ndarray
    prices: np.ndarray
    at_low: np.ndarray
    at_high: np.ndarray


def minimum(
    gradient: np.ndarray,
    hessian: np.ndarray,
    rows: np.ndarray,
    excess: np.ndarray,
    groups: np.ndarray,
    elastic: np.ndarray,
    free: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> Minimum:
    """Minimum of the programme.

    Args:
        gradient: (n,) g.
        hessian: (n, n) H, positive definite.
        rows: (m, n) A.
        excess: (m,) c.
        groups: (m,) number of the group of each row.
        elastic: (k,) price r of each group.
        free: (k,) whether e may be negative.
        low: (n,) bounds of p.
        high: (n,) bounds of p.
    """
    n, m, k = len(gradient), len(excess), len(elastic)
    whole = np.zeros((n + k, n + k))
    whole[:n, :n] = hessian
    whole[range(n, n + k), range(n, n + k)] = _TINY * max(1.0, float(np.abs(hessian).max(initial=0.0)))
    slope = np.concatenate([gradient, elastic])
    held = np.flatnonzero(~free)
    part = np.zeros((m, k))
    part[range(m), groups] = -1.0
    left = np.concatenate([np.hstack([rows, part]), np.eye(n, n + k), -np.eye(n, n + k), -np.eye(n + k)[n + held]])
    right = np.concatenate([-excess, high, -low, np.zeros(len(held))])
    v = np.concatenate([(low + high) / 2, np.zeros(k)])
    beyond = rows @ v[:n] + excess
    for g in range(k):
        v[n + g] = max([*beyond[groups == g], 0.0 if not free[g] else -np.inf]) + 1.0
    slack = np.maximum(right - left @ v, 1e-6)
    dual = np.maximum(float(np.abs(slope).max(initial=0.0)), 1e-6) * np.minimum(1.0, 1 / slack)
    scale = 1 + float(np.abs(slope).max(initial=0.0))
    for _ in range(_STEPS):
        off_dual = whole @ v + slope + left.T @ dual
        off_rows = left @ v + slack - right
        gap = float(slack @ dual) / len(slack)
        if gap < _KNOWN * scale:
            break
        ratio = dual / slack
        factor = np.linalg.inv(whole + left.T @ (ratio[:, None] * left))
        centred = slack * dual
        for last in (False, True):  # the affine step, then the step with its correction
            dv = -factor @ (off_dual + left.T @ (ratio * off_rows - centred / slack))
            ds = -off_rows - left @ dv
            dz = -(centred + ratio * slack * ds) / slack
            if not last:
                affine = float((slack + _way(slack, ds) * ds) @ (dual + _way(dual, dz) * dz)) / len(slack)
                centred = slack * dual + ds * dz - (affine / gap) ** 3 * gap
        primal, back = _SHORT * _way(slack, ds), _SHORT * _way(dual, dz)
        v, slack, dual = v + primal * dv, slack + primal * ds, dual + back * dz
    return Minimum(np.clip(v[:n], low, high), dual[:m], dual[m + n : m + 2 * n], dual[m : m + n])


def _way(values: np.ndarray, steps: np.ndarray) -> float:
    """Largest part of a step, at most 1, that leaves no value negative."""
    falling = steps < 0
    return min(1.0, float((-values[falling] / steps[falling]).min(initial=np.inf)))
