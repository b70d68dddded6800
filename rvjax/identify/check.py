"""`identifiability`: which elements a measurement identifies, before anything is measured."""

from collections.abc import Iterable, Sequence

import numpy as np

from rvjax._jax.checks import checked
from rvjax.identify.elements import mapped_values
from rvjax.identify.information import Identifiability, Spectrum, findings
from rvjax.identify.noise import Noise
from rvjax.identify.problem import Model, Problem
from rvjax.population import Correlation
from rvjax.records import PyTree


@checked
def identifiability(
    model: Model,
    prior: PyTree,
    *,
    noise: Noise,
    at: PyTree = None,
    nuisance: str | Iterable[str] = (),
    correlation: Correlation = None,
) -> Identifiability:
    """Predict which elements a measurement identifies; needs no data.

    Args:
        model: pure function, values of the prior's structure -> observation.
        prior: record or dict (nested ones too) with a `Tolerance`, a constant or None in each field.
        noise: of the observation.
        at: values at which the model is linearised, structure of the prior; None: the mid-point of the prior.
        nuisance: names of fields or elements that are not of interest; here they count as all others.
        correlation: {(field or element, field or element): correlation of their u}.

    Raises:
        ValueError: an argument that does not fit, or a model that is not finite there.
    """
    problem = Problem.of(model, prior, noise=noise, nuisance=nuisance, correlation=correlation)
    u = np.zeros(problem.elements.count) if at is None else problem.elements.at("at", at)
    slopes = slopes_at(problem, u)[0] / problem.sd[:, None]
    mixing = problem.elements.mixing
    spectrum = Spectrum.of(np.sqrt(problem.discount) * slopes @ mixing)
    return findings(problem.elements.names, mixing, spectrum)


def slopes_at(problem: Problem, u: np.ndarray, models: Sequence[Model] = ()) -> np.ndarray:
    """Slopes over u (k, m, p) of models at u (p,), by default of that of the problem; the model must be finite there.

    Args:
        problem: with its noise left out.
        u: standard numbers.
        models: that differ in fields of their parts alone.

    Raises:
        ValueError: a model that is not finite at u.
    """
    observation, found = problem.evaluate(np.tile(u, (max(len(models), 1), 1)), models=models)
    if not (np.isfinite(found).all() and np.isfinite(observation).all()):
        values = problem.elements.structure(mapped_values(problem.elements, u[None])[0])
        raise ValueError(f"model: its observation or its slope is not finite at {values}, in SI".replace("\n", " "))
    return found
