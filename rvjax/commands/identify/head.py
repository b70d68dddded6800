"""The direction and the gains of one encoder head, from the six numbers of the nuisance "reading".

The six numbers are linear in the observation, so that their posterior has one maximum and misfits of a direction are
never attributed to errors of parts. Whether one head explains them is a test of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from rvjax import identify
from rvjax.loaded import HEAD_PARTS


@dataclass(frozen=True)
class Head:
    """One head that the six numbers of a reading describe; intervals of 95 %.

    Attributes:
        angle: direction from pin 0, [value, lower, upper] rad. The scale is taken to lie on the side of the last disc;
            on the other side it is half a turn more. NaN where several directions explain the numbers alike.
        amplitudes: {"ring", "tilt" or "dent": [value, lower, upper] rad}, of the largest order at the rated torque; > 0
            for the ring and the tilt. Parts that the data do not see are missing.
        p: probability of six numbers at least as far from those of one head; NaN for one part alone.
    """

    angle: tuple[float, float, float]
    amplitudes: dict[str, tuple[float, float, float]]
    p: float


CONSISTENT = 1e-3
"""Least p of numbers that one head explains."""
SEEN = 0.1  # standard deviation of a number that the data see, of its prior
BAND = float(stats.norm.ppf(0.975))
GRID = 360  # directions over half a turn


def one_head(values: Sequence[float] | np.ndarray, covariance: np.ndarray, prior: float) -> Head | None:
    """The head whose gains and one direction come closest to the six numbers of "reading"; None if none is seen.

    Weighted least squares over direction and gains; a direction and the one half a turn further fit alike, with
    opposite tilt and dent. The interval of the direction is that of the profile of chi-square.

    Args:
        values: [cosine, sine] of ring, tilt and dent, rad (6,).
        covariance: of them, rad^2 (6, 6).
        prior: their standard deviation before the measurement, rad.
    """
    numbers, cov = np.asarray(values, float), np.asarray(covariance, float)
    sd = np.sqrt(np.diag(cov)).reshape(3, 2).max(axis=1)
    parts = [k for k in range(3) if sd[k] < SEEN * prior]
    if not parts:
        return None
    names = [list(HEAD_PARTS)[k] for k in parts]
    periods = np.array([HEAD_PARTS[name] for name in names])
    own = np.concatenate([[2 * k, 2 * k + 1] for k in parts])
    white = np.linalg.inv(np.linalg.cholesky(cov[np.ix_(own, own)]))
    measured = white @ numbers[own]

    def columns(angle: np.ndarray, shift: float = 0.0) -> np.ndarray:
        """Whitened numbers of a head per gain, (n, 2 k, k); `shift` of a quarter turn: their derivatives over m."""
        phase = periods * angle[:, None] + shift
        made = np.zeros((len(angle), len(own), len(parts)))
        row = np.arange(len(own))
        made[:, row, row // 2] = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(angle), -1)
        return np.asarray(white @ made)

    def gains(angle: np.ndarray) -> np.ndarray:
        """Best gains of directions, (n, k); that of the ring, a compliance, is not negative."""
        made = columns(angle)
        best = np.linalg.pinv(made) @ measured
        if names[0] == "ring" and np.any(under := best[:, 0] < 0):
            made[under, :, 0] = 0.0
            best[under] = np.linalg.pinv(made[under]) @ measured
        return np.asarray(best)

    def chi2(angle: float | np.ndarray) -> np.ndarray:
        angle = np.atleast_1d(angle)
        return np.asarray(np.sum((measured - (columns(angle) @ gains(angle)[..., None])[..., 0]) ** 2, axis=1))

    step = np.pi / GRID
    start = step * int(np.argmin(chi2(step * np.arange(GRID))))
    near = optimize.minimize_scalar(lambda x: chi2(x)[0], bounds=(start - step, start + step), method="bounded")
    angle = float(near.x)
    least, found = float(chi2(angle)[0]), gains(np.array([angle]))[0]
    signed = dict(zip(names, found))
    if signed.get("tilt", 0.0) < 0:
        angle, found = angle + np.pi, found * np.where(periods % 2, -1.0, 1.0)
    angle %= 2 * np.pi

    def beyond(change: np.ndarray) -> np.ndarray:
        return chi2(angle + change) - least - BAND**2

    ends = [_first(beyond, side * step) for side in (-1.0, 1.0)]
    others = np.arange(ends[1] + step, np.pi + ends[0], step) if np.all(np.isfinite(ends)) else np.zeros(1)
    alone = bool(np.all(beyond(others) > 0))
    at = np.array([angle])
    slopes = np.column_stack([columns(at, np.pi / 2)[0] @ (periods * found), columns(at)[0]])
    half = BAND * np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)))[1:]
    freedom = len(parts) - 1
    return Head(
        (angle, angle + ends[0], angle + ends[1]) if alone else (np.nan, np.nan, np.nan),
        {name: (float(g), float(g - h), float(g + h)) for name, g, h in zip(names, found, half)},
        float(stats.chi2.sf(least, freedom)) if freedom else np.nan,
    )


def _first(function: Callable[[np.ndarray], np.ndarray], step: float) -> float:
    """First zero of a function that is negative at 0, within half a turn in steps; NaN if there is none."""
    above = np.flatnonzero(function(step * np.arange(1, GRID)) > 0)
    if not len(above):
        return np.nan
    ends = (step * above[0], step * (above[0] + 1))
    return float(optimize.brentq(lambda x: function(np.atleast_1d(x))[0], *ends))


def head_of(found: identify.Posterior) -> Head | None:
    """The head of an identification; None without the nuisance "reading", or where the data do not see it.

    Args:
        found: of one unit.
    """
    own = [k for k, name in enumerate(found.names) if name.startswith("reading[")]
    if len(own) != 2 * len(HEAD_PARTS) or not np.all(np.isfinite(found.u)):
        return None
    lower, upper = (np.asarray(x["reading"], float) for x in (found.lower, found.upper))
    u_sd = np.asarray(found.u_sd)[own]
    size = (upper - lower) / (2 * BAND * u_sd)  # of a standard deviation of the prior: the prior is normal
    covariance = np.asarray(found.u_covariance)[np.ix_(own, own)] * np.outer(size, size)
    return one_head(np.asarray(found.value["reading"], float), covariance, float(size.max()))
