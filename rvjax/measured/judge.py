"""Evaluation of a measured curve: its contents, and the error without drift, lines and bad readings."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rvjax.measured.atoms import Atom, Model
from rvjax.measured.run import Run
from rvjax.measured.sampling import STRAIGHT, Sampling, legs, places, repetition, without_spikes
from rvjax.measured.search import content
from rvjax.units import arcsec, deg

FASTEST = 12
"""Highest harmonic of the fastest part that is expected: torque of a motor with poles and slots."""
MOTOR = ("sun", "sun against the carrier", "shaft", "shaft against the output")
"""Names of the orders of the part that a motor turns; the fastest part where none of them is given."""
LOST = 4.0  # standard deviations of a reading: a larger step is a lost step, not noise
BAD, FEW = 0.01, 2  # share, or number, of bad readings that are left out
DRIFTS = ("drift", "warm-up", "step")
HOLE = 10.0  # steps: a larger gap in the revolution is no uneven step
FEWEST = 12  # readings of a search


@dataclass(frozen=True, eq=False)
class Judged:
    """A curve and its contents.

    Attributes:
        run: as measured.
        angle: of the places that are used, ascending, rad (n,).
        error: of the places, without drift and lines, rad (n,).
        taken: what was taken off the error, rad (n,).
        sampling: of the angles.
        model: contents that were found.
        parts: {name: order} of what the measured object can cause.
        rows: line of the file of each place of the model.
    """

    run: Run
    angle: np.ndarray
    error: np.ndarray
    taken: np.ndarray
    sampling: Sampling
    model: Model
    parts: Mapping[str, float]
    rows: np.ndarray

    def found(self, *kinds: str) -> list[Atom]:
        """Contents of some kinds."""
        return [atom for atom in self.model.atoms if atom.kind in kinds]

    @property
    def noise(self) -> float:
        """Standard deviation of a place about the contents, rad."""
        model = self.model
        freedom = max(len(model.angle) - model.basis.shape[1], 1)
        return math.sqrt(float(model.residual @ model.residual) / freedom)

    @property
    def driven(self) -> tuple[float, ...]:
        """Orders of the part that a motor turns, against the housing and against the output."""
        return _driven(self.parts, 0.0)

    def hidden(self, order: float) -> dict[str, float]:
        """Parts whose order is the same numbers at these angles.

        Args:
            order: per revolution.
        """
        return {name: own for name, own in self.parts.items() if self.sampling.alike(own, order)}

    def looks_like(self, order: float) -> float:
        """Lowest order that has the same numbers at these angles.

        Args:
            order: per revolution.
        """
        repeat = self.sampling.repeat
        return abs(order - repeat * round(order / repeat)) if math.isfinite(repeat) else order


def judge(run: Run, parts: Mapping[str, float]) -> Judged:
    """Evaluate a curve.

    Args:
        run: one pass of the angle.
        parts: {name: order per revolution, a whole number or not} of what the measured object can cause.

    Raises:
        ValueError: the angle turns back, or the error jumps.
    """
    return _judged(run, tuple(parts.items()))


@functools.lru_cache(maxsize=128)
def _judged(run: Run, own: tuple[tuple[str, float], ...]) -> Judged:
    angle, error, parts = run.angle, run.error, dict(own)
    rows = np.arange(len(angle)) if run.rows is None else run.rows
    if len(passes := legs(angle)) > 1:
        row = rows[passes[1].start]
        raise ValueError(f"{run.name}: the angle turns back at row {row}; a run goes one way, add a column direction")
    path = without_spikes(angle)
    timed = float(np.ptp(path)) >= STRAIGHT * float(np.sum(np.abs(np.diff(path)))) if len(path) else False
    angle = angle if timed else angle % (2 * math.pi)
    rank = np.argsort(angle, kind="stable")
    readings, (angle, error, place) = len(angle), places(angle[rank], error[rank])
    rows = rows[rank][np.unique(place, return_index=True)[1]] if len(place) else rows
    sampling = _sampling(angle, readings, parts)
    model = Model(angle, error, [])
    if len(angle) >= FEWEST and np.ptp(error) > 0 and np.ptp(angle) > 0:
        model = content(angle, error, sampling, parts, highest(parts), timed)
    bad = [int(atom.at) for atom in model.atoms if atom.kind == "glitch"]
    if len(bad) > max(FEW, BAD * len(angle)):  # heavy tails are noise
        bad = []
    made = Judged(run, angle, error, np.zeros(len(angle)), sampling, model, parts, rows)
    _check_steps(made)
    drift = model.curve(made.found(*DRIFTS))
    taken = drift - np.mean(drift) + model.curve(made.found("line"))
    kept = np.delete(np.arange(len(angle)), bad)
    if not bad and not made.found("line", *DRIFTS):
        return made
    return Judged(run, angle[kept], (error - taken)[kept], taken[kept], sampling, model, parts, rows)


def _driven(parts: Mapping[str, float], default: float) -> tuple[float, ...]:
    fastest = max(parts.values(), default=default)
    return tuple(parts[name] for name in MOTOR if name in parts) or (fastest, fastest - 1)


def highest(parts: Mapping[str, float]) -> float:
    """Highest order that is searched.

    Args:
        parts: {name: order per revolution} of what the measured object can cause.
    """
    return max([FASTEST * max(_driven(parts, 100.0)), *parts.values()])


def _sampling(angle: np.ndarray, readings: int, parts: Mapping[str, float]) -> Sampling:
    steps = np.diff(angle)
    step = float(np.median(steps)) if len(steps) else 0.0
    stroke = float(np.ptp(angle)) + step if len(angle) else 0.0
    gap = 2 * math.pi - float(np.ptp(angle)) if len(angle) else math.inf
    if len(steps) and gap < 5 * float(np.mean(steps)):  # uneven places all round
        stroke = max(stroke, 2 * math.pi)
    top = max(parts.values(), default=100.0)
    around = np.sort(angle % (2 * math.pi))
    gaps = np.diff(around, append=around[0] + 2 * math.pi) if len(angle) else np.zeros(1)
    hole = float(np.max(gaps))
    hole = hole if hole > HOLE * max(float(np.mean(gaps)), step) else 0.0
    return Sampling(len(angle), readings, stroke, step, hole, repetition(angle, highest(parts) + 3 * top))


def _check_steps(found: Judged) -> None:
    """Raise ValueError for a lost step."""
    for atom in found.found("step"):
        size = float(found.model.size(atom)[0][0])
        if abs(size) > LOST * found.noise:
            at = found.angle[int(atom.at)] / deg
            gap = f"jumps by {size / arcsec:.3g} arcsec at {at:.5g} deg (row {found.rows[int(atom.at)]})"
            raise ValueError(f"{found.run.name}: the error {gap}: a lost step; measure again")
