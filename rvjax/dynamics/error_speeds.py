"""Dynamic transmission error of one unit over many speeds: a sweep, and the worst of a range.

The lines of a batch of units are a product with a matrix that all units share. They are many more numbers than their
peaks. So the units go block by block, small enough for the cache, and the derivative of a peak takes the speed of the
peak alone.

In a range, an order n meets the rotational mode r at the output speed w_r / n, in a peak as wide as the damping of the
mode. To an even grid come the speeds of those crossings and their neighbours at a quarter of that width, so that no
peak is missed however sharp it is. The speeds move with the modes, and their derivatives with them.
"""

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import root
from rvjax._jax.kernels import folded, fori_loop
from rvjax._jax.sizes import LINES
from rvjax.catalogue import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped
from rvjax.dynamics.error_excitation import Case, Orders, case_of, error_orders, generators, read
from rvjax.dynamics.error_response import curve_range
from rvjax.dynamics.error_transfer import KEY, check_outputs, close, output_rows, output_speed, transfer
from rvjax.dynamics.modes import modal_sectors
from rvjax.errors import RVErrors
from rvjax.records import Array, Record, Scalar, concrete, field, record, text
from rvjax.status import SolveInfo


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
    solution = transfer(unit.lumped, frequency.ravel(), output_rows(unit.lumped, outputs))
    value = solution.value.reshape(*frequency.shape, *solution.value.shape[1:])
    rows, columns = factors(value, excitation)
    real, imaginary = jnp.moveaxis(lines(rows, columns), (1, 2), (0, 1))
    square = largest(rows, columns)
    peak = root(square)
    values = (n, jax.lax.complex(real, imaginary), peak, speeds[place_of_largest(rows, columns)])
    (n, amplitude, peak, peak_speed), info = close(unit, values, peak, solution)
    return SpeedSweep(n, amplitude, peak, peak_speed, outputs, info)


BESIDE = np.arange(-2, 3) / 4
"""Places about a crossing, in widths of the peak. A lone mode of a loss factor peaks at the crossing; a peak that its
neighbours or other damping move by up to half a width is at most an eighth of a width from a place: its height is met
to 3 %."""
MODES = 3  # of each order, the lowest that it meets within the range; higher ones move the output too little to count
JUDGED = 8  # speeds whose peak to peak is computed: those where the sizes of all lines have the largest sum


@record
class SpeedRange(Record):
    """The worst that the errors of one unit make of the output's rotation over a range of speeds."""

    peak_to_peak: Array = field("rad", "largest over the speeds, all lines together")
    peak_to_peak_speed: Array = field("rad/s", "speed of the sun at which it occurs")
    acceleration: Array = field("rad/s2", "root mean square over time, largest over the speeds")
    acceleration_speed: Array = field("rad/s", "speed of the sun at which it occurs")
    sun_speeds: Array = field("rad/s", "all speeds that were looked at, ascending", shape=("speeds",))
    info: SolveInfo = field("-", "residual of the solves; CONVERGED, SINGULAR, ...", kind="record")


@checked
def speed_range(
    design: RVReducer,
    errors: RVErrors,
    *,
    slowest_sun_speed: Scalar,
    fastest_sun_speed: Scalar,
    load_inertia: Scalar = 0.0,
    speeds: int = 40,
    pin_harmonics: int = 8,
) -> SpeedRange:
    """Largest peak to peak and vibration of the output over a range of speeds; first order, one eigenproblem.

    Args:
        design: as in `transmission_error`.
        errors: as in `transmission_error`.
        slowest_sun_speed: one end of the range, () rad/s, of either sign.
        fastest_sun_speed: the other end, () rad/s.
        load_inertia: as in `transmission_error`.
        speeds: of the even grid over the range; crossings of orders and modes within it are added.
        pin_harmonics: as in `error_excitation`.

    Returns:
        SpeedRange, differentiable. SINGULAR where an order meets an undamped mode within the range; other statuses as
        `transmission_error`.

    Raises:
        ValueError: fewer than two speeds, or as `transmission_error`.
    """
    case = case_of(design, errors, pin_harmonics, load_inertia)
    if speeds < 2:
        raise ValueError(f"speeds = {speeds}: a range needs at least 2")
    ends = (slowest_sun_speed, fastest_sun_speed)
    one_sense = concrete(*ends) and float(slowest_sun_speed) * float(fastest_sun_speed) >= 0
    return _range(case, *ends, speeds, pin_harmonics, one_sense)


