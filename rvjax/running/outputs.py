"""Outputs of friction for studies and reports, each of which reads only the equilibria that it needs.

A set is as many equilibria of a whole turn of the output as there are samples, under one torque: none, that with which
the input drives, or that with which the output drives. The motion has the sign of the speed, forward without a speed.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK, quick
from rvjax.cycloidal import CycloidalReducer, Reducer, ReducerErrors
from rvjax.designs import Friction, RVReducer
from rvjax.errors import Errors
from rvjax.life import TurnPlan
from rvjax.loaded import CONTACTS, SUPPORTS, check_carrying, ways
from rvjax.outputs import Description, Joint, Output, Reading, Solved, Source, condition, number_of
from rvjax.records import PyTree, Scalar
from rvjax.running.bench import BackDriving, back_driving
from rvjax.running.inputs import check_call, entered
from rvjax.running.joint import hysteresis
from rvjax.running.losses import around, backward_efficiency, efficiency
from rvjax.status import Status, worst


@dataclass(frozen=True)
class FrictionConditions:
    """Operating conditions of the friction of a single-stage drive; those of the bench as in `loaded`."""

    output_torque: float = condition(0.0, "torque of the discs on the output", unit="N m", torque=True)
    input_angle: float = condition(0.0, "of the shaft, at which the bench twists the output", unit="rad")
    probe_angles: int = condition(
        1, "input angles of the bench, equally spaced over the span from the input angle on", minimum=1, maximum=1000
    )
    pin_contact: str = condition("hertz", "contact law of discs and pins", choices=CONTACTS)
    carrier: str = condition("fixed", "centre of the carrier", choices=SUPPORTS)
    output_speed: float | None = condition(
        None, "of the output against the part at rest; its sign is the direction of motion", unit="rad/s"
    )
    running_samples: int = condition(
        24, "input angles of a turn of the output, for the friction", minimum=1, maximum=100_000
    )


@dataclass(frozen=True)
class RVFrictionConditions(FrictionConditions):
    """Those of an RV reducer."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)
    input_angle: float = condition(0.0, "of the sun, at which the bench twists the output", unit="rad")
    sun: str = condition("fixed", "centre of the sun", choices=SUPPORTS)


class Turned(NamedTuple):
    """Losses of a turn under one torque."""

    loss: jax.Array  # mean in motion, () N m
    rest: jax.Array  # of the worst angle at rest, () N m
    places: dict[str, jax.Array]  # parts of `loss` without drag, () N m
    drag: jax.Array  # () N m
    viscous: jax.Array  # rise of the drag with the speed, () N m s/rad
    status: jax.Array


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
    supports = (*ways(conditions).values(),)
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
        infos = jax.tree.map(lambda x, k=k: x[:, k], turn.info)
        idle = (under[k] != 0) & jnp.any(infos.status == Status.UNLOADED)
        values = dict(loss=turn.mean(k, call.speed), rest=turn.at_rest(k), places=turn.at(k))
        values |= dict(drag=turn.drag(call.speed), viscous=turn.viscous)
        values, info = call.gate.close_all(values, infos, idle)
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


def driven_back(design: Reducer, errors: ReducerErrors, conditions: FrictionConditions) -> BackDriving:
    """Torque on the output that turns it in the direction of the motion."""
    how: dict[str, Any] = dict(samples=conditions.running_samples) | ways(conditions)
    how["direction"] = "forward" if sign_of(conditions) > 0 else "backward"
    return back_driving(errors.stiffened(design), errors, **how)


def loop(design: Reducer, errors: ReducerErrors, conditions: FrictionConditions) -> Solved:
    """Largest of the probe angles, which divide a crank turn."""
    design = errors.stiffened(design)
    step = 2 * np.pi * design.ratio / design.cycloid.pin_count / conditions.probe_angles

    how: dict[str, Any] = {**ways(conditions)}

    def at(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        solution = hysteresis(design, errors, input_angle=angle, **how)
        return solution.width, solution.info.status

    angles = conditions.input_angle + step * np.arange(conditions.probe_angles)
    width, status = jax.vmap(at)(jnp.asarray(angles, jnp.result_type(float, *jax.tree.leaves((design, errors)))))
    return jnp.max(width), worst(status)


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
        check_carrying(design, name)
        check_call(name, design, design.error_record(), None, (*ways(conditions).values(),), conditions.running_samples)
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
    conditions=RVFrictionConditions,
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
            Reading((driven_back,), number_of("torque")), refuse=_refusing("back_driving_torque"),
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
    parts=("friction", "bearings"),
    joints=tuple(
        Joint(sources, partial(together, sources))
        for sources in ((idle, forward), (idle, backward), (forward, backward), (idle, forward, backward))
    ),
    work={source: _work for source in (idle, forward, backward)},
)  # fmt: skip
OTHERS = (dataclasses.replace(DESCRIPTION, design=CycloidalReducer, conditions=FrictionConditions),)
"""Of single-stage drives."""
