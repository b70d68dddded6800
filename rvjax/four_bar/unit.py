"""Parameters of one reducer that determine the position of its discs, and the load on its crank pins.

Axes of cranks and discs are unrolled into lists: a batch of units then sees element-wise arithmetic
only, which XLA turns into a few vector loops. Under load, clearance and bearings let the crank pins move.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import LARGEST_ANGLE
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.four_bar.closures import Crank
from rvjax.records import Array, PyTree, Scalar, broadcast_fields, is_concrete, promote
from rvjax.status import Check, Gate, Status, admit, window

Vector = tuple[Any, Any]


class DiscLoad(NamedTuple):
    """Load of one disc on the carrier, per disc."""

    tangential: jax.Array  # Fv, along the direction of motion of the disc centre, N
    radial: jax.Array  # Fu, along the eccentric direction, N
    torque: jax.Array  # Tc, couple on the crank pins, N m


def pin_load_ratio(shortening: jax.Array) -> jax.Array:
    """kappa: radial over tangential pin load, half the pins in contact, loaded by lever arm; 0 < K1 < 1.

    The forces of the pins meet in the pitch point. A power series replaces the closed form where that
    would cancel.
    """
    small = shortening < 0.4
    k = jnp.where(small, shortening, 0.2)
    series = jnp.zeros_like(k)
    for n in range(20, 0, -1):
        series = series * k**2 + 1 / (4 * n**2 - 1)
    k1 = jnp.where(small, 0.5, shortening)
    closed = 1 / k1 - (1 - k1**2) / k1**2 * jnp.arctanh(k1)
    return jnp.where(small, 4 / jnp.pi * k * series, 2 / jnp.pi * closed)


def disc_load(design: RVReducer, eccentricity: Array, shortening: Array, torque: jax.Array) -> DiscLoad:
    """Share of one disc in the torque that all discs exert on the carrier; only counts are read from `design`."""
    cycloid, ratio = design.cycloid, design.involute.sun_teeth / design.involute.planet_teeth
    tangential = torque / (cycloid.disc_count * eccentricity * (cycloid.pin_count + ratio))  # ratio: the sun reacts
    return DiscLoad(
        tangential=tangential,
        radial=pin_load_ratio(shortening) * jnp.abs(tangential),
        torque=eccentricity * cycloid.disc_teeth * tangential,
    )


def pin_force(load: DiscLoad, crank: Crank, tangent: Vector, count: int, radius: Array) -> Vector:
    """Force of a disc on one of `count` crank pins; `crank` is the disc's eccentric direction."""
    couple = load.torque / (count * radius)
    return (
        (load.radial * crank.cosine - load.tangential * crank.sine) / count + couple * tangent[0],
        (load.radial * crank.sine + load.tangential * crank.cosine) / count + couple * tangent[1],
    )


def joint_shift(force: Vector, clearance: Scalar, stiffness: Scalar) -> Vector:
    """Bore against pin: the clearance taken up in the direction of the load, and the elastic approach.

    No load takes up no clearance: T = 0 is a jump of the clearance part, whose derivatives there are zero.
    """
    square = force[0] ** 2 + force[1] ** 2
    loaded = square > 0
    size = jnp.sqrt(jnp.where(loaded, square, 1))
    unit = tuple(jnp.where(loaded, part / size, 0) for part in force)
    return unit[0] * clearance + force[0] / stiffness, unit[1] * clearance + force[1] / stiffness


class Stage(NamedTuple):
    """Inputs from design and load."""

    eccentricity: Scalar
    radius: Scalar  # of the circle of crank axes
    shortening: Scalar
    stiffness: Scalar  # of a crank bearing; 1 where there is no load
    torque: Scalar


HARMLESS = Stage(eccentricity=0.02, radius=1, shortening=0.5, stiffness=1, torque=0)


class Parts(NamedTuple):
    """Errors that place the discs; lists run over discs [k] and cranks [i]."""

    delta: list[list[Any]]  # [k][i] crank eccentricity
    psi: list[Any]  # [i] crank phases
    disc: list[list[Vector]]  # [k][i] bores, (radial, tangential)
    carrier: list[Vector]  # [i] bores, (radial, tangential)
    clearance: Scalar
    eccentricity: Scalar


class Unit(NamedTuple):
    """Numbers of one reducer, finite and possible; lists as in `Parts`."""

    eccentricity: Array  # nominal plus error
    radius: Array
    axes: list[Vector]  # [i] radial unit vectors
    parts: Parts
    load: DiscLoad | None  # None: unloaded
    stiffness: Array
    gate: Gate

    def disc_crank(self, k: int, first: Crank) -> Crank:
        """Eccentric direction of disc k, the first disc's given."""
        return first.turned(*exact_direction(2 * k, len(self.parts.disc)))

    def joint_shifts(self, crank: Crank) -> list[Vector]:
        """Bores against pins of a disc, per crank."""
        if self.load is None:
            return [(0, 0)] * len(self.axes)
        tangents = [(-y, x) for x, y in self.axes]
        pins = [pin_force(self.load, crank, tangent, len(self.axes), self.radius) for tangent in tangents]
        return [joint_shift(force, self.parts.clearance, self.stiffness) for force in pins]


