"""A reducer in a study and on its test bench: conditions, results that several outputs read, bench observations.

Observations are orders of the transmission error, with the effects of one encoder head (the nuisance "reading" of
identification), and the hysteresis curve. All angles of a turn are solved next to each other: with slopes of fifty
elements that is cheaper than from one angle to the next. Every observation is linear in the errors at single angles, so
that each equilibrium is solved for its slopes once, however many numbers are observed.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK, quick
from rvjax.catalogue import part_class
from rvjax.designs import RVReducer
from rvjax.errors import Errors, RVErrors
from rvjax.loaded.bench import SHARES, Reading, reading
from rvjax.loaded.case import SUPPORTS
from rvjax.loaded.equilibrium import admit, check_input, equilibrium, error_alone, kind_of
from rvjax.loaded.laws import CONTACTS
from rvjax.loaded.revolution import Revolution, instants, revolution, summary
from rvjax.loaded.system import Layout
from rvjax.outputs import Observation, Spectrum, condition
from rvjax.records import Array, Design, PyTree, Scalar

R = TypeVar("R")

SPANS = ("crank_turn", "output_turn")


@dataclass(frozen=True)
class DriveConditions:
    """Operating conditions of a single-stage drive and its test bench; None only where no output needs the value."""

    output_torque: float = condition(0.0, "torque of the discs on the output", unit="N m", torque=True)
    second_torque: float = condition(None, "of the discs on the output, the second one", unit="N m")
    rated_torque: float = condition(None, "of which a test bench takes shares", unit="N m")
    input_angle: float = condition(0.0, "of the shaft, at which the bench twists the output", unit="rad")
    probe_angles: int = condition(
        1, "input angles of the bench, equally spaced over the span from the input angle on", minimum=1, maximum=1000
    )
    span: str = condition("crank_turn", "along which the reducer turns", choices=SPANS)
    samples: int = condition(48, "input angles over the span", minimum=4, maximum=100_000)
    chosen_angles: int = condition(
        None, "of the samples that are solved in a unit, where its extremes are expected", minimum=6, maximum=1000
    )
    order: int = condition(None, "periods in one turn of the output", minimum=1, maximum=50_000)
    pin_contact: str = condition("hertz", "contact law of discs and pins", choices=CONTACTS)
    carrier: str = condition("fixed", "centre of the carrier", choices=SUPPORTS)


@dataclass(frozen=True)
class LoadedConditions(DriveConditions):
    """Operating conditions of an RV reducer: the sun is its input, the carrier its output."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)
    second_torque: float = condition(None, "of the discs on the carrier, the second one", unit="N m")
    input_angle: float = condition(0.0, "of the sun, at which the bench twists the output", unit="rad")
    sun: str = condition("fixed", "centre of the sun", choices=SUPPORTS)


class Methods(Protocol):
    """Conditions that name the methods of an equilibrium."""

    @property
    def pin_contact(self) -> str:
        """Contact law of the pins."""

    @property
    def carrier(self) -> str:
        """Centre of the carrier."""


def ways(given: Methods) -> dict[str, str]:
    """Methods of the equilibrium, as its keyword arguments."""
    return dict(contact=given.pin_contact, carrier=given.carrier, sun=getattr(given, "sun", "fixed"))


def check_carrying(design: object, reader: str) -> None:
    """Raise ValueError for missing parts of a design that carry load.

    Args:
        design: the reducer.
        reader: what needs them, for the message.

    Raises:
        ValueError: names the part and its keys in a study file.
    """
    for part in ("stiffness", "contact"):
        if getattr(design, part) is None:
            cls = part_class(type(design), part)
            keys = ", ".join(f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING)
            raise ValueError(f"design.{part} is missing: {reader} needs it, with {keys}")


RATED, HALF, SLIGHT, PROBE = SHARES


def turns_of(design: RVReducer, given: LoadedConditions) -> float:
    """Turns of the output in the span."""
    return 1.0 if given.span == "output_turn" else 1 / design.cycloid.pin_count


def _along(design: RVReducer, errors: RVErrors, given: LoadedConditions, torque: float) -> Revolution:
    turns = turns_of(design, given)
    return revolution(
        errors.stiffened(design), errors, output_torque=torque, turns=turns, samples=given.samples, **ways(given)
    )


def turn(design: RVReducer, errors: RVErrors, given: LoadedConditions, angles: jax.Array | None = None) -> Revolution:
    """Along the span under the output torque.

    Args:
        design: the reducer.
        errors: of its parts.
        given: conditions.
        angles: of the input, (m,) rad, in the place of all over the span: extremes alone have a value.
    """
    if angles is None:
        return _along(design, errors, given, given.output_torque)
    design = errors.stiffened(design)
    layout = check_input(design, errors, *ways(given).values())
    read = admit(layout, design, errors, given.output_torque, 0.0)
    each = jnp.asarray(angles, read.torque.dtype)
    torques, none = jnp.broadcast_to(read.torque, each.shape), np.zeros(len(each), int)
    return summary(instants(layout, read, torques, each, none), spaced=False)


