"""Exact periodic solution and stability for meshes that switch between two levels.

Between switchings the stiffness is constant, so the state of the modal coordinates (eta, eta'/w0, 1), w0 the
highest angular frequency, advances by one matrix exponential; the steady state is the fixed point of one period.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax.base.words import choose
from rvjax.catalogue import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, lump, spring_table
from rvjax.dynamics.excitation import MESH, OUTPUTS, STAGES, mesh_frequency, mesh_phases, output_indices
from rvjax.dynamics.modes import ModalSector, matrix_root, modal_sectors
from rvjax.dynamics.static import linear_ratio, mesh_stiffness, solve
from rvjax.records import Array, PyTree, Record, Scalar, concrete, field, record, text
from rvjax.status import Gate, SolveInfo, Status, at_once, converged

TAYLOR_DEGREE = 13  # of the exponential at norm 1/2: truncated below 1e-15
MAX_SQUARINGS = 24


@record
class Periodic(Record):
    """Steady state over one mesh period, without truncation of harmonics."""

    time: Array = field("s", "uniform over one mesh period, from 0", shape=("samples",))
    deflection: Array = field("m, rad", "each output at each time", shape=("samples", "outputs"))
    multiplier: Array = field("-", "largest magnitude of a Floquet multiplier")
    outputs: tuple[str, ...] = text("names of the outputs, from System.labels")
    info: SolveInfo = field("-", "CONVERGED, UNSTABLE, SINGULAR, MAX_STEPS, ...", kind="record")


@record
class Floquet(Record):
    """Stability of the vibration under the periodic stiffness."""

    multiplier: Array = field("-", "largest magnitude of a Floquet multiplier")
    info: SolveInfo = field("-", "UNSTABLE above 1 + 1e-9", kind="record")


@checked
def periodic(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    samples: int = 64,
    outputs: Sequence[str] | None = None,
) -> Periodic:
    """Exact steady state under the periodic mesh stiffness of one stage: the reference for `response`.

    Args:
        design: a reducer with inertia, stiffness and mesh variation, or its lumped parameters. Ramps and the loss
            factor must be zero: only a rectangular wave is exact, and a loss factor has no counterpart in time.
        sun_speed: () rad/s, not zero.
        output_torque: external torque on the output, () N m.
        stage: whose meshes vary: "planetary" or "cycloid".
        samples: times per mesh period.
        outputs: names from `assemble(design).labels`; by default output.x, output.y, output.rotation.

    Returns:
        Periodic. UNSTABLE where the solution exists but repels; SINGULAR where it does not exist; MAX_STEPS
        where the speed is too low for the exponentials; NaN for INVALID_GEOMETRY (as `response`; also a traced
        ramp or loss factor that is not zero) and NONFINITE.

    Raises:
        ValueError: a concrete ramp or loss factor that is not zero, an unknown stage or output, or as `lump`.
    """
    lumped = _check(lump(design), stage)
    outputs = OUTPUTS if outputs is None else tuple(outputs)
    output_indices(lumped, outputs)
    return _periodic(lumped, sun_speed, output_torque, stage, samples, outputs)


@checked
def floquet(design: RVReducer | Lumped, *, sun_speed: Scalar, stage: str = "planetary") -> Floquet:
    """Largest Floquet multiplier of the vibration under the periodic mesh stiffness of one stage.

    Harmonic balance returns a periodic solution also where it is unstable; the multiplier shows it.

    Args:
        design: as in `periodic`.
        sun_speed: () rad/s, not zero.
        stage: whose meshes vary: "planetary" or "cycloid".

    Returns:
        Floquet, status UNSTABLE above 1 + 1e-9 (single precision: 1 + 1e-4); else as `periodic`. Eigenvalues of a
        general matrix: on the CPU only.

    Raises:
        ValueError: as `periodic`.
    """
    return _floquet(_check(lump(design), stage), sun_speed, stage)


def _check(lumped: Lumped, stage: str) -> Lumped:
    choose("stage", stage, STAGES)
    for name, value in (
        (f"MeshVariation.{stage}_ramp", getattr(lumped.mesh_variation, f"{stage}_ramp")),
        ("Damping.loss_factor", lumped.damping.loss_factor),
    ):
        if concrete(value) and np.any(np.asarray(value) != 0):
            raise ValueError(f"{name} = {float(np.max(value)):.6g}: the exact periodic solution needs zero")
    return lumped


@partial(jax.jit, static_argnums=(3, 4, 5))
def _periodic(
    lumped: Lumped, sun_speed: Array, output_torque: Array, stage: str, samples: int, outputs: tuple[str, ...]
) -> Periodic:
    lumped, (sun_speed, output_torque), gate = _admitted(lumped, stage, sun_speed, output_torque)
    path = _path(lumped, sun_speed, output_torque, stage, samples)
    size = len(path.modal.square)
    whole = _product(path.steps)
    one = jnp.eye(2 * size, dtype=whole.dtype)
    start, pivot = solve(one - whole[:-1, :-1], whole[:-1, -1:])
    start = jnp.append(start[:, 0], jnp.ones_like(start[:1, 0]))

    def advance(state: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        return step @ state, state

    _, states = scan(advance, start, path.steps)
    motion = states[path.samples][:, :size] @ path.modal.rows(output_indices(lumped, outputs)).T
    sun = states[:, :size] @ path.modal.rows(output_indices(lumped, ("sun.rotation",)))[0]
    free = path.rigid[0]  # nothing holds the rotations: the sun turns by zero on average
    mean_sun = jnp.sum(sun * path.lengths) / jnp.sum(path.lengths)  # of the left ends: the offset of a rigid motion
    rigid = path.modal.rows(output_indices(lumped, (*outputs, "sun.rotation")))[:, 0]
    shift = jnp.where(free, mean_sun, 0) / jnp.where(rigid[-1] == 0, 1, rigid[-1])
    motion = motion - shift * rigid[None, :-1]
    multiplier = _largest(whole, path)
    miss = jnp.max(jnp.abs(whole @ start - start)) / jnp.max(jnp.abs(start))
    period = 2 * jnp.pi / jnp.abs(path.w)
    time = jnp.arange(samples, dtype=period.dtype) / samples * period
    (time, motion, multiplier), info = gate.close(
        (time, motion, multiplier),
        (~(pivot > 16 * jnp.finfo(pivot.dtype).eps), Status.SINGULAR),
        (path.too_slow, Status.MAX_STEPS),
        (_unstable(multiplier), Status.UNSTABLE),
        info=converged(miss),
    )
    return Periodic(time, motion, multiplier, outputs, info)


@partial(jax.jit, static_argnums=2)
def _floquet(lumped: Lumped, sun_speed: Array, stage: str) -> Floquet:
    lumped, (sun_speed,), gate = _admitted(lumped, stage, sun_speed)
    path = _path(lumped, sun_speed, jnp.zeros_like(sun_speed), stage, 1)
    multiplier = _largest(_product(path.steps), path)
    checks = ((path.too_slow, Status.MAX_STEPS), (_unstable(multiplier), Status.UNSTABLE))
    value, info = gate.close(multiplier, *checks, info=at_once(multiplier))
    return Floquet(value, info)


def _admitted(lumped: Lumped, stage: str, *conditions: PyTree) -> tuple[Lumped, tuple[PyTree, ...], Gate]:
    lumped, conditions, gate = admitted(lumped, *conditions)
    ramp = getattr(lumped.mesh_variation, f"{stage}_ramp")
    outside = (ramp != 0) | (lumped.damping.loss_factor != 0) | (conditions[0] == 0)
    speed = jnp.where(conditions[0] == 0, 100, conditions[0])
    return lumped, (speed, *conditions[1:]), Gate((*gate.refused, (outside, Status.INVALID_GEOMETRY)))


class _Path(NamedTuple):
    """One mesh period cut at the switchings and at the sample times, from t = 0."""

    modal: ModalSector
    w: jax.Array
    steps: jax.Array  # (intervals, 2 n + 1, 2 n + 1): exponentials
    lengths: jax.Array  # (intervals,) s
    samples: jax.Array  # index of the interval that starts at each sample time
    rigid: jax.Array  # (n,) bool
    too_slow: jax.Array  # () bool


def _path(lumped: Lumped, sun_speed: Array, output_torque: Array, stage: str, samples: int) -> _Path:
    variation = lumped.mesh_variation
    swing, duty = getattr(variation, f"{stage}_swing"), getattr(variation, f"{stage}_duty")
    modal = modal_sectors(lumped, [("coupled", 0)])["coupled", 0]
    members = spring_table(lumped.cranks, lumped.discs).of(MESH[stage])
    w = mesh_frequency(lumped, sun_speed, stage)
    phase = jnp.sign(w) * jnp.asarray(mesh_phases(lumped, stage), w.dtype)

    turn = 2 * jnp.pi
    grid = jnp.arange(samples, dtype=w.dtype) * (turn / samples)
    edges = jnp.mod(jnp.concatenate([jnp.pi * duty - phase, -jnp.pi * duty - phase]), turn)
    order = jnp.argsort(jnp.concatenate([grid, edges]))
    begins = jnp.concatenate([grid, edges])[order]
    ends = jnp.append(begins[1:], turn)
    middle = jnp.mod((begins + ends)[:, None] / 2 + phase[None, :] + jnp.pi, turn) - jnp.pi
    level = jnp.where(jnp.abs(middle) < jnp.pi * duty, swing * (1 - duty), -swing * duty)
    lengths = (ends - begins) / jnp.abs(w)

    rigid = modal.square <= jnp.finfo(w.dtype).eps * jnp.max(modal.square)
    highest = jnp.sqrt(jnp.max(modal.square))
    springs = modal.springs[members]
    # A rigid mode strains no mesh and balanced loads do not drive it: a spring on it alone changes nothing else.
    held = modal.stiffness + jnp.diag(jnp.where(rigid, jnp.max(modal.square), 0))
    varied = (level * mesh_stiffness(lumped, MESH[stage])[None, :]) @ (
        springs[:, :, None] * springs[:, None, :]
    ).reshape(len(members), -1)
    stiffness = held[None] + varied.reshape(-1, *held.shape)
    damping = lumped.damping
    size = len(modal.square)
    drag = damping.rayleigh_mass * jnp.eye(size, dtype=w.dtype) + damping.rayleigh_stiffness * modal.stiffness
    drag = drag + 2 * damping.modal_ratio * matrix_root(modal.stiffness, modal.square)
    start = modal.rows([2, -1])
    load = output_torque * (start[1] - start[0] / linear_ratio(lumped))
    rate = jnp.zeros((len(lengths), 2 * size + 1, 2 * size + 1), w.dtype)
    rate = rate.at[:, :size, size : 2 * size].set(highest * jnp.eye(size, dtype=w.dtype))
    rate = rate.at[:, size : 2 * size, :size].set(-stiffness / highest)
    rate = rate.at[:, size : 2 * size, size : 2 * size].set(-drag)
    rate = rate.at[:, size : 2 * size, -1].set(load / highest)
    steps, too_slow = _exponential(rate * lengths[:, None, None])
    return _Path(modal, w, steps, lengths, jnp.argsort(order)[:samples], rigid, too_slow)


def _exponential(matrices: jax.Array) -> tuple[jax.Array, jax.Array]:
    """exp of a batch of matrices by a Taylor series and repeated squaring: products only, no LAPACK call."""
    norm = jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(matrices), axis=-1)))
    squarings = jnp.maximum(jnp.ceil(jnp.log2(jnp.maximum(norm, 1e-30))) + 1, 0).astype(jnp.int32)
    small = matrices * jnp.exp2(-squarings.astype(matrices.dtype))
    one = jnp.broadcast_to(jnp.eye(matrices.shape[-1], dtype=matrices.dtype), matrices.shape)
    series = one
    for degree in range(TAYLOR_DEGREE, 0, -1):
        series = one + small @ series / degree

    def square(series: jax.Array, k: jax.Array) -> tuple[jax.Array, None]:
        return jax.lax.cond(k < squarings, lambda m: m @ m, lambda m: m, series), None

    result, _ = scan(square, series, jnp.arange(MAX_SQUARINGS, dtype=jnp.int32))
    return result, squarings > MAX_SQUARINGS


def _product(steps: jax.Array) -> jax.Array:
    """Return the map of a whole period."""
    one = jnp.eye(steps.shape[-1], dtype=steps.dtype)
    return scan(lambda whole, step: (step @ whole, None), one, steps)[0]


def _largest(whole: jax.Array, path: _Path) -> jax.Array:
    largest = jnp.max(jnp.abs(jnp.linalg.eigvals(whole[:-1, :-1])))
    return jnp.where(jnp.any(path.rigid), jnp.maximum(largest, 1), largest)


def _unstable(multiplier: jax.Array) -> jax.Array:
    return multiplier > 1 + max(1e-9, 1e3 * float(jnp.finfo(multiplier.dtype).eps))
