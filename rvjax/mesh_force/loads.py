"""Contact pressure of the forces on the rollers."""

import jax
import jax.numpy as jnp

from rvjax.designs import CamRollerReducer, expect
from rvjax.mesh_force import geometry, line_contact
from rvjax.mesh_force.equilibrium import MeshForces
from rvjax.plausible import checked
from rvjax.records import Array, Record, Scalar, field, promote, record


@record
class ContactPressure(Record):
    """Largest Hertzian pressure in the contacts of every roller; 0 where nothing is loaded."""

    cam: Array = field("Pa", "at the cam", shape=("rollers",))
    cage: Array = field("Pa", "at the cage", shape=("rollers",))
    gear: Array = field("Pa", "at the inner gear", shape=("rollers",))


@checked
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

    def pressure(force: jax.Array, radius: Scalar) -> jax.Array:
        return line_contact.pressure(force, design.young_modulus, design.poisson_ratio, design.roller_length, radius)

    return ContactPressure(
        cam=pressure(cam, r * design.cam_radius / link),
        cage=pressure(jnp.abs(cage), r),
        gear=pressure(gear, r * (1 + r * place.centre_curvature)),  # (10)
    )