def is_loaded(design: RVReducer, output_torque: Scalar) -> bool:
    """False for a torque known to be zero: the program then has no effects of load.

    Raises:
        ValueError: a load without bearing stiffness.
    """
    loaded = not (is_concrete(output_torque) and np.all(np.asarray(output_torque) == 0))
    if loaded and design.cranks.bearing_stiffness is None:
        raise ValueError("CrankStage.bearing_stiffness = None: a load (output_torque) needs it, in N/m")
    return loaded


def take_apart(
    design: RVReducer, errors: RVErrors, output_torque: Array, *others: object, loaded: bool
) -> tuple[PyTree, ...]:
    """Return the unit, and `others` in its dtype. An impossible case becomes a nominal unit.

    Raises:
        ValueError: errors whose shapes do not fit the design.
    """
    numbers = promote(design.cycloid, design.cranks, errors, output_torque, others)
    cycloid, cranks, errors, torque, others = numbers
    stiffness = cranks.bearing_stiffness if loaded else jnp.ones_like(cycloid.eccentricity)
    stage = Stage(cycloid.eccentricity, cranks.circle_radius, cycloid.shortening_coefficient, stiffness, torque)
    # Design and load are checked separately from the errors: a batch over errors then leaves them unbatched.
    stage, gate = admit(stage, HARMLESS, *_judge_stage(stage, loaded))
    parts = _unroll(design, errors)
    parts, gate = admit(parts, 0, *_judge_parts(parts, stage.radius), after=gate)
    count = cranks.count
    unit = Unit(
        eccentricity=stage.eccentricity + parts.eccentricity,
        radius=stage.radius,
        axes=[exact_direction(count + 2 * i, count) for i in range(count)],  # pi + 2 pi i / c
        parts=parts,
        load=disc_load(design, stage.eccentricity, stage.shortening, stage.torque) if loaded else None,
        stiffness=stage.stiffness,
        gate=gate,
    )
    return unit, *others


def _unroll(design: RVReducer, errors: RVErrors) -> Parts:
    names = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore")
    full = broadcast_fields(RVErrors, design.counts, {name: getattr(errors, name) for name in names})
    delta, psi, disc, carrier = (_unstack(full[name]) for name in names)
    return Parts(delta, psi, disc, carrier, errors.bearing_clearance, errors.eccentricity)


def _judge_stage(stage: Stage, loaded: bool) -> tuple[Check, Check]:
    e, radius, shortening, stiffness, torque = stage
    possible = (radius > 0) & (shortening < 1)
    if loaded:
        possible &= (e > 0) & (shortening > 0) & (stiffness > 0)
    # Fourth powers of lengths over the radius, and forces, are formed on the way: they must not overflow.
    size = jnp.where(possible, radius, 1)
    force = torque / jnp.where(possible & (e > 0), jnp.minimum(e, size), 1) if loaded else 0
    ratio = (jnp.abs(e) + jnp.abs(force) / jnp.where(possible, stiffness, 1)) / size
    finite = jnp.isfinite(ratio**4 + force * force + radius**4 + shortening + stiffness + torque)
    finite &= size > window(size, 0.25)[0]  # nor vanish; as squares of forces must not, which give their direction
    finite &= (torque == 0) | (jnp.abs(torque) > 1e6 * window(size, 0.5)[0] * jnp.maximum(size, 1))
    return (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)


def _judge_parts(parts: Parts, radius: jax.Array) -> list[Check]:
    finite = jnp.isfinite((sum(jnp.abs(x) for x in jax.tree.leaves(parts)) / radius) ** 4)
    for phase in parts.psi:
        finite &= jnp.abs(phase) < LARGEST_ANGLE
    checks = [(~finite, Status.NONFINITE)]
    if len(parts.carrier) == 2:
        frame = 2 * radius + sum(radial for radial, _ in parts.carrier)  # l4'
        checks.append((~(frame > 0), Status.INVALID_GEOMETRY))
    return checks


def exact_direction(halves: int, count: int) -> Vector:
    """Cosine and sine of pi * halves / count, exact where they are 0 or +-1."""
    if (2 * halves) % count == 0:
        return ((1, 0), (0, 1), (-1, 0), (0, -1))[(2 * halves // count) % 4]
    return math.cos(math.pi * halves / count), math.sin(math.pi * halves / count)


def _unstack(array: jax.Array) -> list[Any]:
    """Nested lists of scalars. A split, unlike indexing, is transposed into one concatenation."""
    items: list[Any] = [part.reshape(()) for part in jax.lax.split(array.reshape(-1), (1,) * array.size)]
    for size in array.shape[:0:-1]:
        items = [items[i : i + size] for i in range(0, len(items), size)]
    return items
