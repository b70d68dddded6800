"""Rated life of a reducer under a duty, and the causes of a failure: bearings, phases, orders of the force."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import power
from rvjax._jax.programs import quick
from rvjax.bearings import Bearings, RollerBearing
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import RVReducer, expect
from rvjax.errors import Errors, RVErrors
from rvjax.life.bearing import inverse
from rvjax.life.duty import KINDS, Duty, check_phases, kind_of, revolutions
from rvjax.life.machine import Entered, Plan, check_plan, damages, entered
from rvjax.loaded import BearingForces, Read, admit, bearing_forces, check_input
from rvjax.records import Design, Record, Scalar, field, record
from rvjax.status import SolveInfo, succeeded, worst_of


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
    design: Reducer,
    errors: ReducerErrors,
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
        method: "basic" (ISO 281), "raceway" (points of both rings) or "slices" (ISO/TS 16281); balls: "basic" only.
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
            and balls without "basic", supports or axial positions of a single-stage drive, and as `loaded.equilibrium`.
    """
    expect(design, "life.rating", *KINDS)
    plan = check_plan(design, errors, samples, turns, method, reliability, tilt, (contact, carrier, sun))
    if not isinstance(duty, Duty):
        raise ValueError(f"duty: must be a Duty, got {type(duty).__name__}")
    return _rating(plan, check_phases(duty), design, errors, duty, reliability, tilt)


@quick(0, 1)
def _rating(
    plan: Plan, phases: int, design: Reducer, errors: ReducerErrors, duty: Duty, reliability: Scalar, tilt: Scalar
) -> Rating:
    read = admit(plan.layout, design, errors, jnp.broadcast_to(duty.output_torque, (phases,)), 0.0)
    given = under(duty, phases, design, read, reliability, tilt)
    angles = plan.input_angles(design, read.torque.dtype)
    forces = bearing_forces(plan.layout, read, read.torque, angles, near=plan.near)
    return by_forces(plan, given, read.errors, forces)


def under(duty: Duty, phases: int, design: Record, read: Read, reliability: Scalar, tilt: Scalar) -> Entered:
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


def by_forces(plan: Plan, given: Entered, errors: Errors, forces: BearingForces) -> Rating:
    """Lives by the forces of a duty.

    Args:
        plan: samples and method.
        given: bearings, speeds and times of the phases.
        errors: clearances are read.
        forces: (samples, phases, ...).
    """
    share, per_time = revolutions(plan.layout.pins, given.speed, given.time)
    damage = damages(plan, given.bearings, errors, forces, share, given.tilt)
    per_time = per_time / (1e6 * given.factor)  # Eq. 22

    values = dict(
        life=inverse(damage.whole * per_time),
        arm=inverse(damage.arm.rate * per_time),
        arm_load=damage.arm.load,
        static_safety=inverse(damage.hardest),
    )
    if damage.support is not None:
        values |= dict(support=inverse(damage.support.rate * per_time), support_load=damage.support.load)
    statuses = jnp.append(jnp.ravel(forces.info.status), damage.info.status)
    idle = ~(damage.whole * per_time > 0)
    values, info = given.gate.close_all(values, forces.info.replace(status=statuses), idle)
    return Rating(**({"support": None, "support_load": None} | values), info=info)


_STEP = 1e-3  # of a speed


class Failures(NamedTuple):
    """Probability that a bearing fails first, given that one fails; the sum over both fields is 1."""

    arm: jax.Array  # (d, c)
    support: jax.Array | None  # (c, 2)


def first_failures(rated: Rating, bearings: Bearings | None = None) -> Failures:
    """Share of each bearing in the failures of a series system: (life / its life)^(its slope of Weibull), Eqs. 24, 30.

    Exact with one slope. With rollers and balls it is that of the hazard until the life; of the failures it differs by
    less than 1e-3 of itself.

    Args:
        rated: of one unit.
        bearings: of its design; None: all of rollers.
    """

    def share(life: jax.Array, slope: float) -> jax.Array:
        finite = jnp.isfinite(life) & jnp.isfinite(rated.life)
        return jnp.where(finite, power(jnp.where(finite, rated.life / jnp.where(finite, life, 1), 1), slope), 0)

    arm, support = (RollerBearing, RollerBearing) if bearings is None else (bearings.arm, bearings.support)
    if rated.support is None or support is None:
        return Failures(share(rated.arm, arm.weibull_slope), None)
    return Failures(share(rated.arm, arm.weibull_slope), share(rated.support, support.weibull_slope))


def phase_shares(life_of: Callable[[Duty], np.ndarray], duty: Duty) -> np.ndarray:
    """Share of each phase in the damage, (phases, ...): -d ln life / d ln speed, which sums to 1.

    A cycle with all speeds times s has life over s, so the derivatives by the speeds of the phases sum to -1 for every
    method. Central differences of the plain value.

    Args:
        life_of: life of units under a duty, (...) s.
        duty: of p phases, columns (p,).
    """
    speed = np.asarray(duty.output_speed, float)
    shares = []
    for phase, phase_speed in enumerate(speed):
        sides = []
        for factor in (1 + _STEP, 1 - _STEP):
            changed = speed.copy()
            changed[phase] = factor * phase_speed
            sides.append(np.log(life_of(duty.replace(output_speed=changed))))
        shares.append((sides[1] - sides[0]) / np.log((1 + _STEP) / (1 - _STEP)) if phase_speed else 0 * sides[0])
    return np.asarray(shares)


class Orders(NamedTuple):
    """Harmonics of the forces of the arm bearings over one revolution of the output."""

    order: np.ndarray  # (n,), > 0: turns as the output does; `crank_order` turns with the crank
    amplitude: jax.Array  # (d, c, n) complex N: F_x + i F_y = sum of amplitude e^(i order angle), frame of the carrier
    info: SolveInfo


def crank_order(design: Design) -> int:
    """Order of the output revolution that turns with the crank: -zp, but zp of a drive whose ring is the output.

    Args:
        design: one of `life.duty.KINDS`.
    """
    return kind_of(design).sense(design) * design.counts["pins"]


def force_orders(
    design: RVReducer,
    errors: RVErrors,
    *,
    output_torque: Scalar,
    samples: int,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Orders:
    """Orders of the output revolution in the force of a crank on a disc, in the frame of the carrier.

    Order 0 is fixed in the outer ring and passes over the inner ring. The order that turns with the crank is fixed in
    the inner ring, see `crank_order`. Errors make the others.

    Args:
        design: the reducer.
        errors: of its parts.
        output_torque: () N m.
        samples: angles of the revolution, more than twice the largest order.
        contact: as in `loaded.equilibrium`.
        carrier: as in `loaded.equilibrium`.
        sun: as in `loaded.equilibrium`.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    read = admit(layout, design, errors, jnp.atleast_1d(jnp.asarray(output_torque)), 0.0)
    angles = jnp.asarray(2 * np.pi * design.ratio * np.arange(samples) / samples, read.torque.dtype)
    forces = bearing_forces(layout, read, read.torque, angles)
    size = jax.lax.complex(forces.arm[:, 0, ..., 0], forces.arm[:, 0, ..., 1])
    _, info = read.gate.close((), info=worst_of(forces.info))
    wave = jnp.fft.fft(size, axis=0) / samples
    order = np.rint(np.fft.fftfreq(samples, 1 / samples)).astype(int)
    return Orders(order, jnp.where(succeeded(info.status), jnp.moveaxis(wave, 0, -1), jnp.nan), info)
