"""Figures of a design without errors, from closed forms."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import InvoluteStage, RVReducer, expect
from rvjax.geometry.drive import of_drive
from rvjax.geometry.ring import Figures as Figures, harmless, material, of_ring, of_steel
from rvjax.records import Array, PyTree, Scalar, promote
from rvjax.status import Status, admit


@checked
def figures(design: RVReducer | CycloidalReducer, output_torque: Scalar = 0.0) -> Figures:
    """Figures of a design without errors.

    Curvature is that of the flank as ground: an equidistant modification moves it along its normal, a shift
    modification grinds it on another pin circle, harmonics add their own. The pressure is that of rigid discs: the
    force of a pin in proportion to its lever about the disc centre, line contact of pin and flank, the largest value
    while the cranks pass a pitch. Output pins of a single-stage drive likewise.

    Args:
        design: involute stage, cycloid stage, cranks, output pins, contact and inertia are read.
        output_torque: () N m; its sign does not count.

    Returns:
        Figures. All are NaN with status NONFINITE (a number that is read is NaN or inf) or INVALID_GEOMETRY (K1 outside
        (0, 1), a length or modulus that must be positive is not, or holes not larger than their pins). With UNDERCUT
        only the pressure of the pins is NaN.

    Raises:
        ValueError: another kind of design, or other than one tooth of difference between ring and disc.
    """
    expect(design, "geometry.figures", *_KINDS)
    return _KINDS[type(design)](design, output_torque)


def _of_rv(design: RVReducer, output_torque: Scalar) -> Figures:
    cycloid = design.cycloid
    if cycloid.pin_count != cycloid.disc_teeth + 1:
        raise ValueError(
            f"CycloidStage.pin_count = {cycloid.pin_count}: must be disc_teeth + 1 = {cycloid.disc_teeth + 1}"
        )
    contact = design.contact and design.contact.replace(pin_stiffness=None, pin_support=None)
    read = design.involute, cycloid, design.cranks.replace(bearing_stiffness=None), contact, _masses(design)
    return _figures((*read, output_torque))


_KINDS: dict[type, Callable[[Any, Scalar], Figures]] = {RVReducer: _of_rv, CycloidalReducer: of_drive}
"""Figures by the class of the design."""


def _masses(design: RVReducer) -> list[Any] | None:
    """Masses of all rotating parts."""
    inertia, cranks = design.inertia, (design.cranks.count,)
    if inertia is None:
        return None
    sizes = {"sun": (), "planet": cranks, "crank": cranks, "disc": (design.cycloid.disc_count,), "output": ()}
    return [jnp.broadcast_to(getattr(inertia, f"{part}_mass"), size) for part, size in sizes.items()]


@partial(jax.jit, inline=True)
def _figures(read: PyTree) -> Figures:
    read = promote(read)
    gears, cycloid, cranks, contact, masses, torque = read
    k1, circle = cycloid.shortening_coefficient, cranks.circle_radius
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    positive = [cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.pin_radius, circle]
    positive += [gears.module, gears.centre_distance, gears.sun_base_radius, gears.planet_base_radius]
    positive += material(contact)
    possible = (k1 > 0) & (k1 < 1) & jnp.all(jnp.stack(positive) > 0) & (jnp.cos(gears.pressure_angle) > 0)
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (gears, cycloid, cranks, contact, masses, torque), gate = admit(read, _harmless(read), *checks)

    pins, circle = cycloid.pin_count, cranks.circle_radius
    ring, pin = cycloid.pin_circle_radius, cycloid.pin_radius
    share = cycloid.disc_teeth / (cycloid.disc_count * (pins + gears.sun_teeth / gears.planet_teeth))
    found, pressure, info = of_ring(cycloid, contact, jnp.abs(torque) * share, gate)
    own, _ = gate.close(
        dict(
            crank_room=ring - pin - cycloid.eccentricity - circle,
            contact_ratio=contact_ratio(gears),
            mass=None if masses is None else sum(map(jnp.sum, masses)),
        )
    )
    return Figures(**found, **own, pin_pressure=pressure, info=info)


def _harmless(read: PyTree) -> PyTree:
    """A reducer that exists, in the place of one that does not."""
    gears, cycloid, _, contact, *_ = ones = jax.tree.map(jnp.ones_like, read)
    gears = gears.replace(sun_base_radius=0.3, planet_base_radius=0.6, pressure_angle=0.35)
    return gears, harmless(cycloid), ones[2], contact and of_steel(contact), *ones[4:]


def contact_ratio(gears: InvoluteStage) -> Array:
    """Transverse contact ratio of sun and planet at their centre distance, tips of standard height."""
    bases = jnp.stack([jnp.asarray(gears.sun_base_radius), jnp.asarray(gears.planet_base_radius)])
    tips = gears.module * jnp.asarray(np.array([gears.sun_teeth, gears.planet_teeth]) / 2 + 1, bases.dtype)
    square = tips**2 - bases**2
    path = jnp.sum(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0))
    # a0 sin(alpha_w), with a0 cos(alpha_w) the sum of the base radii
    line = gears.centre_distance**2 - jnp.sum(bases) ** 2
    path -= jnp.where(line > 0, jnp.sqrt(jnp.where(line > 0, line, 1)), 0)
    return path / (gears.module * jnp.pi * jnp.cos(gears.pressure_angle))