def input_angles(design: RVReducer, given: LoadedConditions) -> np.ndarray:
    """Angles of the input over the span, (samples,) rad."""
    return 2 * np.pi * design.ratio * turns_of(design, given) * np.arange(given.samples) / given.samples


def decisive(design: RVReducer, errors: RVErrors, given: LoadedConditions, angle: jax.Array) -> jax.Array:
    """Error and largest pressures (c,) at an input angle, the curves whose extremes are limited; NaN where it failed.

    Args:
        design: the reducer.
        errors: of its parts.
        given: conditions.
        angle: () rad.
    """
    found = equilibrium(
        errors.stiffened(design), errors, input_angle=angle, output_torque=given.output_torque, **ways(given)
    )
    pressures = (each for each in (found.pressure, found.output_pressure) if each is not None)
    return jnp.stack([found.error, *map(jnp.max, pressures)])


def solved_angles(given: LoadedConditions) -> int | None:
    """Angles of the span that are solved in each unit, None for all."""
    most = given.chosen_angles
    return None if most is None or most >= given.samples else most


def second_turn(design: RVReducer, errors: RVErrors, given: LoadedConditions) -> Revolution:
    """Along the span under the second torque."""
    return _along(design, errors, given, given.second_torque)


def unloaded_turn(design: RVReducer, errors: RVErrors, given: LoadedConditions) -> Revolution:
    """Along the span at the probe torque: the limit of no load."""
    return _along(design, errors, given, PROBE * given.rated_torque)


HEAD_PARTS = {"ring": 2, "tilt": 1, "dent": 3}
"""Effects in the order of the elements of "reading", and their periods in a revolution of the head."""
READ_AT = 1000.0
"""Torque at which the amplitudes are given where the conditions have none, N m."""


