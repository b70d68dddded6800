"""Constraints along rays: common factor on all half-widths at which a constraint fails.

Where units fail, or a response moves in steps, derivatives of units do not give the slope of a constraint. Along a ray
from zero errors every unit leaves its limits at its specific factor. The factor at which a constraint fails is
therefore continuous in the half-widths for any response, and its differences are slopes. They cost a few dozen samples
where derivatives cost one sample, and are used only where derivatives mislead.
"""

import copy

import numpy as np

from rvjax.tolerances.optimum.sample_average import Point, Training

IDLE = 0.5
"""With a larger margin than this, logarithm of a factor, a constraint does not bind."""

_INWARD, _OUTWARD = 5.0, 0.7  # reach of a ray, logarithm of the factor
_STEP = 0.15  # of differences, logarithm of a half-width: wide enough that several units cross
_FINE, _COARSE = 1e-3, _STEP / 50  # accuracy of a place on a ray and of a difference


class Rays:
    """Points of a learning sample from values alone."""

    def __init__(self, training: Training) -> None:
        self.training = training

    def point(self, half_widths: np.ndarray) -> Point:
        """Margins and slopes as `Training.point` has them, in parts of the way along the ray."""
        room = self.room(half_widths)
        slopes = np.stack([self._difference(half_widths, room, j) for j in range(len(half_widths))], axis=1)
        scale = self.training.distance * np.exp(-self._corrected(room))
        weights = np.eye(len(room), len(self.training.requirements))
        return Point(half_widths, scale - self.training.distance, scale[:, None] * slopes, weights)

    def room(self, half_widths: np.ndarray) -> np.ndarray:
        """Logarithm of the factor at which each constraint (c,) fails."""
        ends = np.full(len(self.training.distance), _INWARD), np.full(len(self.training.distance), _OUTWARD)
        return self._room(half_widths, -ends[0], ends[1], _FINE)

    def scaled(self, half_widths: np.ndarray) -> np.ndarray:
        """Half-widths on the ray just before the first constraint fails."""
        return half_widths * np.exp(self._corrected(self.room(half_widths)).min() - _FINE)

    def met(self, half_widths: np.ndarray) -> bool:
        """True if every constraint holds."""
        factors = np.unique(self.training.correction)
        seen = {factor: self.training.uncorrected(half_widths * factor) for factor in factors}
        return all(seen[factor][k] <= 0 for k, factor in enumerate(self.training.correction))

    def moved(self, name: str, outward: float) -> "Rays":
        """Rays with other limits of one requirement."""
        training = copy.copy(self.training)
        training.requirements = training.requirements | {name: training.requirements[name].widened(outward)}
        return Rays(training)

    def _corrected(self, room: np.ndarray) -> np.ndarray:
        return room - np.log(self.training.correction)

    def _difference(self, half_widths: np.ndarray, room: np.ndarray, j: int) -> np.ndarray:
        """-d log(factor)/d log(half-width j) of each constraint that may bind."""
        found, open_ = [], np.where(room < IDLE, _STEP, 0.0)
        for sign in (1.0, -1.0):
            near, far = 0.5 * open_, 1.25 * open_  # a wider field reduces the margin by no more than it grows
            low, high = (room - far, room + near) if sign > 0 else (room - near, room + far)
            moved = half_widths.copy()
            moved[j] *= np.exp(sign * _STEP)
            found.append(self._room(moved, low, high, _COARSE))
        return (found[1] - found[0]) / (2 * _STEP)

    def _room(self, half_widths: np.ndarray, low: np.ndarray, high: np.ndarray, known: float) -> np.ndarray:
        """Place of each constraint between `low` and `high`, by bisection; every sample serves all constraints."""
        while (high - low).max() > known:
            k = int(np.argmax(high - low))
            at = (low[k] + high[k]) / 2
            met = self.training.uncorrected(half_widths * np.exp(at)) <= 0
            low = np.where(met, np.clip(at, low, high), low)
            high = np.where(met, high, np.clip(at, low, high))
        return (low + high) / 2
