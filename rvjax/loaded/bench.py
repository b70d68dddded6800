"""Values of a test bench for a whole reducer: its torque-angle curve, and the reading of an encoder at the output.

The curve has backlash and lost motion as makers measure them. The reading is the transmission error and what the
deformed housing adds to it: the head is fixed to the ring of pins. The pins ovalise the ring, the couple of the discs
tilts the carrier, and the cranks dent its flange, so that head and scale move although the output does not.
Derivation: docs/models/reading.md.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax._jax.programs import quick
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import RVReducer, expect
from rvjax.loaded.case import at_output, output_rotation, solve
from rvjax.loaded.equilibrium import Loaded, admit, check_input, prepare
from rvjax.loaded.geometry import Geometry, Turn, geometry, turn
from rvjax.loaded.newton import Minimum
from rvjax.loaded.system import Layout
from rvjax.records import Array, PyTree, Record, Scalar, field, is_concrete, quantity, record
from rvjax.roots import solved
from rvjax.status import SolveInfo, succeeded, worst_of

SHARES = (1.0, 0.5, 0.03, 1e-3)
"""Shares of the rated torque, at either sign. The least is the probe torque: the limit of no torque."""


@record
class Torsion(Record):
    """Torque-angle curve at one input angle."""

    torque: Array = field("N m", "torque of the discs on the carrier, ascending", shape=(8,))
    angle: Array = field("rad", "rotation of the carrier against the ideal motion", shape=(8,))
    backlash: Array = field("rad", "error(-probe) - error(+probe), probe = 1e-3 of rated")
    lost_motion: Array = field("rad", "error(-3 %) - error(+3 %)")
    stiffness: Array = field("N m/rad", "secant between half and full rated torque")
    info: SolveInfo = field("-", "the worst of the eight; steps: all", kind="record")


@checked
def torsion(
    design: Reducer,
    errors: ReducerErrors,
    *,
    input_angle: Scalar,
    rated_torque: Scalar,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Torsion:
    """Equilibria at +-(0.1, 3, 50, 100 %) of the rated torque, and the values of a test bench.

    Args:
        design: as in `equilibrium`.
        errors: as in `equilibrium`.
        input_angle: at which the sun is held, () rad.
        rated_torque: () N m, > 0.
        contact: as in `equilibrium`.
        carrier: as in `equilibrium`.
        sun: as in `equilibrium`.

    Returns:
        Torsion; all values NaN where one of the eight equilibria has none.

    Raises:
        ValueError: as `equilibrium`.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    return _torsion(layout, design, errors, input_angle, rated_torque)


@quick(0)
def _torsion(layout: Layout, design: Record, errors: Record, input_angle: Scalar, rated_torque: Scalar) -> Torsion:
    error, info = twisted(layout, design, errors, input_angle, rated_torque, SHARES)
    rated = jnp.asarray(rated_torque, error.dtype)
    torque = rated * jnp.asarray([[-share, share] for share in SHARES], error.dtype)
    gone = error[:, 0] - error[:, 1]
    return Torsion(
        torque=_ascending(torque),
        angle=_ascending(error),
        backlash=gone[3],
        lost_motion=gone[2],
        stiffness=secant(error[0, 1], error[1, 1], rated),
        info=info,
    )


def secant(at_rated: jax.Array, at_half: jax.Array, rated_torque: Scalar) -> jax.Array:
    """Stiffness between half and full rated torque, N m/rad.

    Args:
        at_rated: rotation under the rated torque, rad.
        at_half: rotation under half of it, rad.
        rated_torque: N m.
    """
    return jnp.asarray(0.5 * rated_torque / (at_half - at_rated))


@quick(0)
def twisted(
    layout: Layout,
    design: PyTree,
    errors: PyTree,
    input_angle: Scalar,
    rated_torque: Scalar,
    shares: Sequence[float],
) -> tuple[jax.Array, SolveInfo]:
    """Rotation of the carrier at some shares of the rated torque, of either sign, each from the one before.

    Args:
        layout: counts and methods.
        design: as in `equilibrium`.
        errors: as in `equilibrium`.
        input_angle: () rad.
        rated_torque: () N m.
        shares: of the rated torque, (n,) descending.

    Returns:
        Rotations (n, 2) rad, under the negative and the positive torque, NaN where one of them has no equilibrium; and
        the worst of their infos.
    """
    read = admit(layout, design, errors, rated_torque, input_angle)
    case = prepare(layout, read, read.angle)
    sides = read.torque * jnp.asarray([-1.0, 1.0], read.torque.dtype)
    sizes = jnp.asarray(shares, read.torque.dtype)

    def lower(start: jax.Array, share: jax.Array) -> tuple[jax.Array, tuple[Minimum, SolveInfo]]:
        """Both signs at one size of the torque, from the solutions at the one before."""
        minima, info = jax.vmap(lambda torque, start: solve(layout, read, case.on_bench(torque), start))(
            sides * share, start
        )
        return jnp.where(succeeded(info.status)[:, None], minima.q, jnp.nan), (minima, info)

    cold = jnp.full((2, layout.unknowns), jnp.nan, sides.dtype)
    minima, infos = solved(scan(lower, cold, sizes)[1])

    def angle(torque: jax.Array, minima: Minimum, status: jax.Array) -> jax.Array:
        loaded = case.on_bench(torque)
        return output_rotation(layout, loaded, at_output(layout, loaded, minima, status))

    error = jax.vmap(jax.vmap(angle))(sizes[:, None] * sides[None], minima, infos.status)  # (n, 2)
    whole = worst_of(infos)
    return jnp.where(succeeded(whole.status), error, jnp.nan), whole.replace(steps=jnp.sum(infos.steps))


