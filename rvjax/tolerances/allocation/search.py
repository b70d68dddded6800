"""The search for the cheapest half-widths: steps of a separable model, kept to a trust region."""

import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.separable import cheapest, total_cost
from rvjax.tolerances.allocation.training import Point, Training

_RADIUS = 1.5  # first step, at most, in logarithms of the half-widths
_SETTLED = 2e-3  # steps and violations (as parts of the way to the limit) smaller than this end the search
_NOISE = 0.02  # violation that the sample itself may err by; the certificate takes care of it
_GAIN = 5e-4  # and so does a step that saves less of the cost


class Search:
    """Evaluates sets of half-widths, remembers them, and walks to the cheapest one that meets all constraints."""

    def __init__(self, training: Training, priced: dict[str, Cost], max_steps: int) -> None:
        self.training, self.costs, self.max_steps = training, tuple(priced.values()), max_steps
        self.advance: Callable[[int], Any] = lambda count: None  # of a progress bar
        self.low = np.array([float(cost.finest) for cost in self.costs])
        self.high = np.array([float(cost.coarsest) for cost in self.costs])
        self.history: list[dict[str, Any]] = []

    def cost(self, half_widths: np.ndarray) -> float:
        """Total cost."""
        return float(total_cost(self.costs, jnp.asarray(half_widths)))

    def look(self, half_widths: np.ndarray) -> Point:
        """Evaluate the sample and note it."""
        point = self.training.point(half_widths)
        self.advance(1)
        names = [*(name or "response" for name in self.training.requirements), "joint"]
        margins = dict(zip(names, map(float, point.margins)))  # the joint one is last, if there is one
        named = dict(zip(self.training.fields, map(float, half_widths)))
        self.history.append(dict(cost=self.cost(half_widths), margins=margins, half_widths=named))
        return point

    def begin(self, start: np.ndarray) -> Point:
        """The given half-widths, or the finest where so many units fail that no quantile is left."""
        point = self.look(np.clip(start, self.low, self.high))
        return point if np.isfinite(point.margins).all() else self.look(self.low)

    def run(self, best: Point) -> tuple[Point, bool]:
        """From a point to the cheapest, and whether the steps settled there."""
        distance, radius = self.training.distance, _RADIUS
        while len(self.history) < self.max_steps:
            wanted, prices = self.model_optimum(best, radius)
            step = float(np.abs(np.log(wanted / best.half_widths)).max())
            excess = float((best.margins / distance).max())
            met = excess <= _SETTLED
            if radius < _SETTLED or (met and step < _SETTLED):
                return best, excess <= _NOISE
            new, penalty = self.look(wanted), np.maximum(self.cost(best.half_widths) / distance, 2 * prices)
            gain = self._merit(best, penalty) - self._merit(new, penalty)
            if gain <= 0:
                radius = step / 3
                continue
            best, radius = new, max(radius, 2 * step)
            if met and gain < _GAIN * self.cost(best.half_widths):
                return best, True
        return best, False

    def model_optimum(self, point: Point, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Cheapest half-widths within a factor exp(radius) under the model around a point, and its multipliers."""
        low, high = (np.clip(point.half_widths * math.exp(r), self.low, self.high) for r in (-radius, radius))
        return cheapest(self.costs, point, self.training.distance, low, high)

    def multipliers(self, point: Point) -> np.ndarray:
        """Cost that one unit of each margin is worth at a point."""
        return self.model_optimum(point, _RADIUS)[1]

    def _merit(self, point: Point, penalty: np.ndarray) -> float:
        """Cost plus an exact penalty on violated constraints."""
        return self.cost(point.half_widths) + float(penalty @ np.maximum(point.margins, 0.0))
