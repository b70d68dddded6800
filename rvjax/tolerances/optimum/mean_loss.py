"""Mean loss of units and its derivatives to the vector of decisions.

Costly units behind it are few. They are all solved where a search anchors its units, and follow their gradients from
there.
"""

import math
from collections.abc import Mapping

import numpy as np

from rvjax.population import first_points
from rvjax.response import Response
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.loss import QuadraticLoss
from rvjax.tolerances.optimum.anchor import Anchor, AnchoredUnits
from rvjax.tolerances.optimum.decisions import Decisions


class MeanLoss:
    """Losses of `samples` units; nothing without any."""

    def __init__(
        self,
        response: Response,
        decisions: Decisions,
        losses: Mapping[str, QuadraticLoss],
        samples: int,
        seed: int,
        memo: Memo | None,
    ) -> None:
        self._losses, self._decisions = dict(losses), decisions
        self._units = AnchoredUnits(response, decisions, set(losses), memo)
        numbers = decisions.base.numbers
        self._z = first_points(numbers, seed, samples) if losses else np.zeros((numbers, 0))
        self._anchors: dict[bytes, Anchor | None] = {}

    @property
    def evaluated(self) -> int:
        """Units solved so far."""
        return self._units.evaluated

    def look(self, x: np.ndarray, *, sloped: bool = True) -> tuple[float, np.ndarray]:
        """Mean loss of the units that do not fail, inf where all do, and its derivatives (n,); 0 without `sloped`."""
        total, towards = 0.0, np.zeros(self._decisions.size)
        if not self._losses:
            return total, towards
        population, values = self._decisions.population(x), self._units.values(x, self._z, "tails")
        for name, loss in self._losses.items():
            units = np.flatnonzero(np.isfinite(values[name]))
            if not len(units):
                return math.inf, towards
            total += float(np.mean(loss(values[name][units])))
            if sloped:
                pull = {name: np.asarray(loss.slope(values[name][units])) / len(units)}
                towards += self._units.slope(x, population, self._z[:, units], pull, units)
        return total, towards

    def follow(self, x: np.ndarray) -> None:
        """Solve the units at a vector; values elsewhere follow their gradients from there."""
        if self._losses:
            self._units.drop(x, self._z, {name: np.zeros(self._z.shape[1]) for name in self._losses})
            self._anchors[x.tobytes()] = self._units.anchor

    def follow_from(self, x: np.ndarray | None) -> None:
        """Follow from an earlier vector again; None: all units are solved."""
        self._units.anchor = None if x is None else self._anchors.get(x.tobytes())
