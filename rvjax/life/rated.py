"""The torque for a given life: the inverse of `rating` at one speed.

Largest root of an equation that falls in the end, each evaluation being a whole turn of equilibria.

The unknown is the logarithm of a torque. The value is that of life over the life that is wanted, over the exponent of
the arm bearings (10/3, balls 3): where life falls with this exponent the value is the step to the root.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import while_loop
from rvjax._jax.programs import quick
from rvjax.bearings import Bearings
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import expect
from rvjax.life.damage import ratings
from rvjax.life.duty import KINDS, kind_of
from rvjax.life.machine import Plan, check_plan, damages, entered
from rvjax.loaded import Read, admit, bearing_forces
from rvjax.records import PyTree, Record, Scalar, concrete, field, quantity, record
from rvjax.status import Gate, SolveInfo, Status, succeeded, worst

EVALUATIONS = 64
_RANGE = 16.0  # below the start, in the logarithm: a ten millionth of it is no load
_EDGE = 1e-4  # of the torque: from here on a root lies where a contact law ends

Evaluated = tuple[jax.Array, jax.Array, jax.Array, jax.Array]  # value, status, steps of the equilibria, memory
Evaluate = Callable[[jax.Array, jax.Array], Evaluated]
Root = tuple[jax.Array, jax.Array, SolveInfo]
Numbers = TypeVar("Numbers")  # that a root depends on


class Search(NamedTuple):
    """State of the search."""

    x: jax.Array  # next
    memory: jax.Array  # of the evaluations, from which the next one starts
    lower: jax.Array  # highest x with a value >= 0; -inf: none yet
    upper: jax.Array  # lowest x with a value < 0, or beyond a contact law; inf: none yet
    beyond: jax.Array  # whether `upper` is beyond a contact law
    last: jax.Array  # x before, NaN at first
    value: jax.Array  # there
    pace: jax.Array  # multiple of the value that a step without bracket takes
    status: jax.Array  # -1 while it runs
    evaluations: jax.Array
    steps: jax.Array  # of the equilibria


def largest_root(evaluate: Evaluate, start: jax.Array, memory: jax.Array) -> Root:
    """Root, values stored at it, and end of the search.

    Args:
        evaluate: (x, memory) -> (value, status, steps of the equilibria, memory); CONTACT_OVERLOAD: x is too high.
        start: ().
        memory: of the first evaluation.
    """
    accuracy = max(1e-10, 100 * float(jnp.finfo(start.dtype).eps))

    def onward(state: Search) -> Search:
        value, status, steps, memory = evaluate(state.x, state.memory)
        x, fine = state.x, succeeded(status)
        over = status == Status.CONTACT_OVERLOAD
        value = jnp.where(fine, value, -jnp.log(2.0)).astype(x.dtype)
        above = (over | (fine & (value < 0))) & (x < state.upper)
        lower = jnp.where(fine & (value >= 0), x, state.lower)
        upper, beyond = jnp.where(above, x, state.upper), jnp.where(above, over, state.beyond)

        slope = (value - state.value) / jnp.where(x == state.last, 1, x - state.last)
        secant = x - value / jnp.where(slope < 0, slope, -1)
        usable = fine & (slope < 0) & jnp.isfinite(secant)
        bracketed = jnp.isfinite(lower) & jnp.isfinite(upper)
        middle = 0.5 * (lower + upper)
        inside = usable & (secant > lower) & (secant < upper) & (state.evaluations % 8 != 7)
        # Without bracket: from above the value undershoots where life falls less steeply, so the root is not passed.
        stuck = jnp.abs(value) > 0.5 * jnp.abs(state.value)
        pace = jnp.where(stuck, 2 * state.pace, 1)
        open_step = jnp.where(
            usable & ~stuck, jnp.clip(secant - x, -4 * jnp.abs(value), 4 * jnp.abs(value)), pace * value
        )
        target = jnp.where(bracketed, jnp.where(inside, secant, middle), x + open_step)

        reached = fine & ((jnp.abs(value) <= accuracy) | (upper - lower <= accuracy))
        ended = jnp.where(bracketed & beyond & (upper - lower <= _EDGE), int(Status.CONTACT_OVERLOAD), -1)
        ended = jnp.where(target < start - _RANGE, int(Status.NO_BRACKET), ended)
        ended = jnp.where(state.evaluations + 1 >= EVALUATIONS, int(Status.MAX_STEPS), ended)
        ended = jnp.where(reached, int(Status.CONVERGED), ended)
        ended = jnp.where(fine | over, ended, status).astype(jnp.int32)
        return Search(
            x=jnp.where(ended == -1, target, x),
            memory=memory,
            lower=lower,
            upper=upper,
            beyond=beyond,
            last=x,
            value=value,
            pace=pace,
            status=ended,
            evaluations=state.evaluations + 1,
            steps=state.steps + steps.astype(jnp.int32),
        )

    zero = jnp.zeros((), jnp.int32)
    far = jnp.asarray(jnp.inf, start.dtype)
    nothing = jnp.asarray(jnp.nan, start.dtype)
    first = Search(
        start, memory, -far, far, jnp.zeros((), bool), nothing, nothing, jnp.ones((), start.dtype), zero - 1, zero, zero
    )
    search = while_loop(lambda state: state.status == -1, onward, first)
    return search.x, search.memory, SolveInfo(search.status, search.steps, jnp.abs(search.value))


@record
class RatedTorque(Record):
    """Torque for a given life."""

    torque: Any = field("N m", "of the discs on the output, > 0")
    info: SolveInfo = field(
        "-", "residual: |ln(life / wanted)| over the exponent of life; steps: of all equilibria", kind="record"
    )


@checked
def rated_torque(
    design: Reducer,
    errors: ReducerErrors,
    *,
    life: Scalar,
    output_speed: Scalar,
    samples: int = 48,
    turns: float = 1.0,
    method: str = "basic",
    reliability: Scalar = 0.9,
    tilt: Scalar = 0.0,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> RatedTorque:
    """Largest constant torque under which all crank bearings as a system reach a life, at one speed.

    Args:
        design: as in `rating`.
        errors: as in `rating`.
        life: of the system at `reliability`, () s, > 0.
        output_speed: of the output against the part at rest, () rad/s, either sign, not 0.
        samples: as in `rating`.
        turns: as in `rating`.
        method: as in `rating`.
        reliability: as in `rating`.
        tilt: as in `rating`.
        contact: as in `rating`.
        carrier: as in `rating`.
        sun: as in `rating`.

    Returns:
        RatedTorque. With NaN: NO_BRACKET (no torque gives such a life: interference alone takes more of it),
        CONTACT_OVERLOAD (the torque lies beyond the contact law), or a status of `rating`.

    Raises:
        ValueError: life <= 0, output_speed 0, and as `rating`.
    """
    expect(design, "life.rated_torque", *KINDS)
    plan = check_plan(design, errors, samples, turns, method, reliability, tilt, (contact, carrier, sun))
    if concrete(life) and np.any(np.asarray(life) <= 0):
        raise ValueError(f"life = {quantity(life, 's')}: must be positive")
    if concrete(output_speed) and np.any(np.asarray(output_speed) == 0):
        raise ValueError("output_speed = 0 rad/s: must not be 0; at rest no bearing has a life")
    return _rated_torque(plan, design, errors, life, output_speed, reliability, tilt)


class Given(NamedTuple):
    """Numbers that the root depends on."""

    design: PyTree
    errors: PyTree
    eccentricity: jax.Array
    bearings: Bearings
    budget: jax.Array  # revolutions that 90 % of the bearings must reach
    tilt: jax.Array
    sound: jax.Array  # 1, or 0 where the case is invalid


@quick(0)
def _rated_torque(
    plan: Plan, design: Reducer, errors: ReducerErrors, life: Scalar, speed: Scalar, reliability: Scalar, tilt: Scalar
) -> RatedTorque:
    read = admit(plan.layout, design, errors, 0.0, 0.0)
    call = entered(design, read, speed, life, reliability, tilt, lambda speed, life: ~(life > 0) | (speed == 0))
    budget = call.time * jnp.abs(call.speed) * plan.layout.pins / (2 * jnp.pi * call.factor)
    sound = call.gate.good.astype(budget.dtype)
    given = Given(read.design, read.errors, read.eccentricity, call.bearings, budget, call.tilt, sound)
    x, _, info = _solve(plan, given)
    torque, info = call.gate.close(jnp.exp(x), info=info)
    return RatedTorque(jnp.where(succeeded(info.status), torque, jnp.nan), info)


def _missing(plan: Plan, given: Given, x: jax.Array, start: jax.Array) -> Evaluated:
    """ln(life / wanted) over the exponent of life at the torque e^x, status, steps and displacements."""
    refused = Gate(((given.sound < 0.5, Status.NONFINITE),))
    torque = jnp.exp(x)[None]
    read = Read(given.design, given.errors, given.eccentricity, torque, jnp.zeros_like(x), refused)
    angles = plan.input_angles(given.design, x.dtype)
    forces = bearing_forces(plan.layout, read, torque, angles, start, near=plan.near)
    damage = damages(plan, given.bearings, given.errors, forces, jnp.ones_like(torque), given.tilt)
    share = damage.whole * given.budget / 1e6  # of the life that the wanted revolutions take
    loaded = share > 0
    value = jnp.where(loaded, -jnp.log(jnp.where(loaded, share, 1)) / given.bearings.arm.life_exponent, 1)
    status = worst(jnp.append(jnp.ravel(forces.info.status), damage.info.status))
    assert forces.displacements is not None
    return value, status, jnp.sum(forces.info.steps), forces.displacements


def _solve(plan: Plan, given: Given) -> Root:
    """ln torque, displacements there, and how it was found."""

    def search(given: Given) -> Root:
        dynamic = ratings(given.bearings.arm).dynamic
        first = kind_of(given.design).torque(given.design, given.eccentricity, dynamic) * plan.layout.discs / 5
        cold = jnp.full((plan.samples, 1, plan.layout.unknowns), jnp.nan, first.dtype)
        return largest_root(lambda x, start: _missing(plan, given, x, start), jnp.log(first), cold)

    return implicit_root(search, lambda x, given, start: _missing(plan, given, x, start)[0], given)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def implicit_root(search: Callable[[Numbers], Root], value: Callable[..., jax.Array], given: Numbers) -> Root:
    """A root with the derivatives of its equation, dx = -(dv / d given) dgiven / (dv / dx).

    Args:
        search: (given) -> root, memory of the last evaluation, and how the root was found.
        value: (x, given, memory) -> what is zero at the root.
        given: what the root depends on.
    """
    return search(given)


@implicit_root.defjvp
def _implicit_root_jvp(
    search: Callable[[Numbers], Root],
    value: Callable[..., jax.Array],
    primals: tuple[Numbers],
    tangents: tuple[Numbers],
) -> tuple[Root, Root]:
    (given,), (change,) = primals, tangents
    x, memory, info = implicit_root(search, value, given)
    regular = succeeded(info.status) & jnp.isfinite(x)
    place = jnp.where(regular, x, 0)
    slope = jax.jacfwd(value)(place, given, memory)  # `jax.linearize` would forget the rules of second derivatives
    regular &= slope != 0
    moved = jax.jvp(lambda given: value(place, given, memory), (given,), (change,))[1]
    dx = -moved / jnp.where(regular, slope, 1)
    still = jax.custom_derivatives.zero_from_primal((memory, info))
    return (x, memory, info), (jnp.where(regular, dx, 0), *still)
