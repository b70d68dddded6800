"""What the forces on the rollers mean: contact pressure, load sharing, mesh stiffness."""

from functools import partial

import jax
import jax.numpy as jnp

from rvjax.designs import CamRollerReducer, expect
from rvjax.errors import CamRollerErrors
from rvjax.mesh_force import geometry, line_contact
from rvjax.mesh_force.equilibrium import MeshForces, solve
from rvjax.records import Array, Record, Scalar, field, promote, record


@record
class ContactPressure(Record):
    """Largest Hertzian pressure in the contacts of every roller; 0 where nothing is loaded."""

    cam: Array = field("Pa", "at the cam", shape=("rollers",))
    cage: Array = field("Pa", "at the cage", shape=("rollers",))
    gear: Array = field("Pa", "at the inner gear", shape=("rollers",))


@jax.jit
def contact_pressure(design: CamRollerReducer, forces: MeshForces, *, output_angle: Scalar) -> ContactPressure:
    """Hertzian line-contact pressure of the forces that `solve` returned.

    Args:
        design: the stage.
        forces: of `solve` at the same angle.
        output_angle: angle theta of the cage, () rad.
    """
    expect(design, "mesh_force.contact_pressure", CamRollerReducer)
    design, angle, cam, cage, gear = promote(design, output_angle, forces.cam, forces.cage, forces.gear)
    r, link = design.roller_radius, design.cam_radius + design.roller_radius
    place = geometry.rollers(design.eccentricity, link, design.gear_teeth, *geometry.cam_lead(design.gear_teeth, angle))

    def pressure(force: jax.Array, radius: jax.Array) -> jax.Array:
        return line_contact.pressure(force, design.young_modulus, design.poisson_ratio, design.roller_length, radius)

    return ContactPressure(
        cam=pressure(cam, r * design.cam_radius / link),
        cage=pressure(jnp.abs(cage), r),
        gear=pressure(gear, r * (1 + r * place.centre_curvature)),  # (10)
    )


@jax.jit
def load_sharing(design: CamRollerReducer, forces: MeshForces, *, output_angle: Scalar) -> jax.Array:
    """Part of the cam torque that every roller carries, (z + 1,), sum 1; 0 where there is no torque.

    Rollers preloaded on the return flank carry negative parts.

    Args:
        design: the stage.
        forces: of `solve` at the same angle.
        output_angle: angle theta of the cage, () rad.
    """
    expect(design, "mesh_force.load_sharing", CamRollerReducer)
    design, angle, cam = promote(design, output_angle, forces.cam)
    link = design.cam_radius + design.roller_radius
    place = geometry.rollers(design.eccentricity, link, design.gear_teeth, *geometry.cam_lead(design.gear_teeth, angle))
    moments = design.eccentricity * place.arm * cam  # (8)
    total = jnp.sum(moments)
    return jnp.where(total == 0, 0, moments / jnp.where(total == 0, 1, total))


@partial(jax.jit, static_argnames="contact")
def mesh_stiffness(
    design: CamRollerReducer,
    errors: CamRollerErrors,
    *,
    input_torque: Scalar,
    output_angle: Scalar,
    contact: str = "hertz",
) -> jax.Array:
    """Tangent stiffness of the crank against the fixed output, d input_torque / d windup, N m/rad.

    Args:
        design: as in `solve`.
        errors: as in `solve`.
        input_torque: as in `solve`.
        output_angle: as in `solve`.
        contact: as in `solve`.

    Returns:
        () N m/rad; 0 where nothing is loaded, NaN where `solve` fails.
    """
    expect(design, "mesh_force.mesh_stiffness", CamRollerReducer)
    design, errors, torque, angle = promote(design, errors, input_torque, output_angle)

    def windup(torque: jax.Array) -> jax.Array:
        return solve(design, errors, input_torque=torque, output_angle=angle, contact=contact).windup

    value, compliance = jax.jvp(windup, (torque,), (jnp.ones_like(torque),))
    stiffness = jnp.where(compliance > 0, 1 / jnp.where(compliance > 0, compliance, 1), 0)
    return jnp.where(jnp.isnan(value), jnp.nan, stiffness)
