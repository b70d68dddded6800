"""Dynamic transmission error of a series of units: its second moments in closed form.

The lines are linear in the errors, B_n = S_n x with S_n = T(n Om) X_n exact and X_n free of speed, so that independent
errors with zero mean and variances sigma^2 give E|B_n|^2 = sum |S_n|^2 sigma^2 and E B_n^2 = sum S_n^2 sigma^2.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.plausible import checked
from rvjax.base.fields import axis_sizes
from rvjax.designs import RVReducer
from rvjax.dynamics.error_excitation import Case, case_of, error_orders, generators, read
from rvjax.dynamics.error_transfer import check_outputs, close, output_rows, output_speed, transfer
from rvjax.errors import RVErrors, described, read_by
from rvjax.records import Array, Record, Scalar, field, is_concrete, record, text
from rvjax.status import SolveInfo


@record
class ErrorStatistics(Record):
    """Second moments of the lines of a series of units.

    |B| is the length of a plane vector whose covariance has the eigenvalues (power +- |pseudo_power|) / 2. Without a
    preferred phase, pseudo_power = 0, P(|B| > b) = exp(-b^2 / power) for normal errors: 99.73 % of the units lie below
    2.43 sqrt(power). The mean square of the vibration is the sum of power / 2 over the orders.
    """

    order: Array = field("-", "n of each line, per output turn", shape=("orders",))
    power: Array = field("rad2", "E|B|^2 of each line and output", shape=("orders", "outputs"))
    pseudo_power: Array = field("rad2", "E B^2, complex", shape=("orders", "outputs"))
    outputs: tuple[str, ...] = text("names of the outputs")
    info: SolveInfo = field("-", "residual of the solves; CONVERGED, SINGULAR, ...", kind="record")


@checked
def error_statistics(
    design: RVReducer,
    sigma: RVErrors,
    *,
    sun_speed: Scalar,
    load_inertia: Scalar = 0.0,
    outputs: Sequence[str] = ("output.rotation",),
    pin_harmonics: int = 8,
) -> ErrorStatistics:
    """Second moments of the dynamic transmission error of units with independent errors, first order.

    Args:
        design: as in `transmission_error`.
        sigma: standard deviations of the errors, zero mean, each independent; a scalar in an array field is that of
            every member.
        sun_speed: as in `transmission_error`.
        load_inertia: as in `transmission_error`.
        outputs: as in `transmission_error`.
        pin_harmonics: as in `error_excitation`.

    Returns:
        ErrorStatistics; statuses as `transmission_error`.

    Raises:
        ValueError: a negative standard deviation, or as `transmission_error`.
    """
    case, outputs = case_of(design, sigma, pin_harmonics, load_inertia), check_outputs(outputs)
    independent = case._replace(errors=_by_member(design, sigma))
    return _statistics(independent, sun_speed, outputs, pin_harmonics)


def _by_member(design: RVReducer, sigma: RVErrors) -> RVErrors:
    """Standard deviations with one number for each error; pins without any bring no orders."""
    full = {}
    declared = described(sigma, "shape")
    for name in read_by(sigma, "dynamics"):
        value = getattr(sigma, name)
        if is_concrete(value) and np.any(np.asarray(value) < 0):
            raise ValueError(f"RVErrors.{name}: a standard deviation must be zero or positive")
        sizes = axis_sizes(declared.get(name, ()), design.counts, np.shape(value))
        if sizes and not (is_concrete(value) and np.ndim(value) == 0 and value == 0):
            full[name] = jnp.broadcast_to(value, sizes)
    return sigma.replace(**full)


@partial(jax.jit, static_argnums=(2, 3))
def _statistics(case: Case, sun_speed: Array, outputs: tuple[str, ...], pin_harmonics: int) -> ErrorStatistics:
    unit, (sun_speed,) = read(case, sun_speed)
    orders = error_orders(unit, pin_harmonics)
    n = jnp.asarray([float(order) for order in orders], sun_speed.dtype)
    found = transfer(unit.lumped, n * output_speed(unit.lumped, sun_speed), output_rows(unit.lumped, outputs))

    def lines(errors: dict[str, jax.Array]) -> jax.Array:
        return generators(unit._replace(errors=errors), orders, pin_harmonics)[0]

    power = jnp.zeros(found.value.shape[:2], sun_speed.dtype)
    pseudo = jnp.zeros(found.value.shape[:2], found.value.dtype)
    for name, slope in jax.jacfwd(lines)(unit.errors).items():
        sensitivity = jnp.einsum("kos,ks...->ko...", found.value, slope)
        variance = jnp.square(unit.errors[name])[None, None]
        entries = tuple(range(2, sensitivity.ndim))
        real, imaginary = sensitivity.real, sensitivity.imag
        power += jnp.sum((real**2 + imaginary**2) * variance, axis=entries)
        square = jax.lax.complex((real**2 - imaginary**2) * variance, 2 * real * imaginary * variance)
        pseudo += jnp.sum(square, axis=entries)
    (n, power, pseudo), info = close(unit, (n, power, pseudo), power, found)
    return ErrorStatistics(n, power, pseudo, outputs, info)
