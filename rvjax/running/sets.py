"""Losses of a turn under one torque, for outputs and reports that each read only the equilibria that they need.

A set is as many equilibria of a whole turn of the output as there are samples, under one torque: none, that with which
the input drives, or that with which the output drives. The motion has the sign of the speed, forward without a speed.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import quick
from rvjax.designs import Friction
from rvjax.loaded import ways
from rvjax.outputs import Solved, Source
from rvjax.records import PyTree, Scalar
from rvjax.running.back_driving import BackDriving, back_driving
from rvjax.running.hysteresis import hysteresis
from rvjax.running.inputs import Plan, check_call, entered
from rvjax.running.turn import around, ended, worked
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
