"""Torque on the output that starts a reducer backwards: the least root of an equation, each evaluation a whole turn."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import while_loop
from rvjax._jax.programs import quick
from rvjax.catalogue import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import Bearings, Friction, RVReducer
from rvjax.errors import RVErrors
from rvjax.life import TurnPlan
from rvjax.loaded import Read
from rvjax.records import Array, PyTree, Record, field, record
from rvjax.running.inputs import Call, check_call, check_direction, entered
from rvjax.running.losses import around
from rvjax.status import Gate, SolveInfo, Status, succeeded, worst

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
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
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
    return _back_driving(plan, check_direction(direction), design, errors, friction)


class Given(NamedTuple):
    """Numbers that the root depends on."""

    design: PyTree
    errors: PyTree
    eccentricity: jax.Array
    friction: Friction
    bearings: Bearings | None
    sound: jax.Array  # 1, or 0 where the case is invalid


@quick(0, 1)
def _back_driving(plan: TurnPlan, sign: float, design: PyTree, errors: PyTree, friction: Friction) -> BackDriving:
    call = entered(plan, design, errors, friction, 0.0)
    read = call.read
    sound = call.gate.good.astype(read.torque.dtype)
    given = Given(read.design, read.errors, read.eccentricity, call.friction, call.bearings, sound)
    x, _, info = _solve(plan, sign, given)
    torque, info = call.gate.close(x, info=info)
    return BackDriving(jnp.where(succeeded(info.status), torque, jnp.nan), info)


Evaluated = tuple[jax.Array, jax.Array, jax.Array, jax.Array]  # friction, status, steps, displacements
Root = tuple[jax.Array, jax.Array, SolveInfo]  # torque, displacements there, and how it was found


def _resisting(plan: TurnPlan, sign: float, given: Given, x: jax.Array, start: jax.Array) -> Evaluated:
    """Friction at rest under the torque x of the output."""
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


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _solve(plan: TurnPlan, sign: float, given: Given) -> Root:
    return _least_root(plan, sign, given)


@_solve.defjvp
def _solve_jvp(plan: TurnPlan, sign: float, primals: tuple[Given], tangents: tuple[Given]) -> tuple[Root, Root]:
    """dx = (d friction / d given) dgiven / (1 - d friction / dx)."""
    (given,), (change,) = primals, tangents
    x, start, info = _solve(plan, sign, given)
    regular = succeeded(info.status) & jnp.isfinite(x)
    place = jnp.where(regular, x, 0)

    def friction(x: jax.Array, given: Given) -> jax.Array:
        return _resisting(plan, sign, given, x, start)[0]

    slope = 1 - jax.jacfwd(friction)(place, given)  # `jax.linearize` would forget the rules of second derivatives
    regular &= slope != 0
    dx = jax.jvp(functools.partial(friction, place), (given,), (change,))[1] / jnp.where(regular, slope, 1)
    still = jax.custom_derivatives.zero_from_primal((start, info))
    return (x, start, info), (jnp.where(regular, dx, 0), *still)
