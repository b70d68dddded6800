"""Losses of a running reducer: loss torque at the angles of a turn by place, efficiency, torques at rest.

Derivation: docs/models/running.md.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import quick
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import Friction
from rvjax.life import TurnPlan, magnitude, shared, tapered
from rvjax.loaded import Case, equilibria, forces, named_forces, output_rotation
from rvjax.records import Array, Record, Scalar, field, record
from rvjax.running.inputs import Call, check_call, entered, kind_of
from rvjax.status import SolveInfo, Status

PLACES = ("ring_pins", "output_pins", "arm_bearings", "support_bearings", "gear_meshes")
_TURNED = "turned"


class Turn(NamedTuple):
    """Loss torques at the output, N m, of n angles under t torques, in motion."""

    places: dict[str, jax.Array]  # (n, t) of each of `PLACES`, with load-free moments of bearings
    coulomb: jax.Array  # () drags
    viscous: jax.Array  # () N m s/rad
    static_factor: jax.Array  # ()
    ratio: float
    info: SolveInfo  # (n, t)
    displacements: jax.Array  # (n, t, unknowns), as in `loaded.equilibria`
    held: jax.Array | None = None  # (m, t) rad, rotations of the output where the input is held; `info` has them last

    def drag(self, speed: jax.Array | float) -> jax.Array:
        """Drag at a speed of the output. Eq. 10.

        Args:
            speed: () rad/s.
        """
        return self.coulomb + self.viscous * jnp.abs(speed)

    def at(self, torque: int) -> dict[str, jax.Array]:
        """Means over the angles by place under one of the torques, ().

        Args:
            torque: its number.
        """
        return {name: jnp.mean(loss[:, torque]) for name, loss in self.places.items()}

    def mean(self, torque: int, speed: jax.Array | float = 0.0) -> jax.Array:
        """Mean loss torque in motion under one of the torques, ().

        Args:
            torque: its number.
            speed: () rad/s.
        """
        return sum(self.at(torque).values(), self.drag(speed))

    def at_rest(self, torque: int) -> jax.Array:
        """Loss torque at rest of the worst angle under one of the torques, ().

        Args:
            torque: its number.
        """
        each = sum((loss[:, torque] for loss in self.places.values()), self.coulomb)
        return self.static_factor * jnp.max(each)


def around(
    plan: TurnPlan, call: Call, torques: jax.Array, start: jax.Array | None = None, held: jax.Array | None = None
) -> Turn:
    """Losses along the turn. Eqs. 1 to 10.

    Args:
        plan: counts and methods.
        call: numbers of the call.
        torques: of the output, (t,) N m; each is a set of `plan.samples` equilibria.
        start: displacements of a turn under similar torques.
        held: more torques (m, t) N m, at the input angle of the call; without start.
    """
    read, friction, layout = call.read, call.friction, plan.layout
    kind = kind_of(read.design)

    def take(case: Case, q: jax.Array, carries: jax.Array) -> dict[str, jax.Array]:
        at = forces(layout, case.system, q)
        of_names = named_forces(layout, read, case, at)
        sums = {"ring_pins": jnp.sum(at.pins * jnp.abs(ring_slip(call, case))), kind.joints: jnp.sum(at.joints)}
        arm, support = (jnp.where(carries, force, 0) for force in (of_names.disc_bearing, of_names.support_bearing))
        sums = {name: jnp.where(carries, value, 0) for name, value in sums.items()}
        sums |= {name: jnp.sum(value) for name, value in bearing_moments(call, arm, support).items()}
        return sums if held is None else sums | {_TURNED: output_rotation(layout, case, q)}

    angles = plan.input_angles(read.design, read.torque.dtype)
    if held is None:
        solution = equilibria(layout, read, torques, angles, take, start, near=plan.near)
    else:
        every = jnp.append(angles, jnp.broadcast_to(read.angle, held.shape[:1]))
        rows = jnp.concatenate([jnp.broadcast_to(torques, (plan.samples, len(torques))), held])
        follows = np.isin(np.arange(len(every)), np.arange(1, plan.samples)) if plan.near else False
        solution = equilibria(layout, read, rows, every, take, near=follows)
    taken = {name: value[: plan.samples] for name, value in solution.taken.items()}
    cycloid, cranks = read.design.cycloid, read.design.counts["cranks"]
    slip = jnp.asarray(kind.joint_slip(read.design, read.eccentricity), torques.dtype)
    rates = {
        "ring_pins": friction.ring_pins,
        kind.joints: getattr(friction, kind.joints) * slip if getattr(friction, kind.joints) is not None else 0.0,
        "arm_bearings": cycloid.pin_count * 1.0,
        "support_bearings": kind.support_turns(read.design) * 1.0,
    }
    free = {
        "arm_bearings": cycloid.pin_count * cycloid.disc_count * cranks * friction.arm_bearing_moment,
        "support_bearings": kind.support_turns(read.design) * 2 * cranks * friction.support_bearing_moment,
    }
    nothing = jnp.zeros((plan.samples, len(torques)), torques.dtype)
    places = {name: rates.get(name, 0.0) * taken.get(name, nothing) + free.get(name, 0.0) for name in PLACES}
    ratio = read.design.ratio
    return Turn(
        places=places,
        coulomb=friction.output_drag + abs(ratio) * friction.input_drag,
        viscous=friction.output_viscous + ratio**2 * friction.input_viscous,
        static_factor=friction.static_factor,
        ratio=ratio,
        info=solution.info,
        displacements=solution.displacements,
        held=None if held is None else solution.taken[_TURNED][plan.samples :],
    )


def ring_slip(call: Call, case: Case) -> jax.Array:
    """Sliding at each ring pin per radian of the carrier against the ring, (d, p) m, signed. Eq. 1.

    Args:
        call: radii are read.
        case: of the angle.
    """
    cycloid = call.read.design.cycloid
    return jnp.asarray(cycloid.pin_circle_radius * case.size - cycloid.pin_radius)


def bearing_moments(call: Call, arm: jax.Array, support: jax.Array) -> dict[str, jax.Array]:
    """Friction moment of the load of each bearing, N m: arm (d, c), support (c, 2); only those with a coefficient.

    Args:
        call: coefficients and bearings.
        arm: crank on disc, (d, c, 2) N.
        support: crank on carrier, (c, 2) N.
    """
    friction, bearings = call.friction, call.bearings
    moments = dict[str, jax.Array]()
    if bearings is None:
        return moments
    if friction.arm_bearings is not None:
        moments["arm_bearings"] = friction.arm_bearings * magnitude(arm) * bearings.arm.pitch_diameter / 2
    if friction.support_bearings is not None:
        assert bearings.support is not None
        force = shared(bearings, arm, support)
        load = magnitude(force) if bearings.preload is None else tapered(bearings, force).dynamic
        moments["support_bearings"] = friction.support_bearings * load * bearings.support.pitch_diameter / 2
    return moments


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
    design: Reducer,
    errors: ReducerErrors,
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
    plan: TurnPlan,
    design: Reducer,
    errors: ReducerErrors,
    friction: Friction,
    output_torque: Scalar,
    output_speed: Scalar,
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
    values, info = call.gate.close_all(values, turn.info, idle)
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
