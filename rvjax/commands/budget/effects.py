"""Curves of units, and total effects of errors on their harmonics.

Units have one program for all commands and torques. For the effect of an error it is sampled again and the others are
kept (Jansen 1999).
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK
from rvjax._jax.sizes import AT_ONCE, calls
from rvjax.base.words import choose
from rvjax.errors import STAGES, described
from rvjax.outputs import Curve, torque_condition
from rvjax.population import Population
from rvjax.records import Design, PyTree, Record, Scalar, field, record, text
from rvjax.response import per_response
from rvjax.study import Study


@record
class _Drawn(Record):
    """errors -> angles and curve of one unit."""

    design: Design = field("-", "the reducer", kind="record")
    torque: Scalar | None = field("N m", "None: that of the conditions")
    conditions: object = text("how the reducer runs")
    condition: str = text("name of the torque")
    evaluate: Callable[..., tuple[jax.Array, jax.Array]] = text("of a model")

    def __call__(self, errors: PyTree) -> tuple[jax.Array, jax.Array]:
        """Angles and values (n,)."""
        given = self.conditions
        if self.torque is not None:
            given = dataclasses.replace(given, **{self.condition: self.torque})  # type: ignore[type-var]
        angle, values = self.evaluate(self.design, errors, given)
        return jnp.asarray(angle), values


def curves_of(
    curve: Curve, design: Design, conditions: object, population: Population, z: np.ndarray, torque: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) and curves (units, n) of units with random numbers z (numbers, units).

    Args:
        curve: of a model.
        design: the reducer.
        conditions: how it runs.
        population: of the units.
        z: their random numbers.
        torque: other than that of the conditions, N m.
    """
    unit, count, found = _unit(curve, design, conditions, torque), z.shape[1], list[np.ndarray]()
    for lanes in calls(count, AT_ONCE):
        angles, values = _curves(unit, population, jnp.asarray(z[:, lanes]))
        found.append(np.asarray(values))
    return np.asarray(angles)[0], np.concatenate(found)[:count]


def _unit(curve: Curve, design: Design, conditions: object, torque: float | None) -> _Drawn:
    name = torque_condition(conditions)
    torque = getattr(conditions, name, None) if torque is None else torque
    if not torque:  # no effects of a load are traced
        return _Drawn(design, None, conditions, name, curve.evaluate)
    return _Drawn(design, float(torque), dataclasses.replace(conditions, **{name: 0.0}), name, curve.evaluate)  # type: ignore[type-var]


@per_response(options=QUICK)
def _curves(
    unit: Callable[..., tuple[jax.Array, jax.Array]], population: Population, z: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Angles and curves (units, n)."""
    return jax.vmap(lambda z: unit(population.errors(z)), in_axes=-1)(z)


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
    for error, values in variance.items():
        own = part[error] or "other"
        name = {"field": error, "part": own, "stage": STAGES.get(own, "other")}[level]
        sums[name] = sums[name] + values if name in sums else values
    return dict(
        sorted(sums.items(), key=lambda item: -float(np.sum(np.asarray(item[1])[1:] if np.ndim(item[1]) else item[1])))
    )
