"""Common parts of the models of the census: random and invalid inputs, and the interface of a model."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Case = dict[str, Any]
REAL = np.longdouble  # of the reference computations


class Model(NamedTuple):
    """One model with its static options; `run` gives values, status, residual and the scale of the values."""

    group: str  # models of one group share the number of inputs
    name: str
    draw: Callable[[Any, int], Case]
    run: Callable[[Case], dict[str, Any]]
    judge: Callable[[Case, Any], tuple[np.ndarray, np.ndarray]]  # status due (-1: not known), error over scale
    step: Callable[[str, Any], Any]  # size of a change of an input that matters
    ordinary: Callable[[Case], Any]  # where derivatives are compared and float32 is promised a bound
    judged: float = 1.0  # share of the inputs that the independent computation sees
    faint: float = 0.0  # values below this share of the scale are too small for differences of larger values
    sound: Callable[[Case], Any] = lambda case: moderate(case)  # where the residual has a bound


def decades(rng: Any, size: Any, low: float, high: float) -> np.ndarray:
    """Positive numbers, even in their logarithm."""
    return 10 ** rng.uniform(low, high, size)


def deviations(rng: Any, shape: tuple[int, ...], part: np.ndarray) -> np.ndarray:
    """Errors from nothing to the size of the part; some are exactly zero, some exactly equal to the part."""
    lanes = (shape[0],) + (1,) * (len(shape) - 1)
    size = part.reshape(lanes) * decades(rng, lanes, -12, 0) * (rng.uniform(size=lanes) > 0.1)
    value = size * rng.uniform(-1, 1, shape) * (rng.uniform(size=shape) > 0.2)
    return np.where(rng.uniform(size=shape) < 0.002, -part.reshape(lanes), value)


def spoiled(case: Case, rng: Any, share: float = 0.03) -> Case:
    """Replace one number in a few batch elements by NaN, infinity or a value far outside the domain."""
    names, lanes = list(case), len(next(iter(case.values())))
    for lane in np.flatnonzero(rng.uniform(size=lanes) < share):
        value = case[names[rng.integers(len(names))]][lane : lane + 1].reshape(-1)
        bad = (np.nan, np.inf, -np.inf, 0.0, -1.0, -abs(value[0]), 1e300, 1e-300, 1e30, -1e30, 1e-30)
        value[rng.integers(len(value))] = bad[rng.integers(len(bad))]
    return case


def nonfinite(case: Case) -> np.ndarray:
    return np.any([~np.isfinite(v.reshape(len(v), -1)).all(1) for v in case.values()], axis=0)


def moderate(case: Case, top: float = 1e12) -> np.ndarray:
    """Batch elements whose squares and products do not overflow."""
    return np.all([(np.abs(v.reshape(len(v), -1)) < top).all(1) for v in case.values()], axis=0)


def relative_step(name: str, value: Any) -> Any:
    """A thousandth of the number itself; zeros stay zero: no torque is where a model jumps."""
    return 1e-3 * np.abs(value)
