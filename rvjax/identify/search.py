"""Modes of one unit's posterior: from the mid-point of the prior and from units sampled from it."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.identify.gauss_newton import NEAR
from rvjax.identify.information import Spectrum
from rvjax.identify.problem import Problem, densities, modes
from rvjax.status import SolveInfo, Status

APART = 1.0
"""Mahalanobis distance from which on two modes are two."""

SAME = 1e-2
"""The same between two points of one saddle: its modes may be close by."""

FAINT = 0.01
"""Least weight of a mode that counts."""

STEP_ASIDE = 0.1
"""Posterior standard deviations to each side at which a mode must be lower, or it is a saddle."""

ROUNDS = 8
"""Most times that starts are followed, those next to saddles included."""


class Peak(NamedTuple):
    """A maximum on the host: z, its residuals, slopes and spectrum."""

    z: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray  # over u (m, p)
    observation: np.ndarray
    phi: float
    spectrum: Spectrum
    evidence: float


def evidence_of(
    problem: Problem, z: np.ndarray, residual: np.ndarray, nats: np.ndarray, seen: np.ndarray
) -> np.ndarray:
    """Logarithm of the density of data (..., m) by Laplace's method, at modes z (..., n)."""
    dof = problem.dof
    if np.isinf(dof):
        each = -(residual**2) / 2 - np.log(2 * np.pi) / 2
    else:
        constant = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - np.log(dof * np.pi) / 2
        each = constant - (dof + 1) / 2 * np.log1p(residual**2 / dof)
    data = np.where(seen, each - np.log(problem.sd), 0.0).sum(axis=-1)
    return np.asarray(data - (z**2).sum(axis=-1) / 2 - nats)


def search(
    problem: Problem, y: np.ndarray, rng: np.random.Generator, starts: int, max_steps: int, draws: int
) -> tuple[tuple[Peak, ...], SolveInfo]:
    """Return the distinct modes, heaviest first, and how the solver ended at the first; none where it found none."""
    points = rng.standard_normal((starts, problem.elements.mixing.shape[1]))
    points[0] = 0.0
    rows = jnp.asarray(np.tile(y, (starts, 1)))
    pending = list(points)
    ended: list[Any] = []
    peaks: list[Peak] = []
    saddles: list[Peak] = []
    while pending and len(ended) < ROUNDS:
        block, pending = pending[:starts], pending[starts:]
        at = jnp.asarray(np.stack(block + block[-1:] * (starts - len(block))))
        found = modes(problem.model, problem.device, rows, at, jnp.int32(max_steps))
        found = jax.tree.map(np.array, found)
        ended.append(found)
        for lane in np.argsort(found.phi):
            if not ended_near(found.info)[lane]:
                continue
            peak = _peak(problem, y, *(item[lane] for item in found[:5]))
            if any(_near(peak, other, APART) for other in peaks) or any(_near(peak, s, SAME) for s in saddles):
                continue
            bent = found.info.status[lane] != Status.CONVERGED
            beside = lower_points(problem, y, peak.z, peak.phi, peak.spectrum.root, draws, bent)
            (saddles if beside else peaks).append(peak)
            pending += beside
            if not beside:  # at a kink too
                found.info.status[lane] = Status.CONVERGED
    return tuple(sorted(peaks, key=lambda peak: -peak.evidence)), _final_info(ended, bool(peaks))


def ended_near(info: SolveInfo) -> np.ndarray:
    """Find starts whose steps reached a mode, or a kink close to one."""
    status, away = np.asarray(info.status), np.asarray(info.residual)
    return (status == Status.CONVERGED) | ((status == Status.MAX_STEPS) & (away <= NEAR))


def _final_info(ended: list[Any], found: bool) -> SolveInfo:
    """Return the status of the solver at the lowest usable point."""
    phi = np.concatenate([item.phi for item in ended])
    status = np.concatenate([item.info.status for item in ended])
    usable = status == Status.CONVERGED if found else np.isfinite(phi)
    lane = int(np.argmin(np.where(usable, phi, np.inf)))
    steps, residual = (np.concatenate([getattr(item.info, name) for item in ended]) for name in ("steps", "residual"))
    # Saddles alone are no mode: the steps ended, but not at one.
    named = status[lane] if found or status[lane] != Status.CONVERGED else np.int32(Status.MAX_STEPS)
    return SolveInfo(jnp.int32(named), steps[lane], residual[lane])


def _peak(
    problem: Problem,
    y: np.ndarray,
    z: np.ndarray,
    residual: np.ndarray,
    slopes: np.ndarray,
    observation: np.ndarray,
    phi: np.ndarray,
) -> Peak:
    spectrum = Spectrum.of(np.sqrt(problem.discount) * slopes @ problem.elements.mixing)
    evidence = evidence_of(problem, z, residual, spectrum.nats, ~np.isnan(y))
    return Peak(z, residual, slopes, observation, float(phi), spectrum, float(evidence))


def _near(one: Peak, other: Peak, distance: float) -> bool:
    """Closer than this in standard deviations of the wider of the two."""
    apart = one.z - other.z
    squares = (np.sum((peak.spectrum.right.T @ apart) ** 2 * (1 + peak.spectrum.eigenvalues)) for peak in (one, other))
    return bool(min(squares) < distance**2)


def lower_points(
    problem: Problem, y: np.ndarray, z: np.ndarray, phi: float, root: np.ndarray, draws: int, bent: bool
) -> list[np.ndarray]:
    """Return two points next to a saddle or a kink, where Phi is lower to the side; none for a minimum.

    Args:
        problem: what is solved.
        y: data of one unit (m,).
        z: the point (n,).
        phi: its Phi.
        root: of its posterior covariance (n, n), the least known combination last.
        draws: points of a call.
        bent: the steps ended among bends of Phi, as far from a mode as `NEAR`.
    """
    step = STEP_ASIDE * root[:, ::-1][:, : draws // 2]
    points = np.concatenate([z + step.T, z - step.T])
    found = phi_at(problem, y, np.concatenate([points, np.tile(z, (draws - len(points), 1))]))[: len(points)]
    # At a minimum Phi rises by step^2/2; rounding of Phi is far below that.
    least = NEAR**2 / 2 if bent else 1e-3 * STEP_ASIDE**2 / 2
    lower = found < phi - least - 1e-12 * abs(phi)
    if not lower.any():
        return []
    half = len(step.T)
    k = int(np.argmin(found)) % half
    return [points[k], points[k + half]]


def phi_at(problem: Problem, y: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Phi (k,) of points z (k, n), inf where the model is not finite."""
    return np.asarray(densities(problem.model, problem.device, jnp.asarray(y), jnp.asarray(points)), float)
