"""Width of the loop of torque and angle, input held: friction in parallel with the elastic train."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax._jax.programs import ONCE, quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import Friction, RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded import Case, compliance, equilibria, forces, named, turned
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.running.inputs import Call, Plan, check_call, entered
from rvjax.running.kinds import kind_of
from rvjax.running.turn import bearing_moments, ended, ring_slip, worked
from rvjax.status import SolveInfo, Status


@record
class Hysteresis(Record):
    """Loop of torque and angle of a reducer whose input is held."""

    width: Array = field("rad", "of the loop at zero torque; with play it contains the backlash")
    friction_torque: Array = field("N m", "friction of the output in parallel with the elastic train")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")


@checked
def hysteresis(
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
    friction: Friction | None = None,
    *,
    input_angle: Scalar = 0.0,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Hysteresis:
    """Width of the loop at zero torque: that of the curve without friction between both signs of the friction torque.

    Sliding speeds are those of the elastic motion with the input held, about a fortieth of the ideal ones. Drag of
    the input, meshes, output pins, load-free moments and viscous drag do not count. docs/models/running.md, Eqs. 16-18.

    Args:
        design: as in `losses`.
        errors: as in `losses`.
        friction: as in `losses`.
        input_angle: at which the input is held, () rad.
        contact: as in `losses`.
        carrier: as in `losses`.
        sun: as in `losses`.

    Returns:
        Hysteresis. Status of the worst equilibrium under both signs of the friction torque.

    Raises:
        ValueError: as `losses`.
    """
    plan, friction = check_call("running.hysteresis", design, errors, friction, (contact, carrier, sun))
    return _hysteresis(plan, design, errors, friction, input_angle)


@quick(0, options=ONCE)
def _hysteresis(plan: Plan, design: PyTree, errors: PyTree, friction: Friction, input_angle: Scalar) -> Hysteresis:
    call = entered(plan, design, errors, friction, 0.0, angle=input_angle)
    read, layout = call.read, plan.layout
    signs = jnp.asarray([-1.0, 1.0], read.torque.dtype)

    def take(case: Case, q: jax.Array, carries: jax.Array) -> tuple[jax.Array, jax.Array]:
        return turned(layout, case, q), _sliding(plan, call, case, q, carries)

    def under(torque: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, jax.Array, SolveInfo]]:
        """Both signs of a torque; the second pass needs the friction of the first. One loop compiles once."""
        found = equilibria(layout, read, signs * torque, read.angle[None], take)
        error, resisting = found.taken
        own = call.friction.static_factor * (call.friction.output_drag + resisting[0, 0])
        return own, (own, error[0], jax.tree.map(lambda x: x[0], found.info))

    passes = scan(under, jnp.zeros_like(read.torque), None, length=2)[1]
    (torque, _), (_, angle), infos = passes
    width = jnp.where(torque > 0, angle[0] - angle[1], 0)
    idle = jnp.any(infos.status[1] == Status.UNLOADED)
    (width, torque), info = ended(call, infos.status, idle, (width, torque), worked(infos))
    return Hysteresis(width, torque, info)


def _sliding(plan: Plan, call: Call, case: Case, q: jax.Array, carries: jax.Array) -> jax.Array:
    """Friction of the contacts in the elastic motion at q per radian of the output, () N m. Eqs. 16 and 18."""
    read, layout, friction = call.read, plan.layout, call.friction
    unit = jnp.asarray(np.eye(layout.unknowns)[layout.carried], q.dtype)
    mode = compliance(layout, case.system, q, unit)
    mode = mode / turned(layout, case, mode)
    held = kind_of(read.design).held(layout, read, mode)
    at = forces(layout, case.system, q)
    slip = _ring_slip(call, case, mode[: layout.inner].reshape(layout.discs, 3), held.discs)
    slip -= held.ideal * ring_slip(call, case)
    total = friction.ring_pins * jnp.sum(at.pins * jnp.abs(slip))
    of_names = named(layout, read, case, at)
    loads = (jnp.where(carries, force, 0) for force in (of_names.disc_bearing, of_names.support_bearing))
    turns = {
        "arm_bearings": held.discs[:, None] - held.cranks[None],
        "support_bearings": (held.cranks - held.carrier)[:, None],
    }
    total = jnp.where(carries, total, 0)
    for name, moment in bearing_moments(call, *loads).items():
        total += jnp.sum(moment * jnp.abs(turns[name]))
    return total


def _ring_slip(call: Call, case: Case, moved: jax.Array, turned_by: jax.Array) -> jax.Array:
    """Tangential motion of each disc at each pin, (d, p) m, for motions (d, 3) and rotations (d,) rad. Eq. 18."""
    cycloid, e = call.read.design.cycloid, call.read.eccentricity
    assert case.size is not None
    normal_x, normal_y = -case.system.pins.rows[0], -case.system.pins.rows[1]
    k1 = e * cycloid.pin_count / cycloid.pin_circle_radius
    turn = (1 + k1 * k1 - case.size * case.size) / 2  # K1 cos(psi)
    arm = (cycloid.pin_circle_radius * (turn - 1) - e * (k1 - turn / k1)) / case.size + cycloid.pin_radius
    along = moved[:, 1:2] * normal_x - moved[:, :1] * normal_y  # t = J n
    return along + turned_by[:, None] * arm
