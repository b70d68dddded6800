"""Transfer from the displacement of a spring to the rotations of sun and output; statistics of many units.

Eleven coordinates, the rotations of the central parts and what is common to planets, cranks and discs, have constant
matrices although cranks revolve and eccentrics turn: cos and sin of the angles between them appear squared, in
pairs. So T(w) = C Z(w)^-1 A(w) needs one eigenproblem for all frequencies. Derivation: docs/models/dynamic_error.md.

The lines are linear in the errors, B_n = S_n x with S_n = T(n Om) X_n exact and X_n free of speed, so that independent
errors with zero mean and variances sigma^2 give E|B_n|^2 = sum |S_n|^2 sigma^2 and E B_n^2 = sum S_n^2 sigma^2.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.fields import axis_sizes
from rvjax.base.words import unknown
from rvjax.catalogue import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, loaded
from rvjax.dynamics.error_excitation import Case, Orders, Unit, case_of, error_orders, generators, read, symmetric
from rvjax.dynamics.modes import dynamic_stiffness, matrix_root, modal_sectors, modal_solve, on_resonance, residual
from rvjax.dynamics.static import MeanState, linear_ratio, mean_state, mesh_rows
from rvjax.dynamics.symmetry import sector_mass
from rvjax.errors import RVErrors, described, read_by
from rvjax.records import Array, PyTree, Record, Scalar, field, is_concrete, record, text
from rvjax.status import SolveInfo, Status, converged

ROTATIONS = ("output.rotation", "sun.rotation", "transmission_error")
KEY = ("rotational", 0)
_SUN, _HX, _HY, _HTH, _CX, _CY, _CTH, _OUTPUT = 0, 4, 5, 6, 7, 8, 9, 10  # p at 1 to 3


class Balanced(NamedTuple):
    """Lines of one unit at one speed."""

    orders: Orders
    amplitude: jax.Array  # (orders, outputs) complex
    static: jax.Array  # (orders, outputs) complex
    singular: jax.Array  # () bool
    residual: jax.Array  # ()


class Transfer(NamedTuple):
    """Response of the rotational coordinates to unit displacement of each spring."""

    value: jax.Array  # (F, rows, springs) complex
    singular: jax.Array  # () bool
    residual: jax.Array  # ()


@checked
def error_transfer(
    design: RVReducer | Lumped,
    *,
    frequency: Scalar,
    load_inertia: Scalar = 0.0,
    outputs: Sequence[str] = ("output.rotation",),
) -> jax.Array:
    """Amplitude of rotations for unit displacement of each spring, (outputs, springs) complex, rad/m.

    Args:
        design: a reducer with inertia and stiffness, two or more discs, members alike; or its lumped parameters.
        frequency: () Hz, of either sign: n times the turns of the output per second; 0 is the static limit.
        load_inertia: of what the output drives, () kg m2.
        outputs: of "output.rotation", "sun.rotation" and "transmission_error" (output less sun over the ratio).

    Returns:
        Columns in the order of `ErrorExcitation.springs`. NaN for input that is not finite or not possible, where an
        undamped mode is met to rounding, and at 0 Hz where no torsion spring holds the reducer.

    Raises:
        ValueError: unknown output, one disc, members that differ, or as `rvjax.dynamics.lump`.
    """
    return _error_transfer(symmetric(design), frequency, load_inertia, check_outputs(outputs))


@partial(jax.jit, static_argnums=3)
def _error_transfer(lumped: Lumped, frequency: Array, load_inertia: Array, outputs: tuple[str, ...]) -> jax.Array:
    lumped, (frequency,), gate = admitted(loaded(lumped, load_inertia), frequency)
    solution = transfer(lumped, 2 * jnp.pi * frequency[None], output_rows(lumped, outputs))
    value, _ = gate.close(solution.value[0])
    return jnp.where(solution.singular, jnp.nan, value)


def check_outputs(outputs: Sequence[str]) -> tuple[str, ...]:
    """Raise ValueError for an output that the rotational coordinates do not contain.

    Raises:
        ValueError: names those they do.
    """
    for name in outputs:
        if name not in ROTATIONS:
            raise unknown(f"unknown output {name!r}", name, ROTATIONS, "; errors as excitation have")
    return tuple(outputs)


def output_speed(lumped: Lumped, sun_speed: Array) -> jax.Array:
    """Speed of the output for that of the sun, rad/s."""
    return jnp.asarray(sun_speed / lumped.ratio)


def output_rows(lumped: Lumped, outputs: Sequence[str]) -> jax.Array:
    """Outputs in the rotational coordinates (outputs, 11)."""
    ratio = linear_ratio(lumped)
    one = jnp.eye(11, dtype=ratio.dtype)
    return rotations(outputs, one[_SUN], one[_OUTPUT], ratio)


def rotations(outputs: Sequence[str], sun: jax.Array, output: jax.Array, ratio: jax.Array) -> jax.Array:
    """Outputs (outputs, ...) from the rotations of sun and output."""
    named = {"output.rotation": output, "sun.rotation": sun, "transmission_error": output - sun / ratio}
    return jnp.stack([named[name] for name in outputs])


def close(unit: Unit, values: object, lines: jax.Array, solution: "Transfer | Balanced") -> tuple[PyTree, SolveInfo]:
    """Values of a unit with their status.

    Args:
        unit: as read.
        values: of the result, NaN where the solve fails.
        lines: amplitudes that must be finite.
        solution: how the equations were solved.
    """
    overflow = ~jnp.all(jnp.isfinite(lines))
    checks = ((overflow, Status.NONFINITE), (solution.singular, Status.SINGULAR))
    return unit.gate.close(values, *checks, info=converged(solution.residual))


def forcing(lumped: Lumped) -> jax.Array:
    """Forces on the rotational coordinates for unit displacement of each spring (11, springs), Eq. 12."""
    stiffness, m, n = lumped.stiffness, lumped.cranks, lumped.discs
    arm, root_m, root_n = jnp.asarray(stiffness.turning_arm_bearing), m**0.5, n**0.5

    def springs(mesh: str, k: Scalar, start: int = 0, step: int = 1) -> jax.Array:
        return jnp.sum(mesh_rows(lumped, mesh, *KEY)[start::step], axis=0) * k

    def column(*entries: tuple[int, Array]) -> jax.Array:
        values = jnp.zeros(11, arm.dtype)
        for place, value in entries:
            values = values.at[place].set(value)
        return values

    columns = [
        springs("sun_planet_mesh", stiffness.sun_planet_mesh),
        springs("support_bearing", stiffness.support_bearing, 0, 2),
        springs("support_bearing", stiffness.support_bearing, 1, 2),
        column((_HX, arm * n * root_m)),
        column((_HY, arm * n * root_m), (_CTH, -arm * lumped.circle_radius * m * root_n)),
        column((_CX, -arm * m * root_n)),
        column((_CY, -arm * m * root_n), (_HTH, arm * lumped.eccentricity * n * root_m)),
        springs("disc_pin_mesh", stiffness.disc_pin_mesh),
    ]
    return jnp.stack(columns, axis=1)


def transfer(lumped: Lumped, frequency: jax.Array, rows: jax.Array) -> Transfer:
    """Eq. 13 at signed angular frequencies (F,), rad/s, for outputs `rows` (k, 11).

    A damper feels the error as its spring does, so that the static deflection q_0, K q_0 = L, leaves of the forces only
    those of the masses: q = q_0 - Z^-1 (Z - (1 + i eta + i w b) K) q_0, and nothing cancels at low speed. Z is
    symmetric: one solve for each output gives its response to all springs.
    """
    standing, state = static_deflection(lumped)
    modal = modal_sectors(lumped, [KEY])[KEY]
    z = dynamic_stiffness(lumped, frequency)
    dtype = z.scalar.dtype
    columns = (rows @ modal.transform).T.astype(dtype)
    rhs = jnp.broadcast_to(columns[None], (len(frequency), *columns.shape))
    solution = modal_solve(modal, z, rhs)
    still = modal.transform.T @ (sector_mass(lumped, *KEY)[:, None] * standing)  # q_0 in modal coordinates
    rooted = matrix_root(modal.stiffness, modal.square) @ still
    left = z.scalar[:, None, None] * still.astype(dtype)[None] + z.root[:, None, None] * rooted.astype(dtype)[None]
    free = (lumped.stiffness.sun_torsion == 0) & (lumped.stiffness.output_torsion == 0)
    return Transfer(
        (rows @ standing).astype(dtype)[None] - jnp.einsum("fro,frs->fos", solution, left),
        state.singular | on_resonance(modal, z) | (free & jnp.any(frequency == 0)),
        jnp.maximum(state.residual, residual(modal, z, solution, rhs)),
    )


def static_deflection(lumped: Lumped) -> tuple[jax.Array, MeanState]:
    """Rotational coordinates at standstill for unit displacement of each spring (11, springs).

    Where neither sun nor output is held against rotation the sun is, without force: errors leave the rigid mode alone.
    """
    zero = jnp.zeros_like(lumped.eccentricity)
    state = mean_state(lumped, KEY[0], zero, zero, forcing(lumped))
    return state.solution[:, 1:], state


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
    solution = transfer(unit.lumped, n * output_speed(unit.lumped, sun_speed), output_rows(unit.lumped, outputs))

    def lines(errors: dict[str, jax.Array]) -> jax.Array:
        return generators(unit._replace(errors=errors), orders, pin_harmonics)[0]

    power = jnp.zeros(solution.value.shape[:2], sun_speed.dtype)
    pseudo = jnp.zeros(solution.value.shape[:2], solution.value.dtype)
    for name, slope in jax.jacfwd(lines)(unit.errors).items():
        sensitivity = jnp.einsum("kos,ks...->ko...", solution.value, slope)
        variance = jnp.square(unit.errors[name])[None, None]
        entries = tuple(range(2, sensitivity.ndim))
        real, imaginary = sensitivity.real, sensitivity.imag
        power += jnp.sum((real**2 + imaginary**2) * variance, axis=entries)
        square = jax.lax.complex((real**2 - imaginary**2) * variance, 2 * real * imaginary * variance)
        pseudo += jnp.sum(square, axis=entries)
    (n, power, pseudo), info = close(unit, (n, power, pseudo), power, solution)
    return ErrorStatistics(n, power, pseudo, outputs, info)
