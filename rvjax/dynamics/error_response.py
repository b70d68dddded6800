"""Dynamic transmission error: the errors of one unit carried to speed, resonance and load inertia.

First order holds the errors alone, springs at their mean stiffness: B_n = T(n Om) g_n, linear in the errors, with T
free of them. Harmonic balance (error_balance.py) keeps the product with the varying mesh stiffness.

Lines of a batch of units over many speeds, and the largest of each: a product with a matrix that all units share.

The lines of a unit are many more numbers than its peaks. So the units go block by block, small enough for the cache,
and the derivative of a peak takes the speed of the peak alone.
"""

from collections.abc import Callable, Sequence
from functools import partial
from math import gcd, lcm

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import root
from rvjax._jax.kernels import folded, fori_loop
from rvjax._jax.sizes import LINES
from rvjax._reducer.plausible import checked
from rvjax.base.words import choose
from rvjax.designs import RVReducer
from rvjax.dynamics.error_balance import balance
from rvjax.dynamics.error_excitation import Case, Orders, Unit, case_of, error_orders, generators, read
from rvjax.dynamics.error_transfer import (
    Balanced,
    check_outputs,
    close,
    output_rows,
    output_speed,
    static_deflection,
    transfer,
)
from rvjax.dynamics.excitation import check_stage
from rvjax.dynamics.response import METHODS
from rvjax.errors import RVErrors
from rvjax.records import Array, PyTree, Record, Scalar, field, record, text
from rvjax.status import SolveInfo