def _ascending(pairs: jax.Array) -> jax.Array:
    """(4, 2) [size falling, sign] in ascending order of the torque, (8,)."""
    return jnp.concatenate([pairs[:, 0], pairs[::-1, 1]])


@record
class Reading(Record):
    """Encoder at the output: the place of its heads, and gains from forces to motions of head and scale."""

    radius: Scalar = field("m", "radius of the scale", sign="positive")
    heads: PyTree = field(
        "rad",
        "direction of each head, fixed to the ring, counter-clockwise from pin 0; their mean is read",
        shape=("heads",),
        default=(0.0,),
    )
    ring_gain: Scalar = field("m/N", "radial amplitude of the oval ring per modal force, 1/k_2", default=0.0)
    tilt_gain: Scalar = field("rad/(N m)", "tilt of the carrier per couple of the discs, 1/K_t", default=0.0)
    height: Scalar = field("m", "height of the scale above the centre of tilt", default=0.0)
    disc_position: PyTree = field(
        "m", "axial place of each disc; needed where tilt_gain is given", shape=("discs",), default=None
    )
    dent: Scalar = field("rad/(N m)", "order 3 per output torque, three cranks that dent the flange, c3", default=0.0)
    scale_eccentricity: PyTree = field(
        "m", "centre of the scale against the axis of the carrier, x, y in its frame", shape=(2,), kind="pair",
        default=(0.0, 0.0),
    )  # fmt: skip

    def _check(self) -> None:
        if 0 in np.shape(self.heads):
            raise ValueError("Reading.heads = []: must have one angle or more, rad; give one for each head")
        if self.disc_position is None and is_concrete(self.tilt_gain) and np.any(np.asarray(self.tilt_gain) != 0):
            raise ValueError(
                f"Reading.tilt_gain = {quantity(self.tilt_gain, 'rad/(N m)')}: needs disc_position; "
                "give the axial place of each disc, m"
            )


@checked
def reading(
    found: Loaded, design: RVReducer, reading: Reading, *, input_angle: Scalar, output_torque: Scalar
) -> jax.Array:
    """Angle that an encoder reads in an equilibrium, less the ideal motion: () rad, > 0 ahead.

    The deformation of the housing is evaluated from the forces of the equilibrium and does not change them. The
    direction of a pin force is taken with the nominal eccentricity. Derived in this project: docs/models/reading.md,
    Eqs. 2-7.

    Args:
        found: of `equilibrium`, one case; batches come from `jax.vmap`.
        design: that of `found`.
        reading: the encoder.
        input_angle: that of `found`, () rad.
        output_torque: that of `found`, () N m.

    Returns:
        NaN where `found` has no value, where a number of the encoder is not finite or its radius not positive, and
        where a traced `tilt_gain` other than 0 lacks `disc_position`.

    Raises:
        ValueError: an argument of another kind, or an array whose shape does not fit the design.
    """
    expect(design, "loaded.reading", RVReducer)
    for name, given, kind in (("found", found, Loaded), ("reading", reading, Reading)):
        if not isinstance(given, kind):
            raise ValueError(f"{name} = {type(given).__name__}: must be of kind rvjax.loaded.{kind.__name__}")
    reading._check()
    discs, pins = design.cycloid.disc_count, design.cycloid.pin_count
    value: object
    for name, value, sizes, alone in (
        ("Loaded.pins", found.pins, (discs, pins), False),
        ("Reading.heads", reading.heads, np.shape(reading.heads)[-1:], True),
        ("Reading.disc_position", reading.disc_position, (discs,), discs == 1),
        ("Reading.scale_eccentricity", reading.scale_eccentricity, (2,), False),
    ):
        shape = (len(value),) if isinstance(value, tuple) else np.shape(value)  # a pair may hold tracers
        if value is not None and shape != sizes and not (alone and shape == ()):
            raise ValueError(f"{name}: shape {shape}: must be {sizes} for this design; batches come from jax.vmap")
    return _reading(found.error, found.pins, found.info.status, design, reading, input_angle, output_torque)


