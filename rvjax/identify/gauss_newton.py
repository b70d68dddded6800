"""The mode of a posterior: damped Gauss-Newton steps on standard normal numbers z.

Phi(z) = |z|^2/2 + sum r_i^2/2 with whitened residuals r(z); for Student noise the second term is
(dof + 1)/2 sum ln(1 + r_i^2/dof), whose weights are (dof + 1)/(dof + r_i^2). A step solves
(I + J'WJ + mu I) step = -(z + J'W r) through the QR factors of [sqrt(W) J; sqrt(1 + mu) I]: squaring J would lose
the prior next to a wide nuisance. Its length is measured in posterior standard deviations, sqrt(-g'step).

Where the model bends, steps fall short or go too far by the same share each time. Two steps along one line give that
share (Aitken), and the third one ends there; a plain step follows, for what the stretch spoils elsewhere. The damping
falls by nine after a step that gained what was predicted, and stays where one gained half of it (Nielsen 1999).

Where hundreds of contacts open and close, Phi has bends every few hundredths of a standard deviation: steps that cross
one gain nothing, and no point has the gradient zero. So the undamped distance says how far the mode is, and a few steps
in vain near it end the search; `rvjax.identify.search` then looks to all sides of that point.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.identify.elements import compress_rows
from rvjax.records import Array
from rvjax.status import SolveInfo, Status

TOLERANCE = 1e-9
"""Posterior standard deviations that the last step may be away."""

LONGEST = 2.0
"""Largest change of one number in a step: beyond, the linear model of a distribution is inaccurate."""

IN_LINE = 0.8
"""Least squared cosine of two steps along one line."""

NEAR = 0.15
"""Posterior standard deviations from a mode that are few: a 95 % interval so far off holds the truth in 94.7 %."""

VAIN = 3
"""Steps in vain so near a mode that end the search."""

ROUNDINGS = 8.0
"""Units in the last place of the whitened observation that a residual may be off."""

Linearised = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Linearise = Callable[[np.ndarray, np.ndarray], Linearised]
"""Numbers of starts (k,) and their u (k, p) -> residuals r (k, m), slopes dr/du (k, m, p), the observation (k, m) and
the size of the numbers behind r (k,)."""


class Mode(NamedTuple):
    """Results of the steps, of k starts."""

    z: np.ndarray  # (k, n)
    residual: np.ndarray  # (k, m)
    slopes: np.ndarray  # over u (k, m, p)
    observation: np.ndarray  # (k, m)
    phi: np.ndarray
    info: SolveInfo


class _State(NamedTuple):
    """Of k starts, each item (k, ..)."""

    z: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    observation: np.ndarray
    phi: np.ndarray
    slack: np.ndarray  # what rounding may add to phi
    step: np.ndarray
    away: np.ndarray  # length of the undamped step in posterior standard deviations
    enough: np.ndarray  # the same, at which it ends
    plain: np.ndarray  # the same step before it was stretched or limited
    as_it_is: np.ndarray  # whether it was neither
    promise: np.ndarray  # predicted reduction of phi by the step
    damping: np.ndarray
    growth: np.ndarray
    vain: np.ndarray  # steps without a gain
    steps: np.ndarray


def half_square(residual: Array | np.ndarray, dof: Any) -> Any:
    """Contribution of the data (..., m) to Phi: minus the logarithm of their density, up to a constant."""
    library: Any = jnp if isinstance(residual, jax.Array) else np
    if dof is None:
        return library.sum(residual**2, axis=-1) / 2
    return (dof + 1) / 2 * library.sum(library.log1p(residual**2 / dof), axis=-1)


def weights_of(residual: np.ndarray, dof: float | None) -> np.ndarray:
    """W of each residual, 1 for normal noise."""
    return np.ones_like(residual) if dof is None else (dof + 1) / (dof + residual**2)


def share_of(steps: np.ndarray) -> np.ndarray:
    """Share (...,) of steps (..., n) that changes no number by more than `LONGEST`."""
    return np.minimum(1.0, LONGEST / np.maximum(np.abs(steps).max(axis=-1, initial=0.0), LONGEST / 2))


def damped_step(
    z: np.ndarray, residual: np.ndarray, slopes: np.ndarray, damping: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps (k, n) of weighted residuals and slopes, and their lengths in posterior standard deviations.

    With fewer data than numbers, slopes span m directions only: there it is a problem of m numbers, and across them the
    step goes straight to the mid-point of the prior.
    """
    root = np.sqrt(1 + damping)[:, None]
    across, base = np.zeros_like(z), None
    if slopes.shape[-2] < slopes.shape[-1]:
        base, triangle = np.linalg.qr(np.swapaxes(slopes, -1, -2))
        slopes, along = np.swapaxes(triangle, -1, -2), (z[:, None] @ base)[:, 0]
        across, z = (base @ along[..., None])[..., 0] - z, along
    n = z.shape[-1]
    above = np.concatenate([slopes, -residual[..., None]], axis=-1)
    below = np.concatenate([root[..., None] * np.eye(n), -(z / root)[..., None]], axis=-1)
    factor = np.asarray(np.linalg.qr(np.concatenate([above, below], axis=-2), mode="r"))
    step = np.linalg.solve(factor[:, :n, :n], factor[:, :n, n:])[..., 0]
    square = (factor[:, :n, n] ** 2).sum(axis=-1) + ((across / root) ** 2).sum(axis=-1)
    return (step if base is None else (base @ step[..., None])[..., 0] + across / root**2), np.sqrt(square)


