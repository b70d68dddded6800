"""All crank bearings of one reducer: inputs, valid values, and the damage by their forces.

Loads of the two support bearings of a crank: statics of a beam, and thrust of tapered bearings.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import status
from rvjax._jax.elementary import power
from rvjax.base.fields import fit
from rvjax.bearings import Bearings, RollingBearing
from rvjax.cycloidal import Reducer
from rvjax.errors import Errors
from rvjax.life.bearing import check_method, damaged
from rvjax.life.damage import Damage, basic, check_bearing, harmless, magnitude, ratings, unfit
from rvjax.life.duty import TurnPlan, kind_of
from rvjax.loaded import BearingForces, Read, check_input, unchecked
from rvjax.records import PyTree, Scalar, concrete, promote, quantity
from rvjax.status import Gate, SolveInfo, Status, worst_of


def shared(bearings: Bearings, arm: jax.Array, support: jax.Array) -> jax.Array:
    """Radial force of each support, (..., c, 2, 2) N [support 0, 1; x, y].

    Args:
        bearings: without positions each support carries half (Eq. 17).
        arm: crank on disc, (..., d, c, 2) N.
        support: both supports together, crank on carrier, (..., c, 2) N.
    """
    if not bearings.placed:
        return jnp.stack([support / 2, support / 2], axis=-2)
    gear = support + jnp.sum(arm, axis=-3)  # Eq. 16
    discs = arm.shape[-3]
    place = jnp.broadcast_to(bearings.disc_position, (discs,)).reshape((1,) * (arm.ndim - 3) + (discs, 1, 1))
    one = (bearings.planet_position * gear - jnp.sum(place * arm, axis=-3)) / bearings.support_span  # Eq. 18
    return jnp.stack([support - one, one], axis=-2)


class Equivalent(NamedTuple):
    """Equivalent loads of every instant, (...,) N."""

    dynamic: jax.Array
    static: jax.Array


def tapered(bearings: Bearings, force: jax.Array) -> Equivalent:
    """Equivalent loads of two tapered bearings set against each other. Eqs. 19, 20.

    Args:
        bearings: with preload.
        force: radial, (..., c, 2, 2) N [support 0, 1; x, y].
    """
    assert bearings.support is not None
    cotangent = 1 / jnp.tan(bearings.support.contact_angle)
    axial_factor = 0.4 * cotangent  # Y
    radial = magnitude(force)
    thrust = jnp.max(radial, axis=-1, keepdims=True) / (2 * axial_factor)
    axial = jnp.maximum(bearings.preload, thrust)
    return Equivalent(
        dynamic=jnp.maximum(radial, 0.4 * radial + axial_factor * axial),
        static=jnp.maximum(radial, 0.5 * radial + 0.22 * cotangent * axial),
    )


PLACES = ("disc_position", "planet_position", "support_span")


@dataclass(frozen=True)
class Plan(TurnPlan):
    """Static settings of a program of lives.

    Attributes:
        layout: of the reducer.
        samples: number of angles.
        crank_turns: in which they lie.
        method: as in `rating`.
        sense: of the cranks against disc and carrier, 1 or -1 for a positive turn of the output.
    """

    method: str
    sense: int


def check_plan(
    design: Reducer,
    errors: Errors,
    samples: int,
    turns: float,
    method: str,
    reliability: Scalar,
    tilt: Scalar,
    supports: tuple[str, ...],
) -> Plan:
    """The plan of a call.

    Args:
        design: the reducer.
        errors: of its parts.
        samples: as in `rating`.
        turns: as in `rating`.
        method: as in `rating`.
        reliability: as in `rating`.
        tilt: as in `rating`.
        supports: contact, carrier and sun, as in `loaded.equilibrium`.

    Raises:
        ValueError: see `rating`.
    """
    layout = check_input(design, errors, *supports)
    check_method(method, tilt)
    bearings = design.bearings
    if bearings is None:
        kind = type(design).__name__
        raise ValueError(f"{kind}.bearings = None: the life needs them; give Bearings(arm=RollerBearing(...))")
    if not kind_of(design).supports:
        check_alone(bearings, type(design).__name__, "Bearings")
    for name, bearing in (("arm", bearings.arm), ("support", bearings.support)):
        if bearing is not None:
            check_bearing(bearing, f"Bearings.{name}", method)
    check_places(bearings, design.counts, "Bearings")
    if bearings.preload is not None and method != "basic":
        raise ValueError(
            f'method = {method!r}: must be "basic" with tapered supports (Bearings.preload, support.contact_angle > 0)'
        )
    plan = Plan.of(layout, samples, turns, method, kind_of(design).sense(design))
    if concrete(reliability) and not np.all((np.asarray(reliability) > 0) & (np.asarray(reliability) < 1)):
        raise ValueError(f"reliability = {quantity(reliability, '-')}: must lie between 0 and 1")
    return plan


def check_alone(bearings: Bearings, kind: str, where: str) -> None:
    """Raise ValueError for what only bearings of a crank in a carrier have.

    Args:
        bearings: of the eccentrics.
        kind: of the reducer, for the message.
        where: name of the bearings, for the message.

    Raises:
        ValueError: names the support and the field that is given.
    """
    for name in ("support", "preload", *PLACES):
        if getattr(bearings, name) is not None:
            raise ValueError(
                f"{where}.{name}: must be None for a {kind}; shaft bearings ({where}.support) are not rated"
            )


def check_places(bearings: Bearings, counts: Mapping[str, int], name: str) -> None:
    """Raise ValueError for axial positions, a span or a preload whose shape does not fit the reducer.

    Args:
        bearings: of the cranks.
        counts: of the design.
        name: of the bearings, for the message.

    Raises:
        ValueError: names the field and its shape.
    """
    for place in (*PLACES, "preload"):
        if (value := getattr(bearings, place)) is not None:
            fit(f"{name}.{place}", value, ("discs",) if place == "disc_position" else (), counts)


class Entered(NamedTuple):
    """Numbers that a life reads besides those of the loaded equilibrium, harmless where they cannot be."""

    bearings: Bearings
    speed: jax.Array  # rad/s
    time: jax.Array  # s
    factor: jax.Array  # a1: life at the reliability over that at 90 %
    tilt: jax.Array  # rad
    gate: Gate


def entered(
    design: PyTree,
    read: Read,
    speed: Scalar,
    time: Scalar,
    reliability: Scalar,
    tilt: Scalar,
    impossible: Callable[[jax.Array, jax.Array], jax.Array],
) -> Entered:
    """Check the bearings and the other numbers of a call.

    Args:
        design: its bearings are read.
        read: numbers of the loaded equilibrium.
        speed: of the output, rad/s.
        time: of the phases, or a life, s.
        reliability: share of the bearings.
        tilt: rad.
        impossible: whether a speed and a time cannot be.
    """
    bearings, *others = promote(design.bearings, speed, time, reliability, tilt, read.torque)[:5]
    of_speed, of_time, share, lean = others
    support, tapered_supports = bearings.support, bearings.preload is not None
    refused = [
        (impossible(of_speed, of_time), Status.INVALID_GEOMETRY),
        (~((share > 0) & (share < 1)), Status.INVALID_GEOMETRY),
        *unfit(bearings.arm),
        (~(bearings.arm.contact_angle == 0), Status.INVALID_GEOMETRY),
    ]
    if support is not None:
        angled = support.contact_angle > 0 if tapered_supports else support.contact_angle == 0
        refused += [*unfit(support), (~angled, Status.INVALID_GEOMETRY)]
    if bearings.support_span is not None:
        refused.append((~(bearings.support_span > 0), Status.INVALID_GEOMETRY))
    if tapered_supports:
        refused.append((bearings.preload < 0, Status.INVALID_GEOMETRY))
    rest = unchecked(bearings, arm=None, support=None)
    for number in jax.tree.leaves((others, rest)):
        refused.append((~jnp.all(jnp.isfinite(number)), Status.NONFINITE))

    safe = {"arm": harmless(bearings.arm, 0.0)}
    safe |= {} if support is None else {"support": harmless(support, 0.1 if tapered_supports else 0.0)}
    safe_bearings = jax.tree.map(
        lambda x, y: jnp.asarray(y, x.dtype), bearings, unchecked(jax.tree.map(jnp.ones_like, rest), **safe)
    )
    spare = [jnp.ones_like(of_speed), jnp.ones_like(of_time), jnp.full_like(share, 0.9), jnp.zeros_like(lean)]
    (bearings, others), gate = status.admit((bearings, others), (safe_bearings, spare), *refused, after=read.gate)
    of_speed, of_time, share, lean = others
    return Entered(bearings, of_speed, of_time, reliability_factor(share), lean, gate)


class Damages(NamedTuple):
    """By one cycle, a million revolutions long."""

    arm: Damage  # (d, c)
    support: Damage | None  # (c, 2)
    hardest: jax.Array  # largest P0 / C0 of any bearing at any instant
    info: SolveInfo
    whole: jax.Array  # rate of the system of all bearings, Eq. 24


def system(parts: Sequence[tuple[jax.Array, float]]) -> jax.Array:
    """Rate of a series system, (): sum of (rate of a part / rate)^(slope of the part) = 1. Eqs. 24, 30.

    With one slope a closed form. With two, Newton steps in the logarithm x of the rate over the largest one: the slopes
    of log(sum) in x lie between theirs, so that an error e leaves less than (difference of the slopes)^2 e^2 / 8.

    Args:
        parts: rates of parts, (n,), with their slope of Weibull; with equal slopes in one group.
    """
    largest = jax.lax.stop_gradient(jnp.max(jnp.concatenate([rates for rates, _ in parts])))
    largest = jnp.where(largest > 0, largest, 1)
    sums = [jnp.sum(power(rates / largest, slope)) for rates, slope in parts]
    if len(parts) == 1:
        return largest * power(sums[0], 1 / parts[0][1])
    each, slopes = jnp.stack(sums), jnp.asarray([slope for _, slope in parts], largest.dtype)
    loaded = jnp.any(each > 0)
    each, x = jnp.where(loaded, each, 1), jnp.zeros_like(largest)
    for _ in range(3):
        share = each * jnp.exp(-slopes * x)
        x = x + jnp.log(jnp.sum(share)) * jnp.sum(share) / jnp.sum(share * slopes)
    return jnp.where(loaded, largest * jnp.exp(x), 0)


def damages(
    plan: Plan, bearings: Bearings, errors: PyTree, forces: BearingForces, share: jax.Array, tilt: jax.Array
) -> Damages:
    """Effect of the forces of one cycle on every crank bearing.

    Args:
        plan: samples and method.
        bearings: that exist.
        errors: clearances are read.
        forces: (n, phases, ...).
        share: of the revolutions in each phase, (phases,).
        tilt: rad.
    """
    samples, phases = forces.arm.shape[:2]
    weight = jnp.broadcast_to(share / samples, (samples, phases)).ravel()
    turned = plan.sense * 2 * np.pi * np.arange(plan.samples) / plan.samples  # cranks, without whole turns, rad
    angle = jnp.repeat(jnp.asarray(turned, forces.arm.dtype), phases)
    arm = forces.arm.reshape(samples * phases, *forces.arm.shape[2:])
    supports = forces.support.reshape(samples * phases, *forces.support.shape[2:])

    def by_bearing(bearing: RollingBearing, force: jax.Array, clearance: Scalar) -> tuple[Damage, SolveInfo]:
        """Damage of bearings (rows, columns) with forces (n, rows, columns, 2)."""
        rated, radial = ratings(bearing), jnp.asarray(clearance)

        def one(own: jax.Array) -> tuple[Damage, SolveInfo]:
            return damaged(plan.method, bearing, rated, own, angle, weight, radial, tilt)

        return jax.vmap(jax.vmap(one, 1), 1)(force)

    arm_damage, info = by_bearing(bearings.arm, arm, errors.bearing_clearance)
    infos = [worst_of(info)]
    hardest = [jnp.max(magnitude(arm)) / ratings(bearings.arm).static]
    other = None
    if bearings.support is not None:
        force, rated = shared(bearings, arm, supports), ratings(bearings.support)
        if bearings.preload is None:
            other, info = by_bearing(bearings.support, force, errors.support_clearance)
            infos.append(worst_of(info))
            static = magnitude(force)
        else:
            loads: Equivalent = tapered(bearings, force)
            tapering = bearings.support.life_exponent
            other = jax.vmap(jax.vmap(lambda size: basic(size, weight, rated, tapering), 1), 1)(loads.dynamic)
            static = loads.static
        hardest.append(jnp.max(static) / rated.static)
    info = worst_of(jax.tree.map(lambda *x: jnp.stack(x), *infos))
    rates = {bearings.arm.weibull_slope: [jnp.ravel(arm_damage.rate)]}
    if bearings.support is not None and other is not None:
        rates.setdefault(bearings.support.weibull_slope, []).append(jnp.ravel(other.rate))
    whole = system([(jnp.concatenate(parts), slope) for slope, parts in rates.items()])
    return Damages(arm_damage, other, jnp.max(jnp.stack(hardest)), info, whole)


def reliability_factor(reliability: jax.Array) -> jax.Array:
    """a1: life at a reliability over that at 90 %, ISO 281:2007. Eq. 23.

    Args:
        reliability: between 0 and 1.
    """
    return 0.95 * power(jnp.log(reliability) / math.log(0.9), 1 / 1.5) + 0.05
