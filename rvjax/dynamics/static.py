"""Mean deflection under the load torque, the mesh forces that carry it, and the linear solve of both.

The solve holds no LAPACK call: independent batched calls in one compiled program can wait for each other for ever on
two cores with some versions of jaxlib. The dynamic model keeps one such call in flight, its eigenproblem.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import fori_loop
from rvjax.catalogue import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, deflections, lump, spring_stiffness, spring_table
from rvjax.dynamics.symmetry import is_symmetric, sector, sector_rows, sector_stiffness
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, converged


def solve(matrix: jax.Array, rhs: jax.Array) -> tuple[jax.Array, jax.Array]:
    """x with matrix @ x = rhs and the smallest pivot; derivatives of all orders are solves with the same matrix.

    Args:
        matrix: (n, n), real, scaled so that its rows are comparable.
        rhs: (n, m).
    """
    frozen = jax.lax.stop_gradient(matrix)

    def forward(multiply: object, b: jax.Array) -> tuple[jax.Array, jax.Array]:
        return eliminate(frozen, b)

    def transposed(multiply: object, b: jax.Array) -> tuple[jax.Array, jax.Array]:
        return eliminate(frozen.T, b)

    return jax.lax.custom_linear_solve(lambda x: matrix @ x, rhs, forward, transposed, has_aux=True)


def eliminate(matrix: jax.Array, rhs: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Gauss-Jordan elimination with row pivoting: the solution (n, m) and the smallest pivot.

    A zero pivot is replaced by one, so that a singular system gives numbers, not NaN; the smallest pivot shows it.
    """
    size = matrix.shape[0]
    rows = jnp.arange(size)

    def step(k: Scalar, carry: PyTree) -> PyTree:
        work, free, order, smallest = carry
        column = jax.lax.dynamic_index_in_dim(work, k, 1, keepdims=False)
        chosen = jnp.argmax(jnp.where(free, jnp.abs(column), -1))
        pivot = column[chosen]
        row = work[chosen] / jnp.where(pivot == 0, jnp.ones_like(pivot), pivot)
        here = rows == chosen
        work = jnp.where(here[:, None], row[None, :], work - column[:, None] * row[None, :])
        return work, free & ~here, jnp.where(rows == k, chosen, order), jnp.minimum(smallest, jnp.abs(pivot))

    start = (
        jnp.concatenate([matrix, rhs], axis=1),
        jnp.ones(size, bool),
        jnp.zeros(size, rows.dtype),
        jnp.full((), jnp.inf, matrix.dtype),
    )
    work, _, order, smallest = fori_loop(0, size, step, start)
    return work[order, size:], smallest


@record
class Static(Record):
    """Mean state under a constant load torque."""

    deflection: Array = field("m, rad", "mean deflection, in the order of System.labels", shape=("n",))
    planetary_force: Array = field("N", "force of each sun-planet mesh", shape=("planets",))
    cycloid_force: Array = field("N", "force of each disc-pin mesh", shape=("discs",))
    info: SolveInfo = field("-", "CONVERGED, SINGULAR, INVALID_GEOMETRY or NONFINITE", kind="record")


class Torques(NamedTuple):
    """External torques, () N m."""

    sun: Array
    output: Array


class MeanState(NamedTuple):
    """Response of the mean system to constant forces in one sector."""

    solution: jax.Array  # (r, 1 + m): under the torques, under the further loads
    singular: jax.Array  # () bool
    residual: jax.Array  # ()


def linear_ratio(lumped: Lumped) -> jax.Array:
    """Sun rotation over output rotation in the rigid mode of the linear model."""
    planet = lumped.disc_teeth * lumped.planet_base_radius
    return jnp.divide(planet + jnp.cos(lumped.pressure_angle) * lumped.circle_radius, lumped.sun_base_radius)


def torque_kind(lumped: Lumped) -> str:
    """Sector that holds the rotations of sun and output."""
    return "rotational" if is_symmetric(lumped) else "coupled"


def balancing_torque(lumped: Lumped, output_torque: Array) -> PyTree:
    """Sun torque that leaves the rigid mode without load."""
    return -output_torque / linear_ratio(lumped)


