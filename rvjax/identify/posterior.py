"""Result of `solve`: most probable values of one unit, their uncertainty, and the goodness of fit."""

import dataclasses
import enum

import numpy as np

from rvjax.identify.fit import Fit
from rvjax.identify.information import Identifiability
from rvjax.identify.laplace import Laplace
from rvjax.identify.problem import Problem
from rvjax.identify.search import Peak
from rvjax.records import PyTree
from rvjax.status import SolveInfo, Status


class Outcome(enum.StrEnum):
    """Status of an identification; the first that applies is returned."""

    NONFINITE = "NONFINITE"
    MAX_STEPS = "MAX_STEPS"
    REJECTED = "REJECTED"
    MULTIMODAL = "MULTIMODAL"
    LAPLACE_DOUBTFUL = "LAPLACE_DOUBTFUL"
    CONVERGED = "CONVERGED"


@dataclasses.dataclass(frozen=True, eq=False)
class Mode:
    """One maximum of the posterior.

    Attributes:
        value: structure of the prior, SI.
        weight: share of the posterior, by Laplace's method.
    """

    value: PyTree
    weight: float


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior(Identifiability):
    """Elements of one unit from its measurement; all numbers are NaN where `info` reports that no mode was found.

    Attributes:
        names: of the elements, (p,).
        u_sd: posterior standard deviations, in those of the prior (p,).
        resolution: {element: 1 - u_sd}.
        verdict: {element: "identified", "combination" or "unseen"}.
        directions: combinations with lambda >= 1, strongest first.
        inseparable: (element, element, posterior correlation) of pairs beyond 0.95.
        information: of the measurement, nats.
        u: most probable standard numbers (p,).
        u_covariance: of them (p, p).
        value: most probable values, structure of the prior, SI.
        lower: lower ends of their intervals.
        upper: upper ends.
        fit: how well model and prior explain the data.
        adequate: p_model >= 0.001.
        shares: {group of the observation: {field: share of what is explained}}.
        broken: {element: probability outside its limits}.
        modes: maxima of the posterior, the heaviest first.
        laplace: whether the intervals can be trusted.
        evidence: logarithm of the data's density, by Laplace's method.
        prediction: of the model at the mode, structure of the data.
        residual: data less prediction, NaN where missing.
        status: NONFINITE, MAX_STEPS, REJECTED, MULTIMODAL, LAPLACE_DOUBTFUL or CONVERGED.
        info: of the solver alone; `rvjax.check` takes the result.
        problem: model, prior and noise; for `sample` and `predict`.
        data: the measured numbers (m,), NaN where missing.
        peaks: the modes' numbers.
    """

    u: np.ndarray
    u_covariance: np.ndarray
    value: PyTree
    lower: PyTree
    upper: PyTree
    fit: Fit
    adequate: bool
    shares: dict[str, dict[str, float]]
    broken: dict[str, float]
    modes: tuple[Mode, ...]
    laplace: Laplace
    evidence: float
    prediction: PyTree
    residual: PyTree
    status: Outcome
    info: SolveInfo
    problem: Problem = dataclasses.field(repr=False)
    data: np.ndarray = dataclasses.field(repr=False)
    peaks: tuple[Peak, ...] = dataclasses.field(repr=False)


def outcome(solver: int, adequate: bool, heavy: int, trusted: bool) -> Outcome:
    """Return the first outcome that applies."""
    if solver == Status.NONFINITE:
        return Outcome.NONFINITE
    if solver == Status.MAX_STEPS:
        return Outcome.MAX_STEPS
    if not adequate:
        return Outcome.REJECTED
    if heavy > 1:
        return Outcome.MULTIMODAL
    return Outcome.CONVERGED if trusted else Outcome.LAPLACE_DOUBTFUL
