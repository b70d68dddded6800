"""Loss torque of a reducer at the angles of a turn, by place, under several torques: docs/models/running.md."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.life import input_angles, magnitude, shared, tapered
from rvjax.loaded import Case, equilibria, forces, named, turned
from rvjax.records import PyTree
from rvjax.running.inputs import Call, Plan
from rvjax.running.kinds import kind_of
from rvjax.status import SolveInfo, Status, succeeded, worst

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

    @property
    def failed(self) -> jax.Array:
        """Worst status of all equilibria, ()."""
        return worst(self.info.status)


def around(
    plan: Plan, call: Call, torques: jax.Array, start: jax.Array | None = None, held: jax.Array | None = None
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
        of_names = named(layout, read, case, at)
        sums = {"ring_pins": jnp.sum(at.pins * jnp.abs(ring_slip(call, case))), kind.joints: jnp.sum(at.joints)}
        arm, support = (jnp.where(carries, force, 0) for force in (of_names.disc_bearing, of_names.support_bearing))
        sums = {name: jnp.where(carries, value, 0) for name, value in sums.items()}
        sums |= {name: jnp.sum(value) for name, value in bearing_moments(call, arm, support).items()}
        return sums if held is None else sums | {_TURNED: turned(layout, case, q)}

    angles = input_angles(plan, read.design, read.torque.dtype)
    if held is None:
        found = equilibria(layout, read, torques, angles, take, start, near=plan.near)
    else:
        every = jnp.append(angles, jnp.broadcast_to(read.angle, held.shape[:1]))
        rows = jnp.concatenate([jnp.broadcast_to(torques, (plan.samples, len(torques))), held])
        follows = np.isin(np.arange(len(every)), np.arange(1, plan.samples)) if plan.near else False
        found = equilibria(layout, read, rows, every, take, near=follows)
    taken = {name: value[: plan.samples] for name, value in found.taken.items()}
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
        info=found.info,
        displacements=found.displacements,
        held=None if held is None else found.taken[_TURNED][plan.samples :],
    )


def ring_slip(call: Call, case: Case) -> jax.Array:
    """Sliding at each ring pin per radian of the carrier against the ring, (d, p) m, signed. Eq. 1.

    Args:
        call: radii are read.
        case: of the angle.
    """
    cycloid = call.read.design.cycloid
    assert case.size is not None
    return jnp.asarray(cycloid.pin_circle_radius * case.size - cycloid.pin_radius)


def bearing_moments(call: Call, arm: jax.Array, support: jax.Array) -> dict[str, jax.Array]:
    """Friction moment of the load of each bearing, N m: arm (d, c), support (c, 2); only those with a coefficient.

    Args:
        call: coefficients and bearings.
        arm: crank on disc, (d, c, 2) N.
        support: crank on carrier, (c, 2) N.
    """
    friction, bearings = call.friction, call.bearings
    found = dict[str, jax.Array]()
    if bearings is None:
        return found
    if friction.arm_bearings is not None:
        found["arm_bearings"] = friction.arm_bearings * magnitude(arm) * bearings.arm.pitch_diameter / 2
    if friction.support_bearings is not None:
        assert bearings.support is not None
        force = shared(bearings, arm, support)
        load = magnitude(force) if bearings.preload is None else tapered(bearings, force).dynamic
        found["support_bearings"] = friction.support_bearings * load * bearings.support.pitch_diameter / 2
    return found


def ended(
    call: Call, statuses: jax.Array, idle: jax.Array, values: PyTree, info: SolveInfo
) -> tuple[PyTree, SolveInfo]:
    """Values for the user and their info: NaN where the input or an equilibrium fails.

    Args:
        call: its gate.
        statuses: of all equilibria.
        idle: whether the result counts as UNLOADED.
        values: floating results.
        info: steps and residual.
    """
    failed = worst(statuses)
    done = jnp.where(idle, int(Status.UNLOADED), int(Status.CONVERGED))
    state = jnp.where(succeeded(failed), done, failed).astype(jnp.int32)
    values, info = call.gate.close(values, info=info.replace(status=state))
    fine = succeeded(info.status)
    return jax.tree.map(lambda value: jnp.where(fine, value, jnp.nan), values), info


def worked(info: SolveInfo) -> SolveInfo:
    """Steps of all equilibria and their largest residual.

    Args:
        info: of each.
    """
    return SolveInfo(worst(info.status), jnp.sum(info.steps), jnp.max(info.residual))