@partial(jax.jit, static_argnums=(3, 4, 5))
def _range(case: Case, slowest: Array, fastest: Array, count: int, pin_harmonics: int, one_sense: bool) -> SpeedRange:
    unit, (slowest, fastest) = read(case, slowest, fastest)
    orders = error_orders(unit, pin_harmonics)
    sun_speeds = refine_speeds(unit.lumped, orders, slowest, fastest, count, one_sense)
    n = jnp.asarray([float(order) for order in orders], sun_speeds.dtype)
    frequency = output_speed(unit.lumped, sun_speeds)[:, None] * n[None, :]
    solution = transfer(unit.lumped, frequency.ravel(), output_rows(unit.lumped, ("output.rotation",)))
    excitation, _ = generators(unit, orders, pin_harmonics)
    amplitude = jnp.einsum("qks,ks->qk", solution.value.reshape(*frequency.shape, -1), excitation)
    square = jnp.square(amplitude.real) + jnp.square(amplitude.imag)

    # None of the others can exceed twice its own sum of sizes; close to a resonance one line is nearly all.
    bound = jnp.sum(jnp.sqrt(jax.lax.stop_gradient(square)), axis=1)
    places = jax.lax.top_k(bound, min(JUDGED, len(bound)))[1]
    whole = curve_range(orders, amplitude[places].T)
    worst = jnp.argmax(whole)
    power = jnp.sum(square * frequency**4, axis=1) / 2
    loudest = jnp.argmax(power)
    figures = (whole[worst], sun_speeds[places[worst]], root(power[loudest]), sun_speeds[loudest], sun_speeds)
    (peak, at, loud, loud_at, speeds), info = close(unit, figures, amplitude, solution)
    return SpeedRange(peak, at, loud, loud_at, speeds, info)


def refine_speeds(
    lumped: Lumped, orders: Orders, first: jax.Array, second: jax.Array, count: int, one_sense: bool
) -> jax.Array:
    """Speeds of the sun between both ends, ascending: an even grid, and crossings with their neighbours.

    Crossings beyond the range move to its ends. A range through rest has crossings in both senses of rotation.
    """
    low, high = jnp.minimum(first, second), jnp.maximum(first, second)
    even = low + (high - low) * jnp.asarray(np.linspace(0, 1, count), low.dtype)
    turns = output_speed(lumped, jnp.ones_like(low))
    n = jnp.asarray([float(order) for order in orders], low.dtype)[:, None] * turns  # excited, for one of the sun
    mode = _modes(lumped)[None, :]
    fastest = jnp.maximum(jnp.abs(low), jnp.abs(high))
    slowest = jnp.where(low * high > 0, jnp.minimum(jnp.abs(low), jnp.abs(high)), 0)
    within = (n * slowest <= mode) & (mode <= n * fastest)
    mode = jnp.sort(jnp.where(within, mode, jnp.inf), axis=1)[:, :MODES]
    mode = jnp.where(jnp.isfinite(mode), mode, n * fastest)
    damping, known = lumped.damping, jnp.where(mode > 0, mode, 1)
    width = damping.loss_factor + damping.rayleigh_stiffness * mode + damping.rayleigh_mass / known
    width = width + 2 * damping.modal_ratio
    beside = 1 + width[:, :, None] * jnp.asarray(BESIDE, mode.dtype)[None, None, :]
    crossing = (mode[:, :, None] * beside / n[:, :, None]).ravel()
    crossing = jnp.where(low + high < 0, -crossing, crossing)
    both = crossing if one_sense else jnp.concatenate([crossing, -crossing])
    return jnp.sort(jnp.concatenate([even, jnp.clip(both, low, high)]))


def _modes(lumped: Lumped) -> jax.Array:
    """Angular frequencies of the rotational modes (11,), with first and second derivatives of simple eigenvalues."""
    modal = modal_sectors(lumped, [KEY])[KEY]
    matrix = modal.stiffness  # in a fixed basis, diagonal in value: perturbation of second order
    change = jnp.diagonal(matrix) + jnp.sum(jnp.square(matrix) * _inverse_distances(modal.square), axis=1)
    return root(modal.square + (change - jax.lax.stop_gradient(change)))


def _inverse_distances(square: jax.Array) -> jax.Array:
    """1 / (a - b) of every two eigenvalues (n,), and 0 where they are one."""
    apart = square[:, None] - square[None, :]
    near = jnp.abs(apart) <= jnp.sqrt(jnp.finfo(square.dtype).eps) * jnp.max(square)
    return jnp.where(near, 0, 1 / jnp.where(near, 1, apart))


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
def _largest_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
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

        def step(number: jax.Array, result: jax.Array) -> jax.Array:
            start = jnp.minimum(number * block, units - block)
            line = lines(rows, jax.lax.dynamic_slice_in_dim(columns, start, block, axis=-1))
            square = jnp.square(line[:, 0]) + jnp.square(line[:, 1])
            return jax.lax.dynamic_update_slice_in_dim(result, of_block(square), start, axis=-1)

        result = jnp.zeros((rows.shape[0], rows.shape[3], units), columns.dtype)
        return jnp.moveaxis(fori_loop(0, -(-units // block), step, result), -1, 0)

    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _rule(size: int, is_batched: list[bool], rows: jax.Array, columns: jax.Array) -> tuple[jax.Array, bool]:
        if is_batched[0]:  # different designs
            return jax.vmap(function, (0, 0 if is_batched[1] else None))(rows, columns), True
        result = batched(rows, columns.reshape(-1, *columns.shape[2:]))
        return result.reshape(size, -1, *result.shape[1:]), True

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