def factors(value: jax.Array, excitation: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Real factors of the product of transfer (speeds, orders, outputs, springs) and excitation (orders, springs).

    Rows (orders, 2, speeds, outputs, 2 springs) give real and imaginary part: one product of real matrices runs several
    times as fast as the complex one.
    """
    value = jnp.moveaxis(value, 1, 0)
    rows = jnp.stack(
        [jnp.concatenate([value.real, -value.imag], axis=-1), jnp.concatenate([value.imag, value.real], axis=-1)],
        axis=1,
    )
    return rows, jnp.concatenate([excitation.real, excitation.imag], axis=-1)


def lines(rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Return the product (orders, 2, speeds, outputs).

    Args:
        rows: of `factors`.
        columns: likewise (orders, 2 springs), or (orders, 2 springs, batch), which becomes the last axis.
    """
    return jax.lax.dot_general(rows, columns, (((4,), (1,)), ((0,), (0,))))


@jax.custom_jvp
def largest(rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Largest |line|^2 over the speeds (orders, outputs), NaN if one is."""
    return _highest(rows, columns[None])[0]


@largest.defjvp
def _largest_jvp(primals: PyTree, tangents: PyTree) -> PyTree:
    (rows, columns), (rows_change, columns_change) = primals, tangents
    place = place_of_largest(rows, columns)[:, None, None, :, None]
    rows, rows_change = (jnp.take_along_axis(x, place, axis=2)[:, :, 0] for x in (rows, rows_change))
    columns, columns_change = (x[:, None, None] for x in (columns, columns_change))
    line = jnp.sum(rows * columns, axis=-1)
    change = jnp.sum(rows_change * columns + rows * columns_change, axis=-1)
    return jnp.sum(line**2, axis=1), 2 * jnp.sum(line * change, axis=1)


def place_of_largest(rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Index of the speed, the first of equal values."""
    rows, columns = jax.lax.stop_gradient((rows, columns))
    return _place(rows, columns[None])[0].astype(int)


def _of_units(of_block: Callable[[jax.Array], jax.Array]) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Return a function of all |line|^2 of a batch of units, in blocks of units whose lines stay in the cache.

    Args:
        of_block: of (orders, speeds, outputs, units) to (orders, outputs, units).

    Returns:
        Function of rows and columns (units, orders, 2 springs) to (units, orders, outputs); every vmap over errors
        alone joins the units.
    """

    def function(rows: jax.Array, columns: jax.Array) -> jax.Array:
        units, columns = len(columns), jnp.moveaxis(columns, 0, -1)
        block = min(max(32, LINES // (rows.size // rows.shape[-1]) // 8 * 8), units)

        def step(number: jax.Array, found: jax.Array) -> jax.Array:
            start = jnp.minimum(number * block, units - block)
            line = lines(rows, jax.lax.dynamic_slice_in_dim(columns, start, block, axis=-1))
            square = jnp.square(line[:, 0]) + jnp.square(line[:, 1])
            return jax.lax.dynamic_update_slice_in_dim(found, of_block(square), start, axis=-1)

        found = jnp.zeros((rows.shape[0], rows.shape[3], units), columns.dtype)
        return jnp.moveaxis(fori_loop(0, -(-units // block), step, found), -1, 0)

    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _rule(size: int, is_batched: list[bool], rows: jax.Array, columns: jax.Array) -> tuple[jax.Array, bool]:
        if is_batched[0]:  # different designs
            return jax.vmap(function, (0, 0 if is_batched[1] else None))(rows, columns), True
        found = batched(rows, columns.reshape(-1, *columns.shape[2:]))
        return found.reshape(size, -1, *found.shape[1:]), True

    return batched


def _first(square: jax.Array) -> jax.Array:
    """Index of the largest value along axis 1, the first of equal values.

    Values travel with their places: XLA may compute a value again for another reader, with another rounding.
    """
    place = jnp.broadcast_to(jnp.arange(square.shape[1], dtype=square.dtype)[:, None, None], square.shape)
    while (count := square.shape[1]) > 1:
        half = (count + 1) // 2  # of an odd number, both halves hold the middle
        ends = [jax.lax.slice_in_dim(x, i, i + half, axis=1) for x in (square, place) for i in (0, count - half)]
        second = (ends[0] < ends[1]) | ((ends[0] == ends[1]) & (ends[3] < ends[2]))
        square, place = jnp.where(second, ends[1], ends[0]), jnp.where(second, ends[3], ends[2])
    return jax.lax.squeeze(place, (1,))


_highest = _of_units(lambda square: folded(square, 1, by=jnp.maximum))
_place = _of_units(_first)


@record
class DynamicError(Record):
    """Vibration of the rotations of one unit, q(theta) = Re sum_n amplitude_n e^{i n theta}, theta the output angle."""

    order: Array = field("-", "n of each line, per output turn", shape=("orders",))
    frequency: Array = field("Hz", "of each line", shape=("orders",))
    amplitude: Array = field("rad", "complex amplitude of each line and output", shape=("orders", "outputs"))
    static: Array = field("rad", "transmission error at standstill", shape=("orders", "outputs"))
    peak_to_peak: Array = field("rad", "of all lines together, each output", shape=("outputs",))
    outputs: tuple[str, ...] = text("names of the outputs")
    info: SolveInfo = field("-", "residual of the solves; CONVERGED, SINGULAR, ...", kind="record")


@record
class SpeedSweep(Record):
    """Lines of one unit over a range of speeds."""

    order: Array = field("-", "n of each line, per output turn", shape=("orders",))
    amplitude: Array = field("rad", "complex amplitude", shape=("speeds", "orders", "outputs"))
    peak: Array = field("rad", "largest size of each line over the speeds", shape=("orders", "outputs"))
    peak_speed: Array = field("rad/s", "speed of the sun at which it occurs", shape=("orders", "outputs"))
    outputs: tuple[str, ...] = text("names of the outputs")
    info: SolveInfo = field("-", "residual of the solves; CONVERGED, SINGULAR, ...", kind="record")


@checked
def transmission_error(
    design: RVReducer,
    errors: RVErrors,
    *,
    sun_speed: Scalar,
    load_inertia: Scalar = 0.0,
    outputs: Sequence[str] = ("output.rotation",),
    pin_harmonics: int = 8,
    method: str = "first_order",
    stage: str = "planetary",
    harmonics: int = 8,
    output_torque: Scalar = 0.0,
) -> DynamicError:
    """Dynamic transmission error of one unit at one speed.

    Args:
        design: a reducer with inertia and stiffness, two or more discs, members alike.
        errors: of its parts; those of `error_excitation` are read, by harmonic balance sun_runout as well.
        sun_speed: () rad/s, of either sign; 0 is the static limit.
        load_inertia: of what the output drives, () kg m2.
        outputs: of "output.rotation", "sun.rotation" and "transmission_error" (output less sun over the ratio).
        pin_harmonics: as in `error_excitation`.
        method: "first_order": the errors alone. "harmonic_balance": errors, load and the varying mesh stiffness of one
            stage together; its products reach further orders.
        stage: whose meshes vary (harmonic balance): "planetary" or "cycloid".
        harmonics: of the mesh frequency that are kept on either side of an order (harmonic balance).
        output_torque: external torque on the output, () N m; negative opposes (harmonic balance).

    Returns:
        DynamicError. SINGULAR where an undamped mode is met to rounding, or at standstill without a torsion spring; NaN
        for INVALID_GEOMETRY (radii or masses not positive, no proper cycloid) and NONFINITE.

    Raises:
        ValueError: unknown output, method or stage, harmonics below 1 or below those of an error, one disc, members
            that differ, errors that do not fit the design, or as `rvjax.dynamics.lump`.
    """
    case, outputs = case_of(design, errors, pin_harmonics, load_inertia), check_outputs(outputs)
    check_stage(stage)
    choose("method", method, METHODS)
    if harmonics < 1:
        raise ValueError(f"harmonics = {harmonics}: must be at least 1")
    if method == "first_order":  # the other conditions are not read
        return _transmission_error(case, sun_speed, 0.0, outputs, pin_harmonics, None, 1)
    return _transmission_error(case, sun_speed, output_torque, outputs, pin_harmonics, stage, harmonics)


@partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _transmission_error(
    case: Case,
    sun_speed: Array,
    output_torque: Array,
    outputs: tuple[str, ...],
    pin_harmonics: int,
    stage: str | None,
    harmonics: int,
) -> DynamicError:
    unit, (sun_speed, output_torque) = read(case, sun_speed, output_torque)
    speed = output_speed(unit.lumped, sun_speed)
    if stage is None:
        found = _first_order(unit, speed, outputs, pin_harmonics)
    else:
        found = balance(unit, speed, output_torque, outputs, pin_harmonics, stage, harmonics)
    n = jnp.asarray([float(order) for order in found.orders], speed.dtype)
    frequency = n * jnp.abs(speed) / (2 * jnp.pi)
    values = (n, frequency, found.amplitude, found.static, curve_range(found.orders, found.amplitude))
    (n, frequency, amplitude, static, whole), info = close(unit, values, found.amplitude, found)
    return DynamicError(n, frequency, amplitude, static, whole, outputs, info)


def _first_order(unit: Unit, speed: jax.Array, outputs: tuple[str, ...], pin_harmonics: int) -> Balanced:
    """Lines of the errors without load, at output speed `speed`, () rad/s."""
    orders = error_orders(unit, pin_harmonics)
    n = jnp.asarray([float(order) for order in orders], speed.dtype)
    excitation, _ = generators(unit, orders, pin_harmonics)
    rows = output_rows(unit.lumped, outputs)
    found = transfer(unit.lumped, n * speed, rows)
    amplitude = jnp.einsum("kos,ks->ko", found.value, excitation)
    static = excitation @ (rows @ static_deflection(unit.lumped)[0]).T.astype(excitation.dtype)
    return Balanced(orders, amplitude, static, found.singular, found.residual)


def curve_range(orders: Orders, amplitude: jax.Array) -> jax.Array:
    """Range of the sum of all lines (outputs,), on 2^k >= max(256, 16 n_max / g) angles of the period 2 pi / g."""
    whole = lcm(*(n.denominator for n in orders))
    numbers = [int(n * whole) for n in orders]
    places = np.array(numbers) // gcd(*numbers)
    samples = 1 << (max(256, 16 * int(places.max())) - 1).bit_length()
    spectrum = jnp.zeros((samples // 2 + 1, amplitude.shape[1]), amplitude.dtype)
    curve = jnp.fft.irfft(spectrum.at[places].set(amplitude * (samples / 2)), samples, axis=0)
    return jnp.max(curve, axis=0) - jnp.min(curve, axis=0)


@checked
def speed_sweep(
    design: RVReducer,
    errors: RVErrors,
    *,
    sun_speeds: Array | np.ndarray,
    load_inertia: Scalar = 0.0,
    outputs: Sequence[str] = ("output.rotation",),
    pin_harmonics: int = 8,
) -> SpeedSweep:
    """Lines of one unit over a range of speeds with their maxima; first order, one eigenproblem.

    Args:
        design: as in `transmission_error`.
        errors: as in `transmission_error`.
        sun_speeds: (speeds,) rad/s. A peak is found among these; at damping eta it is eta of its speed wide.
        load_inertia: as in `transmission_error`.
        outputs: as in `transmission_error`.
        pin_harmonics: as in `error_excitation`.

    Returns:
        SpeedSweep; a status holds for all speeds together.

    Raises:
        ValueError: sun_speeds that are no row of numbers, or as `transmission_error`.
    """
    case, outputs = case_of(design, errors, pin_harmonics, load_inertia), check_outputs(outputs)
    if np.ndim(sun_speeds) != 1 or np.shape(sun_speeds)[0] == 0:
        raise ValueError(f"sun_speeds: shape {np.shape(sun_speeds)}, expected (speeds,), at least one")
    return _sweep(case, sun_speeds, outputs, pin_harmonics)


@partial(jax.jit, static_argnums=(2, 3))
def _sweep(case: Case, sun_speeds: Array, outputs: tuple[str, ...], pin_harmonics: int) -> SpeedSweep:
    unit, (speeds,) = read(case, sun_speeds)
    orders = error_orders(unit, pin_harmonics)
    n = jnp.asarray([float(order) for order in orders], speeds.dtype)
    excitation, _ = generators(unit, orders, pin_harmonics)
    frequency = output_speed(unit.lumped, speeds)[:, None] * n[None, :]
    found = transfer(unit.lumped, frequency.ravel(), output_rows(unit.lumped, outputs))
    value = found.value.reshape(*frequency.shape, *found.value.shape[1:])
    rows, columns = factors(value, excitation)
    real, imaginary = jnp.moveaxis(lines(rows, columns), (1, 2), (0, 1))
    square = largest(rows, columns)
    peak = root(square)
    values = (n, jax.lax.complex(real, imaginary), peak, speeds[place_of_largest(rows, columns)])
    (n, amplitude, peak, peak_speed), info = close(unit, values, peak, found)
    return SpeedSweep(n, amplitude, peak, peak_speed, outputs, info)
