"""Losses of a running reducer by place, efficiency, and the torques at rest."""

import jax
import jax.numpy as jnp

from rvjax._jax.programs import quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import Friction, RVReducer
from rvjax.errors import RVErrors
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.running.inputs import Plan, check_call, entered
from rvjax.running.turn import around, ended, worked
from rvjax.status import SolveInfo, Status


@record
class Losses(Record):
    """Losses of one reducer at a torque and a speed, of first order in the friction.

    Their error is 0.33 L^2 of the torque, L = loss_torque without drag over the torque.
    """

    efficiency: Array = field("-", "input drives, at this size of the torque; 0 without torque")
    backward_efficiency: Array = field("-", "output drives, likewise; 0 where it cannot")
    input_torque: Array = field("N m", "on the sun or shaft")
    power_loss: Array = field("W", "at the torque and speed")
    loss_torque: Array = field("N m", "power loss over output speed; at rest its limit")
    ring_pins: Array = field("N m", "part of loss_torque")
    output_pins: Array = field("N m", "part of loss_torque; 0 without output pins")
    arm_bearings: Array = field("N m", "part of loss_torque")
    support_bearings: Array = field("N m", "part of loss_torque")
    gear_meshes: Array = field("N m", "part of loss_torque; 0 without meshes")
    drag: Array = field("N m", "part of loss_torque")
    starting_torque: Array = field("N m", "on the input, from the worst angle, without load")
    no_load_torque: Array = field("N m", "on the input in motion, without load")
    self_locking: Array = field("-", "1: a torque of this size at the output cannot start it, else 0")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")


@checked
def losses(
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
    friction: Friction | None = None,
    *,
    output_torque: Scalar,
    output_speed: Scalar,
    samples: int = 24,
    turns: float = 1.0,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Losses:
    """Losses of a reducer as built: forces of the loaded equilibrium times exact sliding speeds of the ideal motion.

    Of first order: friction does not change the forces, which is 0.33 L^2 of the torque; the true loss is larger where
    the input drives. Temperature, lubricant film, wear and run-in are not modelled. docs/models/running.md, Eqs. 1-14.

    Args:
        design: as in `loaded.equilibrium`; with bearings where they have a coefficient.
        errors: as in `loaded.equilibrium`; shares such as `ring_pin_friction` scale the friction.
        friction: None for that of the design.
        output_torque: of the discs on the output, () N m, either sign.
        output_speed: of the output against the part at rest, () rad/s; its sign, + for 0, is the direction of motion.
        samples: angles over the turns; three sets of so many equilibria.
        turns: of the output, a whole number of crank turns (multiples of 1 / pin_count).
        contact: as in `loaded.equilibrium`.
        carrier: as in `loaded.equilibrium`.
        sun: as in `loaded.equilibrium`.

    Returns:
        Losses. UNLOADED: at some angle under the torque no pin is pressed; at torque 0 within play drag and moments are
        left. With NaN values the worst status of the equilibria at torque 0 and at both signs of this torque;
        NONFINITE, INVALID_GEOMETRY (traced coefficient < 0, static_factor <= 0, gear_meshes >= 1, share < -1).

    Raises:
        ValueError: names the field: no friction, a coefficient of bearings that the design does not have, output_pins
            of an RV reducer, support_bearings or gear_meshes of a single-stage drive, samples < 1, turns not a whole
            number of crank turns, and as `loaded.equilibrium`.
    """
    plan, friction = check_call("running.losses", design, errors, friction, (contact, carrier, sun), samples, turns)
    return _losses(plan, design, errors, friction, output_torque, output_speed)


@quick(0)
def _losses(
    plan: Plan, design: PyTree, errors: PyTree, friction: Friction, output_torque: Scalar, output_speed: Scalar
) -> Losses:
    call = entered(plan, design, errors, friction, output_torque, speed=output_speed)
    torque, speed = call.read.torque, call.speed
    sign = jnp.where(speed >= 0, 1, -1).astype(torque.dtype)
    size = sign * jnp.abs(torque)
    turn = around(plan, call, jnp.stack([jnp.zeros_like(torque), size, -size]))
    driven = torque * sign >= 0  # the input drives
    forward, backward = turn.at(1), turn.at(2)
    parts = {name: jnp.where(driven, forward[name], backward[name]) for name in forward}
    parts["drag"] = turn.drag(speed)
    loss = sum(parts.values(), jnp.zeros_like(torque))
    values = dict(
        efficiency=efficiency(turn.mean(1, speed), torque),
        backward_efficiency=backward_efficiency(turn.mean(2, speed), torque),
        input_torque=(torque + sign * loss) / turn.ratio,
        power_loss=jnp.abs(speed) * loss,
        loss_torque=loss,
        **parts,
        starting_torque=turn.at_rest(0) / abs(turn.ratio),
        no_load_torque=turn.mean(0, speed) / abs(turn.ratio),
    )
    values["self_locking"] = (turn.at_rest(2) > jnp.abs(torque)).astype(torque.dtype)
    idle = jnp.any(turn.info.status[:, 1:] == Status.UNLOADED)
    values, info = ended(call, turn.info.status, idle, values, worked(turn.info))
    return Losses(**values, info=info)


def efficiency(loss: jax.Array, torque: jax.Array) -> jax.Array:
    """Output over input power where the input drives; 0 with derivative 0 without torque. Eq. 12.

    Args:
        loss: mean loss torque in motion, N m.
        torque: N m, of this size.
    """
    size, loaded = jnp.abs(torque), torque != 0
    return jnp.where(loaded, size / (jnp.where(loaded, size, 1) + loss), 0)


def backward_efficiency(loss: jax.Array, torque: jax.Array) -> jax.Array:
    """Input over output power where the output drives; 0 where it cannot, and without torque. Eq. 12.

    Args:
        loss: mean loss torque in motion, N m.
        torque: N m, of this size.
    """
    loaded = torque != 0
    return jnp.where(loaded, jnp.maximum(1 - loss / jnp.where(loaded, jnp.abs(torque), 1), 0), 0)
