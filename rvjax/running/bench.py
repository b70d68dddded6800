"""Friction on a bench: drag from speed ramps, and the torque on the output that starts a reducer backwards.

That torque is the least root of an equation, each evaluation a whole turn.
"""

import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax import checks
from rvjax._jax.kernels import while_loop
from rvjax._jax.programs import quick
from rvjax.base.words import choose
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import Bearings, Friction
from rvjax.life import Evaluated, Root, TurnPlan, implicit_root
from rvjax.loaded import Read
from rvjax.records import Array, PyTree, Record, concrete, field, promote, record
from rvjax.running.inputs import Call, check_call, entered
from rvjax.running.losses import around
from rvjax.status import Gate, SolveInfo, Status, succeeded, worst
from rvjax.units import with_unit

LEAST = 4  # points: three numbers and one degree of freedom
_WRONG, _FAR = 3.0, 5.0  # standard deviations: a number of the wrong sign is no scatter; a point of the wrong sign
_CHANCE = 1e-4  # that scatter alone looks as curved
_LEAST_BEND = 1e-3  # of the mean torque: less bends no result


@record
class DragFit(Record):
    """torque = coulomb sign(speed) + viscous speed + offset, by least squares over all points."""

    coulomb: Array = field("N m", "torque against the motion at any speed")
    viscous: Array = field("N m s/rad", "rise of the torque with the speed")
    offset: Array = field("N m", "zero error of the bench")
    coulomb_sd: Array = field("N m", "standard deviation of coulomb")
    viscous_sd: Array = field("N m s/rad", "standard deviation of viscous")
    residual_sd: Array = field("N m", "of the points about the fit, with n - 3 degrees of freedom")


@checks.checked
def fit_drag(speed: Array | np.ndarray, torque: Array | np.ndarray) -> DragFit:
    """Fit drag to ramps of the speed in both directions. Friction of the motor is part of what the bench measured.

    Args:
        speed: of each point, (n,) rad/s, both signs. A traced point at rest does not count.
        torque: that keeps the speed, (n,) N m, on the same shaft; of the sign of the speed.

    Raises:
        ValueError: arrays of different length, fewer than four points, one direction or one size of the speed, a point
            at rest, a torque against the speed, a drag below zero.

    Warns:
        UserWarning: the points bend about the fit, as those of Stribeck friction do.
    """
    speed, torque = (x if isinstance(x, jax.Array) else np.asarray(x, float) for x in (speed, torque))
    sizes = {"speed": np.shape(speed), "torque": np.shape(torque)}
    for name, size in sizes.items():
        if len(size) != 1:
            raise ValueError(f"{name}: shape {size}, must be (n,)")
    if sizes["speed"] != sizes["torque"]:
        raise ValueError(f"torque: {sizes['torque'][0]} points, must be {sizes['speed'][0]} as of speed")
    if sizes["speed"][0] < LEAST:
        raise ValueError(f"speed: {sizes['speed'][0]} points, must be at least {LEAST}")
    if concrete(speed):
        turning = np.asarray(speed)[np.asarray(speed) != 0]
        if not (np.isnan(turning).any() or (turning.min(initial=0) < 0 < turning.max(initial=0))):
            raise ValueError("speed: one direction only; the offset of the bench needs both")
        if np.ptp(np.abs(turning)) == 0:
            raise ValueError(f"speed: {abs(turning[0]):g} rad/s in every point; viscous drag needs two sizes")
        if len(turning) < sizes["speed"][0]:
            k = int(np.argmin(np.abs(np.asarray(speed))))
            raise ValueError(f"speed[{k}] = 0 rad/s: a point at rest has no direction of friction; leave it out")
    fit = _fit_drag(speed, torque)
    if concrete(fit.residual_sd) and np.isfinite(fit.residual_sd):
        _check(np.asarray(speed), np.asarray(torque), fit)
    return fit


