"""Bearing lives of the units of a result: first failures, loads, errors and phases of the duty; their section."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import rvjax
from rvjax import life, loaded
from rvjax._jax.programs import QUICK
from rvjax.commands.allocate import LIVES
from rvjax.population import Population, drawn, root_key
from rvjax.records import Design, PyTree, Record, field, record, text
from rvjax.render import Content, Figure, Note, Number, Section, Share, Table, Text
from rvjax.response import per_response
from rvjax.study import Kind, Study, kind_of
from rvjax.units import rpm

UNITS = 128
TURNED = 32  # of them, through a whole revolution of the output
LOW = 0.05  # share of the units: fewer are too few of so many
TORQUES = (0.5, 0.7, 1.0, 1.4, 2.0)  # times the largest of the duty
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
    ways: tuple[tuple[str, Any], ...] = text("arguments of the rating or the orders")

    def __call__(self, errors: PyTree, duty: PyTree) -> object:
        return life.rating(errors.stiffened(self.design), errors, duty, **dict(self.ways))


@record
class _Turned(_Rated):
    """Orders (discs, cranks, orders) of the forces of one unit under a torque, N."""

    def __call__(self, errors: PyTree, torque: PyTree) -> object:
        design = errors.stiffened(self.design)
        return life.force_orders(design, errors, output_torque=torque, **dict(self.ways)).amplitude


@per_response(options=QUICK)
def _of_units(unit: Callable[[PyTree, PyTree], PyTree], population: Population, z: jax.Array, load: object) -> PyTree:
    """Lives or orders of the units with random numbers z (numbers, units)."""
    return jax.vmap(lambda z: unit(population.errors(z), load), in_axes=-1)(z)


def _units_of(study: Study, tolerances: object) -> tuple[_Rated, _Turned, Population, life.Duty] | None:
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


def lives_if_any(study: Study, tolerances: object, *, units: int = UNITS) -> Lives | None:
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

    def lives(z: np.ndarray, duty: life.Duty) -> Values:
        return np.asarray(_of_units(unit, population, z, duty).life)

    def gain(z: np.ndarray) -> tuple[float, float]:
        changed = lives(z, duty)[fine]
        below = np.nanquantile(changed, LOW) - np.quantile(rated.life[fine], LOW)
        return float(np.nanmean(changed) - np.mean(rated.life[fine])), float(below)

    first = jax.vmap(lambda unit: life.first_failures(unit, study.design.bearings))(rated)
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


def _flat(arm: object, support: object) -> Values:
    """Values of all bearings of units (units, b), the arm bearings first."""
    parts = [np.asarray(part) for part in (arm, support) if part is not None]
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


ORDERS_SHOWN, ERRORS_SHOWN = 6, 8
HOUR = 3600.0
SPREAD = {"rv": {4: 5.3, 6: 2.7, 8: 2.2, 12: 1.5, 24: 0.5}}
"""By kind and number of angles: standard deviation of the life of a unit in %, rv-40e-whole, against 960 angles."""
LIMITS = (
    "The model is plane: it has no tilt of crank or disc (1 mrad costs a quarter of the life), no moment load, no "
    "axial force and no edge load, so the lives are optimistic. Lives of different methods differ in level: at the "
    "loads of a reducer the exponents 10/3 and 4 differ by a factor of 3.5. Ratings of the bearings are assumed unless "
    "measured."
)


def bearing_section(lives: Lives, study: Study) -> Section:
    """Bearings, orders of the force, errors, torque and phases.

    Args:
        lives: of units with the allocated tolerances.
        study: solved study.
    """
    low, median = np.quantile(lives.life, (LOW, 0.5)) / HOUR
    failed = f" {lives.failed} further units have no life." if lives.failed else ""
    about = (
        f"Method {lives.method}. {100 * lives.reliability:g} % of the bearings reach the rated life of their unit "
        f"under the loads of that unit. Quantiles are over units: of {len(lives.life):,} sample units with the "
        f"tolerances after, half have a rated life above {median:,.0f} h, and {100 - 100 * LOW:g} % above "
        f"{low:,.0f} h.{failed}"
    )
    shown = [name for name in LIVES if name in study.requirements]
    limit = float(study.requirements[shown[0]].lower)
    parts: list[Content] = [Note(about), _figure(lives), _bearings(lives), _orders(lives), _errors(lives)]
    parts.append(_against_torque(lives, limit if np.isfinite(limit) and shown[0] == "life" else None))
    if len(lives.duty) > 1:
        rows = list(zip(_phase_names(lives), _times(lives), lives.phases))
        columns = [Text("phase"), Share("time"), Share("damage")]
        parts += [_phase_figure(lives), Table("duty_phases", columns, rows)]
    return Section("Bearing life", (*parts, Note(f"{_angles(lives.samples, kind_of(study.design))} {LIMITS}")))


def _angles(samples: int, kind: Kind) -> str:
    """Error by the number of angles."""
    computed = f"Forces are computed at {samples} angles of a revolution of the output."
    if (measured := SPREAD.get(kind.word)) is None:
        return f"{computed} The effect of this number on the life of {kind.plural} is not measured."
    spread = measured[max(count for count in measured if count <= max(samples, min(measured)))]
    return (
        f"{computed} In the study rv-40e-whole so many "
        f"angles change the life of a unit by at most {spread:g} % (standard deviation over the units), and the mean "
        f"life by less than 0.1 %."
    )


def _size(title: str, unit: str, read_in: str, form: str = ",.0f") -> Number:
    return Number(title, form=form, unit=unit, read_in=read_in)


def _bearings(lives: Lives) -> Table:
    lives_of = ("life at the centre, h", "median unit, h", f"{100 * LOW:g} % of the units, h")
    columns = [Text("bearing"), Share("fails first"), *(_size(title, "s", "h") for title in lives_of)]
    columns.append(_size("equivalent load, N", "N", "N"))
    low, median = np.quantile(lives.each, (LOW, 0.5), axis=0)
    rows = list(zip(lives.bearings, lives.first, lives.centre, median, low, np.median(lives.load, axis=0)))
    note = "At the centre: every error at the centre of its limits. The equivalent load is that of the median unit."
    return Table("bearing_lives", columns, rows, note=note)


def _largest_orders(lives: Lives) -> list[int]:
    """Places of the largest orders of the units."""
    return [int(k) for k in np.argsort(-np.nan_to_num(lives.force[:, 1]), kind="stable")[:ORDERS_SHOWN]]


def _meaning(order: int, lives: Lives) -> str:
    if order == 0:
        return "fixed in the carrier"
    if order == lives.crank:
        return "turns with the crank"
    return "pins and teeth" if order % lives.pins == 0 else "errors of the parts"


def _orders(lives: Lives) -> Table:
    sizes = (_size(f"{of}, N", "N", "N") for of in ("at the centre", "rms of the units"))
    columns = [Number("order", form=".0f"), Text("load", wraps=True), *sizes]
    rows = [[int(lives.orders[k]), _meaning(int(lives.orders[k]), lives), *lives.force[k]]
            for k in _largest_orders(lives)]  # fmt: skip
    torque = float(np.max(np.abs(lives.duty[:, 0])))
    bearing = lives.bearings[lives.weakest]
    caption = f"Force on the bearing of {bearing} under {torque:.4g} N m, by order of the output revolution"
    return Table("bearing_orders", columns, rows, caption=caption)


def _errors(lives: Lives) -> Table:
    columns = [
        Text("error"),
        _size("mean life, h", "s", "h", "+,.0f"),
        _size(f"life of {100 * LOW:g} % of the units, h", "s", "h", "+,.0f"),
    ]
    largest = sorted(lives.held.items(), key=lambda item: -item[1][0])[:ERRORS_SHOWN]
    rows = [[name.replace("_", " "), *change] for name, change in largest]
    return Table("bearing_errors", columns, rows, caption="Life gained if an error is at the centre of its limits")


def _phase_names(lives: Lives) -> list[str]:
    def motion(speed: float) -> str:
        return f"{speed / rpm:.3g} r/min" if speed else "at rest"

    return [f"{k}: {torque:.4g} N m, {motion(speed)}" for k, (torque, speed, _) in enumerate(lives.duty)]


def _times(lives: Lives) -> np.ndarray:
    return lives.duty[:, 2] / lives.duty[:, 2].sum()


def _figure(lives: Lives) -> Figure:
    rows, first, weakest = _largest_orders(lives), int(np.argmax(lives.first)), lives.bearings[lives.weakest]
    names = [f"{int(lives.orders[k])}, {_meaning(int(lives.orders[k]), lives)}" for k in rows]
    loads = names, lives.force[rows]
    return Figure(
        "bearing_failures",
        f"Which bearing fails first: {lives.bearings[first]} with {100 * lives.first[first]:.0f} %; and its loads",
        lambda: rvjax.plotting.first_failures(lives.bearings, lives.first, *loads, weakest=weakest).axes[0],
    )


def _against_torque(lives: Lives, limit: float | None) -> Figure:
    curves, speed = (lives.torque, lives.of_torque), lives.speed
    speeds = tuple(speed * factor for factor in (1 / 3, 1, 4))
    return Figure(
        "life_torque",
        "Life of all rated bearings of a unit against a constant torque",
        lambda: rvjax.plotting.life_against_torque(*curves, low=LOW, speeds=speeds, speed=speed, limit=limit),
    )


def _phase_figure(lives: Lives) -> Figure:
    return Figure(
        "duty_phases",
        "Share of each phase of the duty in the time and in the damage",
        lambda: rvjax.plotting.phase_shares(_phase_names(lives), _times(lives), lives.phases),
    )
