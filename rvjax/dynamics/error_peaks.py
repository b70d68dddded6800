"""Dynamic transmission error of one unit at the worst of a range of speeds.

An order n meets the rotational mode r at the output speed w_r / n, in a peak as wide as the damping of the mode. To an
even grid over the range come the speeds of those crossings and their neighbours at a quarter of that width, so that
no peak is missed however sharp it is. The speeds move with the modes, and their derivatives with them.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import root
from rvjax._reducer.plausible import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped
from rvjax.dynamics.error_excitation import Case, Orders, case_of, error_orders, generators, read
from rvjax.dynamics.error_response import curve_range
from rvjax.dynamics.error_transfer import KEY, close, output_rows, output_speed, transfer
from rvjax.dynamics.modal import modal_sectors
from rvjax.errors import RVErrors
from rvjax.records import Array, Record, Scalar, concrete, field, record
from rvjax.status import SolveInfo

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
    found = transfer(unit.lumped, frequency.ravel(), output_rows(unit.lumped, ("output.rotation",)))
    excitation, _ = generators(unit, orders, pin_harmonics)
    amplitude = jnp.einsum("qks,ks->qk", found.value.reshape(*frequency.shape, -1), excitation)
    square = jnp.square(amplitude.real) + jnp.square(amplitude.imag)

    # None of the others can exceed twice its own sum of sizes; close to a resonance one line is nearly all.
    bound = jnp.sum(jnp.sqrt(jax.lax.stop_gradient(square)), axis=1)
    places = jax.lax.top_k(bound, min(JUDGED, len(bound)))[1]
    whole = curve_range(orders, amplitude[places].T)
    worst = jnp.argmax(whole)
    power = jnp.sum(square * frequency**4, axis=1) / 2
    loudest = jnp.argmax(power)
    figures = (whole[worst], sun_speeds[places[worst]], root(power[loudest]), sun_speeds[loudest], sun_speeds)
    (peak, at, loud, loud_at, speeds), info = close(unit, figures, amplitude, found)
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
