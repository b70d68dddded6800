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
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.records import Array
from rvjax.status import SolveInfo, Status, first_failure

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

Linearise = Callable[[jax.Array], tuple[jax.Array, jax.Array, tuple[jax.Array, jax.Array]]]
"""u (p,) -> residuals r (m,), slopes dr/du (m, p), the observation (m,) and the size of the numbers behind r."""


class Mode(NamedTuple):
    """Result of the steps."""

    z: Array  # (n,)
    residual: Array  # (m,)
    slopes: Array  # over u (m, p)
    observation: Array  # (m,)
    phi: Array
    info: SolveInfo


class _State(NamedTuple):
    z: jax.Array
    residual: jax.Array
    slopes: jax.Array
    observation: jax.Array
    phi: jax.Array
    slack: jax.Array  # what rounding may add to phi
    step: jax.Array
    away: jax.Array  # length of the undamped step in posterior standard deviations
    enough: jax.Array  # the same, at which it ends
    plain: jax.Array  # the same step before it was stretched or limited
    as_it_is: jax.Array  # whether it was neither
    promise: jax.Array  # predicted reduction of phi by the step
    damping: jax.Array
    growth: jax.Array
    vain: jax.Array  # steps without a gain
    steps: jax.Array


def half_square(residual: jax.Array, dof: jax.Array | None) -> jax.Array:
    """Contribution of the data to Phi: minus the logarithm of their density, up to a constant."""
    if dof is None:
        return jnp.sum(residual**2) / 2
    return (dof + 1) / 2 * jnp.sum(jnp.log1p(residual**2 / dof))


def roots_of_weights(residual: jax.Array, dof: jax.Array | None) -> jax.Array:
    """sqrt(W) of each residual."""
    if dof is None:
        return jnp.ones_like(residual)
    return jnp.sqrt((dof + 1) / (dof + residual**2))


def damped_step(
    z: jax.Array, residual: jax.Array, slopes: jax.Array, damping: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the step (n,) of weighted residuals and slopes, and its length in posterior standard deviations."""
    n, root = z.shape[0], jnp.sqrt(1 + damping)
    above = jnp.concatenate([slopes, -residual[:, None]], axis=1)
    below = jnp.concatenate([root * jnp.eye(n, dtype=z.dtype), -(z / root)[:, None]], axis=1)
    factor = jnp.linalg.qr(jnp.concatenate([above, below]), mode="r")
    step = jax.scipy.linalg.solve_triangular(factor[:n, :n], factor[:n, n])
    return step, jnp.linalg.norm(factor[:n, n])


def _stretch(step: jax.Array, before: jax.Array) -> jax.Array:
    """Factor on a step (n,) that continues the step before it; 1 where they are not in line."""
    square, along = jnp.sum(before**2), jnp.sum(step * before)
    share = along / jnp.maximum(square, jnp.finfo(step.dtype).tiny)
    in_line = along**2 > IN_LINE * square * jnp.sum(step**2)
    return jnp.where(in_line & (jnp.abs(share) > 1 / 3) & (share < 1), 1 / (1 - jnp.minimum(share, 0.99)), 1.0)


def mixed(mixing: jax.Array, z: jax.Array) -> jax.Array:
    """u = M z."""
    return jnp.matmul(mixing, z, precision="highest")


def mode(
    linearise: Linearise, size: int, mixing: jax.Array, start: jax.Array, dof: jax.Array | None, max_steps: jax.Array
) -> Mode:
    """Return the mode reached from one start; under `vmap` every batch element stops separately.

    `info.residual` is the undamped distance from the mode in posterior standard deviations. MAX_STEPS with a residual
    below NEAR: the steps ended at a kink, which may be a mode.

    Args:
        linearise: residuals and slopes.
        size: count of the residuals m.
        mixing: M (p, n), u = M z.
        start: z (n,).
        dof: of Student noise; None is normal noise.
        max_steps: most evaluations of `linearise` behind the first one.
    """
    dtype = start.dtype
    least = ROUNDINGS * jnp.finfo(dtype).eps

    def number(value: float) -> jax.Array:
        return jnp.asarray(value, dtype)

    def going(state: _State) -> jax.Array:
        ended = (state.vain >= VAIN) & (state.away < NEAR)
        lost = (state.steps > 0) & jnp.isinf(state.phi)
        return (state.away > state.enough) & (state.steps <= max_steps) & ~lost & ~ended

    def advance(state: _State) -> _State:
        trial = state.z + state.step
        residual, slopes, (observation, size) = linearise(mixed(mixing, trial))
        phi = jnp.sum(trial**2) / 2 + half_square(residual, dof)
        sound = jnp.isfinite(phi) & jnp.all(jnp.isfinite(slopes))
        better = sound & (phi <= state.phi + state.slack)
        rounding = least * (size + jnp.linalg.norm(trial))
        slack = rounding * jnp.linalg.norm(residual) + rounding**2 + least * phi
        tried = (trial, residual, slopes, observation, phi, slack)
        z, residual, slopes, observation, phi, slack = (
            jnp.where(better, new, old) for new, old in zip(tried, state[: len(tried)], strict=True)
        )
        growth = jnp.where(better, number(2.0), 2 * state.growth)
        # Below rounding a gain has no meaning.
        gain = jnp.where(state.promise > 10 * slack, (state.phi - phi) / state.promise, 1.0)
        eased = state.damping * jnp.maximum(1 / 9, 1 - (2 * jnp.clip(gain, 0, 1) - 1) ** 3)
        damping = jnp.where(better, eased, jnp.maximum(state.damping, 1e-3) * state.growth)
        root = roots_of_weights(residual, dof)
        weighted = root * residual, root[:, None] * mixed(slopes, mixing)
        step, length = damped_step(z, *weighted, damping)
        _, away = damped_step(z, *weighted, number(0.0))
        stretch = jnp.where(better & state.as_it_is, _stretch(step, state.plain), 1.0)
        longer = stretch * step
        limit = jnp.minimum(1.0, LONGEST / jnp.maximum(jnp.max(jnp.abs(longer)), LONGEST / 2))
        as_it_is = (stretch == 1) & (limit == 1)
        part = limit * stretch
        promise = part * length**2 - part**2 * (length**2 - damping * jnp.sum(step**2)) / 2
        enough = jnp.where(better, TOLERANCE + rounding, state.enough)
        missed = ~better | (gain < 0.25)
        vain = jnp.where(state.phi - phi > NEAR**2 / 4, 0, state.vain + jnp.where(missed, 1, 0))
        at = (z, residual, slopes, observation, phi, slack)
        next_one = (limit * longer, away, enough, step, as_it_is, promise, damping, growth, vain)
        return _State(*at, *next_one, state.steps + 1)

    state = jax.lax.while_loop(
        going,
        advance,
        _State(
            start,
            jnp.zeros(size, dtype),
            jnp.zeros((size, mixing.shape[0]), dtype),
            jnp.zeros(size, dtype),
            number(jnp.inf),
            number(0.0),
            jnp.zeros_like(start),
            number(jnp.inf),
            number(TOLERANCE),
            jnp.zeros_like(start),
            jnp.asarray(False),
            number(0.0),
            number(0.0),
            number(2.0),
            jnp.int32(0),
            jnp.int32(0),
        ),
    )
    status = first_failure(
        (~jnp.isfinite(state.phi), Status.NONFINITE), (~(state.away <= state.enough), Status.MAX_STEPS)
    )
    return Mode(*state[:5], SolveInfo(status, jnp.maximum(state.steps - 1, 0), state.away))
