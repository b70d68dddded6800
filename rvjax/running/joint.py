"""Joint model of a reducer for simulators, and the width of its loop of torque and angle.

The joint has play, stiffness, friction and inertia at the output. The loop, input held, comes from friction in parallel
with the elastic train.
"""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax._jax.programs import ONCE, quick
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import Friction
from rvjax.errors import Errors
from rvjax.life import TurnPlan
from rvjax.loaded import Case, compliance, equilibria, forces, named_forces, output_rotation
from rvjax.records import Array, Record, Scalar, concrete, field, quantity, record
from rvjax.running.inputs import Call, check_call, entered, kind_of
from rvjax.running.losses import around, bearing_moments, ring_slip
from rvjax.status import SolveInfo, Status


@record
class Hysteresis(Record):
    """Loop of torque and angle of a reducer whose input is held."""

    width: Array = field("rad", "of the loop at zero torque; with play it contains the backlash")
    friction_torque: Array = field("N m", "friction of the output in parallel with the elastic train")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")


@checked
def hysteresis(
    design: Reducer,
    errors: ReducerErrors,
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
def _hysteresis(
    plan: TurnPlan, design: Reducer, errors: ReducerErrors, friction: Friction, input_angle: Scalar
) -> Hysteresis:
    call = entered(plan, design, errors, friction, 0.0, angle=input_angle)
    read, layout = call.read, plan.layout
    signs = jnp.asarray([-1.0, 1.0], read.torque.dtype)

    def take(case: Case, q: jax.Array, carries: jax.Array) -> tuple[jax.Array, jax.Array]:
        return output_rotation(layout, case, q), _sliding(plan, call, case, q, carries)

    def under(torque: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, jax.Array, SolveInfo]]:
        """Both signs of a torque; the second pass needs the friction of the first. One loop compiles once."""
        solution = equilibria(layout, read, signs * torque, read.angle[None], take)
        error, resisting = solution.taken
        threshold = call.friction.static_factor * (call.friction.output_drag + resisting[0, 0])
        return threshold, (threshold, error[0], jax.tree.map(lambda x: x[0], solution.info))

    passes = scan(under, jnp.zeros_like(read.torque), None, length=2)[1]
    (torque, _), (_, angle), infos = passes
    width = jnp.where(torque > 0, angle[0] - angle[1], 0)
    idle = jnp.any(infos.status[1] == Status.UNLOADED)
    (width, torque), info = call.gate.close_all((width, torque), infos, idle)
    return Hysteresis(width, torque, info)


def _sliding(plan: TurnPlan, call: Call, case: Case, q: jax.Array, carries: jax.Array) -> jax.Array:
    """Friction of the contacts in the elastic motion at q per radian of the output, () N m. Eqs. 16 and 18."""
    read, layout, friction = call.read, plan.layout, call.friction
    unit = jnp.asarray(np.eye(layout.unknowns)[layout.carried], q.dtype)
    mode = compliance(layout, case.system, q, unit)
    mode = mode / output_rotation(layout, case, mode)
    held = kind_of(read.design).held(layout, read, mode)
    at = forces(layout, case.system, q)
    slip = _ring_slip(call, case, mode[: layout.inner].reshape(layout.discs, 3), held.discs)
    slip -= held.ideal * ring_slip(call, case)
    total = friction.ring_pins * jnp.sum(at.pins * jnp.abs(slip))
    of_names = named_forces(layout, read, case, at)
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
    normal_x, normal_y = -case.system.pins.rows[0], -case.system.pins.rows[1]
    k1 = e * cycloid.pin_count / cycloid.pin_circle_radius
    turn = (1 + k1 * k1 - case.size * case.size) / 2  # K1 cos(psi)
    arm = (cycloid.pin_circle_radius * (turn - 1) - e * (k1 - turn / k1)) / case.size + cycloid.pin_radius
    along = moved[:, 1:2] * normal_x - moved[:, :1] * normal_y  # t = J n
    return along + turned_by[:, None] * arm


SHARES = ((-1e-3, 1e-3, 0.5), (1.0, 1.0, 1.0))  # of the rated torque, three at a time as along the turn

OF_JOINT = ("rated_torque", "input_angle", "running_samples", "pin_contact", "carrier", "sun")
"""Conditions of a study that a joint model reads."""


