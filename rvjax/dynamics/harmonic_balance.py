"""Solutions of one mesh frequency: first order, and harmonic balance with full coupling.

First order: the stiffness variation acts on the mean deflection only (Eqs. 5 to 9 of Yang et al. 2018).
Harmonic balance: q = sum over |l| <= H of Q_l e^{i l w t}, Q_-l = conj Q_l.

Every product of stiffness variation and vibration enters through the deflections d_il = v_i.Q_l of the varying
meshes. With d_il = e^{i l ph_i} delta_il (ph_i the mesh phases) they alone satisfy, for l = -H .. H,

    delta_l + Gamma_l (T delta)_l = v.qbar [l = 0],
    Gamma_l[i, m] = e^{-i l ph_i} v_i^T Z_l^-1 v_m e^{i l ph_m},  (T delta)_ml = k_m sum_{j != l} a_|l-j|/2 delta_mj,
    Q_l = qbar [l = 0] - Z_l^-1 sum_m v_m e^{i l ph_m} (T delta)_ml.

Mesh form: one unknown per mesh and harmonic, for any layout. Cyclic form: where shifting the members by one is
a symmetry of the mean system all delta_il are equal, and one unknown per harmonic remains.
"""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.dynamics.assembly import Lumped, spring_table
from rvjax.dynamics.excitation import (
    MESH,
    Solved,
    constants,
    in_order,
    phases,
    resonance_distance,
    shares,
    unfold,
    wave_coefficients,
)
from rvjax.dynamics.modes import dynamic_stiffness, modal_sectors, modal_solve, on_resonance, residual
from rvjax.dynamics.static import Torques, mean_state, mesh_rows, mesh_stiffness, solve, torque_kind
from rvjax.dynamics.symmetry import sector
from rvjax.records import Array


def solve_cyclic(lumped: Lumped, w: Array, torques: Torques, stage: str, harmonics: int, indices: np.ndarray) -> Solved:
    """Cyclic form at signed mesh frequency `w`, rad/s: one small solve and one scalar unknown per harmonic."""
    mesh, kind = MESH[stage], torque_kind(lumped)
    members = spring_table(lumped.cranks, lumped.discs).of(mesh)
    rows_0 = mesh_rows(lumped, mesh, kind)
    state = mean_state(lumped, kind, *torques, jnp.sum(rows_0, axis=0)[:, None])
    mean, x_0 = state.solution[:, 0], state.solution[:, 1]

    parts = shares(lumped, stage, harmonics)
    sectors = modal_sectors(lumped, [share.key for share in parts])
    own, shown, distances, singular, misses = [], [], [], [state.singular], [state.residual]
    for key, orders in parts:
        modal = sectors[key]
        frequency = jnp.asarray(orders, w.dtype) * w
        z = dynamic_stiffness(lumped, frequency)
        waves = constants(phases(lumped, stage, orders), w)
        rhs = (waves @ modal.springs[members].conj().astype(waves.dtype))[:, :, None]
        x = modal_solve(modal, z, rhs)  # Z_l^-1 sum_i e^{i l ph_i} v_i
        own.append(unfold(orders, x[:, :, 0] @ modal.springs[members[0]].astype(waves.dtype)))
        shown.append(unfold(orders, x[:, :, 0] @ modal.rows(indices).T.astype(waves.dtype)))
        distances.append(resonance_distance(modal, frequency))
        singular.append(on_resonance(modal, z))
        misses.append(residual(modal, z, x, rhs))
    orders_used = [share.harmonics for share in parts]
    absent = constants(0, w)
    gamma = jnp.concatenate([constants(rows_0[:1] @ x_0, w), in_order(orders_used, own, harmonics, absent)])
    basis = jnp.asarray(sector(lumped.cranks, lumped.discs, kind)[indices], mean.dtype)
    shown = [
        constants((basis @ x_0)[None], w),
        in_order(orders_used, shown, harmonics, jnp.stack([absent] * len(indices))),
    ]
    coupling, pivot = _coupling(lumped, stage, harmonics, gamma[:, None, None], rows_0[:1] @ mean)
    motion = -jnp.concatenate(shown) * coupling
    return Solved(
        amplitude=2 * motion[1:],
        mean=basis @ mean + motion[0].real,
        distance=in_order(orders_used, distances, harmonics, jnp.full((), jnp.inf, w.dtype)),
        singular=jnp.any(jnp.stack(singular)) | _is_singular(pivot),
        residual=jnp.max(jnp.stack(misses)),
    )


