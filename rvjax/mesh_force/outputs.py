"""Outputs of the mesh-force model for studies."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.catalogue import CORR
from rvjax.designs import CamRollerReducer
from rvjax.errors import CamRollerErrors
from rvjax.mesh_force.cycle import CycleStatistics, cycle_statistics
from rvjax.mesh_force.equilibrium import solve
from rvjax.mesh_force.laws import CONTACTS
from rvjax.outputs import Cases, Curve, Description, Output, Solved, Way, condition
from rvjax.records import Array
from rvjax.units import um


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
