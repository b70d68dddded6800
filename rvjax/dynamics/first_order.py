"""First-order response: the stiffness variation acts on the mean deflection only (Eqs. 5 to 9)."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.dynamics.assembly import Lumped, spring_table
from rvjax.dynamics.excitation import MESH, phases, wave_coefficients
from rvjax.dynamics.harmonics import Solved, constants, in_order, resonance_distance, shares, unfold
from rvjax.dynamics.modal import dynamic_stiffness, modal_sectors, modal_solve, on_resonance, residual
from rvjax.dynamics.static import Torques, mean_state, mesh_rows, mesh_stiffness, torque_kind
from rvjax.dynamics.symmetry import sector
from rvjax.records import Array


def solve_first_order(
    lumped: Lumped, w: Array, torques: Torques, stage: str, harmonics: int, indices: np.ndarray, freeze_forcing: bool
) -> Solved:
    """Amplitudes of the coordinates `indices` at signed mesh frequency `w`, rad/s.

    `freeze_forcing` keeps the forces on the physical coordinates out of the derivatives.
    """
    mesh, kind = MESH[stage], torque_kind(lumped)
    state = mean_state(lumped, kind, *torques)
    mean = state.solution[:, 0]
    force = mesh_stiffness(lumped, mesh) * (mesh_rows(lumped, mesh, kind) @ mean)
    coefficients = wave_coefficients(lumped, stage, harmonics)

    used = [
        share
        for share in shares(lumped, stage, harmonics)
        if np.any(sector(lumped.cranks, lumped.discs, *share.key).basis[indices])
    ]
    sectors = modal_sectors(lumped, [share.key for share in used])
    rows, distances, singular, misses = [], [], [state.singular], [state.residual]
    for key, orders in used:
        modal = sectors[key]
        frequency = jnp.asarray(orders, w.dtype) * w
        z = dynamic_stiffness(lumped, frequency)
        # Eqs. 6 and 7: Z_l B_l = -a_l sum_i e^{i l ph_i} f_i v_i
        weights = -coefficients[np.abs(orders) - 1][:, None] * force[None, :]
        waves = constants(phases(lumped, stage, orders), w) * weights.astype(constants(0, w).dtype)
        if freeze_forcing:
            physical = waves @ mesh_rows(lumped, mesh, *key).conj().astype(waves.dtype)
            rhs = jax.lax.stop_gradient(physical) @ modal.transform.conj().astype(waves.dtype)
        else:
            members = spring_table(lumped.cranks, lumped.discs).of(mesh)
            rhs = waves @ modal.springs[members].conj().astype(waves.dtype)
        solution = modal_solve(modal, z, rhs[:, :, None])
        rows.append(unfold(orders, solution[:, :, 0] @ modal.rows(indices).T.astype(waves.dtype)))
        distances.append(resonance_distance(modal, frequency))
        singular.append(on_resonance(modal, z))
        misses.append(residual(modal, z, solution, rhs[:, :, None]))

    orders_used = [share.harmonics for share in used]
    basis = sector(lumped.cranks, lumped.discs, kind).basis
    return Solved(
        amplitude=in_order(orders_used, rows, harmonics, constants(np.zeros(len(indices)), w)),
        mean=jnp.asarray(basis[indices], mean.dtype) @ mean,
        distance=in_order(orders_used, distances, harmonics, jnp.full((), jnp.inf, w.dtype)),
        singular=jnp.any(jnp.stack(singular)),
        residual=jnp.max(jnp.stack(misses)),
    )
