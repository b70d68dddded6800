"""Outputs of friction for studies and reports, each of which reads only the equilibria that it needs.

A set is as many equilibria of a whole turn of the output as there are samples, under one torque: none, that with which
the input drives, or that with which the output drives. The motion has the sign of the speed, forward without a speed.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK, quick
from rvjax.catalogue import part_class
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import Friction, RVReducer
from rvjax.loaded import DriveConditions as OfDrive, LoadedConditions, ways
from rvjax.outputs import Description, Joint, Output, Reading, Solved, Source, condition
from rvjax.records import PyTree, Scalar
from rvjax.running.back_driving import BackDriving, back_driving
from rvjax.running.inputs import Plan, check_call, entered
from rvjax.running.joint import hysteresis
from rvjax.running.losses import around, backward_efficiency, efficiency, ended, worked
from rvjax.status import Status, worst


class Turned(NamedTuple):
    """Losses of a turn under one torque."""

    loss: jax.Array  # mean in motion, () N m
    rest: jax.Array  # of the worst angle at rest, () N m
    places: dict[str, jax.Array]  # parts of `loss` without drag, () N m
    drag: jax.Array  # () N m
    viscous: jax.Array  # rise of the drag with the speed, () N m s/rad
    status: jax.Array


def supports_of(given: Any) -> tuple[str, str, str]:
    """Contact, carrier and sun.

    Args:
        given: conditions.
    """
    own = ways(given)
    return own["contact"], own["carrier"], own["sun"]


def turned(design: PyTree, errors: PyTree, given: Any, torques: tuple[Scalar, ...]) -> tuple[Turned, ...]:
    """Losses of a turn under each of some torques.

    Args:
        design: the reducer, with friction.
        errors: of its parts.
        given: conditions.
        torques: of the output, () N m each.
    """
    supports = supports_of(given)
    plan, friction = check_call("running", design, errors, None, supports, given.running_samples)
    return _turned(plan, errors.stiffened(design), errors, friction, torques, given.output_speed or 0.0)


@quick(0)
def _turned(
    plan: Plan, design: PyTree, errors: PyTree, friction: Friction, torques: tuple[Scalar, ...], speed: Scalar
) -> tuple[Turned, ...]:
    call = entered(plan, design, errors, friction, 0.0, speed=speed)
    under = jnp.stack([jnp.asarray(torque, call.read.torque.dtype) for torque in torques])
    turn, found = around(plan, call, under), []
    for k in range(len(torques)):
        statuses = turn.info.status[:, k]
        idle = (under[k] != 0) & jnp.any(statuses == Status.UNLOADED)
        values = dict(loss=turn.mean(k, call.speed), rest=turn.at_rest(k), places=turn.at(k))
        values |= dict(drag=turn.drag(call.speed), viscous=turn.viscous)
        values, info = ended(call, statuses, idle, values, worked(turn.info))
        found.append(Turned(**values, status=info.status))
    return tuple(found)


def sign_of(given: Any) -> float:
    """Direction of the motion.

    Args:
        given: conditions.
    """
    return -1.0 if (given.output_speed or 0.0) < 0 else 1.0


def torques_of(given: Any) -> tuple[float, float, float]:
    """Torques of the three sets: none, input drives, output drives.

    Args:
        given: conditions.
    """
    size = sign_of(given) * abs(given.output_torque)
    return 0.0, size, -size


def idle(design: PyTree, errors: PyTree, given: Any) -> Turned:
    """Without load."""
    return turned(design, errors, given, torques_of(given)[:1])[0]


def forward(design: PyTree, errors: PyTree, given: Any) -> Turned:
    """Under the torque with which the input drives."""
    return turned(design, errors, given, torques_of(given)[1:2])[0]


def backward(design: PyTree, errors: PyTree, given: Any) -> Turned:
    """Under the torque with which the output drives."""
    return turned(design, errors, given, torques_of(given)[2:])[0]


def together(sources: tuple[Source, ...], design: PyTree, errors: PyTree, given: Any) -> tuple[Turned, ...]:
    """Several sets in one loop.

    Args:
        sources: of `idle`, `forward` and `backward`.
        design: as in `turned`.
        errors: as in `turned`.
        given: conditions.
    """
    own: dict[Source, float] = dict(zip((idle, forward, backward), torques_of(given)))
    return turned(design, errors, given, tuple(own[source] for source in sources))


def driven_back(design: PyTree, errors: PyTree, given: Any) -> BackDriving:
    """Torque on the output that turns it in the direction of the motion."""
    how: dict[str, Any] = dict(samples=given.running_samples) | ways(given)
    how["direction"] = "forward" if sign_of(given) > 0 else "backward"
    return back_driving(errors.stiffened(design), errors, **how)


def loop(design: PyTree, errors: PyTree, given: Any) -> Solved:
    """Largest of the probe angles, which divide a crank turn."""
    design, step = errors.stiffened(design), 2 * np.pi * design.ratio / design.cycloid.pin_count / given.probe_angles

    how: dict[str, Any] = dict(ways(given))

    def at(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = hysteresis(design, errors, input_angle=angle, **how)
        return found.width, found.info.status

    angles = given.input_angle + step * np.arange(given.probe_angles)
    width, status = jax.vmap(at)(jnp.asarray(angles, jnp.result_type(float, *jax.tree.leaves((design, errors)))))
    return jnp.max(width), worst(status)


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


RunningConditions = dataclasses.make_dataclass("RunningConditions", _conditions(LoadedConditions), frozen=True)
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
    conditions=RunningConditions,
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
