"""Spectrum of the whitened information, and which elements it identifies.

With slopes J over z ~ N(0, I) and J = U S V', lambda = s^2: the posterior covariance of z is V diag(1/(1 + lambda)) V',
a sum of positive terms that keeps its digits next to a lambda of 1e10. Equal lambda have no unique vectors: only
their subspace has a meaning.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

IDENTIFIED = 0.5
"""Largest standard deviation, in those of the prior, of an element that counts as known by itself."""

LOADED = 0.05
"""Least share of an element's variance in the directions seen for it to count as part of a combination."""

SEEN = 1.0
"""Least lambda of a direction: there the data weigh more than the drawing."""

INSEPARABLE = 0.95
"""Least posterior correlation, by size, of two elements that are not distinguishable."""


def compress_rows(rows: np.ndarray) -> np.ndarray:
    """Rows (..., m, n) turned into at most n of the same lengths and angles between columns: their factor R."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if rows.shape[-2] > rows.shape[-1] else rows


class Spectrum(NamedTuple):
    """Singular values and right vectors of slopes J (..., m, n)."""

    eigenvalues: np.ndarray  # (..., n) lambda, largest first
    right: np.ndarray  # (..., n, n), columns

    @classmethod
    def of(cls, slopes: np.ndarray) -> "Spectrum":
        """Return the spectrum of finite slopes."""
        n = slopes.shape[-1]
        _, singular, right = np.linalg.svd(compress_rows(slopes), full_matrices=True)
        missing = np.zeros((*singular.shape[:-1], n - singular.shape[-1]))
        eigenvalues = np.concatenate([singular, missing], axis=-1) ** 2
        return cls(eigenvalues, np.swapaxes(right, -1, -2))

    @property
    def root(self) -> np.ndarray:
        """L (..., n, n) with L L' = (I + J'J)^-1."""
        return self.right / np.sqrt(1 + self.eigenvalues)[..., None, :]

    @property
    def nats(self) -> np.ndarray:
        """Information gained, sum ln(1 + lambda)/2."""
        return np.log1p(self.eigenvalues).sum(axis=-1) / 2


@dataclasses.dataclass(frozen=True)
class Direction:
    """One combination of elements that the data determine.

    Attributes:
        information: lambda, the variance before over the variance after, less one.
        loadings: {element: its correlation with the combination}, the largest positive.
    """

    information: float
    loadings: dict[str, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Identifiability:
    """Elements of a prior that a measurement identifies.

    Attributes:
        names: of the elements, (p,).
        u_sd: standard deviations after the measurement, in those of the prior (p,).
        resolution: {element: 1 - u_sd}.
        verdict: {element: "identified" (u_sd <= 0.5), "combination" (seen only together with others) or "unseen"}.
        directions: combinations with lambda >= 1, strongest first.
        inseparable: (element, element, posterior correlation) of pairs beyond 0.95.
        information: of the whole measurement, nats.
    """

    names: tuple[str, ...]
    u_sd: np.ndarray
    resolution: dict[str, float]
    verdict: dict[str, str]
    directions: tuple[Direction, ...]
    inseparable: tuple[tuple[str, str, float], ...]
    information: float


def covariance(spectrum: Spectrum, mixing: np.ndarray) -> np.ndarray:
    """Posterior covariance of u = M z (..., p, p)."""
    root = mixing @ spectrum.root
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def findings(names: tuple[str, ...], mixing: np.ndarray, spectrum: Spectrum) -> Identifiability:
    """Compute the identifiability of one unit."""
    root = mixing @ spectrum.root
    u_sd = np.linalg.norm(root, axis=1)
    loadings = (mixing @ spectrum.right)[:, spectrum.eigenvalues >= SEEN]
    largest = np.abs(loadings).argmax(axis=0)
    loadings = loadings * np.where(loadings[largest, np.arange(loadings.shape[1])] < 0, -1.0, 1.0)
    seen = (loadings**2).sum(axis=1) >= LOADED
    verdict = np.where(u_sd <= IDENTIFIED, "identified", np.where(seen, "combination", "unseen"))
    scaled = root / u_sd[:, None]
    correlation = scaled @ scaled.T
    pairs = np.argwhere(np.tril(np.abs(correlation) >= INSEPARABLE, -1))
    return Identifiability(
        names=names,
        u_sd=u_sd,
        resolution={name: float(1 - sd) for name, sd in zip(names, u_sd)},
        verdict={name: str(word) for name, word in zip(names, verdict)},
        directions=tuple(
            Direction(float(value), {name: float(number) for name, number in zip(names, column)})
            for value, column in zip(spectrum.eigenvalues, loadings.T)
        ),
        inseparable=tuple((names[i], names[j], float(correlation[i, j])) for i, j in pairs),
        information=float(spectrum.nats),
    )
