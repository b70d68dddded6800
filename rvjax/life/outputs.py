"""Outputs of the life of the crank bearings for studies: one rating under the duty, and the torque for a life.

Random units on which the levels of the bearing life are measured, each method with levels of its own.

Lives of different methods differ by design, so no method is a level of another: a study with another method is another
question. A level is a number of angles round the turn of the output.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK
from rvjax.catalogue import RV_40E
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors, read_by
from rvjax.life.damage import METHODS, check_bearing, static_rating
from rvjax.life.duty import Duty, kind_of
from rvjax.life.machine import check_alone, check_places, check_plan
from rvjax.life.rated import RatedTorque, rated_torque
from rvjax.life.rating import Rating, by_forces, rating, under
from rvjax.loaded import (
    CONTACTS,
    MACHINE,
    RATED,
    SUPPORTS,
    WHOLE,
    BearingForces,
    Revolution,
    admit,
    check_carrying,
    instants,
    summary,
    turn,
    turns_of,
    ways,
)
from rvjax.outputs import Cases, Description, Joint, Output, Reading, Solved, Usual, Way, condition, number_of
from rvjax.records import PyTree
from rvjax.units import rpm

DUTY = ((RATED, 15 * rpm, 3600.0),)  # the rating point of catalogues
ANGLES = {"basic": (12, 24, 48, 96), "raceway": (24, 96), "slices": (12, 48)}  # the last: the reference
OUTPUTS = {"life": "s", "arm_bearing_life": "s", "static_safety": "-"}


def cases(quick: bool) -> Sequence[Cases]:
    """Units of the RV-40E at its rating point, by method; none in a quick run, where compiling takes longest.

    Args:
        quick: no levels.
    """
    return [] if quick else [_cases(method) for method in METHODS]


def _cases(method: str) -> Cases:
    unread = tuple(field for field in read_by(RVErrors, "loaded") if field not in WHOLE)
    return Cases(
        name=f"life_{method}",
        case=f"unit of the RV-40E at 412 N m, a revolution of the output, {method}",
        outputs=OUTPUTS,
        design=MACHINE.replace(bearings=RV_40E.bearings),
        errors=WHOLE,
        conditions=dict(duty=DUTY, reliability=0.9, pin_contact="hertz", carrier="fixed", sun="fixed"),
        torque=None,
        ways=tuple(Way(f"{method}, {n} angles", {"life_samples": n}, ("float64",)) for n in ANGLES[method]),
        batch=64,
        calls=2,
        question={"life_method": method},
        others=(*unread, "contact.pin_stiffness", "contact.pin_support"),
        timed=256,
    )


COLUMNS = {"output_torque": "N m", "output_speed": "rad/s", "time": "s"}


@dataclass(frozen=True)
class DriveLifeConditions:
    """Under which duty, and how, the bearings are rated. The turn is always a whole one of the output."""

    samples: int = condition(48, "input angles over the span", minimum=4, maximum=100_000)
    life_samples: int | None = condition(
        None, "input angles of a bearing life; samples where it is not given", minimum=4, maximum=100_000
    )
    pin_contact: str = condition("hertz", "contact law of discs and pins", choices=CONTACTS)
    carrier: str = condition("fixed", "centre of the carrier", choices=SUPPORTS)
    life_method: str = condition("basic", "of a bearing life; methods differ in level", choices=METHODS)
    reliability: float = condition(
        0.9, "share of the bearings, under the loads of one unit, that reach its life", unit="-", minimum=0, maximum=1
    )
    rated_life: float | None = condition(None, "that the rated torque gives", unit="s")
    rated_speed: float | None = condition(None, "of the output, at which the rated torque is sought", unit="rad/s")
    duty: tuple[tuple[float, ...], ...] | None = condition(None, "phases of a cycle", columns=COLUMNS)


@dataclass(frozen=True)
class LifeConditions(DriveLifeConditions):
    """The same conditions of an RV reducer."""

    sun: str = condition("fixed", "centre of the sun", choices=SUPPORTS)


def _ways(given: DriveLifeConditions) -> dict[str, Any]:
    return dict(
        samples=given.life_samples or given.samples,
        method=given.life_method,
        reliability=given.reliability,
        **ways(given),
    )


def _duty(errors: RVErrors, given: DriveLifeConditions) -> Duty:
    dtype = jnp.result_type(float, *jax.tree.leaves(errors))
    return Duty(*(jnp.asarray(column, dtype) for column in np.asarray(given.duty, float).T))


def rated(design: RVReducer, errors: RVErrors, given: DriveLifeConditions) -> Rating:
    """Under the duty."""
    return rating(errors.stiffened(design), errors, _duty(errors, given), **_ways(given))


def turned_and_rated(design: RVReducer, errors: RVErrors, given: PyTree) -> tuple[Revolution, Rating]:
    """Along the span under the output torque, and under the duty: one loop over all equilibria, half of the program."""
    design, duty = errors.stiffened(design), _duty(errors, given)
    samples = given.life_samples or given.samples
    supports = (*ways(given).values(),)
    plan = check_plan(design, errors, samples, 1.0, given.life_method, given.reliability, 0.0, supports)
    phases, n = len(given.duty), given.samples
    read = admit(plan.layout, design, errors, jnp.append(duty.output_torque, given.output_torque), 0.0)
    numbers = under(duty, phases, design, read, given.reliability, 0.0)

    along = 2 * np.pi * design.ratio * turns_of(design, given) * np.arange(n) / n
    spread = plan.input_angles(design, read.torque.dtype)
    torques = jnp.concatenate([jnp.full(n, read.torque[-1]), jnp.repeat(read.torque[:-1], plan.samples)])
    angles = jnp.concatenate([jnp.asarray(along, read.torque.dtype), jnp.tile(spread, phases)])
    before = np.concatenate(
        [np.minimum(2 * np.arange(n), 2), np.tile((np.arange(plan.samples) > 0) & plan.near, phases)]
    )
    turn = instants(plan.layout, read, torques, angles, before)

    around, rest = jax.tree.map(lambda x: x[:n], turn), jax.tree.map(lambda x: x[n:], turn)

    def each(x: jax.Array) -> jax.Array:
        return jnp.swapaxes(x.reshape(phases, plan.samples, *x.shape[1:]), 0, 1)

    forces = BearingForces(each(rest.arm), each(rest.support), jax.tree.map(each, rest.info), None)
    return summary(around), by_forces(plan, numbers, read.errors, forces)


def sought(design: RVReducer, errors: RVErrors, given: DriveLifeConditions) -> RatedTorque:
    """At the rated speed, for the rated life."""
    assert given.rated_life is not None and given.rated_speed is not None
    return rated_torque(
        errors.stiffened(design), errors, life=given.rated_life, output_speed=given.rated_speed, **_ways(given)
    )


def _arm(rated_life: Rating, design: RVReducer, given: object) -> Solved:
    return jnp.min(rated_life.arm), rated_life.info.status


def _refusing(
    name: str, own: Callable[[DriveLifeConditions], None]
) -> Callable[[RVReducer, DriveLifeConditions], None]:
    """Check the parts of a design, the reliability and the bearings of the method, then run the check `own`."""

    def refuse(design: RVReducer, given: DriveLifeConditions) -> None:
        check_carrying(design, name)
        if design.bearings is None:
            raise ValueError(
                f"design.bearings is missing: {name} needs [design.bearings.arm], with rollers, roller_diameter, "
                f"roller_length, pitch_diameter, or balls, ball_diameter, pitch_diameter"
            )
        for place, bearing in (("arm", design.bearings.arm), ("support", design.bearings.support)):
            if bearing is not None:
                check_bearing(bearing, f"design.bearings.{place}", given.life_method, "conditions.life_method")
        if not kind_of(design).supports:
            check_alone(design.bearings, type(design).__name__, "design.bearings")
        check_places(design.bearings, design.counts, "design.bearings")
        if not 0 < given.reliability < 1:
            raise ValueError(f"conditions.reliability = {given.reliability:g}: must lie between 0 and 1")
        if design.bearings.preload is not None and given.life_method != "basic":
            raise ValueError(
                f'conditions.life_method = "{given.life_method}": must be "basic" with tapered supports '
                f"(design.bearings.preload)"
            )
        own(given)

    return refuse


def _with_duty(given: DriveLifeConditions) -> None:
    if given.duty is None:
        told = ", ".join(f"{name} in {unit}" for name, unit in COLUMNS.items())
        raise ValueError(f"[[duty]] is missing: life and static safety need at least one phase, with {told}")
    times = [phase[2] for phase in given.duty]
    for number, time in enumerate(times):
        if time < 0:
            raise ValueError(f"duty[{number}].time = {time:g} s: must not be negative")
    if not sum(times) > 0:
        raise ValueError("duty.time = 0 s in all phases: must have a positive sum")


def _moving(given: DriveLifeConditions) -> None:
    _with_duty(given)
    assert given.duty is not None
    if not any(speed and time for _, speed, time in given.duty):
        raise ValueError(
            "duty.output_speed = 0 rad/s in all phases that last: must not be 0 in all of them; at rest no bearing "
            "has a life"
        )


def _with_life(given: DriveLifeConditions) -> None:
    assert given.rated_life is not None
    if given.rated_life <= 0:
        raise ValueError(f"conditions.rated_life = {given.rated_life:g} s: must be positive")
    if given.rated_speed == 0:
        raise ValueError("conditions.rated_speed = 0 rad/s: must not be 0; at rest no bearing has a life")


def _of_duty(
    name: str, unit: str, meaning: str, take: Callable[..., Solved] | None = None, read_in: str | None = None
) -> Output:
    """An output of the rating; without `take` its number of this name."""
    own = _with_duty if name == "static_safety" else _moving
    return Output(unit, meaning, Reading((rated,), take or number_of(name)), (), read_in, refuse=_refusing(name, own))


def _static(design: RVReducer) -> tuple[float, float] | None:
    """Limits of the force of an arm bearing, from its static rating."""
    if design.bearings is None:
        return None
    return -np.inf, float(np.min(np.asarray(static_rating(design.bearings.arm)))) / (SAFETY * STARTING)


LIFE, SAFETY, STARTING = 6000 * 3600.0, 1.5, 2.5
"""Usual life of a catalogue, s; static safety of the arm bearings at start and stop, and torque there over rated."""
UNKNOWN = (
    "bearing life (plane model): tilt and edge load (1 mrad costs a quarter of the life), axial forces and preload, "
    "lubricant and dirt, oscillation below a crank turn, wear; gears, flanks and main bearings have no life here; "
    "ratings hold as far as the bearings of the design, which makers of reducers do not publish"
)


def _outputs(arm: str, one: str, every: str) -> dict[str, Output]:
    """Outputs of a kind of reducer by the words for one of its arm bearings, for any bearing and for all."""
    return {
        "life": _of_duty("life", "s", f"that {every} of a unit reach at the reliability, under the duty", read_in="h"),
        "arm_bearing_life": _of_duty("arm_bearing_life", "s", f"least of {arm}, under the duty", _arm, "h"),
        "static_safety": _of_duty("static_safety", "-", f"least C0 / P0 of {one}, phase and angle, under the duty"),
        "rated_torque": Output(
            "N m",
            f"at the rated speed, for the rated life of {every}",
            Reading((sought,), number_of("torque")),
            ("rated_life", "rated_speed"),
            refuse=_refusing("rated_torque", _with_life),
        ),
    }


DESCRIPTION = Description(
    name="life",
    design=RVReducer,
    conditions=LifeConditions,
    outputs=_outputs("a crank bearing in a disc", "a crank bearing", "all crank bearings"),
    cases=cases,
    unknown=UNKNOWN,
    compiler_options=QUICK,
    parts=("bearings",),
    joints=(Joint((turn, rated), turned_and_rated),),
    usual={
        "life": Usual(lambda design: (LIFE, np.inf), "catalogue life at rated torque and 15 r/min"),
        "arm_bearing_force": Usual(_static, "C0/1.5/2.5: static safety 1.5 at start and stop, 2.5 times rated torque"),
    },
    work={rated: lambda given: ("life", (given.life_samples or given.samples) * len(given.duty))},
)

OTHERS = (
    dataclasses.replace(
        DESCRIPTION,
        design=CycloidalReducer,
        conditions=DriveLifeConditions,
        outputs=_outputs("an eccentric bearing", "an eccentric bearing", "all eccentric bearings"),
        cases=None,
        unknown="bearing life (plane model): tilt and edge load (1 mrad costs a quarter of the life), lubricant and "
        "dirt, wear, speed of cages; bearings of the shaft and of the output have no life here",
        usual={},
    ),
)
"""Of single-stage drives."""