@record
class Joint(Record):
    """A reducer as one joint. Every number refers to the coordinate of the output."""

    ratio: Array = field("-", "turns of the input for one of the output")
    half_backlash: Array = field("rad", "half of the play")
    stiffness: Array = field("N m/rad", "secant between half and full rated torque")
    damping: Scalar | None = field("N m s/rad", "of the elastic train, as given; None: not given")
    input_friction: Array = field("N m", "Coulomb friction of input and train without load")
    output_friction: Array = field("N m", "Coulomb friction of the output")
    input_viscous: Array = field("N m s/rad", "of the input")
    output_viscous: Array = field("N m s/rad", "of the output")
    forward_loss: Array = field("-", "rise of the loss with the torque, input drives")
    backward_loss: Array = field("-", "rise of the loss with the torque, output drives")
    mu_avg: Array = field("-", "friction over motor torque, mean of both directions")
    mu_dif: Array = field("-", "half of the difference of both directions")
    rotor_inertia: Array | None = field("kg m2", "of all that turns with the input; None: not known")
    output_inertia: Array | None = field("kg m2", "of all that turns with the output; None: not known")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")


@checked
def joint(
    design: Reducer,
    errors: ReducerErrors,
    friction: Friction | None = None,
    *,
    rated_torque: Scalar,
    damping: Scalar | None = None,
    input_angle: Scalar = 0.0,
    samples: int = 24,
    turns: float = 1.0,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Joint:
    """Numbers of a joint with play, stiffness, Coulomb and load-proportional friction. Eqs. 25-31.

    Args:
        design: as in `losses`; with inertia for both inertias.
        errors: as in `losses`.
        friction: as in `losses`.
        rated_torque: at which losses and stiffness are taken, () N m, > 0.
        damping: of the elastic train, () N m s/rad; it is passed on.
        input_angle: at which play and stiffness are taken, () rad.
        samples: as in `losses`.
        turns: as in `losses`.
        contact: as in `losses`.
        carrier: as in `losses`.
        sun: as in `losses`.

    Returns:
        Joint. CONVERGED, or with NaN values the worst status of its equilibria.

    Raises:
        ValueError: rated_torque <= 0, damping < 0, and as `losses`.
    """
    plan, friction = check_call("running.joint", design, errors, friction, (contact, carrier, sun), samples, turns)
    if concrete(rated_torque) and np.any(np.asarray(rated_torque) <= 0):
        raise ValueError(f"rated_torque = {quantity(rated_torque, 'N m')}: must be positive")
    if damping is not None and concrete(damping) and np.any(np.asarray(damping) < 0):
        raise ValueError(f"damping = {quantity(damping, 'N m s/rad')}: must be zero or positive")
    return _joint(plan, design, errors, friction, rated_torque, damping, input_angle)


@quick(0)
def _joint(
    plan: TurnPlan,
    design: Reducer,
    errors: Errors,
    friction: Friction,
    rated_torque: Scalar,
    damping: Scalar | None,
    input_angle: Scalar,
) -> Joint:
    call = entered(plan, design, errors, friction, rated_torque, angle=input_angle)
    unit_friction, ratio, rated = call.friction, design.ratio, call.read.torque
    held_under = rated * jnp.asarray(SHARES, rated.dtype)
    turn = around(plan, call, jnp.stack([jnp.zeros_like(rated), rated, -rated]), held=held_under)
    unloaded, forward, backward = (turn.mean(torque) for torque in range(3))
    driven, driving = (forward - unloaded) / rated, (backward - unloaded) / rated  # Eq. 28
    lost, held = driven / (1 + driven), driving / (1 - driving)

    assert turn.held is not None
    (less, more, half), (full, *_) = turn.held
    rotor, output = kind_of(design).inertias(design)
    values = dict(
        ratio=jnp.asarray(ratio, rated.dtype),
        half_backlash=(less - more) / 2,
        stiffness=0.5 * rated / (half - full),
        damping=None if damping is None else jnp.asarray(damping, rated.dtype),
        input_friction=unloaded - unit_friction.output_drag,
        output_friction=unit_friction.output_drag,
        input_viscous=ratio**2 * unit_friction.input_viscous,
        output_viscous=unit_friction.output_viscous,
        forward_loss=driven,
        backward_loss=driving,
        mu_avg=(lost + held) / 2,
        mu_dif=(lost - held) / 2,
        rotor_inertia=None if rotor is None else jnp.asarray(rotor, rated.dtype),
        output_inertia=None if output is None else jnp.asarray(output, rated.dtype),
    )
    given = [values[name] for name in ("damping", "rotor_inertia", "output_inertia") if values[name] is not None]
    finite = jnp.all(jnp.isfinite(jnp.stack([jnp.zeros_like(rated), *given])))
    positive = (rated > 0) & (True if damping is None else values["damping"] >= 0)
    gate = call.gate._replace(
        refused=(*call.gate.refused, (~finite, Status.NONFINITE), (~positive, Status.INVALID_GEOMETRY))
    )
    values, info = gate.close_all(values, turn.info)
    return Joint(**values, info=info)
