"""Kinds of reducers with friction: what slides where, besides ring pins and arm bearings, which all kinds have."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import Inertia, RVReducer
from rvjax.loaded import Layout, Read
from rvjax.records import PyTree, Scalar

Inertias = tuple[Scalar, Scalar] | tuple[None, None]


class Held(NamedTuple):
    """Rotations in an elastic motion with the input held, and the ideal motion that it contains, rad."""

    discs: jax.Array  # (d,)
    cranks: jax.Array  # (c,)
    carrier: jax.Array  # ()
    ideal: jax.Array  # () of the carrier against the ring


class Kind(NamedTuple):
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


KINDS: dict[type, Kind] = {
    RVReducer: Kind(
        joints="gear_meshes",
        joint_slip=_slip_of_meshes,
        supports=True,
        support_turns=lambda design: design.cycloid.pin_count,
        held=_held_sun,
        inertias=_inertias_of_rv,
    ),
    CycloidalReducer: Kind(
        joints="output_pins",
        joint_slip=_slip_in_holes,
        supports=False,
        support_turns=lambda design: abs(design.ratio),
        held=_held_shaft,
        inertias=lambda design: (None, None),
    ),
}


def kind_of(design: PyTree) -> Kind:
    """Entry of `KINDS` for a design.

    Args:
        design: one of `KINDS`.
    """
    return next(kind for cls, kind in KINDS.items() if isinstance(design, cls))
