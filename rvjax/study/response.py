"""What a question needs: from the outputs asked for to one function of the errors that computes just those.

An output is one scalar of one unit. Statistics and allocation see the resulting response
`errors -> Outcome` and know nothing of gears; the models know nothing of statistics.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import four_bar, lost_motion, mesh_force
from rvjax.designs import CamRollerReducer, RVReducer
from rvjax.levels.choice import Choice, as_given, choose
from rvjax.lost_motion.reducer import PROFILES
from rvjax.mesh_force.laws import CONTACTS
from rvjax.status import Status, worst
from rvjax.tolerances import Outcome

__all__ = [
    "CamRollerConditions",
    "Choice",
    "Curve",
    "KINDS",
    "Kind",
    "Output",
    "RVConditions",
    "as_given",
    "check_nominal",
    "choose",
    "kind",
    "response",
]

CLOSURES = ("first_order", "quadratic", "closed_form", "newton")
Solved = tuple[Any, Any]  # value and status


@dataclass(frozen=True)
class RVConditions:
    """How an RV reducer runs while it is judged.

    Attributes:
        output_torque: torque of the discs on the carrier, N m.
        angles: uniform crank angles over one crank turn.
        cranks: "phase_locked", "geared" or "free".
        gear_stiffness_ratio: stiffness of the gears between the cranks, for geared cranks.
        lost_motion_profile: "first_order", "closed_form" or "contact".
        closure: of the crank linkages, as in `four_bar.revolution`; None is the exact one.
    """

    output_torque: float = field(default=0.0, metadata=dict(unit="N m"))
    angles: int = field(default=64, metadata=dict(minimum=8))
    cranks: str = field(default="phase_locked", metadata=dict(choices=("phase_locked", "geared", "free")))
    gear_stiffness_ratio: float | None = field(default=None, metadata=dict(unit="-"))
    lost_motion_profile: str = field(default="first_order", metadata=dict(choices=PROFILES))
    closure: str | None = field(default=None, metadata=dict(choices=CLOSURES))


@dataclass(frozen=True)
class CamRollerConditions:
    """How an oscillatory roller stage runs while it is judged.

    Attributes:
        input_torque: torque on the crank, N m.
        contact: "palmgren", "hertz" or "linear".
        angles: output angles in the time in which a roller takes the place of the next.
    """

    input_torque: float = field(default=0.0, metadata=dict(unit="N m"))
    contact: str = field(default="palmgren", metadata=dict(choices=CONTACTS))
    angles: int = field(default=1, metadata=dict(minimum=1))


@dataclass(frozen=True)
class Output:
    """One scalar of one unit.

    Attributes:
        unit: SI unit.
        meaning: one line.
        evaluate: (design, errors, conditions) -> (value, status).
    """

    unit: str
    meaning: str
    evaluate: Callable[[Any, Any, Any], Solved]


@dataclass(frozen=True)
class Curve:
    """What a person looks at over one cycle of one unit.

    Attributes:
        title: of a picture.
        unit: SI unit of the values.
        evaluate: (design, errors, conditions) -> (angle in rad (n,), values (n,)).
    """

    title: str
    unit: str
    evaluate: Callable[[Any, Any, Any], tuple[Any, Any]]


@dataclass(frozen=True)
class Kind:
    """What can be asked of one kind of reducer.

    Attributes:
        conditions: class of its conditions.
        outputs: by name.
        curve: to look at.
    """

    conditions: Any
    outputs: Mapping[str, Output]
    curve: Curve


def _turn(design: RVReducer, errors: Any, conditions: RVConditions, *, loaded: bool = True) -> Any:
    return four_bar.revolution(
        design,
        errors,
        angles=conditions.angles,
        output_torque=conditions.output_torque if loaded else 0.0,
        cranks=conditions.cranks,
        gear_stiffness_ratio=conditions.gear_stiffness_ratio,
        closure=conditions.closure,
    )


def _transmission_error(design: RVReducer, errors: Any, conditions: RVConditions) -> Solved:
    result = _turn(design, errors, conditions)
    return result.peak_to_peak, result.info.status


def _misfit(design: RVReducer, errors: Any, conditions: RVConditions) -> Solved:
    result = _turn(design, errors, conditions, loaded=False)
    return result.largest_misfit, result.info.status


def _lost_motion(design: RVReducer, errors: Any, conditions: RVConditions) -> Solved:
    result = lost_motion.geometric(design, errors, profile=conditions.lost_motion_profile)
    return result.total, result.info.status


def _turn_curve(design: RVReducer, errors: Any, conditions: RVConditions) -> tuple[Any, Any]:
    result = _turn(design, errors, conditions)
    return result.crank_angle, result.error


def _cycle(design: CamRollerReducer, errors: Any, conditions: CamRollerConditions) -> Any:
    return mesh_force.cycle_statistics(
        design,
        errors,
        input_torque=conditions.input_torque,
        contact=conditions.contact,
        samples=conditions.angles,
    )


def _cam_force(design: CamRollerReducer, errors: Any, conditions: CamRollerConditions) -> Solved:
    result = _cycle(design, errors, conditions)
    return result.cam_peak, result.info.status


def _contact_pressure(design: CamRollerReducer, errors: Any, conditions: CamRollerConditions) -> Solved:
    result = _cycle(design, errors, conditions)
    return result.pressure_peak, result.info.status


def _cam_force_curve(design: CamRollerReducer, errors: Any, conditions: CamRollerConditions) -> tuple[Any, Any]:
    """Largest cam force of all rollers while the output turns by one tooth of the gear."""
    angles = np.linspace(0, 2 * np.pi / design.gear_teeth, 8 * (design.gear_teeth + 1), endpoint=False)

    def largest(angle: jax.Array) -> jax.Array:
        torque, contact = conditions.input_torque, conditions.contact
        return jnp.max(mesh_force.solve(design, errors, input_torque=torque, output_angle=angle, contact=contact).cam)

    return angles, jax.vmap(largest)(jnp.asarray(angles))


KINDS: dict[type, Kind] = {
    RVReducer: Kind(
        conditions=RVConditions,
        outputs={
            "transmission_error": Output("rad", "peak to peak over a crank turn under load", _transmission_error),
            "misfit": Output("m", "largest misfit of a disc on the cranks without load (assembly)", _misfit),
            "lost_motion": Output("rad", "free angle of the output, < 0: interference", _lost_motion),
        },
        curve=Curve("Transmission error over one crank turn", "rad", _turn_curve),
    ),
    CamRollerReducer: Kind(
        conditions=CamRollerConditions,
        outputs={
            "cam_force": Output("N", "largest cam force of all rollers over a work cycle", _cam_force),
            "contact_pressure": Output("Pa", "largest contact pressure over a work cycle", _contact_pressure),
        },
        curve=Curve("Largest cam force while the output turns by one tooth", "N", _cam_force_curve),
    ),
}


def kind(design: Any) -> Kind:
    """What can be asked of a design."""
    return KINDS[type(design)]


def response(
    design: Any, outputs: Sequence[str], conditions: Any, choices: Mapping[str, Choice] | None = None
) -> Callable[[Any], Outcome]:
    """The function errors -> Outcome({output: value}, status) of one unit, with no output but those asked for.

    The same question gives the same function again, so that what was compiled for it is used again.

    Args:
        design: the reducer.
        outputs: names of outputs of this kind of design.
        conditions: how the reducer runs.
        choices: levels from `choose`, by output; an output without one is computed as `conditions` say.

    Raises:
        ValueError: an output that does not exist.
    """
    known = kind(design).outputs
    for name in outputs:
        if name not in known:
            raise ValueError(f"unknown response {name!r}; there are {', '.join(known)}")
    return _response(design, tuple(outputs), conditions, tuple((choices or {}).values()))


@cache
def _response(
    design: Any, outputs: tuple[str, ...], conditions: Any, choices: tuple[Choice, ...]
) -> Callable[[Any], Outcome]:
    known, chosen = kind(design).outputs, {choice.output: choice for choice in choices}

    def one(name: str, errors: Any) -> Solved:
        if name not in chosen:
            return known[name].evaluate(design, errors, conditions)
        own = replace(conditions, **dict(chosen[name].settings))
        given = jnp.result_type(float, *jax.tree.leaves(errors))
        value, status = known[name].evaluate(design, _in_precision(errors, chosen[name].precision), own)
        return value.astype(given), status

    def evaluate(errors: Any) -> Outcome:
        found = {name: one(name, errors) for name in outputs}
        statuses = jnp.stack([jnp.asarray(status) for _, status in found.values()])
        return Outcome({name: value for name, (value, _) in found.items()}, worst(statuses))

    return evaluate


def _in_precision(errors: Any, precision: str) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, precision), errors)


def check_nominal(response: Callable[[Any], Outcome], errors: Any) -> None:
    """Refuse a question whose error-free unit already fails.

    Args:
        response: of one unit.
        errors: the record of zeros.

    Raises:
        ValueError: names the status.
    """
    status = Status(int(jax.jit(lambda e: response(e).status)(errors)))
    if status not in (Status.CONVERGED, Status.UNLOADED):
        raise ValueError(f"the unit without errors cannot be solved: {status.name}")
