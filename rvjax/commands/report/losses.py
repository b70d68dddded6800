"""Losses of the units of a result: by place under the conditions, and efficiency against torque and speed."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rvjax._jax.programs import QUICK
from rvjax.population import Population, drawn, root_key
from rvjax.records import Design, PyTree, Record, field, record, text
from rvjax.response import per_response
from rvjax.running import Turned, sign_of, turned
from rvjax.status import SUCCESS
from rvjax.study import Study

UNITS = 256
TORQUES = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.25, 1.5)  # times the torque of the conditions
SPEEDS = (1 / 3, 1.0, 4.0)  # times the speed of the conditions
BAND = (0.01, 0.5, 0.99)
OUTPUTS = (
    "efficiency",
    "backward_efficiency",
    "starting_torque",
    "no_load_torque",
    "back_driving_torque",
    "power_loss",
    "hysteresis",
)
Values = NDArray[np.float64]


@dataclass(frozen=True)
class UnitLosses:
    """Losses of sample units; torques at the output, N m. The first unit has its errors at the centre of their limits.

    Attributes:
        torque: sizes of the torques with which the input drives (t,), ascending; none if the conditions have none.
        given: torque of the conditions.
        speed: of the output, rad/s; 0 if the conditions have none.
        speeds: of the efficiencies (s,) rad/s.
        places: {place: part of the loss torque (units + 1, t)}, with "drag" at `speed`.
        under: {place: part of the loss torque under the torque of the conditions (units + 1,)}.
        viscous: rise of the drag with the speed (units + 1,) N m s/rad.
        failed: number of units without a value, which are excluded.
        samples: angles of a turn of the output.
    """

    torque: Values
    given: float
    speed: float
    speeds: Values
    places: dict[str, Values]
    under: dict[str, Values]
    viscous: Values
    failed: int
    samples: int

    @property
    def at(self) -> int:
        """Place of the size of the torque of the conditions."""
        return TORQUES.index(1.0)

    @property
    def loss(self) -> Values:
        """Loss torque at `speed` (units + 1, t) N m."""
        return np.sum(list(self.places.values()), axis=0)

    @property
    def proportion(self) -> Values:
        """L: loss torque without drag over the torque (units + 1, t)."""
        return (self.loss - self.places["drag"]) / self.torque

    @property
    def efficiency(self) -> Values:
        """With the input driving, at each speed (s, units + 1, t)."""
        faster = (np.abs(self.speeds) - abs(self.speed))[:, None, None] * self.viscous[:, None]
        return self.torque / (self.torque + self.loss + faster)


@record
class _Turned(Record):
    """Losses of one unit under several torques."""

    design: Design = field("-", "the reducer", kind="record")
    conditions: Any = text("of the study")
    torques: tuple[float, ...] = text("of the output, N m")

    def __call__(self, errors: PyTree) -> tuple[Turned, ...]:
        return turned(self.design, errors, self.conditions, self.torques)


@per_response(options=QUICK)
def _of_units(unit: _Turned, population: Population, z: jax.Array) -> tuple[Turned, ...]:
    """Losses of the units with random numbers z (numbers, units)."""
    return jax.vmap(lambda z: unit(population.errors(z)), in_axes=-1)(z)


def losses_if_any(study: Study, tolerances: PyTree, *, units: int = UNITS) -> UnitLosses | None:
    """The losses of a study that requires an output of friction; None for another study.

    Args:
        study: design and conditions.
        tolerances: of the units.
        units: number of sample units.

    Raises:
        ValueError: the unit without errors, or every other unit, has no losses.
    """
    if not any(name in study.requirements for name in OUTPUTS):
        return None
    given, population = study.conditions, Population.of(tolerances)
    size = sign_of(given) * abs(given.output_torque)
    torques = (*(size * share for share in TORQUES if size), given.output_torque)
    unit = _Turned(study.design, given, torques)
    z = np.asarray(drawn(population, root_key(study.seed + 4), jnp.uint32(0), count=units + 1)).copy()
    z[:, 0] = 0
    sets: tuple[Turned, ...] = jax.device_get(_of_units(unit, population, z))
    good = np.all([np.isin(one.status, [int(status) for status in SUCCESS]) for one in sets], axis=0)
    if not good[0] or not good[1:].any():
        raise ValueError(f"study {study.name}: {units + 1 - good.sum()} of {units + 1} units have no losses")
    every = {name: np.stack([one.places[name] for one in sets], axis=1)[good] for name in sets[0].places}
    every["drag"] = np.stack([one.drag for one in sets], axis=1)[good]
    speed = float(study.conditions.output_speed or 0.0)
    return UnitLosses(
        torque=np.abs(unit.torques[:-1]),
        given=unit.torques[-1],
        speed=speed,
        speeds=speed * np.asarray(SPEEDS) if speed else np.zeros(1),
        places={name: each[:, :-1] for name, each in every.items()},
        under={name: each[:, -1] for name, each in every.items()},
        viscous=np.asarray(sets[0].viscous)[good],
        failed=int(units + 1 - good.sum()),
        samples=study.conditions.running_samples,
    )


def quantiles(values: Values) -> Values:
    """Low, 50 % and high quantile over the units, the unit at the centre excluded.

    Args:
        values: (.., units + 1, t).
    """
    return np.quantile(values[..., 1:, :], BAND, axis=-2)
