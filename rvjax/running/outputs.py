"""Outputs of friction for studies and reports, each of which reads only the equilibria that it needs.

A set is as many equilibria of a whole turn of the output as there are samples, under one torque: none, that with which
the input drives, or that with which the output drives. The motion has the sign of the speed, forward without a speed.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK, quick
from rvjax.catalogue import part_class
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import Friction, RVReducer
from rvjax.errors import Errors, RVErrors
from rvjax.life import TurnPlan
from rvjax.loaded import DriveConditions as OfDrive, LoadedConditions, Methods, ways
from rvjax.outputs import Description, Joint, Output, Reading, Solved, Source, condition
from rvjax.records import PyTree, Scalar
from rvjax.running.bench import BackDriving, back_driving
from rvjax.running.inputs import check_call, entered
from rvjax.running.joint import hysteresis
from rvjax.running.losses import around, backward_efficiency, efficiency, ended, worked
from rvjax.status import Status, worst

Reducer = RVReducer | CycloidalReducer


class FrictionConditions(Methods, Protocol):
    """Conditions that friction reads."""

    @property
    def output_torque(self) -> float:
        """Of the discs on the output, N m."""

    @property
    def output_speed(self) -> float | None:
        """Of the output, rad/s; None: at rest."""

    @property
    def running_samples(self) -> int:
        """Angles of a turn of the output."""

    @property
    def input_angle(self) -> float:
        """At which the bench twists the output, rad."""

    @property
    def probe_angles(self) -> int:
        """Angles of the bench, which divide a crank turn."""


class Turned(NamedTuple):
    """Losses of a turn under one torque."""

    loss: jax.Array  # mean in motion, () N m
    rest: jax.Array  # of the worst angle at rest, () N m
    places: dict[str, jax.Array]  # parts of `loss` without drag, () N m
    drag: jax.Array  # () N m
    viscous: jax.Array  # rise of the drag with the speed, () N m s/rad
    status: jax.Array


def supports_of(conditions: FrictionConditions) -> tuple[str, str, str]:
    """Contact, carrier and sun.

    Args:
        conditions: conditions.
    """
    methods = ways(conditions)
    return methods["contact"], methods["carrier"], methods["sun"]


def turned(
    design: Reducer, errors: PyTree, conditions: FrictionConditions, torques: tuple[Scalar, ...]
) -> tuple[Turned, ...]:
    """Losses of a turn under each of some torques.

    Args:
        design: the reducer, with friction.
        errors: of its parts.
        conditions: conditions.
        torques: of the output, () N m each.
    """
    supports = supports_of(conditions)
    plan, friction = check_call("running", design, errors, None, supports, conditions.running_samples)
    return _turned(plan, errors.stiffened(design), errors, friction, torques, conditions.output_speed or 0.0)


@quick(0)
def _turned(
    plan: TurnPlan, design: Reducer, errors: Errors, friction: Friction, torques: tuple[Scalar, ...], speed: Scalar
) -> tuple[Turned, ...]:
    call = entered(plan, design, errors, friction, 0.0, speed=speed)
    under = jnp.stack([jnp.asarray(torque, call.read.torque.dtype) for torque in torques])
    turn, turns = around(plan, call, under), []
    for k in range(len(torques)):
        statuses = turn.info.status[:, k]
        idle = (under[k] != 0) & jnp.any(statuses == Status.UNLOADED)
        values = dict(loss=turn.mean(k, call.speed), rest=turn.at_rest(k), places=turn.at(k))
        values |= dict(drag=turn.drag(call.speed), viscous=turn.viscous)
        values, info = ended(call, statuses, idle, values, worked(turn.info))
        turns.append(Turned(**values, status=info.status))
    return tuple(turns)


def sign_of(conditions: FrictionConditions) -> float:
    """Direction of the motion.

    Args:
        conditions: conditions.
    """
    return -1.0 if (conditions.output_speed or 0.0) < 0 else 1.0


def torques_of(conditions: FrictionConditions) -> tuple[float, float, float]:
    """Torques of the three sets: none, input drives, output drives.

    Args:
        conditions: conditions.
    """
    size = sign_of(conditions) * abs(conditions.output_torque)
    return 0.0, size, -size


def idle(design: Reducer, errors: Errors, conditions: FrictionConditions) -> Turned:
    """Without load."""
    return turned(design, errors, conditions, torques_of(conditions)[:1])[0]


def forward(design: Reducer, errors: Errors, conditions: FrictionConditions) -> Turned:
    """Under the torque with which the input drives."""
    return turned(design, errors, conditions, torques_of(conditions)[1:2])[0]


def backward(design: Reducer, errors: Errors, conditions: FrictionConditions) -> Turned:
    """Under the torque with which the output drives."""
    return turned(design, errors, conditions, torques_of(conditions)[2:])[0]


def together(
    sources: tuple[Source, ...], design: Reducer, errors: Errors, conditions: FrictionConditions
) -> tuple[Turned, ...]:
    """Several sets in one loop.

    Args:
        sources: of `idle`, `forward` and `backward`.
        design: as in `turned`.
        errors: as in `turned`.
        conditions: conditions.
    """
    torque_of: dict[Source, float] = dict(zip((idle, forward, backward), torques_of(conditions)))
    return turned(design, errors, conditions, tuple(torque_of[source] for source in sources))


def driven_back(design: Reducer, errors: RVErrors | CycloidalErrors, conditions: FrictionConditions) -> BackDriving:
    """Torque on the output that turns it in the direction of the motion."""
    how: dict[str, Any] = dict(samples=conditions.running_samples) | ways(conditions)
    how["direction"] = "forward" if sign_of(conditions) > 0 else "backward"
    return back_driving(errors.stiffened(design), errors, **how)


def loop(design: Reducer, errors: RVErrors | CycloidalErrors, conditions: FrictionConditions) -> Solved:
    """Largest of the probe angles, which divide a crank turn."""
    design, step = (
        errors.stiffened(design),
        2 * np.pi * design.ratio / design.cycloid.pin_count / conditions.probe_angles,
    )

    how: dict[str, Any] = dict(ways(conditions))

    def at(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        solution = hysteresis(design, errors, input_angle=angle, **how)
        return solution.width, solution.info.status

    angles = conditions.input_angle + step * np.arange(conditions.probe_angles)
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


def _work(conditions: FrictionConditions) -> tuple[str, int]:
    return "life", conditions.running_samples


def _efficiency(of_turn: Turned, design: Reducer, conditions: FrictionConditions) -> Solved:
    return efficiency(of_turn.loss, jnp.asarray(conditions.output_torque, of_turn.loss.dtype)), of_turn.status


def _backward(of_turn: Turned, design: Reducer, conditions: FrictionConditions) -> Solved:
    return backward_efficiency(of_turn.loss, jnp.asarray(conditions.output_torque, of_turn.loss.dtype)), of_turn.status


def _starting(of_turn: Turned, design: Reducer, conditions: FrictionConditions) -> Solved:
    return of_turn.rest / abs(design.ratio), of_turn.status


def _no_load(of_turn: Turned, design: Reducer, conditions: FrictionConditions) -> Solved:
    return of_turn.loss / abs(design.ratio), of_turn.status


def _back_driving(start: BackDriving, design: Reducer, conditions: FrictionConditions) -> Solved:
    return start.torque, start.info.status


def _power(of_turn: Turned, design: Reducer, conditions: FrictionConditions) -> Solved:
    assert conditions.output_speed is not None  # a study without it has an error
    return abs(conditions.output_speed) * of_turn.loss, of_turn.status


def _set_of(conditions: FrictionConditions) -> tuple[Source, ...]:
    """The set of the torque of the conditions."""
    return (forward,) if conditions.output_torque * sign_of(conditions) >= 0 else (backward,)


def _refusing(
    name: str, check: Callable[[FrictionConditions], None] | None = None
) -> Callable[[Reducer, FrictionConditions], None]:
    """Check the parts of a design and its friction, then run the check `check` of the conditions."""

    def refuse(design: Reducer, conditions: FrictionConditions) -> None:
        if design.friction is None:
            raise ValueError(f"design.friction is missing: {name} needs it")
        for part in ("stiffness", "contact"):
            if getattr(design, part) is None:
                cls = part_class(type(design), part)
                keys = ", ".join(f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING)
                raise ValueError(f"design.{part} is missing: {name} needs it, with {keys}")
        check_call(name, design, design.error_record(), None, supports_of(conditions), conditions.running_samples)
        if check is not None:
            check(conditions)

    return refuse


def _loaded(conditions: FrictionConditions) -> None:
    if conditions.output_torque == 0:
        raise ValueError("conditions.output_torque = 0 N m: must not be 0; an efficiency needs a torque")


def _moving(conditions: FrictionConditions) -> None:
    if conditions.output_speed == 0:
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