def solve_mesh(lumped: Lumped, w: Array, torques: Torques, stage: str, harmonics: int, indices: np.ndarray) -> Solved:
    """Mesh form at signed mesh frequency `w`, rad/s, on the whole model: any layout."""
    mesh, key = MESH[stage], ("coupled", 0)
    members = spring_table(lumped.cranks, lumped.discs).of(mesh)
    rows_0 = mesh_rows(lumped, mesh, *key)
    state = mean_state(lumped, key[0], *torques, rows_0.T)
    mean, x_0 = state.solution[:, 0], state.solution[:, 1:]

    modal = modal_sectors(lumped, [key])[key]
    orders = np.arange(1, harmonics + 1)
    frequency = jnp.asarray(orders, w.dtype) * w
    z = dynamic_stiffness(lumped, frequency)
    waves = constants(phases(lumped, stage, orders), w)
    springs = modal.springs[members].astype(waves.dtype)
    rhs = springs.T[None] * waves[:, None, :]
    x = modal_solve(modal, z, rhs)  # Z_l^-1 v_m e^{i l ph_m}
    gamma = waves.conj()[:, :, None] * jnp.einsum("ir,lrm->lim", springs, x)
    gamma = jnp.concatenate([constants(rows_0 @ x_0, w)[None], gamma])
    shown = jnp.einsum("kr,lrm->lkm", modal.rows(indices).astype(waves.dtype), x)
    shown = jnp.concatenate([constants(x_0[indices], w)[None], shown])
    coupling, pivot = _coupling(lumped, stage, harmonics, gamma, rows_0 @ mean)
    motion = -jnp.einsum("lkm,lm->lk", shown, coupling)
    return Solved(
        amplitude=2 * motion[1:],
        mean=mean[indices] + motion[0].real,
        distance=resonance_distance(modal, frequency),
        singular=state.singular | on_resonance(modal, z) | _is_singular(pivot),
        residual=jnp.maximum(state.residual, residual(modal, z, x, rhs)),
    )


def _coupling(
    lumped: Lumped, stage: str, harmonics: int, gamma: jax.Array, load: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """(T delta)_l for l = 0 .. H (H + 1, m), and the smallest pivot of the system that gives delta.

    With delta_-l = conj delta_l the real parts p and imaginary parts q of delta_0 .. delta_H are the unknowns:
    (T delta)_l = sum_j (t_|l-j| + t_l+j) p_j + i (t_|l-j| - t_l+j) q_j, the terms t_l+j for j >= 1 only.
    """
    count, meshes = harmonics + 1, gamma.shape[1]
    half = wave_coefficients(lumped, stage, 2 * harmonics) / 2
    k = mesh_stiffness(lumped, MESH[stage])[:meshes]
    t = jnp.concatenate([jnp.zeros_like(half[:1]), half])
    order = np.arange(count)
    near, far = t[np.abs(order[:, None] - order)], jnp.where(order >= 1, t[order[:, None] + order], 0)
    even, odd = near + far, near - far
    odd = jnp.where(order >= 1, odd, 0)  # q_0 = 0

    def block(values: jax.Array, matrix: jax.Array) -> jax.Array:
        return jnp.einsum("lim,lj->lijm", values * k[None, None, :], matrix).reshape(count * meshes, count * meshes)

    one = jnp.eye(count * meshes, dtype=t.dtype)
    matrix = jnp.block(
        [
            [one + block(gamma.real, even), -block(gamma.imag, odd)],
            [block(gamma.imag, even), one + block(gamma.real, odd)],
        ]
    )
    rhs = jnp.zeros(2 * count * meshes, t.dtype).at[:meshes].set(load)
    scale = 1 / jax.lax.stop_gradient(jnp.max(jnp.abs(matrix), axis=1, keepdims=True))
    unknown, pivot = solve(scale * matrix, scale * rhs[:, None])
    p, q = unknown.reshape(2, count, meshes)
    return jax.lax.complex(even @ p * k[None, :], odd @ q * k[None, :]), pivot


def _is_singular(pivot: jax.Array) -> jax.Array:
    return jnp.logical_not(pivot > 16 * float(jnp.finfo(pivot.dtype).eps))


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
        if np.any(sector(lumped.cranks, lumped.discs, *share.key)[indices])
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
    basis = sector(lumped.cranks, lumped.discs, kind)
    return Solved(
        amplitude=in_order(orders_used, rows, harmonics, constants(np.zeros(len(indices)), w)),
        mean=jnp.asarray(basis[indices], mean.dtype) @ mean,
        distance=in_order(orders_used, distances, harmonics, jnp.full((), jnp.inf, w.dtype)),
        singular=jnp.any(jnp.stack(singular)),
        residual=jnp.max(jnp.stack(misses)),
    )
