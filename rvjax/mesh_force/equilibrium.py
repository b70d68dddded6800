"""Forces on the rollers of one unit at one output angle.

Equilibrium of a case: its derivatives, and how batches of cases are laid out.

A batch is solved in blocks small enough for the cache, as arrays (rollers, cases): arithmetic then runs along
the cases, and a sum over the rollers is a sum of rows. `jax.vmap` alone would put the cases first, where sums
over two dozen rollers cost several times as much; the rule in `_batched` chooses the layout.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import LARGEST_ANGLE
from rvjax._jax.kernels import BatchedKernel, along_lanes, block_by_block
from rvjax._jax.sizes import ROLLER_CASES
from rvjax.base.words import choose
from rvjax.catalogue import checked
from rvjax.designs import CamRollerReducer, expect
from rvjax.errors import CamRollerErrors
from rvjax.geometry import undercut_margin
from rvjax.mesh_force import laws, line_contact
from rvjax.mesh_force.block import Solution, solve_block
from rvjax.mesh_force.geometry import Case, all_rollers, lever, take_apart
from rvjax.mesh_force.laws import Compliance
from rvjax.records import Array, Record, Scalar, field, promote, record, signs_hold
from rvjax.status import SolveInfo, Status, admit, converged, window

Pair = tuple[jax.Array, jax.Array]
Primals = tuple[jax.Array, jax.Array, Compliance, jax.Array, jax.Array, jax.Array]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def with_implicit_derivative(
    law: str,
    arm: jax.Array,
    gap: jax.Array,
    compliance: Compliance,
    torque: jax.Array,
    windup: jax.Array,
    load: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Windup and loads unchanged, with the derivatives of the equilibrium.

    By the implicit function theorem, du_i = S_i (a_i dtau + tau da_i + dg_i - dD_i), with dtau from the
    derivative of the moment; 0 for an unloaded roller. Forward, reverse and repeated.

    Args:
        law: one of `laws.CONTACTS`.
        arm: moment arms (n,).
        gap: interference (n,).
        compliance: of the rollers.
        torque: ().
        windup: () of the equilibrium.
        load: (n,) of the equilibrium.
    """
    return windup, load


@with_implicit_derivative.defjvp
def _with_implicit_derivative_jvp(law: str, primals: Primals, tangents: Primals) -> tuple[Pair, Pair]:
    arm, gap, compliance, _, _, _ = primals
    darm, dgap, dcompliance, dtorque, _, _ = tangents
    windup, load = with_implicit_derivative(law, *primals)
    rate = jnp.where(load > 0, 1 / laws.slope(law, load, compliance), 0)
    _, dapproach = jax.jvp(lambda c: laws.approach(law, load, c), (compliance,), (dcompliance,))
    ddepth = windup * darm + dgap - dapproach
    arm = lever(arm)
    slope = jnp.sum(arm**2 * rate)
    dmissing = dtorque - jnp.sum(load * darm) - jnp.sum(arm * rate * ddepth)
    # Nothing loaded: the windup is where the first roller touches.
    first = (arm > 0) & (windup * arm + gap >= -1e-12 * jnp.abs(gap))
    touching = jnp.sum(jnp.where(first, arm, 0))
    dedge = -jnp.sum(jnp.where(first, windup * darm + dgap, 0)) / jnp.where(touching > 0, touching, 1)
    dwindup = jnp.where(slope > 0, dmissing / jnp.where(slope > 0, slope, 1), dedge)
    return (windup, load), (dwindup, rate * (arm * dwindup + ddepth))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def equilibrium(law: str, teeth: int, case: Case) -> Solution:
    """Return the equilibrium of a case, (n,) loads; carries no derivative.

    Args:
        law: one of `laws.CONTACTS`.
        teeth: z.
        case: the case.
    """
    solution = _batched(law, teeth)(jax.tree.map(lambda leaf: leaf[None], case))
    return jax.tree.map(lambda leaf: leaf[0], solution)


@equilibrium.defjvp
def _equilibrium_jvp(law: str, teeth: int, primals: tuple[Case], tangents: tuple[Case]) -> tuple[Solution, Solution]:
    solution = equilibrium(law, teeth, *primals)
    return solution, jax.custom_derivatives.zero_from_primal(solution)


@functools.lru_cache(maxsize=64)
def _batched(law: str, teeth: int) -> Callable[[Case], Solution]:
    """Batch (cases, ...) -> Found (cases, ...); vmap makes a larger batch of it."""
    return along_lanes(BatchedKernel(functools.partial(_in_blocks, law, teeth), functools.partial(_shapes, teeth)))


def _shapes(teeth: int, case: Case) -> object:
    size, dtype = max(leaf.shape[0] for leaf in case), case.torque.dtype
    number: Any = jax.ShapeDtypeStruct((size,), dtype)
    return Solution(
        windup=number,
        load=number.update(shape=(size, teeth + 1)),
        steps=number.update(dtype=jnp.int32),
        residual=number,
        loaded=number.update(dtype=bool),
        overload=number.update(dtype=bool),
        finite=number.update(dtype=bool),
    )


def _in_blocks(law: str, teeth: int, case: Case) -> Solution:
    width = min(max(len(leaf) for leaf in case), ROLLER_CASES.here)
    return block_by_block(lambda case: solve_block(law, teeth, case, width), case, width)


@record
class MeshForces(Record):
    """Forces on rollers i = 0 .. z, which lie at output_angle + 2 pi i / (z + 1)."""

    cam: Array = field("N", "force of the cam, >= 0", shape=("rollers",))
    cage: Array = field("N", "force of the cage, signed like sin psi", shape=("rollers",))
    gear: Array = field("N", "force of the inner gear, >= 0", shape=("rollers",))
    windup: Array = field("rad", "crank rotation against the fixed output")
    info: SolveInfo = field("-", "residual: moment missing, relative", kind="record")


