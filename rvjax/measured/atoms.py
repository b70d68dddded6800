"""Contents of a curve that a search may add one after the other: orders, lines, drift, steps, single bad readings.

A model is a set of atoms. It is fitted by least squares; its score is minus twice the logarithm of the likelihood of
residuals that remember the last one (first-order autoregression). So noise with memory is no content.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rvjax.base.linear import svd

COLLINEAR = 1e-8  # square of the share of a column that others do not explain
TINY = 1e-300
LEAST_NOISE = 1e-9  # of the spread of a curve: rounding


@dataclass(frozen=True)
class Atom:
    """One content of a curve.

    Attributes:
        kind: "order", "pair" (of neighbouring orders), "line" (an order that is no whole number), "drift", "warm-up",
            "step" or "glitch".
        at: order, row of a step or of a bad reading, or angle constant of a warm-up, rad.
        name: of the part that causes it, "" if it is unknown.
    """

    kind: str
    at: float = 0.0
    name: str = field(default="", compare=False)

    @property
    def numbers(self) -> int:
        """Parameters: coefficients, and the place that was searched."""
        return {"order": 2, "pair": 4, "line": 2 if self.name else 3, "drift": 1}.get(self.kind, 2)

    def columns(self, angle: np.ndarray) -> np.ndarray:
        """Columns of the fit (n, k).

        Args:
            angle: ascending, rad (n,).
        """
        if self.kind in ("order", "line"):
            return np.stack([np.cos(self.at * angle), np.sin(self.at * angle)], axis=1)
        if self.kind == "pair":
            both = (Atom("order", math.floor(self.at) + side).columns(angle) for side in (0, 1))
            return np.concatenate(list(both), axis=1)
        row = np.arange(len(angle))
        gone = (angle - angle[0]) / max(float(np.ptp(angle)), 1e-300)
        if self.kind == "drift":
            return gone[:, None]
        if self.kind == "warm-up":
            return np.asarray(-np.expm1(-(angle - angle[0]) / self.at))[:, None]
        return np.asarray(row >= self.at if self.kind == "step" else row == self.at, float)[:, None]


def memory(residual: np.ndarray) -> float:
    """Correlation of a residual with the next one, 0 where it is negative."""
    square = float(residual @ residual)
    return float(np.clip(residual[1:] @ residual[:-1] / square, 0.0, 0.9999)) if square > 0 else 0.0


def score(residual: np.ndarray, least: float) -> float:
    """Minus twice the logarithm of the likelihood of residuals with memory, without constants.

    Args:
        residual: in the order of time (n,).
        least: standard deviation below which noise is rounding.
    """
    fresh = float(np.mean(residual**2)) * (1 - memory(residual) ** 2)
    return len(residual) * math.log(max(fresh, least**2))


class Model:
    """Atoms fitted to a curve `value` at `angle`, with `basis` (orthonormal columns), `residual` and `score`."""

    def __init__(self, angle: np.ndarray, value: np.ndarray, atoms: Sequence[Atom]) -> None:
        """Fit atoms.

        Args:
            angle: ascending, rad (n,).
            value: (n,).
            atoms: in addition to the mean; columns that others explain are not used.
        """
        self.angle, self.value, self.atoms = angle, value, tuple(atoms)
        self.least = LEAST_NOISE * float(np.std(value)) + 1e-150
        matrix = np.concatenate([np.ones((len(angle), 1)), *(a.columns(angle) for a in atoms)], axis=1)
        self.owner = np.array([-1, *(k for k, a in enumerate(atoms) for _ in range(a.columns(angle[:2]).shape[1]))])
        self.matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), TINY)
        left, size, right = svd(self.matrix)
        kept = size > math.sqrt(COLLINEAR) * size[0]
        self.basis, self.inverse = left[:, kept], right[kept].T / size[kept]
        self.residual = value - self.basis @ (self.basis.T @ value)
        self.residual -= self.basis @ (self.basis.T @ self.residual)
        self.score = score(self.residual, self.least)

    def more(self, atom: Atom) -> float:
        """Score with one more atom, which is not added."""
        columns = atom.columns(self.angle)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), TINY)
        own = columns - self.basis @ (self.basis.T @ columns)
        left, size, _ = svd(own)
        left = left[:, size > math.sqrt(COLLINEAR)]
        return score(self.residual - left @ (left.T @ self.residual), self.least)

    def curve(self, atoms: Sequence[Atom]) -> np.ndarray:
        """Fitted curve of some atoms (n,)."""
        own = np.array([k >= 0 and self.atoms[k] in atoms for k in self.owner])
        return np.asarray(self.matrix[:, own] @ (self.inverse @ (self.basis.T @ self.value))[own])

    def size(self, atom: Atom) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the columns of an atom, and their covariance for noise of 1.

        Args:
            atom: of the model.
        """
        own = self.owner == self.atoms.index(atom)
        scale = np.maximum(np.linalg.norm(atom.columns(self.angle), axis=0), TINY)
        inverse = self.inverse[own] / scale[:, None]
        return inverse @ (self.basis.T @ self.value), inverse @ inverse.T

    def without(self, atom: Atom) -> "Model":
        """The model with one atom less."""
        return Model(self.angle, self.value, [a for a in self.atoms if a != atom])
