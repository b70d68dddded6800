"""Inputs of every function of friction: kinds of reducers, plan of a call, coefficients of the unit, bearings.

A kind says what slides where, besides ring pins and arm bearings, which all kinds have.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax import status
from rvjax.cycloidal import CycloidalReducer, Reducer
from rvjax.designs import Bearings, Friction, Inertia, RVReducer, expect
from rvjax.errors import Errors
from rvjax.life import TurnPlan, check_alone, check_places
from rvjax.loaded import Layout, Read, admit, check_input, unchecked
from rvjax.records import Design, PyTree, Scalar, concrete, promote, quantity
from rvjax.status import Gate, Status

Inertias = tuple[Scalar, Scalar] | tuple[None, None]


class Held(NamedTuple):
    """Rotations in an elastic motion with the input held, and the ideal motion that it contains, rad."""

    discs: jax.Array  # (d,)
    cranks: jax.Array  # (c,)
    carrier: jax.Array  # ()
    ideal: jax.Array  # () of the carrier against the ring


class FrictionKind(NamedTuple):
    """Rates of motion refer to one radian of the output."""

    joints: str  # place of the joints of `loaded` in `Friction`
    joint_slip: Callable[[PyTree, jax.Array], Scalar]  # (design, eccentricity) -> m
    supports: bool  # whether the supports of the cranks turn with the discs' forces, in the carrier
    support_turns: Callable[[PyTree], float]
    held: Callable[[Layout, Read, jax.Array], Held]
    inertias: Callable[[PyTree], Inertias]  # rotor, output, at the output


def _slip_of_meshes(design: RVReducer, eccentricity: jax.Array) -> Scalar:
    """Eq. 5: pitch line of the base circle, seen from the carrier."""
    return design.involute.sun_base_radius * (design.ratio - 1)


def _slip_in_holes(design: CycloidalReducer, eccentricity: jax.Array) -> Scalar:
    """Eq. 2."""
    return eccentricity * design.cycloid.pin_count


def _held_sun(layout: Layout, read: Read, q: jax.Array) -> Held:
    radius = jnp.asarray(read.design.cranks.circle_radius)
    rho = q[layout.inner + 2 : layout.carried : 3] / read.design.involute.planet_base_radius
    return Held(q[2 : layout.inner : 3] / radius, rho, q[layout.carried] / radius, jnp.zeros((), q.dtype))


def _held_shaft(layout: Layout, read: Read, q: jax.Array) -> Held:
    """A shaft that is held against a carrier at rest turns with it against the ring, so that the ideal motion adds."""
    radius = jnp.asarray(read.design.output.circle_radius)
    carrier = q[layout.carried] / radius
    turned = jnp.zeros_like(carrier) if read.design.member == "carrier" else carrier
    ideal = -turned / read.design.cycloid.pin_count
    return Held(q[2 : layout.inner : 3] / radius, turned[None], carrier, ideal)


def _inertias_of_rv(design: RVReducer) -> Inertias:
    """Eqs. 30 and 31. A crank turns at -zc of the output, against the housing."""
    parts: Inertia | None = design.inertia
    if parts is None:
        return None, None
    cycloid, cranks, discs = design.cycloid, design.cranks.count, design.cycloid.disc_count

    def summed(value: Scalar, members: int) -> jax.Array:
        return jnp.sum(jnp.broadcast_to(value, (members,)))

    spinning = summed(parts.planet_inertia, cranks) + summed(parts.crank_inertia, cranks)
    rotor = parts.sun_inertia * design.ratio**2 + spinning * cycloid.disc_teeth**2
    rotor += summed(parts.disc_mass, discs) * (cycloid.disc_teeth * cycloid.eccentricity) ** 2
    carried = summed(parts.planet_mass, cranks) + summed(parts.crank_mass, cranks)
    output = parts.output_inertia + carried * design.cranks.circle_radius**2 + summed(parts.disc_inertia, discs)
    return rotor, output


KINDS: dict[type, FrictionKind] = {
    RVReducer: FrictionKind(
        joints="gear_meshes",
        joint_slip=_slip_of_meshes,
        supports=True,
        support_turns=lambda design: design.cycloid.pin_count,
        held=_held_sun,
        inertias=_inertias_of_rv,
    ),
    CycloidalReducer: FrictionKind(
        joints="output_pins",
        joint_slip=_slip_in_holes,
        supports=False,
        support_turns=lambda design: abs(design.ratio),
        held=_held_shaft,
        inertias=lambda design: (None, None),
    ),
}


def kind_of(design: Design) -> FrictionKind:
    """Entry of `KINDS` for a design.

    Args:
        design: one of `KINDS`.
    """
    return next(kind for cls, kind in KINDS.items() if isinstance(design, cls))


SHARES = {
    "ring_pins": "ring_pin_friction",
    "output_pins": "output_pin_friction",
    "arm_bearings": "arm_bearing_friction",
    "support_bearings": "support_bearing_friction",
    "gear_meshes": "gear_mesh_friction",
    "arm_bearing_moment": "drag_friction",
    "support_bearing_moment": "drag_friction",
    "input_drag": "drag_friction",
    "output_drag": "drag_friction",
    "input_viscous": "drag_friction",
    "output_viscous": "drag_friction",
}
"""Error by which each coefficient of a unit is larger than the nominal one."""


def check_call(
    where: str,
    design: Reducer,
    errors: Errors,
    friction: Friction | None,
    supports: tuple[str, ...],
    samples: int = 1,
    turns: float = 1.0,
) -> tuple[TurnPlan, Friction]:
    """The plan of a call, and the friction that it takes.

    Args:
        where: the function, for messages.
        design: the reducer.
        errors: of its parts.
        friction: as given; None for that of the design.
        supports: contact, carrier and sun, as in `loaded.equilibrium`.
        samples: angles over the turns.
        turns: of the output.

    Raises:
        ValueError: see `losses`.
    """
    expect(design, where, *KINDS)
    layout = check_input(design, errors, *supports)
    kind = type(design).__name__
    friction = design.friction if friction is None else friction
    if not isinstance(friction, Friction):
        raise ValueError(f"friction = {friction!r}: must be a Friction, or {kind}.friction must be one")
    bearings: Bearings | None = design.bearings
    of_kind = kind_of(design)
    if of_kind.joints != "output_pins" and friction.output_pins is not None:
        raise ValueError(f"Friction.output_pins: must be None for a {kind}; it has no output pins")
    if not of_kind.supports:
        if friction.support_bearings is not None:
            raise ValueError(
                f"Friction.support_bearings: must be None for a {kind}; give support_bearing_moment for its shaft"
            )
        if concrete(friction.gear_meshes) and friction.gear_meshes != 0:
            raise ValueError(
                f"Friction.gear_meshes = {quantity(friction.gear_meshes, '-')}: must be 0 for a {kind}; it has no mesh"
            )
        if bearings is not None:
            check_alone(bearings, kind, "Bearings")
    for name in ("arm_bearings", "support_bearings"):
        if getattr(friction, name) is not None and bearings is None:
            raise ValueError(f"{kind}.bearings = None: Friction.{name} needs them; give Bearings(arm=RollerBearing())")
    if friction.support_bearings is not None:
        assert bearings is not None
        if bearings.support is None:
            raise ValueError("Bearings.support = None: Friction.support_bearings needs it")
        check_places(bearings, design.counts, "Bearings")
    return TurnPlan.of(layout, samples, turns), friction


class Call(NamedTuple):
    """Numbers that a call reads, harmless where they cannot be."""

    read: Read
    friction: Friction  # of this unit: nominal coefficients times 1 + share
    bearings: Bearings | None  # what is read of them, else None
    speed: jax.Array  # of the output, () rad/s
    gate: Gate


def entered(
    plan: TurnPlan,
    design: Reducer,
    errors: Errors,
    friction: Friction,
    torque: Scalar,
    angle: Scalar = 0.0,
    speed: Scalar = 0.0,
) -> Call:
    """Check the numbers of a call.

    Args:
        plan: counts and methods.
        design: the reducer.
        errors: of its parts.
        friction: nominal coefficients.
        torque: of the output, () N m.
        angle: of the input, () rad.
        speed: of the output, () rad/s.
    """
    read = admit(plan.layout, design, errors, torque, angle)
    bearings = _read_of(design.bearings, friction)
    shares = {name: getattr(errors, share, 0.0) for name, share in SHARES.items()}
    friction, bearings, shares, speed, _ = promote(friction, bearings, shares, speed, read.torque)
    given = {name: value for name, value in vars(friction).items() if value is not None}
    finite = [jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves((friction, bearings, shares, speed))]
    negative = [value < 0 for value in given.values()] + [share < -1 for share in shares.values()]
    negative += [~(friction.static_factor > 0), friction.gear_meshes >= 1]
    refused = [
        (~jnp.all(jnp.stack(finite)), Status.NONFINITE),
        (jnp.any(jnp.stack(negative)) | _impossible(bearings), Status.INVALID_GEOMETRY),
    ]
    unit = unchecked(friction, **{name: given[name] * (1 + shares[name]) for name in SHARES if name in given})
    numbers = unit, bearings, speed
    spare = jax.tree.map(jnp.ones_like, numbers)
    (unit, bearings, of_output), gate = status.admit(numbers, spare, *refused, after=read.gate)
    return Call(read, unit, bearings, of_output, gate)


def _read_of(bearings: Bearings | None, friction: Friction) -> Bearings | None:
    """The bearings with None in the place of what no coefficient reads."""
    if bearings is None or (friction.arm_bearings is None and friction.support_bearings is None):
        return None

    def sizes(bearing: PyTree, coefficient: Scalar | None) -> object:
        if bearing is None or coefficient is None:
            return None
        numbers = {f.name for f in dataclasses.fields(bearing) if f.metadata["kind"] == "real"}
        return unchecked(bearing, **dict.fromkeys(numbers - {"pitch_diameter", "contact_angle"}))

    support = sizes(bearings.support, friction.support_bearings)
    kept = unchecked(bearings, arm=sizes(bearings.arm, friction.arm_bearings), support=support)
    if support is None:
        return unchecked(kept, disc_position=None, planet_position=None, support_span=None, preload=None)
    return kept


def _impossible(bearings: Bearings | None) -> jax.Array:
    """True for bearings that cannot exist."""
    wrong = [jnp.zeros((), bool)]
    if bearings is not None:
        wrong += [~(one.pitch_diameter > 0) for one in (bearings.arm, bearings.support) if one is not None]
        if bearings.support_span is not None:
            wrong.append(~(bearings.support_span > 0))
        if bearings.preload is not None and bearings.support is not None:
            angle = bearings.support.contact_angle
            wrong.append((bearings.preload < 0) | ~((angle > 0) & (angle < jnp.pi / 2)))
    return jnp.any(jnp.stack([jnp.asarray(one) for one in wrong]))
