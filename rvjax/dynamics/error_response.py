"""Dynamic transmission error: the errors of one unit carried to speed, resonance and load inertia.

First order holds the errors alone, springs at their mean stiffness: B_n = T(n Om) g_n, linear in the errors, with T
free of them. Harmonic balance (error_balance.py) keeps the product with the varying mesh stiffness.
"""

from collections.abc import Sequence
from functools import partial
from math import gcd, lcm

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import choose
from rvjax.catalogue import checked
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
from rvjax.dynamics.excitation import STAGES
from rvjax.dynamics.response import METHODS
from rvjax.errors import RVErrors
from rvjax.records import Array, Record, Scalar, field, record, text
from rvjax.status import SolveInfo


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
    choose("stage", stage, STAGES)
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
        solution = _first_order(unit, speed, outputs, pin_harmonics)
    else:
        solution = balance(unit, speed, output_torque, outputs, pin_harmonics, stage, harmonics)
    n = jnp.asarray([float(order) for order in solution.orders], speed.dtype)
    frequency = n * jnp.abs(speed) / (2 * jnp.pi)
    values = (n, frequency, solution.amplitude, solution.static, curve_range(solution.orders, solution.amplitude))
    (n, frequency, amplitude, static, whole), info = close(unit, values, solution.amplitude, solution)
    return DynamicError(n, frequency, amplitude, static, whole, outputs, info)


def _first_order(unit: Unit, speed: jax.Array, outputs: tuple[str, ...], pin_harmonics: int) -> Balanced:
    """Lines of the errors without load, at output speed `speed`, () rad/s."""
    orders = error_orders(unit, pin_harmonics)
    n = jnp.asarray([float(order) for order in orders], speed.dtype)
    excitation, _ = generators(unit, orders, pin_harmonics)
    rows = output_rows(unit.lumped, outputs)
    solution = transfer(unit.lumped, n * speed, rows)
    amplitude = jnp.einsum("kos,ks->ko", solution.value, excitation)
    static = excitation @ (rows @ static_deflection(unit.lumped)[0]).T.astype(excitation.dtype)
    return Balanced(orders, amplitude, static, solution.singular, solution.residual)


def curve_range(orders: Orders, amplitude: jax.Array) -> jax.Array:
    """Range of the sum of all lines (outputs,), on 2^k >= max(256, 16 n_max / g) angles of the period 2 pi / g."""
    whole = lcm(*(n.denominator for n in orders))
    numbers = [int(n * whole) for n in orders]
    places = np.array(numbers) // gcd(*numbers)
    samples = 1 << (max(256, 16 * int(places.max())) - 1).bit_length()
    spectrum = jnp.zeros((samples // 2 + 1, amplitude.shape[1]), amplitude.dtype)
    curve = jnp.fft.irfft(spectrum.at[places].set(amplitude * (samples / 2)), samples, axis=0)
    return jnp.max(curve, axis=0) - jnp.min(curve, axis=0)
