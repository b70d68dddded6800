"""Constraints along rays: by how much all half-widths may grow together until one of them no longer holds.

Where units fail, or a response moves in steps, the derivatives of units say nothing of a constraint. Along a ray from
no error at all every unit leaves its limits at one place or another, so that the factor at which a constraint gives way
is continuous in the half-widths whatever the response does, and its differences are slopes. They cost a few dozen
samples where derivatives cost one, and are asked for only where those mislead.
"""

import copy

import numpy as np

from rvjax.tolerances.allocation.sample_average import Point, Training

IDLE = 0.5
"""With more room than this, logarithm of a factor, a constraint does not bind."""

_INWARD, _OUTWARD = 5.0, 0.7  # reach of a ray, logarithm of the factor
_STEP = 0.15  # of differences, logarithm of a half-width: wide enough that several units cross
_FINE, _COARSE = 1e-3, _STEP / 50  # what a place on a ray and a difference are known to


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
        """Logarithm of the factor at which each constraint (c,) gives way."""
        ends = np.full(len(self.training.distance), _INWARD), np.full(len(self.training.distance), _OUTWARD)
        return self._room(half_widths, -ends[0], ends[1], _FINE)

    def scaled(self, half_widths: np.ndarray) -> np.ndarray:
        """The half-widths of the ray just before the first constraint gives way."""
        return half_widths * np.exp(self._corrected(self.room(half_widths)).min() - _FINE)

    def met(self, half_widths: np.ndarray) -> bool:
        """True if every constraint holds."""
        factors = np.unique(self.training.correction)
        seen = {factor: self.training.uncorrected(half_widths * factor) for factor in factors}
        return all(seen[factor][k] <= 0 for k, factor in enumerate(self.training.correction))

    def moved(self, name: str, outward: float) -> "Rays":
        """The same units where the limits of one requirement stand elsewhere."""
        training = copy.copy(self.training)
        training.requirements = training.requirements | {name: training.requirements[name].widened(outward)}
        return Rays(training)

    def _corrected(self, room: np.ndarray) -> np.ndarray:
        return room - np.log(self.training.correction)

    def _difference(self, half_widths: np.ndarray, room: np.ndarray, j: int) -> np.ndarray:
        """-d log(factor)/d log(half-width j) of each constraint that may bind."""
        found, open_ = [], np.where(room < IDLE, _STEP, 0.0)
        for sign in (1.0, -1.0):
            near, far = 0.5 * open_, 1.25 * open_  # a wider field takes from the room, never more than it grows
            low, high = (room - far, room + near) if sign > 0 else (room - near, room + far)
            moved = half_widths.copy()
            moved[j] *= np.exp(sign * _STEP)
            found.append(self._room(moved, low, high, _COARSE))
        return (found[1] - found[0]) / (2 * _STEP)

    def _room(self, half_widths: np.ndarray, low: np.ndarray, high: np.ndarray, known: float) -> np.ndarray:
        """The place of each constraint between `low` and `high`, by halving; every sample serves them all."""
        while (high - low).max() > known:
            k = int(np.argmax(high - low))
            at = (low[k] + high[k]) / 2
            met = self.training.uncorrected(half_widths * np.exp(at)) <= 0
            low = np.where(met, np.clip(at, low, high), low)
            high = np.where(met, high, np.clip(at, low, high))
        return (low + high) / 2
