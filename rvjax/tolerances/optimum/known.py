"""Units at one set of tolerances: values that are solved or predicted, and how far another set is away."""

from dataclasses import dataclass

import numpy as np
from scipy import special

from rvjax.population import Population
from rvjax.status import succeeded, worst


@dataclass(frozen=True)
class Known:
    """All units at one set of tolerances: `doubt` is the standard deviation of a predicted value, 0 of a solved one.

    `seen` is the latest set at which units of each part were solved.
    """

    population: Population
    place: np.ndarray
    values: dict[str, np.ndarray]
    doubt: dict[str, np.ndarray]
    status: list[np.ndarray]
    seen: list[np.ndarray]


def wrong_sides(values: np.ndarray, doubt: np.ndarray, levels: list[float]) -> np.ndarray:
    """Probability (n,) that a unit lies on the other side of one of the levels than its value.

    Args:
        values: (n,) of the units.
        doubt: (n,) their standard deviations.
        levels: at which units decide.
    """
    found = np.zeros(len(values))
    for level in levels:
        off = np.abs(values - level)
        ratio = np.divide(off, doubt, out=np.full(len(values), np.inf), where=(doubt > 0) & np.isfinite(off))
        found = np.maximum(found, special.ndtr(-ratio))
    return found


def whole(values: dict[str, np.ndarray], status: list[np.ndarray]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Values, nan where any part of a unit failed, and its worst status.

    Args:
        values: (n,) by name.
        status: (n,) of each part.
    """
    found = np.asarray(worst(np.stack(status), axis=0))
    good = succeeded(np.asarray(found))
    return {name: np.where(good, row, np.nan) for name, row in values.items()}, found


def place_of(population: Population) -> np.ndarray:
    """Lower and upper limit (fields, 2) of the tolerances; a number of the design as limits of 10 %."""
    limits = [(float(t.lower), float(t.upper)) for t in population.active.values()]
    return np.array(limits + [(0.9 * float(v), 1.1 * float(v)) for v in (population.values or {}).values()])


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Largest change of a limit, in parts of the larger half-width.

    Args:
        one: limits (fields, 2).
        other: likewise.
    """
    half = np.maximum(one[:, 1] - one[:, 0], other[:, 1] - other[:, 0]) / 2
    moved = np.abs(one - other).max(axis=1)
    return float(np.max(moved / np.where(half > 0, half, 1.0), initial=0.0))