def _stretch(step: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Factor on steps (k, n) that continue the steps before them; 1 where they are not in line."""
    square, along = (before**2).sum(axis=-1), (step * before).sum(axis=-1)
    share = along / np.maximum(square, np.finfo(step.dtype).tiny)
    in_line = along**2 > IN_LINE * square * (step**2).sum(axis=-1)
    return np.where(in_line & (np.abs(share) > 1 / 3) & (share < 1), 1 / (1 - np.minimum(share, 0.99)), 1.0)


def mixed(mixing: jax.Array, z: jax.Array) -> jax.Array:
    """u = M z."""
    return jnp.matmul(mixing, z, precision="highest")


def modes(
    linearise: Linearise, size: int, mixing: np.ndarray, starts: np.ndarray, dof: float | None, max_steps: int
) -> Mode:
    """Return the modes reached from starts, each of which stops separately.

    `info.residual` is the undamped distance from the mode in posterior standard deviations. MAX_STEPS with a residual
    below NEAR: the steps ended at a kink, which may be a mode.

    Args:
        linearise: residuals and slopes.
        size: count of the residuals m.
        mixing: M (p, n), u = M z.
        starts: z (k, n).
        dof: of Student noise; None is normal noise.
        max_steps: most evaluations of `linearise` behind the first one.
    """
    state = _at_the_starts(starts, size, len(mixing))
    while (going := _going(state, max_steps)).any():
        (live,) = np.nonzero(going)
        part = _State(*(item[live] for item in state))
        trial = part.z + part.step
        advanced = _advanced(part, trial, linearise(live, trial @ mixing.T), mixing, dof)
        for whole, new in zip(state, advanced, strict=True):
            whole[live] = new
    converged, finite = state.away <= state.enough, np.isfinite(state.phi)
    status = np.where(converged, Status.CONVERGED, Status.MAX_STEPS)
    status = np.where(finite, status, Status.NONFINITE).astype(np.int32)
    return Mode(*state[:5], info_of(status, np.maximum(state.steps - 1, 0), state.away))


def info_of(status: np.ndarray, steps: np.ndarray, away: np.ndarray) -> SolveInfo:
    """One info of many starts; a constructor takes one case."""
    one = SolveInfo(jnp.int32(0))
    return jax.tree.unflatten(jax.tree.structure(one), [status, steps, away])


def _at_the_starts(starts: np.ndarray, size: int, p: int) -> _State:
    count = len(starts)
    return _State(
        z=starts.copy(),
        residual=np.zeros((count, size)),
        slopes=np.zeros((count, size, p)),
        observation=np.zeros((count, size)),
        phi=np.full(count, np.inf),
        slack=np.zeros(count),
        step=np.zeros_like(starts),
        away=np.full(count, np.inf),
        enough=np.full(count, TOLERANCE),
        plain=np.zeros_like(starts),
        as_it_is=np.zeros(count, bool),
        promise=np.zeros(count),
        damping=np.zeros(count),
        growth=np.full(count, 2.0),
        vain=np.zeros(count, np.int32),
        steps=np.zeros(count, np.int32),
    )


def _going(state: _State, max_steps: int) -> np.ndarray:
    ended = (state.vain >= VAIN) & (state.away < NEAR)
    lost = (state.steps > 0) & np.isinf(state.phi)
    return (state.away > state.enough) & (state.steps <= max_steps) & ~lost & ~ended


@np.errstate(invalid="ignore", over="ignore")  # a trial that is not finite
def _advanced(state: _State, trial: np.ndarray, linear: Linearised, mixing: np.ndarray, dof: float | None) -> _State:
    """The state after a trial step, with the next one."""
    residual, slopes, observation, size = linear
    least = ROUNDINGS * np.finfo(trial.dtype).eps
    phi = (trial**2).sum(axis=-1) / 2 + half_square(residual, dof)
    sound = np.isfinite(phi) & np.isfinite(slopes).all(axis=(-2, -1))
    better = sound & (phi <= state.phi + state.slack)
    rounding = least * (size + np.linalg.norm(trial, axis=-1))
    slack = rounding * np.linalg.norm(residual, axis=-1) + rounding**2 + least * phi
    tried = (trial, residual, slopes, observation, phi, slack)
    z, residual, slopes, observation, phi, slack = (
        np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
        for new, old in zip(tried, state[: len(tried)], strict=True)
    )
    growth = np.where(better, 2.0, 2 * state.growth)
    # Below rounding a gain has no meaning.
    meant = state.promise > 10 * slack
    gain = np.where(meant, (state.phi - phi) / np.where(meant, state.promise, 1.0), 1.0)
    eased = state.damping * np.maximum(1 / 9, 1 - (2 * np.clip(gain, 0, 1) - 1) ** 3)
    damping = np.where(better, eased, np.maximum(state.damping, 1e-3) * state.growth)
    root = np.sqrt(weights_of(residual, dof))
    rows = np.concatenate([root[..., None] * (slopes @ mixing), (root * residual)[..., None]], axis=-1)
    rows = compress_rows(rows)
    weighted = rows[..., -1], rows[..., :-1]
    step, length = damped_step(z, *weighted, damping)
    _, away = damped_step(z, *weighted, np.zeros_like(damping))
    stretch = np.where(better & state.as_it_is, _stretch(step, state.plain), 1.0)
    longer = stretch[:, None] * step
    limit = share_of(longer)
    part = limit * stretch
    promise = part * length**2 - part**2 * (length**2 - damping * (step**2).sum(axis=-1)) / 2
    missed = ~better | (gain < 0.25)
    vain = np.where(state.phi - phi > NEAR**2 / 4, 0, state.vain + missed)
    return _State(
        *(z, residual, slopes, observation, phi, slack),
        step=limit[:, None] * longer,
        away=away,
        enough=np.where(better, TOLERANCE + rounding, state.enough),
        plain=step,
        as_it_is=(stretch == 1) & (limit == 1),
        promise=promise,
        damping=damping,
        growth=growth,
        vain=vain,
        steps=state.steps + 1,
    )
