"""`predict`: another response of the same unit, with its uncertainty."""

import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax.identify.posterior import Posterior
from rvjax.identify.problem import counted, integer
from rvjax.identify.sampler import Draws
from rvjax.population import Estimate, deviate_of, wilson
from rvjax.response import Response, by_response, respond, unwrapped
from rvjax.status import succeeded
from rvjax.tolerances import Limits


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
    found = {}
    for name, numbers in values.items():
        number = np.asarray(numbers, float)
        limits = required.get(name)
        if limits is not None:
            kept = good & (number >= limits.lower) & (number <= limits.upper)
            found[name] = wilson(int(kept.sum()), draws, confidence)
        else:
            found[name] = _summary(number[good & np.isfinite(number)], confidence)
    return unwrapped(found)


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
