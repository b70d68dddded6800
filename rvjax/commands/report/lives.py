"""Bearing lives of the units of a result: which bearing fails first, by which load, error and phase of the duty."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rvjax import life, loaded
from rvjax._jax.programs import QUICK
from rvjax.population import Population, drawn, root_key
from rvjax.records import Design, PyTree, Record, field, record, text
from rvjax.response import per_response
from rvjax.study import Study

UNITS = 128
TURNED = 32  # of them, through a whole revolution of the output
LOW = 0.05  # share of the units: fewer are too few of so many
TORQUES = (0.5, 0.7, 1.0, 1.4, 2.0)  # times the largest of the duty
LIVES = ("life", "arm_bearing_life")
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Lives:
    """Bearing lives of sample units with given tolerances, under the duty; lives in seconds of its cycle.

    Attributes:
        method: of the lives, which sets their level.
        samples: angles of a revolution of the output at which forces are computed.
        reliability: share of the bearings, under the loads of one unit, that reach its life.
        life: of all bearings of each unit (units,); units without a life are excluded.
        failed: number of units without a life.
        bearings: names; the arm bearings come first.
        centre: life of each bearing with all errors at the centre of their limits (b,).
        each: life of each bearing (units, b).
        load: equivalent load of each bearing (units, b) N.
        first: probability that a bearing is the first to fail, mean over the units (b,); sums to 1.
        held: {error: change of the mean life and of its low quantile if this error is at the centre of its limits}.
        duty: torque N m, speed rad/s and time s of each phase (p, 3).
        phases: share of each phase in the damage, mean over the units (p,).
        torque: constant torques (t,) N m.
        speed: of the output at them, rad/s.
        of_torque: life with errors at the centre; low, 50 % and high quantile over the units, at each torque (t, 4).
        orders: of the output revolution in the force of the arm bearing that fails first most often (k,).
        force: amplitude at the centre, and root mean square over the units, of each order (k, 2) N.
        pins: of the ring; the cranks turn as often in a revolution of the output.
        crank: order that turns with the crank.
    """

    method: str
    samples: int
    reliability: float
    life: Values
    failed: int
    bearings: tuple[str, ...]
    centre: Values
    each: Values
    load: Values
    first: Values
    held: dict[str, tuple[float, float]]
    duty: Values
    phases: Values
    torque: Values
    speed: float
    of_torque: Values
    orders: NDArray[np.int64]
    force: Values
    pins: int
    crank: int

    @property
    def weakest(self) -> int:
        """Place of the arm bearing that fails first most often."""
        arms = [name.startswith("disc") for name in self.bearings]
        return int(np.argmax(np.where(arms, self.first, -1)))


@record
class _Rated(Record):
    """Lives of the crank bearings of one unit under a duty."""

    design: Design = field("-", "the reducer", kind="record")
    ways: tuple[tuple[str, Any], ...] = text("arguments of the rating")

    def __call__(self, errors: PyTree, duty: PyTree) -> PyTree:
        return life.rating(errors.stiffened(self.design), errors, duty, **dict(self.ways))


@record
class _Turned(Record):
    """Orders (discs, cranks, orders) of the forces of one unit under a torque, N."""

    design: Design = field("-", "the reducer", kind="record")
    ways: tuple[tuple[str, Any], ...] = text("arguments of the orders")

    def __call__(self, errors: PyTree, torque: PyTree) -> PyTree:
        design = errors.stiffened(self.design)
        return life.force_orders(design, errors, output_torque=torque, **dict(self.ways)).amplitude


@per_response(options=QUICK)
def _of_units(unit: Callable[[PyTree, PyTree], PyTree], population: Population, z: jax.Array, load: PyTree) -> PyTree:
    """Lives or orders of the units with random numbers z (numbers, units)."""
    return jax.vmap(lambda z: unit(population.errors(z), load), in_axes=-1)(z)


def _units_of(study: Study, tolerances: PyTree) -> tuple[_Rated, _Turned, Population, life.Duty] | None:
    """Arguments of the programs; None where the study requires no life."""
    if not any(name in study.requirements for name in LIVES):
        return None
    given = study.conditions
    supports = loaded.ways(given)
    samples = given.life_samples or given.samples
    ways = dict(samples=samples, method=given.life_method, reliability=given.reliability) | supports
    orders = dict(samples=8 * study.design.counts["pins"]) | supports
    return (
        _Rated(study.design, tuple(ways.items())),
        _Turned(study.design, tuple(orders.items())),
        Population.of(tolerances),
        life.Duty(*np.asarray(given.duty, float).T),
    )


def lives_if_any(study: Study, tolerances: PyTree, *, units: int = UNITS) -> Lives | None:
    """The bearing lives of a study that requires one; None for another study.

    Args:
        study: design, conditions and duty.
        tolerances: of the units.
        units: number of sample units.

    Raises:
        ValueError: no unit has a life.
    """
    if (asked := _units_of(study, tolerances)) is None:
        return None
    unit, turned, population, duty = asked
    given, pins, torque = study.conditions, unit.design.counts["pins"], float(np.max(np.abs(duty.output_torque)))

    # The first unit has every error at the centre of its limits; the others are random.
    z = np.asarray(drawn(population, root_key(study.seed + 3), jnp.uint32(0), count=units + 1)).copy()
    z[:, 0] = 0
    rated = jax.device_get(_of_units(unit, population, z, duty))
    fine = np.isfinite(rated.life) & (np.arange(units + 1) > 0)
    if not fine.any():
        raise ValueError(f"study {study.name}: none of {units} units has a bearing life")

    def lives(z: PyTree, duty: life.Duty) -> Values:
        return np.asarray(_of_units(unit, population, z, duty).life)

    def gain(z: PyTree) -> tuple[float, float]:
        changed = lives(z, duty)[fine]
        below = np.nanquantile(changed, LOW) - np.quantile(rated.life[fine], LOW)
        return float(np.nanmean(changed) - np.mean(rated.life[fine])), float(below)

    first = jax.vmap(life.first_failures)(rated)
    speed, phases = float(np.max(np.abs(duty.output_speed))), len(duty.time)
    curve = []
    for factor in TORQUES:
        found = lives(z, life.Duty(*(np.full(phases, x) for x in (factor * torque, speed, 1.0))))
        curve.append([found[0], *np.nanquantile(found[fine], (LOW, 0.5, 1 - LOW))])
    share = _flat(first.arm, first.support)[fine].mean(axis=0)
    discs, cranks = rated.arm.shape[1:]
    waves = _of_units(turned, population, z[:, : min(units, TURNED) + 1], torque)
    wave = np.abs(np.asarray(waves)).reshape(-1, discs * cranks, 8 * pins)
    wave = wave[:, int(np.argmax(share[: discs * cranks]))]
    return Lives(
        method=given.life_method,
        samples=dict(unit.ways)["samples"],
        reliability=given.reliability,
        life=rated.life[fine],
        failed=int(units - fine.sum()),
        bearings=_names(discs, cranks, rated.support is not None),
        centre=_flat(rated.arm, rated.support)[0],
        each=_flat(rated.arm, rated.support)[fine],
        load=_flat(rated.arm_load, rated.support_load)[fine],
        first=share,
        held={name: gain(own) for name, own in population.exchanged(z, np.zeros_like(z))},
        duty=np.asarray(given.duty, float),
        phases=np.ones(1) if phases == 1 else life.phase_shares(lambda d: lives(z, d)[fine], duty).mean(axis=1),
        torque=torque * np.asarray(TORQUES),
        speed=speed,
        of_torque=np.asarray(curve),
        orders=np.rint(np.fft.fftfreq(8 * pins, 1 / (8 * pins))).astype(int),
        force=np.stack([wave[0], np.sqrt(np.nanmean(wave[1:] ** 2, axis=0))], axis=1),
        pins=pins,
        crank=life.crank_order(unit.design),
    )


def _names(discs: int, cranks: int, supports: bool) -> tuple[str, ...]:
    if cranks == 1 and not supports:
        return tuple(f"disc {disc}" for disc in range(discs))
    names = [f"disc {disc}, crank {crank}" for disc in range(discs) for crank in range(cranks)]
    names += [f"support {side}, crank {crank}" for crank in range(cranks) for side in range(2)] if supports else []
    return tuple(names)


def _flat(arm: PyTree, support: PyTree) -> Values:
    """Values of all bearings of units (units, b), the arm bearings first."""
    parts = [np.asarray(part) for part in (arm, support) if part is not None]
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
