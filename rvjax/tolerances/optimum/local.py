"""Cost and margins at one vector of decisions."""

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Local:
    """Cost and margins at one vector of decisions, with derivatives.

    Attributes:
        x: (n,) the vector.
        cost: without the objective.
        slopes: (n,) its derivatives.
        bends: (n,) its curvatures.
        objective: priced outputs without errors.
        objective_slopes: (n,) their derivatives.
        margins: (c,) of the constraints, in parts of their ways; <= 0 is met.
        jacobian: (c, n) their derivatives.
        moved: (c,) corrections in these margins, in parts of their ways.
    """

    x: np.ndarray
    cost: float
    slopes: np.ndarray
    bends: np.ndarray
    objective: float
    objective_slopes: np.ndarray
    margins: np.ndarray
    jacobian: np.ndarray
    moved: np.ndarray

    @property
    def total(self) -> float:
        """Cost with the objective."""
        return self.cost + self.objective
