"""Predicted measurements of a unit: orders of runs, a hysteresis curve or frequencies, from the values of a prior.

The values are one flat dict: errors of the study by field, unknown numbers of the design, nuisances of the bench.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax._jax.programs import Options
from rvjax.errors import described, read_by
from rvjax.measured import Conditions
from rvjax.outputs import Observation, torque_of
from rvjax.records import Array, Design, PyTree, Record, field, record, text
from rvjax.study.identification import DRAGS, NUISANCES, number_of_design
from rvjax.study.kinds import number_at, replaced

Values = Mapping[str, PyTree]
Seen = dict[str, PyTree]
Model = Callable[[Values], Seen]

PROBE = 1e-3
"""Share of the largest torque that replaces zero: the side of the backlash needs a sign."""


def _taken(design: PyTree, values: Values) -> tuple[object, object]:
    """Design and errors of one unit."""
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    errors = design.error_record.for_design(design, **{n: v for n, v in values.items() if n in fields})
    for name, value in values.items():
        if name in fields or name in NUISANCES:
            continue
        path, _ = number_of_design(design, name)
        if path:
            now = number_at(design, path)
            design = replaced(design, {path: jnp.broadcast_to(value, () if now is None else np.shape(now))})
        else:
            design = design.stiffer(value)
    return design, errors


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
    speeds: Array | np.ndarray | None = field(
        "rad/s", "of the input, for the nuisance viscous_drag", shape=("torques",), default=None
    )
    least: Array | float = field("N m", "torque at which a run without load or drag is computed", default=0.0)
    part: Array | int | None = field("-", "number of the part of the angles; None: all", kind="integer", default=None)
    parts: int = text("of the angles", default=1)

    @property
    def compiler_options(self) -> Options:
        """Compiler options of programs that evaluate it."""
        return self.observation.compiler_options

    def __call__(self, values: Values) -> Seen:
        """Predict the measurement of one unit."""
        unit, errors = _taken(self.design, values)
        torques = None if self.idle else self._transmitted(values)
        part = {} if self.part is None else {"part": (self.part, self.parts)}
        mean, found = self.observation.predict(unit, errors, self.conditions, torques, self.orders, self.alike, **part)
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

    def split(self) -> tuple["Curves", list[dict[str, PyTree]]]:
        """The curves over a part of the angles, and the fields of each part: `identify.identification.parts_of`."""
        given = {name: getattr(self, name) for name in ("torques", "reading", "speeds", "least")}
        fields = {name: value for name, value in given.items() if value is not None}
        divide = self.observation.parts
        count = divide(self.design, self.conditions, self.orders, self.alike) if divide else 1
        if count == 1:
            return self, [fields]
        return self.replace(part=0, parts=count), [fields | {"part": number} for number in range(count)]

    def shapes(self, dtype: np.dtype) -> Seen:
        """Shapes and types of a measurement, without tracing a model.

        Args:
            dtype: of real numbers.
        """
        runs, paired = (len(self.place),), np.result_type(dtype, np.complex64)
        orders = {*self.orders, *([1] if "mounting" in self.nuisances else [])}
        seen: Seen = {order_name(k): jax.ShapeDtypeStruct(runs, paired) for k in orders}
        return seen | ({"mean": jax.ShapeDtypeStruct(runs, dtype)} if "offset" in self.nuisances else {})

    def _transmitted(self, values: Values) -> Array | np.ndarray:
        """Torques of the discs on the carrier, N m: load and drag both oppose the motion."""
        if not set(DRAGS) & set(self.nuisances):
            return self.torques
        load = jnp.asarray(self.torques)
        drag = values.get("drag", 0.0) + values.get("viscous_drag", 0.0) * jnp.asarray(self.speeds)
        return jnp.sign(load) * jnp.maximum(jnp.abs(load) + drag, self.least)  # the sense of the motion stays


def curve_model(
    model: str,
    design: Design,
    conditions: object,
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
    load = signed_torques(runs, conditions)
    record = design.error_record
    dragged = bool(set(DRAGS) & set(nuisances))
    least = 0.0
    alike = not set(active) & set(read_by(record, model)) & set(described(record, "breaks_pitch"))
    finest, key = max(orders) // observation.period(design), observation.samples
    if alike and finest >= (count := getattr(conditions, key)) / 2:
        raise ValueError(
            f"identify.orders: order {max(orders)} is crank order {finest}, too fine for conditions.{key} = {count}"
        )
    if observation.sided:  # at zero torque the direction selects the side of the backlash
        least = PROBE * max(np.max(np.abs(load)), rated_torque(conditions))
        negative = np.where(load == 0, np.array([run.sign for run in runs]) < 0, load < 0)
        floor = np.finfo(float).tiny if dragged else least  # drag moves a run without load
        load = np.where(negative, -1, 1) * np.maximum(np.abs(load), floor)
    speed = _speeds(runs) if "viscous_drag" in nuisances else np.zeros(len(runs))
    (distinct, speeds), place = np.unique(np.stack([load, speed]), axis=1, return_inverse=True)
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
        speeds=speeds if dragged else None,
        least=least,
    )


def _speeds(runs: Sequence[Conditions]) -> np.ndarray:
    """Speed of the input in each run, rad/s; a run without one, such as a candidate, has the largest of the others."""
    given = [run.speed for run in runs if run.speed is not None]
    if not given:
        raise ValueError('identify.nuisance = "viscous_drag": needs a column "speed [rpm]" of the input in the data')
    return np.array([max(given) if run.speed is None else run.speed for run in runs])


def order_name(order: int) -> str:
    """Name of an order in an observation; it sorts as the number does."""
    return f"order {order:03d}"


def signed_torques(runs: Sequence[Conditions], conditions: object) -> np.ndarray:
    """Torque of the discs on the carrier in each run, N m: load opposes motion, so its sign is the direction.

    Args:
        runs: a run whose file says no torque has that of the conditions.
        conditions: of the study.
    """
    own = float(torque_of(conditions))
    given = np.array([own if run.torque is None else run.torque for run in runs])
    return np.array([run.sign for run in runs]) * given


def rated_torque(conditions: object) -> float:
    """Rated torque, N m; 0 if the conditions have none."""
    return float(getattr(conditions, "rated_torque", None) or 0.0)


@record
class Midline(Record):
    """The midline of a torque-angle loop, input held: `values -> {"angle": (n,)}`.

    With the nuisance "drag" also its width, `"width": (n,)`: on the rising branch drag is taken off the torque of the
    bench, on the falling one it is added.
    """

    design: PyTree = field("-", "the reducer, with stiffness and contact", kind="record")
    load: Array | np.ndarray = field(
        "N m", "of the discs on the carrier, against the torque of the bench", shape=("torques",)
    )
    observation: Observation = text("of the model")
    conditions: PyTree = text("how the model is computed")
    nuisances: tuple[str, ...] = text("of NUISANCES that the prior has")

    @property
    def compiler_options(self) -> Options:
        """Compiler options of programs that evaluate it."""
        return self.observation.compiler_options

    def __call__(self, values: Values) -> Seen:
        """Predict the measurement of one unit."""
        unit, errors = _taken(self.design, values)
        offset = values["offset"] if "offset" in self.nuisances else 0.0
        if "drag" not in self.nuisances:
            return {"angle": self.observation.predict(unit, errors, self.conditions, self.load) + offset}
        load, drag = jnp.asarray(self.load), values["drag"]
        both = self.observation.predict(unit, errors, self.conditions, jnp.concatenate([load + drag, load - drag]))
        rising, falling = jnp.split(both, 2)
        return {"angle": (rising + falling) / 2 + offset, "width": falling - rising}


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
    observation: Observation, design: Design, conditions: object, measured: np.ndarray, start: Values
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
