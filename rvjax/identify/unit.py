"""`solve`: errors of the parts of one unit from its measurement."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy import special

from rvjax._jax.checks import checked
from rvjax.identify import fit as fits, laplace as checks
from rvjax.identify.elements import mapped_values
from rvjax.identify.fit import ADEQUATE, Fit
from rvjax.identify.information import findings
from rvjax.identify.laplace import Laplace
from rvjax.identify.limits import broken, limits_of
from rvjax.identify.noise import Noise
from rvjax.identify.posterior import Mode, Outcome, Posterior, outcome
from rvjax.identify.problem import Model, Problem, counted, integer
from rvjax.identify.search import FAINT, Peak, phi_about, phi_at, search
from rvjax.identify.shares import shares
from rvjax.population import Correlation, deviate_of
from rvjax.records import PyTree
from rvjax.status import SolveInfo, Status

AGREED = 0.2
"""Largest error of the logarithm of a weight, over the spread of all, that leaves the tail of the weights as it is."""


@checked
def solve(
    model: Model,
    prior: PyTree,
    data: PyTree,
    *,
    noise: Noise,
    nuisance: str | Iterable[str] = (),
    correlation: Correlation = None,
    starts: int = 8,
    seed: int = 0,
    max_steps: int = 50,
    draws: int = 512,
    confidence: float = 0.95,
    limits: PyTree = None,
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
    counted("draws", draws, checks.LEAST_DRAWS)
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
    laplace = checks.reliability(log_weights, heavy)
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
    found = fits.goodness(slopes, mixing, problem.nuisance, slopes @ u - residual, seen, problem.dof)
    return Fit(
        **{name: number.item() for name, number in found.items()},
        weights=fits.weights(residual, seen, problem.dof),
        worst=fits.largest(residual, problem.layout.names),
    )
