"""Goodness of fit: two independent p-values from one linearised datum; and a check of Laplace's method.

d = J z^ - r is what the data would be if the model were linear at the mode. Along the left singular vectors of J its
components are independent N(0, 1 + lambda) if model, prior and noise are right. Those with lambda >= 0.01 test
the prior (chi2_prior), the rest tests the model (chi2_model). Both p-values are uniform,
exactly so in the linear normal case. The part that nuisances explain is projected out first.

Laplace's method: draws from the normal distribution about the mode, weighted by the true density. The tail of the
weights is fitted by a generalised Pareto distribution (Zhang and Stephens 2009, Technometrics 51, 316);
a shape k above 0.7 means that averages over the normal distribution are not reliable (Vehtari, Simpson, Gelman, Yao and
Gabry 2024, J. Mach. Learn. Res. 25, 72).
"""

import dataclasses
import math

import numpy as np
from scipy import special

from rvjax.identify.elements import compress_rows

REACHED = 0.01
"""Least lambda of a component that parts within the prior can move."""

ADEQUATE = 0.001
"""Least p_model of a model that may be right."""

SIMULATED = 20_000
"""Linearised units behind the p-values of Student noise; an eighth of them for each unit of a batch."""

WORST = 5


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """Goodness of fit of model and prior; for a batch, arrays over the units.

    Attributes:
        chi2_model: sum of squares of what no part can do.
        dof_model: its number of components.
        p_model: chance of as much or more if the model is right.
        chi2_prior: sum of squares, each over its variance, of what parts of the prior can do.
        dof_prior: its number of components.
        p_prior: chance of as much or more for parts of this prior.
        p_total: of both sums together.
        weights: of Student noise for each real number (m,), 1 for normal noise, 0 where missing.
        worst: names of the largest residuals, largest first.
    """

    chi2_model: float | np.ndarray
    dof_model: int | np.ndarray
    p_model: float | np.ndarray
    chi2_prior: float | np.ndarray
    dof_prior: int | np.ndarray
    p_prior: float | np.ndarray
    p_total: float | np.ndarray
    weights: np.ndarray
    worst: tuple[str, ...] | tuple[tuple[str, ...], ...]


