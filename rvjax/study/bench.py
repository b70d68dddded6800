"""Predicted measurements of a unit: orders of runs, a hysteresis curve or frequencies, from the values of a prior.

The values are one flat dict: errors of the study by field, unknown numbers of the design, nuisances of the bench.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax.choices import unknown
from rvjax.errors import described, read_by
from rvjax.outputs import Observation
from rvjax.records import Array, Design, PyTree, Record, Scalar, field, record, text
from rvjax.study.measured import Conditions
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Values = Mapping[str, PyTree]
Seen = dict[str, PyTree]
Model = Callable[[Values], Seen]

WIDE = 3000 * arcsec
NUISANCES: dict[str, str] = {
    "offset": "zero of the angle readings, one for all runs; with it the means of the runs count",
    "mounting": "eccentricity of the encoders, [cosine, sine] of order 1; with it order 1 counts",
    "phase": "angle of the index mark, where there is none",
    "reading": "motion of a head against the scale under load: oval ring, tilt, dent, each [cosine, sine] of the head",
}
PROBE = 1e-3
"""Share of the largest torque that replaces zero: the side of the backlash needs a sign."""


def nuisance(name: str, orders: Sequence[int]) -> Tolerance:
    """The prior of a nuisance of the bench.

    Args:
        name: of `NUISANCES`.
        orders: of the output turn that are measured; a phase is seen up to their common turn.
    """
    if name == "phase":
        half = math.pi / math.gcd(*orders)
        return Tolerance(-half, half, distribution="uniform")
    shape = {"mounting": (2,), "reading": (6,)}.get(name, ())
    return Tolerance.symmetric(WIDE, shape=shape, vector=False) if shape else Tolerance.symmetric(WIDE)


def part_orders(design: object, orders: Iterable[int]) -> tuple[int, ...]:
    """The orders that only errors of parts or the mounting of the scale make: no harmonic of the housing has them.

    |zp P - m| with P = m + c s is zc P + c s but for its sign (`loaded.housing_orders`).

    Args:
        design: the reducer; its cranks are equal.
        orders: of the output turn.
    """
    counts = getattr(design, "counts", {})
    common = math.gcd(counts.get("teeth", 1), counts.get("cranks", 1))
    return tuple(order for order in orders if order % common)


def number_of_design(design: PyTree, name: str) -> tuple[tuple[str, ...], str]:
    """Path and SI unit of a number of a design.

    Args:
        design: the reducer.
        name: of a field of one of its parts; "stiffness" is a factor on all its springs, whose path is empty.

    Raises:
        ValueError: no part has such a number.
    """
    springs = hasattr(design, "stiffer")
    if name == "stiffness" and springs:
        return (), "-"
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for part in dataclasses.fields(design):
        record, kind = getattr(design, part.name), part.metadata["kind"]
        if kind == "real":
            found[part.name] = (part.name,), part.metadata["unit"]
        for f in dataclasses.fields(record) if dataclasses.is_dataclass(record) else ():
            if f.metadata["kind"] not in ("count", "text", "record"):
                found[f.name] = (part.name, f.name), f.metadata["unit"]
    if name not in found:
        first = ["stiffness (a factor on all springs)"] if springs else []
        raise unknown("no number of this design", name, [*first, *found], "; there are")
    return found[name]


def _taken(design: PyTree, values: Values) -> tuple[PyTree, PyTree]:
    """Design and errors of one unit."""
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    errors = design.error_record.for_design(design, **{n: v for n, v in values.items() if n in fields})
    for name, value in values.items():
        if name in fields or name in NUISANCES:
            continue
        path, _ = number_of_design(design, name)
        design = _with(design, path, value) if path else design.stiffer(value)
    return design, errors


def _with(record: PyTree, path: tuple[str, ...], value: Scalar) -> PyTree:
    """The record with another number at a path, in the shape of what is there."""
    name, rest = path[0], path[1:]
    now = getattr(record, name)
    if rest:
        return record.replace(**{name: _with(now, rest, value)})
    return record.replace(**{name: jnp.broadcast_to(value, () if now is None else np.shape(now))})


@record
class Curves(Record):
    """The orders of runs of transmission error: `values -> {"order 040": (runs,) complex, .., "mean": (runs,)}`.

    Means count with the nuisance "offset", order 1 with "mounting". Its numbers are those of the design and the
    torques: one program serves every design of a kind.
    """

    design: PyTree = field("-", "the reducer", kind="record")
    torques: Array | np.ndarray = field(
        "N m", "of the discs on the carrier, one for each distinct run", shape=("torques",)
    )
    place: tuple[int, ...] = text("which torque each run has")
    observation: Observation = text("of the model")
    conditions: PyTree = text("how the models are computed")
    orders: tuple[int, ...] = text("of the output turn")
    nuisances: tuple[str, ...] = text("of NUISANCES that the prior has")
    alike: bool = text("one turn of the cranks is like the next")
    idle: bool = text("no run has a torque")
    reading: Array | np.ndarray | None = field(
        "-", "real and imaginary part per element of the nuisance", shape=("torques", "orders", 6, 2), default=None
    )

    def __call__(self, values: Values) -> Seen:
        """Predict the measurement of one unit."""
        unit, errors = _taken(self.design, values)
        torques = None if self.idle else self.torques
        mean, found = self.observation.predict(unit, errors, self.conditions, torques, self.orders, self.alike)
        place = np.array(self.place)
        seen: Seen = {}
        for k, order in enumerate(self.orders):
            seen[order_name(order)] = found[place, k]
            if self.reading is not None:
                moved = jnp.einsum("tec,e->ct", jnp.asarray(self.reading)[place, k], values["reading"])
                seen[order_name(order)] += jax.lax.complex(*moved)
            if "phase" in self.nuisances:
                turn = order * values["phase"]
                seen[order_name(order)] *= jax.lax.complex(jnp.cos(turn), -jnp.sin(turn))
        if "mounting" in self.nuisances:
            cosine, sine = values["mounting"]
            one = jnp.broadcast_to(jax.lax.complex(cosine, -sine), (len(place),))
            seen[order_name(1)] = one + seen[order_name(1)] if order_name(1) in seen else one
        if "offset" in self.nuisances:
            seen["mean"] = mean[place] + values["offset"]
        return seen


def curve_model(
    model: str,
    design: Design,
    conditions: PyTree,
    runs: Sequence[Conditions],
    orders: Sequence[int],
    nuisances: Sequence[str],
    active: Sequence[str],
) -> Curves:
    """The model of some runs.

    Args:
        model: name of a model that has curves, such as "four_bar".
        design: the reducer.
        conditions: of the study: how the models are computed.
        runs: torque and direction of each.
        orders: of the output turn.
        nuisances: of `NUISANCES` that the prior has, and others.
        active: errors that vary, by field; some make a turn of the cranks unlike the next.

    Raises:
        ValueError: an order too fine for the angles of the conditions.
    """
    observation = models.kind(design).observations(model)["curve"]
    distinct, place = np.unique(signed_torques(runs, conditions), return_inverse=True)
    record = design.error_record
    alike = not set(active) & set(read_by(record, model)) & set(described(record, "breaks_pitch"))
    finest, key = max(orders) // observation.period(design), observation.samples
    if alike and finest >= (count := getattr(conditions, key)) / 2:
        raise ValueError(
            f"identify.orders: order {max(orders)} is crank order {finest}, too fine for conditions.{key} = {count}"
        )
    if observation.sided:  # at zero torque the direction selects the side of the backlash
        least = PROBE * max(np.max(np.abs(distinct)), rated_torque(conditions))
        load = np.maximum(np.abs(signed := signed_torques(runs, conditions)), least)
        negative = np.where(signed == 0, np.array([run.sign for run in runs]) < 0, signed < 0)
        distinct, place = np.unique(np.where(negative, -load, load), return_inverse=True)
    head = observation.head
    return Curves(
        design=design,
        torques=np.asarray(distinct, float),
        place=tuple(int(k) for k in place),
        observation=observation,
        conditions=conditions,
        orders=tuple(orders),
        nuisances=tuple(name for name in nuisances if name in NUISANCES),
        alike=alike,
        idle=not np.any(distinct),
        reading=head(design, conditions, distinct, tuple(orders)) if head and "reading" in nuisances else None,
    )


def order_name(order: int) -> str:
    """Name of an order in an observation; it sorts as the number does."""
    return f"order {order:03d}"


def signed_torques(runs: Sequence[Conditions], conditions: PyTree) -> np.ndarray:
    """Torque of the discs on the carrier in each run, N m: load opposes motion, so its sign is the direction.

    Args:
        runs: a run whose file says no torque has that of the conditions.
        conditions: of the study.
    """
    own = study_torque(conditions)
    given = np.array([own if run.torque is None else run.torque for run in runs])
    return np.array([run.sign for run in runs]) * given


def study_torque(conditions: "DataclassInstance") -> float:
    """The condition that is the load, N m."""
    return float(next(getattr(conditions, f.name) for f in dataclasses.fields(conditions) if f.metadata["torque"]))


def rated_torque(conditions: PyTree) -> float:
    """Rated torque, N m; 0 if the conditions have none."""
    return float(getattr(conditions, "rated_torque", None) or 0.0)


@record
class Midline(Record):
    """The midline of a torque-angle loop, input held: `values -> {"angle": (n,)}`."""

    design: PyTree = field("-", "the reducer, with stiffness and contact", kind="record")
    load: Array | np.ndarray = field(
        "N m", "of the discs on the carrier, against the torque of the bench", shape=("torques",)
    )
    observation: Observation = text("of the model")
    conditions: PyTree = text("how the model is computed")
    offset: bool = text("the prior has one")

    def __call__(self, values: Values) -> Seen:
        """Predict the measurement of one unit."""
        unit, errors = _taken(self.design, values)
        angle = self.observation.predict(unit, errors, self.conditions, self.load)
        return {"angle": angle + values["offset"] if self.offset else angle}


@record
class Frequencies(Record):
    """Natural frequencies of modes that are followed by their shape: `values -> {"frequency": (n,)}`."""

    design: PyTree = field("-", "the reducer, with inertia and stiffness", kind="record")
    observation: Observation = text("of the model")
    conditions: PyTree = text("how the model is computed")
    test: Array | np.ndarray = field(
        "sqrt(kg)", "rows that are 1 for the own mode and 0 for the others", shape=("tones", "n")
    )

    def __call__(self, values: Values) -> Seen:
        """Predict the measurement of one unit."""
        frequency, shape = self.observation.predict(*_taken(self.design, values), self.conditions)
        alike = jnp.abs(jnp.asarray(self.test) @ shape)
        place = jax.lax.stop_gradient(jnp.argmax(jnp.where(jnp.isfinite(alike), alike, 0.0), axis=1))
        return {"frequency": frequency[place]}


def frequency_model(
    observation: Observation, design: Design, conditions: PyTree, measured: np.ndarray, start: Values
) -> Frequencies:
    """Natural frequencies of the modes that were measured.

    Each is matched to the nearest mode of the unit `start`, no two to the same, and followed by its shape: a mode that
    passes another one keeps its name.

    Args:
        observation: of the model.
        design: the reducer, with inertia and stiffness.
        conditions: how the model is computed.
        measured: ascending, Hz (n,).
        start: values from which the modes are followed.

    Raises:
        ValueError: more frequencies than elastic modes.
    """
    from scipy.optimize import linear_sum_assignment

    frequency, shape = map(np.asarray, observation.predict(*_taken(design, start), conditions))
    elastic = np.flatnonzero(frequency > 0)
    if len(measured) > len(elastic):
        raise ValueError(f"{len(measured)} frequencies, but the design has {len(elastic)} elastic modes")
    apart = np.abs(np.log(np.asarray(measured)[:, None] / frequency[None, elastic]))
    chosen = elastic[linear_sum_assignment(apart)[1]]
    own = np.linalg.inv(shape)[chosen]  # S' M S = I: the inverse of the shapes is S' M
    return Frequencies(design, observation, conditions, own)