def effects_of_a_head(
    design: RVReducer, conditions: LoadedConditions, torques: np.ndarray, orders: Sequence[int]
) -> np.ndarray:
    """Contribution of a head to the orders at each torque, per element of "reading", (torques, k, 6, 2).

    Of the reducer without errors of parts, whose forces those of a unit resemble to 1 %. An element is the largest
    amplitude of its effect, of any order, at the rated torque.

    Args:
        design: the reducer.
        conditions: of the study.
        torques: of the discs on the carrier, N m (torques,).
        orders: of the output turn (k,).
    """
    rated = abs(conditions.rated_torque or conditions.output_torque or READ_AT)
    turn, k = 2 * np.pi * design.ratio, design.cycloid.pin_count * design.cranks.count
    angle = turn * np.arange(samples := k * -(-4 * max(*orders, k) // k)) / samples
    methods = ways(conditions).values()
    loads = map(float, (rated, *torques))  # of one type: one program
    curves = np.stack([jax.device_get(_effects(design, jnp.asarray(angle), load, *methods)) for load in loads])
    waves = 2 / samples * np.fft.rfft(curves)[..., 1:]  # (torques, 6, orders)
    largest = np.abs(waves[0]).reshape(3, -1).max(axis=1)
    waves = waves[1:] / np.repeat(np.where(largest > 0, largest, 1.0), 2)[:, None]
    effects = np.moveaxis(waves[..., np.array(orders) - 1], -1, 1)
    return np.stack([effects.real, effects.imag], axis=-1)


@quick(3, 4, 5)
def _effects(design: RVReducer, angle: jax.Array, torque: float, contact: str, carrier: str, sun: str) -> jax.Array:
    """Readings less the error for unit gains: cosine and sine of the head for ring, tilt and dent, (6, angles)."""
    discs = design.cycloid.disc_count
    position = np.linspace(-1.0, 1.0, discs) if discs > 1 else np.zeros(1)
    gains = zip(np.eye(3).tolist(), HEAD_PARTS.values())
    heads = [
        Reading(1.0, (np.pi * part / 2 / m,), ring, tilt, 1.0, position, dent)
        for (ring, tilt, dent), m in gains
        for part in (0, 1)
    ]

    def at(x: jax.Array) -> jax.Array:
        solution = equilibrium(
            design, RVErrors(), input_angle=x, output_torque=torque, contact=contact, carrier=carrier, sun=sun
        )
        seen = [reading(solution, design, head, input_angle=x, output_torque=torque) for head in heads]
        return jnp.stack([value - solution.error for value in seen])

    return jax.vmap(at, out_axes=1)(angle)


NEEDS = ("stiffness", "contact")
PARTS = 5
"""Most parts of the angles of a turn of the output."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _errors(layout: Layout, design: RVReducer, errors: Errors, torques: Array, angles: Array) -> jax.Array:
    """Transmission error (t, n) at torques (t,) and input angles (n,)."""
    return _each(functools.partial(_error, layout, design, errors), torques, angles)


def _error(layout: Layout, design: Design, errors: Errors, torque: Scalar, angle: Scalar) -> jax.Array:
    return error_alone(layout, design, errors, angle, torque)


def _each(function: Callable[[Scalar, Scalar], R], torques: Array, angles: Array) -> R:
    """The function at every torque and angle, under one `jax.vmap`: each one traces the equilibrium again."""
    shape = len(torques), len(angles)
    pairs = (jnp.broadcast_to(x, shape).ravel() for x in (torques[:, None], angles))
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), jax.vmap(function)(*pairs))


def _errors_jvp(
    layout: Layout, primals: tuple[RVReducer, Errors, Array, Array], tangents: tuple[object, object, Array, Array]
) -> tuple[jax.Array, jax.Array]:
    """One adjoint of each equilibrium, then sums: with ten observed numbers a tenth of their adjoints."""
    design, errors, torques, angles = primals
    leaves, tree = jax.tree.flatten((design, errors))
    zero = jax.custom_derivatives.SymbolicZero
    still: Callable[[object], bool] = lambda tangent: isinstance(tangent, zero)  # noqa: E731
    changes = jax.tree.leaves(tangents[:2], is_leaf=still)
    moving = [i for i, change in enumerate(changes) if not still(change)]

    def one(moved: list[jax.Array], torque: Scalar, angle: Scalar) -> Array:
        whole = list(leaves)
        for i, leaf in zip(moving, moved):
            whole[i] = leaf
        design, errors = jax.tree.unflatten(tree, whole)
        return _error(layout, design, errors, torque, angle)

    of = functools.partial(jax.value_and_grad(one, (0, 1, 2)), [leaves[i] for i in moving])
    error, (slopes, of_torque, of_angle) = _each(of, torques, angles)
    change = jnp.zeros_like(error)
    for slope, i in zip(slopes, moving):
        change += jnp.tensordot(slope, changes[i], jnp.ndim(changes[i]), precision="highest")
    if not still(tangents[2]):
        change += of_torque * tangents[2][:, None]
    if not still(tangents[3]):
        change += of_angle * tangents[3][None]
    return error, change


_errors.defjvp(_errors_jvp, symbolic_zeros=True)


def _count(design: RVReducer, given: LoadedConditions, orders: tuple[int, ...], alike: bool) -> int:
    """Angles of a period: so many that no order of perfect parts that they do not resolve looks like an observed one.

    The mean is observed, too.
    """
    step = design.cycloid.pin_count if alike else 1
    seen = {0, *(k / step for k in orders)}
    passing = [k / step for k in kind_of(design).passing(design)]

    def taken(count: int) -> bool:
        return any(abs(k - count * round(k / count)) in seen for k in passing if 2 * k >= count)

    least = given.samples if alike else max(given.samples, 4 * max(orders))
    return next(count for count in itertools.count(least) if not taken(count))


def _parts(design: RVReducer, given: LoadedConditions, orders: tuple[int, ...], alike: bool) -> int:
    """Parts of a turn of the output: so many that what one takes for another order is far from those of the pins."""
    if alike:
        return 1
    pins, count = design.cycloid.pin_count, _count(design, given, orders, alike)

    def distance(parts: int) -> int:
        """Least distance of a mistaken order from a multiple of the pins."""
        mistaken = [k * count // parts % pins for k in range(1, parts)]
        return min(min(k, pins - k) for k in mistaken)

    fit = [n for n in range(2, PARTS + 1) if count % n == 0 and distance(n) >= pins // PARTS]
    return max(fit, default=1)


def _spectrum(
    design: RVReducer,
    errors: Errors,
    given: LoadedConditions,
    torques: Array,
    orders: tuple[int, ...],
    alike: bool,
    part: tuple[Array | int, int] = (0, 1),
) -> Spectrum:
    """One turn of the cranks where all are alike, else a turn of the output."""
    step = design.cycloid.pin_count if alike else 1
    count, (number, parts) = _count(design, given, orders, alike), part
    stiff, torques = errors.stiffened(design), jnp.asarray(torques)
    numbers = jnp.asarray(np.arange(0, count, parts), torques.dtype) + jnp.asarray(number, torques.dtype)
    angles = 2 * jnp.pi * design.ratio / step / count * numbers
    error = _errors(check_input(stiff, errors, **ways(given)), stiff, errors, torques, angles)
    turned = np.outer(np.arange(count), [k // step for k in orders]) * 2 * np.pi / count
    every = np.where([k % step == 0 for k in orders], 2 * parts / count * np.exp(-1j * turned), 0)
    waves = jnp.asarray(every.reshape(-1, parts, len(orders)))[:, number]
    real_imaginary = [jnp.matmul(error, w.astype(error.dtype), precision="highest") for w in (waves.real, waves.imag)]
    return jnp.mean(error, axis=1), jax.lax.complex(*real_imaginary)


def _angle(design: object, errors: PyTree, given: LoadedConditions, torques: Array) -> Array:
    """Output angle at each torque, input held."""
    angle = jnp.asarray(given.input_angle, jnp.result_type(float))[None]
    stiff = errors.stiffened(design)
    return _errors(check_input(stiff, errors, **ways(given)), stiff, errors, jnp.asarray(torques), angle)[:, 0]


CURVE = Observation(
    "curve",
    _spectrum,
    NEEDS,
    samples="samples",
    period=lambda design: int(design.cycloid.pin_count),
    sided=True,
    head=effects_of_a_head,
    parts=_parts,
    compiler_options=QUICK,
)
LOOP = Observation("loop", _angle, NEEDS, compiler_options=QUICK)