@dataclasses.dataclass(frozen=True)
class Components:
    """Sums of squares of linearised data (..., m), and how to find those of simulated ones."""

    left: np.ndarray  # (..., m, k)
    eigenvalues: np.ndarray  # (..., k)
    nuisances: np.ndarray  # (..., m, q) orthonormal columns, zero where the rank is lower
    seen: np.ndarray  # (..., m)

    @classmethod
    def of(cls, slopes: np.ndarray, mixing: np.ndarray, nuisance: np.ndarray, seen: np.ndarray) -> "Components":
        """Components of slopes over u (..., m, p) whose columns `nuisance` are projected out."""
        columns = _orthonormal(slopes[..., nuisance])
        slopes = slopes - columns @ (np.swapaxes(columns, -1, -2) @ slopes)
        slopes[..., nuisance] = 0.0
        left, singular, _ = np.linalg.svd(slopes @ mixing, full_matrices=False)
        return cls(left, singular**2, columns, seen)

    @property
    def reached(self) -> np.ndarray:
        """True for components that parts of the prior can move."""
        return self.eigenvalues >= REACHED

    @property
    def dof(self) -> tuple[np.ndarray, np.ndarray]:
        """Components of the model's and of the prior's sum."""
        prior = self.reached.sum(axis=-1)
        nuisances = np.rint((self.nuisances**2).sum(axis=(-2, -1))).astype(int)
        return np.maximum(self.seen.sum(axis=-1) - nuisances - prior, 0), prior

    def sums(self, data: np.ndarray, moved: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """chi2_model and chi2_prior.

        Args:
            data: d (..., m).
            moved: what parts add along the left vectors where d is noise alone (..., k).
        """
        data = data - _along(self.nuisances, data)
        along = _dot(self.left, data)
        rest = ((data - _back(self.left, along)) ** 2).sum(axis=-1)
        squares = (along + moved) ** 2 / (1 + self.eigenvalues)
        model = rest + np.where(self.reached, 0.0, squares).sum(axis=-1)
        return model * (self.dof[0] > 0), np.where(self.reached, squares, 0.0).sum(axis=-1)


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns of the same span, zero where the rank is lower."""
    if not columns.size:
        return columns
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    least = max(columns.shape[-2:]) * np.finfo(float).eps * singular.max(axis=-1, keepdims=True)
    return np.asarray(left * (singular > least)[..., None, :])


def _dot(columns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...mk,...m->...k", columns, vectors, optimize=True))


def _back(columns: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...mk,...k->...m", columns, numbers, optimize=True))


def _along(columns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return _back(columns, _dot(columns, vectors))


def goodness(
    slopes: np.ndarray, mixing: np.ndarray, nuisance: np.ndarray, data: np.ndarray, seen: np.ndarray, dof: float | None
) -> dict[str, np.ndarray]:
    """Compute the statistics of `Fit` for units with linearised data d (..., m)."""
    if dof is None:  # normal noise stays what it is when rows are turned
        rows = compress_rows(np.concatenate([slopes, data[..., None]], axis=-1))
        slopes, data = rows[..., :-1], rows[..., -1]
    components = Components.of(slopes, mixing, nuisance, seen)
    model, prior = components.sums(data)
    dof_model, dof_prior = components.dof
    if dof is None:
        p_model, p_prior, p_total = (
            _chance(*pair) for pair in ((model, dof_model), (prior, dof_prior), (model + prior, dof_model + dof_prior))
        )
    else:
        p_model, p_prior, p_total = _simulated_chances(components, model, prior, dof)
    return dict(
        chi2_model=model, dof_model=dof_model, p_model=p_model, chi2_prior=prior, dof_prior=dof_prior, p_prior=p_prior,
        p_total=p_total,
    )  # fmt: skip


def _chance(chi2: np.ndarray, dof: np.ndarray) -> np.ndarray:
    return np.where(dof > 0, special.chdtrc(np.maximum(dof, 1), chi2), 1.0)


def _simulated_chances(components: Components, model: np.ndarray, prior: np.ndarray, dof: float) -> np.ndarray:
    """p-values (3, ...) by simulation of the linearised model, the same random numbers for every unit."""
    lead = model.shape
    count = SIMULATED // 8 if lead else SIMULATED
    rng = np.random.default_rng(0)
    noise = rng.standard_t(dof, (count, components.left.shape[-2]))
    parts = rng.standard_normal((count, components.eigenvalues.shape[-1]))
    chances = np.empty((3, *lead))
    for unit in np.ndindex(lead):
        one = Components(*(getattr(components, f.name)[unit] for f in dataclasses.fields(components)))
        sums = one.sums(noise * one.seen, parts * np.sqrt(one.eigenvalues))
        for k, (simulated, own) in enumerate(
            [(sums[0], model[unit]), (sums[1], prior[unit]), (sums[0] + sums[1], model[unit] + prior[unit])]
        ):
            # A sum without components is 0 in every draw, and so its own: p = 1.
            chances[(k, *unit)] = (1 + np.sum(simulated >= own)) / (1 + count)
    return chances


def largest(residual: np.ndarray, names: list[str]) -> tuple[str, ...]:
    """Names of the largest residuals (m,), largest first."""
    order = np.argsort(-np.abs(residual), kind="stable")[:WORST]
    return tuple(names[i] for i in order if residual[i] != 0)


MOST_PARETO = 0.7
"""Largest shape of weights whose averages can be trusted."""

EQUAL = 0.99
"""Effective draws, as a part of all, above which weights are equal: their variance is below 1 % of the square of their
mean. The shape of such weights is that of rounding: 0.80 with one compiler, 0.38 with another."""

LEAST_DRAWS = 40
"""Below, the tail holds too few weights for a fit."""


@dataclasses.dataclass(frozen=True)
class Laplace:
    """Reliability of the intervals about the mode.

    Attributes:
        pareto_k: shape of the tail of the importance weights; 0 where they are equal, as `EQUAL` says.
        ess: effective number of the draws.
        trusted: pareto_k <= 0.7, and a single mode holds more than 1 %.
    """

    pareto_k: float
    ess: float
    trusted: bool


def pareto_shape(log_weights: np.ndarray) -> float:
    """Shape k of the tail of importance weights; inf if so many are zero that no tail is left."""
    size = log_weights.size
    tail = min(size // 5, math.ceil(3 * math.sqrt(size)))
    ordered = np.sort(log_weights - log_weights.max())
    cutoff, above = ordered[-tail - 1], ordered[-tail:]
    if not math.isfinite(cutoff):
        return math.inf
    if above[-1] - cutoff < 1e-9:
        return 0.0
    excess = np.exp(above) - math.exp(cutoff)
    excess = excess[excess > 0]
    return _generalised_pareto(excess) if excess.size > 4 else math.inf


def _generalised_pareto(x: np.ndarray) -> float:
    """Shape k of sorted excesses: the profile likelihood over theta = -k/sigma averaged, and a weak prior at 0.5."""
    n = x.size
    points = 30 + int(math.sqrt(n))
    quarter = x[int(n / 4 + 0.5) - 1]
    theta = 1 / x[-1] + (1 - np.sqrt(points / (np.arange(points) + 0.5))) / (3 * quarter)
    shape = np.log1p(-theta[:, None] * x).mean(axis=1)
    likelihood = n * (np.log(-theta / shape) - shape - 1)
    weights = np.exp(likelihood - likelihood.max())
    k = float(np.log1p(-(theta @ weights / weights.sum()) * x).mean())
    return (n * k + 5.0) / (n + 10.0)


def reliability(log_weights: np.ndarray, modes: int) -> Laplace:
    """Return the verdict on draws.

    Args:
        log_weights: of draws from the normal distribution; -inf where the model is not finite.
        modes: that hold more than 1 %.
    """
    if not np.isfinite(log_weights.max()):
        return Laplace(math.inf, 0.0, False)
    weights = np.exp(log_weights - log_weights.max())
    ess = float(weights.sum() ** 2 / (weights**2).sum())
    k = 0.0 if ess > EQUAL * weights.size else pareto_shape(log_weights)
    return Laplace(k, ess, bool(k <= MOST_PARETO and modes <= 1))
