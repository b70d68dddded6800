"""One unit: `solve` finds the errors of its parts from its measurement, `predict` another response of it."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.checks import checked
from rvjax.identify.elements import findings, mapped_values
from rvjax.identify.gauss_newton import weights_of
from rvjax.identify.goodness_of_fit import ADEQUATE, LEAST_DRAWS, Fit, Laplace, goodness, largest, reliability
from rvjax.identify.identification import Model, Problem, counted, integer
from rvjax.identify.observation import Noise
from rvjax.identify.posterior import Mode, Outcome, Posterior, broken, limits_of, outcome, shares
from rvjax.identify.sampler import Draws
from rvjax.identify.search import FAINT, Peak, phi_about, phi_at, search
from rvjax.population import Correlation, Estimate, deviate_of, wilson
from rvjax.response import Response, by_response, respond, unwrapped
from rvjax.status import SolveInfo, Status, succeeded
from rvjax.tolerances import Limits

AGREED = 0.2
"""Largest error of the logarithm of a weight, over the spread of all, that leaves the tail of the weights as it is."""


@checked
def solve(
    model: Model,
    prior: object,
    data: object,
    *,
    noise: Noise,
    nuisance: str | Iterable[str] = (),
    correlation: Correlation = None,
    starts: int = 8,
    seed: int = 0,
    max_steps: int = 50,
    draws: int = 512,
    confidence: float = 0.95,
    limits: object = None,
) -> Posterior:
    """Identify the errors of one unit from its measurement.

    Args:
        model: pure function, values of the prior's structure -> observation.
        prior: record or dict (nested ones too) with a `Tolerance`, a constant or None in each field.
        data: measured observation, NaN where missing.
        noise: of the observation.
        nuisance: names of fields or elements that are not of interest; the model check does not count what they
            explain.
        correlation: {(field or element, field or element): correlation of their u}.
        starts: the mid-point of the prior, and units sampled from it.
        seed: of starts and draws.
        max_steps: most steps of the solver.
        draws: that check Laplace's method, at least 40.
        confidence: of the intervals.
        limits: structure of the prior with the drawing's `Tolerance` in each field; None: the prior's own.

    Raises:
        ValueError: an argument that does not fit.
    """
    problem = Problem.of(model, prior, noise=noise, nuisance=nuisance, correlation=correlation)
    deviate = deviate_of(confidence)
    counted("starts", starts, 1)
    counted("max_steps", max_steps, 1)
    counted("draws", draws, LEAST_DRAWS)
    y = problem.layout.data(data)
    rng = np.random.default_rng(integer("seed", seed) % 2**64)
    drawing = limits_of(problem.elements, limits)
    peaks, info = search(problem, y, rng, starts, max_steps, draws)
    if not peaks:
        return _lost(problem, y, info)
    return _found(problem, y, peaks, info, rng, draws=draws, deviate=deviate, drawing=drawing)


def _found(
    problem: Problem,
    y: np.ndarray,
    peaks: tuple[Peak, ...],
    info: SolveInfo,
    rng: np.random.Generator,
    *,
    draws: int,
    deviate: float,
    drawing: np.ndarray,
) -> Posterior:
    elements, layout, mixing, peak = problem.elements, problem.layout, problem.elements.mixing, peaks[0]
    about = findings(elements.names, mixing, peak.spectrum)
    u, root = mixing @ peak.z, mixing @ peak.spectrum.root
    weights = special.softmax([item.evidence for item in peaks])
    heavy = int((weights > FAINT).sum())
    picked = rng.standard_normal((draws, mixing.shape[1]))
    drawn = peak.z + picked @ peak.spectrum.root.T
    phi, error = phi_about(problem, y, drawn, peak, draws)
    log_weights = (picked**2).sum(axis=1) / 2 - phi
    if error > AGREED * log_weights.std():
        log_weights += phi - phi_at(problem, y, drawn, draws)
    laplace = reliability(log_weights, heavy)
    rows = [u, u - deviate * about.u_sd, u + deviate * about.u_sd, *(mixing @ item.z for item in peaks)]
    values = mapped_values(elements, np.stack(rows))
    fit = _goodness(problem, y, peak.residual, peak.slopes, u)
    adequate = bool(fit.p_model >= ADEQUATE)
    return Posterior(
        **{field.name: getattr(about, field.name) for field in dataclasses.fields(about)},
        u=u,
        u_covariance=root @ root.T,
        value=elements.structure(values[0]),
        lower=elements.structure(np.minimum(values[1], values[2])),
        upper=elements.structure(np.maximum(values[1], values[2])),
        fit=fit,
        adequate=adequate,
        shares=shares(problem, values[0]),
        broken=broken(elements, drawing, u, root, rng),
        modes=tuple(Mode(elements.structure(value), float(weight)) for value, weight in zip(values[3:], weights)),
        laplace=laplace,
        evidence=peak.evidence,
        prediction=layout.tree(peak.observation),
        residual=layout.tree(y - peak.observation),
        status=outcome(int(info.status), adequate, heavy, laplace.trusted),
        info=info,
        problem=problem,
        data=y,
        peaks=peaks,
    )


def _lost(problem: Problem, y: np.ndarray, info: SolveInfo) -> Posterior:
    """No mode: every number is NaN, and the status gives the reason."""
    elements, layout, p = problem.elements, problem.layout, problem.elements.count
    nothing = np.full(p, np.nan)
    values, numbers = elements.structure(nothing), {name: np.nan for name in elements.names}
    fields = dict.fromkeys(elements.population.active, np.nan)
    lost: dict[str, Any] = dict(
        **dict.fromkeys(("directions", "inseparable", "modes", "peaks"), ()),
        **dict.fromkeys(("value", "lower", "upper"), values),
        **dict.fromkeys(("prediction", "residual"), layout.tree(np.full(y.size, np.nan))),
        **dict.fromkeys(("information", "evidence"), np.nan),
        **dict.fromkeys(("u", "u_sd"), nothing),
        u_covariance=np.full((p, p), np.nan),
        names=elements.names,
        resolution=numbers,
        verdict=dict.fromkeys(elements.names, "unseen"),
        fit=Fit(np.nan, 0, np.nan, np.nan, 0, np.nan, np.nan, np.full(y.size, np.nan), ()),
        adequate=False,
        shares={group: dict(fields) for group in layout.groups},
        broken=dict(numbers),
        laplace=Laplace(np.nan, np.nan, False),
        status=Outcome(Status(int(info.status)).name),
        info=info,
        problem=problem,
        data=y,
    )
    return Posterior(**lost)


def _goodness(problem: Problem, y: np.ndarray, residual: np.ndarray, slopes: np.ndarray, u: np.ndarray) -> Fit:
    """Goodness of fit of model and prior for one unit."""
    mixing, seen = problem.elements.mixing, ~np.isnan(y)
    numbers = goodness(slopes, mixing, problem.nuisance, slopes @ u - residual, seen, problem.dof)
    return Fit(
        **{name: number.item() for name, number in numbers.items()},
        weights=seen * weights_of(residual, problem.dof),
        worst=largest(residual, problem.layout.names),
    )


@checked
def predict(
    posterior: Posterior | Draws,
    response: Response,
    *,
    draws: int = 2048,
    seed: int = 0,
    requirement: Limits | dict[str, Limits] | None = None,
    confidence: float = 0.95,
) -> Estimate | dict[str, Estimate]:
    """Return a response of the unit that was measured, or the chance that it keeps a requirement.

    The value is the mean of the response over the posterior, its error the standard deviation, and its interval holds
    the response with the given confidence. With a requirement it is the probability that the response lies within it,
    with a score interval for the finite number of draws; a draw whose response fails does not keep it.

    Args:
        posterior: of `solve`, taken as normal about each mode; or the `Draws` of `sample`.
        response: pure function of values of the prior's structure; a scalar, a dict or record of scalars, or `Outcome`.
        draws: from the posterior.
        seed: of the draws.
        requirement: `Requirement`, or a dict of them by name of the response.
        confidence: of the intervals.

    Raises:
        ValueError: a posterior without a mode, or an argument that does not fit.
    """
    counted("draws", draws, 2)
    deviate_of(confidence)
    source = posterior.posterior if isinstance(posterior, Draws) else posterior
    if not source.peaks:
        raise ValueError(f"posterior: status {source.status}, it must have a mode")
    rng = np.random.default_rng(integer("seed", seed) % 2**64)
    z = _pick(posterior, draws, rng) if isinstance(posterior, Draws) else _drawn(posterior, draws, rng)
    values, status = respond(response, source.problem.elements.population, jnp.asarray(z.T))
    good = succeeded(np.asarray(status))
    required = by_response(requirement, tuple(values), Limits, "requirement")
    estimates = {}
    for name, numbers in values.items():
        number = np.asarray(numbers, float)
        limits = required.get(name)
        if limits is not None:
            kept = good & (number >= limits.lower) & (number <= limits.upper)
            estimates[name] = wilson(int(kept.sum()), draws, confidence)
        else:
            estimates[name] = _summary(number[good & np.isfinite(number)], confidence)
    return unwrapped(estimates)


def _summary(numbers: np.ndarray, confidence: float) -> Estimate:
    if numbers.size < 2:
        return Estimate(np.nan, np.nan, np.nan, np.nan)
    ends = np.quantile(numbers, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Estimate(float(numbers.mean()), float(numbers.std(ddof=1)), float(ends[0]), float(ends[1]))


def _drawn(posterior: Posterior, draws: int, rng: np.random.Generator) -> np.ndarray:
    """z (draws, n) from the normal distributions about the modes, by their weights."""
    weights = np.array([mode.weight for mode in posterior.modes])
    peaks = rng.choice(len(weights), draws, p=weights / weights.sum())
    normal = rng.standard_normal((draws, posterior.peaks[0].z.size))
    z = np.empty_like(normal)
    for k, peak in enumerate(posterior.peaks):
        z[peaks == k] = peak.z + normal[peaks == k] @ peak.spectrum.root.T
    return z


def _pick(sampled: Draws, draws: int, rng: np.random.Generator) -> np.ndarray:
    """z (draws, n) of those sampled, each at most once where there are enough."""
    every = sampled.z.reshape(-1, sampled.z.shape[-1])
    return np.asarray(every[rng.choice(len(every), draws, replace=len(every) < draws)])
