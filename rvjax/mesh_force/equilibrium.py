"""Forces on the rollers of one unit at one output angle."""

import functools
import operator

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax.choices import choose
from rvjax.designs import CamRollerReducer, expect
from rvjax.elementary import LARGEST_ANGLE
from rvjax.errors import CamRollerErrors
from rvjax.mesh_force import geometry, laws, line_contact
from rvjax.mesh_force.batch import attach, equilibrium
from rvjax.mesh_force.case import all_rollers, take_apart
from rvjax.plausible import checked
from rvjax.records import Array, Record, Scalar, field, promote, record, signs_hold
from rvjax.status import SolveInfo, Status, admit, converged, window


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
    leaves = jax.tree.leaves((design, errors, torque, angle))
    finite = functools.reduce(operator.and_, [jnp.all(jnp.isfinite(leaf)) for leaf in leaves])
    finite &= jnp.abs(z * angle) < LARGEST_ANGLE
    possible = signs_hold(design) & (jnp.abs(design.poisson_ratio) < 1)
    possible &= design.eccentricity < design.cam_radius + design.roller_radius
    in_range, crushing = _in_range(design, errors, torque)
    crushing &= contact == "hertz"
    refusals = (
        (~(finite & (~possible | in_range | crushing)), Status.NONFINITE),
        (~possible, Status.INVALID_GEOMETRY),
        (geometry.undercut_margin(design) <= 0, Status.UNDERCUT),
        (crushing, Status.CONTACT_OVERLOAD),
    )
    design, gate = admit(design, _harmless(z, torque.dtype), *refusals)
    (errors, torque, angle), gate = admit((errors, torque, angle), 0, after=gate)

    case, unit = take_apart(design, errors, torque, angle)
    found = equilibrium(contact, z, case)
    rollers = all_rollers(z, case)
    windup, load = attach(contact, rollers.arm, rollers.gap, rollers.compliance, case.torque, found.windup, found.load)
    windup *= design.roller_radius / design.eccentricity
    cam = unit * load

    tolerance = 1e-12 if torque.dtype == jnp.float64 else 64 * float(jnp.finfo(torque.dtype).eps)
    (cam, cage, gear, windup), info = gate.close(
        (cam, cam * rollers.cage_ratio, cam * rollers.compliance.gear, windup),
        (~found.finite, Status.NONFINITE),
        (found.overload, Status.CONTACT_OVERLOAD),
        (~(found.residual <= tolerance), Status.MAX_STEPS),
        ((case.torque == 0) & ~jnp.any(load > 0), Status.UNLOADED),
        info=converged(found.residual, found.steps),
    )
    return MeshForces(cam, cage, gear, windup, info)


def _in_range(design: CamRollerReducer, errors: CamRollerErrors, torque: jax.Array) -> tuple[jax.Array, jax.Array]:
    """True if no product overflows, and True if only the load does; squares of the ratios are formed."""
    r, e, link = design.roller_radius, design.eccentricity, design.cam_radius + design.roller_radius
    _, root = window(torque, 0.5)
    unit = line_contact.load_unit(design.young_modulus, design.poisson_ratio, design.roller_length, r)
    interference = jnp.max(jnp.abs(errors.cam_radius) + jnp.abs(errors.eccentricity) + jnp.abs(errors.roller_radius))
    ratios = (link / r, link / e, link / design.cam_radius, interference / r, design.roller_length / r)
    load = jnp.abs(design.cam_share * torque) / (unit * e)
    sound = (unit < root) & (link * e * r > 1 / root)
    sound &= design.cam_radius > 64 * float(jnp.finfo(torque.dtype).eps) * link  # formed as the rest of the link
    for ratio in ratios:
        sound &= ratio * ratio < root
    fits = (load < root) & (unit * (1 + load) < root)
    large_enough = (unit * e > 1 / root) & ((load > 1 / root) | (torque == 0) | (design.cam_share == 0))
    return sound & fits & large_enough, sound & ~fits & jnp.isfinite(torque)


def _harmless(teeth: int, dtype: DTypeLike) -> CamRollerReducer:
    safe = CamRollerReducer(
        gear_teeth=teeth,
        cam_radius=1.0,
        roller_radius=0.1,
        roller_length=0.1,
        eccentricity=0.2 / teeth**2,
        young_modulus=1.0,
        poisson_ratio=0.3,
        cam_share=1.0,
    )
    return jax.tree.map(lambda value: jnp.asarray(value, dtype), safe)
