"""Joint model of a reducer for simulators: play, stiffness, friction and inertia at the output."""

import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import Friction, RVReducer
from rvjax.errors import RVErrors
from rvjax.records import Array, PyTree, Record, Scalar, concrete, field, quantity, record
from rvjax.running.inputs import Plan, check_call, entered
from rvjax.running.kinds import kind_of
from rvjax.running.turn import around, ended, worked
from rvjax.status import SolveInfo, Status

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
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
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
    plan: Plan,
    design: PyTree,
    errors: PyTree,
    friction: Friction,
    rated_torque: Scalar,
    damping: Scalar | None,
    input_angle: Scalar,
) -> Joint:
    call = entered(plan, design, errors, friction, rated_torque, angle=input_angle)
    own, ratio, rated = call.friction, design.ratio, call.read.torque
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
        input_friction=unloaded - own.output_drag,
        output_friction=own.output_drag,
        input_viscous=ratio**2 * own.input_viscous,
        output_viscous=own.output_viscous,
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
    values, info = ended(call._replace(gate=gate), turn.info.status, jnp.zeros((), bool), values, worked(turn.info))
    return Joint(**values, info=info)
