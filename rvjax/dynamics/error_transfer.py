"""Transfer from the displacement of a spring to the rotations of sun and output, frequency by frequency.

Eleven coordinates, the rotations of the central parts and what is common to planets, cranks and discs, have constant
matrices although cranks revolve and eccentrics turn: cos and sin of the angles between them appear squared, in
pairs. So T(w) = C Z(w)^-1 A(w) needs one eigenproblem for all frequencies. Derivation: docs/models/dynamic_error.md.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._reducer.plausible import checked
from rvjax.base.words import unknown
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, loaded
from rvjax.dynamics.error_excitation import Orders, Unit, symmetric
from rvjax.dynamics.modal import dynamic_stiffness, matrix_root, modal_sectors, modal_solve, on_resonance, residual
from rvjax.dynamics.static import MeanState, linear_ratio, mean_state, mesh_rows
from rvjax.dynamics.symmetry import sector_mass
from rvjax.records import Array, PyTree, Scalar
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
    found = transfer(lumped, 2 * jnp.pi * frequency[None], output_rows(lumped, outputs))
    value, _ = gate.close(found.value[0])
    return jnp.where(found.singular, jnp.nan, value)


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


def close(unit: Unit, values: PyTree, lines: jax.Array, found: "Transfer | Balanced") -> tuple[PyTree, SolveInfo]:
    """Values of a unit with their status.

    Args:
        unit: as read.
        values: of the result, NaN where the solve fails.
        lines: amplitudes that must be finite.
        found: how the equations were solved.
    """
    overflow = ~jnp.all(jnp.isfinite(lines))
    checks = ((overflow, Status.NONFINITE), (found.singular, Status.SINGULAR))
    return unit.gate.close(values, *checks, info=converged(found.residual))


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
