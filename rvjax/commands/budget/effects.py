"""Total effects of errors on the harmonics of units, one error sampled again and the others kept (Jansen 1999)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from rvjax._jax.sizes import AT_ONCE
from rvjax.base.words import choose
from rvjax.errors import STAGES, described
from rvjax.population import Population
from rvjax.study import Study

FEWEST, MOST = 16, 2**16
LEVELS = ("field", "part", "stage")
Solve = Callable[[np.ndarray], np.ndarray]  # random numbers of units -> their waves
V = TypeVar("V", float, np.ndarray)


@dataclass(frozen=True)
class Load:
    """Results of one load, fields as in `Budget`."""

    variance: dict[str, np.ndarray]
    error: dict[str, float]
    total: np.ndarray
    together: tuple[float, float]
    alike: np.ndarray
    failed: int


def of_load(
    solve: Solve, draw: Callable[..., np.ndarray], population: Population, samples: int, block: int = AT_ONCE
) -> Load:
    """Variances by error from units, of which each error is sampled again.

    Args:
        solve: random numbers of units -> their waves (units, k); NaN of a failed unit.
        draw: (first unit, count=) -> random numbers.
        population: of the units.
        samples: number of units.
        block: units at once.

    Raises:
        ValueError: no unit can be solved.
    """
    one, other, changed = _solved(solve, draw, population, samples, block)
    good = np.isfinite(one).all(1) & np.isfinite(other).all(1)
    for values in changed.values():
        good &= np.isfinite(values).all(1)
    if not good.any():
        raise ValueError(f"none of {samples} units can be solved")
    one, other, count = one[good], other[good], int(good.sum())
    waves = squares(one.shape[1])
    moved = {field: values[good] - one for field, values in changed.items()}
    square = {field: 0.5 * waves * np.abs(values) ** 2 for field, values in moved.items()}
    mean = one.sum(0) / count
    total = waves * (np.abs(one - mean) ** 2).sum(0) / max(1, count - 1)
    rest = 0.25 * (waves * np.abs(other - one - sum(moved.values())) ** 2)[:, 1:].sum(1)
    whole = total[1:].sum()
    share, spread = (float(x / whole) if whole > 0 else 0.0 for x in (rest.sum() / count, rest.std() / np.sqrt(count)))
    return Load(
        variance={field: values.sum(0) / count for field, values in square.items()},
        error={field: float(v[:, 1:].sum(1).std() / np.sqrt(count)) for field, v in square.items()},
        total=total,
        together=(share, spread),
        alike=waves * np.abs(mean) ** 2,
        failed=int(samples - good.sum()),
    )


def squares(count: int) -> np.ndarray:
    """Mean squares (count,) of waves of amplitude 1; the first is a constant.

    Args:
        count: of the waves.
    """
    return np.where(np.arange(count) > 0, 0.5, 1.0)


def _solved(
    solve: Solve, draw: Callable[..., np.ndarray], population: Population, samples: int, block: int
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Waves (units, k) of units, of other units, and of the first with one error of the others, by that error."""
    block = min(block, samples)
    parts: list[list[np.ndarray]] = []
    for first in range(0, samples, block):
        own, new = (draw(first + start, count=block) for start in (0, samples))
        batches = [own, new, *(mixed for _, mixed in population.exchanged(own, new))]
        parts.append([solve(batch)[: samples - first] for batch in batches])
    one, another, *changed = (np.concatenate(values) for values in zip(*parts))
    return one, another, dict(zip(population.active, changed))


def parts_of(study: Study, population: Population) -> dict[str, str]:
    """Part of the reducer by error that varies; "" for an error of none."""
    part = described(study.design.error_record, "part")
    return {field: part.get(field, "") for field in population.active}


def by_level(level: str, variance: dict[str, V], part: dict[str, str]) -> dict[str, V]:
    """Variances of errors, or summed over those of a part or stage, the largest first without the mean of a curve.

    Args:
        level: "field", "part" or "stage".
        variance: by error; a number, or an array by order.
        part: of each error.

    Raises:
        ValueError: another level.
    """
    choose("level", level, LEVELS)
    sums: dict[str, V] = {}
    for field, values in variance.items():
        own = part[field] or "other"
        name = {"field": field, "part": own, "stage": STAGES.get(own, "other")}[level]
        sums[name] = sums[name] + values if name in sums else values
    return dict(
        sorted(sums.items(), key=lambda item: -float(np.sum(np.asarray(item[1])[1:] if np.ndim(item[1]) else item[1])))
    )
