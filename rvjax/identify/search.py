"""Modes of the posterior of one unit. Starts: the mid-point of the prior, and units sampled from it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.kernels import in_blocks
from rvjax._jax.sizes import LINEARISED
from rvjax.identify.elements import Spectrum
from rvjax.identify.gauss_newton import NEAR, Linearised, Mode, half_square, modes
from rvjax.identify.identification import Problem, densities, parts_of
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

CHECKED, DOUBT = 8, 3.0
"""Points at which a part of a model is checked against all of it; errors there within which a point is in doubt."""

LOWEST = 3
"""Ends of a search with a part of the model that all of it goes on from, and others apart from these."""


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
    if dof is None:
        each = -(residual**2) / 2 - np.log(2 * np.pi) / 2
    else:
        constant = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - np.log(dof * np.pi) / 2
        each = constant - (dof + 1) / 2 * np.log1p(residual**2 / dof)
    data = np.where(seen, each - np.log(problem.sd), 0.0).sum(axis=-1)
    return np.asarray(data - (z**2).sum(axis=-1) / 2 - nats)


def search(
    problem: Problem, y: np.ndarray, rng: np.random.Generator, starts: int, max_steps: int, draws: int
) -> tuple[tuple[Peak, ...], SolveInfo]:
    """Return the distinct modes, largest weight first, and how the solver ended at the first; may be empty.

    Where a model has parts, starts are followed with the first part alone, and then from the modes of that with all.
    """
    points = rng.standard_normal((starts, problem.elements.mixing.shape[1]))
    points[0] = 0.0
    peaks, info = _searched(problem, y, _begun(problem, y, points, max_steps), max_steps, draws)
    if not peaks and len(parts_of(problem.model)[1]) > 1:
        peaks, info = _searched(problem, y, points, max_steps, draws)
    return peaks, info


def follow(
    problem: Problem,
    y: np.ndarray,
    starts: np.ndarray,
    max_steps: int,
    *,
    part: bool = False,
    together: int = LINEARISED,
) -> Mode:
    """Follow starts (k, n) of units with the data y (k, m).

    Args:
        problem: what is solved.
        y: data.
        starts: standard numbers z.
        max_steps: most steps of each.
        part: with the first part of the model alone.
        together: units that are evaluated at once.
    """

    def linearise(live: np.ndarray, u: np.ndarray) -> Linearised:
        return problem.linearise(y[live], u, part=part, together=together)

    return modes(linearise, problem.layout.size, problem.elements.mixing, starts, problem.dof, max_steps)


def _begun(problem: Problem, y: np.ndarray, points: np.ndarray, max_steps: int) -> np.ndarray:
    """The points, or of the ends to which a part of the model leads from them the lowest and those that are apart."""
    if len(parts_of(problem.model)[1]) == 1:
        return points
    ends = follow(problem, np.tile(y, (len(points), 1)), points, max_steps, part=True)
    ended: list[Peak] = []
    for lane in np.argsort(ends.phi):
        if ended_near(ends.info)[lane]:
            peak = peak_of(problem, y, ends, (lane,))
            if len(ended) < LOWEST or not any(_near(peak, other, APART) for other in ended):
                ended.append(peak)
    return np.stack([peak.z for peak in ended]) if ended else points


def _searched(
    problem: Problem, y: np.ndarray, points: np.ndarray, max_steps: int, draws: int
) -> tuple[tuple[Peak, ...], SolveInfo]:
    pending = list(points)
    ended: list[Mode] = []
    peaks: list[Peak] = []
    saddles: list[Peak] = []
    while pending and len(ended) < ROUNDS:
        block, pending = pending[: len(points)], pending[len(points) :]
        ends = follow(problem, np.tile(y, (len(block), 1)), np.stack(block), max_steps)
        ended.append(ends)
        for lane in np.argsort(ends.phi):
            if not ended_near(ends.info)[lane]:
                continue
            peak = peak_of(problem, y, ends, (lane,))
            if any(_near(peak, other, APART) for other in peaks) or any(_near(peak, s, SAME) for s in saddles):
                continue
            bent = bool(ends.info.status[lane] != Status.CONVERGED)
            beside = lower_points(problem, y, peak, draws, bent)
            (saddles if beside else peaks).append(peak)
            pending += beside
            if not beside:  # at a kink too
                ends.info.status[lane] = Status.CONVERGED
    return tuple(sorted(peaks, key=lambda peak: -peak.evidence)), _final_info(ended, bool(peaks))


def ended_near(info: SolveInfo) -> np.ndarray:
    """Find starts whose steps reached a mode, or a kink close to one."""
    status, away = np.asarray(info.status), np.asarray(info.residual)
    return (status == Status.CONVERGED) | ((status == Status.MAX_STEPS) & (away <= NEAR))


def _final_info(ended: list[Mode], solved: bool) -> SolveInfo:
    """Return the status of the solver at the lowest usable point."""
    every: Mode = jax.tree.map(lambda *items: np.concatenate(items), *ended)
    phi, status = every.phi, every.info.status
    usable = status == Status.CONVERGED if solved else np.isfinite(phi)
    lane = int(np.argmin(np.where(usable, phi, np.inf)))
    # Saddles alone are no mode: the steps ended, but not at one.
    named = status[lane] if solved or status[lane] != Status.CONVERGED else np.int32(Status.MAX_STEPS)
    return SolveInfo(jnp.int32(named), every.info.steps[lane], every.info.residual[lane])


def peak_of(problem: Problem, y: np.ndarray, ends: Mode, lane: tuple[int, ...]) -> Peak:
    """Return the maximum of one unit y (m,) at which the steps from a start, a place in `ends`, ended."""
    z, residual, slopes, observation, phi = (item[lane] for item in ends[:5])
    spectrum = Spectrum.of(np.sqrt(problem.discount) * slopes @ problem.elements.mixing)
    evidence = evidence_of(problem, z, residual, spectrum.nats, ~np.isnan(y))
    return Peak(z, residual, slopes, observation, float(phi), spectrum, float(evidence))


def _near(one: Peak, other: Peak, distance: float) -> bool:
    """True if two modes are closer than this, in standard deviations of the wider one."""
    apart = one.z - other.z
    squares = (np.sum((peak.spectrum.right.T @ apart) ** 2 * (1 + peak.spectrum.eigenvalues)) for peak in (one, other))
    return bool(min(squares) < distance**2)


def lower_points(problem: Problem, y: np.ndarray, peak: Peak, draws: int, bent: bool) -> list[np.ndarray]:
    """Return two points next to a saddle or a kink, where Phi is lower to the side; none for a minimum.

    Args:
        problem: what is solved.
        y: data of one unit (m,).
        peak: the point.
        draws: points of a call.
        bent: the steps ended among bends of Phi, as far from a mode as `NEAR`.
    """
    step = STEP_ASIDE * peak.spectrum.root[:, ::-1][:, : draws // 2]
    points = np.concatenate([peak.z + step.T, peak.z - step.T])
    # At a minimum Phi rises by step^2/2; rounding of Phi is far below that.
    least = NEAR**2 / 2 if bent else 1e-3 * STEP_ASIDE**2 / 2
    limit = peak.phi - least - 1e-12 * abs(peak.phi)
    phi, error = phi_about(problem, y, points, peak, draws)
    if (open_ := phi < limit + DOUBT * error).any() and error:
        phi[open_] = phi_at(problem, y, points[open_], draws)
    if not (phi < limit).any():
        return []
    half = len(step.T)
    k = int(np.argmin(phi)) % half
    return [points[k], points[k + half]]


def phi_about(problem: Problem, y: np.ndarray, points: np.ndarray, peak: Peak, draws: int) -> tuple[np.ndarray, float]:
    """Phi (k,) of points z (k, n) near a mode, and its largest error at some of them.

    Of a model with parts only the first is evaluated; what the others add is taken as linear about the mode.
    """
    if len(parts_of(problem.model)[1]) == 1:
        return phi_at(problem, y, points, draws), 0.0
    mixing = problem.elements.mixing
    here, slopes = problem.evaluate((mixing @ peak.z)[None], part=True)
    rest = peak.observation - here[0]
    slope = problem.sd[:, None] * peak.slopes - np.where(np.isnan(y)[:, None], 0.0, slopes[0])
    apart = (points - peak.z) @ mixing.T @ slope.T
    phi = _phi(problem, y, points, problem.evaluate(points @ mixing.T, part=True)[0] + rest + apart)
    some = np.linspace(0, len(points) - 1, CHECKED).astype(int)
    with np.errstate(invalid="ignore"):
        error = float(np.abs(phi[some] - phi_at(problem, y, points[some], draws)).max())
    return phi, error if np.isfinite(error) else np.inf


def phi_at(problem: Problem, y: np.ndarray, points: np.ndarray, draws: int) -> np.ndarray:
    """Phi (k,) of points z (k, n), inf where the model is not finite.

    Args:
        problem: what is solved.
        y: data of one unit (m,).
        points: z.
        draws: points of a call.
    """
    if hasattr(problem.model, "split"):
        return _phi(problem, y, points, problem.evaluate(points @ problem.elements.mixing.T)[0])
    call = lambda part: densities(problem.model, problem.device, jnp.asarray(y), jnp.asarray(part))  # noqa: E731
    return np.asarray(in_blocks(call, draws, points), float)


def _phi(problem: Problem, y: np.ndarray, points: np.ndarray, observation: np.ndarray) -> np.ndarray:
    phi = (points**2).sum(axis=-1) / 2 + half_square(problem.whitened(observation, y)[0], problem.dof)
    return np.where(np.isfinite(phi), phi, np.inf)
