"""Outputs of friction for studies."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp

from rvjax._jax.programs import QUICK
from rvjax.catalogue import part_class
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.loaded import Conditions as OfReducer, DriveConditions as OfDrive
from rvjax.outputs import Description, Joint, Output, Reading, Solved, Source, condition
from rvjax.records import PyTree
from rvjax.running.back_driving import BackDriving
from rvjax.running.inputs import check_call
from rvjax.running.losses import backward_efficiency, efficiency
from rvjax.running.sets import Turned, backward, driven_back, forward, idle, loop, sign_of, supports_of, together


def _conditions(base: type) -> Any:
    """Conditions of the loaded reducer that friction reads, with speed and number of angles."""
    kept = ("output_torque", "input_angle", "probe_angles", "pin_contact", "carrier", "sun")
    fields = [
        (f.name, Any, dataclasses.field(default=f.default, metadata=f.metadata))
        for f in dataclasses.fields(base)
        if f.name in kept
    ]
    speed = condition(None, "of the output against the part at rest; its sign is the direction of motion", unit="rad/s")
    samples = condition(24, "input angles of a turn of the output, for the friction", minimum=1, maximum=100_000)
    return [*fields, ("output_speed", Any, speed), ("running_samples", Any, samples)]


Conditions = dataclasses.make_dataclass("Conditions", _conditions(OfReducer), frozen=True)
"""Operating conditions of the friction."""
DriveConditions = dataclasses.make_dataclass("DriveConditions", _conditions(OfDrive), frozen=True)
"""Of a single-stage drive."""


def _work(given: Any) -> tuple[str, int]:
    return "life", given.running_samples


def _efficiency(found: Turned, design: PyTree, given: Any) -> Solved:
    return efficiency(found.loss, jnp.asarray(given.output_torque, found.loss.dtype)), found.status


def _backward(found: Turned, design: PyTree, given: Any) -> Solved:
    return backward_efficiency(found.loss, jnp.asarray(given.output_torque, found.loss.dtype)), found.status


def _starting(found: Turned, design: PyTree, given: Any) -> Solved:
    return found.rest / abs(design.ratio), found.status


def _no_load(found: Turned, design: PyTree, given: Any) -> Solved:
    return found.loss / abs(design.ratio), found.status


def _back_driving(found: BackDriving, design: PyTree, given: Any) -> Solved:
    return found.torque, found.info.status


def _power(found: Turned, design: PyTree, given: Any) -> Solved:
    return abs(given.output_speed) * found.loss, found.status


def _set_of(given: Any) -> tuple[Source, ...]:
    """The set of the torque of the conditions."""
    return (forward,) if given.output_torque * sign_of(given) >= 0 else (backward,)


def _refusing(name: str, own: Callable[[Any], None] | None = None) -> Callable[[PyTree, Any], None]:
    """Check the parts of a design and its friction, then run the check `own` of the conditions."""

    def refuse(design: PyTree, given: Any) -> None:
        if design.friction is None:
            raise ValueError(f"design.friction is missing: {name} needs it")
        for part in ("stiffness", "contact"):
            if getattr(design, part) is None:
                cls = part_class(type(design), part)
                keys = ", ".join(f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING)
                raise ValueError(f"design.{part} is missing: {name} needs it, with {keys}")
        check_call(name, design, design.error_record(), None, supports_of(given), given.running_samples)
        if own is not None:
            own(given)

    return refuse


def _loaded(given: Any) -> None:
    if given.output_torque == 0:
        raise ValueError("conditions.output_torque = 0 N m: must not be 0; an efficiency needs a torque")


def _moving(given: Any) -> None:
    if given.output_speed == 0:
        raise ValueError("conditions.output_speed = 0 rad/s: must not be 0")


SPEED = ("output_speed",)
UNKNOWN = (
    "friction (first order: true losses differ by 0.33 L^2 of the torque, L = loss without drag over torque): "
    "temperature, lubricant film, wear, run-in, sticking and sliding in turn, rolling of the pins, churning that is "
    "not linear in the speed, change of the forces by friction; coefficients are inputs that makers do not publish"
)
DESCRIPTION = Description(
    name="running",
    design=RVReducer,
    conditions=Conditions,
    outputs={
        "efficiency": Output(
            "-", "output over input power, input drives", Reading((forward,), _efficiency), SPEED,
            refuse=_refusing("efficiency", _loaded),
        ),
        "backward_efficiency": Output(
            "-", "input over output power, output drives; 0 where it cannot", Reading((backward,), _backward), SPEED,
            refuse=_refusing("backward_efficiency", _loaded),
        ),
        "starting_torque": Output(
            "N m", "on the input, at rest, from the worst angle, without load", Reading((idle,), _starting),
            refuse=_refusing("starting_torque"),
        ),
        "no_load_torque": Output(
            "N m", "on the input in motion, without load, mean of a turn", Reading((idle,), _no_load), SPEED,
            refuse=_refusing("no_load_torque"),
        ),
        "back_driving_torque": Output(
            "N m", "on the output, turns it from every angle, input free; inf: self-locking",
            Reading((driven_back,), _back_driving), refuse=_refusing("back_driving_torque"),
        ),
        "power_loss": Output(
            "W", "at torque and speed, mean of a turn", Reading((forward, backward), _power, _set_of), SPEED,
            refuse=_refusing("power_loss", _moving),
        ),
        "hysteresis": Output(
            "rad", "width of the loop of torque and angle by friction, largest of the probe angles of a crank turn; "
            "with play it contains the backlash", loop, refuse=_refusing("hysteresis"),
        ),
    },
    unknown=UNKNOWN,
    compiler_options=QUICK,
    costly=True,
    parts=("friction", "bearings"),
    joints=tuple(
        Joint(sources, partial(together, sources))
        for sources in ((idle, forward), (idle, backward), (forward, backward), (idle, forward, backward))
    ),
    work={source: _work for source in (idle, forward, backward)},
)  # fmt: skip
OTHERS = (dataclasses.replace(DESCRIPTION, design=CycloidalReducer, conditions=DriveConditions),)
"""Of single-stage drives."""