def mean_state(
    lumped: Lumped, kind: str, sun_torque: Array, output_torque: Array, loads: Array | None = None
) -> MeanState:
    """Solve Kbar q = F in the sector `kind`, for the two torques and for further `loads` (r, m).

    Where neither sun nor output is held against rotation, the sun is held at zero: balanced loads leave that
    spring without force, others are singular.
    """
    stiffness = sector_stiffness(lumped, kind)
    place = np.arange(len(stiffness))
    sun, output = place == (0 if kind == "rotational" else 2), place == len(place) - 1
    free = (lumped.stiffness.sun_torsion == 0) & (lumped.stiffness.output_torsion == 0)
    ground = jnp.where(free, mesh_stiffness(lumped, "sun_planet_mesh")[0] * lumped.sun_base_radius**2, 0)
    stiffness = stiffness + jnp.diag(jnp.where(sun, ground, 0))
    rhs = jnp.where(sun, sun_torque, jnp.where(output, output_torque, 0)).reshape(-1, 1)
    rhs = rhs if loads is None else jnp.concatenate([rhs, loads], axis=1)

    diagonal = jnp.diag(stiffness)
    scale = jax.lax.rsqrt(jnp.where(diagonal > 0, diagonal, 1))[:, None]
    scaled = scale * stiffness * scale.T  # condition 1e6 in SI, 1e2 so
    unknown, pivot = solve(scaled, scale * rhs)
    rounding = float(jnp.finfo(pivot.dtype).eps)
    excess = jnp.abs(sun_torque - balancing_torque(lumped, output_torque))
    size = jnp.abs(sun_torque) + jnp.abs(output_torque) / linear_ratio(lumped)
    least = max(4 * len(place) * rounding, rounding**0.75)
    singular = ~(pivot > least) | (free & (excess > 64 * rounding * size))
    miss = jnp.max(jnp.abs(scaled @ unknown - scale * rhs))
    size = jnp.max(jnp.abs(unknown)) + jnp.max(jnp.abs(scale * rhs))
    left = miss / jnp.where(size > 0, size, 1)
    # Rounding can hide a mechanism from the pivots, but then not from what the solution misses.
    return MeanState(scale * unknown, singular | ~(left <= rounding ** (2 / 3)), left)


def mesh_rows(lumped: Lumped, mesh: str, kind: str, label: int = 0) -> jax.Array:
    """Deflection vectors of the springs of one kind in a sector (members, r)."""
    members = spring_table(lumped.cranks, lumped.discs).of(mesh)
    return deflections(lumped, sector_rows(lumped.cranks, lumped.discs, kind, label)[:, members])


def mesh_stiffness(lumped: Lumped, mesh: str) -> jax.Array:
    """Mean stiffness of each mesh of a stage (members,)."""
    return spring_stiffness(lumped)[spring_table(lumped.cranks, lumped.discs).of(mesh)]


@checked
def static(design: RVReducer | Lumped, *, output_torque: Scalar, sun_torque: Scalar | None = None) -> Static:
    """Mean deflection under a load torque on the output.

    Args:
        design: a reducer with inertia and stiffness, or its lumped parameters.
        output_torque: external torque on the output, () N m; negative opposes a positive rotation.
        sun_torque: external torque on the sun, () N m; by default the one that balances `output_torque`. Zero: the
            input is held by its torsion spring alone, as in a measurement of torsional stiffness.

    Returns:
        Static (Kbar qbar = F, after Eq. 3). SINGULAR where no spring carries the torque; NaN for
        INVALID_GEOMETRY (radii or masses not positive, pins along the radius) and NONFINITE input.

    Raises:
        ValueError: as `rvjax.dynamics.lump`.
    """
    return _static(lump(design), output_torque, sun_torque)


@jax.jit
def _static(lumped: Lumped, output_torque: Array, sun_torque: Array | None) -> Static:
    lumped, (output_torque, sun_torque), gate = admitted(lumped, output_torque, sun_torque)
    sun_torque = balancing_torque(lumped, output_torque) if sun_torque is None else sun_torque
    kind = torque_kind(lumped)
    state = mean_state(lumped, kind, sun_torque, output_torque)
    basis = sector(lumped.cranks, lumped.discs, kind)
    mean = state.solution[:, 0]
    deflection = jnp.asarray(basis, mean.dtype) @ mean
    forces = [
        mesh_stiffness(lumped, mesh) * (mesh_rows(lumped, mesh, kind) @ mean)
        for mesh in ("sun_planet_mesh", "disc_pin_mesh")
    ]
    (deflection, planetary, cycloid), info = gate.close(
        (deflection, *forces),
        (state.singular, Status.SINGULAR),
        (~jnp.all(jnp.isfinite(deflection)), Status.NONFINITE),
        info=converged(state.residual),
    )
    return Static(deflection, planetary, cycloid, info)
