"""Forces over one work cycle of a roller, their statistics and parametric studies; outputs of studies.

While the output turns by 2 pi / (z n) the n rollers together pass through every cam lead, so that few
angles describe the whole cycle of one roller. With an error for each roller the rollers differ, and the
output has to turn by a whole tooth.

Source: Wei et al. 2021, Chin. J. Mech. Eng. 34:84, section 4, Figs. 11-16.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.catalogue import CORR, checked
from rvjax.designs import CamRollerReducer, expect
from rvjax.errors import CamRollerErrors
from rvjax.geometry import rollers
from rvjax.mesh_force import line_contact
from rvjax.mesh_force.equilibrium import MeshForces, solve
from rvjax.mesh_force.geometry import cam_lead
from rvjax.mesh_force.laws import CONTACTS
from rvjax.outputs import Cases, Curve, Description, Output, Solved, Way, condition
from rvjax.records import Array, Record, Scalar, field, promote, record
from rvjax.status import SolveInfo, worst_of
from rvjax.units import um


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
    place = rollers(design.eccentricity, link, design.gear_teeth, *cam_lead(design.gear_teeth, angle))

    def pressure(force: jax.Array, radius: Scalar) -> jax.Array:
        return line_contact.pressure(force, design.young_modulus, design.poisson_ratio, design.roller_length, radius)

    return ContactPressure(
        cam=pressure(cam, r * design.cam_radius / link),
        cage=pressure(jnp.abs(cage), r),
        gear=pressure(gear, r * (1 + r * place.centre_curvature)),  # (10)
    )


@record
class CycleStatistics(Record):
    """Statistics over one work cycle. Means: rollers of the working half, unloaded ones count as zero."""

    cam_mean: Array = field("N", "mean cam force")
    cam_peak: Array = field("N", "largest cam force")
    gear_mean: Array = field("N", "mean gear force")
    gear_peak: Array = field("N", "largest gear force")
    cage_mean: Array = field("N", "mean signed cage force")
    cage_peak_to_peak: Array = field("N", "largest less smallest signed cage force")
    pressure_peak: Array = field("Pa", "largest contact pressure of cam, cage and gear")
    windup_mean: Array = field("rad", "mean windup")
    windup_peak_to_peak: Array = field("rad", "largest less smallest windup")
    info: SolveInfo = field("-", "of the worst angle", kind="record")


@checked
def cycle_angles(gear_teeth: int, *, samples: int = 8, roller_by_roller: bool = False) -> np.ndarray:
    """Output angles of one work cycle, rad: (samples,), or (samples n,) where the rollers differ.

    Args:
        gear_teeth: z.
        samples: angles in the time in which a roller takes the place of the next.
        roller_by_roller: whether every roller has a separate error.
    """
    points = samples * (gear_teeth + 1 if roller_by_roller else 1)
    return (np.arange(points) + 0.5) * (2 * math.pi / (gear_teeth * (gear_teeth + 1) * samples))


@checked
@partial(jax.jit, static_argnames=("contact", "samples"))
def cycle_statistics(
    design: CamRollerReducer, errors: CamRollerErrors, *, input_torque: Scalar, contact: str = "hertz", samples: int = 8
) -> CycleStatistics:
    """Mean, peak and peak to peak of the forces over one work cycle of a roller.

    Args:
        design: as in `solve`.
        errors: as in `solve`; with one radius error per roller a whole tooth is sampled.
        input_torque: as in `solve`; for a negative torque the other half works.
        contact: as in `solve`.
        samples: angles in the time in which a roller takes the place of the next, static.

    Returns:
        CycleStatistics; NaN with the worst status where an angle cannot be solved.
    """
    expect(design, "mesh_force.cycle_statistics", CamRollerReducer)
    z = design.gear_teeth
    design, errors, torque = promote(design, errors, input_torque)
    angles = cycle_angles(z, samples=samples, roller_by_roller=np.ndim(errors.roller_radius) == 1)

    def at(angle: jax.Array) -> tuple[MeshForces, jax.Array, jax.Array]:
        forces = solve(design, errors, input_torque=torque, output_angle=angle, contact=contact)
        pressure = contact_pressure(design, forces, output_angle=angle)
        largest = jnp.max(jnp.stack([pressure.cam, pressure.cage, pressure.gear]))
        sine, _ = cam_lead(z, angle)
        return forces, sine * jnp.where(torque < 0, -1, 1) > 0, largest

    forces, working, pressure = jax.vmap(at)(jnp.asarray(angles, torque.dtype))

    def mean(force: jax.Array) -> jax.Array:
        return jnp.sum(jnp.where(working, force, 0)) / jnp.sum(working, dtype=force.dtype)

    return CycleStatistics(
        cam_mean=mean(forces.cam),
        cam_peak=jnp.max(forces.cam),
        gear_mean=mean(forces.gear),
        gear_peak=jnp.max(forces.gear),
        cage_mean=mean(forces.cage),
        cage_peak_to_peak=jnp.max(forces.cage) - jnp.min(forces.cage),
        pressure_peak=jnp.max(pressure),
        windup_mean=jnp.mean(forces.windup),
        windup_peak_to_peak=jnp.max(forces.windup) - jnp.min(forces.windup),
        info=worst_of(forces.info),
    )


@checked
@partial(jax.jit, static_argnames=("parameter", "contact", "samples"))
def sweep(
    design: CamRollerReducer,
    errors: CamRollerErrors,
    parameter: str,
    values: Array | np.ndarray,
    *,
    input_torque: Scalar,
    contact: str = "hertz",
    samples: int = 8,
) -> CycleStatistics:
    """Statistics of the work cycle while one field varies; one vmapped solve.

    Args:
        design: as in `solve`.
        errors: as in `solve`.
        parameter: field of the design ("eccentricity") or of its errors ("errors.eccentricity").
        values: of that field (k,), SI.
        input_torque: as in `solve`.
        contact: as in `solve`.
        samples: as in `cycle_statistics`.

    Returns:
        CycleStatistics with (k,) fields.

    Raises:
        ValueError: no such field.
    """
    expect(design, "mesh_force.sweep", CamRollerReducer)
    name = parameter.removeprefix("errors.")
    of_errors = name != parameter
    design, errors, swept, torque = promote(design, errors, values, input_torque)

    def at(value: jax.Array) -> CycleStatistics:
        unit = (design, errors.replace(**{name: value})) if of_errors else (design.replace(**{name: value}), errors)
        return cycle_statistics(*unit, input_torque=torque, contact=contact, samples=samples)

    return jax.vmap(at)(swept)


@dataclass(frozen=True)
class MeshForceConditions:
    """Operating conditions of an oscillatory roller stage."""

    input_torque: float = condition(0.0, "torque on the crank", unit="N m", torque=True)
    contact: str = condition("palmgren", "contact law", choices=CONTACTS)
    angles: int = condition(
        1, "output angles in the time in which a roller takes the place of the next", minimum=1, maximum=100_000
    )


def _cycle(design: CamRollerReducer, errors: CamRollerErrors, conditions: MeshForceConditions) -> CycleStatistics:
    torque, contact = conditions.input_torque, conditions.contact
    return cycle_statistics(design, errors, input_torque=torque, contact=contact, samples=conditions.angles)


def _cam_force(design: CamRollerReducer, errors: CamRollerErrors, conditions: MeshForceConditions) -> Solved:
    cycle = _cycle(design, errors, conditions)
    return cycle.cam_peak, cycle.info.status


def _contact_pressure(design: CamRollerReducer, errors: CamRollerErrors, conditions: MeshForceConditions) -> Solved:
    cycle = _cycle(design, errors, conditions)
    return cycle.pressure_peak, cycle.info.status


def _curve(
    design: CamRollerReducer, errors: CamRollerErrors, conditions: MeshForceConditions
) -> tuple[np.ndarray, Array]:
    """Largest cam force of all rollers while the output turns by one tooth of the gear."""
    angles = np.linspace(0, 2 * np.pi / design.gear_teeth, 8 * (design.gear_teeth + 1), endpoint=False)

    def largest(angle: jax.Array) -> jax.Array:
        torque, contact = conditions.input_torque, conditions.contact
        return jnp.max(solve(design, errors, input_torque=torque, output_angle=angle, contact=contact).cam)

    return angles, jax.vmap(largest)(jnp.asarray(angles))


TORQUES = (11.0, 110.0)  # N m
ROLLERS = dict(cam_radius=(-4 * um, 4 * um), eccentricity=(-4 * um, 4 * um), roller_radius=(-1 * um, 1 * um))


def _cases(quick: bool) -> Sequence[Cases]:
    return [_cases_of("hertz", quick), *([] if quick else [_cases_of("palmgren", quick)])]


def _cases_of(contact: str, quick: bool) -> Cases:
    samples = (1, 8) if quick else (1, 4, 16)
    contacts = ("linear", "hertz") if contact == "hertz" else (contact,)
    ways = [Way(f"{law}, {n} angles a pitch", dict(contact=law, angles=n)) for law in contacts for n in samples[:-1]]
    exact = Way(f"{contact}, {samples[-1]} angles a pitch", dict(contact=contact, angles=samples[-1]), ("float64",))
    return Cases(
        name="mesh_force" if contact == "hertz" else f"mesh_force, {contact}",
        case="unit of the CORR, a whole work cycle under load",
        outputs={"cam_force": "N", "contact_pressure": "Pa"},
        design=CORR,
        errors=ROLLERS,
        conditions=dict(contact=contact),
        torque=TORQUES,
        ways=(*ways, exact),
        batch=128,
        calls=1 if quick else 8,
    )


DESCRIPTION = Description(
    name="mesh_force",
    design=CamRollerReducer,
    conditions=MeshForceConditions,
    outputs={
        "cam_force": Output("N", "largest cam force of all rollers over a work cycle", _cam_force),
        "contact_pressure": Output("Pa", "largest contact pressure over a work cycle", _contact_pressure),
    },
    curve=Curve("Largest cam force while the output turns by one tooth", "N", _curve),
    cases=_cases,
    unknown="friction, inertia, and errors of cage and gear",
)