@quick()
def _reading(
    error: Array,
    pins: Array,
    status: Array,
    design: RVReducer,
    reading: Reading,
    input_angle: Scalar,
    output_torque: Scalar,
) -> jax.Array:
    cycloid, dtype = design.cycloid, jnp.result_type(float, error, pins)
    given = (cycloid.eccentricity, cycloid.pin_circle_radius, error, pins, reading, input_angle, output_torque)
    numbers: PyTree = given
    good = succeeded(status) & (jnp.asarray(reading.radius) > 0)
    for leaf in jax.tree.leaves(numbers):
        good &= jnp.all(jnp.isfinite(leaf))
    if reading.disc_position is None:
        good &= jnp.asarray(reading.tilt_gain) == 0
    # Harmless numbers where there is no reading: no derivative of a failed case meets 0 * inf.
    numbers = jax.tree.map(lambda leaf: jnp.where(good, jnp.asarray(leaf, dtype), 0), numbers)
    e, circle, error, pins, reading, angle, torque = numbers
    circle = jnp.where(good, circle, cycloid.pin_count)
    e, radius = jnp.where(good, e, 0.5), jnp.where(good, reading.radius, 1)
    at = geometry(cycloid.replace(pin_circle_radius=circle), e, angle / design.ratio)

    # Force of the discs on a pin along -n, its parts outward and along J u.
    outward = -(at.normal[0] * at.pin.cosine[None] + at.normal[1] * at.pin.sine[None])
    along = at.normal[0] * at.pin.sine[None] - at.normal[1] * at.pin.cosine[None]
    place = 4 * np.pi * np.arange(cycloid.pin_count) / cycloid.pin_count  # 2 phi
    cosine, sine = (jnp.asarray(x, dtype)[None] for x in (np.cos(place), np.sin(place)))
    gain = jnp.asarray(reading.ring_gain)
    oval = (  # Eq. 4
        gain * jnp.sum(pins * (outward * cosine - along * sine / 2)),
        gain * jnp.sum(pins * (outward * sine + along * cosine / 2)),
    )
    tilt = jnp.zeros((2,), dtype)
    if reading.disc_position is not None:  # Eq. 5: the force of a disc on the ring is that on its pins, -n F
        disc_on_ring = -jnp.stack([jnp.sum(normal * pins, axis=1) for normal in at.normal])
        tilt = -jnp.asarray(reading.tilt_gain) * jnp.sum(
            jnp.atleast_1d(reading.disc_position)[None] * disc_on_ring, axis=1
        )
    return jnp.where(good, error + _mean_of_heads(reading, radius, at, oval, tilt, torque), jnp.nan)


def _mean_of_heads(
    reading: Reading, radius: jax.Array, at: Geometry, oval: tuple[Array, Array], tilt: jax.Array, torque: jax.Array
) -> jax.Array:
    """Contribution of the heads to the error, Eqs. 2, 3, 6, 7."""
    head = turn(jnp.atleast_1d(reading.heads))
    seen = Turn(*at.carrier.back.of(head.cosine, head.sine))  # u(head - th)
    double_cosine, double_sine = head.cosine * head.cosine - head.sine * head.sine, 2 * head.sine * head.cosine
    ring = (oval[1] * double_cosine - oval[0] * double_sine) / 2
    moved = [reading.height * t + s for t, s in zip(tilt, reading.scale_eccentricity)]
    scale = moved[1] * seen.cosine - moved[0] * seen.sine  # . J u(head - th)
    dent = reading.dent * torque * seen.cosine * (4 * seen.cosine * seen.cosine - 3)  # cos 3x = 4 cos^3 x - 3 cos x
    return jnp.mean((scale - ring) / radius - dent)


def housing_orders(design: RVReducer, harmonic: int, most: int = 240) -> tuple[int, ...]:
    """Orders of the output turn that a harmonic of the housing excites with equal cranks, ascending.

    A reducer without errors of parts is the same after a turn of carrier and cranks by 360 deg / cranks. A
    disturbance fixed in the housing with m periods round it therefore appears only at the orders |zp P - m| with
    P = m (mod cranks). Eq. 1 of docs/models/reading.md.

    Args:
        design: counts of pins and cranks are read.
        harmonic: m, periods round the housing: stiffness, shift, ovality, or a place such as that of a head.
        most: largest order.

    Raises:
        ValueError: a design of another kind, harmonic < 0 or most < 0, or one that is no integer.
    """
    expect(design, "loaded.housing_orders", RVReducer)
    for name, value in (("harmonic", harmonic), ("most", most)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
            raise ValueError(f"{name} = {value!r}: must be an integer of at least 0")
    pins, cranks = design.cycloid.pin_count, design.cranks.count
    farthest = (most + harmonic) // pins + 1
    turns = (p for p in range(-farthest, farthest + 1) if (p - harmonic) % cranks == 0)
    return tuple(sorted({order for p in turns if (order := abs(pins * p - int(harmonic))) <= most}))