def _check(speed: np.ndarray, torque: np.ndarray, fit: DragFit) -> None:
    """Raise for torques and drags that are no friction; warn where the points bend about the fit."""
    way, share = np.sign(speed), np.abs(speed) / np.abs(speed).max()
    plain = np.stack([way, way * share, np.ones_like(way)], axis=1)
    against = way * torque < 0
    if np.sum(against) <= max(1, len(speed) // 10):  # no scatter about zero: a wrong point, if far from the others
        off = torque - plain @ np.linalg.lstsq(plain[~against], torque[~against])[0]
        against &= np.abs(off) > _FAR * np.sqrt(np.mean(off[~against] ** 2))
    else:
        against &= False
    for side in (1, -1):
        on_side = way == side
        if side * (mean := torque[on_side].mean()) <= 0 or (against & on_side).any():
            k = int(np.argmin(np.where(on_side, way * torque, np.inf)))
            raise ValueError(
                f"torque[{k}] = {torque[k]:g} N m at {speed[k]:g} rad/s (mean of this direction {mean:g} N m): a "
                "torque that keeps a speed has its sign; check the signs and subtract the zero of the bench"
            )
    for name, unit in (("coulomb", "N m"), ("viscous", "N m s/rad")):
        value, spread = (float(getattr(fit, key)) for key in (name, f"{name}_sd"))
        if value < -_WRONG * spread - 1e-9 * np.abs(torque).max() / (np.abs(speed).max() if unit != "N m" else 1):
            shown = f"{value:g} +- {with_unit(spread, unit, 'g')}"
            raise ValueError(f"{name} = {shown}: must not be negative; the points are no such drag")
    if (more := len(speed) - 5) < 1:
        return
    curved = np.concatenate([plain, way[:, None] * share[:, None] ** [2, 3]], axis=1)
    left, less = (torque - x @ np.linalg.lstsq(x, torque)[0] for x in (plain, curved))
    bend, scatter = np.sum((left - less) ** 2), np.sum(less**2)
    chance = special.fdtrc(2, more, bend / 2 / max(scatter / more, 1e-30 * np.sum(torque**2)))
    size = float(np.sqrt(bend / len(speed)))
    if chance < _CHANCE and size > _LEAST_BEND * np.abs(torque).mean():
        warnings.warn(
            f"the torque bends about the fit by {size:.3g} N m rms: coulomb and viscous do not describe it, as below "
            "the speed of a full lubricant film (Stribeck); fit the range of speeds that is used",
            stacklevel=4,
        )


@quick()
def _fit_drag(speed: Array | np.ndarray, torque: Array | np.ndarray) -> DragFit:
    speed, torque = promote(speed, torque)
    most = jnp.max(jnp.abs(speed))
    scale = jnp.where(most > 0, most, 1)
    moving = (speed != 0).astype(speed.dtype)
    columns = jnp.stack([jnp.sign(speed), speed / scale, moving], axis=1)
    basis, upper = jnp.linalg.qr(columns)
    coefficients = jax.scipy.linalg.solve_triangular(upper, basis.T @ torque)
    rest = moving * torque - columns @ coefficients
    sd = jnp.sqrt(jnp.sum(rest * rest) / (jnp.sum(moving) - 3))
    inverse = jax.scipy.linalg.solve_triangular(upper, jnp.eye(3, dtype=speed.dtype))
    sds = sd * jnp.sqrt(jnp.sum(inverse * inverse, axis=1))  # (X'X)^-1 = R^-1 R^-T
    return DragFit(coefficients[0], coefficients[1] / scale, coefficients[2], sds[0], sds[1] / scale, sd)


DIRECTIONS = {"forward": 1.0, "backward": -1.0}
EVALUATIONS = 64
FARTHEST = 1000.0  # times the friction at rest without load
_STRETCH = 4.0  # of the torque, where the secant leads away from a root
_EDGE = 1e-4  # of the torque: from here on a root lies where an equilibrium fails


@record
class BackDriving(Record):
    """Torque on the output that turns a reducer from every angle, input free."""

    torque: Array = field("N m", "on the output, >= 0; inf: none up to 1000 times the friction without load")
    info: SolveInfo = field("-", "steps: of all equilibria; residual: of the root over the torque", kind="record")


@checked
def back_driving(
    design: Reducer,
    errors: ReducerErrors,
    friction: Friction | None = None,
    *,
    direction: str = "forward",
    samples: int = 24,
    turns: float = 1.0,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> BackDriving:
    """Least torque on the output that turns the reducer from the worst angle, input free and without inertia. Eq. 15.

    Args:
        design: as in `losses`.
        errors: as in `losses`.
        friction: as in `losses`.
        direction: of the motion of the output, "forward" or "backward".
        samples: angles over the turns; four to eight sets of so many equilibria.
        turns: as in `losses`.
        contact: as in `losses`.
        carrier: as in `losses`.
        sun: as in `losses`.

    Returns:
        BackDriving. CONVERGED with 0 where nothing rubs without load, with inf and derivative 0 where the unit locks
        itself; with NaN the status of an equilibrium that fails before the root, or one of `losses`.

    Raises:
        ValueError: unknown direction, and as `losses`.
    """
    supports = contact, carrier, sun
    plan, friction = check_call("running.back_driving", design, errors, friction, supports, samples, turns)
    choose("direction", direction, DIRECTIONS)
    return _back_driving(plan, DIRECTIONS[direction], design, errors, friction)


class Given(NamedTuple):
    """Numbers that the root depends on."""

    design: PyTree
    errors: PyTree
    eccentricity: jax.Array
    friction: Friction
    bearings: Bearings | None
    sound: jax.Array  # 1, or 0 where the case is invalid


@quick(0, 1)
def _back_driving(
    plan: TurnPlan, sign: float, design: Reducer, errors: ReducerErrors, friction: Friction
) -> BackDriving:
    call = entered(plan, design, errors, friction, 0.0)
    read = call.read
    sound = call.gate.good.astype(read.torque.dtype)
    given = Given(read.design, read.errors, read.eccentricity, call.friction, call.bearings, sound)
    x, _, info = _solve(plan, sign, given)
    torque, info = call.gate.close(x, info=info)
    return BackDriving(jnp.where(succeeded(info.status), torque, jnp.nan), info)


def _resisting(plan: TurnPlan, sign: float, given: Given, x: jax.Array, start: jax.Array) -> Evaluated:
    """Friction at rest under the torque x of the output, status, steps and displacements."""
    gate = Gate(((given.sound < 0.5, Status.NONFINITE),))
    zero = jnp.zeros_like(x)
    read = Read(given.design, given.errors, given.eccentricity, x, zero, gate)
    call = Call(read, given.friction, given.bearings, zero, gate)
    turn = around(plan, call, -sign * x[None], start)
    idle = (turn.info.status == Status.UNLOADED)[..., None]  # no start for a torque
    memory = jnp.where(idle, jnp.nan, turn.displacements)
    return turn.at_rest(0), worst(turn.info.status), jnp.sum(turn.info.steps), memory


class Search(NamedTuple):
    """State of the search. The excess is x less the friction at x: negative below the root."""

    x: jax.Array  # next
    memory: jax.Array  # displacements from which the next one starts
    least: jax.Array  # friction without load, NaN at first
    last: jax.Array  # x before
    excess: jax.Array  # there
    lower: jax.Array  # highest x below the root
    upper: jax.Array  # lowest x above it, or where an equilibrium fails; inf: none yet
    beyond: jax.Array  # status of the failure at `upper`, 0 for none
    residual: jax.Array
    status: jax.Array  # -1 while it runs
    evaluations: jax.Array
    steps: jax.Array  # of the equilibria


def _least_root(plan: TurnPlan, sign: float, given: Given) -> Root:
    """Secant from below, kept in a bracket once there is one."""
    dtype = given.eccentricity.dtype
    accuracy = max(1e-11, 100 * float(jnp.finfo(dtype).eps))

    def onward(state: Search) -> Search:
        x = state.x
        friction, status, steps, memory = _resisting(plan, sign, given, x, state.memory)
        fine, first = succeeded(status), state.evaluations == 0
        friction = jnp.where(fine, friction, 0)
        least = jnp.where(first, friction, state.least)
        excess = x - friction
        lower = jnp.where(fine & (excess < 0), x, state.lower)
        above = ~(fine & (excess < 0)) & ~first
        upper = jnp.where(above, x, state.upper)
        beyond = jnp.where(above, jnp.where(fine, 0, status), state.beyond).astype(jnp.int32)
        bracketed, farthest = jnp.isfinite(upper), FARTHEST * least

        slope = (excess - state.excess) / jnp.where(x == state.last, 1, x - state.last)
        rising = fine & (slope > 0)
        secant = x - excess / jnp.where(rising, slope, 1)
        inside = rising & (secant > lower) & (secant < upper) & (state.evaluations % 8 != 7)
        # Without bracket the friction itself is never beyond the root, because it rises with the torque.
        open_step = jnp.where(rising, jnp.clip(secant, friction, jnp.maximum(_STRETCH * x, friction)), _STRETCH * x)
        open_step = jnp.where(first, friction, jnp.minimum(jnp.maximum(open_step, friction), farthest))
        target = jnp.where(bracketed, jnp.where(inside, secant, 0.5 * (lower + upper)), open_step)

        width = upper - lower
        reached = fine & ((jnp.abs(excess) <= accuracy * x) | (bracketed & (beyond == 0) & (width <= accuracy * upper)))
        locked = fine & (excess < 0) & (x >= farthest) & ~first
        ended = jnp.where(bracketed & (beyond > 0) & (width <= _EDGE * upper), beyond, -1)
        ended = jnp.where(state.evaluations + 1 >= EVALUATIONS, int(Status.MAX_STEPS), ended)
        ended = jnp.where(reached | locked, int(Status.CONVERGED), ended)
        ended = jnp.where(first & ~fine, status, ended).astype(jnp.int32)
        here = jnp.where(locked, jnp.inf, x)
        return Search(
            x=jnp.where(ended == -1, target, here),
            memory=memory,
            least=least,
            last=x,
            excess=excess,
            lower=lower,
            upper=upper,
            beyond=beyond,
            residual=jnp.abs(excess) / jnp.where(x > 0, x, 1),
            status=ended,
            evaluations=state.evaluations + 1,
            steps=state.steps + steps.astype(jnp.int32),
        )

    zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
    cold = jnp.full((plan.samples, 1, plan.layout.unknowns), jnp.nan, dtype)
    state = Search(zero, cold, zero, zero, zero, zero, zero + jnp.inf, none, zero, none - 1, none, none)
    end = while_loop(lambda state: state.status == -1, onward, state)
    return end.x, end.memory, SolveInfo(end.status, end.steps, end.residual)


def _solve(plan: TurnPlan, sign: float, given: Given) -> Root:
    """Torque, displacements there, and how it was found."""

    def excess(x: jax.Array, given: Given, start: jax.Array) -> jax.Array:
        return x - _resisting(plan, sign, given, x, start)[0]

    return implicit_root(lambda given: _least_root(plan, sign, given), excess, given)
