"""What a bench would see of a unit: from the values of a prior to orders of runs, a torque-angle curve or frequencies.

The values are one flat dict: errors of the study by field, unknown numbers of the design, nuisances of the bench.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import dynamics, four_bar, loaded
from rvjax.designs import RVReducer
from rvjax.study.measured import Conditions
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec

Values = Mapping[str, Any]
Observation = dict[str, Any]
Model = Callable[[Values], Observation]

KINDS = {"four_bar": ("curve",), "loaded": ("curve", "loop"), "dynamics": ("frequencies",)}
"""What each model can predict of what was measured."""
WIDE = 3000 * arcsec
NUISANCES: dict[str, str] = {
    "offset": "zero of the angle readings, one for all runs; with it the means of the runs count",
    "mounting": "eccentricity of the encoders, [cosine, sine] of order 1; with it order 1 counts",
    "phase": "angle of the index mark, where there is none",
}
PROBE = 1e-3
"""Share of the largest torque that stands for none: the side to which the play lies needs a sign."""
BREAKS_PITCH = ("pin_offset", "pin_radii", "ring_centre", "sun_runout")
"""Errors with which one turn of the cranks is not like the next."""


def nuisance(name: str, orders: Sequence[int]) -> Tolerance:
    """The prior of a nuisance of the bench.

    Args:
        name: of `NUISANCES`.
        orders: of the output turn that are measured; a phase is seen up to their common turn.
    """
    if name == "phase":
        half = math.pi / math.gcd(*orders)
        return Tolerance(-half, half, distribution="uniform")
    return Tolerance.symmetric(WIDE, shape=(2,), vector=False) if name == "mounting" else Tolerance.symmetric(WIDE)


def number_of_design(design: Any, name: str) -> tuple[str, ...]:
    """Path of a number of a design.

    Args:
        design: the reducer.
        name: of a field of one of its parts; "stiffness" is a factor on all its springs.

    Raises:
        ValueError: no part has such a number.
    """
    if name == "stiffness":
        return ()
    found = {}
    for part in dataclasses.fields(design):
        record = getattr(design, part.name)
        for f in dataclasses.fields(record) if dataclasses.is_dataclass(record) else ():
            if f.metadata["kind"] not in ("count", "text", "record"):
                found[f.name] = (part.name, f.name)
    if name not in found:
        raise ValueError(f"no number of this design; there are stiffness (a factor on all springs), {', '.join(found)}")
    return found[name]


def unit_of_number(design: Any, name: str) -> str:
    """SI unit of a number of a design, "-" for the factor on all springs.

    Args:
        design: the reducer.
        name: as in `number_of_design`.
    """
    path = number_of_design(design, name)
    if not path:
        return "-"
    return next(f.metadata["unit"] for f in dataclasses.fields(getattr(design, path[0])) if f.name == path[1])


def _taken(design: Any, values: Values) -> tuple[Any, Any]:
    """Design and errors of one unit."""
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    errors = design.error_record.for_design(design, **{n: v for n, v in values.items() if n in fields})
    for name, value in values.items():
        if name in fields or name in NUISANCES:
            continue
        path = number_of_design(design, name)
        if path:
            part = getattr(design, path[0])
            now = jnp.broadcast_to(
                value, np.shape(getattr(part, path[1])) if getattr(part, path[1]) is not None else ()
            )
            design = design.replace(**{path[0]: part.replace(**{path[1]: now})})
        else:
            design = _stiffer(design, value)
    return design, errors


def _stiffer(design: RVReducer, factor: Any) -> RVReducer:
    """The design with all springs times a factor."""
    cranks = design.cranks
    if cranks.bearing_stiffness is not None:
        design = design.replace(cranks=cranks.replace(bearing_stiffness=factor * cranks.bearing_stiffness))
    if design.stiffness is not None:
        design = design.replace(stiffness=jax.tree.map(lambda k: factor * k, design.stiffness))
    return design


def curve_model(
    model: str,
    design: RVReducer,
    conditions: Any,
    runs: Sequence[Conditions],
    orders: Sequence[int],
    nuisances: Sequence[str],
    active: Sequence[str],
) -> Model:
    """The orders of runs of transmission error, as `values -> {"order 40": (runs,) complex, .., "mean": (runs,)}`.

    Args:
        model: "four_bar" or "loaded".
        design: the reducer.
        conditions: of the study: how the models are computed.
        runs: torque and direction of each.
        orders: of the output turn.
        nuisances: of `NUISANCES` that the prior has: means count with "offset", order 1 with "mounting".
        active: errors that vary, by field; some make a turn of the cranks unlike the next.
    """
    torques = signed_torques(runs, conditions)
    distinct, place = np.unique(torques, return_inverse=True)
    of_runs = _four_bar_orders if model == "four_bar" else _loaded_orders
    spectrum = of_runs(design, conditions, tuple(float(t) for t in distinct), tuple(orders), tuple(active))

    def observe(values: Values) -> Observation:
        mean, found = spectrum(*_taken(design, values))
        seen: Observation = {}
        for k, order in enumerate(orders):
            seen[order_name(order)] = found[place, k]
            if "phase" in nuisances:
                turn = order * values["phase"]
                seen[order_name(order)] *= jax.lax.complex(jnp.cos(turn), -jnp.sin(turn))
        if "mounting" in nuisances:
            cosine, sine = values["mounting"]
            one = jnp.broadcast_to(jax.lax.complex(cosine, -sine), (len(runs),))
            seen[order_name(1)] = one + seen[order_name(1)] if order_name(1) in seen else one
        if "offset" in nuisances:
            seen["mean"] = mean[place] + values["offset"]
        return seen

    return observe


def order_name(order: int) -> str:
    """Name of an order in an observation; it sorts as the number does."""
    return f"order {order:03d}"


def signed_torques(runs: Sequence[Conditions], conditions: Any) -> np.ndarray:
    """Torque of the discs on the carrier in each run, N m: load opposes motion, so its sign is the direction.

    Args:
        runs: a run whose file says no torque has that of the conditions.
        conditions: of the study.
    """
    given = np.array([conditions.output_torque if run.torque is None else run.torque for run in runs])
    return np.array([run.sign for run in runs]) * given


def _four_bar_orders(
    design: RVReducer, conditions: Any, torques: Sequence[float], orders: Sequence[int], active: Sequence[str]
) -> Callable[[Any, Any], tuple[jax.Array, jax.Array]]:
    """(mean (torques,), orders (torques, k)) of a unit."""
    pins, most = design.cycloid.pin_count, (conditions.angles + 1) // 2
    for order in orders:
        if order // pins >= most:
            raise ValueError(
                f"identify.orders: order {order} is crank order {order // pins}; conditions.angles is too few"
            )
    none_loaded = not any(torques)

    def spectrum(design: Any, errors: Any) -> tuple[jax.Array, jax.Array]:
        def turn(torque: Any) -> jax.Array:
            ways = dict(cranks=conditions.cranks, gear_stiffness_ratio=conditions.gear_stiffness_ratio)
            ways |= dict(closure=conditions.closure, angles=conditions.angles)
            return four_bar.revolution(design, errors, output_torque=torque, **ways).harmonics

        waves = turn(0.0)[None] if none_loaded else jax.vmap(turn)(jnp.asarray(torques))
        # The cranks turn against the output: X e^(i h crank) is conj(X) e^(i h pins output).
        none = 0 * waves[:, 0]  # a failed turn stays NaN
        found = [jnp.conj(waves[:, k // pins]) if k % pins == 0 else none for k in orders]
        return jnp.real(waves[:, 0]), jnp.stack(found, axis=1)

    return spectrum


def _loaded_orders(
    design: RVReducer, conditions: Any, torques: Sequence[float], orders: Sequence[int], active: Sequence[str]
) -> Callable[[Any, Any], tuple[jax.Array, jax.Array]]:
    """As `_four_bar_orders`, of the whole reducer; one turn of the cranks where all are alike."""
    pins = design.cycloid.pin_count
    like = not set(active) & set(BREAKS_PITCH)
    turns = 1 / pins if like else 1.0
    finest = max(orders)
    samples = conditions.samples if like else max(conditions.samples, 4 * finest)
    step = pins if like else 1
    if like and finest // pins >= samples / 2:
        raise ValueError(f"identify.orders: order {finest} is too fine for conditions.samples = {samples}")
    least = PROBE * max(np.max(np.abs(torques)), conditions.rated_torque or 0.0)
    signs = np.where(np.signbit(torques), -1.0, 1.0)
    load = jnp.asarray(np.where(np.abs(torques) < least, signs * least, torques))

    def spectrum(design: Any, errors: Any) -> tuple[jax.Array, jax.Array]:
        ways = dict(contact=conditions.pin_contact, carrier=conditions.carrier, sun=conditions.sun)

        def turn(torque: jax.Array) -> jax.Array:
            stiff = errors.stiffened(design)
            return loaded.revolution(stiff, errors, output_torque=torque, turns=turns, samples=samples, **ways).error

        error = jax.vmap(turn)(load)
        waves = 2 / samples * jnp.fft.rfft(error)
        none = 0 * waves[:, 0]
        found = [waves[:, k // step] if k % step == 0 else none for k in orders]
        return jnp.mean(error, axis=1), jnp.stack(found, axis=1)

    return spectrum


def loop_model(design: RVReducer, conditions: Any, torque: np.ndarray, nuisances: Sequence[str]) -> Model:
    """The midline of a torque-angle loop, as `values -> {"angle": (n,)}`.

    Args:
        design: the reducer, with stiffness and contact.
        conditions: of the study; the input is held at `input_angle`.
        torque: of the bench on the output, N m (n,): against that of the discs.
        nuisances: "offset" is the only one that a loop has.
    """
    load = -jnp.asarray(torque)

    def observe(values: Values) -> Observation:
        unit, errors = _taken(design, values)
        stiff = errors.stiffened(unit)

        def angle(torque: jax.Array) -> jax.Array:
            ways = dict(contact=conditions.pin_contact, carrier=conditions.carrier, sun=conditions.sun)
            at = conditions.input_angle
            return loaded.equilibrium(stiff, errors, input_angle=at, output_torque=torque, **ways).error

        zero = values["offset"] if "offset" in nuisances else 0.0
        return {"angle": jax.vmap(angle)(load) + zero}

    return observe


def frequency_model(design: RVReducer, measured: np.ndarray, start: Values) -> Model:
    """Natural frequencies of the modes that were measured, as `values -> {"frequency": (n,)}`.

    Each is matched to the nearest mode of the unit `start`, no two to the same, and followed by its shape: a mode that
    passes another one keeps its name.

    Args:
        design: the reducer, with inertia and stiffness.
        measured: ascending, Hz (n,).
        start: values from which the modes are followed.

    Raises:
        ValueError: more frequencies than elastic modes.
    """
    from scipy.optimize import linear_sum_assignment

    nominal = _modes(design, start)
    frequency, shape = np.asarray(nominal.frequency), np.asarray(nominal.shape)
    elastic = np.flatnonzero(frequency > 0)
    if len(measured) > len(elastic):
        raise ValueError(f"{len(measured)} frequencies, but the design has {len(elastic)} elastic modes")
    apart = np.abs(np.log(np.asarray(measured)[:, None] / frequency[None, elastic]))
    chosen = elastic[linear_sum_assignment(apart)[1]]
    # Shapes are mass-normalised: S' M S = I, so the inverse of the shapes is S' M.
    test = jnp.asarray(np.linalg.inv(shape)[chosen])

    def observe(values: Values) -> Observation:
        found = _modes(design, values)
        alike = jnp.abs(test @ found.shape)
        place = jax.lax.stop_gradient(jnp.argmax(jnp.where(jnp.isfinite(alike), alike, 0.0), axis=1))
        return {"frequency": found.frequency[place]}

    return observe


def _modes(design: RVReducer, values: Values) -> dynamics.Modes:
    unit, errors = _taken(design, values)
    return dynamics.modes(errors.stiffened(unit))