@checked
@functools.partial(jax.jit, static_argnames="contact")
def solve(
    design: CamRollerReducer,
    errors: CamRollerErrors,
    *,
    input_torque: Scalar,
    output_angle: Scalar,
    contact: str = "hertz",
) -> MeshForces:
    """Forces of cam, cage and gear on every roller, and the elastic windup of the crank.

    Quasi-static, without friction; every contact is elastic and unilateral. Errors act as interference on the
    nominal geometry, which they leave as it is.

    Args:
        design: the stage.
        errors: of its parts, m; `roller_radius` is () or one number per roller (z + 1,).
        input_torque: torque M0 on the crank, of which one cam carries `cam_share`, () N m; < 0 drives the other way.
        output_angle: angle theta of the cage, () rad; at 0 roller 0 is at dead centre.
        contact: "hertz", "linear" (its small-load limit) or "palmgren" (softer, for errors of many micrometres).

    Returns:
        MeshForces. Status CONVERGED, UNLOADED (no torque and no preload: windup is where contact begins), or with
        NaN values: NONFINITE, INVALID_GEOMETRY, UNDERCUT, CONTACT_OVERLOAD (a half-width reaches a radius; hertz
        only), MAX_STEPS. Wei et al. 2021, Eqs. 4-27.

    Raises:
        ValueError: unknown `contact`, or a shape of `errors.roller_radius` that does not fit the design.
    """
    expect(design, "mesh_force.solve", CamRollerReducer)
    choose("contact", contact, laws.CONTACTS)
    z = design.gear_teeth
    if np.shape(errors.roller_radius) not in ((), (z + 1,)):
        raise ValueError(
            f"CamRollerErrors.roller_radius: shape {np.shape(errors.roller_radius)}, expected () or ({z + 1},)"
        )
    design, errors, torque, angle = promote(design, errors, input_torque, output_angle)
    widest = jnp.max(jnp.abs(errors.roller_radius))  # NaN where one is
    leaves = jax.tree.leaves((design, errors.replace(roller_radius=widest), torque, angle))
    finite = functools.reduce(operator.and_, [jnp.isfinite(leaf) for leaf in leaves])
    finite &= jnp.abs(z * angle) < LARGEST_ANGLE
    possible = signs_hold(design) & (jnp.abs(design.poisson_ratio) < 1)
    possible &= design.eccentricity < design.cam_radius + design.roller_radius
    in_range, crushing = _in_range(design, errors, widest, torque)
    crushing &= contact == "hertz"
    refusals = (
        (~(finite & (~possible | in_range | crushing)), Status.NONFINITE),
        (~possible, Status.INVALID_GEOMETRY),
        (undercut_margin(design) <= 0, Status.UNDERCUT),
        (crushing, Status.CONTACT_OVERLOAD),
    )
    design, gate = admit(design, _harmless(z), *refusals)
    others = errors.replace(roller_radius=0.0)
    (others, torque, angle), gate = admit((others, torque, angle), 0, after=gate)
    errors = others.replace(roller_radius=errors.roller_radius)

    case, unit = take_apart(design, errors, torque, angle, gate.good)
    solution = equilibrium(contact, z, case)
    rollers = all_rollers(z, case)
    windup, load = with_implicit_derivative(
        contact, rollers.arm, rollers.gap, rollers.compliance, case.torque, solution.windup, solution.load
    )
    windup *= design.roller_radius / design.eccentricity
    cam = unit * load

    tolerance = 1e-12 if torque.dtype == jnp.float64 else 64 * float(jnp.finfo(torque.dtype).eps)
    (cam, cage, gear, windup), info = gate.close(
        (cam, cam * rollers.cage_ratio, cam * rollers.compliance.gear, windup),
        (~solution.finite, Status.NONFINITE),
        (solution.overload, Status.CONTACT_OVERLOAD),
        (~(solution.residual <= tolerance), Status.MAX_STEPS),
        ((case.torque == 0) & ~solution.loaded, Status.UNLOADED),
        info=converged(solution.residual, solution.steps),
    )
    return MeshForces(cam, cage, gear, windup, info)


def _in_range(
    design: CamRollerReducer, errors: CamRollerErrors, widest: jax.Array, torque: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """True if no product overflows, and True if only the load does; squares of the ratios are formed."""
    r, e, link = design.roller_radius, design.eccentricity, design.cam_radius + design.roller_radius
    _, root = window(torque, 0.5)
    unit = line_contact.load_unit(design.young_modulus, design.poisson_ratio, design.roller_length, r)
    interference = jnp.abs(errors.cam_radius) + jnp.abs(errors.eccentricity) + widest
    ratios = (link / r, link / e, link / design.cam_radius, interference / r, design.roller_length / r)
    load = jnp.abs(design.cam_share * torque) / (unit * e)
    sound = (unit < root) & (link * e * r > 1 / root)
    sound &= design.cam_radius > 64 * float(jnp.finfo(torque.dtype).eps) * link  # formed as the rest of the link
    for ratio in ratios:
        sound &= ratio * ratio < root
    fits = (load < root) & (unit * (1 + load) < root)
    large_enough = (unit * e > 1 / root) & ((load > 1 / root) | (torque == 0) | (design.cam_share == 0))
    return sound & fits & large_enough, sound & ~fits & jnp.isfinite(torque)


def _harmless(teeth: int) -> CamRollerReducer:
    return CamRollerReducer(
        gear_teeth=teeth,
        cam_radius=1.0,
        roller_radius=0.1,
        roller_length=0.1,
        eccentricity=0.2 / teeth**2,
        young_modulus=1.0,
        poisson_ratio=0.3,
        cam_share=1.0,
    )
