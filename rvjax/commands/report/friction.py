"""Friction of units with the allocated tolerances: losses, and their section of the page by place and coefficients."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import rvjax
from rvjax import models
from rvjax._jax.programs import QUICK
from rvjax.population import Population, drawn, root_key
from rvjax.records import PyTree, Record, field, record, text
from rvjax.render import Content, Figure, Note, Number, Section, Share, Table, Text, Titled
from rvjax.response import per_response
from rvjax.running import SHARES, Turned, sign_of, turned
from rvjax.status import SUCCESS
from rvjax.study import Study, comments, is_assumed, shown
from rvjax.units import rpm

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

    design: PyTree = field("-", "the reducer", kind="record")
    conditions: Any = text("of the study")
    torques: tuple[float, ...] = text("of the output, N m")

    def __call__(self, errors: object) -> tuple[Turned, ...]:
        return turned(self.design, errors, self.conditions, self.torques)


@per_response(options=QUICK)
def _of_units(unit: _Turned, population: Population, z: jax.Array) -> tuple[Turned, ...]:
    """Losses of the units with random numbers z (numbers, units)."""
    return jax.vmap(lambda z: unit(population.errors(z)), in_axes=-1)(z)


def losses_if_any(study: Study, tolerances: object, *, units: int = UNITS) -> UnitLosses | None:
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


FIRST_ORDER = 0.33  # error of the loss torque over L^2 and the torque, docs/models/running.md
LARGE = 0.25  # L from which on first order is too coarse
FAR = 0.5  # L up to which the error is known, docs/models/running.md
USUAL = {
    "ring_pins": "0.03 to 0.10",
    "output_pins": "0.03 to 0.10",
    "arm_bearings": "0.002 to 0.0025 (needles) times bore/pitch diameter",
    "support_bearings": "0.0011 to 0.0018 (cylindrical, tapered) times bore/pitch diameter",
    "gear_meshes": "0.005 to 0.015",
}


def friction_section(losses: UnitLosses, study: Study) -> Section:
    """Shares, efficiency, coefficients, and what is not modelled.

    Args:
        losses: of units with the allocated tolerances.
        study: solved study.
    """
    name = next(name for name in OUTPUTS if name in study.requirements)
    unknown = models.kind(study.design).described[name].unknown
    parts: list[Content] = [Note(_about(losses)), _places(losses)]
    if losses.given:
        parts += [Note("\n".join(_order(losses))), _figure(losses), _efficiencies(losses)]
    parts += [_coefficients(study), Note(f"Not modelled: {unknown}.")]
    return Section("Friction and efficiency", tuple(parts))


def _about(losses: UnitLosses) -> str:
    units = len(losses.viscous) - 1
    failed = f" {losses.failed} further units have no value." if losses.failed else ""
    return (
        f"Losses of {units:,} sample units with the tolerances after, means over {losses.samples} angles of a turn of "
        f"the output.{failed} Torques are those at the output."
    )


def _state(losses: UnitLosses) -> str:
    """Torque and speed of the conditions."""
    torque = f"{losses.given:.4g} N m"
    return f"{torque}, {losses.speed / rpm:.4g} r/min" if losses.speed else f"{torque}, at rest"


def _places(losses: UnitLosses) -> Table:
    """Loss torque by place, of the unit at the centre and of the mean unit."""
    largest = sorted(losses.under.items(), key=lambda item: -float(np.mean(item[1][1:])))
    found = {name: each for name, each in largest if np.any(each)}
    total = sum(found.values(), np.zeros(len(losses.viscous)))
    mean = float(np.mean(total[1:]))
    rows = []
    for name, each in (found | {"sum": total}).items():
        own = float(np.mean(each[1:]))
        rows.append([name.replace("_", " "), float(each[0]), own, own / mean if mean else None])
    columns = [
        Text("place"),
        Number("errors at the centre, N m", unit="N m"),
        Number("mean of the units, N m", unit="N m"),
        Share("share"),
    ]
    caption = f"Loss torque by place, {_state(losses)}"
    note = "At the centre: every error at the centre of its limits. Share: of the mean of the units."
    return Table("loss_places", columns, rows, caption=caption, note=note, total=True)


def _order(losses: UnitLosses) -> Iterator[str]:
    """Error of first order, and a warning where it is large."""
    part = np.median(losses.proportion[1:], axis=0)
    at, torque = float(part[losses.at]), losses.torque
    efficiency = float(np.median(losses.efficiency[len(losses.speeds) // 2, 1:, losses.at]))
    error = 100 * efficiency**2 * FIRST_ORDER * at**2
    yield (
        f"Efficiencies are of first order in the friction. The error is {FIRST_ORDER:g} L² of the torque, with L = "
        f"loss torque without drag over torque; the true efficiency is lower. At {torque[losses.at]:.4g} N m "
        f"L = {at:.2g} in the median unit: {error:.2g} percentage points."
    )
    if np.any(part > LARGE):
        most = float(np.max(torque[part > LARGE]))
        yield (
            f"warning: L is above {LARGE:g} at {most:.4g} N m and below (median unit); the error of the loss there is "
            f"more than {100 * FIRST_ORDER * LARGE**2:.1g} % of the torque"
        )


def _efficiencies(losses: UnitLosses) -> Table:
    """Efficiency at each torque and speed, and L."""
    low, median, high = quantiles(losses.efficiency)
    part = np.median(losses.proportion[1:], axis=0)
    columns = [Number("torque, N m", unit="N m"), *(Text(_speed(speed)) for speed in losses.speeds)]
    columns += [Number("L", form=".2g"), Number("first-order error, % of the torque", form=".2g")]
    rows = [
        [
            float(torque),
            *(f"{100 * median[s, k]:.1f} [{100 * low[s, k]:.1f}, {100 * high[s, k]:.1f}]" for s in range(len(low))),
            float(part[k]),
            float(100 * FIRST_ORDER * part[k] ** 2) if part[k] <= FAR else None,
        ]
        for k, torque in enumerate(losses.torque)
    ]
    caption = "Efficiency in %: median of the units [1 %, 99 % of the units]"
    note = f"L of the median unit. Above {FAR:g} first order does not hold."
    return Table("efficiencies", columns, rows, caption=caption, note=note)


def _speed(speed: float) -> str:
    return f"{abs(speed) / rpm:.4g} r/min" if speed else "at rest"


def _coefficients(study: Study) -> Table:
    """Every coefficient with its source."""
    said = {path.partition(".")[2]: word for path, word in comments(study.text).items() if path.startswith("friction.")}
    rows = []
    for number in study.numbers:
        part, _, name = number.path.partition(".")
        if part != "friction":
            continue
        source = said.get(name, "")
        if number.origin == "default":
            source = "default"
        elif not source or is_assumed(source) or number.assumed:
            usual = f" (usual: {USUAL[name]}, assumed)" if name in USUAL else ""
            source = (source if source and is_assumed(source) else "assumed") + usual
        value = f"{float(number.value):.4g}" if number.unit == "-" else shown(number.value, number.unit)
        rows.append([Titled(name.replace("_", " "), number.meaning), value, _spread(study, name), source])
    columns = [Text("coefficient"), Text("value"), Text("spread of units"), Text("source", wraps=True)]
    return Table("friction", columns, rows, caption="Friction of the study")


def _spread(study: Study, name: str) -> str:
    """Limits of the share by which a coefficient differs between units."""
    tolerance = getattr(study.tolerances, SHARES.get(name, ""), None)
    if tolerance is None:
        return "all equal"
    return f"{100 * float(tolerance.lower):+.3g} to {100 * float(tolerance.upper):+.3g} %"


def _figure(losses: UnitLosses) -> Figure:
    curves, speeds = (losses.torque, quantiles(losses.efficiency)), np.abs(losses.speeds)
    return Figure(
        "efficiency_torque",
        "Efficiency of the units against torque and speed",
        lambda: rvjax.plotting.efficiency_against_torque(*curves, speeds=speeds, rated=losses.at),
    )
