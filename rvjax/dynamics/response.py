"""Steady response to the periodic mesh stiffness of one stage, per mesh harmonic.

First-order response: the stiffness variation acts on the mean deflection only (Eqs. 5 to 9).
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.plausible import checked
from rvjax.base.words import choose
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, lump, spring_table
from rvjax.dynamics.excitation import MESH, check_stage, mesh_frequency, phases, wave_coefficients
from rvjax.dynamics.harmonic_balance import solve_cyclic, solve_mesh
from rvjax.dynamics.harmonics import (
    OUTPUTS,
    Solved,
    constants,
    in_order,
    output_indices,
    resonance_distance,
    shares,
    unfold,
)
from rvjax.dynamics.modal import dynamic_stiffness, modal_sectors, modal_solve, on_resonance, residual
from rvjax.dynamics.static import Torques, balancing_torque, mean_state, mesh_rows, mesh_stiffness, torque_kind
from rvjax.dynamics.symmetry import is_symmetric, sector
from rvjax.records import Array, Record, Scalar, field, record, text
from rvjax.status import SolveInfo, Status, converged


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


METHODS = ("first_order", "harmonic_balance")


@record
class Response(Record):
    """Periodic response q(t) = mean + Re sum_l amplitude_l e^{i l w t}, w the angular mesh frequency."""

    frequency: Array = field("Hz", "of each harmonic", shape=("harmonics",))
    amplitude: Array = field("m, rad", "complex amplitude of each harmonic and output", shape=("harmonics", "outputs"))
    mean: Array = field("m, rad", "mean deflection of each output", shape=("outputs",))
    resonance_distance: Array = field(
        "-",
        "of each harmonic: min |l w / w_r - 1| over the modes that it excites and the outputs show; inf without any",
        shape=("harmonics",),
    )
    outputs: tuple[str, ...] = text("names of the outputs, from System.labels")
    form: str = text(
        "equations that were solved: first_order or cyclic, by symmetry; first_order_whole or mesh, on the whole model"
    )
    info: SolveInfo = field("-", "residual of the solves; CONVERGED, SINGULAR, ...", kind="record")


@checked
def response(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    harmonics: int = 9,
    method: str = "first_order",
    outputs: Sequence[str] | None = None,
    sun_torque: Scalar | None = None,
) -> Response:
    """Steady response to the mesh stiffness variation of one stage under constant load.

    The first-order solution (Eqs. 5 to 9 of Yang et al. 2018) applies the stiffness variation to the mean
    deflection only; harmonic balance keeps its product with the vibration. By symmetry each harmonic excites one
    kind of motion: what `outputs` cannot show is not solved, and is exactly zero. One disc, or members given one by
    one, leave no symmetry, and the whole model is solved; `form` names the equations.

    Args:
        design: a reducer with inertia, stiffness and mesh variation, or its lumped parameters.
        sun_speed: () rad/s, of either sign.
        output_torque: external torque on the output, () N m; negative opposes a positive rotation.
        stage: whose meshes vary: "planetary" or "cycloid".
        harmonics: of the mesh frequency, H; harmonic balance drops all above.
        method: "first_order" or "harmonic_balance".
        outputs: names from `assemble(design).labels`; by default output.x, output.y, output.rotation.
        sun_torque: external torque on the sun, () N m; by default the one that balances `output_torque`.

    Returns:
        Response. SINGULAR where no spring carries the torque, or undamped with a harmonic on a mode to
        rounding; NaN for INVALID_GEOMETRY (radii or masses not positive, pins along the radius) and NONFINITE.

    Raises:
        ValueError: unknown stage, method or output, harmonics below 1, or as `rvjax.dynamics.lump`.
    """
    lumped, outputs = _checked(design, stage, outputs)
    choose("method", method, METHODS)
    if harmonics < 1:
        raise ValueError(f"harmonics = {harmonics}: must be at least 1")
    return _response(lumped, sun_speed, output_torque, sun_torque, stage, harmonics, method, outputs, False)


@checked
def constant_forcing(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    harmonics: int = 9,
    outputs: Sequence[str] | None = None,
) -> Response:
    """First-order response whose derivatives leave out those of the forcing, as Eq. 14 of Yang et al. 2018 does.

    Its value is that of `response`. Its derivatives are right for inertias and, while only one of the central
    parts is held against rotation, for stiffnesses; for geometry and angles they are not.

    Args:
        design: as in `response`.
        sun_speed: as in `response`.
        output_torque: as in `response`.
        stage: as in `response`.
        harmonics: as in `response`.
        outputs: as in `response`.
    """
    lumped, outputs = _checked(design, stage, outputs)
    return _response(lumped, sun_speed, output_torque, None, stage, harmonics, "first_order", outputs, True)


def _checked(design: RVReducer | Lumped, stage: str, outputs: Sequence[str] | None) -> tuple[Lumped, tuple[str, ...]]:
    lumped, outputs = lump(design), OUTPUTS if outputs is None else tuple(outputs)
    check_stage(stage)
    output_indices(lumped, outputs)
    return lumped, outputs


@partial(jax.jit, static_argnums=(4, 5, 6, 7, 8))
def _response(
    lumped: Lumped,
    sun_speed: Array,
    output_torque: Array,
    sun_torque: Array | None,
    stage: str,
    harmonics: int,
    method: str,
    outputs: tuple[str, ...],
    freeze_forcing: bool,
) -> Response:
    lumped, (sun_speed, output_torque, sun_torque), gate = admitted(lumped, sun_speed, output_torque, sun_torque)
    sun_torque = balancing_torque(lumped, output_torque) if sun_torque is None else sun_torque
    torques = Torques(sun_torque, output_torque)
    indices = output_indices(lumped, outputs)
    w = mesh_frequency(lumped, sun_speed, stage)
    if method == "first_order":
        form = "first_order" if is_symmetric(lumped) else "first_order_whole"
        solved = solve_first_order(lumped, w, torques, stage, harmonics, indices, freeze_forcing)
    elif lumped.alike and lumped.cranks >= 3 and (lumped.discs >= 3 or stage == "cycloid"):
        form = "cyclic"
        solved = solve_cyclic(lumped, w, torques, stage, harmonics, indices)
    else:
        form = "mesh"
        solved = solve_mesh(lumped, w, torques, stage, harmonics, indices)
    amplitude = jnp.where(w < 0, solved.amplitude.conj(), solved.amplitude)  # time reversed
    overflow = ~(jnp.all(jnp.isfinite(amplitude)) & jnp.all(jnp.isfinite(solved.mean)))
    frequency = jnp.arange(1, harmonics + 1, dtype=w.dtype) * jnp.abs(w) / (2 * jnp.pi)
    (frequency, amplitude, mean, distance), info = gate.close(
        (frequency, amplitude, solved.mean, solved.distance),
        (overflow, Status.NONFINITE),
        (solved.singular, Status.SINGULAR),
        info=converged(solved.residual),
    )
    return Response(frequency, amplitude, mean, distance, outputs, form, info)
