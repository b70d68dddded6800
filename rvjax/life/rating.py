"""Rated life of a reducer under a duty."""

from typing import Any

import jax
import jax.numpy as jnp

from rvjax._jax.programs import quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import RVReducer, expect
from rvjax.errors import RVErrors
from rvjax.life.angles import input_angles
from rvjax.life.bearing import inverse
from rvjax.life.duty import Duty, check_phases, revolutions
from rvjax.life.kinds import KINDS
from rvjax.life.machine import Entered, Plan, check_plan, damages, entered
from rvjax.loaded import BearingForces, Read, admit, bearing_forces
from rvjax.records import PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, succeeded, worst


@record
class Rating(Record):
    """Lives of the crank bearings of one reducer under a duty, in seconds of its cycle, rests included."""

    life: Any = field("s", "of all crank bearings as a system; inf without load")
    arm: Any = field("s", "of each bearing of a crank in a disc", shape=("discs", "cranks"))
    support: Any = field("s", "of each bearing of a crank in the carrier", shape=("cranks", 2))
    arm_load: Any = field("N", "equivalent load at 90 %", shape=("discs", "cranks"))
    support_load: Any = field("N", "equivalent load at 90 %", shape=("cranks", 2))
    static_safety: Any = field("-", "least C0 / P0 of any bearing, angle and phase; inf without force")
    info: SolveInfo = field("-", "worst equilibrium; steps: all. UNLOADED: no revolution carries load", kind="record")


@checked
def rating(
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
    duty: Duty,
    *,
    samples: int = 48,
    turns: float = 1.0,
    method: str = "basic",
    reliability: Scalar = 0.9,
    tilt: Scalar = 0.0,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Rating:
    """Life of every crank bearing, and of all of them, from the forces of the loaded equilibrium along a turn.

    The reliability counts bearings under the loads of one unit; a share of units is a statistic over `errors`. Methods
    differ in level: compare lives of one method only. Docs: docs/models/life.md, Eqs. 16-25.

    Args:
        design: as in `loaded.equilibrium`, with bearings.
        errors: as in `loaded.equilibrium`. "slices" also reads both clearances, for the rollers.
        duty: phases of torque, speed and time.
        samples: angles over the turns.
        turns: of the output, a whole number of crank turns (multiples of 1 / pin_count).
        method: "basic" (ISO 281), "raceway" (points of both rings) or "slices" (ISO/TS 16281).
        reliability: share of such units that reach the lives, between 0 and 1.
        tilt: of the rings of every bearing in the plane of its load, rad; "slices" only.
        contact: as in `loaded.equilibrium`.
        carrier: as in `loaded.equilibrium`.
        sun: as in `loaded.equilibrium`.

    Returns:
        Rating; `support` and `support_load` are None without support bearings, as of a single-stage drive. Status of
        the worst equilibrium, of phases at rest too; UNLOADED with life inf and derivative 0; with NaN values NONFINITE
        or INVALID_GEOMETRY (bearings that cannot exist, time < 0).

    Raises:
        ValueError: names the argument: bearings None, unknown method, reliability outside (0, 1), samples < 1, turns
            not a whole number of crank turns, phases of different number, tilt without "slices", tapered supports
            without "basic", supports or axial positions of a single-stage drive, and as `loaded.equilibrium`.
    """
    expect(design, "life.rating", *KINDS)
    plan = check_plan(design, errors, samples, turns, method, reliability, tilt, (contact, carrier, sun))
    if not isinstance(duty, Duty):
        raise ValueError(f"duty: must be a Duty, got {type(duty).__name__}")
    return _rating(plan, check_phases(duty), design, errors, duty, reliability, tilt)


@quick(0, 1)
def _rating(
    plan: Plan, phases: int, design: PyTree, errors: PyTree, duty: Duty, reliability: Scalar, tilt: Scalar
) -> Rating:
    read = admit(plan.layout, design, errors, jnp.broadcast_to(duty.output_torque, (phases,)), 0.0)
    given = under(duty, phases, design, read, reliability, tilt)
    angles = input_angles(plan, design, read.torque.dtype)
    forces = bearing_forces(plan.layout, read, read.torque, angles, near=plan.near)
    return by_forces(plan, given, read.errors, forces)


def under(duty: Duty, phases: int, design: PyTree, read: Read, reliability: Scalar, tilt: Scalar) -> Entered:
    """The numbers of a duty, checked.

    Args:
        duty: its speeds and times are read.
        phases: their number.
        design: its bearings are read.
        read: numbers of the loaded equilibrium.
        reliability: share of the bearings.
        tilt: rad.
    """
    speed, time = (jnp.broadcast_to(x, (phases,)) for x in (duty.output_speed, duty.time))
    return entered(
        design, read, speed, time, reliability, tilt, lambda _, time: jnp.any(time < 0) | ~(jnp.sum(time) > 0)
    )


def by_forces(plan: Plan, given: Entered, errors: PyTree, forces: BearingForces) -> Rating:
    """Lives by the forces of a duty.

    Args:
        plan: samples and method.
        given: bearings, speeds and times of the phases.
        errors: clearances are read.
        forces: (samples, phases, ...).
    """
    turned = revolutions(plan.layout.pins, given.speed, given.time)
    found = damages(plan, given.bearings, errors, forces, turned.share, given.tilt)
    per_time = turned.per_time / (1e6 * given.factor)  # Eq. 22

    values = dict(
        life=inverse(found.whole * per_time),
        arm=inverse(found.arm.rate * per_time),
        arm_load=found.arm.load,
        static_safety=inverse(found.hardest),
    )
    if found.support is not None:
        values |= dict(support=inverse(found.support.rate * per_time), support_load=found.support.load)
    state = worst(jnp.append(jnp.ravel(forces.info.status), found.info.status))
    ended = jnp.where(found.whole * per_time > 0, Status.CONVERGED, Status.UNLOADED)
    info = SolveInfo(
        jnp.where(succeeded(state), ended, state).astype(jnp.int32),
        jnp.sum(forces.info.steps),
        jnp.max(forces.info.residual),
    )
    values, info = given.gate.close(values, info=info)
    fine = succeeded(info.status)
    values = jax.tree.map(lambda x: jnp.where(fine, x, jnp.nan), values)
    return Rating(**({"support": None, "support_load": None} | values), info=info)
