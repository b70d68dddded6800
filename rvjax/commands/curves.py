"""Curves of units by one program for all commands and torques."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK
from rvjax._jax.sizes import AT_ONCE, calls
from rvjax.outputs import Curve, torque_condition
from rvjax.population import Population
from rvjax.records import Design, PyTree, Record, Scalar, field, record, text
from rvjax.response import per_response


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
